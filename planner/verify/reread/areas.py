"""Places all over a layer: how far within its outline they lie, which of them beads are to fill, and how far beads leave it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.verify.reread.places import AskedPlaces

_PITCH = 0.25  # bead widths between places
_MOST = 200_000  # places of a layer
_NOSE = 0.08  # share across that a nose takes
_COARSE = 0.5  # bead widths between places at which the room is measured
_FAR = 1.0  # m: no place is so near
MIDDLE = 0.5  # bead widths from the outline, where beads' middle lines are at the outermost

Place = Callable[[Array, Array], Array]  # of shares across and along (n): points (n, 3), or m to the outline (n)


@dataclass(frozen=True)
class PlaceGrid:
    """A grid of places of a layer, rows (m) along and columns (n) across.

    points   (m, n, 3) [m]
    depth    (m, n) m within the outline; negative outside
    pitch    [m] between places: along and across
    width    of a bead [m]
    """

    points: Array
    depth: Array
    pitch: tuple[float, float]
    width: float

    @property
    def inside(self) -> Flags:
        """Which places (m, n) lie within the outline."""
        return np.asarray(self.depth > 0.0)

    def beyond(self, tips: Array, within: float) -> Array:
        """How far (k) [m] tips (k, 3) are from the places that lie so far within the outline [m]."""
        core = self.points[self.inside & (self.depth >= within)]
        return np.asarray(cKDTree(core).query(tips)[0]) if len(core) else np.full(len(tips), _FAR)

    def asked(self, near: float, beside: float, least: float) -> AskedPlaces:
        """Places to be filled within `near` [m] of a bead, but where the layer is narrower than `least` [m].

        beside: m within which those are to be filled that are within two beads' widths of the outline
        """
        long = _long(self.inside, least / self.pitch[1]) & _long(self.inside.T, least / self.pitch[0]).T
        core = long & (self.depth >= MIDDLE * self.width)
        count = int(core.sum())
        whole = float(max(self.inside.sum(), 1))
        reach = np.where(self.depth[core] < 2.0 * self.width, beside, near)
        return AskedPlaces(self.points[core], np.ones(count), reach, whole)


def area_of(
    place: Place, room: Place, sizes: tuple[float, float], stations: Array, width: float, pitch: float = _PITCH
) -> PlaceGrid:
    """The area whose places `place` gives, where `room` is 0 or more.

    sizes     along and across [m]
    stations  shares along at which the room is asked for; in between it is taken as straight; of one, places and room are
              the same all along, which is along y
    width     of a bead [m]; pitch: its share from place to place
    """
    apart = max(pitch * width, float(np.sqrt(sizes[0] * sizes[1] / _MOST)))
    counts = [max(int(np.ceil(size / apart)), 2) for size in sizes]
    v, c = (np.linspace(0.0, 1.0, count + 1) for count in counts)
    # the room changes slowly from place to place, but around a nose
    few = np.linspace(0.0, 1.0, max(int(sizes[1] / (_COARSE * width)), 60) + 1)
    few = np.unique(np.concatenate([few, np.linspace(0.0, _NOSE, 41), c[c <= _NOSE]]))
    coarse = np.stack([np.interp(c, few, room(few, np.full(len(few), at))) for at in stations])
    rooms = np.broadcast_to(coarse[0], (len(v), len(c))) if len(coarse) == 1 else _between(stations, coarse, v)
    if len(coarse) == 1:
        points = place(c, np.zeros(len(c))) + (v * sizes[0])[:, None, None] * [0.0, 1.0, 0.0]
    else:
        points = place(np.tile(c, len(v)), np.repeat(v, len(c))).reshape(len(v), len(c), 3)
    steps = (sizes[0] / counts[0], sizes[1] / counts[1])
    return PlaceGrid(points, depth_of(rooms >= 0.0, steps), steps, width)


def depth_of(inside: Flags, steps: tuple[float, float]) -> Array:
    """How far (m, n) [m] places of a grid lie within an outline that runs half a step beyond the last ones inside; negative
    outside."""
    padded, half = np.pad(inside, 1), 0.5 * min(steps)
    deep = distance_transform_edt(padded, sampling=steps)[1:-1, 1:-1]
    if not inside.any():
        return np.full(inside.shape, -_FAR)
    away = distance_transform_edt(~padded, sampling=steps)[1:-1, 1:-1]
    return np.where(inside, deep - half, half - away)


def _between(stations: Array, values: Array, v: Array) -> Array:
    """Values (m, n) at stations (m), straight between them at v (k)."""
    at = np.clip(np.searchsorted(stations, v) - 1, 0, len(stations) - 2)
    share = ((v - stations[at]) / (stations[at + 1] - stations[at]))[:, None]
    return np.asarray((1.0 - share) * values[at] + share * values[at + 1])


def _long(inside: Flags, least: float) -> Flags:
    """Which places lie in runs of so many at least along their rows."""
    out = np.zeros_like(inside)
    for i, row in enumerate(inside):
        ends = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
        for first, last in zip(ends[::2], ends[1::2], strict=True):
            out[i, first:last] = last - first >= least
    return out
