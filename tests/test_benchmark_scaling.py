"""Scaling, axes and profile: the fit on known data, cases that are valid, memory that is seen, functions that are named."""

from __future__ import annotations

import cProfile
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from solved import small_plan

from benchmarks import axes, profile, scaling
from benchmarks.memory import Peak, held_mb
from benchmarks.peer_cases import cap, waypoint_text
from benchmarks.repeated import repeated
from planner.cell.cell import build_cell
from planner.problem import load_problem


@pytest.mark.parametrize("power", [0.5, 1.0, 1.05, 2.0])
def test_the_exponent_of_a_power_law_is_its_power(power: float) -> None:
    sizes = [1e3, 1e4, 1e5, 1e6]
    assert scaling.exponent(sizes, [3e-4 * n**power for n in sizes]) == pytest.approx(power, abs=1e-12)


def test_the_exponent_is_the_least_squares_slope_in_logarithms() -> None:
    sizes, values = np.array([1e3, 1e4, 1e5]), np.array([1.0, 20.0, 100.0])
    x, y = np.log(sizes) - np.log(sizes).mean(), np.log(values) - np.log(values).mean()
    assert scaling.exponent(sizes.tolist(), values.tolist()) == pytest.approx(float(x @ y / (x @ x)))
    with pytest.raises(ValueError, match="two different sizes"):
        scaling.exponent([1e3, 1e3], [1.0, 2.0])


def test_every_case_of_axes_is_a_problem_with_those_axes(tmp_path: Path) -> None:
    assert {case.count for case in axes.CASES} == {1, 2, 3, 4}
    (tmp_path / "cap.txt").write_text(waypoint_text(cap(100)), encoding="utf-8")
    for case in axes.CASES:
        file = tmp_path / "cap_on_table.yaml"
        file.write_text(axes.problem_text(case), encoding="utf-8")
        problem = load_problem(file)
        cell = build_cell(problem)
        tilt = problem.process.cones.tilt
        assert case.count == 1 + len(cell.holder) + 2 * (tilt > 0.0)
        assert cell.holder.names == case.table


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="Linux tells what a process holds")
def test_memory_that_is_held_for_a_while_is_seen() -> None:
    before = held_mb(os.getpid())
    with Peak() as peak:
        held = np.ones(25_000_000)
        peak._ended.wait(0.6)
        del held
    assert before + 150.0 < peak.mb < before + 300.0
    assert held_mb(os.getpid()) < peak.mb - 100.0


def test_a_profile_names_the_function_that_takes_the_time() -> None:
    def busy() -> int:
        return sum(range(300_000))

    measured = cProfile.Profile()
    measured.enable()
    busy()
    measured.disable()
    places = [place for place, *_ in profile.dearest(measured, 3)]
    assert any("sum" in place or place.startswith("tests/test_benchmark_scaling.py:") for place in places)
    assert all(str(profile.ROOT) not in place for place in places)


def test_what_stands_in_for_threads_gives_what_they_give() -> None:
    with profile.InLine(2) as pool:
        assert pool.map(lambda a, b: a + b, [1, 2], [10, 20]) == [11, 22]
        assert pool.submit(pow, 2, 5).result() == 32


def test_a_repeated_print_counts_on() -> None:
    plan = small_plan()
    longer = repeated(plan, 3)
    n, beads = len(plan.t), len(plan.beads)
    assert (longer.layers, len(longer.beads), len(longer.t)) == (3 * plan.layers, 3 * beads, 3 * n)
    assert longer.bead.max() == 3 * beads - 1 and longer.trajectory.layer.max() == 3 * plan.layers - 1
    assert longer.trajectory.extruded[-1] == pytest.approx(3.0 * plan.trajectory.extruded[-1])
    assert [dip.bead for dip in longer.dips[-len(plan.dips) :]] == [dip.bead + 2 * beads for dip in plan.dips]
