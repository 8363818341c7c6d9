"""Distance along a net of triangles from given points: fast marching (Kimmel and Sethian 1998)."""

from __future__ import annotations

import heapq

import numpy as np
from numba import njit

from planner.readonly import Array, Ints


def march(points: Array, triangles: Ints, start: Array) -> Array:
    """Distances (n,) [m] of points (n, 3): start (n,) where it is finite, from there on along triangles (m, 3).

    Exact in the plane for a straight source; elsewhere of first order in the triangles' size. Infinite where no
    triangle leads.
    """
    corner = triangles.ravel()
    order = np.argsort(corner, kind="stable")
    first = np.searchsorted(corner[order], np.arange(len(points) + 1))
    return _march(points, triangles, order // 3, first, start)


@njit(cache=True)
def _march(points: Array, triangles: Ints, around: Ints, first: Ints, start: Array) -> Array:
    value = start.copy()
    done = np.zeros(len(points), dtype=np.bool_)
    front = [(np.inf, -1)]
    for i in range(len(points)):
        if np.isfinite(value[i]):
            heapq.heappush(front, (value[i], i))
    while len(front) > 0:
        price, here = heapq.heappop(front)
        if here < 0:
            break
        if done[here] or price > value[here]:
            continue
        done[here] = True
        for k in range(first[here], first[here + 1]):
            triangle = triangles[around[k]]
            for i in range(3):
                there, other = triangle[i], triangle[(i + 1) % 3]
                if there == here or done[there]:
                    continue
                if other == here:
                    other = triangle[(i + 2) % 3]
                new = value[here] + np.sqrt(np.sum((points[there] - points[here]) ** 2))
                if done[other]:
                    new = min(
                        new,
                        _through(
                            points[here] - points[there], points[other] - points[there], value[here], value[other]
                        ),
                    )
                if new < value[there]:
                    value[there] = new
                    heapq.heappush(front, (new, there))
    return value


@njit(cache=True)
def _through(a: Array, b: Array, at_a: float, at_b: float) -> float:
    """When a straight front that passes two corners at given distances reaches the third (a, b: the two from there);
    infinite where it does not come through the triangle."""
    aa, ab, bb = np.sum(a * a), np.sum(a * b), np.sum(b * b)
    det = aa * bb - ab * ab
    if det <= 0.0:
        return np.inf
    # inverse of the Gram matrix: |gradient|^2 = (T - p)' Q (T - p) = 1
    qaa, qab, qbb = bb / det, -ab / det, aa / det
    x = qaa + 2.0 * qab + qbb
    y = at_a * (qaa + qab) + at_b * (qab + qbb)
    z = at_a * at_a * qaa + 2.0 * at_a * at_b * qab + at_b * at_b * qbb - 1.0
    root = y * y - x * z
    if root < 0.0:
        return np.inf
    p = (y + np.sqrt(root)) / x
    if qaa * (at_a - p) + qab * (at_b - p) > 0.0 or qab * (at_a - p) + qbb * (at_b - p) > 0.0:
        return np.inf
    return p
