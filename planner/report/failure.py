"""report.html of a refusal: without a trajectory, it shows why and where planning failed, and what could be changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.report import page
from planner.report.html import stage
from planner.report.places import ReportPlace
from planner.report.scene import failed_scene

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import CellView
    from planner.toolpath.bead import Bead, Toolpath

# What a user can adjust, by field of the problem file, and its effect: true of every refusal.
LEVERS = (
    ("cell.nozzle", "A nozzle at an angle to the flange keeps the wrist away from its singularity."),
    ("cell.home_deg", "Start from a posture on another branch of the arm."),
    (
        "resolve",
        "Search more finely (roll_step_deg, table_step_deg), or accept less distance from singularities (min_sigma).",
    ),
    ("process.speed_mm_s", "Print slower, if a joint is too slow for the path."),
    ("process.corner_tolerance_mm", "Round corners more, if they demand too much of a joint."),
    ("strategy", "as_published and fixed leave the search little freedom; ladder and sqp use all of it."),
)


def _levers(problem: Any) -> Iterator[tuple[str, str]]:
    """What the user of this problem can adjust, and its effect."""
    positioner = problem.cell.positioner
    place = "cell.bed_mm"
    if positioner is not None:
        place = f"cell.positioner.{'origin_mm' if positioner.base is None else 'base_mm'}"
    yield place, "Move the part: nearer when out of reach, away when the arm folds up."
    if positioner is not None:
        yield (
            "cell.positioner.free",
            "Free another axis of the positioner, so that it can turn the place towards the arm.",
        )
    yield from LEVERS


def write_failure_report(
    path: Path,
    *,
    problem: Any,
    strategy: str,
    message: str,
    toolpath: Toolpath | None,
    bead: int | None,
    point_mm: tuple[float, float, float] | None,
    facts: Mapping[str, str],
    hints: Sequence[str] = (),
    cell: Cell | None = None,
    view: CellView | None = None,
    posture: Sequence[float] | None = None,
) -> None:
    """Write the report of a refused problem.

    message   one sentence: the reason
    toolpath  what was to be printed, if planning got that far; `bead` is the index of the bead that failed
    point_mm  the place in the part frame, if known
    facts     name -> text, shown as they are; "what to change", if given, comes first in the advice
    hints     changes that were tried and would help, shown after it
    cell, view   the robots and their bodies, to be shown in the scene
    posture   their joints there, arm and holder [rad, m], if the refusal has a posture; else they are at their start
    Raises OutputError if `path` cannot be written.
    """
    facts = dict(facts)
    advice = facts.pop("what to change", None)
    known = []
    beads = toolpath.beads if toolpath is not None else ()
    failed = bead if bead is not None and 0 <= bead < len(beads) else None
    if failed is not None:
        line = beads[failed]
        known.append(("bead", f"{failed} of {len(beads)} ({line.name}), layer {line.layer + 1}"))
    if point_mm is not None and toolpath is None:  # else it is among the places
        x, y, z = point_mm
        known.append(("place in the part frame", f"x {x:.2f}, y {y:.2f}, z {z:.2f} mm"))
    scene, marks = None, []
    if toolpath is not None:
        marks = _places(beads, failed, point_mm, [*([advice] if advice else []), *hints])
        scene = failed_scene(toolpath.shape, beads, failed, marks, cell, view, posture)
    text = page.page(
        "failure",
        f"{problem.name}: no plan",
        {"scene": scene, "charts": []},
        **stage(name=problem.name, moves=False, layers=0, dips=False, marks=bool(marks)),
        problem=problem,
        strategy=strategy,
        message=message,
        drawn=toolpath is not None,
        bead_known=failed is not None,
        posture_known=posture is not None,
        known=[*known, *facts.items()],
        places=[(ReportPlace(each["letter"], "fail", each["what"], each["where"], -1), None) for each in marks],
        advice=advice,
        hints=hints,
        levers=tuple(_levers(problem)),
    )
    page.write_text(Path(path), text)


def _places(
    beads: Sequence[Bead], failed: int | None, point_mm: Sequence[float] | None, advice: Sequence[str]
) -> list[dict[str, Any]]:
    """The place of the refusal for the page: the given point, or the start of the bead that fails; or none."""
    if failed is None and point_mm is None:
        return []
    near = [beads[failed]] if failed is not None else list(beads)
    if not near:
        return []
    points, normals = (np.concatenate([getattr(bead, name) for bead in near]) for name in ("points", "normals"))
    point = points[0] if point_mm is None else np.asarray(point_mm, dtype=float) * 1e-3
    normal = normals[np.linalg.norm(points - point, axis=1).argmin()]
    x, y, z = point * 1e3
    where = f"x {x:.1f}, y {y:.1f}, z {z:.1f} mm in the part frame".replace("-", "−")
    bead = "" if failed is None else f"bead {failed}, layer {beads[failed].layer + 1}; "
    return [
        {
            "letter": "✗",
            "kind": "fail",
            "what": "Here it fails",
            "value": "",
            "t": 0.0,
            "point": point.round(6).tolist(),
            "normal": normal.round(4).tolist(),
            "where": f"{bead}{where}" if point_mm is not None else f"{bead}it begins at {where}",
            "help": "; ".join(advice) and "Would help: " + "; ".join(advice),
            "pair": [],
        }
    ]
