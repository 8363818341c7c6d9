"""A plan in a few words, for who has it in Python: a line, a short text, a small table."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.plan.plan import Plan

# metric → what it is, unit, factor, decimals
ROWS = {
    "at_speed_fraction": ("of the length at the commanded speed", "%", 100.0, 1),
    "speed_min_mm_s": ("slowest while depositing", "mm/s", 1.0, 1),
    "print_time_s": ("whole print, travel included", "s", 1.0, 1),
    "sigma_min": ("least singular value of the arm's Jacobian", "", 1.0, 3),
    "joint_limit_margin_deg": ("least distance from an end stop", "deg", 1.0, 1),
    "clearance_min_mm": ("least clearance beyond the tip", "mm", 1.0, 1),
}


def plan_line(plan: Plan) -> str:
    """Name, strategy and verdict."""
    verdict = "verified" if plan.verified else "not verified"
    return f"{plan.name} by {plan.strategy}: {verdict}, {plan.t[-1]:.1f} s, {len(plan.beads)} beads"


def plan_words(plan: Plan) -> str:
    """The line, a line for each metric that there is, and one for each check that fails."""
    rows = [f"{value:>12}  {label}" for value, label in _rows(plan)]
    return "\n".join([plan_line(plan), *rows, *(f"FAILED {text}" for text in _failed(plan))])


def plan_html(plan: Plan) -> str:
    """The same as a table."""
    rows = "".join(f"<tr><td>{escape(value)}</td><td>{escape(label)}</td></tr>" for value, label in _rows(plan))
    failed = "".join(f"<tr><td>FAILED</td><td>{escape(text)}</td></tr>" for text in _failed(plan))
    return f"<table><caption>{escape(plan_line(plan))}</caption><tbody>{rows}{failed}</tbody></table>"


def _rows(plan: Plan) -> list[tuple[str, str]]:
    return [
        (f"{plan.metrics[key] * factor:.{decimals}f} {unit}".strip(), label)
        for key, (label, unit, factor, decimals) in ROWS.items()
        if key in plan.metrics
    ]


def _failed(plan: Plan) -> list[str]:
    return [
        f"{check.name}: {check.worst:.4g} {check.unit}, limit {check.limit:.4g} ({check.where})"
        for check in plan.checks
        if not check.ok
    ]
