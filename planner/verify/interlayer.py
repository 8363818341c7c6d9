"""Interlayer time: how old the bead below is when the nozzle lays material on it, and whether that is within limits.

Found from the executed motion alone. A place lies on the place of a lower layer, laid earlier, that is nearest to the
point one bead's height down its normal, if that is near enough sideways for the two beads to overlap by a quarter of
their width. Of several about equally near, as at the ends of a closed bead or where beads cross, the one
whose age agrees with that of neighbouring places along the bead is chosen. Where one bead rises over itself, as a
spiral does, it lies on its own earlier turn. First layers, bridges and struts lie on nothing. All values are in the
part frame, in metres and seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.plan import Check
from planner.plan.by_layer import AGES
from planner.verify.checks import DIGITS, EVERYWHERE, Findings, Judged, place
from planner.verify.pressed import laid_beads

_STEP = 0.25  # bead widths between places
_BESIDE = 0.75  # bead widths from the line of the bead below: there the two overlap by a quarter
_OFF = 0.75  # bead heights: the bead below may lie this much higher or lower than one height down
_AS_NEAR = 0.2  # bead widths: a place farther away by no more than this counts as equally near
_NEAREST = 6  # places examined
_BESIDE_IT = 3  # places on either side along the bead, whose ages decide between those
_AT_ONCE = 50_000  # places processed at once: bounds the memory
_OWN = 0.5  # as _OFF, within the bead's own layer, whose other places all lie a whole height above that point


@dataclass(frozen=True)
class LaidPlaces:
    """Places (k) along the beads, in order of time; those that are there from the beginning come first.

    tip, down (k, 3)        the nozzle's tip, and one bead's height beneath it along the normal [m]
    normal (k, 3), width, height (k)
    bead, layer, sample (k) sample is -1 for beads that are there from the beginning
    time (k) [s]            when it is laid, NaN for beads that are there from the beginning
    run (k)                 number of the stretch laid without interruption
    """

    tip: Array
    down: Array
    normal: Array
    width: Array
    height: Array
    bead: Ints
    layer: Ints
    sample: Ints
    time: Array
    run: Ints


def interlayer(judged: Judged) -> Findings:
    """Ages of the bead below each place, and the checks of the limits that the problem sets."""
    spec = judged.problem.process.interlayer_time
    if not judged.trajectory.deposit.any():
        return Findings()
    places = laid_places(judged)
    age, below = ages(places)
    known = np.flatnonzero(np.isfinite(age))
    checks = []
    for least, asked in ((True, None if spec is None else spec.least), (False, None if spec is None else spec.most)):
        if asked is not None:
            checks.append(_check(judged, places, age, below, known, asked, least))
    if not len(known):
        return Findings(tuple(checks))
    found = age[known]
    metrics = {
        "interlayer_time_min_s": float(found.min()),
        "interlayer_time_median_s": float(np.median(found)),
        "interlayer_time_max_s": float(found.max()),
    }
    return Findings(tuple(checks), metrics, {AGES: _by_sample(judged, places, age)})


def laid_places(judged: Judged) -> LaidPlaces:
    """Places along the beads of the motion, a quarter of a bead's width apart; a resting nozzle lays only one."""
    laid, t = laid_beads(judged), judged.trajectory
    begins = np.append(True, np.diff(laid.bead) != 0)
    run = np.cumsum(begins) - 1
    step = np.append(0.0, np.linalg.norm(np.diff(laid.tip, axis=0), axis=1)) / (_STEP * laid.width)
    way = np.cumsum(np.where(begins, 0.0, step))
    number = np.floor(way - way[np.flatnonzero(begins)][run])
    moved = np.append(True, np.diff(number) > 0)
    last = np.append(begins[1:], True) & (step > 0.0)
    at = np.flatnonzero(begins | moved | last)
    at = at[~np.array([bead.round for bead in judged.toolpath.beads])[laid.bead[at]]]
    layers = np.array([bead.layer for bead in judged.toolpath.beads])
    sample = laid.sample[at].astype(np.int64)
    return LaidPlaces(
        tip=laid.tip[at],
        down=laid.tip[at] - laid.height[at, None] * laid.normal[at],
        normal=laid.normal[at],
        width=laid.width[at],
        height=laid.height[at],
        bead=laid.bead[at],
        layer=layers[laid.bead[at]],
        sample=sample,
        time=np.where(sample >= 0, t.t[sample], np.nan),
        run=run[at],
    )


