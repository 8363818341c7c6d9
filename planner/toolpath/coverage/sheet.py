"""Faces sewn into one net of triangles, distances along it, and lines of equal distance.

Distances are found by fast marching (Kimmel and Sethian 1998). Holes are filled so that rows run straight on behind
them; triangles in a hole do not count as material.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from planner.base.arrays import Array, Ints, true_runs
from planner.base.compiled import inner_njit, njit
from planner.base.geometry import arc_lengths

_SEWN = 2e-5  # m: points on two faces' edges that are nearer than this are merged
_CLEAR = 0.6  # mesh sizes: no point is placed nearer to the edge
_LOOKED = 5  # pieces per side of a triangle at the rim, for checking coverage
_LOOKS = 33  # lines of u and of v along which a face is measured

_CORNER = np.radians(30.0)  # turn of an edge within a spacing: there one side ends and the next begins
_SIDES = 4  # so many of the longest sides are tried as sources
_FLAT = 1e-6  # least height of a triangle, as a share of its sides: its square is well above rounding
_DIRECTIONS = 6  # so many lines through the middle are tried as sources, too


class Patch(Protocol):
    """One face: a surface over (u, v), and the closed curves that trim it.

    loops: closed polylines (m, 2) in (u, v), the first point not repeated; the outer one first, then holes. Points are
    at most a quarter of the spacing of rows apart on the surface. Where two faces meet (or a face meets itself, as
    a cylinder does), both list the same points in space, by which seams are recognised. points and normals must be
    defined in holes too, and a little beyond the outer loop.
    """

    @property
    def loops(self) -> tuple[Array, ...]:
        """Closed polylines (m, 2) in (u, v), the outer one first."""
        ...

    def points(self, uv: Array) -> Array:
        """Points (n, 3) at parameters (n, 2) [m]."""
        ...

    def normals(self, uv: Array) -> Array:
        """Unit outward normals (n, 3) at parameters (n, 2)."""
        ...


@dataclass(frozen=True)
class Stroke:
    """A curve on the faces, printed without a break.

    points, normals (n, 3)  on the true surface [m], normals of unit length
    patch (n,)              number of the face under each point
    parameters (n, 2)       (u, v) of the point on that face
    closed                  the last point is joined to the first, which is not repeated
    """

    points: Array
    normals: Array
    patch: Ints
    parameters: Array
    closed: bool = False


def march(points: Array, triangles: Ints, start: Array) -> Array:
    """Distances (n,) [m] of points (n, 3): `start` (n,) where that is finite, and from there along triangles (m, 3).

    Exact in the plane for a straight source; elsewhere of first order in the triangles' size. Infinite where no
    triangles lead.
    """
    corner = triangles.ravel()
    order = np.argsort(corner, kind="stable")
    first = np.searchsorted(corner[order], np.arange(len(points) + 1))
    return _march(points, triangles, order // 3, first, start)


@njit
def _march(points: Array, triangles: Ints, around: Ints, first: Ints, start: Array) -> Array:
    value = start.copy()
    done = np.zeros(len(points), dtype=np.bool_)
    front = [(np.inf, -1)]
    for i in range(len(points)):
        if np.isfinite(value[i]):
            heapq.heappush(front, (value[i], i))
    while len(front) > 0:
        price, here = heapq.heappop(front)
        if here < 0:
            break
        if done[here] or price > value[here]:
            continue
        done[here] = True
        for k in range(first[here], first[here + 1]):
            triangle = triangles[around[k]]
            for i in range(3):
                there, other = triangle[i], triangle[(i + 1) % 3]
                if there == here or done[there]:
                    continue
                if other == here:
                    other = triangle[(i + 2) % 3]
                new = value[here] + np.sqrt(np.sum((points[there] - points[here]) ** 2))
                if done[other]:
                    new = min(
                        new,
                        _through(
                            points[here] - points[there], points[other] - points[there], value[here], value[other]
                        ),
                    )
                if new < value[there]:
                    value[there] = new
                    heapq.heappush(front, (new, there))
    return value


@inner_njit
def _through(a: Array, b: Array, at_a: float, at_b: float) -> float:
    """Distance at the third corner of a triangle for a straight front that passed the other two.

    a, b (3,) lead from the third corner to the other two, at_a and at_b are their distances. Infinite if the front
    does not come through the triangle.
    """
    aa, ab, bb = np.sum(a * a), np.sum(a * b), np.sum(b * b)
    det = aa * bb - ab * ab
    if det <= 0.0:
        return np.inf
    # inverse of the Gram matrix: |gradient|^2 = (T - p)' Q (T - p) = 1
    qaa, qab, qbb = bb / det, -ab / det, aa / det
    x = qaa + 2.0 * qab + qbb
    y = at_a * (qaa + qab) + at_b * (qab + qbb)
    z = at_a * at_a * qaa + 2.0 * at_a * at_b * qab + at_b * at_b * qbb - 1.0
    root = y * y - x * z
    if root < 0.0:
        return np.inf
    p = (y + np.sqrt(root)) / x
    if qaa * (at_a - p) + qab * (at_b - p) > 0.0 or qab * (at_a - p) + qbb * (at_b - p) > 0.0:
        return np.inf
    return p


@dataclass(frozen=True)
class FaceMesh:
    """Faces as one net of triangles.

    points (n, 3)       [m]
    triangles (m, 3)    indices of points
    patch (m,)          face of each triangle
    corners (m, 3, 2)   (u, v) of each triangle's corners on its face
    material (m,)       false in holes
    size                approximate spacing of points [m]
    """

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
        """Unit normals at the points (n, 3), outward as those of the faces."""
        out = np.zeros_like(self.points)
        for k, face in enumerate(self.patches):
            on = self.patch == k
            corner = self.triangles[on].ravel()
            np.add.at(out, corner, face.normals(self.corners[on].reshape(-1, 2)))
        return out / np.maximum(np.linalg.norm(out, axis=1), np.finfo(float).tiny)[:, None]

    def looked_at(self, rim: Ints) -> Array:
        """Points (k, 3) all over the material, at which coverage is checked.

        These are the net's points and the centroids of its triangles, and more in triangles that touch one of the
        points `rim`, where rows end.
        """
        net = self.triangles[self.material]
        corners = self.points[net]
        fine = corners[np.isin(net, rim).any(axis=1)]
        share = np.array(
            [(i, j, _LOOKED - i - j) for i in range(_LOOKED + 1) for j in range(_LOOKED + 1 - i)], dtype=np.float64
        )
        closely = np.einsum("ki,mij->mkj", share / _LOOKED, fine).reshape(-1, 3)
        return np.vstack([self.points[np.unique(net)], corners.mean(axis=1), closely])


def sheet_of(patches: Sequence[Patch], size: float) -> FaceMesh:
    """Triangulate faces with points about `size` [m] apart, keeping the points of their loops."""
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
    # a triangle at a pole, where a whole edge of the face is one point, may have two corners there
    kept = (net[:, 0] != net[:, 1]) & (net[:, 1] != net[:, 2]) & (net[:, 2] != net[:, 0])
    return FaceMesh(
        tuple(patches),
        joined[used],
        net[kept],
        np.concatenate(owner)[kept],
        np.concatenate(corners)[kept],
        np.concatenate(material)[kept],
        size,
    )


def inside(loop: Array, uv: Array) -> NDArray[np.bool_]:
    """Which points (n, 2) are inside a closed polyline (m, 2), by the even-odd rule."""
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
    # mean lengths along u and along v: coordinates in which the face has about its true size
    along = [
        np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=i), axis=2).mean(axis=1 - i))])
        for i in range(2)
    ]
    columns = max(int(np.ceil(along[0][-1] / size)), 2)
    rows = max(int(np.ceil(along[1][-1] / (size * np.sqrt(0.75)))), 2)
    s, t = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1), indexing="ij")
    s = s + 0.5 / columns * (np.arange(rows + 1) % 2)  # every second row is half a step further: equilateral triangles
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
    """For each point, the lowest index (n,) of those at the same place."""
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


@dataclass(frozen=True)
class Rim:
    """The edges of the material, as closed curves.

    edges (e, 2)        those with material on one side only, as indices of points
    edge_of             number of an edge by its two points, the lower first
    loop, arc (e,)      curve that an edge belongs to, and arc length at its start [m]
    around              length of each curve [m]
    vertices            points of each curve in order
    """

    edges: Ints
    edge_of: dict[tuple[int, int], int]
    loop: Ints
    arc: Array
    around: Array
    vertices: tuple[Ints, ...]

    @staticmethod
    def of(sheet: FaceMesh) -> Rim:
        """Chain the edges that have material on one side; the triangles' orientation is kept where it is consistent."""
        edges = sheet.edges().reshape(-1, 3, 2)[sheet.material].reshape(-1, 2)
        _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
        rim = edges[np.sort(first[count == 1])]
        at: dict[int, list[int]] = {}
        for k, (a, b) in enumerate(rim):
            at.setdefault(int(a), []).append(k)
            at.setdefault(int(b), []).append(k)
        used = np.zeros(len(rim), dtype=np.bool_)
        ordered: list[tuple[int, int]] = []
        loop: list[int] = []
        vertices: list[Ints] = []
        for seed in range(len(rim)):
            if used[seed]:
                continue
            used[seed] = True
            start, here = (int(i) for i in rim[seed])
            chain = [start, here]
            while here != start:
                on = next((k for k in at[here] if not used[k]), None)
                if on is None:
                    break
                used[on] = True
                a, b = (int(i) for i in rim[on])
                here = b if a == here else a
                chain.append(here)
            ordered += list(zip(chain[:-1], chain[1:], strict=True))
            loop += [len(vertices)] * (len(chain) - 1)
            vertices.append(np.array(chain[:-1], dtype=np.int64))
        pairs = np.array(ordered, dtype=np.int64).reshape(-1, 2)
        names = np.array(loop, dtype=np.int64)
        length = np.linalg.norm(sheet.points[pairs[:, 1]] - sheet.points[pairs[:, 0]], axis=1)
        around: Array = np.bincount(names, weights=length, minlength=len(vertices)).astype(np.float64)
        before = np.concatenate([[0.0], np.cumsum(length)[:-1]])
        arc = before - np.concatenate([[0.0], np.cumsum(around)])[names]
        edge_of = {(min(pair), max(pair)): k for k, pair in enumerate(ordered)}
        return Rim(pairs, edge_of, names, arc, around, tuple(vertices))


