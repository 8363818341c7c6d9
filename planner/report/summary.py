"""The summary table on stdout: the chosen strategy beside the baseline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from planner.report.extruder import events_words, materials_words
from planner.report.places import place_words, without_stops, worst_first
from planner.report.robustness import robustness_words
from planner.report.wording import OVER_BOUND, OVER_IDEAL, counted, resumed_words, with_ratios

if TYPE_CHECKING:
    from planner.plan import Plan

MOST_ADVISED = 3  # changes in the summary; the report has all
# metric, label, unit, factor, decimals
ROWS = (
    ("at_speed_fraction", "at commanded speed (±2 %)", "% of length", 100.0, 1),
    ("deposition_time_s", "deposition time", "s", 1.0, 1),
    (OVER_IDEAL, "  over length / commanded speed", "×", 1.0, 3),
    (OVER_BOUND, "  over the bound without jerk limits", "×", 1.0, 3),
    ("print_time_s", "print time", "s", 1.0, 1),
    ("speed_min_mm_s", "lowest speed", "mm/s", 1.0, 1),
    ("sigma_min", "singularity margin σ", "", 1.0, 3),
    ("wrist_margin_deg", "wrist margin", "deg", 1.0, 1),
    ("joint_limit_margin_deg", "joint limit margin", "deg", 1.0, 1),
    ("velocity_ratio_max", "joint velocity / limit", "", 1.0, 3),
    ("acceleration_ratio_max", "joint acceleration / limit", "", 1.0, 3),
    ("jerk_ratio_max", "joint jerk / limit", "", 1.0, 3),
    ("position_error_max_mm", "tip off the path", "mm", 1.0, 4),
    ("axis_error_max_deg", "axis off the normal", "deg", 1.0, 4),
    ("tilt_max_deg", "nozzle leans from the normal, at most", "deg", 1.0, 2),
    ("tilt_bead_error_max_mm", "  a bead's edges off its height by that", "mm", 1.0, 4),
    ("path_deviation_max_mm", "rounded corners off the drawing", "mm", 1.0, 3),
    ("clearance_min_mm", "least clearance beyond the tip", "mm", 1.0, 1),
    ("flow_error_max", "material in a millimetre, off by", "%", 100.0, 2),
    ("over_extruded_mm3", "too much material, in dips", "mm³", 1.0, 2),
    ("extruded_mm", "filament", "mm", 1.0, 0),
)


def print_summary(
    plan: Plan, folder: Path, programs: str = "", program_notes: Sequence[str] = (), forecast: Sequence[str] = ()
) -> None:
    """Print verdict, summary table, notes, failed checks, programs with what controllers will make of them, and the folder."""
    out = Console(highlight=False)
    m = plan.metrics
    size = f"{counted(m['beads'], 'bead')}, {counted(m['layers'], 'layer')}, {m['deposited_length_mm'] / 1e3:.2f} m"
    size += f"; {resumed_words(plan)}" if plan.first_bead else ""
    table = Table(title=f"{plan.problem.name}: {size}", title_justify="left")
    table.add_column("")
    table.add_column(plan.strategy, justify="right")
    for name in plan.baseline:
        table.add_column(name, justify="right", style="dim")
    table.add_column("unit")
    columns = [with_ratios(values) for values in (m, *plan.baseline.values())]
    for metric, label, unit, factor, decimals in ROWS:
        if all(metric not in values for values in columns):
            continue
        cells = [_number(values.get(metric, math.nan) * factor, decimals) for values in columns]
        table.add_row(label, *cells, unit)
    out.print(table)
    notes = [f"note: {note}" for note in plan.toolpath.notes]
    if plan.resolved_by not in ("", plan.strategy):
        notes.append(f"note: the paths of strategy {plan.resolved_by} print better here, and were taken")
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
            text = f"FAILED {check.name}: {check.worst:.4g} {check.unit}, limit {check.limit:.4g} ({check.where})"
            out.print(text, markup=False, soft_wrap=True)
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
    """How many dips there are, what they cost, and the dearest of them; empty without any."""
    dips = without_stops(plan.dips)
    if not dips:
        return ""
    worst = worst_first(dips)[0]
    lost = sum(dip.lost for dip in dips)
    count = "1 dip costs" if len(dips) == 1 else f"{len(dips)} dips cost"
    return f"{count} {lost:.2f} s; the dearest: {place_words(worst)}, {worst.speed * 1e3:.1f} mm/s, {worst.cause}"


def _advice(plan: Plan) -> str:
    """What would help most, and what it was tried on; empty where nothing was found."""
    if not plan.advice:
        return ""
    changes = "; or ".join(each.words for each in plan.advice[:MOST_ADVISED])
    return f"what would help most, {plan.advice[0].tried_on}: {changes}"


def _number(value: float, decimals: int) -> str:
    return "no plan" if math.isnan(value) else f"{value:.{decimals}f}"
