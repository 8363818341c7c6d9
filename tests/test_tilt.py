"""A nozzle that leans within its cone: how far, and what that does to the bead, from what the joints really do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_page import figures
from solved import small_plan, solve_alone, write_small

from planner.base.arrays import Array
from planner.plan import Plan
from planner.problem import load_problem
from planner.report.html import write_report
from planner.report.summary import print_summary
from planner.verify.checks import bead_errors
from planner.verify.executed import executed_motion
from planner.verify.verdict import verify

CONE_DEG = 5.0
CENTRE, WIDTH = np.array([31.4e-3, 37e-3]), 0.6e-3  # of the small problem's cylinder, and its beads


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """The small print, its nozzle allowed to lean, and so fast that it must."""
    path = write_small(tmp_path_factory.mktemp("tilt"), ("strategy: ladder", "strategy: sqp"))
    return solve_alone(load_problem(path, [f"process.cones.nozzle_normal_deg={CONE_DEG}", "process.speed_mm_s=80"]))


def normals_of_the_cylinder(tips: Array) -> Array:
    away = tips[:, :2] - CENTRE
    return np.column_stack([away / np.linalg.norm(away, axis=1)[:, None], np.zeros(len(tips))])


@pytest.mark.slow
def test_the_lean_is_that_of_the_joints_against_the_cylinder(plan: Plan) -> None:
    motion = executed_motion(plan.cell, plan.trajectory)
    at = plan.trajectory.deposit
    normals = normals_of_the_cylinder(motion.tip[at])
    lean = np.arccos(np.clip(-(normals * motion.axis[at]).sum(axis=1), -1.0, 1.0))
    assert np.degrees(lean.max()) > 0.9 * CONE_DEG, "it is used"
    np.testing.assert_allclose(plan.series["tilt_deg"][at], np.degrees(lean), atol=1e-3)
    assert not plan.series["tilt_deg"][~at].any()
    assert plan.metrics["tilt_max_deg"] == pytest.approx(np.degrees(lean.max()), abs=1e-4)
    assert plan.metrics["tilt_max_deg"] <= CONE_DEG + 0.05
    expected = 0.5 * WIDTH * np.sin(lean.max()) * 1e3
    assert plan.metrics["tilt_bead_error_max_mm"] == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_a_beads_edge_is_as_far_off_as_the_nozzles_face_is(plan: Plan) -> None:
    # Here the face's rim is looked at point by point: how high it stands above the plane through the tip.
    motion, t = executed_motion(plan.cell, plan.trajectory), plan.trajectory
    rows = np.flatnonzero(t.deposit)[::7]
    normals = normals_of_the_cylinder(motion.tip[rows])
    around = np.linspace(0.0, 2.0 * np.pi, 721)
    rim = np.column_stack([np.cos(around), np.sin(around), np.zeros_like(around)])
    heights = np.einsum("nij,kj,ni->nk", motion.rotation[rows], 0.5 * WIDTH * rim, normals)
    found = bead_errors(plan.toolpath, t, np.radians(plan.series["tilt_deg"]))[rows]
    np.testing.assert_allclose(found, heights.max(axis=1), rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(found, -heights.min(axis=1), rtol=1e-3, atol=1e-8)


@pytest.mark.slow
def test_a_wider_bead_is_farther_off_where_it_is_wide(plan: Plan) -> None:
    beads = tuple(replace(bead, width=WIDTH * (1.0 + bead.s / bead.length)) for bead in plan.toolpath.beads)
    found = verify(plan.problem, plan.cell, replace(plan.toolpath, beads=beads), plan.trajectory)
    t = plan.trajectory
    share = np.array([s / beads[b].length if b >= 0 else 0.0 for s, b in zip(t.s, t.bead, strict=True)])
    expected = 0.5e3 * WIDTH * (1.0 + share) * np.sin(np.radians(plan.series["tilt_deg"]))
    assert found.metrics["tilt_bead_error_max_mm"] == pytest.approx(expected.max(), rel=1e-6)
    assert found.metrics["tilt_bead_error_max_mm"] > 1.2 * plan.metrics["tilt_bead_error_max_mm"]


def test_it_is_told_where_the_nozzle_may_lean_and_nowhere_else(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "140")
    upright = small_plan()
    assert not {"tilt_max_deg", "tilt_bead_error_max_mm"} & upright.metrics.keys()
    for each, told in ((plan, True), (upright, False)):
        print_summary(replace(each, timing_s={"total": 1.0}), tmp_path)
        out = capsys.readouterr().out
        assert ("lean of the nozzle" in out) is told
        assert ("edges off their height" in out) is told
        write_report(each, tmp_path / "report.html")
        page = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert ("lean of the nozzle" in page) is told
        assert ("edges off their height" in page) is told
        assert ("Lean of the nozzle</h3>" in page) is told
        labels = {channel["label"] for channel in figures(tmp_path / "report.html")["scene"]["lines"]["channels"]}
        assert ("Nozzle off the surface normal" in labels) is told
