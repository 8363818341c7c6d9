"""Plots of plans, for notebooks and papers: each takes matplotlib's axes, draws, and returns them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.patheffects as effects
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from planner.base.arrays import Array
from planner.base.errors import InputError, nearest_name
from planner.plan import Plan
from planner.report.joints import shown_units
from planner.report.places import without_stops, worst_first
from planner.report.scene import COLOURS as COLOURS_OF_SCENES
from planner.report.thinning import keep_minima, stretches, turning
from planner.resolve.joint_path import ORDERS, ByArcLength, by_arc_length, spline_of
from planner.resolve.roll_map import COLLISION, LIMITS, REACH, SINGULAR, RollMap

# ----------------------------------------------------------------------------------------------------
# Shared: colours that suit colour-blind eyes too, and axes if the caller gives none.

# Okabe and Ito, without their yellow, which is hard to see on white.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
STYLES = ("-", "--", "-.", ":")
INK, SOFT, FAINT, ALARM = "#1b2733", "#5b6b7b", "#d9e0e7", "#b5402f"
MAP = LinearSegmentedColormap.from_list("calm", COLOURS_OF_SCENES)  # as in the report: red is where it gets tight


def axes_of(ax: Axes | None, **figure: Any) -> Axes:
    """The axes given, or those of a new figure (`figure`: as for matplotlib.pyplot.subplots)."""
    if ax is not None:
        return ax
    return plt.subplots(layout="constrained", **figure)[1]


def legend_above(ax: Axes) -> None:
    """Put the legend in one row above the axes, where nothing is drawn."""
    count = len(ax.get_legend_handles_labels()[0])
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=count, frameon=False, fontsize=8)


def tidy(ax: Axes) -> Axes:
    """Remove the top and right spines."""
    ax.spines[["top", "right"]].set_visible(False)
    return ax


# ----------------------------------------------------------------------------------------------------
# Along a print: speed and its ceilings, path derivatives, joints within their ranges.

NAMES = ("velocity", "acceleration", "jerk")
RATES = ("|q′| v", "|q″| v²", "|q‴| v³")
MOST_NAMED = 3  # dips whose cause is written next to them
_APART, _LATE = 0.2, 0.75  # shares of the width: least distance of two names; beyond it, names are left of their places
_HIGHEST = 20.0  # × the commanded speed: higher ceilings are not drawn
_LEAST_SHARE = 1e-2  # share of a limit: less is not drawn
_ENDLESS = 720.0  # deg: a larger range is drawn as unlimited
_PER_SAMPLE = 4  # places evaluated between two samples of a task


def speed(plan: Plan, ax: Axes | None = None, bead: int | None = None) -> Axes:
    """The tip's speed while material flows, over time, or along one bead; its dips marked, the worst ones named.

    Args:
        plan: The plan to draw.
        ax: Axes to draw on; new ones by default.
        bead: Index of the bead, for its speed over arc length; by default, the whole print over time.

    Returns:
        The axes.

    Raises:
        InputError: If the plan does not lay this bead.
    """
    laid = plan.deposit if bead is None else plan.deposit & (plan.bead == _known(plan, bead))
    ax = tidy(axes_of(ax, figsize=(9.0, 2.8)))
    x = plan.t if bead is None else plan.s * 1e3
    y = np.where(laid, plan.speed * 1e3, np.nan)
    rows = np.flatnonzero(laid)
    window = slice(rows[0], rows[-1] + 1)
    commanded = np.where(laid, plan.commanded[plan.bead] * 1e3, np.nan)
    if np.ptp(commanded[laid]) > 0.0:
        ax.plot(x[window], commanded[window], color=SOFT, linestyle="--", linewidth=1.0, label="commanded")
    else:
        ax.axhline(commanded[rows[0]], color=SOFT, linestyle="--", linewidth=1.0, label="commanded")
    ax.plot(x[window], y[window], color=COLOURS[0], linewidth=1.2, label="reached")
    dips = worst_first([dip for dip in without_stops(plan.dips) if bead is None or dip.bead == bead])
    at = np.array([(dip.t if bead is None else dip.at_s * 1e3, dip.speed * 1e3) for dip in dips]).reshape(-1, 2)
    ax.scatter(at[:, 0], at[:, 1], s=22, color="white", edgecolor=ALARM, zorder=3, label=f"dips: {len(dips)}")
    _name_worst(ax, [(where, low, dip.cause) for dip, (where, low) in zip(dips, at.tolist(), strict=True)], x[window])
    ax.set_ylim(0.0, 1.15 * float(np.nanmax(y)))
    ax.set_xlabel("time, s" if bead is None else f"arc length along bead {bead}, mm")
    ax.set_ylabel("speed, mm/s")
    legend_above(ax)
    return ax


def _name_worst(ax: Axes, dips: Sequence[tuple[float, float, str]], x: Array) -> None:
    """Write the cause next to the first few dips (x, y, cause), except those too close to one that is named."""
    first, last = float(x[0]), float(x[-1])
    named: list[float] = []
    for where, low, cause in dips:
        if len(named) == MOST_NAMED:
            return
        if any(abs(where - other) < _APART * (last - first) for other in named):
            continue
        named.append(where)
        right = where > first + _LATE * (last - first)
        ax.annotate(
            cause, (where, low), xytext=(-5 if right else 5, -3), textcoords="offset points", ha="right" if right else "left",
            color=ALARM, fontsize=8, va="top",
        )  # fmt: skip


def path_derivatives(plan: Plan, bead: int, order: int, ax: Axes | None = None) -> Axes:
    """What a bead demands of each joint at the constant commanded speed: |q′| v, |q″| v² or |q‴| v³ over its limit.

    Where a curve is above 1, the speed has to dip.

    Args:
        plan: The plan to draw.
        bead: Index of the bead.
        order: 1 velocity, 2 acceleration, 3 jerk.
        ax: Axes to draw on; new ones by default.

    Returns:
        The axes.

    Raises:
        InputError: If there is no such order, or if the plan does not lay this bead.
    """
    if order not in ORDERS:
        raise InputError(f"there is no derivative of order {order!r}", hint="1 velocity, 2 acceleration, 3 jerk")
    found, limits = _along_bead(plan, bead), _limits(plan)
    ax = tidy(axes_of(ax, figsize=(9.0, 2.8)))
    shares = np.abs(found.rates[:, :, order - 1]) * plan.commanded[bead] ** order / limits[:, order - 1]
    for j, name in enumerate(plan.joint_names):
        style = STYLES[j // len(COLOURS) % len(STYLES)]
        ax.plot(found.s * 1e3, shares[:, j], style, color=COLOURS[j % len(COLOURS)], linewidth=1.2, label=name)
    ax.axhline(1.0, color=INK, linestyle="--", linewidth=1.0)
    ax.set_yscale("log")
    ax.set_ylim(_LEAST_SHARE, 2.0 * max(float(shares.max()), 1.0))
    ax.set_xlabel(f"arc length along bead {bead}, mm")
    ax.set_ylabel(f"{RATES[order - 1]} over the {NAMES[order - 1]} limit")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return ax


def speed_ceilings(plan: Plan, bead: int, ax: Axes | None = None) -> Axes:
    """The greatest constant speed that the limits of velocity, acceleration and jerk allow at each place of a bead.

    Also drawn are the commanded speed and the one that is reached: it dips where a ceiling does, and slows down before
    and speeds up after that.

    Args:
        plan: The plan to draw.
        bead: Index of the bead.
        ax: Axes to draw on; new ones by default.

    Returns:
        The axes.

    Raises:
        InputError: If the plan does not lay this bead.
    """
    found, limits = _along_bead(plan, bead), _limits(plan)
    ax = tidy(axes_of(ax, figsize=(9.0, 3.2)))
    with np.errstate(divide="ignore"):
        each = (limits / np.abs(found.rates)) ** (1.0 / ORDERS)
    commanded = float(plan.commanded[bead])
    for k, name in enumerate(NAMES):
        ceiling = np.minimum(each[:, :, k].min(axis=1), _HIGHEST * commanded)
        ax.plot(
            found.s * 1e3, ceiling * 1e3, STYLES[k + 1], color=COLOURS[k + 1], linewidth=1.2, label=f"{name} limits"
        )
    rows = plan.deposit & (plan.bead == bead)
    ax.plot(plan.s[rows] * 1e3, plan.speed[rows] * 1e3, color=COLOURS[0], linewidth=2.0, label="reached")
    ax.axhline(commanded * 1e3, color=SOFT, linestyle="--", linewidth=1.0, label="commanded")
    ax.set_yscale("log")
    ax.set_xlabel(f"arc length along bead {bead}, mm")
    ax.set_ylabel("speed, mm/s")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return ax


def joint_ranges(plan: Plan, ax: Axes | None = None) -> Axes:
    """The range of each joint, and how much of it is used while material flows, and overall.

    Args:
        plan: The plan to draw.
        ax: Axes to draw on; new ones by default.

    Returns:
        The axes.
    """
    names = plan.joint_names
    ax = tidy(axes_of(ax, figsize=(9.0, 0.6 + 0.38 * len(names))))
    scale, units = shown_units(plan.cell)
    low, high, q = scale * plan.cell.limits.q_min, scale * plan.cell.limits.q_max, scale * plan.q
    far = np.abs([low, high])
    shown = np.isfinite(far) & ((far <= _ENDLESS) | (np.array(units) == "mm"))
    widest = 1.1 * max(float(np.abs(q).max()), float(far[shown].max(initial=180.0)))
    rows = np.arange(len(names))[::-1]
    ends = np.clip(low, -widest, widest), np.clip(high, -widest, widest)
    ax.barh(rows, ends[1] - ends[0], left=ends[0], height=0.7, color=FAINT, label="range")
    for used, height, colour, label in (
        (q, 0.26, COLOURS[4], "used, travel included"),
        (q[plan.deposit], 0.5, COLOURS[0], "used while depositing"),
    ):
        ax.barh(rows, np.ptp(used, axis=0), left=used.min(axis=0), height=height, color=colour, label=label)
    ax.set_yticks(rows, names)
    ax.set_xlim(-widest, widest)
    ax.set_xlabel("angle, deg; place, mm" if "mm" in units else "angle, deg")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return ax


def _known(plan: Plan, bead: int) -> int:
    """The bead's index. Raises InputError for a bead that is not laid."""
    first, last = plan.first_bead, plan.first_bead + len(plan.beads) - 1
    if not first <= bead <= last:
        raise InputError(f"there is no bead {bead!r} in this plan", hint=f"a number from {first} to {last}")
    return bead


