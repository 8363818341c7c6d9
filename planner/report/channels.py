"""What beads can be coloured by: values along them, and classes of values, each with its colour.

Classes are few and labelled by their ends: if nearly all of a print has one value, a smooth scale would show nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.plan.by_layer import AGES
from planner.report.extruder import even_flow, surplus
from planner.report.page import coarse

if TYPE_CHECKING:
    from planner.plan import Plan

# The verifier's series with their labels, units and decimals; small values are tight.
TIGHT = (
    ("sigma", "Singularity margin, σ", "", 3),
    ("wrist_deg", "Wrist margin, joint 5 from straight", "°", 1),
    ("limit_margin_deg", "Joint range, to the nearest end stop", "°", 1),
    ("clearance_mm", "Least distance of two bodies beyond the tip", "mm", 1),
)
RATIOS = ("velocity_ratio", "acceleration_ratio", "jerk_ratio")
SPEEDS = (0.5, 0.75, 0.9, 0.98)  # shares of the commanded speed at which classes of speed end
SHARES = (0.05, 0.2, 0.4, 0.6, 0.8)  # shares of the deposited samples, from the tight end, at which other classes end
WORDS = "red: the tightest 5 % of what is laid"
FEW_LAYERS = 6
MOST_ALIKE = 0.5  # share of the deposited samples in one class: the initial colouring shows more differences than that


def channels(plan: Plan, kept: NDArray[np.intp]) -> list[dict[str, Any]]:
    """What beads can be coloured by at samples `kept`; `first` marks the initial colouring.

    Each has `key`, `label`, `unit`, `digits`, `values`; `min` and `max` of these; `edges` (k + 1) of its classes; and
    `bad`, the end at which values are tight.
    """
    if not len(kept):
        return []
    traj = plan.trajectory
    out = [_speed(plan, kept)]
    for name, label, unit, digits in TIGHT:
        values = plan.series[name][kept] if name in plan.series else np.empty(0)
        if np.isfinite(values).any():
            out.append(_channel(name, label, unit, values, "low", digits=digits))
    ratios = [plan.series[name][kept] for name in RATIOS if name in plan.series]
    if ratios:
        used = 100.0 * np.where(np.isfinite(most := np.max(ratios, axis=0)), most, 0.0)
        out.append(_channel("load", "Joint limits used", "%", used, "high", 0.0, digits=0))
    if "tilt_deg" in plan.series:
        lean = plan.series["tilt_deg"][kept]
        out.append(_channel("tilt_deg", "Nozzle off the surface normal", "°", lean, "high", 0.0, digits=2))
    over = surplus(plan)
    if over is not None:
        share, most = over[kept], max(float(over[kept].max()), 1.0)
        out.append(_channel("surplus", "Too much material, share of what flows", "%", share, "high", 0.0, most))
    flow = even_flow(traj)[kept] * 1e9
    if np.ptp(flow) > 0:
        out.append(_channel("flow", "Flow of material", "mm³/s", flow, "low", digits=2))
    if layers := int(np.ptp(traj.layer[kept])):
        first = int(traj.layer[kept].min()) + 1
        ends = None if layers >= FEW_LAYERS else [first + k + 0.5 for k in range(layers)]
        out.append(_channel("layer", "Layer", "", traj.layer[kept] + 1.0, "none", digits=0, inner=ends))
    ages = _ages(plan, kept)
    out += [] if ages is None else [ages]
    shown = next((k for k, each in enumerate(out) if _most_alike(each) < MOST_ALIKE), 0)
    return [{**each, "first": k == shown} for k, each in enumerate(out)]


def _speed(plan: Plan, kept: NDArray[np.intp]) -> dict[str, Any]:
    """The tip's speed; if beads have different commanded speeds, its share of each bead's own."""
    commanded = plan.commanded[plan.trajectory.bead[kept]] * 1e3
    speed = plan.trajectory.speed[kept] * 1e3
    label, unit, whole = "Tip speed", "mm/s", float(commanded[0])
    if np.ptp(commanded) > 0.0:
        label, unit, whole, speed = "Tip speed, of the bead's own", "%", 100.0, 100.0 * speed / commanded
    low, high = min(float(speed.min()), 0.9 * whole), max(float(speed.max()), whole)
    return _channel("speed", label, unit, speed, "low", low, high, inner=[share * whole for share in SPEEDS])


def _ages(plan: Plan, kept: NDArray[np.intp]) -> dict[str, Any] | None:
    """Age of the material below; classes also end at the required window. None if nothing lies on anything."""
    values = plan.series[AGES][kept] if AGES in plan.series else np.empty(0)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    spec, inner = plan.problem.process.interlayer_time, None
    if spec is not None:
        even = np.round(np.quantile(finite, [k / 4 for k in range(1, 4)]), 1).tolist()
        inner = [*even, *(edge for edge in (spec.least, spec.most) if edge is not None)]
    return _channel(AGES, "Age of the material below, interlayer time", "s", values, "none", inner=inner)


def edges_of(values: Array, inner: Sequence[float] | None, bad: str, digits: int) -> Array:
    """Ends of classes of values (n), ascending: at `inner`, or such that the tightest values are a separate class."""
    finite = values[np.isfinite(values)]
    if inner is None:
        shares = [1.0 - share for share in SHARES] if bad == "high" else list(SHARES)
        if bad == "none":
            shares = [k / 6 for k in range(1, 6)]
        inner = np.round(np.quantile(finite, sorted(shares)), digits).tolist()
    low, high = float(finite.min()), float(finite.max())
    between = np.unique([edge for edge in inner if low < edge < high])
    return np.array([low, *between, high])


def _most_alike(channel: dict[str, Any]) -> float:
    """The share of the deposited samples in the largest class."""
    return float(max(channel["shares"]))


def _channel(
    key: str,
    label: str,
    unit: str,
    values: NDArray[np.floating[Any]],
    bad: str,
    low: float | None = None,
    high: float | None = None,
    *,
    digits: int = 1,
    inner: Sequence[float] | None = None,
) -> dict[str, Any]:
    finite = values[np.isfinite(values)]
    least = float(finite.min()) if low is None else low
    most = max(float(finite.max()) if high is None else high, least + 1e-6)
    edges = edges_of(np.asarray(values, dtype=np.float64), inner, bad, digits)
    count = np.bincount(np.searchsorted(edges[1:-1], finite, side="right"), minlength=len(edges) - 1)
    return {
        "key": key,
        "label": label,
        "unit": unit,
        "values": coarse(np.asarray(values, dtype=np.float64)),
        "min": least,
        "max": most,
        "edges": edges.tolist(),
        "shares": (count / len(finite)).tolist(),
        "bad": bad,
        "digits": digits,
        "words": WORDS if inner is None and bad != "none" else "",
    }
