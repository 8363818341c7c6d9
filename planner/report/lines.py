"""Lines of beads for the scene: points and normals in the part frame, thinned, with what they can be coloured by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.readonly import Array
from planner.report.extruder import even_flow, surplus
from planner.report.packing import coarse
from planner.report.thinning import SCENE_BUDGET, keep_minima, stretches, turning

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.toolpath.bead import Bead


EVEN = 127  # steps of a component of a unit vector
# What series of the verifier say, and in which unit; where these are small it gets tight.
TIGHT = (
    ("sigma", "Distance from singularity, σ", "", 4),
    ("wrist_deg", "Wrist: joint 5 from straight", "°", 1),
    ("limit_margin_deg", "Distance from the nearest end stop", "°", 1),
    ("clearance_mm", "Least distance of two bodies beyond the tip", "mm", 1),
)


def plan_lines(plan: Plan) -> dict[str, Any]:
    """What is laid, by time: `point`, `normal`, `sample` and `along` of the points; `first`, `bead`, `layer` of the lines."""
    traj = plan.trajectory
    kept, starts = _kept_samples(plan)
    first = np.flatnonzero(starts)
    return {
        **_geometry(traj.tip[kept], -traj.axis[kept], first),
        "sample": kept.astype(np.int32),
        "along": coarse(traj.s[kept] * 1e3),
        "bead": traj.bead[kept[first]].astype(np.int32),
        "layer": traj.layer[kept[first]].astype(np.int32),
        "channels": _channels(plan, kept),
    }


def bead_lines(beads: Sequence[Bead], budget: int) -> dict[str, Any]:
    """Beads as they are planned, of which no motion is shown: `point`, `normal` and `first`."""
    points = np.concatenate([bead.points for bead in beads] or [np.zeros((0, 3))])
    normals = np.concatenate([bead.normals for bead in beads] or [np.zeros((0, 3))])
    last = np.cumsum([len(bead.points) for bead in beads], dtype=np.intp) - 1
    first = last + 1 - np.array([len(bead.points) for bead in beads], dtype=np.intp)
    if not len(points):
        return _geometry(points, normals, first)
    sharp = turning(points, first, last)
    kept = keep_minima([-sharp, np.zeros(len(points))], budget, np.union1d(first, last))
    return _geometry(points[kept], normals[kept], np.flatnonzero(np.isin(kept, first)))


def _geometry(points: Array, normals: Array, first: NDArray[np.intp]) -> dict[str, Any]:
    return {
        "point": [coarse(points[:, k]) for k in range(3)],
        "normal": np.round(normals * EVEN).astype(np.int8).ravel(),
        "first": first.astype(np.int32),
    }


def _kept_samples(plan: Plan) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Samples of deposition to draw, in order, and which of them start a new line."""
    traj = plan.trajectory
    index, begin, end = stretches(traj.deposit, traj.bead)
    if not len(index):
        return index, np.empty(0, dtype=bool)
    sharp = turning(traj.tip[index], begin, end)
    signals = [traj.speed[index], -sharp, np.zeros(len(index))]
    signals += [
        plan.series[name][index] for name in ("sigma", "limit_margin_deg", "clearance_mm") if name in plan.series
    ]
    kept = keep_minima(signals, SCENE_BUDGET, np.union1d(begin, end))
    starts = np.zeros(len(index), dtype=bool)
    starts[begin] = True
    return index[kept], starts[kept]


def _channels(plan: Plan, kept: NDArray[np.intp]) -> list[dict[str, Any]]:
    """What beads can be coloured by, with the ends of the scale; `bad` says at which of them it gets tight."""
    if not len(kept):
        return []
    traj = plan.trajectory
    commanded = plan.problem.process.speed * 1e3
    speed = traj.speed[kept] * 1e3
    low, high = min(float(speed.min()), 0.9 * commanded), max(float(speed.max()), commanded)
    out: list[dict[str, Any]] = [_channel("speed", "Tip speed", "mm/s", speed, "low", low, high, 1)]
    for name, label, unit, digits in TIGHT:
        values = plan.series[name][kept] if name in plan.series else np.empty(0)
        if np.isfinite(values).any():
            out.append(_channel(name, label, unit, values, "low", digits=digits))
    if "tilt_deg" in plan.series:
        lean = plan.series["tilt_deg"][kept]
        out.append(_channel("tilt_deg", "Nozzle off the surface normal", "°", lean, "high", 0.0, digits=2))
    over = surplus(plan)
    if over is not None:
        share, most = over[kept], max(float(over[kept].max()), 1.0)
        out.append(_channel("surplus", "Too much material, share of what flows", "%", share, "high", 0.0, most, 1))
    flow = even_flow(traj)[kept] * 1e9
    if np.ptp(flow) > 0:
        out.append(_channel("flow", "Flow of material", "mm³/s", flow, "low", digits=2))
    if np.ptp(traj.layer[kept]):
        out.append(_channel("layer", "Layer", "", traj.layer[kept] + 1.0, "high", digits=0))
    return out


def _channel(
    key: str,
    label: str,
    unit: str,
    values: NDArray[np.floating[Any]],
    bad: str,
    low: float | None = None,
    high: float | None = None,
    digits: int = 1,
) -> dict[str, Any]:
    finite = values[np.isfinite(values)]
    least = float(finite.min()) if low is None else low
    most = max(float(finite.max()) if high is None else high, least + 1e-6)
    return {
        "key": key,
        "label": label,
        "unit": unit,
        "values": coarse(np.asarray(values, dtype=np.float64)),
        "min": least,
        "max": most,
        "bad": bad,
        "digits": digits,
    }