def ages(places: LaidPlaces) -> tuple[Array, Ints]:
    """Age (k) [s], when each place is laid, of the bead that it lies on, and that bead (k).

    NaN and -1 where a place lies on nothing, or on a bead that is there from the beginning.
    """
    others = _others(places)
    nearest = others[:, 0]  # where it is -1 the age is NaN, which sorts last
    age = np.where(nearest >= 0, places.time - places.time[nearest], np.nan)
    below = np.empty(len(age), dtype=np.int64)
    for first in range(0, len(age), _AT_ONCE):
        own = slice(first, min(first + _AT_ONCE, len(age)))
        beside = np.arange(own.start, own.stop)[:, None] + np.arange(-_BESIDE_IT, _BESIDE_IT + 1)
        held = np.clip(beside, 0, len(age) - 1)
        same = (held == beside) & (places.run[held] == places.run[own, None])
        around = np.sort(np.where(same, age[held], np.nan), axis=1)
        row, count = np.arange(len(around)), np.isfinite(around).sum(axis=1)
        usual = around[row, np.maximum(count - 1, 0) // 2]
        those = np.where(others[own] >= 0, places.time[own, None] - places.time[others[own]], np.nan)
        off = np.abs(those - usual[:, None])
        below[own] = others[own][row, np.argmin(np.where(np.isnan(off), np.inf, off), axis=1)]
    on = np.flatnonzero((below >= 0) & ~np.isnan(places.time[below]))
    found, bead = np.full(len(age), np.nan), np.full(len(age), -1)
    found[on] = places.time[on] - _when(places, on, below[on])
    bead[on] = places.bead[below[on]]
    return found, bead


def _others(places: LaidPlaces) -> Ints:
    """Places (k, _NEAREST) that each one may lie on, the nearest first; -1 for none."""
    out, found = np.full((len(places.bead), _NEAREST), -1), np.zeros(len(places.bead), dtype=bool)
    numbers = np.unique(places.layer)
    rows = [np.flatnonzero(places.layer == number) for number in numbers]
    trees = [cKDTree(places.tip[own]) for own in rows]
    low, high = np.array([tree.mins for tree in trees]), np.array([tree.maxes for tree in trees])
    for k, own in enumerate(rows):
        reach = float(np.hypot(_BESIDE * places.width[own], _OFF * places.height[own]).max())
        left = own[places.sample[own] >= 0]
        for j in (*range(k - 1, -1, -1), k):
            if not len(left):
                break
            down = places.down[left]
            if (down.min(axis=0) > high[j] + reach).any() or (down.max(axis=0) < low[j] - reach).any():
                continue
            away, near = trees[j].query(down, k=_NEAREST, distance_upper_bound=reach)
            at, which = np.nonzero(np.isfinite(away) & (away <= away[:, :1] + _AS_NEAR * places.width[left, None]))
            one, other = left[at], rows[j][near[at, which]]
            on = _lies_on(places, one, other, _OWN if j == k else _OFF)
            on &= ~(places.time[other] >= places.time[one])
            out[one[on], which[on]] = other[on]
            found[one[on]] = True
            left = left[~found[left]]
    for first in range(0, len(out), _AT_ONCE):  # move those found to the front, the nearest first
        some = out[first : first + _AT_ONCE]
        some[:] = np.take_along_axis(some, np.argsort(some < 0, axis=1, kind="stable"), axis=1)
    return out


def _lies_on(places: LaidPlaces, one: Ints, other: Ints, off: float) -> Flags:
    """Whether places (m) lie on others: about one height above them, and not too far sideways."""
    way = places.tip[other] - places.down[one]
    rise = (way * places.normal[one]).sum(axis=1)
    beside = np.linalg.norm(way - rise[:, None] * places.normal[one], axis=1)
    return np.asarray((np.abs(rise) <= off * places.height[one]) & (beside <= _BESIDE * places.width[other]))


def _when(places: LaidPlaces, one: Ints, other: Ints) -> Array:
    """When (m) [s] the tip passed nearest to the point one height below each place, interpolated near `other`."""
    best, when = np.full(len(one), np.inf), np.empty(len(one))
    for side in (-1, 1):
        beside = np.clip(other + side, 0, len(places.run) - 1)
        beside = np.where(places.run[beside] == places.run[other], beside, other)
        way = places.tip[beside] - places.tip[other]
        square = np.maximum((way**2).sum(axis=1), 1e-18)
        share = np.clip(((places.down[one] - places.tip[other]) * way).sum(axis=1) / square, 0.0, 1.0)
        away = np.linalg.norm(places.tip[other] + share[:, None] * way - places.down[one], axis=1)
        time = places.time[other] + share * (places.time[beside] - places.time[other])
        when, best = np.where(away < best, time, when), np.minimum(away, best)
    return when


def _by_sample(judged: Judged, places: LaidPlaces, age: Array) -> Array:
    """Age (n) by sample: that of the last place up to it; NaN in travel."""
    t = judged.trajectory
    series = np.full(len(t), np.nan)
    laid, own = np.flatnonzero(t.deposit), places.sample >= 0
    last = np.searchsorted(places.sample[own], laid, side="right") - 1
    here = places.bead[own][last] == t.bead[laid]
    series[laid] = np.where((last >= 0) & here, age[own][last], np.nan)
    return series


def _check(
    judged: Judged, places: LaidPlaces, age: Array, below: Ints, known: Ints, asked: float, least: bool
) -> Check:
    """The check of the least or greatest age allowed [s], at the worst place."""
    name = "interlayer time at least" if least else "interlayer time at most"
    dt = judged.trajectory.dt
    limit = asked - dt if least else asked + dt
    if not len(known):
        return Check(name, asked, limit, "s", True, EVERYWHERE, least=least)
    k = known[int(np.argmin(age[known]) if least else np.argmax(age[known]))]
    worst = float(age[k])
    room = DIGITS * limit
    ok = worst >= limit - room if least else worst <= limit + room
    sample = int(places.sample[k])
    where = f"{place(judged.trajectory, sample)}, on bead {below[k]}"
    missing = age[known] < limit if least else age[known] > limit
    if not ok:
        held = np.floor((worst - dt) * 10.0) / 10.0 if least else np.ceil((worst - dt) * 10.0) / 10.0
        where += f"; {missing.mean():.1%} of such places are outside the limit; {'least_s' if least else 'most_s'}: {held:g} would hold"
    return Check(name, worst, limit, "s", bool(ok), where, least=least, sample=sample)
