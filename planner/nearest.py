"""Distance from points to polylines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]


def distance_to_polyline(points: Array, polyline: Array) -> Array:
    """Distances (n) from points (n, 3) to a polyline (m, 3) whose vertices lie close together.

    Exact if a point's nearest segment touches one of its two nearest vertices (two, because a closed polyline has
    its first vertex twice), as it does when vertices are closer to each other than the line is to itself elsewhere.
    """
    if len(points) == 0:
        return np.zeros(0)
    _, nearest = cKDTree(polyline).query(points, k=2)
    best = np.full(len(points), np.inf)
    for start in np.concatenate([nearest - 1, nearest], axis=1).T:
        start = np.clip(start, 0, len(polyline) - 2)
        a, b = polyline[start], polyline[start + 1]
        d = b - a
        t = np.clip(((points - a) * d).sum(axis=1) / np.maximum((d * d).sum(axis=1), 1e-30), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * d, axis=1))
    return best
