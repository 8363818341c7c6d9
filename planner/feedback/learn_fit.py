"""Corrections for the next run from the deviation of the last one.

Iterative learning control: where the executed path is off the plan by e, the next program requests positions shifted by
-e. A controller that cuts corners and lags passes on part of each request, never reversed, so that the residual shrinks
from run to run (Gunnarsson and Norrlöf, "On the design of ILC algorithms using optimization", Automatica 2001; for
robot programs He et al., arXiv 2301.02348). Only across the path: along it, a position error is a timing error, which
is a matter of speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import uniform_filter1d

from planner.base.arrays import Array, Flags, Indices, Ints, ReadOnlyArrays, true_runs
from planner.base.geometry import arc_lengths
from planner.feedback.filters import noise_of
from planner.feedback.learn_track import RecordedWay
from planner.motion.as_run import Corrections
from planner.plan import Trajectory

KNOT = 16e-3  # s of planned motion between knots of the corrections: no controller is given shorter lines
BEND = 0.1e-3  # m: expected second difference of corrections from knot to knot; the smaller, the smoother
QUIET = 2e-6  # m: least noise assumed of a recording
APART = 1e-6  # m: least distance between knots of the corrections
AROUND = 4  # knots to either side (64 ms) over which a run is judged better or worse
MORE, LESS = 1.5, 0.5  # factors on the gain where a run was better, and where it was not
LEAST = 0.01  # least gain
ROUNDED = 2e-9  # m: margin for rounding in the file
UNKNOWN_MOST = 0.3  # share of a bead in gaps of the recording, above which the bead is not learnt from


@dataclass(frozen=True)
class RunErrors(ReadOnlyArrays):
    """Deviation of a run from its plan (n samples of the plan).

    off (n, 3)     of the executed tip across the planned path, part frame [m]; 0 where unknown
    known (n)      samples on beads that the recording shows
    speed (n)      executed along the plan [m/s]; NaN where unknown
    noise          standard deviation of one recorded tip on a bead [m]
    """

    off: Array
    known: Flags
    speed: Array
    noise: float

    @property
    def size(self) -> Array:
        """Distance from the plan (k) at known samples [m]."""
        return np.asarray(np.linalg.norm(self.off[self.known], axis=1))


def errors_of(t: Trajectory, run: RecordedWay) -> RunErrors:
    """Deviation of a run from a plan, at each sample of the plan."""
    n = len(t)
    place, first = np.unique(np.maximum.accumulate(run.place), return_index=True)
    rows = np.arange(n)
    executed = _executed(run, rows)
    when = np.interp(rows, place, run.time[first])
    known = t.deposit & (rows >= place[0]) & (rows <= place[-1])
    for a, b in run.gaps:
        known &= ~((rows > run.place[a]) & (rows < run.place[b]))
    along = np.gradient(t.tip, axis=0)
    size = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / np.where(size > 0.0, size, 1.0)
    off = executed - t.tip
    off -= (off * along).sum(axis=1, keepdims=True) * along
    # at rest a recording repeats its last digits and shows no noise
    laying = t.deposit[np.minimum(np.rint(run.place).astype(np.int64), n - 1)]
    return RunErrors(
        np.where(known[:, None], off, 0.0),
        known,
        _speed(t, when, known),
        float(np.sqrt((noise_of(run.tip, laying) ** 2).mean())),
    )


def _executed(run: RecordedWay, rows: Ints) -> Array:
    """Executed tips (n, 3) [m] at samples of the plan (n): means of recorded tips near each, linearly interpolated."""
    near = np.rint(run.place).astype(np.int64)
    count = np.bincount(near)
    there = np.flatnonzero(count)
    place, *tip = (np.bincount(near, column)[there] / count[there] for column in (run.place, *run.tip.T))
    return np.column_stack([np.interp(rows, place, column) for column in tip])


def _speed(t: Trajectory, when: Array, known: Flags) -> Array:
    """Speed along the plan (n) [m/s], over ten samples around each."""
    way = arc_lengths(t.tip)
    k = np.arange(len(t))
    a, b = np.maximum(k - 5, 0), np.minimum(k + 5, len(t) - 1)
    inside = known & known[a] & known[b] & (t.bead[a] == t.bead[b])
    took = when[b] - when[a]
    out: Array = np.where(inside & (took > 0.0), (way[b] - way[a]) / np.where(took > 0.0, took, 1.0), np.nan)
    return out


@dataclass(frozen=True)
class Lessons(ReadOnlyArrays):
    """What was learnt from the runs so far (k knots), at each knot from the run closest to the plan around it.

    corrections    of the next program, or of the last one
    best (k, 3)    the corrections of that run [m];  left (k, 3): its remaining deviation from the plan [m]
    gain (k)       share of the remaining deviation that is corrected next: reduced where it was too much before; 0
                   where nothing was learnt from a run
    """

    corrections: Corrections
    best: Array
    left: Array
    gain: Array


def next_lessons(t: Trajectory, errors: RunErrors, before: Lessons | None, most: float) -> Lessons:
    """Add what a run teaches to the lessons of the runs before; corrections are bounded by `most` [m].

    Where a run was closer to the plan than the best before it, the next corrects its remaining deviation; elsewhere it
    corrects a smaller share of the best run's. So a robot that a correction makes worse returns to the one that did
    not. Beads that the trajectory does not lay keep their lessons.
    """
    step = max(round(KNOT / t.dt), 1)
    rows: list[tuple[Array, ...]] = []
    for first, last in true_runs(t.deposit).tolist():
        own = np.arange(first, last)
        knots = np.unique(np.append(np.arange(0, len(own), step), len(own) - 1))
        knots = knots[np.append(True, np.diff(t.s[own[knots]]) > APART)]  # the tip may rest on a bead
        bead, s, known = int(t.bead[first]), t.s[own[knots]], errors.known[own]
        ran, best, left, gain = _before(before, bead, s)
        if known.mean() >= 1.0 - UNKNOWN_MOST:
            off = _smoothed(errors.off[own], known, knots, errors.noise)
            better = (_around(off) <= _around(left)) | (gain == 0.0)
            gain = np.where(
                better, np.where(gain == 0.0, 1.0, np.minimum(MORE * gain, 1.0)), np.maximum(LESS * gain, LEAST)
            )
            best, left = np.where(better[:, None], ran, best), np.where(better[:, None], off, left)
        # where no run has been learnt from yet, a forecast's corrections stay
        shift = np.where((gain > 0.0)[:, None], best - gain[:, None] * left, ran)
        rows.append((np.full(len(s), bead), s, shift, best, left, gain))
    beads, s, shift, best, left, gain = (np.concatenate(column) for column in zip(*rows, strict=True))
    found = Lessons(Corrections(beads.astype(np.int64), s, _bounded(shift, most)), best, left, gain)
    return found if before is None else _with_others(found, before, most)


def _with_others(found: Lessons, before: Lessons, most: float) -> Lessons:
    """Lessons of a run, with the earlier ones for beads that it did not lay, such as those before the first bead of a
    resumed print; their corrections are bounded by `most` [m] too."""
    kept = ~np.isin(before.corrections.bead, found.corrections.bead)
    bead = np.concatenate([found.corrections.bead, before.corrections.bead[kept]])
    order = np.argsort(bead, kind="stable")

    def both(own: Array, others: Array) -> Array:
        return np.asarray(np.concatenate([own, others[kept]])[order])

    shift = both(found.corrections.shift, _bounded(before.corrections.shift, most))
    corrections = Corrections(bead[order], both(found.corrections.s, before.corrections.s), shift)
    return Lessons(
        corrections, both(found.best, before.best), both(found.left, before.left), both(found.gain, before.gain)
    )


def _bounded(shift: Array, most: float) -> Array:
    """Displacements (k, 3) [m], shortened to `most` [m] where they are longer."""
    size = np.linalg.norm(shift, axis=1, keepdims=True)
    return np.asarray(shift * np.minimum(1.0, (most - ROUNDED) / np.where(size > 0.0, size, 1.0)))


def _before(before: Lessons | None, bead: int, s: Array) -> tuple[Array, Array, Array, Array]:
    """Corrections of the last run, the best ones, the deviation these left (k, 3) [m], and gains (k), at arc lengths s
    (k) of a bead; gains are 0 where nothing was learnt from a run."""
    k = len(s)
    own = slice(0, 0) if before is None else slice(*np.searchsorted(before.corrections.bead, [bead, bead + 1]).tolist())
    if before is None or own.start == own.stop:
        return np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3)), np.zeros(k)
    place = before.corrections.s[own]
    ran, best, left = (
        np.column_stack([np.interp(s, place, column) for column in values[own].T])
        for values in (before.corrections.shift, before.best, before.left)
    )
    return ran, best, left, np.interp(s, place, before.gain[own])


def _around(off: Array) -> Array:
    """Root mean square (k) of deviations from the plan (k, 3) over AROUND knots to either side."""
    return np.sqrt(uniform_filter1d(np.square(off).sum(axis=1), 2 * AROUND + 1, mode="nearest"))


def _smoothed(off: Array, known: Flags, knots: Indices, noise: float) -> Array:
    """Values (k, 3) at knots whose linear interpolation is close to off (n, 3) where that is known, and bends little.

    Minimises sum |off - value|^2 / noise^2 + sum |second difference|^2 / BEND^2, with a pentadiagonal matrix.
    """
    n, k = len(off), len(knots)
    if k == 1:
        return off[:1]
    at = np.clip(np.searchsorted(knots, np.arange(n), side="right") - 1, 0, k - 2)
    u = np.clip((np.arange(n) - knots[at]) / (knots[at + 1] - knots[at]), 0.0, 1.0)
    w = known.astype(np.float64)
    upper = np.zeros((3, k))  # diagonals of the symmetric matrix, the main one last
    upper[2] = np.bincount(at, w * (1.0 - u) ** 2, k) + np.bincount(at + 1, w * u**2, k)
    upper[1, 1:] = np.bincount(at, w * u * (1.0 - u), k)[:-1]
    right = np.column_stack([np.bincount(at, w * (1.0 - u) * c, k) + np.bincount(at + 1, w * u * c, k) for c in off.T])
    stiff = (max(noise, QUIET) / BEND) ** 2
    for i, square in enumerate((1.0, 4.0, 1.0)):
        upper[2, i : k - 2 + i] += stiff * square
    upper[1, 1 : k - 1] += -2.0 * stiff
    upper[1, 2:k] += -2.0 * stiff
    upper[0, 2:] += stiff
    upper[2] += 1e-9 + 1e-3 * stiff  # where nothing is known, nothing changes
    return np.asarray(solveh_banded(upper, right))


def bends(corrections: Corrections) -> Array:
    """Distance (k) of each correction from the mean of its neighbours on the bead [m]; 0 at a bead's ends."""
    bead, shift = corrections.bead, corrections.shift
    out = np.zeros(len(bead))
    inside = (bead[2:] == bead[1:-1]) & (bead[:-2] == bead[1:-1])
    out[1:-1] = np.where(inside, np.linalg.norm(0.5 * (shift[2:] + shift[:-2]) - shift[1:-1], axis=1), 0.0)
    return out


