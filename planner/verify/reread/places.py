"""Places of the executed motion at which the print is checked, and checks that name the worst of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.plan import Check
from planner.verify.checks import DIGITS, EVERYWHERE, Judged, place

APART = 0.2e-3  # m between the places checked along a bead and along drawn lines
_OF_WIDTH = 0.5  # × a bead's width: most between its places, so that neighbouring lines do not stand in for a lost one
OFF_LEVEL = 2e-5  # m: layers off their height, for interpolation between waypoints and the tip's own tolerance
SHORT = 0.001  # × the length, on top of what may be left out: ends of pieces and rounded corners
_CORNERS = 0.005  # × a layer, on top of what may be left out: at rounded turns and narrow ends
AXIS = np.radians(0.05)  # tolerance on top of the nozzle's cone
ON_PART, NORMAL = "layers on the part", "nozzle normal to the part"
DRAWN, WHOLE = "print on the drawn path", "drawn path left out"
INSIDE, FILLED = "beads within the part", "layers filled"


@dataclass(frozen=True)
class Places:
    """Places of the executed motion (n) on beads: tip (n, 3), outward axis (n, 3), bead and layer, and the sample.

    On a scanned print, the tip is where it would be if that print were exactly as drawn.
    """

    tip: Array
    up: Array
    bead: Ints
    layer: Ints
    sample: Ints

    def some(self, which: Ints | Flags) -> Places:
        """A selection of them."""
        return Places(*(values[which] for values in vars(self).values()))

    def few(self, count: int) -> Places:
        """At most `count` of them, evenly spread over the print."""
        return self.some(np.unique(np.linspace(0, len(self.tip) - 1, count).astype(np.int64)))


def places_of(judged: Judged) -> Places:
    """Samples on beads, thinned out to the spacing needed."""
    t, motion = judged.trajectory, judged.motion
    at = np.flatnonzero(t.deposit)
    step = np.floor(t.s[at] / _apart(judged))
    kept = np.ones(len(at), dtype=bool)
    same = t.bead[at][1:] == t.bead[at][:-1]
    kept[1:] = ~same | (step[1:] != step[:-1])
    kept[:-1] |= ~same
    kept[-1] = True
    at = at[kept]
    layers = np.array([bead.layer for bead in judged.toolpath.beads], dtype=np.int64)
    return Places(judged.drawn_tip[at], -motion.axis[at], t.bead[at].astype(np.int64), layers[t.bead[at]], at)


def _apart(judged: Judged) -> float:
    """Greatest distance between places of a bead [m]."""
    return min(APART, _OF_WIDTH * judged.problem.process.bead.width)


def between(judged: Judged) -> float:
    """Greatest distance [m] between places of the motion, and from a bead's ends to its first and last places."""
    return max(_apart(judged), float(judged.commanded.max()) * judged.trajectory.dt)


def begun_layers(judged: Judged) -> set[int]:
    """Layers begun before a resumed print, which lays at most the rest of them."""
    return {bead.layer for bead in judged.toolpath.beads[: judged.trajectory.first_bead]}


def may_be_left(judged: Judged, crumbs: float) -> float:
    """The share of the length that may be missing: what the notes report, up to what the problem allows, plus SHORT."""
    return min(judged.toolpath.told.left_out, crumbs) + SHORT


def by_number(number: Ints) -> Iterator[tuple[int, Ints]]:
    """Each distinct number, and the places (k) that have it."""
    order = np.argsort(number, kind="stable")
    found, first = np.unique(number[order], return_index=True)
    yield from zip(found.tolist(), np.split(order, first[1:]), strict=True)


def worst_of(judged: Judged, places: Places, name: str, values: Array, limit: float, unit: str) -> Check:
    """The check that no value (n) exceeds the limit, at the worst place. NaN fails."""
    return beyond_limits(judged, places, name, values, np.full(len(values), limit), unit)


def beyond_limits(judged: Judged, places: Places, name: str, values: Array, limits: Array, unit: str) -> Check:
    """The check that no value (n) exceeds its own limit (n), at the place that exceeds it most or is nearest to it."""
    i = int(np.argmax(np.where(np.isnan(values), np.inf, values - limits)))
    value, limit, sample = float(values[i]), float(limits[i]), int(places.sample[i])
    ok = bool(value <= limit * (1.0 + DIGITS))
    return Check(name, value, limit, unit, ok, place(judged.trajectory, sample), sample=sample)


def not_read(why: str) -> Check:
    """The check in place of those of a file that is not read again."""
    return Check(ON_PART, 0.0, 0.0, "mm", True, f"not read again: {why}")


@dataclass(frozen=True)
class AskedPlaces:
    """Places (n, 3) of one layer's surface, half a bead or more within its outline, that must be filled.

    area     (n,) that each represents [m^2]
    near     (n,) a place counts as filled if this near to a bead's middle line [m]
    whole    area of the layer [m^2], which unfilled shares refer to
    """

    points: Array
    area: Array
    near: Array
    whole: float


def filled(places: Places, asked: Mapping[int, AskedPlaces], may: float, corners: float = _CORNERS) -> Check:
    """The unfilled share of the worst layer, or of all layers together if a share may be missing.

    may: share of all layers that the notes report as missing; corners: share of a layer that rounded turns and narrow
    ends leave unfilled
    """
    printed = dict(by_number(places.layer))
    most = total = whole = 0.0
    where = EVERYWHERE
    for layer, wanted in asked.items():
        whole += wanted.whole
        if not len(wanted.points):
            continue
        own = printed.get(layer, np.zeros(0, dtype=np.int64))
        away = cKDTree(places.tip[own]).query(wanted.points)[0] if len(own) else np.full(len(wanted.points), np.inf)
        lost = away > wanted.near
        total += float(wanted.area[lost].sum())
        share = float(wanted.area[lost].sum() / wanted.whole)
        if share > most:
            most, spot = share, wanted.points[lost][np.argmax((away - wanted.near)[lost])] * 1e3
            where = "layer {}, at {:.1f}, {:.1f}, {:.1f} mm".format(layer + 1, *spot)
    if may > 0.0:
        most = total / max(whole, 1e-300)
    limit = may + corners
    return Check(FILLED, most, limit, "of its area", most <= limit, where)
