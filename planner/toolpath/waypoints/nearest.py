"""The nearest point printed so far: one search tree for every moment of a print.

Every sixteen neighbouring points have a box, every two of these boxes another, and so on. Each box knows the first bead
with a point in it, so a search skips beads that are not there yet.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints, read_only
from planner.base.compiled import njit
from planner.base.processes import in_threads

FAR = 50e-3  # m: greatest distance; anything farther counts as this far away
ALWAYS = -1  # bead number of points that are there from the start
_LEAF = 16  # points in the smallest boxes
_GRID = 20  # bits of each coordinate in the order of the points: three fit into 64
_MANY = 2_000  # points: for fewer, threads take longer to start than to search
_DEEPEST = 64  # levels: more than the number of points can require


class PrintedPoints(NamedTuple):
    """Points of beads for kernels, in an order that keeps neighbours together.

    points (n, 3) [m]; bead (n) to which each belongs; origin (n): its index in the points the tree was made of
    low, high (2 m, 3), since (2 m)   boxes k and the first bead in each: its halves are 2 k and 2 k + 1; box 1 is all,
                                      and those from m on hold sixteen points each
    """

    points: Array
    bead: Ints
    origin: Ints
    low: Array
    high: Array
    since: Ints


def printed_points(points: Array, bead: Ints) -> PrintedPoints:
    """A search tree of points (n, 3) of beads (n), ALWAYS for points there from the start; n may be 0."""
    order = _in_neighbourhood(points)
    leaves = 1 << max(int(np.ceil(np.log2(max(-(-len(points) // _LEAF), 1)))), 0)
    low, high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
    since = np.full(2 * leaves, np.iinfo(np.int64).max)
    starts = np.arange(0, len(points), _LEAF)
    if len(points):
        filled = slice(leaves, leaves + len(starts))
        low[filled] = np.minimum.reduceat(points[order], starts)
        high[filled] = np.maximum.reduceat(points[order], starts)
        since[filled] = np.minimum.reduceat(bead[order], starts)
    first = leaves
    while first > 1:
        halves, first = slice(first, 2 * first), first // 2
        whole = slice(first, 2 * first)
        low[whole] = low[halves].reshape(-1, 2, 3).min(axis=1)
        high[whole] = high[halves].reshape(-1, 2, 3).max(axis=1)
        since[whole] = since[halves].reshape(-1, 2).min(axis=1)
    arrays = (points[order], bead[order].astype(np.int64), order, low, high, since)
    return PrintedPoints(*(read_only(values) for values in arrays))


def _in_neighbourhood(points: Array) -> Ints:
    """An order (n) of points (n, 3) that keeps neighbours together: the Z-order curve through the cells of a grid."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    extent = float(np.ptp(points, axis=0).max())
    cells = ((points - points.min(axis=0)) / max(extent, 1e-12) * ((1 << _GRID) - 1)).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(_GRID):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def nearest_printed(tree: PrintedPoints, printed: int, points: Array, far: float = FAR) -> tuple[Array, Ints]:
    """Distances (n) [m] of points (n, 3) from the nearest one of the first `printed` beads, and its index (n).

    If none is within `far`, returns `far` and -1. Of two equally near points the one with the smaller index counts.
    """
    points = read_only(points)
    distance, index = np.empty(len(points)), np.empty(len(points), dtype=np.int64)

    def part(first: int, last: int) -> None:
        _nearest(tree, printed, points[first:last], far, distance[first:last], index[first:last])

    if len(points) < _MANY:
        part(0, len(points))
    else:
        in_threads(part, len(points))
    return distance, index


@njit
def _nearest(tree: PrintedPoints, printed: int, points: Array, far: float, distance: Array, index: Ints) -> None:
    """Fill distance (n) and index (n) as `nearest_printed` returns them."""
    leaves = len(tree.since) // 2
    stack, apart = np.empty(_DEEPEST, dtype=np.int64), np.empty(_DEEPEST)
    for i in range(len(points)):
        best, found = far * far, -1
        height = 0
        if tree.since[1] < printed:
            stack[0], apart[0] = 1, _outside(tree, 1, points[i])
            height = 1
        while height > 0:
            height -= 1
            box = stack[height]
            if apart[height] > best:
                continue
            if box >= leaves:
                first = (box - leaves) * _LEAF
                for k in range(first, min(first + _LEAF, len(tree.bead))):
                    if tree.bead[k] < printed:
                        size = 0.0
                        for d in range(3):
                            size += (points[i, d] - tree.points[k, d]) ** 2
                        if size < best or (size == best and (found < 0 or tree.origin[k] < found)):
                            best, found = size, tree.origin[k]
                continue
            near, far_half = 2 * box, 2 * box + 1
            near_apart, far_apart = _outside(tree, near, points[i]), _outside(tree, far_half, points[i])
            if far_apart < near_apart:
                near, far_half, near_apart, far_apart = far_half, near, far_apart, near_apart
            if far_apart <= best and tree.since[far_half] < printed:
                stack[height], apart[height] = far_half, far_apart
                height += 1
            if near_apart <= best and tree.since[near] < printed:
                stack[height], apart[height] = near, near_apart
                height += 1
        distance[i], index[i] = np.sqrt(best), found


@njit(inline="always")
def _outside(tree: PrintedPoints, box: int, point: Array) -> float:
    """Squared distance of a point (3) from a box, 0 inside; infinite from an empty one."""
    total = 0.0
    for d in range(3):
        beyond = max(tree.low[box, d] - point[d], point[d] - tree.high[box, d], 0.0)
        total += beyond * beyond
    return total
