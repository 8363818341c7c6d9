"""Beads that can be laid, but not run into or out of at the usual length: their runs are shortened, and that is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.cell.cell import build_cell, near_ends
from planner.planning.advice import _trial, changes
from planner.planning.context import context_of, with_way
from planner.planning.pipeline import load, solve
from planner.planning.short_runs import all_short
from planner.toolpath.build import build_toolpath
from planner.toolpath.runs import SHORTEST
from planner.toolpath.task import tasks_of

# With the nozzle upright and its tip on the flange's axis, joint 1 is the direction in which the tip lies.
CELL = """name: edge
cell:
  arm: irb2600
  nozzle: {{tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}}
  home_deg: [0, 0, 0, 0, 60, 0]
  bed_mm: [1000, 0, 300]
  limits: {{joint_1: {{range_deg: [{low:.6f}, {high:.6f}]}}}}
layers: {{source: {{waypoints: path.txt}}}}
process: {{speed_mm_s: 20, travel_speed_mm_s: 200, bead: {{width_mm: 0.8, height_mm: 0.5}}{more}}}
"""
REACH, HALF = 1000.0, 12.0  # mm: how far the line stands from the arm, and half its length


def problem_at(folder: Path, room_mm: float, more: str = "") -> Path:
    """A line across, both of whose ends joint 1 can pass by so much."""
    y = np.arange(-HALF, HALF + 0.01, 0.5)
    np.savetxt(folder / "path.txt", np.column_stack([0 * y, y, 0 * y + 0.5, 0 * y, 0 * y, 0 * y + 1.0]), fmt="%.4f")
    end = np.degrees(np.arctan2(HALF + room_mm, REACH))
    file = folder / "edge.yaml"
    file.write_text(CELL.format(low=-end, high=end, more=more))
    return file


@pytest.mark.slow
def test_runs_are_shortened_where_the_arm_ends(tmp_path: Path) -> None:
    problem = load(problem_at(tmp_path, 2.0))
    plan = solve(problem, baseline=False)
    assert plan.verified
    (note,) = [note for note in plan.toolpath.notes if "shortened" in note]
    assert note.startswith("run-ins and run-outs shortened: no posture within the joints' ranges") and "joint_1" in note
    (bead,) = plan.toolpath.beads
    assert bead.short_runs == (True, True)
    (task,) = tasks_of(problem, plan.toolpath)
    assert all(SHORTEST <= run <= 2.5 * SHORTEST for run in (-task.s[0], task.s[-1] - task.s[task.last]))
    assert plan.metrics["at_speed_fraction"] > 0.9


def test_advice_keeps_runs_as_short_as_they_are(tmp_path: Path) -> None:
    """With corners rounder, too, there is no way but with short runs."""
    problem = load(problem_at(tmp_path, 11.2))
    given = with_way(
        all_short(context_of(problem, near_ends(build_cell(problem)), build_toolpath(problem)), "no room"), Stages()
    )
    rounder = next(change for change in changes(problem) if change.kind == "corner_tolerance")
    found = _trial(given, rounder, given.start)([0])
    assert found is not None and found.length == pytest.approx(2e-3 * HALF, rel=0.01)


@pytest.mark.slow
def test_only_the_run_that_is_in_the_way_is_shortened(tmp_path: Path) -> None:
    """A wall behind the line's end, as high as the nozzle's face and as near as the nozzle is wide and clear of it."""
    file = problem_at(tmp_path, 100.0)
    wall = "fixtures: {wall: {box_mm: [40, 4, 30], centre_mm: [1000, 22.4, 300]}}"
    file.write_text(file.read_text().replace("  limits:", f"  {wall}\n  limits:"))
    plan = solve(load(file), baseline=False)
    assert plan.verified and plan.toolpath.beads[0].short_runs == (False, True)


@pytest.mark.slow
def test_with_room_enough_nothing_is_shortened(tmp_path: Path) -> None:
    plan = solve(load(problem_at(tmp_path, 5.0)), baseline=False)
    assert plan.verified and plan.toolpath.beads[0].short_runs == (False, False)
    assert not any("shortened" in note for note in plan.toolpath.notes)


@pytest.mark.parametrize(
    ("room_mm", "more"), [(1.0, ", run_in_mm: 3"), (-2.0, "")], ids=["as asked for", "the bead itself"]
)
def test_what_is_asked_for_or_would_not_help_stays(tmp_path: Path, room_mm: float, more: str) -> None:
    problem = load(problem_at(tmp_path, room_mm, more))
    with pytest.raises(Refusal) as caught:
        solve(problem, baseline=False)
    assert caught.value.run in ("run-in", "run-out")
    assert build_toolpath(problem).beads[0].short_runs == (False, False)
