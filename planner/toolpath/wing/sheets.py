"""Layers of a wing whose section changes along its span: sheets parallel to its sides, and level ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline

from planner.readonly import Array, Flags
from planner.toolpath.wing.areas import STATION, Area
from planner.toolpath.wing.loft import LoftedSide

_NUDGE = 1e-6  # m by which a place beyond the ends of a side is off its normal there
_ACROSS, _ALONG = 161, 9  # places of the table by which a sheet is unrolled
_MARGIN = 0.02  # of a sheet's breadth, by which that table is wider
_FLATTEST = 0.02  # least length of the unrolled sheet, per length of the side: outside the sheet it may fold over
_NEWTON_STEPS = 6  # from straight interpolation, to nanometres along the sheet


class Places:
    """Points (n, 3), and where they lie beside sides of a wing; each side is searched once."""

    def __init__(self, points: Array) -> None:
        self.points = points
        self._beside: dict[int, tuple[Array, Array]] = {}

    def beside(self, side: LoftedSide) -> tuple[Array, Array]:
        """u (n) of the nearest places on a side, and distances (n) from these, inwards; NaN beyond its ends across."""
        if id(side) not in self._beside:
            u, v = side.nearest(self.points)
            away, inward = self.points - side.points(u, v), side.inward(u, v)
            depth = (away * inward).sum(axis=1)
            ahead = np.linalg.norm(away - depth[:, None] * inward, axis=1)
            self._beside[id(side)] = u, np.where(((u <= 0.0) | (u >= 1.0)) & (ahead > _NUDGE), np.nan, depth)
        return self._beside[id(side)]


class Sheet(Protocol):
    """One layer: what lies under its tip surface. A place on it is c across the wing and y along the span."""

    @property
    def area(self) -> Area:
        """Where it is, in c and y."""
        ...

    @property
    def height(self) -> float:
        """From its bottom to its top [m]."""
        ...

    @property
    def bend(self) -> float:
        """Greatest curvature of its tip surface across the wing [1/m]."""
        ...

    @property
    def slope(self) -> float:
        """Of its middle line, unrolled: x by y."""
        ...

    def tips(self, c: Array, y: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the tip surface at places c, y (n)."""
        ...

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the true surface at its places nearest to points (n, 3)."""
        ...

    def covers(self, places: Places) -> Flags:
        """Which places (n) lie inside."""
        ...

    def unrolled(self, c: Array, y: Array) -> Array:
        """x (n) [m] of places c, y (n) where the sheet is rolled out: lengths across the wing, from one line on."""
        ...

    def rolled(self, x: Array, y: Array) -> Array:
        """c (n) of places x, y (n) of the sheet rolled out."""
        ...


@dataclass(frozen=True)
class CurvedSheet:
    """A layer parallel to one side of a wing; c is u of that side.

    tip, base   signed distances inwards from the side, of its top and its bottom [m]
    """

    side: LoftedSide
    tip: float
    base: float
    area: Area

    @property
    def height(self) -> float:
        """From its bottom to its top [m]."""
        return abs(self.tip - self.base)

    @property
    def slope(self) -> float:
        """Of its middle line, unrolled: x by y."""
        return self._table[1]

    @cached_property
    def bend(self) -> float:
        """Greatest curvature of its tip surface across the wing [1/m]."""
        middle = self.area.y[~np.isnan(self.area.edges).all(axis=(1, 2))]
        u = np.linspace(np.nanmin(self.area.edges), np.nanmax(self.area.edges), _ACROSS)
        worst = 0.0
        for y in middle[[0, -1]]:
            inside = self.area.holds(u, np.full(len(u), y))
            points, inward = self.side.parallel(u[inside], np.full(inside.sum(), y), self.tip)
            turned, length = (np.linalg.norm(np.diff(rows, axis=0), axis=1) for rows in (inward, points))
            worst = max(worst, float((turned / length).max(initial=0.0)))
        return worst

    @property
    def _outward(self) -> float:
        return 1.0 if self.tip > self.base else -1.0

    def tips(self, c: Array, y: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the tip surface at places c, y (n)."""
        points, inward = self.side.parallel(c, y, self.tip)
        return points, self._outward * inward

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the true surface at its places nearest to points (n, 3)."""
        return self._outward * self.side.inward(*self.side.nearest(points))

    def covers(self, places: Places) -> Flags:
        """Which places (n) lie inside."""
        u, depth = places.beside(self.side)
        low, high = sorted((self.tip, self.base))
        covered = (depth > low) & (depth < high)
        at = np.flatnonzero(covered)
        if len(at):
            covered[at] = self.area.holds(u[at], places.points[at, 1])
        return np.asarray(covered)

    def unrolled(self, c: Array, y: Array) -> Array:
        """x (n) [m] of places c, y (n) where the sheet is rolled out: lengths across the wing, from one line on."""
        return np.asarray(self._table[0].ev(c, y))

    def rolled(self, x: Array, y: Array) -> Array:
        """c (n) of places x, y (n) of the sheet rolled out."""
        table, _, low, high = self._table
        c = np.full(len(x), 0.5 * (low + high))
        for _ in range(_NEWTON_STEPS):
            c = np.clip(c + (x - table.ev(c, y)) / table.ev(c, y, dx=1), low, high)
        return np.asarray(c)

    @cached_property
    def _table(self) -> tuple[RectBivariateSpline, float, float, float]:
        """x by u and y, the slope of the middle line, and the least and the greatest u.

        x is the length across, at one y, from a straight line along the middle of the area, plus what that line moves:
        so the sheet is rolled out nearly without stretching, whatever the wing's taper and sweep.
        """
        there = ~np.isnan(self.area.edges).all(axis=(1, 2))
        y_there = self.area.y[there]
        low, high = np.nanmin(self.area.edges), np.nanmax(self.area.edges)
        margin = _MARGIN * (high - low)
        low, high = np.clip([low - margin, high + margin], 0.0, 1.0)
        u = np.linspace(low, high, _ACROSS)
        y = np.linspace(y_there[0] - STATION, y_there[-1] + STATION, _ALONG)
        points, inward = self.side.parallel(np.tile(u, _ALONG), np.repeat(y, _ACROSS), self.tip)
        across = np.column_stack([-inward[:, 2], np.zeros(len(inward)), inward[:, 0]]).reshape(_ALONG, _ACROSS, 3)
        across = across / np.linalg.norm(across, axis=2)[:, :, None]
        points = points.reshape(_ALONG, _ACROSS, 3)
        outside, _ = self.side.parallel(np.tile(u, _ALONG), np.repeat(y, _ACROSS), 0.0)
        usual = np.linalg.norm(np.diff(outside.reshape(_ALONG, _ACROSS, 3), axis=1), axis=2)
        along = across[:, 1:] + across[:, :-1]
        steps = (np.diff(points, axis=1) * along).sum(axis=2) / np.linalg.norm(along, axis=2)
        steps = steps * np.sign(steps.sum())
        floor = _FLATTEST * usual
        steps = 0.5 * (steps + np.sqrt(steps**2 + 4.0 * floor**2))

        length = np.concatenate([np.zeros((_ALONG, 1)), np.cumsum(steps, axis=1)], axis=1)
        centre = np.array([np.nanmean(edges) for edges in self.area.edges[there]])
        middle, _ = self.side.parallel(centre, y_there, self.tip)
        slope, place = np.polyfit(y_there, middle[:, 0], 1) if len(y_there) > 1 else (0.0, middle[0, 0])
        starts = []
        for k in range(_ALONG):
            # the line's own u: where x of the points is the line's, nearest to the middle
            roots = CubicSpline(u, points[k, :, 0] - (slope * y[k] + place)).roots(extrapolate=False)
            at = roots[np.argmin(np.abs(roots - centre.mean()))] if len(roots) else centre.mean()
            starts.append(float(CubicSpline(u, length[k])(at)))
        sign = np.sign(points[0, -1, 0] - points[0, 0, 0])
        x = length - np.array(starts)[:, None] + sign * slope * (y - y[0])[:, None]
        return RectBivariateSpline(u, y, x.T, kx=5, ky=5, s=0), float(sign * slope), float(low), float(high)


@dataclass(frozen=True)
class FlatSheet:
    """A level layer, its top and its bottom at heights `tip` and `base` [m]; c is x."""

    tip: float
    base: float
    area: Area

    slope = 0.0
    bend = 0.0

    @property
    def height(self) -> float:
        """From its bottom to its top [m]."""
        return self.tip - self.base

    def tips(self, c: Array, y: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the tip surface at places c, y (n)."""
        points = np.column_stack([c, y, np.full(len(c), self.tip)])
        return points, self.normals(points)

    def normals(self, points: Array) -> Array:
        """Upwards (n, 3)."""
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))

    def covers(self, places: Places) -> Flags:
        """Which places (n) lie inside."""
        x, y, z = places.points.T
        covered = (z > self.base) & (z < self.tip)
        at = np.flatnonzero(covered)
        if len(at):
            covered[at] = self.area.holds(x[at], y[at])
        return np.asarray(covered)

    def unrolled(self, c: Array, y: Array) -> Array:
        """x (n) [m] of places c, y (n)."""
        return c

    def rolled(self, x: Array, y: Array) -> Array:
        """c (n) of places x, y (n)."""
        return x
