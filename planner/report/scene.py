"""What the page draws the scene from: cell, part and beads in metres, the motion, and the places to go to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.report.dips import dip_marks
from planner.report.lines import bead_lines, plan_lines
from planner.report.part import part_data
from planner.report.places import Place, places_data
from planner.report.robot import cell_data, postures
from planner.report.thinning import SCENE_BUDGET

if TYPE_CHECKING:
    from planner.cell import Cell
    from planner.plan import CellView, Plan
    from planner.toolpath.bead import Bead
    from planner.toolpath.shape import Shape


EARLIER_BUDGET = 10_000  # points of beads that are there before the motion
# Cividis, reversed and without its palest end: the ordinary is dark and calm, the exceptional is light.
COLOURS: list[tuple[float, str]] = [
    (0.0, "#f2c928"),
    (0.2, "#c9ae5c"),
    (0.4, "#9b9476"),
    (0.6, "#6e7277"),
    (0.8, "#404d6c"),
    (1.0, "#00224e"),
]
PAPER = "#ffffff"
INK = "#1b2733"
ALARM = "#d1495b"
PLANNED = "#40566e"
EARLIER = "#b9c4cf"  # beads of which no motion is shown: they were there before
DEFAULT_WIDTH = 0.6e-3  # m: of a bead whose width nobody tells


def plan_scene(plan: Plan, places: Sequence[Place]) -> dict[str, Any]:
    """Scene of a plan: `cell`, `part`, `motion`, `lines`, `earlier`, `places`, `dips`, `colours`, times in seconds."""
    traj = plan.trajectory
    cell = cell_data(plan.cell, plan.view)
    width = _width(plan.beads)
    earlier = plan.toolpath.beads[: plan.first_bead]
    facing = -traj.axis[traj.deposit].mean(axis=0) if traj.deposit.any() else np.zeros(3)
    return {
        "cell": cell,
        "part": part_data(plan.toolpath.shape),
        "motion": None if cell is None else postures(plan.cell, traj),
        "dt": traj.dt,
        "end": float(traj.t[-1]),
        "facing": facing.round(4).tolist(),
        "lines": plan_lines(plan) | {"width": width},
        "still": [bead_lines(earlier, EARLIER_BUDGET) | {"width": width, "colour": EARLIER}] if earlier else [],
        "places": places_data(plan, places),
        "dips": dip_marks(plan),
        "events": [[float(e.start), float(e.duration), e.words] for e in traj.events if e.duration > 0.0],
        "colours": COLOURS,
        "home": None,
    }


def failed_scene(
    shape: Shape | None,
    beads: Sequence[Bead],
    failed: int | None,
    places: list[dict[str, Any]],
    cell: Cell | None,
    view: CellView | None,
) -> dict[str, Any]:
    """Scene where there is no trajectory: all beads as planned, the failed one in red, the robots at their start."""
    width = _width(beads)
    others = [bead for k, bead in enumerate(beads) if k != failed]
    still = [bead_lines(others, SCENE_BUDGET) | {"width": width, "colour": PLANNED}]
    if failed is not None:
        still.append(bead_lines([beads[failed]], SCENE_BUDGET) | {"width": width, "thick": 2.0, "colour": ALARM})
    shown = beads if failed is None else [beads[failed]]
    facing = np.mean([np.mean(bead.normals, axis=0) for bead in shown], axis=0) if shown else np.zeros(3)
    return {
        "cell": None if cell is None else cell_data(cell, view),
        "part": part_data(shape),
        "motion": None,
        "dt": 0.0,
        "end": 0.0,
        "facing": facing.round(4).tolist(),
        "lines": None,
        "still": still,
        "places": places,
        "dips": None,
        "events": [],
        "colours": COLOURS,
        "home": None if cell is None else cell.home.tolist(),
    }


def _width(beads: Sequence[Bead]) -> float:
    """The usual width of beads [m]."""
    widths = [float(np.median(bead.width)) for bead in beads if len(getattr(bead, "width", ()))]
    return float(np.median(widths)) if widths else DEFAULT_WIDTH
