"""A print that is resumed at one of its beads: the same paths, an approach clear of what stands, and all that is said."""

from __future__ import annotations

import json
import re
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_page import points
from scipy.interpolate import CubicSpline
from solved import write_small

import planner.planning.pipeline
from planner.base.errors import EXIT_INPUT, InputError
from planner.base.rapid_names import LONGEST_NAME
from planner.collision.print_body import print_body, standing
from planner.collision.scene import NOTHING, obstacles_of
from planner.export.plan_json import plan_json
from planner.export.rapid.text import module_name
from planner.motion.timing.timed_path import time_path
from planner.motion.trajectory import join
from planner.motion.travel.plan import plan_travels
from planner.plan import Plan, Trajectory
from planner.planning.files import write
from planner.planning.pipeline import solve
from planner.planning.short_runs import dips_in_a_run
from planner.planning.solve_command import main
from planner.problem import Problem, load_problem
from planner.report.scene import plan_scene
from planner.report.summary import print_summary
from planner.resolve.joint_path import JointPath
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of
from planner.verify.verdict import Report, verify

TWO_LAYERS = ("  count: 1\n", "  count: 2\n")
PROCESS = (
    "  travel_speed_mm_s: 200\n",
    """\
  travel_speed_mm_s: 200
  retract: {length_mm: 1}
  start: {heat_wait_s: 2, nozzle_c: 200, purge_mm: 10}
  materials:
    pla: {prime: {length_mm: 2}}
    pva: {tool: 4}
  change: {wait_s: 1, purge_mm: 5}
""",
)
ORDER = ("pla", "pla", "pla", "pla", "pva", "pla")  # of the beads: the first one that is laid anew needs the other tool
FIRST = 4
BEADS = 6


@cache
def layered() -> tuple[Problem, Toolpath]:
    """Three paths in two layers, of two materials."""
    with tempfile.TemporaryDirectory() as folder:
        problem = load_problem(write_small(Path(folder), TWO_LAYERS, PROCESS))
        toolpath = build_toolpath(problem)
    beads = zip(toolpath.beads, ORDER, strict=True)
    return problem, replace(toolpath, beads=tuple(replace(bead, material=material) for bead, material in beads))


def _solved(first_bead: int) -> Plan:
    problem, toolpath = layered()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner.planning.pipeline, "build_toolpath", lambda problem: toolpath)
        return solve(problem, first_bead=first_bead)


@cache
def whole() -> Plan:
    """The print from its first bead on."""
    return _solved(0)


@cache
def resumed() -> Plan:
    """The same print, resumed in the middle of its second layer."""
    return _solved(FIRST)


def failed(plan: Plan, trajectory: Trajectory) -> set[str]:
    """Names of the checks that fail."""
    checks = verify(plan.problem, plan.cell, plan.toolpath, trajectory).checks
    return {check.name for check in checks if not check.ok}


@pytest.mark.slow
def test_the_rest_is_verified_and_keeps_the_numbers_of_its_beads() -> None:
    plan = resumed()
    assert whole().verified and plan.verified
    assert plan.first_bead == FIRST and len(plan.beads) == BEADS - FIRST and plan.layers == 1
    assert np.unique(plan.trajectory.bead).tolist() == [-1, *range(FIRST, BEADS)]
    assert {event.bead for event in plan.trajectory.events} == {-1, *range(FIRST, BEADS)}
    assert {dip.bead for dip in plan.dips} <= set(range(FIRST, BEADS))


@pytest.mark.slow
def test_joints_pass_the_same_postures_as_in_the_whole_print() -> None:
    before, after = whole().trajectory, resumed().trajectory
    for bead in range(FIRST, BEADS):
        a, b = (np.flatnonzero(each.bead == bead) for each in (before, after))
        there = slice(3, -3)  # a spline's ends are its worst places
        expected = CubicSpline(before.s[a], before.q[a])(after.s[b])
        np.testing.assert_allclose(after.q[b][there], expected[there], atol=np.radians(1e-3))
        assert abs(len(a) - len(b)) <= 1