def _along_bead(plan: Plan, bead: int) -> ByArcLength:
    """Derivatives along the deposited part of a bead; s from its start."""
    path = plan.paths[_known(plan, bead) - plan.first_bead]
    low, high = float(path.task.s[path.task.first]), float(path.task.s[path.task.last])
    found = by_arc_length(path, spline_of(path), low, high, _PER_SAMPLE)
    return ByArcLength(found.s - low, found.rates)


def _limits(plan: Plan) -> Array:
    """Limits (nj, 3) of the joints' velocity, acceleration and jerk."""
    limits = plan.cell.limits
    return np.column_stack([limits.velocity, limits.acceleration, limits.jerk])


# ----------------------------------------------------------------------------------------------------
# Comparison of plans.


def compare(plans: Mapping[str, Plan], metric: str, ax: Axes | None = None, label: str = "") -> Axes:
    """One metric of several plans as bars; hatched if a plan is not verified.

    Args:
        plans: Plans by the names written next to the bars.
        metric: A name in `Plan.metrics`; values are in the unit that the name gives.
        ax: Axes to draw on; new ones by default.
        label: Title of the axes; by default, the metric's name.

    Returns:
        The axes.

    Raises:
        InputError: If none of the plans has the metric.
    """
    known = sorted({name for plan in plans.values() for name in plan.metrics})
    if metric not in known:
        near = nearest_name(metric, known)
        raise InputError(f"no plan has a metric {metric!r}", hint=f"did you mean {near}?" if near else None)
    ax = tidy(axes_of(ax, figsize=(4.0, 0.6 + 0.4 * len(plans))))
    rows = np.arange(len(plans))[::-1]
    values = [plan.metrics.get(metric, np.nan) for plan in plans.values()]
    bars = ax.barh(rows, np.nan_to_num(values), height=0.65, color=COLOURS[0])
    for bar, value, plan in zip(bars, values, plans.values(), strict=True):
        text = "none" if np.isnan(value) else f"{value:.3g}"
        ax.annotate(f" {text}", (max(bar.get_width(), 0.0), bar.get_y() + bar.get_height() / 2), va="center", color=INK)
        if not plan.verified:
            bar.set(facecolor="white", edgecolor=COLOURS[1], hatch="///")
    ax.set_yticks(rows, list(plans))
    ax.margins(x=0.22)
    ax.set_title(label or metric, loc="left", fontsize=10)
    return ax


