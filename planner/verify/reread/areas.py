"""Places all over a layer: their depth within its outline, those that beads must fill, and how far beads leave it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.verify.reread.places import AskedPlaces

_PITCH = 0.25  # bead widths between places
_MOST = 200_000  # most places of a layer
_NOSE = 0.08  # share across that a nose takes up
_COARSE = 0.5  # bead widths between places at which the room is measured
_FAR = 1.0  # m: stands for "nowhere near"
MIDDLE = 0.5  # bead widths from the outline to the outermost middle lines of beads

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
        """Whether places (m, n) lie within the outline."""
        return np.asarray(self.depth > 0.0)

    def beyond(self, tips: Array, within: float) -> Array:
        """Distance (k) [m] of tips (k, 3) from the places that lie at least `within` [m] inside the outline."""
        core = self.points[self.inside & (self.depth >= within)]
        return np.asarray(cKDTree(core).query(tips)[0]) if len(core) else np.full(len(tips), _FAR)

    def asked(self, near: float, beside: float, least: float) -> AskedPlaces:
        """Places that must have a bead within `near` [m], except where the layer is narrower than `least` [m].

        beside: replaces `near` for places within two bead widths of the outline [m]
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
    """The area with places from `place`, where `room` is 0 or more.

    sizes     along and across [m]
    stations  shares along at which the room is evaluated, interpolated linearly in between; with a single one, places
              and room are the same all along, and along is y
    width     of a bead [m]; pitch: bead widths between places
    """
    apart = max(pitch * width, float(np.sqrt(sizes[0] * sizes[1] / _MOST)))
    counts = [max(int(np.ceil(size / apart)), 2) for size in sizes]
    v, c = (np.linspace(0.0, 1.0, count + 1) for count in counts)
    # the room changes slowly from place to place, except around a nose
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
    """Depth (m, n) [m] of places within an outline half a step beyond the last places inside; negative outside."""
    padded, half = np.pad(inside, 1), 0.5 * min(steps)
    deep = distance_transform_edt(padded, sampling=steps)[1:-1, 1:-1]
    if not inside.any():
        return np.full(inside.shape, -_FAR)
    away = distance_transform_edt(~padded, sampling=steps)[1:-1, 1:-1]
    return np.where(inside, deep - half, half - away)


def _between(stations: Array, values: Array, v: Array) -> Array:
    """Values (k, n) at v (k), interpolated linearly from values (m, n) at stations (m)."""
    at = np.clip(np.searchsorted(stations, v) - 1, 0, len(stations) - 2)
    share = ((v - stations[at]) / (stations[at + 1] - stations[at]))[:, None]
    return np.asarray((1.0 - share) * values[at] + share * values[at + 1])


def _long(inside: Flags, least: float) -> Flags:
    """Whether places lie in runs of at least `least` along their rows."""
    out = np.zeros_like(inside)
    for i, row in enumerate(inside):
        ends = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
        for first, last in zip(ends[::2], ends[1::2], strict=True):
            out[i, first:last] = last - first >= least
    return out