@pytest.mark.slow
def test_metrics_are_of_what_is_printed_now() -> None:
    plan, all_of_it = resumed(), whole()
    lengths = np.array([bead.length for bead in plan.toolpath.beads])
    assert plan.metrics["beads"] == 2 and plan.metrics["layers"] == 1 and all_of_it.metrics["layers"] == 2
    assert plan.metrics["deposited_length_mm"] == pytest.approx(1e3 * lengths[FIRST:].sum())
    assert plan.metrics["ideal_deposition_time_s"] == pytest.approx(lengths[FIRST:].sum() / plan.problem.process.speed)
    share = lengths[FIRST:].sum() / lengths.sum()
    assert plan.metrics["extruded_volume_mm3"] == pytest.approx(share * all_of_it.metrics["extruded_volume_mm3"])
    assert plan.metrics["bound_deposition_time_s"] < 0.6 * all_of_it.metrics["bound_deposition_time_s"]
    assert plan.baseline["as_published"]["beads"] == 2


@pytest.mark.slow
def test_the_extruder_starts_anew_with_the_tool_of_the_first_bead() -> None:
    events = resumed().trajectory.events
    assert [(event.kind, event.bead, event.material) for event in events[:4]] == [
        ("heat", -1, "pva"),
        ("select", -1, "pva"),
        ("purge", -1, "pva"),
        ("retract", FIRST, "pva"),
    ]
    assert resumed().trajectory.extruded[0] == resumed().trajectory.feed[0] == 0.0


@pytest.mark.slow
def test_the_approach_is_clear_of_what_stands() -> None:
    """A bead that stands in the way of an approach is found there, if it is printed before; a new approach avoids it."""
    plan = resumed()
    problem, cell, t = plan.problem, plan.cell, plan.trajectory
    toolpath = _with_bead_across(plan, 20e-3)
    crossed = replace(plan, toolpath=toolpath)
    assert "nozzle clear of part and print" in failed(crossed, t)
    need = 1e3 * problem.collision.nozzle
    assert _least_in_approach(crossed, t) < need
    assert (
        _least_in_approach(crossed, replace(t, first_bead=0)) > need
    )  # of a whole print nothing stands there so early

    obstacles = obstacles_of(problem, cell, toolpath, print_body(toolpath, standing(cell)))
    paths = STRATEGIES["ladder"](cell, tasks_of(problem, plan.toolpath), problem.resolve, NOTHING)
    timed = [time_path(cell, path) for path in paths[FIRST:]]
    travels = plan_travels(cell, timed, toolpath, problem.process, None, obstacles)
    assert _least_in_approach(crossed, join(cell, toolpath, problem.process, timed, travels, t.dt)) >= need


def _least_in_approach(plan: Plan, trajectory: Trajectory) -> float:
    """Least clearance on the way to the first bead [mm]."""
    series = verify(plan.problem, plan.cell, plan.toolpath, trajectory).series
    return float(series["clearance_mm"][: int(np.flatnonzero(trajectory.deposit)[0])].min())


def _with_bead_across(plan: Plan, height: float) -> Toolpath:
    """The toolpath, its first bead across the way to the first bead that is laid: through the nozzle, 15 mm behind
    its tip, where that is so high over the part."""
    t, toolpath = plan.trajectory, plan.toolpath
    way = t.tip[: int(np.flatnonzero(t.deposit)[0])]
    i = int(np.flatnonzero(toolpath.surface.signed_distance(way) > height)[-1])
    normal = toolpath.surface.normals(way[i : i + 1])[0]
    across = np.cross(way[i + 1] - way[i], normal)
    s = np.linspace(0.0, 20e-3, 101)
    points = way[i] - 15e-3 * t.axis[i] + (s - 10e-3)[:, None] * across / np.linalg.norm(across)
    alike = np.ones(len(s))
    bead = replace(
        toolpath.beads[0], s=s, points=points, source=points, normals=alike[:, None] * normal,
        roll_zero=alike[:, None] * across, width=0.6e-3 * alike, height=0.5e-3 * alike,
    )  # fmt: skip
    return replace(toolpath, beads=(bead, *toolpath.beads[1:]))


@pytest.mark.slow
@pytest.mark.parametrize("first_bead", [0, FIRST - 1, FIRST + 1])
def test_a_motion_that_begins_with_another_bead_is_found(first_bead: int) -> None:
    found = failed(resumed(), replace(resumed().trajectory, first_bead=first_bead))
    assert ("every bead complete" if first_bead < FIRST else "beads of the toolpath") in found


@pytest.mark.slow
def test_missing_rest_for_a_change_is_found_and_none_is_asked_for_before_the_first_bead() -> None:
    t = resumed().trajectory
    assert [event.bead for event in t.events if event.kind == "change"] == [BEADS - 1]
    events = tuple(event for event in t.events if event.kind != "change")
    assert "rest for a change of material" in failed(resumed(), replace(t, events=events))


