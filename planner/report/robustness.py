"""Head-room under uncertainty in words and tables: whether a plan holds where the part stands a little elsewhere."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING

from planner.report.wording import CHECK_NAMES, METRICS, MISSING, number, significant

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.plan.robustness import Bound, Robustness, TriedDisplacement

MOST_TIMES = 10.0  # tolerances: farther than that, first order says little
MOST_FAILURES = 5  # of placements that are told one by one on the command line


def robustness_words(plan: Plan) -> list[str]:
    """Lines for the command line; none where nobody asked."""
    room = plan.headroom
    if room is None:
        return []
    lines = [f"tolerance {room.tolerance.words}: {_verdict(room)}"]
    lines += [f"  to first order {_bound(bound)}" for bound in (room.bounds[0], room.bounds[-1])]
    for name, label, unit, factor, decimals in (
        ("joint_limit_margin_deg", "joint limit margin", " deg", 1.0, 1),
        ("sigma_min", "singularity margin σ", "", 1.0, 3),
        ("at_speed_fraction", "at commanded speed", " %", 100.0, 1),
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


def robustness_section(plan: Plan) -> str:
    """HTML: verdict, bounds to first order, checks and metrics at their worst, and every displacement that was tried."""
    room = plan.headroom
    if room is None:
        return ""
    good = "yes" if room.holds else "bad"
    x, y, z = (1e3 * c for c in room.middle)
    return (
        f"<h2>Where the part stands elsewhere</h2><p class={good}>{'✓' if room.holds else '✗'} "
        f"{escape(room.tolerance.words)}: {escape(_verdict(room))}.</p>"
        "<p class=note>The part is shifted and turned about the middle of what is printed "
        f"({x:.1f}, {y:.1f}, {z:.1f} mm in the part frame), the work object is corrected, and the nozzle goes the "
        "same way over the part with the same table angles on the same branch. Joints and times are found anew, travel "
        "goes through the same targets, and all checks are made again.</p>"
        f"{_bounds(room)}{_worst_metrics(plan, room)}{_worst_checks(room)}{_tried(room)}"
    )


def _verdict(room: Robustness) -> str:
    elsewhere = len(room.tried) - 1
    failed = sum(not each.verified for each in room.tried[1:])
    if not elsewhere:
        return "as planned, nowhere else"
    if failed:
        return f"does not hold at {failed} of {elsewhere} placements tried"
    if not room.holds:
        return "does not hold, not even as planned"
    return f"holds at all {elsewhere} placements tried"


def _factor(bound: Bound) -> str:
    return f"more than {MOST_TIMES:g}" if bound.factor > MOST_TIMES else f"{max(bound.factor, 0.0):.2f}"


def _amounts(bound: Bound) -> tuple[str, str]:
    """What is there, and by how much it may change."""
    if bound.joint:
        return f"{math.degrees(bound.room):.2f} deg", f"{math.degrees(bound.change):.2f} deg"
    return f"{bound.room:.4f}", f"{bound.change:.4f}"


def _where(bound: Bound) -> str:
    return f"bead {bound.bead}, layer {bound.layer + 1}, {bound.s * 1e3:.1f} mm along it"


def _bound(bound: Bound) -> str:
    room, change = _amounts(bound)
    what = f"the range of {bound.joint}" if bound.joint else "the singularity margin"
    return f"{what} holds up to {_factor(bound)} times that: room {room}, change {change} ({_where(bound)})"


def _bounds(room: Robustness) -> str:
    rows = []
    for bound in room.bounds:
        has, change = _amounts(bound)
        what = f"range of {escape(bound.joint)}" if bound.joint else "singularity margin σ"
        rows.append(
            f"<tr{' class=bad' if bound.factor < 1.0 else ''}><th scope=row>{what}</th><td class=n>{has}</td>"
            f"<td class=n>{change}</td><td class=n>{_factor(bound)}</td><td class=where>{escape(_where(bound))}</td></tr>"
        )
    return (
        "<h3>To first order</h3><p class=note>By the Jacobian at every sample of the beads and their runs, over all "
        "shifts and turns at once: the room to the limit, the most by which the tolerance changes it, and for how many "
        "times the tolerance it would last. σ counts where material flows; travel is judged below.</p>"
        "<div class=wide><table><thead><tr><th class=left>what</th><th>room</th><th>change</th><th>times</th>"
        f"<th class=left>where it is tightest</th></tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _worst_metrics(plan: Plan, room: Robustness) -> str:
    worst = room.worst_metrics
    rows = "".join(
        f"<tr><th scope=row>{metric.label.strip()}{f'<span class=unit>, {metric.unit}</span>' if metric.unit else ''}</th>"
        f"<td class=n>{number(plan.metrics[metric.key] * metric.scale, metric.digits)}</td>"
        f"<td class=n>{number(worst[metric.key][0] * metric.scale, metric.digits)}</td>"
        f"<td class=where>{escape(worst[metric.key][1].name)}</td></tr>"
        for metric in METRICS
        if metric.key in worst and metric.key in plan.metrics
    )
    return (
        "<h3>At worst</h3><div class=wide><table><thead><tr><th class=left></th><th>as planned</th><th>worst</th>"
        f"<th class=left>where the part stands then</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _worst_checks(room: Robustness) -> str:
    rows = "".join(
        f"<tr{'' if check.ok else ' class=bad'}><th scope=row>{escape(check.name.translate(CHECK_NAMES))}</th>"
        f"<td class=n>{significant(check.worst)}</td><td class=n>{significant(check.limit)}</td>"
        f"<td>{escape(check.unit)}</td><td class=where>{escape(where.name)}; {escape(check.where) or MISSING}</td></tr>"
        for check, where in room.worst_checks
    )
    return (
        "<div class=wide><table><thead><tr><th class=left>check</th><th>worst</th><th>limit</th><th class=left>unit</th>"
        f"<th class=left>where</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _tried(room: Robustness) -> str:
    rows = "".join(_tried_row(each) for each in room.tried)
    return (
        "<h3>Every placement tried</h3><p class=note>The whole shift along each axis, the whole turn about each, both "
        "at once in eight corners, and what first order says is worst for joints and singularities.</p>"
        "<div class=wide><table><thead><tr><th class=left>the part</th><th class=left>verdict</th><th>σ</th>"
        f"<th>joint margin, °</th><th>at speed, %</th><th>print, s</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _tried_row(each: TriedDisplacement) -> str:
    metrics = each.metrics or {}
    values = (
        ("sigma_min", 1.0, 4),
        ("joint_limit_margin_deg", 1.0, 1),
        ("at_speed_fraction", 100.0, 2),
        ("print_time_s", 1.0, 1),
    )
    cells = "".join(
        f"<td class=n>{number(metrics[name] * scale, digits) if name in metrics else MISSING}</td>"
        for name, scale, digits in values
    )
    verdict = "<span class=yes>✓ holds</span>" if each.verified else f"✗ {'<br>'.join(map(escape, each.failures))}"
    row = "" if each.verified else " class=bad"
    shift = ", ".join(f"{1e3 * c:.2f}" for c in each.displacement.shift)
    turn = ", ".join(f"{math.degrees(angle):.2f}" for angle in each.displacement.turn)
    about = f" title='shifted by {shift} mm, turned by {turn} deg'".replace("-", "−")
    return (
        f"<tr{row}><th scope=row{about}>{escape(each.displacement.name)}</th><td class=where>{verdict}</td>{cells}</tr>"
    )
