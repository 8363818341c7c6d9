"""Layers of a wing whose section changes along its span: sheets parallel to its sides, and level ones.

A side is ruled: straight lines join the section at one end of the span to that at the other. Points are (x, y, z) in
the part frame [m]: x along the chord, y along the span, z upwards. A place on a side is u, from 0 to 1 along both
sections at once, and v, from 0 to 1 along the span. The lines continue straight beyond both ends, so that layers inside
the wing, which lean along the span, are parallel to a side right up to its ends.

SpanIntervals says where a layer is worth printing: intervals across the wing, at stations along the span.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.toolpath.wing.section import AerofoilSection, SectionSide

_GRID = (400, 17)  # places along u and v at which the search for the nearest one starts
_BEYOND = 0.25  # of the span, by which the search extends beyond either end
_LOFT_STEPS = 4  # from a place some tenths of a millimetre away
_TURNS = 60  # of the iteration for a parallel's place at a given y: each gains a factor of about thirty on a usual wing
_STILL = 1e-13  # of the span: a smaller step ends that iteration

Intervals = Sequence[tuple[float, float]]
STATION = 0.5e-3  # m between stations; between them edges are straight
_CELLS = 240  # across a side, in which edges are searched
_CROSSES = 1e-8  # m by which a parallel may come closer to its own side than its distance
_HALVINGS = 12  # of a cell of some 0.3 mm, each by a secant's guess
_FEWEST = 8  # stations

_NUDGE = 1e-6  # m off the normal at an end of a side: a place farther off is beyond that end
_ACROSS, _ALONG = 161, 9  # places in the table that unrolls a sheet
_MARGIN = 0.02  # of a sheet's width, by which that table is wider
_FLATTEST = 0.02  # least unrolled length, per length of the side: outside its area a sheet may fold over
_SHEET_STEPS = 6  # Newton steps, down to nanometres along the sheet


@dataclass(frozen=True)
class LoftedSide:
    """One side of a wing, from a side of the section at y = `start` to one of that at y = `start` + `span` [m]."""

    root: SectionSide
    tip: SectionSide
    start: float
    span: float

    def points(self, u: Array, v: Array) -> Array:
        """Points (n, 3) at places u, v (n)."""
        flat = (1.0 - v)[:, None] * self._ends(u, 0)[0] + v[:, None] * self._ends(u, 0)[1]
        return np.column_stack([flat[:, 0], self.start + self.span * v, flat[:, 1]])

    def inward(self, u: Array, v: Array) -> Array:
        """Unit normals (n, 3) pointing into the wing."""
        (root, tip), (along_root, along_tip) = self._ends(u, 0), self._ends(u, 1)
        along = (1.0 - v)[:, None] * along_root + v[:, None] * along_tip
        return self._normals(along, tip - root)

    def parallel(self, u: Array, y: Array, distance: float) -> tuple[Array, Array]:
        """Points and inward unit normals (n, 3) at u and y (n) of the surface parallel to this, `distance` [m] inside.

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
        """Places u, v (n) on this side nearest to points (n, 3): feet of perpendiculars, if there are any."""
        u_grid, v_grid, tree = self._search
        _, k = tree.query(points)
        u, v = u_grid[k], v_grid[k]
        most_u, most_v = 2.0 / _GRID[0], 2.0 * (1.0 + 2.0 * _BEYOND) / _GRID[1]
        for _ in range(_LOFT_STEPS):
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
            # full Newton where the Hessian is positive definite, otherwise Gauss-Newton
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
        """Unit normals (n, 3) from derivatives (n, 2) by u and by v; the latter also has the y component `span`."""
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

    root: AerofoilSection
    tip: AerofoilSection
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


def stations_of(start: float, span: float) -> Array:
    """y of the stations of a wing [m], including both ends."""
    return np.linspace(start, start + span, max(round(span / STATION), _FEWEST) + 1)


