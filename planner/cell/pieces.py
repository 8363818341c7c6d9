"""Turn meshes into convex bodies: a fine mesh into a hull of few planes, a bent one into a few pieces.

The surface is cut by planes, and each piece is replaced by its hull. The hull of the surface on one side of a plane
contains all of the solid there, so the pieces contain the whole solid. Several cuts across each axis are compared; the
one that removes most of the volume that hulls add to the solid is made.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from planner.base.arrays import Array, Ints

_PLACES = np.linspace(0.0, 1.0, 9)[1:-1]  # positions of cuts along a body, as fractions of its length
_LOOKED = 96  # directions whose farthest points represent a side while cuts are compared
_WORTH = 0.01  # share of the whole body's hull volume that a cut must remove
_THIN = 1e-6  # m: anything thinner has no hull
MOST_PLANES = 2000  # of a hull: a finer one costs time for nothing, and coal does not accept all of them
_MOST_AROUND = 200  # triangles that meet in one corner, as those of a face do; at 255, coal says "too many neighbours"
_FACES, _AROUND = 300, 300  # planes of a hull that was too fine: along its largest faces, and spread around it
# rad between these faces, of which the first that works is used: a round end has a corner at each face of its rim, and
# is itself cut into triangles around one of them
_APART = (0.0, np.radians(10.0), np.radians(20.0))


class _Cut(NamedTuple):
    """Volume that a cut removes from the hulls [m^3], and the triangles (m, 3, 3) of both sides."""

    gain: float
    low: Array
    high: Array


def convex_pieces(corners: Array, most: int) -> list[Array]:
    """Corners (n, 3) of at most `most` convex pieces that together contain a closed surface's triangles (m, 3, 3) [m].

    Raises QhullError or ValueError if the triangles lie in one plane.
    """
    whole = _hull(corners)
    if whole is None:
        raise ValueError("all triangles lie in one plane")
    least = _WORTH * whole.volume
    pieces = [(corners, _best_cut(corners))]
    while len(pieces) < most:
        k = max(range(len(pieces)), key=lambda i: pieces[i][1].gain)
        cut = pieces[k][1]
        if cut.gain < least:
            break
        sides = [side for side in (cut.low, cut.high) if len(side)]
        pieces[k : k + 1] = [(side, _best_cut(side)) for side in sides]
    hulls = [_hull(piece) for piece, _ in pieces]
    return [lean_hull(hull.points) for hull in hulls if hull is not None]


def lean_hull(points: Array) -> Array:
    """Corners (n, 3) of the hull of points (m, 3) [m], or of a simpler one around it.

    It is simplified if it has too many planes, or too many triangles meet in one corner.

    Raises QhullError or ValueError if the points lie in one plane.
    """
    hull = ConvexHull(points)
    planes = len(np.unique(np.round(hull.equations, 12), axis=0))
    own = points[hull.vertices]
    if planes <= MOST_PLANES and _most_around(hull) <= _MOST_AROUND:
        return np.asarray(own)
    faces = _faces_by_size(hull)
    for apart in _APART:
        directions = np.vstack([_kept_apart(faces, apart)[:_FACES], _all_round(_AROUND), np.eye(3), -np.eye(3)])
        farthest = (own @ directions.T).max(axis=0)
        around = HalfspaceIntersection(np.column_stack([directions, -farthest]), own.mean(axis=0)).intersections
        lean = ConvexHull(around)
        if _most_around(lean) <= _MOST_AROUND:
            break
    return np.asarray(around[lean.vertices])


def _most_around(hull: ConvexHull) -> int:
    """The largest number of triangles that meet in one corner of a hull."""
    return int(np.bincount(hull.simplices.ravel()).max())


def _faces_by_size(hull: ConvexHull) -> Array:
    """Normals (n, 3) of a hull's faces, largest first; faces of nearly the same direction count as one."""
    corners = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    _, first, alike = np.unique(np.round(hull.equations[:, :3], 2), axis=0, return_index=True, return_inverse=True)
    together = np.bincount(alike.ravel(), weights=area)
    return np.asarray(hull.equations[first[np.argsort(-together, kind="stable")], :3])


def _kept_apart(directions: Array, apart: float) -> Array:
    """Unit vectors (n, 3) without those within an angle [rad] of one that is kept before them."""
    if apart == 0.0:
        return directions
    kept = directions[:1]
    for each in directions[1:]:
        if (kept @ each).max() < np.cos(apart):
            kept = np.vstack([kept, each])
    return kept


def _hull(corners: Array) -> ConvexHull | None:
    """The hull of triangles (m, 3, 3); None if they are flat."""
    points = np.unique(corners.reshape(-1, 3), axis=0)
    if len(points) < 4 or np.linalg.matrix_rank(points - points[0], tol=_THIN) < 3:
        return None
    try:
        return ConvexHull(points)
    except QhullError:
        return None


def _volume(farthest: Array, also: Array | None = None) -> float:
    """Volume of the hull of a side's farthest points [m^3]: close to that of its whole hull, and much faster.

    farthest, also: (directions, 3), one point per direction; the farther of both counts.
    """
    if also is not None:
        beyond = ((also - farthest) * _DIRECTIONS).sum(axis=1) > 0.0
        farthest = np.where(beyond[:, None], also, farthest)
    try:
        return float(ConvexHull(farthest).volume)
    except QhullError:  # flat
        return 0.0


