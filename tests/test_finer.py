"""Sampling that follows from verification: a plan off its path between samples is planned again with more of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from planner.cell.cell import build_cell
from planner.planning import pipeline
from planner.planning.context import context_of
from planner.planning.finer import with_finer_samples, worst_off
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.finer import sampled_finer

CASE = ("resolve.rung_mm=10", "resolve.roll_step_deg=30", "process.speed_mm_s=20")


def seam(folder: Path, turn_deg: float) -> Problem:
    """A line whose normal turns within a few waypoints, 2 mm apart, in its middle, and back again."""
    s = np.arange(0.0, 121.0, 2.0)
    lean = np.radians(turn_deg) * (np.tanh((s - 50.0) / 1.2) - np.tanh((s - 70.0) / 1.2))
    points = np.column_stack([0.0 * s, s - 60.0, 100.0 + 0.0 * s])
    normals = np.column_stack([np.sin(lean), 0.0 * s, np.cos(lean)])
    file = folder / "seam.txt"
    np.savetxt(file, np.hstack([points, normals]), fmt="%.6f")
    return load_problem("peer_cap", [f"layers.source.waypoints={file}", *CASE])


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return seam(tmp_path_factory.mktemp("seam"), 6.0)


@pytest.fixture(scope="module")
def toolpath(problem: Problem) -> Toolpath:
    return build_toolpath(problem)


@pytest.mark.slow
def test_a_plan_that_leaves_the_normal_between_samples_gets_more_of_them(
    problem: Problem, toolpath: Toolpath, monkeypatch: pytest.MonkeyPatch
) -> None:
    finer = solve(problem, baseline=False)
    assert finer.verified
    monkeypatch.setattr(pipeline, "with_finer_samples", lambda *_: None)
    as_drawn = solve(problem, baseline=False)
    assert [check.name for check in as_drawn.checks if not check.ok] == ["axis on the normal"]
    n = len(toolpath.beads[0].s)
    assert as_drawn.metrics["waypoints"] == n < finer.metrics["waypoints"] < 3 * n
    assert finer.metrics["axis_error_max_deg"] < 0.05


@pytest.mark.parametrize("places", [[60e-3], [49e-3, 50e-3, 51e-3, 70e-3], list(np.linspace(0.0, 0.12, 40))])
def test_the_curve_stays_where_it_is(toolpath: Toolpath, places: list[float]) -> None:
    (bead,), (finer,) = toolpath.beads, sampled_finer(toolpath, {0: np.array(places)}).beads
    assert len(finer.s) > len(bead.s)
    assert (np.diff(finer.s) > 0.0).all()
    spline = make_interp_spline(bead.s, np.hstack([bead.points, bead.normals]), k=5)(finer.s)
    np.testing.assert_allclose(finer.points, spline[:, :3], rtol=0, atol=1e-7)
    np.testing.assert_allclose(finer.normals, spline[:, 3:], rtol=0, atol=2e-3)
    np.testing.assert_array_equal(finer.points[[0, -1]], bead.points[[0, -1]])
    np.testing.assert_allclose(np.linalg.norm(finer.roll_zero, axis=1), 1.0)
    np.testing.assert_allclose((finer.roll_zero * finer.normals).sum(axis=1), 0.0, atol=1e-12)
    steps = np.diff(finer.s)
    assert (np.abs(np.diff(np.log(steps))) < 0.3).all(), "they draw together gradually"
    was, now = (np.interp(places, each.s, np.gradient(each.s)) for each in (bead, finer))
    assert (now < 0.65 * was).all()


def test_other_beads_stay_as_they_are(toolpath: Toolpath) -> None:
    twice = replace(toolpath, beads=toolpath.beads * 2)
    finer = sampled_finer(twice, {0: np.array([0.06])})
    assert finer.beads[1] is twice.beads[1]
    assert len(finer.beads[0].s) > len(twice.beads[0].s)


@pytest.mark.slow
def test_what_more_samples_do_not_help_stays(problem: Problem, toolpath: Toolpath) -> None:
    """A plan that is verified, and one that fails by something else as well."""
    given = context_of(problem, build_cell(problem), toolpath)
    plan = solve(problem, baseline=False)
    report = pipeline.verify(problem, given.cell, plan.toolpath, plan.trajectory)
    assert with_finer_samples(given, plan.trajectory, report) is None
    off = {"axis on the normal", "joint range"}
    failed = tuple(replace(check, ok=check.name not in off) for check in report.checks)
    assert with_finer_samples(given, plan.trajectory, replace(report, checks=failed)) is None


@pytest.mark.slow
def test_more_samples_are_tried_while_they_help(
    problem: Problem, toolpath: Toolpath, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = context_of(problem, build_cell(problem), toolpath)
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "with_finer_samples", lambda *_: None)
        plan = solve(problem, baseline=False)
    report = pipeline.verify(problem, given.cell, toolpath, plan.trajectory)
    off = worst_off(plan.trajectory, report)
    assert len(off) == 1 and 1.0 < off[0] < 2.0
    finer = with_finer_samples(given, plan.trajectory, report)
    assert finer is not None
    assert finer.toolpath.notes[-1].startswith("1 of 1 beads sampled more finely")
    assert with_finer_samples(given, plan.trajectory, report, before=1.1 * off) is None
    assert with_finer_samples(given, plan.trajectory, report, before=np.array([1.1 * off[0], 1.1])) is not None
    far = replace(report, series=report.series | {"off_the_path": 600.0 * report.series["off_the_path"]})
    assert with_finer_samples(given, plan.trajectory, far) is None


@pytest.mark.slow
def test_the_rest_of_a_print_keeps_the_samples_of_the_whole(problem: Problem, tmp_path: Path) -> None:
    text = problem.layers.source.waypoints.read_text(encoding="utf-8")
    rows = np.loadtxt(text.splitlines())
    straight = np.column_stack([rows[:, :3] + [30.0, 0.0, 0.0], np.tile([0.0, 0.0, 1.0], (len(rows), 1))])
    np.savetxt(tmp_path / "two.txt", np.vstack([rows, straight]), fmt="%.6f")
    both = load_problem("peer_cap", [f"layers.source.waypoints={tmp_path / 'two.txt'}", *CASE])
    for strategy in ("sqp", "ladder"):
        whole, rest = (solve(both, strategy, baseline=False, first_bead=k) for k in (0, 1))
        assert len(whole.toolpath.beads[0].s) > len(build_toolpath(both).beads[0].s)
        np.testing.assert_array_equal(rest.toolpath.beads[0].s, whole.toolpath.beads[0].s)
        np.testing.assert_array_equal(rest.paths[0].q, whole.paths[1].q)
