"""Plans beside each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from planner.errors import InputError, nearest_name
from planner.plan import Plan
from planner.plots.style import COLOURS, INK, axes_of, tidy


def compare(plans: Mapping[str, Plan], metric: str, ax: Axes | None = None, label: str = "") -> Axes:
    """One metric of several plans as bars; hatched where a plan is not verified.

    plans: by the names that are written beside the bars; metric: a name in `Plan.metrics`, in the unit that it says.
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
