"""Distance from points to polylines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, read_only
from planner.base.compiled import njit


def distance_to_polyline(points: Array, polyline: Array) -> Array:
    """Distances (n) from points (n, 3) to a polyline (m, 3) whose vertices lie close together.

    Exact if a point's nearest segment touches one of its two nearest vertices (two, because a closed polyline has
    its first vertex twice), as it does when vertices are closer to each other than the line is to itself elsewhere.
    """
    if len(points) == 0:
        return np.zeros(0)
    # a tree of sliding midpoints is built in half the time, and as good for points in a row
    _, nearest = cKDTree(polyline, balanced_tree=False, compact_nodes=False).query(points, k=2)
    return _distances(read_only(points), read_only(polyline), nearest)


@njit(cache=True)
def _distances(points: Array, polyline: Array, nearest: NDArray[np.intp]) -> Array:
    """Distances (n) to the segments at each point's nearest vertices (n, k)."""
    out = np.empty(len(points))
    last = len(polyline) - 2
    for i in range(len(points)):
        best = np.inf
        for vertex in nearest[i]:
            for start in (vertex - 1, vertex):
                j = min(max(start, 0), last)
                along = length = 0.0
                for k in range(3):
                    d = polyline[j + 1, k] - polyline[j, k]
                    along += (points[i, k] - polyline[j, k]) * d
                    length += d * d
                t = min(max(along / max(length, 1e-30), 0.0), 1.0)
                square = 0.0
                for k in range(3):
                    gap = points[i, k] - polyline[j, k] - t * (polyline[j + 1, k] - polyline[j, k])
                    square += gap * gap
                best = min(best, square)
        out[i] = np.sqrt(best)
    return out