def most_bent(corrections: Corrections, beads: int) -> Array:
    """The greatest bend (b) of the corrections on each of `beads` beads [m]."""
    out = np.zeros(beads)
    np.maximum.at(out, corrections.bead, bends(corrections))
    return out


def evened(corrections: Corrections, bend: Array) -> Corrections:
    """Move corrections that are off the mean of their neighbours by more than `bend` (k) [m] half way towards it."""
    return _evened_at(corrections, np.flatnonzero(bends(corrections) > bend))


def evened_around(corrections: Corrections, bead: int, s: float, reach: float) -> Corrections:
    """Move corrections within a reach [m] of a place on a bead half way towards the mean of their neighbours."""
    near = (corrections.bead == bead) & (np.abs(corrections.s - s) <= reach)
    return _evened_at(corrections, np.flatnonzero(near & (bends(corrections) > 0.0)))


def _evened_at(corrections: Corrections, k: Indices) -> Corrections:
    shift = corrections.shift.copy()
    shift[k] = 0.5 * corrections.shift[k] + 0.25 * (corrections.shift[k - 1] + corrections.shift[k + 1])
    return Corrections(corrections.bead, corrections.s, shift)


def less_around(corrections: Corrections, bead: int, s: float, reach: float) -> Corrections:
    """Halve the corrections at a place on a bead, and reduce those within a reach [m] of it, less with distance."""
    away = np.where(corrections.bead == bead, np.abs(corrections.s - s) / reach, np.inf)
    share = np.clip(away, 0.0, 1.0)
    share = 0.5 + 0.5 * share**2 * (3.0 - 2.0 * share)
    return Corrections(corrections.bead, corrections.s, share[:, None] * corrections.shift)
