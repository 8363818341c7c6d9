"""Which places of beads lie on which others, as the toolpath draws them; ages between layers are predicted from this.

From each place, a point one bead height down its normal is compared with earlier layers. The place lies on the nearest
place there, and on any about as near, since the executed motion may be nearer to those. A bead that only crosses here,
or the other end of a closed bead, does not count. The verifier determines again, from the motion, what each place lies
on. Where one bead rises over itself, it lies on its own earlier turn. Struts lie on nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.toolpath.bead import Bead

_STEP = 0.25  # × bead width: spacing of places
_BESIDE = 0.8  # × bead width: greatest distance from the line of the bead below; the verifier allows less
_OFF = 0.8  # × bead height: how far above or below one height down the bead below may be; the verifier allows less
_OWN = 0.5  # likewise within the bead's own layer
_AS_NEAR = 0.2  # × bead width: a place this much farther than the nearest one still counts
_BOTH_SIDES = (-2, -1, 1, 2)  # neighbouring places along a bead whose contacts are compared
_ALONG = 3.0  # steps by which contacts of neighbouring places may be farther apart than these, along their beads
_NEAREST = 8  # places examined: three on each of two equally near beads, and two more


@dataclass(frozen=True)
class BeadContacts(ReadOnlyArrays):
    """Places (k) that lie on others, sorted by pairs of beads.

    upper, lower (k)   indices of the beads
    at, below (k)      arc lengths of the upper and the lower place along their beads [m]
    around, beneath (k)  distance to the next place along each; nothing in between is examined [m]
    """

    upper: Ints
    lower: Ints
    at: Array
    below: Array
    around: Array
    beneath: Array

    def __len__(self) -> int:
        return len(self.upper)

    @cached_property
    def first(self) -> Ints:
        """Index (p) of the first place of each pair of beads."""
        if not len(self):
            return np.empty(0, dtype=np.int64)
        new = (np.diff(self.upper) != 0) | (np.diff(self.lower) != 0)
        return np.append(0, np.flatnonzero(new) + 1)

    @cached_property
    def pairs(self) -> Ints:
        """The pairs (p, 2) of beads: the upper and the lower one."""
        return np.column_stack([self.upper[self.first], self.lower[self.first]])

    def extremes(self, values: Array) -> tuple[Array, Array]:
        """The smallest and the greatest (p) of values (k) within each pair."""
        if not len(self):
            return np.empty(0), np.empty(0)
        return np.minimum.reduceat(values, self.first), np.maximum.reduceat(values, self.first)


@dataclass(frozen=True)
class _BeadPlaces:
    """Places (k) along beads: bead, layer, arc length `s` and distance to the next place [m]; tip, and the point one
    bead height down from it (k, 3); normal (k, 3); width and height (k) [m]."""

    bead: Ints
    layer: Ints
    s: Array
    around: Array
    tip: Array
    down: Array
    normal: Array
    width: Array
    height: Array


def contacts(beads: Sequence[Bead]) -> BeadContacts:
    """Which places lie on which: both ends of each bead and places up to a quarter width apart."""
    places = _places([(i, bead) for i, bead in enumerate(beads) if not bead.round])
    if places is None:
        none, no = np.empty(0, dtype=np.int64), np.empty(0)
        return BeadContacts(none, none, no, no, no, no)
    rows = [np.flatnonzero(places.layer == number) for number in np.unique(places.layer)]
    trees = [cKDTree(places.tip[own]) for own in rows]
    low, high = np.array([tree.mins for tree in trees]), np.array([tree.maxes for tree in trees])
    found: list[tuple[Ints, Ints]] = []
    for k, left in enumerate(rows):
        reach = float(np.hypot(_BESIDE * places.width[left], _OFF * places.height[left]).max())
        for j in (*range(k - 1, -1, -1), k):
            if not len(left):
                break
            down = places.down[left]
            if (down.min(axis=0) > high[j] + reach).any() or (down.max(axis=0) < low[j] - reach).any():
                continue
            one, other = _beneath(places, left, rows[j], trees[j], reach, _OWN if j == k else _OFF)
            same = (places.bead[other] == places.bead[one]) & (places.s[other] < places.s[one])
            earlier = same | (places.bead[other] < places.bead[one])
            one, other = one[earlier], other[earlier]
            found.append((one, other))
            left = np.setdiff1d(left, one)
    one, other = (np.concatenate(each) for each in zip(*found, strict=True)) if found else (np.empty(0, int),) * 2
    one, other = _kept_along(places, one, other)
    order = np.lexsort((places.s[one], places.bead[other], places.bead[one]))
    one, other = one[order], other[order]
    return BeadContacts(
        places.bead[one], places.bead[other], places.s[one], places.s[other], places.around[one], places.around[other]
    )


def _places(beads: Sequence[tuple[int, Bead]]) -> _BeadPlaces | None:
    """Places along beads, given with their numbers; None if there are no beads."""
    if not beads:
        return None
    counts = [int(np.ceil(bead.length / (_STEP * float(bead.width.min())))) + 1 for _, bead in beads]
    columns: list[Array] = []
    for (_, bead), count in zip(beads, counts, strict=True):
        s = np.linspace(0.0, bead.length, count)
        values = np.column_stack([bead.points, bead.normals, bead.width, bead.height])
        columns.append(np.column_stack([s, *(np.interp(s, bead.s, column) for column in values.T)]))
    table = np.concatenate(columns)
    s, tip, normal, width, height = table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7], table[:, 8]
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    steps = [bead.length / (count - 1) for (_, bead), count in zip(beads, counts, strict=True)]
    number, layer = np.array([i for i, _ in beads]), np.array([bead.layer for _, bead in beads])
    return _BeadPlaces(
        np.repeat(number, counts),
        np.repeat(layer, counts),
        s,
        np.repeat(steps, counts),
        tip,
        tip - height[:, None] * normal,
        normal,
        width,
        height,
    )


def _beneath(places: _BeadPlaces, left: Ints, rows: Ints, tree: cKDTree, reach: float, off: float) -> tuple[Ints, Ints]:
    """Places of `left` that lie on places `rows` of a layer, paired with the nearest of these and all about as near."""
    away, near = tree.query(places.down[left], k=min(_NEAREST, len(rows)), distance_upper_bound=reach)
    away, near = away.reshape(len(left), -1), near.reshape(len(left), -1)
    as_near = np.isfinite(away) & (away <= away[:, :1] + _AS_NEAR * places.width[left, None])
    at, which = np.nonzero(as_near)
    one, other = left[at], rows[near[at, which]]
    way = places.tip[other] - places.down[one]
    rise = (way * places.normal[one]).sum(axis=1)
    beside = np.linalg.norm(way - rise[:, None] * places.normal[one], axis=1)
    on = (np.abs(rise) <= off * places.height[one]) & (beside <= _BESIDE * places.width[other])
    return one[on], other[on]


def _kept_along(places: _BeadPlaces, one: Ints, other: Ints) -> tuple[Ints, Ints]:
    """Keep the contacts, pairs (m) of a place and one it lies on, that continue along the bead.

    If a place lies on several others that are far apart along their beads, only those count that at least half of the
    neighbouring places lie on, too.
    """
    order = np.lexsort((other, one))
    one, other = one[order], other[order]
    if not len(one):
        return one, other
    first = np.flatnonzero(np.append(True, np.diff(one) != 0))
    which = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(one))))
    apart = np.maximum.reduceat(other, first) - np.minimum.reduceat(other, first)
    doubtful = np.flatnonzero(apart[which] > _ALONG)  # places are numbered along all beads, one after another
    last = len(places.s)
    key = one * (2 * last) + other
    known, agree = np.zeros(len(doubtful)), np.zeros(len(doubtful))
    for beside in _BOTH_SIDES:
        place = np.clip(one[doubtful] + beside, 0, last - 1)
        same = (place == one[doubtful] + beside) & (places.bead[place] == places.bead[one[doubtful]])
        near = _ALONG + abs(beside)
        low = np.searchsorted(key, place * (2 * last) + np.maximum(other[doubtful] - near, 0))
        high = np.searchsorted(key, place * (2 * last) + np.minimum(other[doubtful] + near, last), side="right")
        known += same
        agree += same & (high > low)
    lone = doubtful[2.0 * agree < known]
    kept = np.ones(len(one), dtype=bool)
    kept[lone] = False
    none_left = np.add.reduceat(kept, first) == 0  # then all of them count
    kept |= none_left[which]
    return one[kept], other[kept]