# ----------------------------------------------------------------------------------------------------
# The roll × path map.

# measure → label, factor
ROLL_MEASURES = {
    "sigma": ("least singular value σ", 1.0),
    "limit": ("angle from an end stop, deg", 180.0 / np.pi),
    "clearance": ("clearance beyond need, mm", 1e3),
}
# reason → grey, hatch: distinguishable without colour
AREAS = {
    REACH: ("#f4f6f9", "."),
    LIMITS: ("#e3e8ee", "///"),
    SINGULAR: ("#cdd5dd", "xxx"),
    COLLISION: ("#f3d9d2", "\\\\\\"),
}


def redundancy_map(roll_map: RollMap, ax: Axes | None = None, measure: str = "sigma") -> Axes:
    """Draw the feasible roll along the path, coloured by a measure (red is tight), with infeasible areas hatched.

    The line is the roll that was chosen, if there is one.

    Args:
        roll_map: The map, such as one of `Plan.roll_maps`.
        ax: Axes to draw on; new ones by default.
        measure: "sigma", "limit" or "clearance".

    Returns:
        The axes.

    Raises:
        InputError: If there is no such measure.
    """
    if measure not in ROLL_MEASURES:
        near = nearest_name(measure, ROLL_MEASURES)
        hint = f"did you mean {near}?" if near else f"one of {', '.join(ROLL_MEASURES)}"
        raise InputError(f"there is no measure {measure!r}", hint=hint)
    label, factor = ROLL_MEASURES[measure]
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
        area = np.concatenate([here, here[:, :1]], axis=1)  # once around the circle
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
    """Edges (m + 1) of columns at ascending places (m)."""
    middle = 0.5 * (at[1:] + at[:-1])
    return np.concatenate([at[:1], middle, at[-1:]])


