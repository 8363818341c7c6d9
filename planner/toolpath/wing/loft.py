"""The surface of a wing whose section changes along its span: straight lines from the section at one end to the other's.

Points are (x, y, z) in the part frame [m]: x along the chord, y along the span, z upwards. A place on a side is u, from
0 to 1 along both sections at once, and v, from 0 to 1 along the span; the lines go on straight beyond both ends, so
that layers inside the wing, which lean along the span, are parallel to a surface up to its ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planner.readonly import Array
from planner.toolpath.wing.section import Section, Side

_GRID = (400, 17)  # places along u and v where the search for the nearest one begins
_BEYOND = 0.25  # of the span, by which the search goes on at either end
_NEWTON_STEPS = 4  # from a place some tenths of a millimetre away
_TURNS = 60  # of the iteration for the place that a given y is above: contracts some thirty times each on a usual wing
_STILL = 1e-13  # of the span: that iteration ends


@dataclass(frozen=True)
class LoftedSide:
    """One side of a wing, from a side of the section at y = `start` to one of that at y = `start` + `span` [m]."""

    root: Side
    tip: Side
    start: float
    span: float

    def points(self, u: Array, v: Array) -> Array:
        """Points (n, 3) at places u, v (n)."""
        flat = (1.0 - v)[:, None] * self._ends(u, 0)[0] + v[:, None] * self._ends(u, 0)[1]
        return np.column_stack([flat[:, 0], self.start + self.span * v, flat[:, 1]])

    def inward(self, u: Array, v: Array) -> Array:
        """Unit normals (n, 3) into the wing."""
        (root, tip), (along_root, along_tip) = self._ends(u, 0), self._ends(u, 1)
        along = (1.0 - v)[:, None] * along_root + v[:, None] * along_tip
        return self._normals(along, tip - root)

    def parallel(self, u: Array, y: Array, distance: float) -> tuple[Array, Array]:
        """Points of the surface parallel to this one, `distance` [m] inside it, at u and y (n); unit normals inwards (n, 3).

        The points are exact: `distance` from this side along its normal.
        """
        (root, tip), (along_root, along_tip) = self._ends(u, 0), self._ends(u, 1)
        goal = (y - self.start) / self.span
        v = goal
        for _ in range(_TURNS):
            inward = self._normals(along_root + v[:, None] * (along_tip - along_root), tip - root)
            step = goal - distance / self.span * inward[:, 1] - v
            v = v + step
            if np.abs(step).max(initial=0.0) < _STILL:
                break
        inward = self._normals(along_root + v[:, None] * (along_tip - along_root), tip - root)
        flat = root + v[:, None] * (tip - root) + distance * inward[:, ::2]
        return np.column_stack([flat[:, 0], y, flat[:, 1]]), inward

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Places u, v (n) of this side that are nearest to points (n, 3): where their normal meets it, if it does."""
        u_grid, v_grid, tree = self._search
        _, k = tree.query(points)
        u, v = u_grid[k], v_grid[k]
        most_u, most_v = 2.0 / _GRID[0], 2.0 * (1.0 + 2.0 * _BEYOND) / _GRID[1]
        for _ in range(_NEWTON_STEPS):
            (root, tip), (root_u, tip_u), (root_uu, tip_uu) = (self._ends(u, order) for order in range(3))
            w = v[:, None]
            off = root + w * (tip - root) - points[:, ::2]
            off_y = self.start + self.span * v - points[:, 1]
            to_u, to_v, bend = root_u + w * (tip_u - root_u), tip - root, root_uu + w * (tip_uu - root_uu)
            twist = tip_u - root_u
            pull_u = (off * to_u).sum(axis=1)
            pull_v = (off * to_v).sum(axis=1) + off_y * self.span
            a, c = (to_u * to_u).sum(axis=1), (to_v * to_v).sum(axis=1) + self.span**2
            b = (to_u * to_v).sum(axis=1)
            # Newton's second derivatives where they keep a minimum, else those of the distance from a tangent plane
            full_a, full_b = a + (off * bend).sum(axis=1), b + (off * twist).sum(axis=1)
            good = (full_a > 0.0) & (full_a * c > full_b**2)
            a, b = np.where(good, full_a, a), np.where(good, full_b, b)
            scale = a * c - b * b
            u = np.clip(u + np.clip((b * pull_v - c * pull_u) / scale, -most_u, most_u), 0.0, 1.0)
            v = np.clip(v + np.clip((b * pull_u - a * pull_v) / scale, -most_v, most_v), -_BEYOND, 1.0 + _BEYOND)
        return u, v

    def distance(self, points: Array) -> Array:
        """Distances (n) of points (n, 3) from this side."""
        return np.asarray(np.linalg.norm(points - self.points(*self.nearest(points)), axis=1))

    def _ends(self, u: Array, order: int) -> tuple[Array, Array]:
        """Points (n, 2) of both sections at u (n), or their derivatives."""
        found = []
        for side in (self.root, self.tip):
            length = side.last - side.first
            found.append(np.asarray(side.curve(side.first + u * length, order)) * length**order)
        return found[0], found[1]

    def _normals(self, along: Array, across: Array) -> Array:
        """Unit normals (n, 3) from derivatives (n, 2) by u and by v; that by v is `span` along y."""
        x, z = along.T
        normals = np.column_stack([-z * self.span, z * across[:, 0] - x * across[:, 1], x * self.span])
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])

    @cached_property
    def _search(self) -> tuple[Array, Array, cKDTree]:
        grid = np.meshgrid(np.linspace(0.0, 1.0, _GRID[0]), np.linspace(-_BEYOND, 1.0 + _BEYOND, _GRID[1]))
        u, v = (each.ravel() for each in grid)
        return u, v, cKDTree(self.points(u, v))


@dataclass(frozen=True)
class Loft:
    """A wing between the sections at the two ends of its span."""

    root: Section
    tip: Section
    start: float
    span: float

    @cached_property
    def upper(self) -> LoftedSide:
        """The upper side."""
        return LoftedSide(self.root.upper, self.tip.upper, self.start, self.span)

    @cached_property
    def lower(self) -> LoftedSide:
        """The lower side."""
        return LoftedSide(self.root.lower, self.tip.lower, self.start, self.span)