@dataclass(frozen=True)
class SpanIntervals:
    """Intervals of c, a coordinate across the wing, at stations along its span.

    y      (m,) of the stations [m]
    edges  (m, k, 2) ends of the intervals there, in order; NaN where there are fewer than k
    """

    y: Array
    edges: Array

    @classmethod
    def of(cls, y: Array, intervals: Sequence[Intervals]) -> SpanIntervals:
        """From a list of intervals at each station."""
        most = max((len(each) for each in intervals), default=0)
        edges = np.full((len(y), max(most, 1), 2), np.nan)
        for station, each in enumerate(intervals):
            for k, ends in enumerate(each):
                edges[station, k] = ends
        return cls(y, edges)

    @property
    def empty(self) -> bool:
        """Whether there is no interval at all."""
        return bool(np.isnan(self.edges).all())

    def at(self, y: Array) -> Array:
        """Edges (n, k, 2) at y (n): interpolated between two stations, or the nearest one's if the numbers differ."""
        y = np.clip(y, self.y[0], self.y[-1])
        k = np.clip(np.searchsorted(self.y, y, side="right") - 1, 0, len(self.y) - 2)
        share = (y - self.y[k]) / (self.y[k + 1] - self.y[k])
        before, after = self.edges[k], self.edges[k + 1]
        between = before + share[:, None, None] * (after - before)
        differs = (np.isnan(before) != np.isnan(after)).any(axis=(1, 2))
        nearest = np.where(share[:, None, None] < 0.5, before, after)
        return np.asarray(np.where(differs[:, None, None], nearest, between))

    def holds(self, c: Array, y: Array) -> Flags:
        """Which places (n) lie inside."""
        edges = self.at(y)
        return np.asarray(((c[:, None] >= edges[:, :, 0]) & (c[:, None] <= edges[:, :, 1])).any(axis=1))


def parallel_area(
    side: LoftedSide, other: LoftedSide, distance: float, apart: float, tilt: float, stations: Array
) -> SpanIntervals:
    """Intervals of u where a surface parallel to `side`, `distance` [m] inside (outside if negative), is worth laying.

    It ends where the other side is less than `apart` [m] away, where it would cross itself, and where it is steeper
    than `tilt` [rad].
    """

    def room(u: Array, y: Array) -> Array:
        points, inward = side.parallel(u, y, distance)
        least = np.abs(inward[:, 2]) - np.cos(tilt)
        at = np.flatnonzero(least >= 0.0)
        least[at] = np.minimum(least[at], other.distance(points[at]) - apart)
        if distance != 0.0:
            at = np.flatnonzero(least >= 0.0)
            least[at] = np.minimum(least[at], side.distance(points[at]) - abs(distance) + _CROSSES)
        return least

    u = np.linspace(0.0, 1.0, _CELLS + 1)
    grid = np.broadcast_to(u, (len(stations), len(u)))
    rooms = room(grid.ravel(), np.repeat(stations, len(u))).reshape(grid.shape)
    inside = np.pad(rooms >= 0.0, ((0, 0), (1, 1)))
    row, start = np.nonzero(inside[:, 1:] & ~inside[:, :-1])
    _, end = np.nonzero(inside[:, :-1] & ~inside[:, 1:])
    start, end = start, end - 1
    low = _edges(room, u, stations[row], rooms[row], start, np.maximum(start - 1, 0))
    high = _edges(room, u, stations[row], rooms[row], end, np.minimum(end + 1, _CELLS))
    return SpanIntervals.of(
        stations, [list(zip(low[row == k], high[row == k], strict=True)) for k in range(len(stations))]
    )


def _edges(
    room: Callable[[Array, Array], Array],
    u: Array,
    y: Array,
    rooms: Array,
    good: NDArray[np.intp],
    bad: NDArray[np.intp],
) -> Array:
    """The u between cells `good` and `bad` (n), at y (n), at which room begins."""
    k = np.arange(len(y))
    inner, outer, has, lacks = u[good], u[bad], rooms[k, good], np.minimum(rooms[k, bad], -1e-15)
    for _ in range(_HALVINGS if len(y) else 0):
        share = np.clip(has / (has - lacks), 0.1, 0.9)
        middle = inner + share * (outer - inner)
        found = room(middle, y)
        ok = found >= 0.0
        inner, has = np.where(ok, middle, inner), np.where(ok, found, has)
        outer, lacks = np.where(ok, outer, middle), np.where(ok, lacks, np.minimum(found, -1e-15))
    return np.asarray(inner)


