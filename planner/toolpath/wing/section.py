"""A wing's section as two smooth curves, and distances from them: what layers parallel to its sides are made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial import cKDTree

from planner.readonly import Array

_DEGREE = 5  # so that the nozzle's angular acceleration has no steps
_SAMPLES = 2000  # of a side: the start of Newton's method, and of the search for where a parallel ends
_NEWTON_STEPS = 3  # from a sample some 40 um away
_CROSSES = 1e-8  # m by which a parallel may come closer to its own side than its distance
_HALVINGS = 24  # of a grid cell of some 40 um
_SWINGS = 0.3  # of a step, by which the curve may leave the chord between two points; on a circle of six, 0.13


class TooUneven(ValueError):
    """No smooth curve through points: it would swing out beside this one (counted from 0)."""

    def __init__(self, point: int) -> None:
        self.point = point
        super().__init__(f"no smooth curve through point {point}")


@dataclass(frozen=True)
class Side:
    """One side of a section, from parameter `first` to `last` of a curve whose inner side is on its left [m]."""

    curve: BSpline
    first: float
    last: float

    def points(self, t: Array) -> Array:
        """Points (n, 2) at parameters t (n)."""
        return np.asarray(self.curve(t))

    def inward(self, t: Array) -> Array:
        """Unit normals (n, 2) into the section."""
        along = np.asarray(self.curve(t, 1))
        return np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]

    def nearest(self, points: Array) -> Array:
        """Parameters (n) of the places nearest to points (n, 2)."""
        grid, tree = self._search
        _, k = tree.query(points)
        t = grid[k]
        cell = grid[1] - grid[0]
        for _ in range(_NEWTON_STEPS):
            away, along, bend = points - self.curve(t), self.curve(t, 1), self.curve(t, 2)
            slope = np.maximum((along * along).sum(axis=1) - (away * bend).sum(axis=1), 1e-3)
            step = np.clip((away * along).sum(axis=1) / slope, -cell, cell)
            t = np.clip(t + step, self.first, self.last)
        return np.asarray(t)

    def distance(self, points: Array) -> Array:
        """Distances (n) of points (n, 2) from this side."""
        return np.asarray(np.linalg.norm(points - self.points(self.nearest(points)), axis=1))

    @cached_property
    def grid(self) -> Array:
        """Parameters all along the side."""
        return np.linspace(self.first, self.last, _SAMPLES)

    @cached_property
    def _search(self) -> tuple[Array, cKDTree]:
        return self.grid, cKDTree(self.points(self.grid))


@dataclass(frozen=True)
class Section:
    """Upper and lower side [m]: x along the chord, z upwards."""

    upper: Side
    lower: Side


def section_through(points: Array, nose: int) -> Section:
    """The section through points (n, 2) [m], from the trailing edge over the upper side, `nose`, the lower side back.

    One spline in chord length through all of them, so that the leading edge is round. Raises TooUneven.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    curve = make_interp_spline(t, points, k=_DEGREE)
    between = np.linspace(0.0, 1.0, 7)[1:-1]
    swung = np.asarray(curve(t[:-1, None] + steps[:, None] * between))
    chords = points[:-1, None] + between[:, None] * np.diff(points, axis=0)[:, None]
    off = np.linalg.norm(swung - chords, axis=2).max(axis=1) / steps
    if off.max() > _SWINGS:
        raise TooUneven(int(np.argmax(off)))
    return Section(Side(curve, 0.0, float(t[nose])), Side(curve, float(t[nose]), float(t[-1])))


def parallels(side: Side, other: Side, distance: float, apart: float, tilt: float) -> list[tuple[float, float]]:
    """Where a curve parallel to `side`, so far inside (or outside, if negative) [m], is worth printing: intervals of t.

    It ends where the other side is less than `apart` [m] away, where it would cross itself, and where it is steeper than
    `tilt` [rad].
    """

    def room(t: Array) -> Array:
        inward = side.inward(t)
        points = side.points(t) + distance * inward
        clear = other.distance(points) - apart
        if distance != 0.0:
            clear = np.minimum(clear, side.distance(points) - abs(distance) + _CROSSES)
        return np.minimum(clear, np.abs(inward[:, 1]) - np.cos(tilt))

    inside = np.concatenate([[False], room(side.grid) >= 0.0, [False]])
    starts, ends = np.flatnonzero(np.diff(inside.astype(int)) > 0), np.flatnonzero(np.diff(inside.astype(int)) < 0) - 1
    found = []
    for start, end in zip(starts, ends, strict=True):
        bounds: list[float] = []
        for k, beyond in ((start, start - 1), (end, end + 1)):
            good, bad = side.grid[k], side.grid[int(np.clip(beyond, 0, len(side.grid) - 1))]
            for _ in range(_HALVINGS):
                middle = 0.5 * (good + bad)
                good, bad = (middle, bad) if room(np.array([middle]))[0] >= 0.0 else (good, middle)
            bounds.append(float(good))
        found.append((bounds[0], bounds[1]))
    return found
