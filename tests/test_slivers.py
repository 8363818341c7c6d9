"""Slender triangles cut across: the same surface, a bounded number of triangles, others as they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.collision.print_body import SLENDER, split, without_slivers

LONGEST = 0.02


def areas(triangles: Array) -> Array:
    out: Array = 0.5 * np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    return out


def test_good_triangles_stay_as_they_are() -> None:
    triangles = np.random.default_rng(1).normal(size=(50, 3, 3))
    assert without_slivers(triangles, LONGEST) is triangles
    thin = np.array([[[0.0, 0.0, 0.0], [0.019, 0.0, 0.0], [0.01, 1e-6, 0.0]]])  # no longer than is asked for
    assert without_slivers(thin, LONGEST) is thin


@pytest.mark.parametrize("apex", [0.0, 0.3, 5.0, 10.0])
@pytest.mark.parametrize("turn", [0, 1, 2])
def test_a_sliver_becomes_few_triangles(apex: float, turn: int) -> None:
    sliver = np.roll(np.array([[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [apex, 1.7e-3, 0.0]]]), turn, axis=1)
    cut = without_slivers(sliver, LONGEST)
    assert areas(cut).sum() == pytest.approx(areas(sliver).sum())
    assert len(cut) <= 2.0 * 10.0 / LONGEST + 4
    assert np.linalg.norm(np.roll(cut, -1, axis=1) - cut, axis=2).max() <= 1.1 * LONGEST
    assert len(split(cut, 4e-3)) < 40_000


@given(st.lists(st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9), min_size=1, max_size=4), st.floats(0.0, 1e-2))
def test_the_surface_is_the_same(values: list[list[float]], squeezed: float) -> None:
    triangles = np.array(values).reshape(-1, 3, 3) * [1.0, squeezed, 1.0]
    cut = without_slivers(triangles, LONGEST)
    assert areas(cut).sum() == pytest.approx(areas(triangles).sum(), rel=1e-6, abs=1e-9)
    low, high = triangles.min(axis=(0, 1)) - 1e-9, triangles.max(axis=(0, 1)) + 1e-9
    assert (cut >= low).all() and (cut <= high).all()


def test_what_is_only_a_little_slender_is_left_to_the_halving() -> None:
    h = 1.0 / (0.9 * SLENDER)
    assert len(without_slivers(np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, h, 0.0]]]), LONGEST)) == 1
