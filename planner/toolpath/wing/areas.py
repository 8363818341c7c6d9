"""Where along and across a wing a layer is worth printing: intervals across, at stations along the span."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.readonly import Array, Flags
from planner.toolpath.wing.loft import LoftedSide

Intervals = Sequence[tuple[float, float]]

STATION = 0.5e-3  # m between stations; between them edges are straight
_CELLS = 240  # across a side, in which edges are looked for
_CROSSES = 1e-8  # m by which a parallel may come closer to its own side than its distance
_HALVINGS = 12  # of a cell of some 0.3 mm, each by a secant's guess
_FEWEST = 8  # stations


def stations_of(start: float, span: float) -> Array:
    """y of the stations of a wing [m], both ends among them."""
    return np.linspace(start, start + span, max(round(span / STATION), _FEWEST) + 1)


@dataclass(frozen=True)
class Area:
    """Intervals of c, a coordinate across the wing, at stations along its span.

    y      (m,) of the stations [m]
    edges  (m, k, 2) ends of the intervals there, in order; NaN where there are fewer than k
    """

    y: Array
    edges: Array

    @classmethod
    def of(cls, y: Array, intervals: Sequence[Intervals]) -> Area:
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
        """Edges (n, k, 2) at y (n): between those of the two stations, or of the nearest if these differ in number."""
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
) -> Area:
    """Where a surface parallel to `side`, so far inside (or outside, if negative) [m], is worth printing: intervals of u.

    It ends where the other side is less than `apart` [m] away, where it would cross itself, and where it is steeper than
    `tilt` [rad].
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
    return Area.of(stations, [list(zip(low[row == k], high[row == k], strict=True)) for k in range(len(stations))])


def _edges(
    room: Callable[[Array, Array], Array],
    u: Array,
    y: Array,
    rooms: Array,
    good: NDArray[np.intp],
    bad: NDArray[np.intp],
) -> Array:
    """Where between cells `good` and `bad` (n) of u, at y (n), there begins to be room."""
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
