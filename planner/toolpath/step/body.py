"""Faces that make up a body: the exact nearest place on them, and on which side of them a point lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints, ReadOnlyArrays, read_only
from planner.base.compiled import inner_njit, njit
from planner.base.processes import in_blocks
from planner.toolpath.step.files import Face
from planner.toolpath.step.splines import SplineArrays, SplineSet, fill_normal, foot_of

# ----------------------------------------------------------------------------------------------------
# Inside or outside the loops that trim faces, and data along their rims.

Raster = NDArray[np.int8]

ON_THE_RIM = 5e-6  # m: a place this near a face's rim counts as on it; its edges are known to 2 um
CELLS = 64  # along each side of a face's raster, which separates most inside places from outside ones
_MIXED = 2
_SAME = 1.0 - 1e-6  # cosine between normals that count as one


def shared(loops: Sequence[Ints], points: Array, following: Ints) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """For each point of loops, whether its edge is shared (m), and whether it lies at a pole (m), an edge of no length.

    An edge is shared if its number also occurs in another loop, or twice in one, or if it is a pole.
    """
    edge = np.concatenate(loops)
    offsets = np.concatenate([[0], np.cumsum([len(on) for on in loops])[:-1]])
    begins = np.concatenate(
        [
            offset + (np.flatnonzero(on != np.roll(on, 1)) if (on != on[0]).any() else np.array([0]))
            for offset, on in zip(offsets, loops, strict=True)
        ]
    )
    numbers, runs = np.unique(edge[begins], return_counts=True)
    lengths = np.zeros(int(edge.max()) + 1)
    np.add.at(lengths, edge, np.linalg.norm(points[following] - points, axis=1))
    pole = lengths[edge] < ON_THE_RIM
    joined = np.isin(edge, numbers[runs > 1]) | pole
    if pole.any():  # this includes points of the edges that end there
        pole = cKDTree(points[pole]).query(points)[0] <= ON_THE_RIM
    return joined, pole


def normals_met(points: Array, normals: Array) -> Array:
    """For points (m, 3) of rims, the sum (m, 3) of the normals at the same place, each direction once.

    Once, because the sum of two nearly opposite normals points out of the material only if their weights are equal.
    """
    pairs = cKDTree(points).query_pairs(2.0 * ON_THE_RIM, output_type="ndarray")
    pairs = pairs[(normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1) < _SAME]
    met: dict[int, list[Array]] = {}
    for i, j in np.vstack([pairs, pairs[:, ::-1]]):
        known = met.setdefault(int(i), [normals[i]])
        if all(other @ normals[j] < _SAME for other in known):
            known.append(normals[j])
    total = normals.copy()
    for i, known in met.items():
        total[i] = np.sum(known, axis=0)
    return total


def raster_of(uv: Array, following: Ints, first: int, last: int, low: Array, high: Array) -> Raster:
    """Cells (64, 64) of a face's box: 0 outside, 1 inside, 2 where its rim runs."""
    step = (high - low) / CELLS
    a, b = (uv[first:last] - low) / step, (uv[following[first:last]] - low) / step
    cells = np.zeros((CELLS, CELLS), dtype=np.int8)
    pieces = np.maximum(np.ceil(4.0 * np.abs(b - a).max(axis=1)).astype(int), 1)
    index = np.repeat(np.arange(len(a)), pieces + 1)
    t = (np.arange(len(index)) - np.repeat(np.cumsum(pieces + 1) - pieces - 1, pieces + 1)) / pieces[index]
    run = a[index] + t[:, None] * (b - a)[index]
    near = np.floor(run[:, None, :] + np.array([[x, y] for x in (-0.3, 0.3) for y in (-0.3, 0.3)])).astype(int)
    near = np.clip(near.reshape(-1, 2), 0, CELLS - 1)
    cells[near[:, 0], near[:, 1]] = _MIXED
    clear = np.argwhere(cells != _MIXED)
    middles = low + (clear + 0.5) * step
    cells[clear[:, 0], clear[:, 1]] = _within(middles, uv, following, first, last)
    return cells


class RimArrays(NamedTuple):
    """The loops that trim faces (k), as compiled kernels take them: see `FaceBody`."""

    raster: Raster
    low: Array
    high: Array
    uv: Array
    points: Array
    normals: Array
    shared: NDArray[np.bool_]
    next: Ints
    first: Ints


