"""Key figures of a plan: those that decide between two, and which of two is the better one."""

from __future__ import annotations

import math
from collections.abc import Mapping

from planner.report.wording import METRICS, SHORT, Metric

ROWS: tuple[Metric, ...] = tuple(metric for key in SHORT for metric in METRICS if metric.key == key)
NONE = "–"

Figures = tuple[tuple[str, float], ...]  # (name of the metric, value), of those in SHORT that a plan has


def figures_of(metrics: Mapping[str, float]) -> Figures:
    """Those of a plan's metrics that are shown; no value that is no number."""
    return tuple((row.key, float(metrics[row.key])) for row in ROWS if math.isfinite(metrics.get(row.key, math.nan)))


def heading(row: Metric) -> dict[str, str]:
    """What a figure is called, in short with its unit and in full."""
    unit = f", {row.unit}" if row.unit else ""
    return {"label": SHORT[row.key] + unit, "full": row.label.strip()}


def written(row: Metric, value: float | None) -> str:
    """A figure in its unit's digits."""
    return NONE if value is None else f"{value * row.scale:.{row.digits}f}"


def verdict(row: Metric, value: float | None, other: float | None) -> str:
    """How a value compares with another: "better", "worse", "same" to the digits shown, or "" where that says nothing."""
    if value is None or other is None:
        return ""
    if written(row, value) == written(row, other):
        return "same"
    if not row.better:
        return ""
    return "better" if (value > other) == (row.better == "up") else "worse"


def difference(row: Metric, value: float | None, other: float | None) -> str:
    """How much a value lies above another, with its sign."""
    if value is None or other is None:
        return NONE
    if written(row, value) == written(row, other):
        return "0"
    return f"{(value - other) * row.scale:+.{row.digits}f}".replace("-", "\u2212")
