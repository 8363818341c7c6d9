"""Targets beside the path, so that fewer are enough: lines between them pass it on both sides.

A line between two points of a bend misses the path between them on one side only. Where both points lie outside of the
bend by half of what a line may miss, it may be longer by a factor of sqrt(1.5) and still miss the path by no more. What
holds for positions holds for orientations and the station's axes as well.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.export.corners import closer_at_turns
from planner.export.fit import Poses, Way, between, fraction, great_arc, misfits
from planner.export.thinning import Indices, Judge, fewest
from planner.readonly import Array, Flags

OFF = 0.5  # of the tolerances: how far targets may lie beside the path
TINY = 1e-15  # m, rad: keeps what is not moved from dividing by nothing
SHARE = 0.5  # of what a usual line misses at its middle; it is within its tolerance, so that this is within OFF of it


def chosen_targets(
    way: Way, kept: Indices, linear: Flags, cornered: Flags, joint: Judge, chord: float
) -> tuple[Indices, Poses]:
    """Samples (m) that become targets, `kept` (sorted) among them, and the targets (m).

    linear (n - 1) says which steps between samples belong to lines; `joint` judges spans of the others. At the samples
    `cornered` (n) no zone may cut off more than `chord` [m]. Kept samples have their targets on the path, and so have
    all between two of them where it takes no fewer to leave it. The count is near the least, by a few per cent: each
    line reaches as far as it can, but a target has one place beside the path, and not a choice of all.
    """

    def enough(targets: Poses, settled: Indices, joint: Judge) -> Indices:
        sample = fewest(settled, _judge(way, targets, linear, joint))
        return closer_at_turns(sample, way.poses.position, targets.position, cornered, chord)

    plain = enough(way.poses, kept, joint)
    beside = outwards(way, _reach(plain, kept, linear))
    travel = plain[:-1][~linear[plain[:-1]]]  # which stays as it is, so that it need not be judged again
    found = enough(beside, np.union1d(kept, travel), lambda first, last: np.zeros(len(first)))
    fewer = np.diff(np.searchsorted(found, kept)) < np.diff(np.searchsorted(plain, kept))
    owner = np.clip(np.searchsorted(kept, np.arange(len(way.clock)), side="right") - 1, 0, len(fewer) - 1)
    sample = np.unique(np.concatenate([kept, found[fewer[owner[found]]], plain[~fewer[owner[plain]]]]))
    moved = fewer[owner[sample], None]
    return sample, Poses(np.where(moved, beside.table[sample], way.poses.table[sample]))


def outwards(way: Way, reach: Array) -> Poses:
    """Poses moved off the way to the outer side of its bends, by half of what a usual line misses there.

    reach (n) is half of a usual line around each sample, in samples; 0 leaves the target where it is.
    """
    return Poses(_outwards(way.poses.table, reach, OFF * way.tolerance[:3]))


def _judge(way: Way, targets: Poses, linear: Flags, joint: Judge) -> Judge:
    """How far the controller's interpolation between two samples' targets misses the samples between, in tolerances."""

    def judge(first: Indices, last: Indices) -> Array:
        out = np.empty(len(first))
        line = linear[first]
        out[line] = misfits(way, targets, first[line], last[line]).max(axis=1, initial=0.0)
        out[~line] = joint(first[~line], last[~line])
        return out

    return judge


def _reach(sample: Indices, kept: Indices, linear: Flags) -> Array:
    """Half of a usual line around each sample (n) [samples], never beyond what is kept; 0 outside of lines."""
    at = np.arange(len(linear) + 1)
    half = np.interp(at, 0.5 * (sample[1:] + sample[:-1]), 0.5 * np.diff(sample))
    k = np.searchsorted(kept, at)
    edge = np.minimum(at - kept[np.maximum(k - 1, 0)], kept[k] - at)
    within = np.append(linear, False) & np.append(False, linear)
    out: Array = np.where(within, np.minimum(half, edge), 0.0)
    return out


@njit(cache=True)
def _at(values: Array, place: float, out: Array) -> None:
    """Row of values at a place between two samples."""
    i = min(int(place), len(values) - 2)
    for j in range(values.shape[1]):
        out[j] = values[i, j] + (place - i) * (values[i + 1, j] - values[i, j])


@njit(cache=True)
def _outwards(pose: Array, reach: Array, most: Array) -> Array:
    """`outwards`; most (3): of positions [m], orientations and the station's axes [rad]."""
    out, width = pose.copy(), pose.shape[1]
    a, b, off = np.empty(width), np.empty(width), np.empty(width)
    for k in range(len(pose)):
        if reach[k] <= 0.0:
            continue
        _at(pose, k - reach[k], a)
        _at(pose, k + reach[k], b)
        omega, sign = great_arc(a, b)
        between(a, b, fraction(a, b, pose[k], 0.5), omega, sign, off)
        for j in range(width):
            off[j] = SHARE * (pose[k, j] - off[j])
        moved = np.sqrt(np.sum(off[:3] ** 2))
        turned = 2.0 * np.sqrt(np.sum(off[3:7] ** 2))  # a rotation is twice the angle of its quaternions
        for j in range(3):
            out[k, j] += off[j] * min(1.0, most[0] / max(moved, TINY))
        for j in range(3, 7):
            out[k, j] += off[j] * min(1.0, most[1] / max(turned, TINY))
        out[k, 3:7] /= np.sqrt(np.sum(out[k, 3:7] ** 2))
        for j in range(7, width):
            out[k, j] += min(max(off[j], -most[2]), most[2])
    return out
