"""Distance from points to polylines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, read_only
from planner.base.compiled import njit

_IN_DOUBT = 1e-5  # m: a point closer than this, judged by its nearest vertices, is not checked again
_FIRST_AGAIN = 8  # vertices checked the second time, and twice as many each further time


def distance_to_polyline(points: Array, polyline: Array) -> Array:
    """Distances (n) [m] from points (n, 3) to a polyline (m, 3).

    Exact above _IN_DOUBT. Below, exact if a point's nearest segment touches one of its two nearest vertices (two,
    because a closed polyline has its first vertex twice), as it does if vertices are closer to each other than the line
    is to itself elsewhere. Where a line crosses itself, the nearest vertex may belong to another pass.
    """
    if len(points) == 0:
        return np.zeros(0)
    # splitting at sliding midpoints builds the tree in half the time, and is as good for points in a row
    tree = cKDTree(polyline, balanced_tree=False, compact_nodes=False)
    points, polyline = read_only(points), read_only(polyline)
    _, nearest = tree.query(points, k=2)
    found = _distances(points, polyline, nearest)
    half = 0.5 * float(np.linalg.norm(np.diff(polyline, axis=0), axis=1).max(initial=0.0))
    doubt, count = np.flatnonzero(found > _IN_DOUBT), _FIRST_AGAIN
    while len(doubt):
        count = min(count, len(polyline))
        away, nearest = tree.query(points[doubt], k=count)
        found[doubt] = _distances(read_only(points[doubt]), polyline, nearest.reshape(len(doubt), count))
        # one end of the nearest segment is at most half a segment farther away than the segment itself
        doubt = (
            doubt[(away.reshape(len(doubt), count)[:, -1] < found[doubt] + half)]
            if count < len(polyline)
            else doubt[:0]
        )
        count *= 2
    return found


@njit
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
