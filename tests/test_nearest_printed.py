"""The search tree of what is printed so far against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.toolpath.waypoints.nearest import ALWAYS, FAR, nearest_printed, printed_points


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(0, 400),
    beads=st.integers(1, 30),
    extent=st.sampled_from([(0.1, 0.1, 0.01), (0.3, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)]),
    seed=st.integers(0, 2**32 - 1),
)
def test_it_finds_the_nearest_of_what_is_there(count: int, beads: int, extent: tuple[float, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3)) * extent
    bead = rng.integers(ALWAYS, beads, count)
    tree = printed_points(points, bead)
    asked = rng.uniform(-0.03, 0.06, (40, 3)) + points.mean(axis=0) if count else rng.random((40, 3))
    for printed in (0, beads // 2, beads):
        away = np.linalg.norm(asked[:, None] - points, axis=2)
        away[:, bead >= printed] = np.inf
        best = away.min(axis=1, initial=np.inf)
        distance, index = nearest_printed(tree, printed, asked)
        assert distance == pytest.approx(np.minimum(best, FAR), abs=1e-12)
        assert ((index < 0) == (best > FAR)).all()
        found = index >= 0
        assert (bead[index[found]] < printed).all()
        assert away[np.flatnonzero(found), index[found]] == pytest.approx(best[found], abs=1e-12)


def test_of_two_as_near_the_first_is_taken_however_many_are_asked() -> None:
    points = np.array([[0.01 * k, side, 0.0] for k in range(50) for side in (-1e-3, 1e-3)])
    tree = printed_points(points, np.zeros(100, dtype=np.int64))
    asked = np.repeat(0.01 * np.arange(50)[:, None] * [1.0, 0.0, 0.0], 60, axis=0)
    _, index = nearest_printed(tree, 1, asked)  # in threads
    assert (index == np.repeat(2 * np.arange(50), 60)).all()
    assert (nearest_printed(tree, 1, asked[:100])[1] == index[:100]).all()