@dataclass(frozen=True)
class Row:
    """A line of equal distance on the material.

    points (n, 3)  [m]
    level          number of the line
    ends           (loop of the rim, arc there [m]) where it starts and where it ends; None: closed, the first point
                   not repeated
    """

    points: Array
    level: float
    ends: tuple[tuple[int, float], tuple[int, float]] | None

    @property
    def length(self) -> float:
        """Length [m], without the closing side of closed rows."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


def rows_at(sheet: FaceMesh, rim: Rim, field: Array, height: float, level: float) -> list[Row]:
    """All pieces of the line on which `field` (n,) is `height`."""
    net = sheet.triangles[sheet.material]
    above = field >= height
    cut = net[above[net].any(axis=1) & ~above[net].all(axis=1)]
    if not len(cut):
        return []
    edges = np.stack([cut, np.roll(cut, -1, axis=1)], axis=2)
    crossed = above[edges[..., 0]] != above[edges[..., 1]]
    pairs = np.sort(edges[crossed], axis=1)  # two of each triangle, in a row
    nodes, node = np.unique(pairs, axis=0, return_inverse=True)
    links = node.reshape(-1, 2)
    share = (height - field[nodes[:, 0]]) / (field[nodes[:, 1]] - field[nodes[:, 0]])
    points = sheet.points[nodes[:, 0]] + share[:, None] * (sheet.points[nodes[:, 1]] - sheet.points[nodes[:, 0]])

    def end(k: int) -> tuple[int, float] | None:
        on = rim.edge_of.get((int(nodes[k, 0]), int(nodes[k, 1])))
        if on is None:
            return None
        return int(rim.loop[on]), float(rim.arc[on] + np.linalg.norm(points[k] - sheet.points[rim.edges[on, 0]]))

    out = []
    for chain, closed in _chains(links, len(nodes)):
        first, last = (None, None) if closed else (end(chain[0]), end(chain[-1]))
        both = (first, last) if first is not None and last is not None else None
        line = points[chain]
        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        line = line[np.concatenate([[True], step > 0.0])]
        if len(line) > 1:
            out.append(Row(line, level, both))
    return out


def _chains(links: Ints, count: int) -> list[tuple[list[int], bool]]:
    """Paths and cycles of a graph whose nodes have at most two links; (nodes, is a cycle)."""
    beside: list[list[int]] = [[] for _ in range(count)]
    for a, b in links:
        beside[int(a)].append(int(b))
        beside[int(b)].append(int(a))
    seen = np.zeros(count, dtype=np.bool_)
    out = []
    for ends_only in (True, False):
        for seed in range(count):
            if seen[seed] or (ends_only and len(beside[seed]) != 1):
                continue
            chain = [seed]
            seen[seed] = True
            while True:
                on = next((k for k in beside[chain[-1]] if not seen[k]), None)
                if on is None:
                    break
                seen[on] = True
                chain.append(on)
            out.append((chain, not ends_only))
    return out


def fields_of(sheet: FaceMesh, rim: Rim, spacing: float) -> list[Array]:
    """Distances of the net's points from each source (n,) [m], signed if the source has two sides."""
    out = []
    sides = [side for loop in rim.vertices for side in _sides(sheet, loop, spacing)]
    sides.sort(key=lambda side: -float(np.linalg.norm(np.diff(sheet.points[side], axis=0), axis=1).sum()))
    for side in sides[:_SIDES]:
        start = np.full(len(sheet.points), np.inf)
        start[side] = 0.0
        out.append(march(sheet.points, sheet.triangles, start))
    corners = sheet.points[sheet.triangles[sheet.material]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = np.average(corners.mean(axis=1), axis=0, weights=area)
    centre = int(np.argmin(np.linalg.norm(sheet.points - middle, axis=1)))
    spread = sheet.points - sheet.points[centre]
    axes = np.linalg.svd(sheet.points - middle, full_matrices=False)[2]
    for k in range(_DIRECTIONS):
        angle = np.pi * k / _DIRECTIONS
        out.append(_from_section(sheet, spread @ (np.cos(angle) * axes[0] + np.sin(angle) * axes[1])))
    return [field for field in out if np.isfinite(field[sheet.triangles]).all()]


def _sides(sheet: FaceMesh, loop: Ints, spacing: float) -> list[Ints]:
    """Pieces of a rim between its corners; none if it has fewer than two."""
    points = sheet.points[loop]
    s = arc_lengths(np.vstack([points, points[:1]]))
    n = len(loop)
    if s[-1] == 0.0:  # where sewn faces share a single point
        return []
    ahead = np.array([_at(points, s, s[i] + 0.5 * spacing) for i in range(n)])
    behind = np.array([_at(points, s, s[i] - 0.5 * spacing) for i in range(n)])
    one, two = points - behind, ahead - points
    cosine = np.einsum("ij,ij->i", one, two) / np.maximum(
        np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1), np.finfo(float).tiny
    )
    bent = cosine < np.cos(_CORNER)
    if not bent.any() or bent.all():
        return []
    # of the points around a corner, the one where the edge turns most
    shift = int(np.flatnonzero(~bent)[0])
    bent, cosine, order = np.roll(bent, -shift), np.roll(cosine, -shift), np.roll(loop, -shift)
    corner = [a + int(np.argmin(cosine[a:b])) for a, b in true_runs(bent)]
    if len(corner) < 2:
        return []
    twice = np.concatenate([order, order])
    return [twice[a : b + 1] for a, b in zip(corner, [*corner[1:], corner[0] + n], strict=True)]


