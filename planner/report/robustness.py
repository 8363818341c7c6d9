"""Headroom in words and tables: whether a plan holds for a slightly displaced part."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from markupsafe import Markup

from planner.report.templates import render

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.plan.robustness import Bound, Displacement, Robustness

MOST_TIMES = 10.0  # × the tolerance: beyond that, a first-order bound means little
# for each placement: metric, factor, decimals
TRIED_METRICS = (
    ("sigma_min", 1.0, 4),
    ("joint_limit_margin_deg", 1.0, 1),
    ("at_speed_fraction", 100.0, 2),
    ("print_time_s", 1.0, 1),
)
MOST_FAILURES = 5  # placements whose failures are listed on the command line


def robustness_words(plan: Plan) -> list[str]:
    """Lines for the command line; none without a tolerance."""
    room = plan.headroom
    if room is None:
        return []
    lines = [f"tolerance {room.tolerance.words}: {_verdict(room)}"]
    lines += [f"  to first order {_bound(bound)}" for bound in (room.bounds[0], room.bounds[-1])]
    for name, label, unit, factor, decimals in (
        ("joint_limit_margin_deg", "joint range", "°", 1.0, 1),
        ("rail_margin_mm", "rail range", " mm", 1.0, 1),
        ("sigma_min", "singularity margin", "", 1.0, 3),
        ("at_speed_fraction", "length at commanded speed (±2 %)", " %", 100.0, 1),
        ("print_time_s", "print time", " s", 1.0, 1),
    ):
        if name in room.worst_metrics:
            value, where = room.worst_metrics[name]
            planned = plan.metrics[name] * factor
            lines.append(
                f"  worst {label} {value * factor:.{decimals}f}{unit} ({where.name}); as planned {planned:.{decimals}f}"
            )
    lines += [
        f"  least {check.name} {check.worst:.2f} mm, limit {check.limit:g} ({where.name})"
        for check, where in room.worst_checks
        if check.least and check.unit == "mm"
    ]
    failed = [each for each in room.tried if not each.verified]
    lines += [f"  FAILED {each.displacement.name}: {each.failures[0]}" for each in failed[:MOST_FAILURES]]
    if len(failed) > MOST_FAILURES:
        lines.append(f"  and {len(failed) - MOST_FAILURES} more, see plan.json")
    return lines


def robustness_section(plan: Plan) -> Markup:
    """HTML: verdict, bounds to first order, checks and metrics at their worst, and every displacement that was tried."""
    if plan.headroom is None:
        return Markup("")
    return render(
        "robustness",
        room=plan.headroom,
        metrics=plan.metrics,
        verdict=_verdict,
        amounts=_amounts,
        factor=_factor,
        place=_where,
        moved=_moved,
        tried_metrics=TRIED_METRICS,
    )


def _verdict(room: Robustness) -> str:
    elsewhere = len(room.tried) - 1
    failed = sum(not each.verified for each in room.tried[1:])
    if not elsewhere:
        return "tried only as planned"
    if failed:
        return f"does not hold at {failed} of {elsewhere} placements tried"
    if not room.holds:
        return "does not hold, not even as planned"
    return f"holds at all {elsewhere} placements tried"


def _factor(bound: Bound) -> str:
    return f"more than {MOST_TIMES:g}" if bound.factor > MOST_TIMES else f"{max(bound.factor, 0.0):.2f}"


def _amounts(bound: Bound) -> tuple[str, str]:
    """The margin left, and by how much it may change."""
    if bound.joint:
        return f"{math.degrees(bound.room):.2f} deg", f"{math.degrees(bound.change):.2f} deg"
    return f"{bound.room:.4f}", f"{bound.change:.4f}"


def _where(bound: Bound) -> str:
    return f"bead {bound.bead}, layer {bound.layer + 1}, {bound.s * 1e3:.1f} mm along it"


def _bound(bound: Bound) -> str:
    room, change = _amounts(bound)
    what = f"the range of {bound.joint}" if bound.joint else "the singularity margin"
    return f"{what} holds up to {_factor(bound)} times the tolerance: room {room}, change {change} ({_where(bound)})"


def _moved(displacement: Displacement) -> str:
    shift = ", ".join(f"{1e3 * c:.2f}" for c in displacement.shift)
    turn = ", ".join(f"{math.degrees(angle):.2f}" for angle in displacement.turn)
    return f"shifted by {shift} mm, turned by {turn} deg".replace("-", "−")
