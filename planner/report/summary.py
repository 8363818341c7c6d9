"""The summary table on stdout: the chosen strategy next to the baseline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from planner.report.extruder import events_words, materials_words
from planner.report.places import check_advice, place_words, without_stops, worst_first
from planner.report.robustness import robustness_words
from planner.report.wording import (
    METRICS,
    OVER_BOUND,
    OVER_IDEAL,
    MetricLabel,
    counted,
    distance,
    resumed_words,
    with_ratios,
)

if TYPE_CHECKING:
    from planner.plan import Plan

MOST_ADVISED = 3  # changes in the summary; the report has all
SHOWN = (
    "at_speed_fraction",
    "speed_min_mm_s",
    "deposition_time_s",
    OVER_IDEAL,
    OVER_BOUND,
    "print_time_s",
    "sigma_min",
    "wrist_margin_deg",
    "joint_limit_margin_deg",
    "rail_margin_mm",
    "velocity_ratio_max",
    "acceleration_ratio_max",
    "jerk_ratio_max",
    "position_error_max_mm",
    "axis_error_max_deg",
    "tilt_max_deg",
    "tilt_bead_error_max_mm",
    "path_deviation_max_mm",
    "nozzle_clearance_min_mm",
    "arm_clearance_min_mm",
    "robot_clearance_min_mm",
    "flow_error_max",
    "even_flow_fraction",
    "over_extruded_mm3",
    "steering_radius_min_mm",
    "extruded_mm",
)
ROWS = tuple(metric for key in SHOWN for metric in METRICS if metric.key == key)


def print_summary(
    plan: Plan, folder: Path, programs: str = "", program_notes: Sequence[str] = (), forecast: Sequence[str] = ()
) -> None:
    """Print summary table, notes, forecasts of controllers, failed checks, verdict, programs and folder."""
    out = Console(highlight=False)
    m = plan.metrics
    size = f"{counted(m['beads'], 'bead')}, {counted(m['layers'], 'layer')}, {m['deposited_length_mm'] / 1e3:.2f} m"
    size += f"; {escape(resumed_words(plan))}" if plan.first_bead else ""
    table = Table(title=f"{plan.problem.name}: {size}", title_justify="left")
    table.add_column("")
    table.add_column(plan.strategy, justify="right")
    for name in plan.baseline:
        table.add_column(name, justify="right", style="dim")
    table.add_column("unit")
    columns = [with_ratios(values) for values in (m, *plan.baseline.values())]
    for row in ROWS:
        if any(row.key in values for values in columns):
            table.add_row(row.label, *(_number(values.get(row.key, math.nan), row) for values in columns), row.unit)
    out.print(table)
    notes = [f"note: {note}" for note in plan.toolpath.notes]
    if plan.resolved_by not in ("", plan.strategy):
        notes.append(f"note: the paths of strategy {plan.resolved_by} print better here and were used")
    notes += [f"note on the RAPID program: {note}" for note in program_notes]
    told = "; ".join(program_notes)
    notes += [f"forecast: {sentence}" for sentence in forecast if sentence.removeprefix("WARNING: ") not in told]
    for line in (
        *notes,
        _dips(plan),
        _advice(plan),
        *materials_words(plan),
        events_words(plan.trajectory.events),
        *robustness_words(plan),
    ):
        if line:
            out.print(line, markup=False, soft_wrap=True)
    for check in plan.checks:
        if not check.ok:
            out.print(f"FAILED {check.words}", markup=False, soft_wrap=True)
            advice = check_advice(check.name, plan, check.sample)
            if advice:
                out.print(f"  what may help: {advice}", markup=False, soft_wrap=True)
    if plan.verified:
        verdict = f"verified: {len(plan.checks)} checks hold"
        if plan.headroom is not None:
            verdict += f", within {plan.headroom.tolerance.words} too"
        verdict += f"; {programs}" if programs else ""
    elif plan.holds_as_planned and plan.headroom is not None:
        verdict = f"verified as planned, but NOT within {plan.headroom.tolerance.words}: no robot code was written"
    else:
        verdict = "NOT verified: no robot code was written"
    out.print(f"{verdict}; {plan.timing_s['total']:.1f} s; results in {folder}", markup=False, soft_wrap=True)


def _dips(plan: Plan) -> str:
    """The number of dips, their cost, and the costliest of them; empty without any."""
    dips = without_stops(plan.dips)
    if not dips:
        return ""
    worst = worst_first(dips)[0]
    lost = sum(dip.lost for dip in dips)
    count = "1 dip costs" if len(dips) == 1 else f"{len(dips)} dips cost"
    return f"{count} {lost:.2f} s; the costliest: {place_words(worst)}, {worst.speed * 1e3:.1f} mm/s, {worst.cause}"


def _advice(plan: Plan) -> str:
    """What would help most, and what it was tried on; empty if nothing was found."""
    if not plan.advice:
        return ""
    changes = "; or ".join(each.words for each in plan.advice[:MOST_ADVISED])
    return f"what would help most, {plan.advice[0].tried_on}: {changes}"


def _number(value: float, row: MetricLabel) -> str:
    return "no plan" if math.isnan(value) else distance(row.key, value * row.scale, row.digits)
