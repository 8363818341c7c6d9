"""How deep the nozzle presses into beads: the verifier's own model against coal, by hand, and on plans that go wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from solved import small_plan

from benchmarks.clearance import pressed_by_coal
from planner.base.arrays import Array
from planner.cell.bodies import nozzle_profile
from planner.plan import TRAVEL
from planner.problem import load_problem
from planner.verify.checks import Judged
from planner.verify.pressed import LIMIT, deepest, outline_distance, pressed
from planner.verify.verdict import verify

WIDTH, HEIGHT = 1.0e-3, 0.5e-3
STEP = 0.1e-3


def bead_along(x: float, z: float, lean: float = 0.0, count: int = 60) -> tuple[Array, Array]:
    """Tips and axes (n, 3) of a straight bead along y, the nozzle leaning towards +x."""
    y = STEP * np.arange(count)
    axis = np.array([-np.sin(lean), 0.0, -np.cos(lean)])
    return np.column_stack([np.full(count, x), y, np.full(count, z)]), np.tile(axis, (count, 1))


def judged_of(*beads: tuple[Array, Array], heights: Sequence[Array | float] | None = None) -> Judged:
    """What `deepest` looks at, of beads that are laid one after the other; heights of each [m]."""
    tip, axis = (np.concatenate([each[k] for each in beads]) for k in (0, 1))
    number = np.repeat(np.arange(len(beads), dtype=np.int32), [len(each[0]) for each in beads])
    number.setflags(write=False)  # as a trajectory's, and the axis part of the rotation: compiled once
    s = np.concatenate([STEP * np.arange(len(each[0])) for each in beads])
    side = np.cross([0.0, 1.0, 0.0], axis)
    rotation = np.stack([side, np.cross(axis, side), axis], axis=-1)
    toolpath = SimpleNamespace(
        beads=[
            SimpleNamespace(
                s=STEP * np.arange(len(each)), length=STEP * (len(each) - 1), points=each,
                normals=np.tile([0.0, 0.0, 1.0], (len(each), 1)),
                width=np.full(len(each), WIDTH), height=np.broadcast_to(height, len(each)).astype(float),
            )
            for (each, _), height in zip(beads, heights or [HEIGHT] * len(beads), strict=True)
        ]
    )  # fmt: skip
    t = SimpleNamespace(
        deposit=np.ones(len(tip), dtype=bool), bead=number, s=s, first_bead=0, t=0.01 * np.arange(len(tip))
    )
    motion = SimpleNamespace(tip=tip, axis=rotation[:, :, 2], rotation=rotation)
    cell = SimpleNamespace(nozzle_name="")
    made: Any = SimpleNamespace(
        problem=load_problem("peer_cap"), trajectory=t, motion=motion, toolpath=toolpath, cell=cell, body=None,
        stretches=((cell, slice(0, len(tip))),),
    )  # fmt: skip
    return made  # type: ignore[no-any-return]


def test_a_bead_beside_another_touches_and_presses_nothing() -> None:
    assert deepest(judged_of(bead_along(0.0, HEIGHT), bead_along(0.8e-3, HEIGHT))).depth == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("lower", [0.05e-3, 0.2e-3])
def test_a_nozzle_that_runs_lower_presses_by_as_much(lower: float) -> None:
    found = deepest(judged_of(bead_along(0.0, HEIGHT), bead_along(0.6e-3, HEIGHT - lower)))
    assert found.depth == pytest.approx(lower, abs=0.016 * HEIGHT)
    assert (found.bead, found.at >= 60) == (0, True)


def test_the_share_of_a_bead_s_height_counts_not_the_depth() -> None:
    """0.2 mm into a bead that is 1 mm high are less than 0.15 mm into one of 0.2 mm beside it."""
    high, low = bead_along(0.0, 1.0e-3), bead_along(10e-3, 0.2e-3)
    over = bead_along(0.4e-3, 0.8e-3), bead_along(10.4e-3, 0.05e-3)
    judged = judged_of(high, low, *over, heights=(1.0e-3, 0.2e-3, 0.5e-3, 0.5e-3))
    found, (check,) = deepest(judged), pressed(judged).checks
    assert (found.bead, found.share) == (1, pytest.approx(0.75, abs=0.05))
    assert found.depth == pytest.approx(0.15e-3, abs=0.01e-3)
    assert found.greatest == pytest.approx(0.2e-3, abs=0.02e-3)
    assert pressed(judged).metrics["nozzle_pressed_max_mm"] == found.greatest * 1e3
    assert not check.ok and "bead 1" in check.where


def test_a_bead_that_thins_is_judged_where_it_is_pressed() -> None:
    """0.1 mm into its 0.5 mm, though its end is but 0.1 mm high."""
    thins = np.append(np.full(50, HEIGHT), np.linspace(HEIGHT, 0.1e-3, 50))
    judged = judged_of(
        bead_along(0.0, HEIGHT, count=100), bead_along(0.6e-3, HEIGHT - 0.1e-3, count=30), heights=(thins, HEIGHT)
    )
    (check,) = pressed(judged).checks
    assert check.ok and check.worst == pytest.approx(0.2, abs=0.02)


def test_its_own_bead_and_what_comes_later_do_not_count() -> None:
    assert deepest(judged_of(bead_along(0.0, HEIGHT, lean=0.3))).at == -1
    assert deepest(judged_of(bead_along(0.6e-3, HEIGHT - 0.2e-3), bead_along(0.0, HEIGHT))).depth < 1e-9


def test_a_bead_that_comes_back_over_its_own_beginning_is_pressed() -> None:
    tip, axis = bead_along(0.0, HEIGHT)
    there, back = (tip, axis), (tip[::-1] + [0.5e-3, 0.0, -0.2e-3], axis)
    judged = judged_of((np.concatenate([there[0], back[0]]), np.concatenate([there[1], back[1]])))
    assert deepest(judged).depth == pytest.approx(0.2e-3, abs=0.016 * HEIGHT)


@pytest.mark.slow
@settings(
    max_examples=6, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate]
)  # shrinking takes minutes
@given(
    x=st.floats(-1.2e-3, 1.2e-3), lower=st.floats(0.0, 0.3e-3), lean=st.floats(-0.5, 0.5), turn=st.floats(0.0, np.pi)
)  # fmt: skip
def test_depths_are_those_of_coal(x: float, lower: float, lean: float, turn: float) -> None:
    tip, axis = bead_along(x, HEIGHT - lower, lean)
    c, s = np.cos(turn), np.sin(turn)
    R, middle = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([0.0, 3e-3, 0.0])
    judged = judged_of(bead_along(0.0, HEIGHT), ((tip - middle) @ R.T + middle, axis @ R.T))
    found = deepest(judged).depth
    looks = sorted({*range(62, 120, 12), max(deepest(judged).at, 60)})
    assert found == pytest.approx(
        pressed_by_coal(judged, looks), abs=0.06 * HEIGHT
    )  # between balls, and from look to look


@settings(max_examples=60, deadline=None)
@given(r=st.floats(0.0, 8e-3), z=st.floats(-3e-3, 12e-3))
def test_distance_from_an_outline_is_that_of_its_points(r: float, z: float) -> None:
    profile = np.array([[0.0, 0.5e-3], [3e-3, 2e-3], [3e-3, 4e-3], [6e-3, 1e-3]])  # not convex
    corners = np.concatenate([[[0.0, 0.0]], profile, [[30e-3, 1e-3]]])
    along = np.linspace(0.0, 1.0, 2001)[:, None]
    points = np.concatenate([a + along * (b - a) for a, b in zip(corners[:-1], corners[1:], strict=True)])
    away = np.hypot(points[:, 0] - z, points[:, 1] - r).min()
    radius = np.interp(z, profile[:, 0], profile[:, 1]) if z < 3e-3 else np.interp(z, [3e-3, 6e-3], [4e-3, 1e-3])
    inside = z > 0.0 and r < radius
    assert abs(outline_distance(profile, r, z)) == pytest.approx(away, abs=2e-5)
    if away > 1e-5:
        assert (outline_distance(profile, r, z) < 0.0) == inside


def test_a_plan_whose_nozzle_dips_into_its_print_fails() -> None:
    """Beads in the wrong order: what is laid last lies 0.6 mm lower, where something is already."""
    plan = small_plan()
    t, bead = plan.trajectory, plan.toolpath.beads[0]
    higher = replace(bead, points=bead.points + 0.6e-3 * bead.normals, height=2.0 * bead.height)
    toolpath = replace(plan.toolpath, beads=(higher, *plan.toolpath.beads))
    later = replace(t, bead=np.where(t.bead == TRAVEL, TRAVEL, t.bead + 1), first_bead=1)
    report = verify(plan.problem, plan.cell, toolpath, later)
    check = next(check for check in report.checks if check.name == "print pressed by the nozzle")
    assert not check.ok
    assert check.worst == pytest.approx(0.6, abs=0.02)
    assert check.limit == LIMIT
    assert "bead 0" in check.where
    assert report.metrics["nozzle_pressed_max_mm"] == pytest.approx(0.6, abs=0.02)


def test_a_plan_that_keeps_its_order_presses_nothing() -> None:
    plan = small_plan()
    check = next(check for check in plan.checks if check.name == "print pressed by the nozzle")
    assert check.ok
    assert check.worst < 0.02
    assert nozzle_profile(plan.problem.cell.nozzle)[0][1] > 0.0
    assert pressed(judged_of(bead_along(0.0, HEIGHT))).metrics["nozzle_pressed_max_mm"] == 0.0
