"""What an upright nozzle meets whatever the posture: what stands with the part is named, and a height that clears it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.base.errors import Blocked, Change
from planner.cell.cell import build_cell
from planner.planning.context import PlanningContext, context_of
from planner.planning.pipeline import load, solve
from planner.planning.upright import RAISES, check_upright
from planner.resolve.ladder import ladder
from planner.toolpath.build import build_toolpath

CELL = """name: wall
cell:
  arm: irb2600
  nozzle: {tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}
  home_deg: [0, 0, 0, 0, 60, 0]
  positioner: {robot: irbp_a250, origin_mm: [1100, 0, 600], free: [rotation]}
layers: {source: {waypoints: wall.txt}}
process: {speed_mm_s: 20, travel_speed_mm_s: 200, bead: {width_mm: 0.8, height_mm: 0.5}}
"""
TUBE = 15.0  # mm, radius of the head where none is given: the nozzle's axis is as high above the plate at least


def wall(folder: Path, height_mm: float, *overrides: str) -> PlanningContext:
    """A level line of 15 mm on an upright wall, so high above the plate."""
    x = np.arange(0.0, 15.01, 0.5)
    np.savetxt(
        folder / "wall.txt", np.column_stack([x, 0 * x, 0 * x + height_mm, 0 * x, 0 * x - 1.0, 0 * x]), fmt="%.6f"
    )
    (folder / "wall.yaml").write_text(CELL)
    problem = load(folder / "wall.yaml", *overrides)
    return context_of(problem, build_cell(problem), build_toolpath(problem))


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("height_mm", [1.0, 6.0, 13.0])
def test_a_nozzle_in_the_plate_is_refused_with_the_height_that_clears_it(tmp_path: Path, height_mm: float) -> None:
    given = wall(tmp_path, height_mm)
    with pytest.raises(Blocked, match=r"of print head with plate \(plate\)") as caught:
        check_upright(given)
    lacks = float(str(caught.value).partition("every posture lacks ")[2].partition(" mm")[0])
    assert lacks == pytest.approx(TUBE - height_mm, abs=1.0)  # points stand for the plate
    least = next(more for more in RAISES if height_mm + more > TUBE)
    assert f"; the part would be clear {least:g} mm higher on its plate" in str(caught.value)
    (change,) = caught.value.hints
    assert isinstance(change, Change)
    heights = [more for more in RAISES if more >= least][:2]
    assert [fields for _, fields in change.tries] == [
        (("cell.positioner.part_mm", [0.0, 0.0, more]),) for more in heights
    ]


def test_what_is_clear_of_the_plate_or_may_lean_is_the_searchs(tmp_path: Path) -> None:
    check_upright(wall(tmp_path, 17.0))
    check_upright(wall(tmp_path, 1.0, "process.cones.nozzle_normal_deg=10"))
    with pytest.raises(Blocked, match=r"lacks [01]\."):
        check_upright(wall(tmp_path, 17.0, "collision.nozzle_mm=2.9"))  # a clearance that was asked for


def test_a_search_that_lacks_clearance_from_the_plate_names_the_plate(tmp_path: Path) -> None:
    """By less than what is kept between bodies for what lies between places of a search."""
    given = wall(tmp_path, TUBE + 2.4, "process.run_in_mm=0.5")
    with pytest.raises(Blocked, match=r"of print head with plate \(plate\).* lacks 0\.\d mm"):
        ladder(given.cell, given.tasks, given.problem.resolve, given.obstacles)


@pytest.mark.slow
def test_the_height_that_is_named_gives_a_verified_plan(tmp_path: Path) -> None:
    given = wall(tmp_path, 6.0)
    with pytest.raises(Blocked) as caught:
        solve(given.problem, baseline=False)
    (hint,) = caught.value.hints
    assert hint.startswith("cell.positioner.part_mm: [0.0, 0.0, 10.0] gives a verified")