def _draw_chosen(ax: Axes, roll_map: RollMap) -> None:
    """Draw the chosen roll, broken where it wraps around the circle and between beads."""
    roll = np.degrees(roll_map.chosen)
    if np.isnan(roll).all():
        return
    broken = np.flatnonzero((np.abs(np.diff(roll)) > 180.0) | (np.diff(roll_map.bead) != 0)) + 1
    x, y = np.insert(roll_map.along * 1e3, broken, np.nan), np.insert(roll, broken, np.nan)
    outline = [effects.Stroke(linewidth=4.0, foreground=INK), effects.Normal()]
    ax.plot(x, y, color="white", linewidth=2.0, path_effects=outline, solid_capstyle="round", label="chosen roll")


# ----------------------------------------------------------------------------------------------------
# The print in three dimensions.

PATH_MEASURES = {"speed": "speed, mm/s", "sigma": "singular value σ", "layer": "layer", "bead": "bead"}
MOST_SEGMENTS = 12_000  # more are slow to draw, and look no finer
MOST_TRIANGLES = 6_000  # of the part: a finer one is not drawn
_SLOWER = 0.9  # × the commanded speed: the colours reach down at least to there
_PART_ALPHA = 0.25
_LARGEST_PART = 4.0  # × the print: a larger part would leave no room for it
_FLATTEST = 0.3  # × a print's greatest extent: least space for each of its sides


def toolpath(plan: Plan, ax: Any = None, measure: str = "speed") -> Any:
    """The deposited beads in the part frame, coloured by a measure.

    Args:
        plan: The plan to draw.
        ax: Axes with `projection="3d"`; new ones by default.
        measure: "speed", "sigma", "layer" or "bead".

    Returns:
        The axes.

    Raises:
        InputError: If there is no such measure.
    """
    if measure not in PATH_MEASURES:
        near = nearest_name(measure, PATH_MEASURES)
        hint = f"did you mean {near}?" if near else f"one of {', '.join(PATH_MEASURES)}"
        raise InputError(f"there is no measure {measure!r}", hint=hint)
    if ax is None:
        ax = plt.figure(figsize=(7.0, 5.5), layout="constrained").add_subplot(projection="3d")
    values = _values(plan, measure)
    index, begin, end = stretches(plan.deposit, plan.bead)
    sharp = turning(plan.tip[index], begin, end)
    kept = keep_minima([values[index], -sharp, np.zeros(len(index))], MOST_SEGMENTS, np.union1d(begin, end))
    rows = index[kept]
    points = plan.tip[rows] * 1e3
    joined = ~np.isin(kept[1:], begin)
    segments = np.stack([points[:-1], points[1:]], axis=1)[joined]
    lines = Line3DCollection(list(segments), cmap=MAP, linewidths=1.6)
    lines.set_array(np.minimum(values[rows][1:], values[rows][:-1])[joined])
    if measure == "speed":  # otherwise rounding errors would span all colours
        commanded = float(plan.commanded.max()) * 1e3
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
    ax.figure.colorbar(lines, ax=ax, label=PATH_MEASURES[measure], shrink=0.6, pad=0.1)
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
    """Look at the print from the outside, from where most of it faces."""
    across = float(np.hypot(normal[0], normal[1]))
    azimuth = np.degrees(np.arctan2(normal[1], normal[0])) if across > 0.15 else -60.0
    ax.view_init(elev=20.0 if abs(normal[2]) < 0.5 else 45.0, azim=azimuth + 14.0)
