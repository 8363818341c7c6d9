"""report.html of a refusal: there is no trajectory, so it shows why, where, and what could be changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.report import page as frame
from planner.report.scene import bead_scene

if TYPE_CHECKING:
    from planner.toolpath.bead import Toolpath

# What a user can turn, by field of the problem file, and what it does: true of every refusal.
LEVERS = (
    (
        "cell.positioner.origin_mm or cell.bed_mm",
        "Move the part: nearer when out of reach, away when the arm folds up.",
    ),
    ("cell.positioner.free", "Free another axis of the positioner, so that it can bring the place to the arm."),
    ("cell.nozzle", "A nozzle that stands at an angle to the flange keeps the wrist away from its singularity."),
    ("cell.home_deg", "Start from a posture on another branch of the arm."),
    (
        "resolve",
        "Search finer (roll_step_deg, table_step_deg), or accept less distance from singularities (min_sigma).",
    ),
    ("process.speed_mm_s", "Print slower, if a joint is too slow for the path."),
    ("process.corner_tolerance_mm", "Round corners more, if they ask too much of a joint."),
    ("strategy", "as_published and fixed leave the search little freedom; ladder and sqp use all of it."),
)


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
) -> None:
    """Write the report of a refused problem.

    message   one sentence: the reason
    toolpath  what was to be printed, if planning came that far; `bead` is the index of the one that failed
    point_mm  the place in the part frame, if known
    facts     name -> text, shown as they are; "what to change", if there, is shown first of the advice
    hints     changes that were tried and would help, shown after it
    Raises OutputError where `path` cannot be written.
    """
    facts = dict(facts)
    advice = facts.pop("what to change", None)
    header = (
        f"<p class=kind>Print plan</p><h1>{escape(problem.name)}</h1>"
        f"<p class=about>strategy <b>{escape(strategy)}</b></p>"
        + frame.verdict(False, "No plan: this cannot be printed as it stands", f"<p>{escape(message)}</p>")
    )
    known = []
    beads = toolpath.beads if toolpath is not None else ()
    if bead is not None and 0 <= bead < len(beads):
        line = beads[bead]
        known.append(("bead", f"{bead} of {len(beads)} ({line.name}), layer {line.layer + 1}"))
    if point_mm is not None:
        x, y, z = point_mm
        known.append(("place in the part frame", f"x {x:.2f}, y {y:.2f}, z {z:.2f} mm"))
    body = frame.pairs_table("What is known", [*known, *facts.items()])
    scene = None
    if toolpath is not None:
        failed = bead if bead is not None and 0 <= bead < len(beads) else None
        scene = bead_scene(toolpath.shape, beads, failed, point_mm)
        body += (
            "<h2>Where</h2><p class=note>All planned lines in the part’s own frame, in millimetres"
            f"{'; the one that fails is thick and red' if failed is not None else ''}"
            f"{'; the place is marked “here”' if point_mm is not None else ''}. Drag to turn.</p><div id=view></div>"
        )
    body += "<h2>What to change</h2>"
    if advice:
        body += f"<p><b>{escape(advice)}</b></p>"
    if hints:
        items = "".join(f"<li>{escape(hint)}</li>" for hint in hints)
        body += f"<p>Tried on this problem, each by itself:</p><ul>{items}</ul>"
    body += "<p class=note>The fields of the problem file that decide whether a plan exists:</p>"
    rows = "".join(f"<tr><th scope=row><code>{name}</code></th><td>{what}</td></tr>" for name, what in LEVERS)
    body += f"<table><tbody>{rows}</tbody></table>"
    footer = "No robot code was written. This file needs no network."
    text = frame.page(f"{problem.name}: no plan", header, body, footer, {"scene": scene, "charts": []})
    frame.write_text(Path(path), text)
