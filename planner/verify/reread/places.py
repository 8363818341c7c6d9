"""Places of the executed motion at which what is printed is looked at, and checks that name the worst of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.plan import Check
from planner.verify.checks import DIGITS, EVERYWHERE, Judged, place

APART = 0.2e-3  # m between the places of a bead, and of what is drawn, that are looked at
_OF_WIDTH = 0.5  # of a bead's width between its places at most, lest the lines beside a lost one count as it
OFF_LEVEL = 2e-5  # m: layers off their height, what interpolation between waypoints and the tip's own tolerance add
SHORT = 0.001  # of the length, besides what may be left out: ends of pieces and rounded corners
_CORNERS = 0.005  # of a layer, besides what may be left out: beside rounded turns and narrow ends
AXIS = np.radians(0.05)  # beyond the nozzle's cone
ON_PART, NORMAL = "layers on the part", "nozzle normal to the part"
DRAWN, WHOLE = "print on the drawn path", "drawn path left out"
INSIDE, FILLED = "beads within the part", "layers filled"


@dataclass(frozen=True)
class Places:
    """Places of the executed motion (n) on beads: tip (n, 3), outward axis (n, 3), bead and layer, and the sample.

    On a print that was scanned, the tip is where it would be if that were as it was drawn.
    """

    tip: Array
    up: Array
    bead: Ints
    layer: Ints
    sample: Ints

    def some(self, which: Ints | Flags) -> Places:
        """Some of them."""
        return Places(*(values[which] for values in vars(self).values()))

    def few(self, count: int) -> Places:
        """So many of them at most, even over the print."""
        return self.some(np.unique(np.linspace(0, len(self.tip) - 1, count).astype(np.int64)))


def places_of(judged: Judged) -> Places:
    """Samples of beads, no nearer to each other than need be."""
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
    """How far apart places of a bead are to be, at most [m]."""
    return min(APART, _OF_WIDTH * judged.problem.process.bead.width)


def between(judged: Judged) -> float:
    """How far apart places of the motion may be [m], and the ends of a bead from the first and the last of them."""
    return max(_apart(judged), float(judged.commanded.max()) * judged.trajectory.dt)


def begun_layers(judged: Judged) -> set[int]:
    """Layers of which a print that is resumed lays only the rest."""
    return {bead.layer for bead in judged.toolpath.beads[: judged.trajectory.first_bead]}


def may_be_left(judged: Judged, crumbs: float) -> float:
    """The share of the length that may be missing: what notes tell of, up to what the problem allows, and next to nothing."""
    return min(judged.toolpath.told.left_out, crumbs) + SHORT


def by_number(number: Ints) -> Iterator[tuple[int, Ints]]:
    """The numbers there are, and the places (k) of each."""
    order = np.argsort(number, kind="stable")
    found, first = np.unique(number[order], return_index=True)
    yield from zip(found.tolist(), np.split(order, first[1:]), strict=True)


def worst_of(judged: Judged, places: Places, name: str, values: Array, limit: float, unit: str) -> Check:
    """The check that no value (n) exceeds the limit, at the worst place. NaN fails."""
    return beyond_limits(judged, places, name, values, np.full(len(values), limit), unit)


def beyond_limits(judged: Judged, places: Places, name: str, values: Array, limits: Array, unit: str) -> Check:
    """The check that no value (n) exceeds its own limit (n), at the place where it does most, or comes nearest to it."""
    i = int(np.argmax(np.where(np.isnan(values), np.inf, values - limits)))
    value, limit, sample = float(values[i]), float(limits[i]), int(places.sample[i])
    ok = bool(value <= limit * (1.0 + DIGITS))
    return Check(name, value, limit, unit, ok, place(judged.trajectory, sample), sample=sample)


def not_read(why: str) -> Check:
    """What stands in the place of checks of a file that is not read again."""
    return Check(ON_PART, 0.0, 0.0, "mm", True, f"not read again: {why}")


@dataclass(frozen=True)
class AskedPlaces:
    """Places (n, 3) of one layer's surface that lie half a bead or more within its outline, and are to be filled.

    area     (n,) that each stands for [m^2]
    near     (n,) m from a bead's middle line, within which a place counts as filled
    whole    area of the layer [m^2], of which what is not filled is a share
    """

    points: Array
    area: Array
    near: Array
    whole: float


def filled(places: Places, asked: Mapping[int, AskedPlaces], may: float, corners: float = _CORNERS) -> Check:
    """The share of a layer that no bead comes near to, in the worst layer, or where a share may be missing, of all layers.

    may: share of all of them that notes tell of; corners: share of a layer that rounded turns and narrow ends leave
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
