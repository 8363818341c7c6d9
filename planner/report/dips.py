"""Dips in the report: marks on the part, a table of those that cost most, and what would avoid them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.report.wording import counted, number

if TYPE_CHECKING:
    from planner.plan import Dip, Plan, Trajectory


MOST_ROWS = 30
MOST_MARKS = 800  # each carries some 300 bytes of words


def worst_first(dips: Sequence[Dip]) -> list[Dip]:
    """Dips by the time that they cost, most first."""
    return sorted(dips, key=lambda dip: -dip.lost)


def without_stops(dips: Sequence[Dip]) -> list[Dip]:
    """Dips but for those where the nozzle has to rest on its bead."""
    return [dip for dip in dips if dip.limit != "stop"]


def samples_of(trajectory: Trajectory, dips: Sequence[Dip]) -> NDArray[np.intp]:
    """Sample at which each dip is slowest."""
    return np.rint(np.array([dip.t for dip in dips]) / trajectory.dt).astype(np.intp)


def dip_marks(plan: Plan) -> dict[str, Any] | None:
    """Marks of the dips that cost most: `point` and `normal` (part frame, m), `sample`, `layer`, `words`; None without any."""
    if not plan.dips:
        return None
    shown = sorted(worst_first(plan.dips)[:MOST_MARKS], key=lambda dip: dip.t)
    traj = plan.trajectory
    at = samples_of(traj, shown)
    return {
        "point": traj.tip[at].astype(np.float32).ravel(),
        "normal": (-traj.axis[at]).astype(np.float32).ravel(),
        "sample": at.astype(np.int32),
        "layer": np.array([dip.layer for dip in shown], dtype=np.int32),
        "words": [_lines(dip, plan.problem.process.speed) for dip in shown],
    }


def dips_section(plan: Plan) -> str:
    """HTML of the dips: how many, what they cost, by cause, and the worst of them with what would avoid each."""
    head = "<h2>Dips in speed</h2>"
    dips = without_stops(plan.dips)
    rests = [dip for dip in plan.dips if dip.limit == "stop"]
    took = number(sum(dip.lost for dip in rests), 2)
    many = counted(len(rests), "time")
    stops = f" Where fibre is cut the nozzle stops on its bead: {many}, {took} s in all." if rests else ""
    if not dips:
        return f"{head}<p class=note>None: all beads are printed at the commanded speed, within 2 %.{stops}</p>"
    shown = worst_first(dips)[:MOST_ROWS]
    count, lost = len(dips), sum(dip.lost for dip in dips)
    many = f"The {len(shown)} of {number(count, 0)} that cost most" if count > len(shown) else "Most costly first"
    flows = any(dip.over_extruded for dip in dips)
    all_marked = len(plan.dips) <= MOST_MARKS
    marked = "each is a white mark" if all_marked else f"the {MOST_MARKS} that cost most are white marks"
    rows = "".join(_row(dip, plan.problem.process.speed, flows) for dip in shown)
    extra = "<th>too much material, mm³</th>" if flows else ""
    return (
        f"{head}<p class=note>{number(count, 0)} {'dips cost' if count > 1 else 'dip costs'} {number(lost, 2)} s. In the "
        f"print above {marked}, to be clicked.{stops}</p>"
        f"{_causes(dips)}<h3>{many}</h3>"
        "<p class=note>What would avoid a dip, each by itself: the speed and the limits follow exactly from this motion "
        "held at constant speed; what is “about” is an estimate. The search sees a change too, so that a new plan may "
        "come out better or worse.</p>"
        "<div class=wide><table class=stack><thead><tr><th class=left>where</th><th>lowest, mm/s</th><th>lost, s</th>"
        f"<th class=left>why</th>{extra}<th class=left>what would avoid it</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div>"
    )


def place_words(dip: Dip) -> str:
    """Where a dip is, in words."""
    return f"bead {dip.bead}, layer {dip.layer + 1}, {dip.from_s * 1e3:.1f} to {dip.to_s * 1e3:.1f} mm along it"


def _causes(dips: Sequence[Dip]) -> str:
    """A table: how many dips each joint's limit asks for, and what they cost."""
    groups: dict[str, list[Dip]] = defaultdict(list)
    for dip in dips:
        groups[dip.cause].append(dip)
    ordered = sorted(groups.items(), key=lambda item: -sum(dip.lost for dip in item[1]))
    rows = "".join(
        f"<tr><th scope=row>{escape(cause)}</th><td class=n>{number(len(group), 0)}</td>"
        f"<td class=n>{number(sum(dip.lost for dip in group), 2)}</td>"
        f"<td class=n>{number(min(dip.speed for dip in group) * 1e3, 1)}</td></tr>"
        for cause, group in ordered
    )
    return (
        "<div class=wide><table><thead><tr><th class=left>why</th><th>dips</th><th>lost, s</th><th>lowest, mm/s</th>"
        f"</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _row(dip: Dip, commanded: float, flows: bool) -> str:
    extra = f"<td class=n data-unit='mm³ too much'>{number(dip.over_extruded * 1e9, 3)}</td>" if flows else ""
    remedies = "<br>".join(escape(remedy.words) for remedy in dip.remedies) or "–"
    return (
        f"<tr><td class=where>{escape(place_words(dip))}</td><td class=n data-unit='mm/s'>{number(dip.speed * 1e3, 1)} of "
        f"{commanded * 1e3:g}</td><td class=n data-unit='s lost'>{number(dip.lost, 3)}</td><td>{escape(dip.cause)}</td>{extra}"
        f"<td class=where>{remedies}</td></tr>"
    )


def _lines(dip: Dip, commanded: float) -> list[str]:
    return [
        place_words(dip),
        f"{dip.speed * 1e3:.1f} of {commanded * 1e3:g} mm/s, {dip.lost:.3f} s lost",
        f"why: {dip.cause}",
        *([f"too much material: {dip.over_extruded * 1e9:.3g} mm³"] if dip.over_extruded else []),
        *(f"{'or' if k else 'would avoid it:'} {remedy.words}" for k, remedy in enumerate(dip.remedies)),
    ]