@pytest.mark.slow
def test_programs_say_where_they_begin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = write(resumed(), tmp_path)
    rapid = (tmp_path / "SmallFrom4.mod").read_text()
    assert re.findall(r"PROC (\w+)\(\)", rapid) == ["main", "Start", "Bead0005", "Bead0006", "Finish"]
    assert re.findall(r"! (Bead \d+), layer 1", rapid) == ["Bead 4", "Bead 5"]
    assert "Resumes at bead 4" in rapid and "2 beads in 1 layers" in rapid
    assert "SmallFrom4.mod" in (tmp_path / "SmallFrom4.pgf").read_text()
    assert (tmp_path / "extrusion.gcode").read_text().startswith("; small_from_4: ")
    assert json.loads(plan_json(plan))["first_bead"] == 4 and json.loads(plan_json(whole()))["first_bead"] == 0
    words = "resumed at bead 4 of 6, beads 0 to 3 assumed to be printed"
    assert words in (tmp_path / "report.html").read_text()
    print_summary(plan, tmp_path)
    assert words in " ".join(capsys.readouterr().out.split())


def test_the_report_draws_beads_that_stand_already() -> None:
    drawn, before = plan_scene(resumed(), []), plan_scene(whole(), [])
    assert before["still"] == [] and len(drawn["still"]) == 1
    lines = drawn["still"][0]
    starts = np.array([bead.points[0] for bead in resumed().toolpath.beads[:FIRST]])
    np.testing.assert_allclose(points(lines)[lines["first"]], starts, atol=2e-6)
    assert drawn["lines"]["bead"].tolist() == list(range(FIRST, BEADS))


def test_names_that_are_cut_keep_the_number() -> None:
    name = module_name("a_very_long_name_of_a_problem_that_goes_on_from_12")
    assert len(name) == LONGEST_NAME and name.endswith("From12") and name.startswith("AVeryLong")
    assert module_name("from_5") == "From5"


@pytest.mark.slow
def test_a_rest_with_beads_that_may_be_cut_is_searched_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[str] = []

    def ladder(*given: Any) -> tuple[JointPath, ...]:
        searched.append("ladder")
        return STRATEGIES["ladder"](*given)

    monkeypatch.setitem(STRATEGIES, "counted", ladder)
    problem = load_problem(write_small(tmp_path), ["process.split_beads=true"])
    rest = solve(problem, "counted", first_bead=1, baseline=False)
    assert rest.verified and rest.first_bead == 1
    assert searched == ["ladder"]


@pytest.mark.slow
@pytest.mark.parametrize("pieces", ["false", "true"])
def test_what_is_asked_of_a_plan_is_asked_of_the_whole_print(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pieces: str
) -> None:
    """Runs that dip, or clearance that lacks, in a bead before the rest: the rest follows what was decided by that."""
    begun: list[int] = []

    def looked(trajectory: Trajectory, report: Report) -> str:
        begun.append(trajectory.first_bead)
        return dips_in_a_run(trajectory, report)

    monkeypatch.setattr(planner.planning.pipeline, "dips_in_a_run", looked)
    problem = load_problem(write_small(tmp_path), [f"process.split_beads={pieces}"])
    rest = solve(problem, "ladder", first_bead=1, baseline=False)
    assert (rest.first_bead, begun) == (1, [0])


@pytest.mark.slow
def test_the_baseline_of_a_rest_that_may_be_in_pieces_is_of_that_rest(tmp_path: Path) -> None:
    plan = solve(load_problem(write_small(tmp_path), ["process.split_beads=true"]), "ladder", first_bead=1)
    (metrics,) = plan.baseline.values()
    assert metrics["deposited_length_mm"] == pytest.approx(plan.metrics["deposited_length_mm"])


@pytest.mark.parametrize("first_bead", [BEADS, -1])
def test_a_bead_that_is_not_there_is_refused_with_the_range(first_bead: int) -> None:
    with pytest.raises(InputError, match=rf"no bead {first_bead} to begin with \(a number from 0 to 5\)"):
        _solved(first_bead)


@pytest.mark.slow
def test_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_small(tmp_path)
    assert main([str(path), "--quiet", "--from-bead", "2"]) == 0
    assert {"SmallFrom2.mod", "plan.json"} <= {file.name for file in (tmp_path / "out" / "small_from_2").iterdir()}
    assert main([str(path), "--quiet", "--from-bead", "3"]) == EXIT_INPUT
    assert "from 0 to 2" in capsys.readouterr().err
    assert not (tmp_path / "out" / "small_from_3").exists()
