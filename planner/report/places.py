"""The worst places of a plan: what is worst there, how bad, when and where."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.report.scene import MARK_OUT_MM, Place

if TYPE_CHECKING:
    from planner.plan import Plan

Array = NDArray[np.float64]
AT_SPEED = 0.98


def worst_places(plan: Plan) -> list[Place]:
    """Places while depositing: slowest, nearest to a singularity and to an end stop, hardest on the joints, leaning most."""
    traj, series = plan.trajectory, plan.series
    printing = np.flatnonzero(traj.deposit)
    if not len(printing):
        return []
    found: list[tuple[str, str, int]] = []
    commanded = plan.problem.process.speed * 1e3
    speed = traj.speed * 1e3
    i = int(printing[speed[printing].argmin()])
    if speed[i] < AT_SPEED * commanded:
        found.append(("Slowest", f"{speed[i]:.2f} mm/s of {commanded:g} mm/s", i))
    for name, what, words in (
        ("sigma", "Nearest to a singularity", "σ {:.4f}"),
        ("wrist_deg", "Wrist nearest to straight", "{:.1f}°"),
        ("limit_margin_deg", "Nearest to an end stop", "{:.1f}°"),
    ):
        if name in series and np.isfinite(series[name][printing]).any():
            i = int(printing[np.nanargmin(series[name][printing])])
            value = words.format(series[name][i])
            found.append((what, value + (_stop(plan, i) if name == "limit_margin_deg" else ""), i))
    for name, what in (
        ("velocity_ratio", "Most of a joint's speed"),
        ("acceleration_ratio", "Most of a joint's acceleration"),
        ("jerk_ratio", "Most of a joint's jerk"),
    ):
        if name in series and np.isfinite(series[name][printing]).any():
            values = np.abs(series[name])
            each = values if values.ndim == 1 else np.where(np.isnan(values), -np.inf, values).max(axis=1)
            i = int(printing[np.nanargmax(each[printing])])
            joint = "" if values.ndim == 1 else f" ({plan.cell.joint_names[int(np.nanargmax(values[i]))]})"
            found.append((what, f"{100 * each[i]:.1f} % of the limit{joint}", i))
    if "tilt_deg" in series:
        i = int(printing[series["tilt_deg"][printing].argmax()])
        found.append(("Nozzle leans most", f"{series['tilt_deg'][i]:.2f}° from the normal", i))
    out = traj.tip * 1e3 - MARK_OUT_MM * traj.axis
    return [Place("ABCDEFGHIJ"[k], what, value, i, out[i]) for k, (what, value, i) in enumerate(found)]


def where_words(plan: Plan, sample: int) -> str:
    """A sample's whereabouts in words: bead, layer, how far along, and the point in the part frame."""
    traj = plan.trajectory
    x, y, z = traj.tip[sample] * 1e3
    line = f"bead {traj.bead[sample]}, layer {traj.layer[sample] + 1}, {traj.s[sample] * 1e3:.1f} mm along it"
    return f"{line}; x {x:.1f}, y {y:.1f}, z {z:.1f} mm".replace("-", "−")


def _stop(plan: Plan, sample: int) -> str:
    """Name of the joint that is nearest to its end stop."""
    limits, q = plan.cell.limits, plan.trajectory.q[sample]
    margin = np.minimum(q - limits.q_min, limits.q_max - q)
    return f" ({plan.cell.joint_names[int(margin.argmin())]})"
