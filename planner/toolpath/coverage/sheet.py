"""Faces as one net of triangles: seams sewn, holes filled, every corner knowing where on its face it is.

Holes are filled so that rows run straight on behind them; the triangles in them are no material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from planner.toolpath.coverage.patches import Array, Ints, Patch

_SEWN = 2e-5  # m: points of two faces' edges that are nearer than this are one
_CLEAR = 0.6  # mesh sizes: nearer to the edge, no point is put
_LOOKED = 5  # parts of a side of a triangle at the rim, where coverage is looked at
_LOOKS = 33  # lines of u and of v along which a face is measured


@dataclass(frozen=True)
class Sheet:
    """points (n, 3) [m]; triangles (m, 3), indices of points; patch (m,), the face of each; corners (m, 3, 2), the
    (u, v) of each triangle's corners on it; material (m,), false in holes; size: the distance of points, about [m]."""

    patches: tuple[Patch, ...]
    points: Array
    triangles: Ints
    patch: Ints
    corners: Array
    material: NDArray[np.bool_]
    size: float

    def edges(self) -> Ints:
        """Edges (3m, 2) of the triangles, a triangle's three in a row: its corners 0-1, 1-2, 2-0."""
        return np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=2).reshape(-1, 2)

    def normals(self) -> Array:
        """Unit normals at the points (n, 3), outward as the faces say."""
        out = np.zeros_like(self.points)
        for k, face in enumerate(self.patches):
            on = self.patch == k
            corner = self.triangles[on].ravel()
            np.add.at(out, corner, face.normals(self.corners[on].reshape(-1, 2)))
        return out / np.maximum(np.linalg.norm(out, axis=1), np.finfo(float).tiny)[:, None]

    def looked_at(self, rim: Ints) -> Array:
        """Points (k, 3) all over the material: those of the net, and the middles of its triangles; more of them in
        triangles that touch one of the points `rim`, where rows end."""
        net = self.triangles[self.material]
        corners = self.points[net]
        fine = corners[np.isin(net, rim).any(axis=1)]
        share = np.array(
            [(i, j, _LOOKED - i - j) for i in range(_LOOKED + 1) for j in range(_LOOKED + 1 - i)], dtype=np.float64
        )
        closely = np.einsum("ki,mij->mkj", share / _LOOKED, fine).reshape(-1, 3)
        return np.vstack([self.points[np.unique(net)], corners.mean(axis=1), closely])


def sheet_of(patches: Sequence[Patch], size: float) -> Sheet:
    """Triangulate faces with points about `size` [m] apart, and those of their loops as they are."""
    points, triangles, owner, corners, material = [], [], [], [], []
    count = 0
    for k, patch in enumerate(patches):
        uv, faces, solid = _triangulate(patch, size)
        points.append(patch.points(uv))
        triangles.append(faces + count)
        corners.append(uv[faces])
        owner.append(np.full(len(faces), k, dtype=np.int64))
        material.append(solid)
        count += len(uv)
    joined = np.concatenate(points)
    name = _sew(joined)
    used, compact = np.unique(name, return_inverse=True)
    net = compact[np.concatenate(triangles)]
    # a triangle of a pole, where a whole edge of the face is one point, may have two corners there
    kept = (net[:, 0] != net[:, 1]) & (net[:, 1] != net[:, 2]) & (net[:, 2] != net[:, 0])
    return Sheet(
        tuple(patches),
        joined[used],
        net[kept],
        np.concatenate(owner)[kept],
        np.concatenate(corners)[kept],
        np.concatenate(material)[kept],
        size,
    )


def inside(loop: Array, uv: Array) -> NDArray[np.bool_]:
    """Which points (n, 2) a closed polyline (m, 2) goes round an odd number of times."""
    a, b = loop, np.roll(loop, -1, axis=0)
    odd = np.zeros(len(uv), dtype=np.bool_)
    for (ax, ay), (bx, by) in zip(a, b, strict=True):
        if ay == by:
            continue
        spans = (ay > uv[:, 1]) != (by > uv[:, 1])
        odd ^= spans & (uv[:, 0] < ax + (uv[:, 1] - ay) * (bx - ax) / (by - ay))
    return odd


def _triangulate(patch: Patch, size: float) -> tuple[Array, Ints, NDArray[np.bool_]]:
    """(u, v) of the points of one face, its triangles, and which of them are material."""
    outer, holes = patch.loops[0], patch.loops[1:]
    edge = np.concatenate(patch.loops)
    low, high = outer.min(axis=0), outer.max(axis=0)
    knots = [np.linspace(low[i], high[i], _LOOKS) for i in range(2)]
    grid = np.stack(np.meshgrid(*knots, indexing="ij"), axis=-1)
    places = patch.points(grid.reshape(-1, 2)).reshape(_LOOKS, _LOOKS, 3)
    # mean length along u, and along v: coordinates in which the face is about its own size
    along = [
        np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=i), axis=2).mean(axis=1 - i))])
        for i in range(2)
    ]
    columns = max(int(np.ceil(along[0][-1] / size)), 2)
    rows = max(int(np.ceil(along[1][-1] / (size * np.sqrt(0.75)))), 2)
    s, t = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1), indexing="ij")
    s = s + 0.5 / columns * (np.arange(rows + 1) % 2)  # every second row half a step further: equal triangles
    st = np.stack([s.ravel() * along[0][-1], t.ravel() * along[1][-1]], axis=1)
    st = st[st[:, 0] < along[0][-1]]
    uv = np.stack([np.interp(st[:, i], along[i], knots[i]) for i in range(2)], axis=1)
    uv = uv[inside(outer, uv)]
    near, _ = cKDTree(patch.points(edge)).query(patch.points(uv))
    uv = np.concatenate([edge, uv[near > _CLEAR * size]])
    st = np.stack([np.interp(uv[:, i], knots[i], along[i]) for i in range(2)], axis=1)
    net = Delaunay(st).simplices.astype(np.int64)
    middle = uv[net].mean(axis=1)
    net = net[inside(outer, middle)]
    solid = np.ones(len(net), dtype=np.bool_)
    for hole in holes:
        solid &= ~inside(hole, uv[net].mean(axis=1))
    return uv, net, solid


def _sew(points: Array) -> Ints:
    """For each point the lowest index of those at the same place (n,)."""
    name = np.arange(len(points), dtype=np.int64)
    pairs = cKDTree(points).query_pairs(_SEWN, output_type="ndarray")
    for _ in range(len(points)):
        low = np.minimum(name[pairs[:, 0]], name[pairs[:, 1]])
        before = name.copy()
        np.minimum.at(name, pairs[:, 0], low)
        np.minimum.at(name, pairs[:, 1], low)
        if np.array_equal(name, before):
            break
    return name
