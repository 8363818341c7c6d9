"""A line near faces, brought onto them: each point onto its own face, exactly."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from planner.toolpath.coverage.patches import Array, Ints, Patch, Stroke
from planner.toolpath.coverage.sheet import Sheet

_TRIANGLES = 12  # looked at for each point, nearest middles first
_NEWTON = 6  # steps; from the net three do
_DIFFERENCE = 1e-6  # of a triangle's size in (u, v), for derivatives


def onto_faces(sheet: Sheet, line: Array, closed: bool) -> Stroke:
    """The points of the faces that are nearest to those of a line (n, 3)."""
    patch, uv = _in_net(sheet, line)
    points, normals = np.empty_like(line), np.empty_like(line)
    for k, face in enumerate(sheet.patches):
        on = patch == k
        if on.any():
            extent = np.ptp(face.loops[0], axis=0)
            uv[on] = _nearest(face, line[on], uv[on], _DIFFERENCE * extent)
            points[on], normals[on] = face.points(uv[on]), face.normals(uv[on])
    return Stroke(points, normals, patch, uv, closed)


def _in_net(sheet: Sheet, line: Array) -> tuple[Ints, Array]:
    """Face and (u, v) of the point of the net nearest to each point of a line."""
    corners = sheet.points[sheet.triangles]
    count = min(_TRIANGLES, len(corners))
    _, near = cKDTree(corners.mean(axis=1)).query(line, k=count)
    near = near.reshape(len(line), -1)
    a, b, c = (corners[near, i] for i in range(3))
    share = _shares(line[:, None] - a, b - a, c - a)
    place = a + share[..., :1] * (b - a) + share[..., 1:] * (c - a)
    best = np.argmin(np.linalg.norm(line[:, None] - place, axis=2), axis=1)
    i = np.arange(len(line))
    triangle, (s, t) = near[i, best], share[i, best].T[:, :, None]
    uv = sheet.corners[triangle]
    return sheet.patch[triangle], uv[:, 0] + s * (uv[:, 1] - uv[:, 0]) + t * (uv[:, 2] - uv[:, 0])


def _shares(p: Array, e: Array, f: Array) -> Array:
    """Coordinates of the point of the triangle (0, e, f) nearest to p, clipped into it (nearly, at its corners)."""
    ee, ef, ff = (np.einsum("...i,...i", x, y) for x, y in ((e, e), (e, f), (f, f)))
    pe, pf = np.einsum("...i,...i", p, e), np.einsum("...i,...i", p, f)
    det = np.maximum(ee * ff - ef * ef, np.finfo(float).tiny)
    s, t = (pe * ff - pf * ef) / det, (pf * ee - pe * ef) / det
    s, t = np.clip(s, 0.0, 1.0), np.clip(t, 0.0, 1.0)
    over = np.maximum(s + t, 1.0)
    return np.stack([s / over, t / over], axis=-1)


def _nearest(face: Patch, target: Array, uv: Array, difference: Array) -> Array:
    """(u, v) of the points of a face nearest to targets, from near by: Gauss and Newton's method."""
    for _ in range(_NEWTON):
        off = target - face.points(uv)
        du, dv = (
            (face.points(uv + step) - face.points(uv - step)) / (2.0 * step.max())
            for step in (difference * [1.0, 0.0], difference * [0.0, 1.0])
        )
        uu, uv_, vv = (np.einsum("ij,ij->i", x, y) for x, y in ((du, du), (du, dv), (dv, dv)))
        pu, pv = np.einsum("ij,ij->i", off, du), np.einsum("ij,ij->i", off, dv)
        det = uu * vv - uv_ * uv_
        # at a pole one direction is nothing: stay
        safe = det > 1e-12 * (uu * vv).max()
        det = np.where(safe, det, 1.0)
        uv = uv + np.where(safe, [(pu * vv - pv * uv_) / det, (pv * uu - pu * uv_) / det], 0.0).T
    return uv
