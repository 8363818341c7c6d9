"""What happens along a print: speed and its ceilings, path derivatives, joints within their ranges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from planner.errors import InputError
from planner.plan import Plan
from planner.plots.style import ALARM, COLOURS, FAINT, INK, SOFT, STYLES, axes_of, legend_above, tidy
from planner.readonly import Array
from planner.resolve.derivatives import ORDERS, ByArcLength, by_arc_length, spline_of

NAMES = ("velocity", "acceleration", "jerk")
RATES = ("|q′| v", "|q″| v²", "|q‴| v³")
MOST_NAMED = 3  # dips whose cause is written beside them
_APART, _LATE = 0.2, 0.75  # of the width: between two names; where names stand to the left of their places
_HIGHEST = 20.0  # times the commanded speed: higher ceilings are not drawn
_LEAST_SHARE = 1e-2  # of a limit: less is not drawn
_ENDLESS = 720.0  # deg: a range beyond it has no end, for a picture
_PER_SAMPLE = 4  # places that are looked at between two samples of a task


def speed(plan: Plan, ax: Axes | None = None, bead: int | None = None) -> Axes:
    """The tip's speed while material flows, over time, or along one bead; its dips marked, the worst ones named."""
    laid = plan.deposit if bead is None else plan.deposit & (plan.bead == _known(plan, bead))
    ax = tidy(axes_of(ax, figsize=(9.0, 2.8)))
    x = plan.t if bead is None else plan.s * 1e3
    y = np.where(laid, plan.speed * 1e3, np.nan)
    rows = np.flatnonzero(laid)
    window = slice(rows[0], rows[-1] + 1)
    ax.axhline(plan.problem.process.speed * 1e3, color=SOFT, linestyle="--", linewidth=1.0, label="commanded")
    ax.plot(x[window], y[window], color=COLOURS[0], linewidth=1.2, label="reached")
    dips = sorted((dip for dip in plan.dips if bead is None or dip.bead == bead), key=lambda dip: -dip.lost)
    at = np.array([(dip.t if bead is None else dip.at_s * 1e3, dip.speed * 1e3) for dip in dips]).reshape(-1, 2)
    ax.scatter(at[:, 0], at[:, 1], s=22, color="white", edgecolor=ALARM, zorder=3, label=f"dips: {len(dips)}")
    _name_worst(ax, [(where, low, dip.cause) for dip, (where, low) in zip(dips, at.tolist(), strict=True)], x[window])
    ax.set_ylim(0.0, 1.15 * float(np.nanmax(y)))
    ax.set_xlabel("time, s" if bead is None else f"arc length along bead {bead}, mm")
    ax.set_ylabel("speed, mm/s")
    legend_above(ax)
    return ax


def _name_worst(ax: Axes, dips: Sequence[tuple[float, float, str]], x: Array) -> None:
    """Write the cause beside the first few dips (x, y, cause), none beside a neighbour of one that is named."""
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
    """What a bead asks of each joint at the commanded, constant speed: |q′| v, |q″| v² or |q‴| v³ over its limit.

    order: 1 velocity, 2 acceleration, 3 jerk. Where a curve is above 1, the speed has to dip.
    """
    if order not in ORDERS:
        raise InputError(f"there is no derivative of order {order!r}", hint="1 velocity, 2 acceleration, 3 jerk")
    found, limits = _along_bead(plan, bead), _limits(plan)
    ax = tidy(axes_of(ax, figsize=(9.0, 2.8)))
    shares = np.abs(found.rates[:, :, order - 1]) * plan.problem.process.speed**order / limits[:, order - 1]
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

    Beside them the commanded speed and the one that is reached: it dips where a ceiling does, and gains and loses
    speed around that.
    """
    found, limits = _along_bead(plan, bead), _limits(plan)
    ax = tidy(axes_of(ax, figsize=(9.0, 3.2)))
    with np.errstate(divide="ignore"):
        each = (limits / np.abs(found.rates)) ** (1.0 / ORDERS)
    commanded = plan.problem.process.speed
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
    """The range of each joint, what of it is used while material flows, and what in all."""
    names = plan.joint_names
    ax = tidy(axes_of(ax, figsize=(9.0, 0.6 + 0.38 * len(names))))
    low, high = np.degrees(plan.cell.limits.q_min), np.degrees(plan.cell.limits.q_max)
    q = np.degrees(plan.q)
    told = np.abs(np.concatenate([low, high]))
    widest = 1.1 * max(float(np.abs(q).max()), float(told[told <= _ENDLESS].max(initial=180.0)))
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
    ax.set_xlabel("angle, deg")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return ax


def _known(plan: Plan, bead: int) -> int:
    """Raises InputError for a bead that is not laid."""
    first, last = plan.first_bead, plan.first_bead + len(plan.beads) - 1
    if not first <= bead <= last:
        raise InputError(f"there is no bead {bead!r} in this plan", hint=f"a number from {first} to {last}")
    return bead


def _along_bead(plan: Plan, bead: int) -> ByArcLength:
    """Derivatives along what is deposited of a bead; s from its start."""
    path = plan.paths[_known(plan, bead) - plan.first_bead]
    low, high = float(path.task.s[path.task.first]), float(path.task.s[path.task.last])
    found = by_arc_length(path, spline_of(path), low, high, _PER_SAMPLE)
    return ByArcLength(found.s - low, found.rates)


def _limits(plan: Plan) -> Array:
    """Limits (nj, 3) of the joints' velocity, acceleration and jerk."""
    limits = plan.cell.limits
    return np.column_stack([limits.velocity, limits.acceleration, limits.jerk])
