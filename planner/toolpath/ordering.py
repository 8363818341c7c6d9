"""Print order: which bead follows which, and in which direction, so that travel is short."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.problem.by_layer import fits
from planner.toolpath.plane_paths import PlaneCurve


def shorten_travel(curves: Sequence[PlaneCurve], start: Array | None = None) -> list[PlaneCurve]:
    """Order and orient curves: by nearest neighbour, then improved until no 2-opt move helps.

    A closed curve starts and ends where it did; an open one may be run backwards. If `start` (2) is given, the whole
    order runs in the direction that begins nearer to it.
    """
    order = _travelled(curves)
    if not order or start is None:
        return order
    if np.hypot(*(order[-1].points[-1] - start)) < np.hypot(*(order[0].points[0] - start)):
        return [reverse(curve) for curve in reversed(order)]
    return order


def in_order(curves: Sequence[PlaneCurve], order: Sequence[str], start: Array | None = None) -> list[PlaneCurve]:
    """Curves in the order of the first patterns that fit their names; those that fit none come last.

    Each group is ordered by `shorten_travel`, from where the previous group ends, or from `start` (2).
    """
    groups: dict[int, list[PlaneCurve]] = {}
    for curve in curves:
        groups.setdefault(rank(curve.name, order), []).append(curve)
    found: list[PlaneCurve] = []
    for k in sorted(groups):
        found += shorten_travel(groups[k], found[-1].points[-1] if found else start)
    return found


def rank(name: str, order: Sequence[str]) -> int:
    """Index of the first pattern that fits a name, or the number of patterns if none does."""
    return next((k for k, pattern in enumerate(order) if fits(pattern, name)), len(order))


def rows_of_layers(curves: Sequence[PlaneCurve], count: int, order: Sequence[str]) -> list[list[PlaneCurve]]:
    """The same curves in each of `count` layers, in print order; each layer starts where the one before ended, or near
    it if an order is given."""
    rows = [in_order(curves, order)]
    while len(rows) < count:
        if order:
            rows.append(in_order(rows[-1], order, rows[-1][-1].points[-1]))
        else:
            rows.append([reverse(curve) for curve in reversed(rows[-1])])
    return rows


def _travelled(curves: Sequence[PlaneCurve]) -> list[PlaneCurve]:
    if len(curves) < 2:
        return list(curves)
    ends = np.array([[curve.points[0], curve.points[-1]] for curve in curves])
    order, flipped = _improve(ends, *_nearest_neighbour(ends))
    return [reverse(curves[i]) if back else curves[i] for i, back in zip(order, flipped, strict=True)]


def reverse(curve: PlaneCurve) -> PlaneCurve:
    """The curve run backwards."""
    return replace(curve, points=curve.points[::-1].copy(), source=curve.source[::-1].copy())


def nearest_first(lines: Sequence[tuple[Array, bool]]) -> list[tuple[int, bool]]:
    """Order lines from the first on, always to the nearest end: their numbers, and whether each runs backwards.

    A line is its points (n, d), and whether it is closed. A closed line does not repeat its first point, ends where it
    begins, and is never reversed.
    """
    left = list(range(1, len(lines)))
    order = [(0, False)]
    while left:
        (line, closed), back = lines[order[-1][0]], order[-1][1]
        here = line[0] if closed or back else line[-1]
        far = [(float(np.linalg.norm(lines[k][0][0] - here)), k, False) for k in left]
        far += [(float(np.linalg.norm(lines[k][0][-1] - here)), k, True) for k in left if not lines[k][1]]
        _, k, turned = min(far)
        left.remove(k)
        order.append((k, turned))
    return order


@njit
def _nearest_neighbour(ends: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    n = len(ends)
    order = np.zeros(n, dtype=np.int64)
    flipped = np.zeros(n, dtype=np.bool_)
    left = np.ones(n, dtype=np.bool_)
    left[0] = False
    here = ends[0, 1]
    for k in range(1, n):
        best, best_i, best_side = np.inf, -1, 0
        for i in range(n):
            if left[i]:
                for side in range(2):
                    d = np.hypot(ends[i, side, 0] - here[0], ends[i, side, 1] - here[1])
                    if d < best - 1e-12:
                        best, best_i, best_side = d, i, side
        order[k], flipped[k] = best_i, best_side == 1
        left[best_i] = False
        here = ends[best_i, 1 - best_side]
    return order, flipped


@inner_njit
def _end(ends: Array, order: NDArray[np.int64], flipped: NDArray[np.bool_], k: int, last: int) -> Array:
    return ends[order[k], last if not flipped[k] else 1 - last]


@inner_njit
def _gap(ends: Array, order: NDArray[np.int64], flipped: NDArray[np.bool_], a: int, la: int, b: int, lb: int) -> float:
    """Distance between end la of the a-th in order and end lb of the b-th; 0 beyond either end of the tour."""
    if a < 0 or b >= len(order):
        return 0.0
    p, q = _end(ends, order, flipped, a, la), _end(ends, order, flipped, b, lb)
    return float(np.hypot(p[0] - q[0], p[1] - q[1]))


@njit
def _improve(
    ends: Array, order: NDArray[np.int64], flipped: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """2-opt over stretches i..j (a stretch of one reverses a single curve) until none shortens the travel."""
    n = len(order)
    better = True
    while better:
        better = False
        for i in range(n):
            for j in range(i, n):
                before = _gap(ends, order, flipped, i - 1, 1, i, 0) + _gap(ends, order, flipped, j, 1, j + 1, 0)
                after = _gap(ends, order, flipped, i - 1, 1, j, 1)
                if j + 1 < n:
                    after += _gap(ends, order, flipped, i, 0, j + 1, 0)
                if after < before - 1e-9:
                    for k in range((j - i + 1) // 2):
                        order[i + k], order[j - k] = order[j - k], order[i + k]
                        flipped[i + k], flipped[j - k] = flipped[j - k], flipped[i + k]
                    for k in range(i, j + 1):
                        flipped[k] = not flipped[k]
                    better = True
    return order, flipped
