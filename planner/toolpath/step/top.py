"""Faces of a STEP file seen from above, onto which plane curves are projected; and as triangles, for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints
from planner.toolpath.bead import Shape, skin_shape
from planner.toolpath.step.body import ON_THE_RIM, FaceBody, FacePlaces
from planner.toolpath.step.files import Face
from planner.toolpath.substrate.mesh_surface import HeightField, fit

_CELLS, _MOST_CELLS = 10, 200  # least and greatest number of cells along each parameter of a face
_LINES, _LOOKS = 5, 41  # lines across a face each way, and places on each, at which its curvature is measured
_SAG = 2e-3  # m: greatest deviation of a cell from its face; bodies of triangles are moved onto the face from this far

CLOSE = 5e-7  # m: close enough to the faces; normals are then within a few hundredths of a degree
FARTHEST = 2e-5  # m: greatest distance of the smooth surface from the faces at the curves
_COARSEST, _FINEST = 8, 64  # knots of the smooth surface along the longer side of the covered area
_SAMPLES = 240  # samples of the faces along that side
_ASIDE = 1e-3  # weight of samples away from all curves, relative to those near a curve
_STEEPEST = 0.17  # least upward component of a normal: steeper faces are ignored
_STARTS = 6  # nearest samples of a place from which the search above or beneath it starts
_STEPS = 30
_LEAST_UP = 0.05  # least upward component assumed for the normal of a tangent plane
_AS_ONE = np.array([1.0, 1.0j])  # packs u and v into one number
_FOUND = 1e-10  # m: a foot this close to its place is that place
_STILL = 1e-13  # m: a smaller change of height counts as none


def faces_shape(faces: Sequence[Face]) -> Shape:
    """Triangles of faces: cells of their parameters, cut where the faces are trimmed."""
    vertices, normals = [], []
    for face in faces:
        uv = _triangles(face)
        points, out = face.points(uv), face.normals(uv)
        across = np.cross(points[1::3] - points[::3], points[2::3] - points[::3])
        turned = (across * out[::3]).sum(axis=1) < 0.0
        order = np.arange(len(uv)).reshape(-1, 3)
        order[turned] = order[turned][:, ::-1]
        vertices.append(points[order.ravel()])
        normals.append(out[order.ravel()])
    return Shape(np.vstack(vertices), np.vstack(normals), np.arange(sum(map(len, vertices))).reshape(-1, 3))


def _triangles(face: Face) -> np.ndarray:
    """Corners (3 k, 2) of k triangles in u and v."""
    outer, *holes = face.loops
    area = shapely.make_valid(shapely.Polygon(outer, holes))
    low, high = np.array(area.bounds).reshape(2, 2)
    cells = _cells(face, low, high)
    u, v = (np.linspace(a, b, count + 1) for a, b, count in zip(low, high, cells, strict=True))
    cells = shapely.box(*(edge.ravel() for edge in (*np.meshgrid(u[:-1], v[:-1]), *np.meshgrid(u[1:], v[1:]))))
    pieces = shapely.intersection(cells, area)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(pieces))
    corners = shapely.get_coordinates(triangles[shapely.area(triangles) > 0.0]).reshape(-1, 4, 2)
    return corners[:, :3].reshape(-1, 2)


def _cells(face: Face, low: Array, high: Array) -> list[int]:
    """How many cells a face needs along u and along v, between the least and the greatest of both (2)."""
    across, there = np.meshgrid(np.linspace(0.0, 1.0, _LINES), np.linspace(0.0, 1.0, _LOOKS), indexing="ij")
    sags = []
    for shares in ((there, across), (across, there)):
        uv = low + np.stack(shares, axis=-1).reshape(-1, 2) * (high - low)
        # second differences are eight times a piece's deviation from the face
        turns = np.diff(face.points(uv).reshape(_LINES, _LOOKS, 3), 2, axis=1)
        sags.append(float(np.linalg.norm(turns, axis=2).max()) / 8.0 * ((_LOOKS - 1) / _CELLS) ** 2)
    if sum(sags) <= _SAG:
        return [_CELLS, _CELLS]
    return [int(np.clip(np.ceil(_CELLS * np.sqrt(2.0 * sag / _SAG)), _CELLS, _MOST_CELLS)) for sag in sags]


class NotSmooth(ValueError):
    """The smooth surface deviates from the faces by `gap` at `place` (2) [m]: there is an edge or a step."""

    def __init__(self, gap: float, place: Array) -> None:
        self.gap, self.place = gap, place
        super().__init__(f"the faces are {gap * 1e3:.3f} mm off any smooth surface")


@dataclass(frozen=True)
class UpperFaces:
    """Faces that look upwards somewhere: their samples, the tree of the samples' x and y, and notes on their file."""

    body: FaceBody
    samples: FacePlaces
    tree: cKDTree
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, faces: Sequence[Face], notes: tuple[str, ...] = ()) -> UpperFaces | None:
        """The faces, at least one; None where none looks upwards."""
        body = FaceBody.of(faces)
        places = body.at(body.sample_face, body.sample_uv)
        # samples on rims are dense along a seam, and nearest of all around a pole: bad starts for places next to them
        on_rim = np.isin(places.uv @ _AS_ONE, body.rim_uv @ _AS_ONE)
        use = ~on_rim | ~np.isin(places.face, places.face[~on_rim])
        up = (places.normals[:, 2] > _STEEPEST) & use
        if not up.any():
            return None
        samples = FacePlaces(places.points[up], places.normals[up], places.face[up], places.uv[up])
        return cls(body, samples, cKDTree(samples.points[:, :2]), notes)

    def top(self, plane: Array) -> tuple[Array, Array]:
        """Heights (n,) of the uppermost faces at x, y (n, 2), and z components (n,) of their normals; NaN off faces.

        The foot of the perpendicular from a place in the air gives a tangent plane, which gives the next height. Unlike
        a search in u and v, this also works at a pole.
        """
        near = self.tree.query(plane, k=min(_STARTS, self.tree.n))[1].reshape(len(plane), -1)
        known = self.samples
        highest = near[np.arange(len(plane)), np.argmax(known.points[near, 2], axis=1)]
        z, up = np.full(len(plane), np.nan), np.full(len(plane), np.nan)
        for start in (highest, near[:, 0]):
            left = np.flatnonzero(np.isnan(z))
            if len(left) == 0:
                break
            height, places = self._risen(plane[left], start[left], near[left])
            off = np.linalg.norm(places.points - np.column_stack([plane[left], height]), axis=1)
            here = (off <= ON_THE_RIM) & (places.normals[:, 2] > 0.0)
            here[here] = self._on_face(places.face[here], places.uv[here])
            z[left[here]], up[left[here]] = height[here], places.normals[here, 2]
        return z, up

    def _risen(self, plane: Array, start: Ints, near: Ints) -> tuple[Array, FacePlaces]:
        """Heights (n,) above x, y (n, 2) at which a place is its own foot or, beyond a rim, settles; and feet.

        start (n,) and near (n, c): samples to start from, and from which feet are sought.
        """
        known = self.samples
        foot, normal = known.points[start], known.normals[start]
        face, uv = known.face[start], known.uv[start]
        height, busy = np.full(len(plane), np.nan), np.arange(len(plane))
        for _ in range(_STEPS):
            aside = ((plane[busy] - foot[busy, :2]) * normal[busy, :2]).sum(axis=1)
            risen = foot[busy, 2] - aside / np.maximum(normal[busy, 2], _LEAST_UP)
            moved = ~(np.abs(risen - height[busy]) <= _STILL)
            height[busy] = risen
            busy = busy[moved]
            if len(busy) == 0:
                break
            there = np.column_stack([plane[busy], height[busy]])
            places = self.body.followed(there, known.face[near[busy]], known.uv[near[busy]])
            foot[busy], normal[busy], face[busy], uv[busy] = places.points, places.normals, places.face, places.uv
            busy = busy[np.linalg.norm(places.points - there, axis=1) > _FOUND]
        return height, FacePlaces(foot, normal, face, uv)

    def beneath(self, points: Array) -> FacePlaces:
        """Feet of perpendiculars from points (n, 3) close above the faces."""
        near = self.tree.query(points[:, :2], k=min(_STARTS, self.tree.n))[1].reshape(len(points), -1)
        return self.body.followed(points, self.samples.face[near], self.samples.uv[near])

    def _on_face(self, face: Ints, uv: Array) -> NDArray[np.bool_]:
        """Whether parameters (n, 2) are inside faces (n), or on their rims, which meet within their tolerance."""
        inside = self.body.inside(face, uv)
        out = np.flatnonzero(~inside)
        inside[out] = self.body.rim_distance(face[out], self.body.at(face[out], uv[out]).points) <= ON_THE_RIM
        return inside

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the uppermost faces' normals at x, y (n, 2); NaN where there is none."""
        return self.top(plane)[1]