def _at(points: Array, s: Array, where: float) -> Array:
    """The point of a closed polyline at arc length `where` [m], on any lap."""
    closed = np.vstack([points, points[:1]])
    return np.array([np.interp(where % s[-1], s, closed[:, i]) for i in range(3)])


def _from_section(sheet: FaceMesh, height: Array) -> Array:
    """Signed distance along the net from the line where `height` (n,) is zero."""
    corners, values = sheet.points[sheet.triangles], height[sheet.triangles]
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    longest = np.maximum((e * e).sum(axis=1), (f * f).sum(axis=1))
    there = np.linalg.norm(np.cross(e, f), axis=1) > _FLAT * longest  # triangles of collinear rim points have no slope
    cut = there & (values > 0.0).any(axis=1) & (values <= 0.0).any(axis=1)
    e, f = e[cut], f[cut]
    de, df = values[cut, 1] - values[cut, 0], values[cut, 2] - values[cut, 0]
    ee, ef, ff = (np.einsum("ij,ij->i", x, y) for x, y in ((e, e), (e, f), (f, f)))
    slope = np.sqrt((de * de * ff - 2.0 * de * df * ef + df * df * ee) / (ee * ff - ef * ef))
    start = np.full(len(height), np.inf)
    np.minimum.at(start, sheet.triangles[cut], np.abs(values[cut]) / slope[:, None])
    return np.where(height > 0.0, 1.0, -1.0) * march(sheet.points, sheet.triangles, start)
