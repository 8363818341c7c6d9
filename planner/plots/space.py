"""The print on its part, in three dimensions."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from planner.errors import InputError, nearest_name
from planner.plan import Plan
from planner.plots.style import FAINT, MAP
from planner.readonly import Array

MEASURES = {"speed": "speed, mm/s", "sigma": "singular value σ", "layer": "layer", "bead": "bead"}
MOST_SEGMENTS = 12_000  # more is slow to draw, and no finer to look at
MOST_TRIANGLES = 6_000  # of the part: a finer one is not drawn
_SLOWER = 0.9  # of the commanded speed: the colours reach down to there at least
_PART_ALPHA = 0.25
_LARGEST_PART = 4.0  # times the print: a larger part would leave it no room
_FLATTEST = 0.3  # of its greatest extent, that is left for each side of a print


def toolpath(plan: Plan, ax: Any = None, measure: str = "speed") -> Any:
    """What is deposited, in the part frame, coloured by a measure: "speed", "sigma", "layer" or "bead".

    ax: axes with projection="3d"; new ones, if none are given.
    """
    if measure not in MEASURES:
        near = nearest_name(measure, MEASURES)
        hint = f"did you mean {near}?" if near else f"one of {', '.join(MEASURES)}"
        raise InputError(f"there is no measure {measure!r}", hint=hint)
    if ax is None:
        ax = plt.figure(figsize=(7.0, 5.5), layout="constrained").add_subplot(projection="3d")
    values = _values(plan, measure)
    every = max(1, int(np.ceil(plan.deposit.sum() / MOST_SEGMENTS)))
    rows = np.flatnonzero(plan.deposit)[::every]
    points = plan.tip[rows] * 1e3
    joined = plan.bead[rows][1:] == plan.bead[rows][:-1]
    segments = np.stack([points[:-1], points[1:]], axis=1)[joined]
    lines = Line3DCollection(list(segments), cmap=MAP, linewidths=1.6)
    lines.set_array(np.minimum(values[rows][1:], values[rows][:-1])[joined])
    if measure == "speed":  # else rounding would be stretched over all colours
        commanded = plan.problem.process.speed * 1e3
        lines.set_clim(min(float(values[rows].min()), _SLOWER * commanded), commanded)
    part = _part(plan, points)
    if len(part):
        ax.add_collection3d(Poly3DCollection(list(part), facecolor=FAINT, edgecolor="none", alpha=_PART_ALPHA))
    ax.add_collection3d(lines)
    shown = np.concatenate([points, part.reshape(-1, 3)])
    low, high = shown.min(axis=0), shown.max(axis=0)
    room = np.maximum(high - low, _FLATTEST * float((high - low).max()))
    for k, name in enumerate("xyz"):
        middle = 0.5 * (low[k] + high[k])
        getattr(ax, f"set_{name}lim")(middle - 0.55 * room[k], middle + 0.55 * room[k])
        getattr(ax, f"set_{name}label")(f"{name}, mm")
        getattr(ax, f"{name}axis").set_major_locator(MaxNLocator(3))
        getattr(ax, f"{name}axis").pane.set_visible(False)
    ax.grid(False)
    ax.set_box_aspect(room)
    _look_at(ax, -plan.axis[rows].mean(axis=0))
    ax.figure.colorbar(lines, ax=ax, label=MEASURES[measure], shrink=0.6, pad=0.1)
    return ax


def _values(plan: Plan, measure: str) -> Array:
    if measure == "sigma":
        return plan.series["sigma"]
    by_name = {"speed": plan.speed * 1e3, "layer": plan.trajectory.layer, "bead": plan.bead}
    return np.asarray(by_name[measure], dtype=float)


def _part(plan: Plan, points: Array) -> Array:
    """The part's triangles (n, 3, 3) [mm], if it has a shape of its own: neither too fine nor far larger than the print."""
    shape = plan.toolpath.shape
    if shape is None or len(shape.triangles) > MOST_TRIANGLES:
        return np.empty((0, 3, 3))
    corners = np.asarray(shape.vertices)[np.asarray(shape.triangles)] * 1e3
    large = np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)) > _LARGEST_PART * np.linalg.norm(
        np.ptp(points, axis=0)
    )
    return np.empty((0, 3, 3)) if large else corners


def _look_at(ax: Any, normal: Array) -> None:
    """From outside, where most of the print faces."""
    across = float(np.hypot(normal[0], normal[1]))
    azimuth = np.degrees(np.arctan2(normal[1], normal[0])) if across > 0.15 else -60.0
    ax.view_init(elev=20.0 if abs(normal[2]) < 0.5 else 45.0, azim=azimuth + 14.0)
