"""Points that stand for a surface: no solid that keeps its clearance from them comes nearer to the surface."""

from __future__ import annotations

import numpy as np

from planner.readonly import Array

_SPACING = 2e-3  # m
_MOST = 100_000  # points, about: larger surfaces have them farther apart
_AREA = 0.5  # of the square of the spacing, about, that falls to one point


def surface_points(corners: Array, clearance: float) -> tuple[Array, float]:
    """Points (n, 3) all over triangles (m, 3, 3) [m], and the radius that makes up for what is between them.

    clearance: the least distance that is asked of them [m]; at less the surface may be nearer than they say.
    """
    across = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    spacing = max(_SPACING, float(np.sqrt(0.5 * across.sum() / (_MOST * _AREA))))
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    parts = np.maximum(np.ceil(longest / spacing), 1.0).astype(np.int64)
    points = []
    for n in np.unique(parts):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        u, v = i[inside] / n, j[inside] / n
        share = np.column_stack([1.0 - u - v, u, v])
        points.append(np.einsum("kc,mcx->mkx", share, corners[parts == n]).reshape(-1, 3))
    # no place of a triangle is farther than this from one of its corners
    away = spacing / np.sqrt(3.0)
    return np.concatenate(points), float(np.hypot(clearance, away) - clearance)
