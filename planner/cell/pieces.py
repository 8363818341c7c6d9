"""Meshes as convex bodies: few planes around a fine one, and a bent one as a few pieces.

The surface is cut by planes, and each piece is replaced by its hull. The hull of what lies on one side of a plane contains
all of the solid there, so the pieces contain the whole solid. Of some cuts across each axis the one is taken that removes
most of the volume that hulls add to the solid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from planner.base.arrays import Array

_PLACES = np.linspace(0.0, 1.0, 9)[1:-1]  # of cuts along a body, as shares of its length
_LOOKED = 96  # directions in which a side's farthest points stand for it while cuts are compared
_WORTH = 0.01  # of the whole body's hull that a cut takes away, at least
_THIN = 1e-6  # m: what is thinner has no hull
MOST_PLANES = 2000  # of a hull: a finer one costs time for nothing, and coal does not take all of them
_MOST_AROUND = 200  # planes around one corner; of 256 coal says "too many neighbours"
_FACES, _AROUND = 300, 300  # of one too fine: planes along its largest faces, and others spread around it


class _Cut(NamedTuple):
    """How much less the hulls hold after a cut [m^3], and both sides' triangles (m, 3, 3)."""

    gain: float
    low: Array
    high: Array


def convex_pieces(corners: Array, most: int) -> list[Array]:
    """Corners (n, 3) of at most so many convex pieces that together hold a closed surface's triangles (m, 3, 3) [m].

    Raises QhullError or ValueError where the triangles lie in one plane.
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
    """Corners (n, 3) of the hull of points (m, 3) [m]; of one around it, where it has more planes than are of use.

    Raises QhullError or ValueError where they lie in one plane.
    """
    hull = ConvexHull(points)
    planes = len(np.unique(np.round(hull.equations, 12), axis=0))
    if planes <= MOST_PLANES and np.bincount(hull.simplices.ravel()).max() <= _MOST_AROUND:
        return np.asarray(points[hull.vertices])
    own = points[hull.vertices]
    directions = np.vstack([_large_faces(hull), _all_round(_AROUND), np.eye(3), -np.eye(3)])
    farthest = (own @ directions.T).max(axis=0)
    around = HalfspaceIntersection(np.column_stack([directions, -farthest]), own.mean(axis=0)).intersections
    return np.asarray(around[ConvexHull(around).vertices])


def _large_faces(hull: ConvexHull) -> Array:
    """Normals (n, 3) of a hull's largest faces, those of nearly one direction together."""
    corners = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    _, first, alike = np.unique(np.round(hull.equations[:, :3], 2), axis=0, return_index=True, return_inverse=True)
    together = np.bincount(alike.ravel(), weights=area)
    return np.asarray(hull.equations[first[np.argsort(-together, kind="stable")[:_FACES]], :3])


def _hull(corners: Array) -> ConvexHull | None:
    """The hull of triangles (m, 3, 3), none of what is flat."""
    points = np.unique(corners.reshape(-1, 3), axis=0)
    if len(points) < 4 or np.linalg.matrix_rank(points - points[0], tol=_THIN) < 3:
        return None
    try:
        return ConvexHull(points)
    except QhullError:
        return None


def _volume(corners: Array) -> float:
    """Of the hull of a side's farthest points [m^3]: nearly that of its hull, and much sooner known."""
    if not len(corners):
        return 0.0
    points = corners.reshape(-1, 3)
    hull = _hull(points[np.unique(np.argmax(points @ _DIRECTIONS.T, axis=0))])
    return 0.0 if hull is None else float(hull.volume)


def _all_round(count: int) -> Array:
    """Directions (n, 3) spread evenly over the sphere: a spiral with the golden angle."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


_DIRECTIONS = np.vstack([_all_round(_LOOKED), np.eye(3), -np.eye(3)])


def _best_cut(corners: Array) -> _Cut:
    """The cut across an axis that takes most away; none gains anything where the triangles are too few."""
    best, volume = _Cut(0.0, corners, corners[:0]), _volume(corners)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    for axis in range(3):
        for place in low[axis] + _PLACES * (high[axis] - low[axis]):
            below, above = _side(corners, axis, place, -1.0), _side(corners, axis, place, 1.0)
            gain = volume - _volume(below) - _volume(above)
            if gain > best.gain:
                best = _Cut(gain, below, above)
    return best


def _side(corners: Array, axis: int, place: float, sign: float) -> Array:
    """What of triangles (m, 3, 3) lies on one side of a plane across an axis, cut there."""
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
