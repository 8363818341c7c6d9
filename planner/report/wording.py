"""Words of the report: metrics with human labels and units, numbers as people read them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.plan import Plan

MISSING = "–"
FARTHEST = 50.0  # mm: the verifier looks no farther for what comes near, so that a distance of as much is a bound


@dataclass(frozen=True)
class MetricLabel:
    """A row of the summary: `scale` turns the metric's value into `unit`; `better` is up, down or empty."""

    key: str
    label: str
    unit: str
    digits: int
    scale: float = 1.0
    better: str = ""
    limit: float = math.inf


OVER_IDEAL, OVER_BOUND = "deposition_over_ideal", "deposition_over_bound"  # ratios made here, of metrics
METRICS = (
    MetricLabel("at_speed_fraction", "Length printed at the commanded speed (±2 %)", "%", 2, 100, "up"),
    MetricLabel("speed_min_mm_s", "Slowest tip speed while depositing", "mm/s", 2, better="up"),
    MetricLabel("speed_max_mm_s", "Fastest tip speed while depositing", "mm/s", 2),
    MetricLabel("deposition_time_s", "Time spent depositing", "s", 1, better="down"),
    MetricLabel("ideal_deposition_time_s", "Time if the speed never dipped", "s", 1),
    MetricLabel(OVER_IDEAL, "  that is, times that", "×", 3, better="down"),
    MetricLabel("bound_deposition_time_s", "Time that joint speed and acceleration alone would allow", "s", 1),
    MetricLabel(OVER_BOUND, "  that is, times that", "×", 3, better="down"),
    MetricLabel("bound_any_path_s", "Time that any joint path takes at least", "s", 1),
    MetricLabel("bound_gap_fraction", "  longer than that by at most", "%", 2, 100, "down"),
    MetricLabel("print_time_s", "Whole print, travel included", "s", 1, better="down"),
    MetricLabel("sigma_min", "Distance from singularity: least singular value σ", "", 4, better="up"),
    MetricLabel("wrist_margin_deg", "Wrist: least angle of joint 5 from straight", "°", 1, better="up"),
    MetricLabel("joint_limit_margin_deg", "Least distance from a joint's end stop", "°", 1, better="up"),
    MetricLabel("rail_margin_mm", "Least distance of what slides from its end", "mm", 1, better="up"),
    MetricLabel("velocity_ratio_max", "Joint speed, worst share of its limit", "%", 1, 100, "down", 100),
    MetricLabel("acceleration_ratio_max", "Joint acceleration, worst share of its limit", "%", 1, 100, "down", 100),
    MetricLabel("jerk_ratio_max", "Joint jerk, worst share of its limit", "%", 1, 100, "down", 100),
    MetricLabel("position_error_max_mm", "Tip off the planned line, worst", "mm", 4, better="down"),
    MetricLabel("axis_error_max_deg", "Nozzle axis off the surface normal, worst", "°", 4, better="down"),
    MetricLabel("file_normal_max_deg", "Nozzle axis off the file’s own normals, worst", "°", 3, better="down"),
    MetricLabel("tilt_max_deg", "Nozzle leans from the surface normal, at most", "°", 2, better="down"),
    MetricLabel("tilt_bead_error_max_mm", "  that leaves a bead's edges off its height by", "mm", 4, better="down"),
    MetricLabel("path_deviation_max_mm", "Rounded corners: off the drawn path, worst", "mm", 3, better="down"),
    MetricLabel("clearance_min_mm", "Least distance of anything from anything, beyond the tip", "mm", 1, better="up"),
    MetricLabel("nozzle_clearance_min_mm", "  of nozzle and print head from part and print", "mm", 1, better="up"),
    MetricLabel("arm_clearance_min_mm", "  of the robots’ links from part and print", "mm", 1, better="up"),
    MetricLabel("robot_clearance_min_mm", "  of robots and fixtures from each other", "mm", 1, better="up"),
    MetricLabel("nozzle_pressed_max_mm", "Nozzle presses into beads printed before, at most", "mm", 3, better="down"),
    MetricLabel("tip_clearance_min_mm", "Nozzle tip above the bare part, least", "mm", 1, better="up"),
    MetricLabel("branch_changes_in_deposition", "Changes of the arm's branch while depositing", "", 0, better="down"),
    MetricLabel("deposited_length_mm", "Length deposited", "m", 2, 1e-3),
    MetricLabel("flow_error_max", "Material in a millimetre of a bead: off by at most", "%", 2, 100, "down"),
    MetricLabel("over_extruded_mm3", "Too much material, where speed dips", "mm³", 2, better="down"),
    MetricLabel("lag_zone_mm", "Length not judged by that, where pressure rises or falls", "mm", 0),
    MetricLabel("extruded_mm", "Filament used", "m", 2, 1e-3),
    MetricLabel("extruded_volume_mm3", "Material deposited", "cm³", 2, 1e-3),
)
# metric → its name where there is little room; the long one stands in METRICS
SHORT = {
    "at_speed_fraction": "At commanded speed",
    "speed_min_mm_s": "Slowest",
    "deposition_time_s": "Depositing",
    "print_time_s": "Whole print",
    "sigma_min": "Singularity σ",
    "joint_limit_margin_deg": "To an end stop",
    "clearance_min_mm": "Clearance",
    "velocity_ratio_max": "Joint speed / limit",
    "acceleration_ratio_max": "Acceleration / limit",
    "jerk_ratio_max": "Jerk / limit",
    "path_deviation_max_mm": "Corners off the drawing",
    "over_extruded_mm3": "Too much material",
}