@inner_njit
def _crossings(u: float, v: float, uv: Array, following: Ints, first: int, last: int) -> bool:
    """Even-odd rule."""
    odd = False
    for i in range(first, last):
        j = following[i]
        if (uv[i, 1] > v) != (uv[j, 1] > v):
            at = uv[i, 0] + (v - uv[i, 1]) / (uv[j, 1] - uv[i, 1]) * (uv[j, 0] - uv[i, 0])
            if u < at:
                odd = not odd
    return odd


@njit
def _within(places: Array, uv: Array, following: Ints, first: int, last: int) -> Raster:
    out = np.zeros(len(places), dtype=np.int8)
    for i in range(len(places)):
        if _crossings(places[i, 0], places[i, 1], uv, following, first, last):
            out[i] = 1
    return out


@inner_njit
def is_inside(face: int, u: float, v: float, rims: RimArrays) -> bool:
    """Whether a place lies within the loops of a face, by its raster or, in mixed cells, by the even-odd rule."""
    low, high, raster = rims.low, rims.high, rims.raster
    if u < low[face, 0] or u > high[face, 0] or v < low[face, 1] or v > high[face, 1]:
        return False
    i = min(int((u - low[face, 0]) / (high[face, 0] - low[face, 0]) * CELLS), CELLS - 1)
    j = min(int((v - low[face, 1]) / (high[face, 1] - low[face, 1]) * CELLS), CELLS - 1)
    if raster[face, i, j] != _MIXED:
        return raster[face, i, j] == 1
    return _crossings(u, v, rims.uv, rims.next, rims.first[face], rims.first[face + 1])


@njit
def all_inside(face: Ints, uv: Array, rims: RimArrays) -> NDArray[np.bool_]:
    """The same for parameters (n, 2) of faces (n)."""
    out = np.zeros(len(uv), dtype=np.bool_)
    for i in range(len(uv)):
        out[i] = is_inside(face[i], uv[i, 0], uv[i, 1], rims)
    return out


# ----------------------------------------------------------------------------------------------------
# The search for the nearest place on faces, point by point, compiled.

SHELL = 10e-3  # m: default thickness of the material beneath open faces
_ASIDE = 1e-8  # m, by which a perpendicular may miss a point
_TINY = 1e-300


@inner_njit
def _perpendicular(x: Array, d: Array) -> bool:
    """Whether a place with derivatives d (6, 3) is the foot of a perpendicular from x (3), not just a search's end."""
    gu = gv = a = b = 0.0
    for k in range(3):
        e = d[0, k] - x[k]
        gu += e * d[1, k]
        gv += e * d[2, k]
        a += d[1, k] ** 2
        b += d[2, k] ** 2
    return abs(gu) <= _ASIDE * np.sqrt(a) and abs(gv) <= _ASIDE * np.sqrt(b)


@njit
def settle(
    points: Array,
    faces: Ints,
    starts: Array,
    splines: SplineArrays,
    rims: RimArrays,
) -> tuple[Ints, Array]:
    """Face (n) and parameters (n, 2) of the nearest foot that is inside its face; where none is, of the nearest one.

    points (n, 3) [m]; faces (n, c) to try for each and parameters (n, c, 2) to start from
    """
    knots, poles, table, domain = splines
    found, place = np.empty(len(points), dtype=np.int64), np.empty((len(points), 2))
    d = np.empty((6, 3))
    hit = np.empty(faces.shape[1], dtype=np.bool_)
    for i in range(len(points)):
        best, best_in = np.inf, False
        for c in range(faces.shape[1]):
            face = faces[i, c]
            hit[c] = False
            tried = False
            for earlier in range(c):
                tried = tried or (hit[earlier] and faces[i, earlier] == face)
            if tried:
                continue
            u, v = foot_of(points[i], face, starts[i, c, 0], starts[i, c, 1], knots, poles, table, domain, d)
            gap = 0.0
            for k in range(3):
                gap += (d[0, k] - points[i, k]) ** 2
            within = _perpendicular(points[i], d) and is_inside(face, u, v, rims)
            hit[c] = within
            if (within and not best_in) or (within == best_in and gap < best):
                best, best_in = gap, within
                found[i], place[i, 0], place[i, 1] = face, u, v
    return found, place


