"""Words of the report: metrics with readable labels and units, numbers as people read them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.plan import Plan

MISSING = "–"
FARTHEST = 50.0  # mm: the verifier searches no farther for close bodies, so this distance is a lower bound
STRAIGHTEST = 10_000.0  # mm: the verifier does not distinguish larger steering radii


@dataclass(frozen=True)
class MetricLabel:
    """A metric as it is shown: `scale` turns its value into `unit`; `better` is up, down or empty."""

    key: str
    label: str
    unit: str
    digits: int
    scale: float = 1.0
    better: str = ""
    limit: float = math.inf


OVER_IDEAL, OVER_BOUND = "deposition_over_ideal", "deposition_over_bound"  # ratios of metrics, computed here
# One name for a figure wherever it is shown; if a check judges it, the name of that check.
METRICS = (
    MetricLabel("at_speed_fraction", "length at commanded speed (±2 %)", "%", 2, 100, "up"),
    MetricLabel("speed_min_mm_s", "slowest in deposition", "mm/s", 2, better="up"),
    MetricLabel("speed_max_mm_s", "speed in deposition", "mm/s", 2),
    MetricLabel("print_time_s", "print time", "s", 1, better="down"),
    MetricLabel("interlayer_time_min_s", "interlayer time at least", "s", 1),
    MetricLabel("interlayer_time_median_s", "interlayer time, median", "s", 1),
    MetricLabel("interlayer_time_max_s", "interlayer time at most", "s", 1),
    MetricLabel("deposition_time_s", "deposition time", "s", 1, better="down"),
    MetricLabel("ideal_deposition_time_s", "deposition time without dips", "s", 1),
    MetricLabel(OVER_IDEAL, "deposition over that without dips", "×", 3, better="down"),
    MetricLabel("bound_deposition_time_s", "deposition time without jerk limits", "s", 1),
    MetricLabel(OVER_BOUND, "deposition over that without jerk limits", "×", 3, better="down"),
    MetricLabel("bound_any_path_s", "deposition time of any joint path, at least", "s", 1),
    MetricLabel("bound_gap_fraction", "deposition longer than any joint path's, at most", "%", 2, 100, "down"),
    MetricLabel("sigma_min", "singularity margin", "", 4, better="up"),
    MetricLabel("wrist_margin_deg", "wrist margin", "°", 1, better="up"),
    MetricLabel("joint_limit_margin_deg", "joint range", "°", 1, better="up"),
    MetricLabel("rail_margin_mm", "rail range", "mm", 1, better="up"),
    MetricLabel("velocity_ratio_max", "joint velocity", "%", 1, 100, "down", 100),
    MetricLabel("acceleration_ratio_max", "joint acceleration", "%", 1, 100, "down", 100),
    MetricLabel("jerk_ratio_max", "joint jerk", "%", 1, 100, "down", 100),
    MetricLabel("position_error_max_mm", "tip on the path", "mm", 4, better="down"),
    MetricLabel("axis_error_max_deg", "axis on the normal", "°", 4, better="down"),
    MetricLabel("file_normal_max_deg", "axis near the file's normals", "°", 3, better="down"),
    MetricLabel("tilt_max_deg", "lean of the nozzle", "°", 2, better="down"),
    MetricLabel("tilt_bead_error_max_mm", "bead's edges off their height by the lean", "mm", 4, better="down"),
    MetricLabel("path_deviation_max_mm", "path within corner tolerance", "mm", 3, better="down"),
    MetricLabel("bead_crossings", "beads cross nowhere", "places", 0, better="down"),
    MetricLabel("clearance_min_mm", "least clearance", "mm", 1, better="up"),
    MetricLabel("nozzle_clearance_min_mm", "nozzle clear of part and print", "mm", 1, better="up"),
    MetricLabel("arm_clearance_min_mm", "arm clear of part and print", "mm", 1, better="up"),
    MetricLabel("robot_clearance_min_mm", "robots clear of each other and of fixtures", "mm", 1, better="up"),
    MetricLabel("nozzle_pressed_max_mm", "print pressed by the nozzle", "mm", 3, better="down"),
    MetricLabel("print_off_max_mm", "scanned print off the drawing", "mm", 3),
    MetricLabel("print_left_off_max_mm", "last layer off the drawing", "mm", 3, better="down"),
    MetricLabel("over_print_error_max_mm", "nozzle over the print", "mm", 3, better="down"),
    MetricLabel("tip_clearance_min_mm", "nozzle tip outside the part", "mm", 1, better="up"),
    MetricLabel("branch_changes_in_deposition", "branch changes in deposition", "", 0, better="down"),
    MetricLabel("deposited_length_mm", "length deposited", "m", 2, 1e-3),
    MetricLabel("flow_error_max", "flow per millimetre", "%", 2, 100, "down"),
    MetricLabel("even_flow_fraction", "millimetres with even flow", "%", 2, 100, "up"),
    MetricLabel("over_extruded_mm3", "too much material in dips", "mm³", 2, better="down"),
    MetricLabel("lag_zone_mm", "length not judged by flow per millimetre", "mm", 0),
    MetricLabel("steering_radius_min_mm", "steering radius of the fibre", "mm", 1, better="up"),
    MetricLabel("extruded_mm", "filament", "m", 2, 1e-3),
    MetricLabel("extruded_volume_mm3", "material deposited", "cm³", 2, 1e-3),
)

RECORD = "record"
# What is judged, by subject: names of metrics and checks. Those in no group are about the record.
GROUPS = {
    "speed and time": (
        "length at commanded speed (±2 %)",
        "slowest in deposition",
        "speed in deposition",
        "speed in travel",
        "print time",
        "time of a layer",
        "pauses before layers",
        "interlayer time at least",
        "interlayer time, median",
        "interlayer time at most",
        "deposition time",
        "deposition time without dips",
        "deposition over that without dips",
        "deposition time without jerk limits",
        "deposition over that without jerk limits",
        "deposition time of any joint path, at least",
        "deposition longer than any joint path's, at most",
    ),
    "motion": (
        "joint velocity",
        "joint acceleration",
        "joint jerk",
        "joint range",
        "rail range",
        "asked joint velocity",
        "asked joint range",
        "asked rail range",
        "singularity margin",
        "wrist margin",
        "branch changes in deposition",
        "continuity",
        "starts and ends at home",
        "nozzles changed at home",
    ),
    "geometry": (
        "tip on the path",
        "axis on the normal",
        "axis near the file's normals",
        "lean of the nozzle",
        "bead's edges off their height by the lean",
        "nozzle to gravity",
        "layer to gravity",
        "path within corner tolerance",
        "input path reached everywhere",
        "every bead complete",
        "order of beads",
        "beads cross nowhere",
        "lines around the first layer",
        "beads as wide and high as asked",
        "begins above the scanned layer",
        "nozzle over the print",
        "asked as learned",
        "asked off the plan",
        "scanned print off the drawing",
        "last layer off the drawing",
        "layers on the part",
        "nozzle normal to the part",
        "beads within the part",
        "layers filled",
        "layers as dense as asked",
        "print on the drawn path",
        "drawn path left out",
        "length deposited",
    ),
    "clearance": (
        "least clearance",
        "nozzle clear of part and print",
        "arm clear of part and print",
        "robots clear of each other and of fixtures",
        "asked nozzle clear of part and print",
        "asked arm clear of part and print",
        "asked robots clear of each other and of fixtures",
        "nozzle tip outside the part",
        "print pressed by the nozzle",
        "obstacles where the print is",
    ),
    "material": (
        "flow per millimetre",
        "millimetres with even flow",
        "length not judged by flow per millimetre",
        "material keeps pace",
        "extrusion balance",
        "filament fed",
        "primes, retracts and cuts as asked",
        "fibre as long as its bead",
        "steering radius of the fibre",
        "motor runs while a bead is laid",
        "too much material in dips",
        "material fed by its own tool",
        "rest for a change of material",
        "beads of the material asked for",
        "material deposited",
        "filament",
    ),
    RECORD: (
        "all numbers finite",
        "beads of the toolpath",
        "recorded poses",
        "recorded branch",
        "recorded times and beads",
        "recorded layers and lengths",
        "recorded speed",
        "programs repeat the plan",
        "as it was planned",
    ),
}

WHOLE = 1e7  # smaller numbers are written without an exponent

CHECK_NAMES = str.maketrans("_", " ")


def with_ratios(metrics: Mapping[str, float]) -> dict[str, float]:
    """Metrics, with the ratios of the deposition time to its ideal and its bound, where known."""
    out = dict(metrics)
    for ratio, best in ((OVER_IDEAL, "ideal_deposition_time_s"), (OVER_BOUND, "bound_deposition_time_s")):
        if out.get(best, 0.0) > 0.0 and "deposition_time_s" in out:
            out[ratio] = out["deposition_time_s"] / out[best]
    return out


def number(value: float | None, digits: int) -> str:
    """A number with `digits` decimals and separated thousands; a tiny nonzero one is shown as a bound."""
    if value is None or math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if 0 < abs(value) < 0.5 * 10**-digits:
        return f"<\u2009{10**-digits:.{digits}f}"
    return f"{value:,.{digits}f}".replace(",", "\u202f").replace("-", "−")


def distance(key: str, value: float, digits: int) -> str:
    """A metric's value; a distance or radius [mm] at the limit of the verifier's search is shown as a bound."""
    bound = key.endswith("clearance_min_mm") and key != "tip_clearance_min_mm" and value >= FARTHEST
    bound |= key == "steering_radius_min_mm" and value >= STRAIGHTEST
    return f"≥\u2009{number(value, digits)}" if bound else number(value, digits)


def counted(count: float, one: str) -> str:
    """A count with its noun: 1 layer, 10 layers."""
    return f"{number(count, 0)} {one}{'' if count == 1 else 's'}"


def resumed_words(plan: Plan) -> str:
    """What a resumed print leaves out, its first nozzle if they are exchanged, and the pause before its start."""
    last = plan.first_bead - 1
    before = "bead 0" if last == 0 else f"beads 0 to {last}"
    nozzle = f", {plan.begins_with} on the flange" if plan.begins_with else ""
    pause = plan.pause_left_out
    words = "before the start, as in the pause before layer"
    left = "" if pause is None else f"; {words} {pause.before_layer}: {pause.what}"
    return (
        f"resumed at bead {plan.first_bead} of {len(plan.toolpath.beads)}, {before} assumed to be printed{nozzle}{left}"
    )


def significant(value: float, digits: int = 4) -> str:
    """A number with `digits` significant digits, without an exponent if it is below ten million."""
    if math.isnan(value) or math.isinf(value):
        return number(value, 0)
    text = f"{value:.{digits}g}"
    return (f"{value:.0f}" if "e+" in text and abs(value) < WHOLE else text).replace("-", "−")


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
