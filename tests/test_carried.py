"""Travel carried along with a part that stands elsewhere: the same ways, between the ends that the beads have there."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_travel import check_joined, check_limits, check_smooth, still, tip_speed

import planner.planning.pipeline
from planner.cell.cell import Cell
from planner.motion.cubics import Cubics, JointState, extremes
from planner.motion.timing.profile import HEADROOM
from planner.motion.timing.timed_path import TimedPath, time_path
from planner.motion.trajectory import join
from planner.motion.travel.plan import ViaRest, between_ends, carried_travels, plan_travels, slower
from planner.plan.robustness import Displacement
from planner.planning.options import DEFAULT_DT
from planner.planning.pipeline import _elsewhere
from planner.planning.robustness import displaced, followed, middle_of
from planner.problem import Problem
from planner.problem.process import FilamentMoveSpec
from planner.toolpath.bead import Toolpath

AWAY = Displacement("", (1e-3, -1.5e-3, 1e-3), (math.radians(0.6), math.radians(-0.5), math.radians(0.6)))


def wave(rng: np.random.Generator, nj: int = 3) -> Cubics:
    """A motion of some pieces, continuous to the acceleration."""
    spells = rng.uniform(0.05, 0.3, 5)
    q, v, a = (rng.normal(size=nj) for _ in range(3))
    coefficients = np.empty((4, 5, nj))
    for k, h in enumerate(spells):
        jerk = 50.0 * rng.normal(size=nj)
        coefficients[:, k] = jerk / 6.0, a / 2.0, v, q
        q, v, a = q + h * (v + h * (a / 2.0 + h * jerk / 6.0)), v + h * (a + h * jerk / 2.0), a + h * jerk
    return Cubics(np.concatenate([[0.0], np.cumsum(spells)]), coefficients)


@given(st.integers(0, 2**32 - 1))
def test_a_motion_between_other_ends_meets_them_and_stays_smooth(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way = wave(rng)
    start, end = (JointState(*(rng.normal(size=3) for _ in range(3))) for _ in range(2))
    moved = between_ends(way, start, end)
    assert moved.duration == pytest.approx(way.duration)
    check_joined(moved, start, end)
    check_smooth(moved)


@given(st.integers(0, 2**32 - 1))
def test_between_its_own_ends_a_motion_stays_as_it_is(seed: int) -> None:
    way = wave(np.random.default_rng(seed))
    moved = between_ends(way, way.start, way.end)
    t = np.linspace(0.0, way.duration, 200)
    np.testing.assert_allclose(moved.joints(t), way.joints(t), atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(1.0, 4.0))
def test_a_slower_motion_goes_the_same_way(seed: int, times: float) -> None:
    way = wave(np.random.default_rng(seed))
    slow = slower(way, times)
    t = np.linspace(0.0, way.duration, 200)
    np.testing.assert_allclose(slow.joints(times * t), way.joints(t), atol=1e-9)
    np.testing.assert_allclose(extremes(slow).jerk, extremes(way).jerk / times**3, rtol=1e-9)


@pytest.fixture(scope="module", params=["at rest", "in motion"])
def moving(request: pytest.FixtureRequest) -> bool:
    """Whether beads and travel meet in motion."""
    return bool(request.param == "in motion")


@pytest.mark.slow
def test_travel_is_carried_between_the_displaced_beads(
    cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem, moving: bool
) -> None:
    process = drawing_problem.process
    here = [time_path(cell, piece.path, (moving, moving)) for piece in timed]
    elsewhere = displaced(cell, AWAY.matrix(middle_of(toolpath)))
    there = [time_path(elsewhere, followed(elsewhere, piece.path), (moving, moving)) for piece in timed]
    planned = plan_travels(cell, here, toolpath, process)
    carried = carried_travels(elsewhere, planned, there, toolpath, process)
    assert len(carried) == len(planned)
    lost = sum(each is None for each in carried)
    assert lost <= (2 if moving else 0), "only beads that end in motion may not be met"
    homes = [planned[0].start.q, planned[-1].end.q]
    starts = [still(homes[0]), *(piece.end for piece in there)]
    ends = [*(piece.start for piece in there), still(homes[1])]
    for i, (motion, was, start, end) in enumerate(zip(carried, planned, starts, ends, strict=True)):
        if motion is None:
            continue
        assert isinstance(motion, Cubics)
        check_joined(motion, start, end)
        check_smooth(motion)
        check_limits(elsewhere, motion, share=1.0 if moving else HEADROOM)
        assert tip_speed(elsewhere, motion) <= process.travel_speed
        assert was.duration * (1.0 - 1e-12) <= motion.duration <= 1.3 * was.duration
        if 0 < i < len(there):  # over the part it goes where it went, less what is not linear
            shares = np.linspace(0.0, 1.0, 100)
            tips = [
                where.T_part_nozzle(each.joints(shares * each.duration))[:, :3, 3]
                for where, each in ((cell, was), (elsewhere, motion))
            ]
            off = np.linalg.norm(tips[1] - tips[0], axis=1).max()
            assert off < (6e-4 if moving else 2e-4), "m"


@pytest.mark.slow(keep=1)
def test_carried_travel_leaves_the_extruder_its_time(
    cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem, moving: bool
) -> None:
    """Where the runs beside it are quicker than planned, too: it lasts longer, or has to be planned anew."""
    slow = FilamentMoveSpec(length_mm=30.0, speed_mm_s=20.0)
    process = drawing_problem.process.model_copy(update={"prime": slow, "retract": slow})
    here = [time_path(cell, piece.path, (moving, moving)) for piece in timed]
    quick = replace(cell, limits=replace(cell.limits, acceleration=2.0 * cell.limits.acceleration))
    there = [time_path(quick, piece.path, (moving, moving)) for piece in timed]
    carried = [
        plan_travels(quick, there, toolpath, process, range(i, i + 1))[0] if way is None else way
        for i, way in enumerate(
            carried_travels(quick, plan_travels(cell, here, toolpath, process), there, toolpath, process)
        )
    ]
    told = join(quick, toolpath, process, there, carried, DEFAULT_DT).events
    pauses = [
        after.start - (before.start + before.duration)
        for before, after in itertools.pairwise(told)
        if (before.kind, after.kind) == ("retract", "prime")
    ]
    assert len(pauses) == len(timed) - 1 and min(pauses) < 1e-5


def test_home_is_passed_on_the_way_where_it_was(
    cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem
) -> None:
    planned = plan_travels(cell, timed, toolpath, drawing_problem.process)
    elsewhere = displaced(cell, AWAY.matrix(middle_of(toolpath)))
    there = [time_path(elsewhere, followed(elsewhere, piece.path)) for piece in timed[:2]]
    home = planned[0].start.q
    out = Cubics(planned[-1].times, planned[-1].coefficients)
    via = ViaRest(between_ends(out, timed[0].end, still(home)), planned[0])
    carried = carried_travels(elsewhere, [planned[0], via, planned[-1]], there, toolpath, drawing_problem.process)[1]
    assert isinstance(carried, ViaRest)
    check_joined(carried.out, there[0].end, still(home))
    check_joined(carried.back, still(home), there[1].start)


@pytest.mark.parametrize("waits", [False, True])
def test_what_is_planned_anew_is_planned_at_once_and_round_what_stands_there(
    cell: Cell, toolpath: Toolpath, drawing_problem: Problem, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    asked: list[tuple[object, ...]] = []

    def anew(cell: Cell, timed: object, toolpath: object, process: object, *which: object) -> list[str]:
        asked.append((cell, *which))
        return ["anew", "anew too"]

    def rested(*given: Any) -> list[str]:
        assert given[5:] == ("obstacles", "touching")
        return [*given[4][:3], "with a rest"]

    stubs: dict[str, Any] = {
        "carried_travels": lambda *_: ["carried", None, "carried too", None],
        "plan_travels": anew,
        "obstacles_of": lambda *_: "obstacles",
        "contacts_within": lambda *_: "touching" if waits else None,
        "with_rests": rested,
        "join": lambda cell, toolpath, process, timed, travels, dt, touching: travels,
    }
    for name, stub in stubs.items():
        monkeypatch.setattr(planner.planning.pipeline, name, stub)
    body: Any = "body"
    found: Any = _elsewhere(drawing_problem, cell, toolpath, [], [], DEFAULT_DT, body)
    assert asked == [(cell, [1, 3], "obstacles")]
    assert found == ["carried", "anew", "carried too", "with a rest" if waits else "anew too"]
