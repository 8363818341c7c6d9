"""Samples that no robot can have produced: wrong for an instant, held for a while, or zeros in place of unknown values.

They are judged only by the samples before and after, whatever the unit: a moving joint advances by similar amounts in
consecutive steps. Samples that are wrong for an instant, and those that repeat the previous one until it leaps, are
left out and reported; recordings that cannot be repaired this way are rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d, rank_filter

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import InputError
from planner.feedback.filters import noise_of

INSTANT = 2  # consecutive samples that may be wrong
AROUND = 4  # samples to either side that are compared with one
NOISES = 12.0  # × the noise of one sample: tolerated difference
DIGITS = 5.0  # × the last digit: tolerated difference, added to the above
COARSE = 0.0125  # s between samples: above this, a short move may take only a few samples, so nothing is judged
MISSING = 1.9  # × the usual time step: from here on samples are missing
LEAP = 3.0  # × the second-longest step nearby: tolerated length of a step
MOST_LEFT_OUT = 0.01  # share of samples (or FEW, if that is more) that may be wrong for an instant: more is no glitch
FEW = 3


@dataclass(frozen=True)
class CleanedSamples:
    """Which samples (m) of a recording are kept, and a description of those left out."""

    kept: Flags
    remarks: tuple[str, ...]


def cleaned(file: Path, lines: Ints, time: Array, places: Array, names: Sequence[str]) -> CleanedSamples:
    """Samples of joints (m, n), in any unit, without those that no robot can have produced.

    lines (m): their lines in the file; time (m) [s]; names (n) of the columns. Raises InputError for positions that
    leap and stay there, and if more than a few samples are wrong.
    """
    if float(np.median(np.diff(time))) > COARSE * (1.0 + 1e-6):
        return CleanedSamples(np.ones(len(time), dtype=np.bool_), ())
    floor = NOISES * noise_of(places) + DIGITS * _last_digits(places)
    wrong = _wrong_for_an_instant(places, floor)
    kept: Flags = np.asarray(~wrong.any(axis=1))
    remarks = []
    if not kept.all():
        first = int(np.argmin(kept))
        column, out = names[int(np.argmax(wrong[first]))], int((~kept).sum())
        if out > max(MOST_LEFT_OUT * len(kept), FEW):
            reason = f"{out} of {len(kept)} samples cannot be a joint's: column {column!r} leaps and comes back"
            raise InputError(reason, file=file, line=int(lines[first]), hint="does the interface mix up samples?")
        where = f"the first in line {lines[first]}: column {column}"
        remarks.append(f"{_count(out)} left out as no joint can move like that, {where}")
    held = _held(places, kept, floor, time)
    if held.any():
        where = f"the first in line {lines[int(np.argmax(held))]}"
        remarks.append(f"{_count(int(held.sum()))} left out as the recording stood still, {where}")
        kept &= ~held
    rows = np.flatnonzero(kept)
    leaps = _leaps(places[rows], floor, time[rows])
    if leaps.any():
        i = int(np.argmax(leaps.any(axis=1)))
        reason = f"column {names[int(np.argmax(leaps[i]))]!r} leaps from one sample to the next as no joint can"
        hint = "samples were lost, held or written as 0: use a recording without such samples"
        raise InputError(reason, file=file, line=int(lines[rows[i + 1]]), hint=hint)
    return CleanedSamples(kept, tuple(remarks))


def _count(count: int) -> str:
    return f"{count} sample{'s' if count > 1 else ''}"


def _last_digits(places: Array) -> Array:
    """The smallest non-zero step (n) of each column: the value of its last digit, if that exceeds the noise."""
    steps = np.abs(np.diff(places, axis=0))
    least = np.where(steps > 0.0, steps, np.inf).min(axis=0, initial=np.inf)
    return np.where(np.isfinite(least), least, 0.0)


def _wrong_for_an_instant(places: Array, floor: Array) -> Flags:
    """Samples (m, n) farther from the median around them than the medians nearby are from each other."""
    middle = median_filter(places, size=(2 * INSTANT + 1, 1), mode="nearest")
    around = 2 * AROUND + 1
    span = maximum_filter1d(middle, around, axis=0) - minimum_filter1d(middle, around, axis=0)
    return np.asarray(np.abs(places - middle) > floor + span)


def _leaps(places: Array, floor: Array, time: Array) -> Flags:
    """Steps (m - 1, n) that are far longer than their neighbours, ignoring the longest of these: a position that is
    soon left again gives a second step as long. Steps across missing samples are not judged."""
    took = np.diff(time)
    steps = np.abs(np.diff(places, axis=0)) * (took < MISSING * np.median(took))[:, None]
    beside = np.ones((2 * AROUND + 1, 1))
    beside[AROUND] = 0.0
    usual = rank_filter(steps, -2, footprint=beside, mode="constant") if len(steps) else steps
    return np.asarray(steps > floor + LEAP * usual)


def _held(places: Array, kept: Flags, floor: Array, time: Array) -> Flags:
    """Samples (m) that repeat the previous one in all joints until a leap."""
    rows = np.flatnonzero(kept)
    out = np.zeros(len(places), dtype=np.bool_)
    leaps = np.flatnonzero(_leaps(places[rows], floor, time[rows]).any(axis=1))
    same = (np.diff(places[rows], axis=0) == 0.0).all(axis=1)
    for i in leaps.tolist():
        k = i
        while k > 0 and same[k - 1]:
            out[rows[k]] = True
            k -= 1
    return out