@dataclass(frozen=True)
class FaceTop:
    """Faces for distances and true normals; a smooth surface near curves for laying beads.

    Curves cross between faces of different curvature, and between knots within a face; the smooth surface has four
    continuous derivatives, which joints can follow. gap: its greatest deviation from the faces at the curves [m].
    """

    faces: UpperFaces
    surface: HeightField
    gap: float

    @classmethod
    def near(cls, faces: UpperFaces, curves: Array, reach: float) -> FaceTop:
        """Fit a smooth surface to faces within `reach` [m] of curves, points x, y (n, 2) that all fall onto faces.

        Raises NotSmooth if it deviates from them by more than FARTHEST at a curve.
        """
        z, up = faces.top(curves)
        low, high = curves.min(axis=0) - reach, curves.max(axis=0) + reach
        side = float((high - low).max())
        axes = [np.arange(a, b + side / _SAMPLES, side / _SAMPLES) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        away = cKDTree(curves).query(grid)[0]
        heights, steep = faces.top(grid)
        there = steep > _STEEPEST
        samples = np.column_stack([grid, heights])[there]
        weights = (np.where(away <= reach, 1.0, _ASIDE) * steep**2)[there]
        best, worst, knots = None, 0, _COARSEST
        while knots <= _FINEST and (best is None or best.gap > CLOSE):
            surface = fit(samples, weights, low, high, side / knots)
            points, normals = surface.at(curves)
            off = np.abs(points[:, 2] - z) * np.minimum(normals[:, 2], up)
            if best is None or off.max() < best.gap:
                worst = int(np.argmax(off))
                best = cls(faces, surface, float(off[worst]))
            knots *= 2
        if best is None or best.gap > FARTHEST:
            raise NotSmooth(np.inf if best is None else best.gap, curves[worst])
        return best

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the smooth surface at x, y (n, 2), even just beyond the faces."""
        return self.surface.at(plane)

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the uppermost faces' normals at x, y (n, 2); NaN where there is none."""
        return self.faces.upward(plane)

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the faces at the feet of perpendiculars from points (n, 3) just above."""
        return self.faces.beneath(points).normals

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the faces; negative inside."""
        return self.faces.body.signed_distance(points)

    def shape(self) -> Shape:
        """Triangles of the whole smooth surface."""
        return skin_shape(self.at, *self.surface.span)
