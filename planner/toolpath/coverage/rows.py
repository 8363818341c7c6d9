"""Rows that cover faces: lines of equal distance from an edge or a middle line, joined into strokes.

Rows never cross, because they are level lines of one function. They are joined along the edge of the material
(`stitch.py`). Of several sources of distance, the one whose strokes take the least time is chosen. Strokes are
projected onto the true faces point by point.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints
from planner.base.geometry import arc_lengths
from planner.toolpath.coverage.measures import SurfaceLine, crossings, distances, seconds
from planner.toolpath.coverage.sheet import FaceMesh, Patch, Rim, Row, Stroke, fields_of, rows_at, sheet_of
from planner.toolpath.coverage.stitch import (
    InsetEdge,
    chosen_joints,
    evenly,
    possible_joints,
    row_chains,
    smooth,
    stitched,
)
from planner.toolpath.ordering import nearest_first

_TRIANGLES = 12  # checked for each point, those with the nearest centroids
_NEWTON = 6  # steps; three suffice from the net
_DIFFERENCE = 1e-6  # × the face's extent in (u, v): step of finite differences

REACH = 0.55  # spacings: no point of a face is farther from the strokes
_MESH = 0.25  # spacings between points of the net
_INSET = 0.04  # spacings between the edge and where rows end and joints run
_KERNEL = 0.3  # spacings: half width of the kernel that rounds turns at rows' ends; about as wide as REACH allows
_STEP = 0.1  # spacings between points of a stroke
_FINE = 0.025  # spacings between points that are averaged
_SHORTEST = 0.3  # spacings: a shorter row is a dot
_TRIES = 4  # with rows added, one place at a time, for what is left uncovered
_WIDER = 1.02  # × the spacing: rows may be this far apart if that saves one
_CLOSER = 0.97  # × the spacing, for each new attempt if strokes leave points out of reach
_CLOSEST = 5  # attempts with closer rows, at most
_AIM = 0.543  # spacings: REACH, less a margin for places between the points checked


def onto_faces(sheet: FaceMesh, line: Array, closed: bool) -> Stroke:
    """Project a line (n, 3) onto the nearest points of the faces."""
    patch, uv = _in_net(sheet, line)
    points, normals = np.empty_like(line), np.empty_like(line)
    for k, face in enumerate(sheet.patches):
        on = patch == k
        if on.any():
            extent = np.ptp(face.loops[0], axis=0)
            uv[on] = _nearest(face, line[on], uv[on], _DIFFERENCE * extent)
            points[on], normals[on] = face.points(uv[on]), face.normals(uv[on])
    return Stroke(points, normals, patch, uv, closed)


def _in_net(sheet: FaceMesh, line: Array) -> tuple[Ints, Array]:
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
    """(u, v) of the points of a face nearest to targets, from a start nearby, by the Gauss-Newton method."""
    for _ in range(_NEWTON):
        off = target - face.points(uv)
        du, dv = (
            (face.points(uv + step) - face.points(uv - step)) / (2.0 * step.max())
            for step in (difference * [1.0, 0.0], difference * [0.0, 1.0])
        )
        uu, uv_, vv = (np.einsum("ij,ij->i", x, y) for x, y in ((du, du), (du, dv), (dv, dv)))
        pu, pv = np.einsum("ij,ij->i", off, du), np.einsum("ij,ij->i", off, dv)
        det = uu * vv - uv_ * uv_
        # at a pole one derivative vanishes: stay
        safe = det > 1e-12 * (uu * vv).max()
        det = np.where(safe, det, 1.0)
        uv = uv + np.where(safe, [(pu * vv - pv * uv_) / det, (pv * uu - pu * uv_) / det], 0.0).T
    return uv


class TooSmallError(ValueError):
    """No row fits onto the faces at this spacing."""


class NotCoveredError(ValueError):
    """All strokes tried cross or leave points of the faces out of REACH; `farthest`: of the best [spacings]."""

    def __init__(self, farthest: float) -> None:
        self.farthest = farthest
        super().__init__(f"no rows without crossings reach every point of the faces ({farthest:.2f} spacings at best)")


@dataclass(frozen=True)
class _Net:
    """The faces' net, and data looked up on it repeatedly.

    normals, tree  unit normals (n, 3) at the net's points, and a tree of these points
    solid          indices of the points of the material
    looked_at      (k, 3) points all over the material, where coverage is checked
    """

    sheet: FaceMesh
    rim: Rim
    normals: Array
    tree: cKDTree
    solid: Ints
    looked_at: Array


@dataclass(frozen=True)
class _Candidate:
    """Strokes before they are projected onto the faces.

    Lines (n, 3), each with whether it is closed; their approximate time [s]; and how far the farthest point of the
    material is from them [spacings].
    """

    lines: tuple[tuple[Array, bool], ...]
    time: float
    farthest: float


def cover(patches: Sequence[Patch], spacing: float, speed: float) -> list[Stroke]:
    """Strokes that cover faces, sewn together where they meet, for printing at `speed` [m/s].

    Rows are at most 1.02 `spacing` [m] apart. No point of the faces is farther from the strokes than REACH; they
    neither cross nor touch. Raises TooSmallError or NotCoveredError.
    """
    sheet = sheet_of(patches, _MESH * spacing)
    solid = np.unique(sheet.triangles[sheet.material])
    rim = Rim.of(sheet)
    looked_at = sheet.looked_at(rim.edges.ravel())
    net = _Net(sheet, rim, sheet.normals(), cKDTree(sheet.points), solid, looked_at)
    # the quickest first; one that leaves points out of reach is queued again with its rows closer together
    queue: list[tuple[float, int, int, _Candidate]] = []
    fields = fields_of(sheet, rim, spacing)
    for k, field in enumerate(fields):
        _tried(queue, net, field, k, 0, spacing, speed)
    nearest = np.inf
    while queue:
        _, k, closer, best = heapq.heappop(queue)
        nearest = min(nearest, best.farthest)
        if best.farthest <= _AIM:
            strokes = [onto_faces(sheet, line, closed) for line, closed in best.lines]
            # ends that reach into corners of the material could meet there
            if not len(crossings([SurfaceLine(stroke.points, stroke.normals, stroke.closed) for stroke in strokes])):
                return strokes
        if closer < _CLOSEST:
            _tried(queue, net, fields[k], k, closer + 1, spacing, speed)
    if np.isinf(nearest):
        raise TooSmallError("the faces are too small for a row at this spacing")
    raise NotCoveredError(nearest)


def _tried(
    queue: list[tuple[float, int, int, _Candidate]],
    net: _Net,
    field: Array,
    k: int,
    closer: int,
    spacing: float,
    speed: float,
) -> None:
    """Queue the strokes of the k-th field, with its rows moved closer `closer` times, unless it has none."""
    found = _candidate(net, field, spacing, spacing * _CLOSER**closer, speed)
    if found is not None:
        heapq.heappush(queue, (found.time, k, closer, found))


def _candidate(net: _Net, field: Array, spacing: float, apart: float, speed: float) -> _Candidate | None:
    """Rows of one field about `apart` [m] apart, joined and smoothed; None if there are none."""
    low, high = float(field[net.solid].min()), float(field[net.solid].max())
    count = max(int(np.ceil((high - low) / (_WIDER * apart))), 1)
    heights: Array = np.linspace(low, high, 2 * count + 1)[1::2]
    rows = [
        row for k, height in enumerate(heights) for row in rows_at(net.sheet, net.rim, field, float(height), float(k))
    ]
    best: _Candidate | None = None
    for _ in range(_TRIES):
        kept = [cut for row in rows if (cut := _shortened(row, spacing)) is not None]
        if not kept:
            return best
        lines = _strokes(net.sheet, net.rim, kept, spacing)
        measured = [SurfaceLine(line, net.normals[net.tree.query(line)[1]], closed) for line, closed in lines]
        away = distances([line.opened()[0] for line in measured], net.looked_at)
        found = _Candidate(tuple(lines), seconds(measured, speed, _INSET * spacing), float(away.max()) / spacing)
        if best is None or found.farthest < best.farthest:
            best = found
        if found.farthest <= _AIM:
            return found
        extra = _cap(net, field, heights, net.looked_at[np.argmax(away)], spacing)
        if not extra:
            return best
        rows += extra
    return best


def _strokes(sheet: FaceMesh, rim: Rim, rows: Sequence[Row], spacing: float) -> list[tuple[Array, bool]]:
    """Rows joined into as few lines as possible, smoothed, in print order."""
    joints = chosen_joints(possible_joints(rows, rim.around, spacing), spacing)
    edge = InsetEdge.of(sheet, rim, _INSET * spacing)
    out = []
    for chain in row_chains(len(rows), joints):
        closed = rows[chain[0][0]].ends is None
        line = rows[chain[0][0]].points if closed else stitched(rows, chain, joints, edge, spacing)
        line = smooth(line, _KERNEL * spacing, _FINE * spacing, closed)
        out.append((evenly(line, _STEP * spacing, closed), closed))
    return _in_turn(out)


def _in_turn(lines: Sequence[tuple[Array, bool]]) -> list[tuple[Array, bool]]:
    """Lines in print order, always with the nearest end next; open ones may be reversed."""
    turned = ((*lines[k], back) for k, back in nearest_first(lines))
    return [(line[::-1].copy() if back else line, closed) for line, closed, back in turned]


def _shortened(row: Row, spacing: float) -> Row | None:
    """The row without the parts too near the edge; None if hardly anything is left."""
    if row.ends is None:
        return row if row.length > _SHORTEST * spacing else None
    s = arc_lengths(row.points)
    first, last = _INSET * spacing, s[-1] - _INSET * spacing
    if last - first < _SHORTEST * spacing:
        return None
    at = np.concatenate([[first], s[(s > first) & (s < last)], [last]])
    points = np.stack([np.interp(at, s, row.points[:, i]) for i in range(3)], axis=1)
    return replace(row, points=points)


def _cap(net: _Net, field: Array, heights: Array, place: Array, spacing: float) -> list[Row]:
    """Further rows halfway between the last level and a place (3,) that it leaves out of reach.

    Such places occur where the material ends between two levels.
    """
    far = float(field[net.tree.query(place)[1]])
    base = int(np.clip(np.searchsorted(heights, far) - 1, 0, len(heights) - 1))
    level = base + 0.5 * float(np.sign(far - heights[base]))
    return [
        row
        for row in rows_at(net.sheet, net.rim, field, 0.5 * float(heights[base] + far), level)
        if np.linalg.norm(row.points - place, axis=1).min() < spacing and row.length > _SHORTEST * spacing
    ]
