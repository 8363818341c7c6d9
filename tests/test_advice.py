"""What would help most: changes within bounds, tried, and what comes of them once they are applied."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from solved import small_plan, small_problem, write_small

from benchmarks.advice import WITHIN, applied
from planner.motion.timing.timed_path import time_path
from planner.plan import Plan
from planner.planning.advice import LEAST, SpeedTotals, below_speed, changes, laid, promises, recorded, worst_beads
from planner.planning.pipeline import solve
from planner.report.places import SLOWEST_ADVISED, followable
from planner.toolpath.task import Stop


@cache
def advised_file() -> Path:
    return write_small(Path(mkdtemp()), ("strategy: ladder\n", "strategy: sqp\n"))


@cache
def advised() -> Plan:
    return solve(advised_file())


def test_changes_keep_within_bounds_and_are_worse_in_nothing_else() -> None:
    problem = small_problem()
    found = {each.kind: each for each in changes(problem)}
    assert list(found) == ["corner_tolerance", "lean", "speed"]
    assert found["corner_tolerance"].value == pytest.approx(0.3)  # half of the bead's 0.6 mm
    assert found["corner_tolerance"].problem.process.corner_tolerance == pytest.approx(0.3e-3)
    assert found["lean"].problem.process.cones.tilt == pytest.approx(np.radians(5.0))
    assert found["speed"].problem.process.speed == pytest.approx(0.03)
    assert problem.process.speed == pytest.approx(0.04)


def test_what_is_wider_already_is_not_advised() -> None:
    problem = small_problem()
    cones = problem.process.cones.model_copy(update={"tilt": np.radians(8.0)})
    wide = problem.process.model_copy(update={"corner_tolerance": 0.4e-3, "cones": cones})
    assert [each.kind for each in changes(problem.model_copy(update={"process": wide}))] == ["speed"]


def test_beads_with_most_slow_length_come_first_as_far_as_they_are_cheap() -> None:
    path = small_plan().paths[0]
    sizes = (300, 5 * LEAST, 90, 200)
    paths = [replace(path, q=np.zeros((n, 7))) for n in sizes]
    assert worst_beads(paths, {0: 0.01, 1: 0.05, 2: 0.02, 3: 0.03}) == [2, 3]
    assert worst_beads(paths, {0: 0.0}) == []


def test_what_does_nothing_for_some_slow_beads_is_not_tried_on_all() -> None:
    whole, now = SpeedTotals(9.5, 10.0, 300.0), SpeedTotals(0.6, 1.0, 40.0)
    few = SpeedTotals(0.15, 0.25, 10.0)
    for at_speed, worth in ((0.15, False), (0.152, False), (0.153, True), (0.25, True), (0.1, False)):
        assert promises(few, SpeedTotals(at_speed, 0.25, 10.0), now, whole) is worth, at_speed


def test_lengths_below_speed_are_those_of_each_bead() -> None:
    plan = small_plan()
    each = [recorded(plan.trajectory, plan.commanded, [bead]).slow for bead in range(len(plan.beads))]
    np.testing.assert_allclose(below_speed(plan.trajectory, plan.commanded), each, rtol=0, atol=1e-12)
    assert max(each) > 0.0


def test_length_and_time_are_those_of_the_print() -> None:
    plan = small_plan()
    whole = recorded(plan.trajectory, plan.commanded, range(len(plan.beads)))
    assert whole.length == pytest.approx(plan.metrics["deposited_length_mm"] * 1e-3, rel=0.01)
    assert whole.time == pytest.approx(plan.metrics["deposition_time_s"], rel=0.01)
    assert whole.share == pytest.approx(plan.metrics["at_speed_fraction"], abs=0.03)


def test_a_rest_at_a_cut_is_no_time_that_a_bead_takes() -> None:
    plan = small_plan()
    path = plan.paths[0]
    task = replace(path.task, stops=(Stop(0.5 * plan.beads[0].length, 1.0, "cut"),))
    timed = time_path(plan.cell, replace(path, task=task))
    dt = plan.trajectory.dt
    s = timed.at(np.arange(0.0, timed.duration, dt))[1]
    inside = (s >= 0.0) & (s <= plan.beads[0].length)
    trajectory: Any = SimpleNamespace(
        dt=dt, deposit=inside, bead=np.where(inside, 0, -1), speed=np.diff(s, prepend=s[0]) / dt
    )
    found, meant = recorded(trajectory, plan.commanded, [0]), laid(timed)
    assert found.time == pytest.approx(meant.time, abs=0.05)
    assert found.length == pytest.approx(meant.length, rel=0.01)


@pytest.mark.slow
def test_advice_does_what_it_says() -> None:
    rows = applied(str(advised_file()), ())
    assert rows
    for row in rows:
        assert row.verified
        assert row.share == pytest.approx(row.advice.share, rel=WITHIN), row.advice.words
        assert row.time == pytest.approx(row.advice.time, rel=WITHIN), row.advice.words


@pytest.mark.slow
def test_advice_raises_the_share_at_speed_and_is_told() -> None:
    plan = advised()
    assert plan.advice
    for each in plan.advice:
        assert each.whole > each.whole_now
        assert f"{each.field}: {each.value:g}" in each.words
        assert set(each.beads) <= set(range(len(plan.beads)))
        assert 0.0 < each.covered <= 1.0


def test_no_speed_below_half_of_the_commanded_is_shown() -> None:
    plan = small_plan()
    speed = plan.problem.process.speed
    shown = [each for dip in plan.dips for each in followable(dip, speed) if each.kind == "speed"]
    assert all(each.changes[0][1] >= SLOWEST_ADVISED * speed * 1e3 for each in shown)
    assert len(shown) < sum(each.kind == "speed" for dip in plan.dips for each in dip.remedies)
