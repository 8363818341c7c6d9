"""Boxes within boxes around the facets of a mesh: the nearest facet to a point, and the highest one below the sky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.readonly import Array, Ints, ReadOnlyArrays, read_only

_LEAF = 4  # facets in a leaf
_BITS = 20  # of each coordinate, by which facets are sorted
_DEPTH = 64  # of the stack: twice as many as boxes can be nested
_UPWARD = 1e-6  # upward component of a facet's normal: below, it is not seen from above
_RIM = 1e-9  # of a facet: a point this little outside still lies on it, so that no ray slips between two
_TINY = 1e-30


@dataclass(frozen=True)
class FacetTree(ReadOnlyArrays):
    """Facets, sorted so that neighbours stand together, and the boxes of a complete binary tree over them.

    corners (n, 3, 3) [m], counter-clockwise seen from outside; normals (n, 3) of unit length
    low, high (m, 3)  of the boxes; box 0 holds all, box i those of 2 i + 1 and 2 i + 2, the last row is of leaves
    """

    corners: Array
    normals: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, corners: Array) -> FacetTree:
        """The tree of facets (n, 3, 3), n at least 1, none of them without an area."""
        order = np.argsort(_morton(corners.mean(axis=1)), kind="stable")
        corners = np.ascontiguousarray(corners[order])
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = across / np.linalg.norm(across, axis=1)[:, None]
        n = len(corners)
        leaves = 1 << int(np.ceil(np.log2(max(n / _LEAF, 1.0))))
        low, high = np.full((leaves * _LEAF, 3), np.inf), np.full((leaves * _LEAF, 3), -np.inf)
        low[:n], high[:n] = corners.min(axis=1), corners.max(axis=1)
        lows, highs = [low.reshape(leaves, _LEAF, 3).min(axis=1)], [high.reshape(leaves, _LEAF, 3).max(axis=1)]
        while len(lows[0]) > 1:
            lows.insert(0, lows[0].reshape(-1, 2, 3).min(axis=1))
            highs.insert(0, highs[0].reshape(-1, 2, 3).max(axis=1))
        return cls(corners, normals, np.vstack(lows), np.vstack(highs))

    def distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the nearest facet [m]."""
        return _distance(read_only(points), self.corners, self.low, self.high)

    def top(self, plane: Array) -> tuple[Array, Ints]:
        """The highest facet that is seen from above at x, y (n, 2): z there [m], NaN where none is; its index, or -1."""
        return _top(np.ascontiguousarray(plane), self.corners, self.normals, self.low, self.high)

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the normals of the highest facets at x, y (n, 2); NaN where none is."""
        found = self.top(plane)[1]
        return np.where(found >= 0, self.normals[found, 2], np.nan)


def _morton(points: Array) -> NDArray[np.uint64]:
    """Points (n, 3) by the interleaved bits of their coordinates: near in this order is near in space."""
    span = np.maximum(np.ptp(points, axis=0).max(), _TINY)
    cell = ((points - points.min(axis=0)) / span * (2**_BITS - 1)).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


@njit(cache=True)
def _box_gap(p: Array, low: Array, high: Array) -> float:
    """Squared distance of a point (3) from a box."""
    square = 0.0
    for k in range(3):
        gap = max(low[k] - p[k], 0.0, p[k] - high[k])
        square += gap * gap
    return square


@njit(cache=True)
def _facet_gap(p: Array, t: Array) -> float:
    """Squared distance of a point (3) from a facet (3, 3); after Ericson, Real-Time Collision Detection, 5.1.5."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for k in range(3):
        ab, ac = t[1, k] - t[0, k], t[2, k] - t[0, k]
        d1 += ab * (p[k] - t[0, k])
        d2 += ac * (p[k] - t[0, k])
        d3 += ab * (p[k] - t[1, k])
        d4 += ac * (p[k] - t[1, k])
        d5 += ab * (p[k] - t[2, k])
        d6 += ac * (p[k] - t[2, k])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v = w = 0.0  # shares of the second and third corner in the nearest point
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / max(d1 - d3, _TINY)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / max(d2 - d6, _TINY)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / max((d4 - d3) + (d5 - d6), _TINY)
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    square = 0.0
    for k in range(3):
        gap = p[k] - t[0, k] - v * (t[1, k] - t[0, k]) - w * (t[2, k] - t[0, k])
        square += gap * gap
    return square


@njit(cache=True)
def _distance(points: Array, corners: Array, low: Array, high: Array) -> Array:
    n, first_leaf = len(corners), len(low) // 2
    out = np.empty(len(points))
    stack = np.empty(_DEPTH, dtype=np.int64)
    nearest = 0  # of the point before: a good guess for its neighbour
    for i in range(len(points)):
        p = points[i]
        best = _facet_gap(p, corners[nearest])
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            box = stack[size]
            if _box_gap(p, low[box], high[box]) >= best:
                continue
            if box >= first_leaf:
                start = (box - first_leaf) * _LEAF
                for facet in range(start, min(start + _LEAF, n)):
                    gap = _facet_gap(p, corners[facet])
                    if gap < best:
                        best, nearest = gap, facet
                continue
            left, right = 2 * box + 1, 2 * box + 2
            if _box_gap(p, low[left], high[left]) < _box_gap(p, low[right], high[right]):
                left, right = right, left
            stack[size], stack[size + 1] = left, right  # the nearer one is looked at first
            size += 2
        out[i] = np.sqrt(best)
    return out


@njit(cache=True)
def _top(plane: Array, corners: Array, normals: Array, low: Array, high: Array) -> tuple[Array, Ints]:
    n, first_leaf = len(corners), len(low) // 2
    out, found = np.full(len(plane), np.nan), np.full(len(plane), -1, dtype=np.int64)
    stack = np.empty(_DEPTH, dtype=np.int64)
    for i in range(len(plane)):
        x, y = plane[i, 0], plane[i, 1]
        best = -np.inf
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            box = stack[size]
            if x < low[box, 0] or x > high[box, 0] or y < low[box, 1] or y > high[box, 1] or high[box, 2] <= best:
                continue
            if box < first_leaf:
                stack[size], stack[size + 1] = 2 * box + 1, 2 * box + 2
                size += 2
                continue
            start = (box - first_leaf) * _LEAF
            for facet in range(start, min(start + _LEAF, n)):
                if normals[facet, 2] < _UPWARD:
                    continue
                t = corners[facet]
                ux, uy, wx, wy = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[2, 0] - t[0, 0], t[2, 1] - t[0, 1]
                area = ux * wy - uy * wx
                v = ((x - t[0, 0]) * wy - (y - t[0, 1]) * wx) / area
                w = (ux * (y - t[0, 1]) - uy * (x - t[0, 0])) / area
                if v < -_RIM or w < -_RIM or v + w > 1.0 + _RIM:
                    continue
                z = t[0, 2] + v * (t[1, 2] - t[0, 2]) + w * (t[2, 2] - t[0, 2])
                if z > best:
                    best = z
                    out[i], found[i] = z, facet
    return out, found