def _all_round(count: int) -> Array:
    """Directions (n, 3) spread evenly over the sphere: a spiral with the golden angle."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


_DIRECTIONS = np.vstack([_all_round(_LOOKED), np.eye(3), -np.eye(3)])


def _best_cut(corners: Array) -> _Cut:
    """The cut across an axis that removes most; its gain is 0 if no cut removes anything.

    All cuts across an axis share one pass over the corners: these are sorted along it, and each direction has one
    farthest corner between two cuts. Only the points where a cut meets triangles are examined for each cut.
    """
    points = _once(corners.reshape(-1, 3))  # most corners belong to six triangles
    low, high = points.min(axis=0), points.max(axis=0)
    none = _Cut(0.0, corners, corners[:0])
    if (high - low).min() < _THIN:
        return none
    best, at, whole = 0.0, (0, 0.0), 0.0
    for axis in range(3):
        points = points[np.argsort(points[:, axis], kind="stable")]
        places = low[axis] + _PLACES * (high[axis] - low[axis])
        before, after = (np.searchsorted(points[:, axis], places, side=side) for side in ("left", "right"))
        farthest = _Farthest.of(points, after)
        if axis == 0:
            whole = _volume(points[farthest.below[-1]])
        for i, place in enumerate(places.tolist()):
            on = _outermost(np.vstack([points[before[i] : after[i]], _on_cut(corners, axis, place)]))
            gain = whole - _volume(points[farthest.below[i]], on) - _volume(points[farthest.above[i]], on)
            if gain > best:
                best, at = gain, (axis, place)
    return none if best <= 0.0 else _Cut(best, _side(corners, *at, -1.0), _side(corners, *at, 1.0))


def _once(points: Array) -> Array:
    """Points (n, 3) without duplicates."""
    points = points[np.lexsort(points.T)]
    return points[np.append(True, (points[1:] != points[:-1]).any(axis=1))]


class _Farthest(NamedTuple):
    """Indices of the farthest of sorted points in each direction, up to each cut and beyond it.

    below    (cuts + 1, directions): the last row is for all points; above (cuts, directions)
    """

    below: Ints
    above: Ints

    @classmethod
    def of(cls, points: Array, cuts: Ints) -> _Farthest:
        """From points (n, 3) and how many of them lie up to each cut; some lie below the first and above the last."""
        away = _DIRECTIONS @ points.T
        edges = [0, *cuts.tolist(), len(points)]
        slabs = [k for k in range(len(edges) - 1) if edges[k] < edges[k + 1]]
        own = {k: edges[k] + away[:, edges[k] : edges[k + 1]].argmax(axis=1) for k in slabs}
        below, above = (cls._running(away, own, order) for order in (range(len(edges) - 1), range(len(cuts), 0, -1)))
        return cls(below, above[::-1])

    @staticmethod
    def _running(away: Array, own: dict[int, Ints], order: Iterable[int]) -> Ints:
        """The farthest in all slabs so far (n, directions), slab after slab."""
        rows, out = np.arange(len(away)), list[Ints]()
        for k in order:
            before, now = out[-1] if out else own[k], own.get(k)
            out.append(before if now is None else np.where(away[rows, now] > away[rows, before], now, before))
        return np.array(out)


def _on_cut(corners: Array, axis: int, place: float) -> Array:
    """Points (n, 3) where edges of triangles (m, 3, 3) meet a plane across an axis."""
    away = corners[:, :, axis] - place
    met = corners[(away.min(axis=1) < 0.0) & (away.max(axis=1) > 0.0)]
    begin, end = met.reshape(-1, 3), np.roll(met, -1, axis=1).reshape(-1, 3)
    a, b = begin[:, axis] - place, end[:, axis] - place
    crossing = a * b < 0.0
    share = a[crossing] / (a[crossing] - b[crossing])
    return np.asarray(begin[crossing] + share[:, None] * (end[crossing] - begin[crossing]))


def _outermost(points: Array) -> Array | None:
    """The farthest of points (n, 3) in each direction (directions, 3); None if there are no points."""
    return points[(_DIRECTIONS @ points.T).argmax(axis=1)] if len(points) else None


def _side(corners: Array, axis: int, place: float, sign: float) -> Array:
    """The parts of triangles (m, 3, 3) on one side of a plane across an axis, cut at the plane."""
    away = sign * (corners[:, :, axis] - place)
    inside = away >= 0.0
    count = inside.sum(axis=1)
    kept = [corners[count == 3]]
    for many in (1, 2):
        mixed = np.flatnonzero(count == many)
        if not len(mixed):
            continue
        # first the corner that is alone on its side
        alone = np.argmax(inside[mixed] == (many == 1), axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        rows = np.arange(len(mixed))[:, None]
        own, far = corners[mixed][rows, order], away[mixed][rows, order]
        share = far[:, :1] / (far[:, :1] - far[:, 1:])
        ends = own[:, :1] + share[:, :, None] * (own[:, 1:] - own[:, :1])
        if many == 1:
            kept.append(np.stack([own[:, 0], ends[:, 0], ends[:, 1]], axis=1))
        else:
            kept.append(np.stack([ends[:, 0], own[:, 1], own[:, 2]], axis=1))
            kept.append(np.stack([ends[:, 0], own[:, 2], ends[:, 1]], axis=1))
    return np.concatenate(kept)
