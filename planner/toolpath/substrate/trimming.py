"""Plane curves cut where they leave a region, with the input paths that they stand for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.readonly import Array, Flags
from planner.toolpath.paths import length
from planner.toolpath.rounding import PlaneCurve
from planner.toolpath.svg import PlanePath

_SAME = 1e-9  # m: vertices nearer than this to a cut are the cut


def trim_path(path: PlanePath, dense: Array, keep: Flags) -> list[PlanePath]:
    """The pieces of a polyline where its dense points (n, 2) are kept (n); closed if all of a closed one are."""
    if keep.all():
        return [path]
    arc = _arc(dense)
    return [
        PlanePath(path.name, _between(path.points, *ends), False)
        for ends in (_unrolled(arc, *run) for run in _runs(keep, path.closed))
        if ends[1] - ends[0] > _SAME
    ]


def trim_curve(curve: PlaneCurve, keep: Flags) -> list[PlaneCurve]:
    """The pieces of a rounded curve whose samples are kept (n), from sample to sample; at least two samples each."""
    if keep.all():
        return [curve]
    last = len(keep) - 1
    total = length(curve.source)
    pieces = []
    for first, end in _runs(keep, curve.closed):
        if end == first:
            continue
        index = np.arange(first, end + 1)
        index = np.where(index > last, index - last, index)  # past the seam of a closed curve
        source = _between(curve.source, first * total / last, end * total / last)
        pieces.append(replace(curve, points=curve.points[index], source=source, closed=False))
    return pieces


def _runs(keep: Flags, closed: bool) -> list[tuple[int, int]]:
    """First and last place of each run of kept places (n), not all of them; past n - 1 where it crosses the seam."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(np.int8), [0]])))
    runs = [(int(first), int(end) - 1) for first, end in change.reshape(-1, 2)]
    if closed and len(runs) > 1 and runs[0][0] == 0 and runs[-1][1] == len(keep) - 1:
        runs = [*runs[1:-1], (runs[-1][0], len(keep) - 1 + runs[0][1])]
    return runs


def _arc(points: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _unrolled(arc: Array, first: int, end: int) -> tuple[float, float]:
    """Arc lengths of the places `first` and `end`, the latter past the seam where it is no place of its own."""
    last = len(arc) - 1
    return float(arc[first]), float(arc[end]) if end <= last else float(arc[-1] + arc[end - last])


def _between(points: Array, low: float, high: float) -> Array:
    """A polyline (n, 2) from one arc length to another [m], which may lie a round further on a closed one."""
    arc = _arc(points)
    if high > arc[-1] + _SAME:
        points, arc = np.vstack([points, points[1:]]), np.concatenate([arc, arc[-1] + arc[1:]])
    inner = points[(arc > low + _SAME) & (arc < high - _SAME)]
    ends = np.column_stack([np.interp([low, high], arc, points[:, k]) for k in range(2)])
    return np.vstack([ends[:1], inner, ends[1:]])