class SampleArrays(NamedTuple):
    """Places on faces (s) from which nearer ones are sought: face (s), uv (s, 2), points (s, 3) [m]."""

    face: Ints
    uv: Array
    points: Array


@njit
def signed(
    points: Array,
    near: Ints,
    samples: SampleArrays,
    splines: SplineArrays,
    side: Ints,
    rims: RimArrays,
    shell: float,
) -> tuple[Array, Array]:
    """Signed distances (n,) [m] and the normals (n, 3) at the nearest places.

    points (n, 3) [m]; near (n, c): the samples nearest to each; side (k) as in `FaceBody`; shell: thickness of the
    material beneath the faces [m], infinite where they enclose a body
    """
    sample_face, sample_uv, sample_points = samples
    knots, poles, table, domain = splines
    rim_points, rim_normals, rim_shared = rims.points, rims.normals, rims.shared
    rim_next, rim_first = rims.next, rims.first
    out, normals = np.empty(len(points)), np.empty((len(points), 3))
    d, normal, foot = np.empty((6, 3)), np.empty(3), np.empty(3)
    hit = np.empty(near.shape[1], dtype=np.bool_)
    for i in range(len(points)):
        best, above, straight = np.inf, 1.0, True
        at_sample = 0.0  # squared distance to the nearest sample: a foot farther away belongs to another place
        for k in range(3):
            at_sample += (points[i, k] - sample_points[near[i, 0], k]) ** 2
        for c in range(near.shape[1]):
            face = sample_face[near[i, c]]
            hit[c] = tried = known = False
            for earlier in range(c):
                if sample_face[near[i, earlier]] == face:
                    known = True
                    tried = tried or hit[earlier]
            if tried and best <= at_sample:
                continue
            start = sample_uv[near[i, c]]
            u, v = foot_of(points[i], face, start[0], start[1], knots, poles, table, domain, d)
            if _perpendicular(points[i], d) and is_inside(face, u, v, rims):
                hit[c] = True
                gap = 0.0
                for k in range(3):
                    gap += (d[0, k] - points[i, k]) ** 2
                if gap < best:
                    best, straight = gap, True
                    fill_normal(face, u, v, knots, poles, table, domain, normal)
                    above = 0.0
                    for k in range(3):
                        normals[i, k] = side[face] * normal[k]
                        above += normals[i, k] * (points[i, k] - d[0, k])
                continue
            if known:  # its rim has already been searched
                continue
            for a in range(rim_first[face], rim_first[face + 1]):
                b = rim_next[a]
                length = ahead = 0.0
                for k in range(3):
                    way = rim_points[b, k] - rim_points[a, k]
                    length += way * way
                    ahead += way * (points[i, k] - rim_points[a, k])
                t = min(max(ahead / max(length, _TINY), 0.0), 1.0)
                gap = 0.0
                for k in range(3):
                    foot[k] = rim_points[a, k] + t * (rim_points[b, k] - rim_points[a, k])
                    gap += (foot[k] - points[i, k]) ** 2
                if gap < best:
                    best, straight = gap, rim_shared[a]
                    size = above = 0.0
                    for k in range(3):
                        normals[i, k] = (1.0 - t) * rim_normals[a, k] + t * rim_normals[b, k]
                        size += normals[i, k] ** 2
                        above += normals[i, k] * (points[i, k] - foot[k])
                    for k in range(3):
                        normals[i, k] /= np.sqrt(max(size, _TINY))
        if best > at_sample:  # far away, where perpendiculars meet: the nearest sample will do
            best, straight, above = at_sample, True, 0.0
            face, start = sample_face[near[i, 0]], sample_uv[near[i, 0]]
            fill_normal(face, start[0], start[1], knots, poles, table, domain, normal)
            for k in range(3):
                normals[i, k] = side[face] * normal[k]
                above += normals[i, k] * (points[i, k] - sample_points[near[i, 0], k])
        gap = np.sqrt(best)
        if above >= 0.0 or not straight:
            out[i] = gap
        else:
            out[i] = max(-gap, gap - shell)
    return out, normals


# ----------------------------------------------------------------------------------------------------
# Faces that make up a body: the exact nearest place on them, and on which side of them a point lies.

_COARSEST, _FINEST, _SHARE = 5e-3, 1e-3, 0.01  # m: limits of a face's sample spacing; its share of the face's size
_MOST_ACROSS = 400  # samples of a face along u or v
_CANDIDATES = 8  # samples nearest to a point whose faces are tried
_AT_ONCE = 8192  # points in one thread's block