class WingPlaces:
    """Points (n, 3), and their positions relative to sides of a wing; each side is searched once."""

    def __init__(self, points: Array) -> None:
        self.points = points
        self._beside: dict[int, tuple[Array, Array]] = {}

    def beside(self, side: LoftedSide) -> tuple[Array, Array]:
        """u (n) of the nearest places on a side, and depths (n) inside it; NaN beyond its ends across the wing."""
        if id(side) not in self._beside:
            u, v = side.nearest(self.points)
            away, inward = self.points - side.points(u, v), side.inward(u, v)
            depth = (away * inward).sum(axis=1)
            ahead = np.linalg.norm(away - depth[:, None] * inward, axis=1)
            self._beside[id(side)] = u, np.where(((u <= 0.0) | (u >= 1.0)) & (ahead > _NUDGE), np.nan, depth)
        return self._beside[id(side)]


class WingSheet(Protocol):
    """One layer: the volume under its tip surface. A place on it is c across the wing and y along the span."""

    @property
    def area(self) -> SpanIntervals:
        """The area that it covers, in c and y."""
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
        """Slope of its unrolled middle line: x by y."""
        ...

    def tips(self, c: Array, y: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the tip surface at places c, y (n)."""
        ...

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the true surface at its places nearest to points (n, 3)."""
        ...

    def covers(self, places: WingPlaces) -> Flags:
        """Which places (n) lie inside."""
        ...

    def unrolled(self, c: Array, y: Array) -> Array:
        """x (n) [m] of places c, y (n) on the unrolled sheet: lengths across the wing, from one line on."""
        ...

    def rolled(self, x: Array, y: Array) -> Array:
        """c (n) of places x, y (n) on the unrolled sheet."""
        ...


@dataclass(frozen=True)
class CurvedSheet:
    """A layer parallel to one side of a wing; c is u of that side.

    tip, base   signed distances inwards from the side, of its top and its bottom [m]
    """

    side: LoftedSide
    tip: float
    base: float
    area: SpanIntervals

    @property
    def height(self) -> float:
        """From its bottom to its top [m]."""
        return abs(self.tip - self.base)

    @property
    def slope(self) -> float:
        """Slope of its unrolled middle line: x by y."""
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

    def covers(self, places: WingPlaces) -> Flags:
        """Which places (n) lie inside."""
        u, depth = places.beside(self.side)
        low, high = sorted((self.tip, self.base))
        covered = (depth > low) & (depth < high)
        at = np.flatnonzero(covered)
        if len(at):
            covered[at] = self.area.holds(u[at], places.points[at, 1])
        return np.asarray(covered)

    def unrolled(self, c: Array, y: Array) -> Array:
        """x (n) [m] of places c, y (n) on the unrolled sheet: lengths across the wing, from one line on."""
        return np.asarray(self._table[0].ev(c, y))

    def rolled(self, x: Array, y: Array) -> Array:
        """c (n) of places x, y (n) on the unrolled sheet."""
        table, _, low, high = self._table
        c = np.full(len(x), 0.5 * (low + high))
        for _ in range(_SHEET_STEPS):
            c = np.clip(c + (x - table.ev(c, y)) / table.ev(c, y, dx=1), low, high)
        return np.asarray(c)

    @cached_property
    def _table(self) -> tuple[RectBivariateSpline, float, float, float]:
        """Unrolled x by u and y, the slope of the middle line, and the least and greatest u.

        x is the length across, at one y, from a straight line along the middle of the area, plus that line's shift:
        so the sheet is unrolled nearly without stretching, whatever the wing's taper and sweep.
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
            # the line's own u: where the points have the line's x, nearest to the middle
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
    area: SpanIntervals

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

    def covers(self, places: WingPlaces) -> Flags:
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
