"""Prints that can only be printed nearer to joints' ends than searches keep: found as a last resort, told, and judged as all are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.cell.cell import LEAST_ROOM, LIMIT_ROOM, build_cell
from planner.planning.context import context_of
from planner.planning.joint_ends import nearer_to_ends
from planner.planning.pipeline import load, solve
from planner.problem import Problem
from planner.resolve.ladder import ladder
from planner.toolpath.build import build_toolpath

# With the nozzle upright and its tip on the flange's axis, joint 1 is the direction in which the tip lies. Joint 6 is held so
# closely that it cannot turn back by as much as joint 1 turns along the line: no roll that rests serves the whole of it.
CELL = """name: end
cell:
  arm: irb2600
  nozzle: {{tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}}
  home_deg: [0, 0, 0, 0, 60, 0]
  bed_mm: [1000, 0, 300]
  limits: {{joint_1: {{range_deg: [-30, {end:.6f}]}}, joint_6: {{range_deg: [-12, 12]}}}}
layers: {{source: {{waypoints: path.txt}}}}
process: {{speed_mm_s: 20, travel_speed_mm_s: 200, bead: {{width_mm: 0.8, height_mm: 0.5}}, run_in_mm: 3}}
"""
REACH, HALF, RUN = 1000.0, 300.0, 3.0  # mm: how far the line stands from the arm, half its length, and its runs


def problem_at(folder: Path, beyond_deg: float, *overrides: str, towards: int = 1) -> Problem:
    """A line across, run-in and run-out included, whose left end joint 1 can pass by so much; drawn towards it, or away (-1)."""
    y = np.arange(-HALF, HALF + 0.01, 5.0)[::towards]
    np.savetxt(folder / "path.txt", np.column_stack([0 * y, y, 0 * y + 0.5, 0 * y, 0 * y, 0 * y + 1.0]), fmt="%.4f")
    file = folder / "end.yaml"
    file.write_text(CELL.format(end=np.degrees(np.arctan2(HALF + RUN, REACH)) + beyond_deg))
    return load(file, *overrides)


@pytest.mark.slow(keep=("ladder",))
@pytest.mark.parametrize("strategy", ["sqp", "ladder"])
def test_what_can_only_be_printed_near_an_end_is_printed_there_and_told(tmp_path: Path, strategy: str) -> None:
    problem = problem_at(tmp_path, 2.0)
    cell = build_cell(problem)
    given = context_of(problem, cell, build_toolpath(problem))
    with pytest.raises(Refusal, match="every posture is within 4 deg of the end of a joint's range") as caught:
        ladder(cell, given.tasks, problem.resolve, given.obstacles)
    assert caught.value.near_ends
    plan = solve(problem, strategy, baseline=False)
    assert plan.verified
    room = np.min([(cell.limits.q_max - path.q).min(axis=0) for path in plan.paths], axis=0)
    assert LEAST_ROOM < room[0] < LIMIT_ROOM
    (note,) = (note for note in plan.toolpath.notes if "from the ends of their ranges" in note)
    assert note.startswith("no plan keeps joints 4 deg from the ends of their ranges: bead 0, waypoint")
    end = np.degrees(cell.limits.q_max[0])
    assert f"joint_1 comes to {np.degrees(room[0]):.1f} deg from its end at {end:.1f}, 600.0 mm along bead 0" in note
    (check,) = (check for check in plan.checks if check.name == "joint range")
    assert check.ok
    # the cell that is told keeps the usual room
    assert plan.cell.limits.room == LIMIT_ROOM


@pytest.mark.parametrize(
    ("beyond_deg", "towards", "why"),
    [
        (-0.5, 1, r"no posture within the joints' ranges; the nearest one exceeds that of joint_1 by 0\.[1-5] deg"),
        (-0.5, -1, r"no posture within the joints' ranges; the nearest one exceeds that of joint_1 by 0\.5 deg"),
        (0.3, 1, r"every posture is within 0\.6 deg of the end of a joint's range"),
    ],
    ids=["crossed on the way", "crossed at once", "too near"],
)
def test_what_an_end_forbids_stays_refused(tmp_path: Path, beyond_deg: float, towards: int, why: str) -> None:
    with pytest.raises(Refusal, match=why):
        solve(problem_at(tmp_path, beyond_deg, towards=towards), baseline=False)


@pytest.mark.slow
def test_where_the_usual_room_serves_nothing_is_told(tmp_path: Path) -> None:
    plan = solve(problem_at(tmp_path, 6.0), baseline=False)
    assert plan.verified
    assert not any("from the ends of their ranges" in note for note in plan.toolpath.notes)


def test_what_is_refused_for_another_reason_is_not_searched_again(tmp_path: Path) -> None:
    problem = problem_at(tmp_path, 6.0, "cell.bed_mm=[4000, 0, 300]")
    given = context_of(problem, build_cell(problem), build_toolpath(problem))
    with pytest.raises(Refusal, match="out of the arm's reach") as caught:
        ladder(given.cell, given.tasks, problem.resolve, given.obstacles)
    assert nearer_to_ends(given, caught.value, Stages()) is None