@dataclass(frozen=True)
class FacePlaces(ReadOnlyArrays):
    """Places on faces: points and unit outward normals (n, 3) [m]; face (n), its position in the body; uv (n, 2)."""

    points: Array
    normals: Array
    face: Ints
    uv: Array


@dataclass(frozen=True)
class FaceBody:
    """Faces with the data for finding the nearest place on them.

    splines, side (k)  of the faces
    raster (k, 64, 64) of the box [low, high] (k, 2) around each face's loops: 0 outside, 1 inside, 2 both
    rim ...            the loops' points: uv (m, 2), points (m, 3), the sum (m, 3) of the normals of the faces that meet
                       there, whether their edge has a face on both sides (m), index (m) of the next one, first (k + 1)
                       of each face
    sample ...         samples: face (s), uv (s, 2), and the tree of their points
    shell              thickness of the material beneath open faces [m]
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
    shell: float = SHELL

    @classmethod
    def of(cls, faces: Sequence[Face], shell: float = SHELL) -> FaceBody:
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
        rim_points = np.ascontiguousarray(splines.points(owner, rim_uv))  # as are the copies in other processes
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
        sample_uv = np.vstack([rim_uv[~pole], *grids])  # no search for a foot can start at a pole
        tree = cKDTree(splines.points(sample_face, sample_uv))
        return cls(**{**vars(body), "sample_face": sample_face, "sample_uv": sample_uv, "tree": tree, "shell": shell})

    @property
    def rims(self) -> RimArrays:
        """The arrays of the loops that kernels use."""
        return RimArrays(
            self.raster, self.low, self.high,
            self.rim_uv, self.rim_points, self.rim_normals, self.rim_shared, self.rim_next, self.rim_first,
        )  # fmt: skip

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
            self.rims,
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

    def at(self, face: Ints, uv: Array) -> FacePlaces:
        """The places at parameters (n, 2) of faces (n)."""
        normals = self.side[face, None] * self.splines.normals(face, uv)
        return FacePlaces(self.splines.points(face, uv), normals, np.asarray(face, dtype=np.int64), uv)

    def beneath(self, points: Array) -> FacePlaces:
        """Feet of perpendiculars from points (n, 3) close to the faces.

        Just beyond an open rim, they lie on the continued surface.
        """
        _, near = self.tree.query(points, k=min(_CANDIDATES, self.tree.n))
        near = near.reshape(len(points), min(_CANDIDATES, self.tree.n))
        return self._feet(points, self.sample_face[near], self.sample_uv[near])

    def followed(self, points: Array, face: Ints, uv: Array) -> FacePlaces:
        """The same, starting from c places for each point: faces (n, c) and parameters (n, c, 2)."""
        return self._feet(points, face, uv)

    def _feet(self, points: Array, face: Ints, uv: Array) -> FacePlaces:
        found, place = settle(
            read_only(points), np.ascontiguousarray(face), np.ascontiguousarray(uv), self.splines.arrays, self.rims
        )
        return self.at(found, place)

    @property
    def closed(self) -> bool:
        """Whether the faces enclose a body."""
        return bool(self.rim_shared.all())

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the material [m]; negative inside."""
        return self._nearest(points)[0]

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) at the places of the faces nearest to points (n, 3)."""
        return self._nearest(points)[1]

    def _nearest(self, points: Array) -> tuple[Array, Array]:
        samples = SampleArrays(self.sample_face, self.sample_uv, np.asarray(self.tree.data))
        splines, rims, shell = self.splines.arrays, self.rims, np.inf if self.closed else self.shell
        count = min(_CANDIDATES, self.tree.n)
        off, normals = np.empty(len(points)), np.empty((len(points), 3))

        def look(at: slice) -> None:
            some = read_only(points[at])
            near = np.ascontiguousarray(self.tree.query(some, k=count)[1].reshape(len(some), count))
            off[at], normals[at] = signed(some, near, samples, splines, self.side, rims, shell)

        in_blocks(look, len(points), _AT_ONCE)
        return off, normals


def _to_segments(points: Array, a: Array, b: Array) -> Array:
    """Distances (n,) of points from segments a b, all (n, 3)."""
    way = b - a
    t = np.clip(((points - a) * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), _TINY), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - a - t[:, None] * way, axis=1))