CHECK_NAMES = str.maketrans("_", " ")


def with_ratios(metrics: Mapping[str, float]) -> dict[str, float]:
    """Metrics, and how the deposition time compares with what it would be at best, where both are known."""
    out = dict(metrics)
    for ratio, best in ((OVER_IDEAL, "ideal_deposition_time_s"), (OVER_BOUND, "bound_deposition_time_s")):
        if out.get(best, 0.0) > 0.0 and "deposition_time_s" in out:
            out[ratio] = out["deposition_time_s"] / out[best]
    return out


def number(value: float | None, digits: int) -> str:
    """A number with `digits` decimals and thousands apart; tiny but not zero is said to be so."""
    if value is None or math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if 0 < abs(value) < 0.5 * 10**-digits:
        return f"<\u2009{10**-digits:.{digits}f}"
    return f"{value:,.{digits}f}".replace(",", "\u202f").replace("-", "−")


def distance(key: str, value: float, digits: int) -> str:
    """A metric's value; a distance [mm] of bodies as far as the verifier looks is told as the bound that it is."""
    bound = key.endswith("clearance_min_mm") and key != "tip_clearance_min_mm" and value >= FARTHEST
    return f"≥\u2009{number(value, digits)}" if bound else number(value, digits)


def counted(count: float, one: str) -> str:
    """A count with its noun: 1 layer, 10 layers."""
    return f"{number(count, 0)} {one}{'' if count == 1 else 's'}"


def resumed_words(plan: Plan) -> str:
    """What a plan of a resumed print leaves out."""
    last = plan.first_bead - 1
    before = "bead 0" if last == 0 else f"beads 0 to {last}"
    return f"resumed at bead {plan.first_bead} of {len(plan.toolpath.beads)}, {before} taken to be there"


def significant(value: float, digits: int = 4) -> str:
    """A number with `digits` significant digits, without a needless exponent."""
    if math.isnan(value) or math.isinf(value):
        return number(value, 0)
    return f"{value:.{digits}g}".replace("-", "−")


def duration(seconds: float | None) -> str:
    """A time span in words: 42.1 s, 3 min 05 s, 2 h 04 min."""
    if seconds is None or not math.isfinite(seconds):
        return MISSING
    if seconds < 60:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def summary_rows(columns: Sequence[Mapping[str, float]]) -> list[tuple[MetricLabel, list[tuple[str, bool, bool]]]]:
    """Every metric that a column has, with what each shows: text, whether it is over the limit, whether it is best."""
    columns = [with_ratios(column) for column in columns]
    rows = []
    for metric in METRICS:
        values = [_scaled(column.get(metric.key), metric) for column in columns]
        best = _best(values, metric)
        cells = [
            (
                MISSING if value is None else distance(metric.key, value, metric.digits),
                value is not None and round(value, 6) > metric.limit,
                k in best,
            )
            for k, value in enumerate(values)
        ]
        if any(value is not None for value in values):
            rows.append((metric, cells))
    return rows


def _scaled(value: float | None, metric: MetricLabel) -> float | None:
    return None if value is None or math.isnan(value) else float(value) * metric.scale


def _best(values: list[float | None], metric: MetricLabel) -> set[int]:
    """Columns that show the best value, unless all show the same."""
    shown = {i: round(value, metric.digits) for i, value in enumerate(values) if value is not None}
    if not metric.better or len(set(shown.values())) < 2:
        return set()
    best = max(shown.values()) if metric.better == "up" else min(shown.values())
    return {i for i, value in shown.items() if value == best}
