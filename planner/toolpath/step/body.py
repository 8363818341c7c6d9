"""Faces that make up a body: the nearest place on them, exactly, and on which side of them a point is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.readonly import Array, Ints, ReadOnlyArrays, read_only
from planner.toolpath.step.face import Face
from planner.toolpath.step.nearest import settle, signed
from planner.toolpath.step.splines import SplineSet
from planner.toolpath.step.trim import all_inside, normals_met, raster_of, shared

_COARSEST, _FINEST, _SHARE = 5e-3, 1e-3, 0.01  # m between samples of a face, as a share of its size
_MOST_ACROSS = 400  # samples of a face along u or v
_CANDIDATES = 8  # samples near a point whose faces are looked at
_TINY = 1e-300


@dataclass(frozen=True)
class Places(ReadOnlyArrays):
    """Places on faces: points and unit outward normals (n, 3) [m]; face (n), its position in the body; uv (n, 2)."""

    points: Array
    normals: Array
    face: Ints
    uv: Array


@dataclass(frozen=True)
class FaceBody:
    """Faces and what it takes to find the nearest of them.

    splines, side (k)  of the faces
    raster (k, 64, 64) of the box [low, high] (k, 2) around each face's loops: 0 outside, 1 inside, 2 both
    rim ...            the loops' points: uv (m, 2), points (m, 3), the sum (m, 3) of the normals of the faces that meet
                       there, whether their edge has a face on both sides (m), index (m) of the next one, first (k + 1)
                       of each face
    sample ...         samples: face (s), uv (s, 2), and the tree of their points
    """

    splines: SplineSet
    side: Ints
    raster: NDArray[np.int8]
    low: Array
    high: Array
    rim_uv: Array
    rim_points: Array
    rim_normals: Array
    rim_shared: NDArray[np.bool_]
    rim_next: Ints
    rim_first: Ints
    sample_face: Ints
    sample_uv: Array
    tree: cKDTree

    @classmethod
    def of(cls, faces: Sequence[Face]) -> FaceBody:
        """The body of faces, at least one."""
        splines = SplineSet.of([face.surface for face in faces])
        side = np.array([face.side for face in faces], dtype=np.int64)
        rim = [np.vstack(face.loops) for face in faces]
        rim_uv = np.vstack(rim)
        rim_first = np.concatenate([[0], np.cumsum([len(points) for points in rim])])
        owner = np.repeat(np.arange(len(faces)), np.diff(rim_first))
        following, start = [], 0
        for face in faces:
            for loop in face.loops:
                following.append(start + np.roll(np.arange(len(loop)), -1))
                start += len(loop)
        rim_next = np.concatenate(following)
        rim_points = splines.points(owner, rim_uv)
        normals = side[owner, None] * splines.normals(owner, rim_uv)
        rim_shared, pole = shared([on for face in faces for on in face.edges], rim_points, rim_next)
        low, high = (np.array([f(points, axis=0) for points in rim]) for f in (np.min, np.max))
        raster = np.stack(
            [raster_of(rim_uv, rim_next, rim_first[k], rim_first[k + 1], low[k], high[k]) for k in range(len(faces))]
        )
        body = cls(
            splines,
            side,
            raster,
            low,
            high,
            rim_uv,
            rim_points,
            normals_met(rim_points, normals),
            rim_shared,
            rim_next,
            rim_first,
            owner,
            rim_uv,
            cKDTree(rim_points),
        )
        grids = [body._grid(k) for k in range(len(faces))]
        sample_face = np.concatenate([owner[~pole], *[np.full(len(g), k, dtype=np.int64) for k, g in enumerate(grids)]])
        sample_uv = np.vstack([rim_uv[~pole], *grids])  # at a pole no foot can be looked for
        tree = cKDTree(splines.points(sample_face, sample_uv))
        return cls(**{**vars(body), "sample_face": sample_face, "sample_uv": sample_uv, "tree": tree})

    def _grid(self, face: int) -> Array:
        """Samples (n, 2) of a face, inside it."""
        box = np.array([self.low[face], self.high[face]])
        lines = np.linspace(0.0, 1.0, 17)
        u, v = np.meshgrid(lines, lines, indexing="ij")
        uv = box[0] + np.stack([u, v], axis=-1).reshape(-1, 2) * (box[1] - box[0])
        points = self.splines.points(np.full(len(uv), face), uv).reshape(17, 17, 3)
        size = float(np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0)))
        step = min(max(_SHARE * size, _FINEST), _COARSEST)
        across = [np.linalg.norm(np.diff(points, axis=k), axis=2).sum(axis=k).max() for k in (0, 1)]
        counts = [min(max(int(np.ceil(length / step)), 2), _MOST_ACROSS) for length in across]
        axes = [np.linspace(box[0, k], box[1, k], counts[k] + 2)[1:-1] for k in (0, 1)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        return grid[self.inside(np.full(len(grid), face), grid)]

    def inside(self, face: Ints, uv: Array) -> NDArray[np.bool_]:
        """Whether parameters (n, 2) lie within the loops of faces (n)."""
        return all_inside(
            np.ascontiguousarray(face, dtype=np.int64),
            np.ascontiguousarray(uv),
            self.raster,
            self.low,
            self.high,
            self.rim_uv,
            self.rim_next,
            self.rim_first,
        )

    def rim_distance(self, face: Ints, points: Array) -> Array:
        """Distances (n,) of points (n, 3) from the rims of faces (n) [m]."""
        out = np.empty(len(points))
        before = np.empty_like(self.rim_next)
        before[self.rim_next] = np.arange(len(before))
        for k in np.unique(face):
            on, p = face == k, points[face == k]
            first = self.rim_first[k]
            near = first + cKDTree(self.rim_points[first : self.rim_first[k + 1]]).query(p)[1]
            a, b, c = (self.rim_points[at] for at in (before[near], near, self.rim_next[near]))
            out[on] = np.minimum(_to_segments(p, a, b), _to_segments(p, b, c))
        return out

    def at(self, face: Ints, uv: Array) -> Places:
        """The places at parameters (n, 2) of faces (n)."""
        normals = self.side[face, None] * self.splines.normals(face, uv)
        return Places(self.splines.points(face, uv), normals, np.asarray(face, dtype=np.int64), uv)

    def beneath(self, points: Array) -> Places:
        """Feet of perpendiculars from points (n, 3) close to the faces; a little beyond an open rim, feet on the surface
        that goes on there."""
        _, near = self.tree.query(points, k=min(_CANDIDATES, self.tree.n))
        near = near.reshape(len(points), min(_CANDIDATES, self.tree.n))
        return self._feet(points, self.sample_face[near], self.sample_uv[near])

    def followed(self, points: Array, face: Ints, uv: Array) -> Places:
        """The same, begun from places on faces (n, c) with parameters (n, c, 2), c to try for each."""
        return self._feet(points, face, uv)

    def _feet(self, points: Array, face: Ints, uv: Array) -> Places:
        s = self.splines
        found, place = settle(
            read_only(points),
            np.ascontiguousarray(face),
            np.ascontiguousarray(uv),
            s.knots,
            s.poles,
            s.table,
            s.domain,
            self.raster,
            self.low,
            self.high,
            self.rim_uv,
            self.rim_next,
            self.rim_first,
        )
        return self.at(found, place)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the material [m]; negative inside."""
        return self._nearest(points)[0]

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) at the places of the faces nearest to points (n, 3)."""
        return self._nearest(points)[1]

    def _nearest(self, points: Array) -> tuple[Array, Array]:
        _, near = self.tree.query(points, k=min(_CANDIDATES, self.tree.n))
        near = np.ascontiguousarray(near.reshape(len(points), min(_CANDIDATES, self.tree.n)))
        s = self.splines
        return signed(
            read_only(points),
            near,
            self.sample_face,
            self.sample_uv,
            np.asarray(self.tree.data),
            s.knots,
            s.poles,
            s.table,
            s.domain,
            self.side,
            self.raster,
            self.low,
            self.high,
            self.rim_uv,
            self.rim_points,
            self.rim_normals,
            self.rim_shared,
            self.rim_next,
            self.rim_first,
            bool(self.rim_shared.all()),
        )


def _to_segments(points: Array, a: Array, b: Array) -> Array:
    """Distances (n,) of points from segments a b, all (n, 3)."""
    way = b - a
    t = np.clip(((points - a) * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), _TINY), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - a - t[:, None] * way, axis=1))
