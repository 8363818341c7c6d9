"""The roll × path map as a picture."""

from __future__ import annotations

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from planner.errors import InputError, nearest_name
from planner.plots.style import INK, MAP, SOFT, axes_of
from planner.readonly import Array
from planner.resolve.roll_map import COLLISION, LIMITS, REACH, SINGULAR, RollMap

# measure → label, factor
MEASURES = {
    "sigma": ("least singular value σ", 1.0),
    "limit": ("angle from an end stop, deg", 180.0 / np.pi),
    "clearance": ("clearance beyond need, mm", 1e3),
}
# reason → grey, hatch: told apart without colour
AREAS = {
    REACH: ("#f4f6f9", "."),
    LIMITS: ("#e3e8ee", "///"),
    SINGULAR: ("#cdd5dd", "xxx"),
    COLLISION: ("#f3d9d2", "\\\\\\"),
}


def redundancy_map(roll_map: RollMap, ax: Axes | None = None, measure: str = "sigma") -> Axes:
    """Draw what the roll may be along the path, coloured by a measure (light is tight), hatched where it may not be.

    measure: "sigma", "limit" or "clearance". The line is the roll that was chosen, if there is one.
    """
    if measure not in MEASURES:
        near = nearest_name(measure, MEASURES)
        hint = f"did you mean {near}?" if near else f"one of {', '.join(MEASURES)}"
        raise InputError(f"there is no measure {measure!r}", hint=hint)
    label, factor = MEASURES[measure]
    ax = axes_of(ax, figsize=(9.0, 3.6))
    x = _edges(roll_map.along * 1e3)
    step = np.degrees(roll_map.roll[1] - roll_map.roll[0])
    y = np.degrees(roll_map.roll[0]) + step * (np.arange(len(roll_map.roll) + 1) - 0.5)
    values = np.where(roll_map.free, getattr(roll_map, measure) * factor, np.nan)
    shown = ax.pcolormesh(x, y, values.T, cmap=MAP, rasterized=True)
    if np.isfinite(values).any():
        ax.figure.colorbar(shown, ax=ax, label=label, pad=0.02)
    legend = []
    for why, (grey, hatch) in AREAS.items():
        here = roll_map.why == why
        if not here.any():
            continue
        area = np.concatenate([here, here[:, :1]], axis=1)  # once round the circle
        rolls = np.append(np.degrees(roll_map.roll), np.degrees(roll_map.roll[0]) + 360.0)
        ax.contourf(roll_map.along * 1e3, rolls, area.T, levels=[0.5, 1.5], colors=[grey], hatches=[hatch])
        legend.append(Patch(facecolor=grey, edgecolor=SOFT, hatch=hatch, label=roll_map.reasons[why]))
    _draw_chosen(ax, roll_map)
    ax.set_xlim(x[0], x[-1])
    ax.set_ylim(-180.0, 180.0)
    ax.set_yticks(range(-180, 181, 90))
    ax.set_xlabel("deposited length, mm")
    ax.set_ylabel("roll about the nozzle, deg")
    if legend:
        ax.legend(handles=legend, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(legend), frameon=False)
    return ax


def _edges(at: Array) -> Array:
    """Edges of columns (m + 1) that stand at ascending places (m)."""
    middle = 0.5 * (at[1:] + at[:-1])
    return np.concatenate([at[:1], middle, at[-1:]])


def _draw_chosen(ax: Axes, roll_map: RollMap) -> None:
    """The chosen roll, broken where it goes round the circle and between beads."""
    roll = np.degrees(roll_map.chosen)
    if np.isnan(roll).all():
        return
    broken = np.flatnonzero((np.abs(np.diff(roll)) > 180.0) | (np.diff(roll_map.bead) != 0)) + 1
    x, y = np.insert(roll_map.along * 1e3, broken, np.nan), np.insert(roll, broken, np.nan)
    outline = [effects.Stroke(linewidth=4.0, foreground=INK), effects.Normal()]
    ax.plot(x, y, color="white", linewidth=2.0, path_effects=outline, solid_capstyle="round", label="chosen roll")
