"""Which of both ways, and of all whole turns, an orientation is reached by: chosen over the whole print at once."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numba import njit

from planner.export.axes.machine import Machine, Ways
from planner.readonly import Array, Flags, Indices

TURN = 2.0 * np.pi
JUMP = np.radians(10.0)  # between two samples: more than that is another way, not a motion
DEAR = 1000.0  # times its angle a jump costs while material is laid
FROM_ZERO = 1e-3  # rad of motion that a radian from zero costs at the start


def candidates(angles: Array, ranges: Sequence[tuple[float, float] | None]) -> Array:
    """Angles (n, c, k) within the ranges that stand for both ways (n, 2, k), NaN where there is none."""
    found = []
    turns = [range(1 if each is None else int((each[1] - each[0]) / TURN) + 1) for each in ranges]
    for way, *turn in itertools.product((0, 1), *turns):
        own = angles[:, way].copy()
        for j, within in enumerate(ranges):
            if within is not None:
                own[:, j] += TURN * (np.ceil((within[0] - own[:, j]) / TURN) + turn[j])
                own[own[:, j] > within[1], j] = np.nan
        own[np.isnan(own).any(axis=1)] = np.nan
        found.append(own)
    return np.stack(found, axis=1)


def missing(ways: Ways, machine: Machine) -> Indices:
    """Samples that no angles within the machine's ranges give."""
    reachable = ~np.isnan(candidates(ways.angles, machine.ranges)[:, :, 0]).all(axis=1)
    # where an axis is free it need not stand where the formula has it, but the others must
    bound = tuple(None if j == machine.loose else each for j, each in enumerate(machine.ranges))
    loosely = ~np.isnan(candidates(ways.angles, bound)[:, :, 0]).all(axis=1)
    return np.flatnonzero(~(ways.reached & np.where(ways.free, loosely, reachable)))


def chosen(ways: Ways, machine: Machine, t: Array, laid: Flags, quat: Array) -> Array:
    """Angles (n, k) of the machine's axes that turn least over samples at times t (n), none of them missing.

    Whole turns are kept: no angle leaps from one end of a turn to the other. While material is laid, axes change
    their way only where nothing else is left. Where an axis is free it moves evenly from what is asked before to what
    is asked after.
    """
    bound = np.flatnonzero(~ways.free)
    angles = np.zeros((len(t), len(machine.letters)))
    if len(bound):
        table = candidates(ways.angles[bound], machine.ranges)
        endless = np.array([each is None for each in machine.ranges])
        pick = _cheapest(np.ascontiguousarray(table), endless, laid[bound])
        own = table[np.arange(len(bound)), pick]
        own[:, endless] = np.unwrap(own[:, endless], axis=0)
        for j in range(angles.shape[1]):
            angles[:, j] = np.interp(t, t[bound], own[:, j])
    else:
        for j, within in enumerate(machine.ranges):
            angles[:, j] = 0.0 if within is None else np.clip(0.0, *within)
    free = np.flatnonzero(ways.free)
    if len(free):
        settled = machine.settled(angles[free], quat[free])
        settled += TURN * np.round((angles[free] - settled) / TURN)
        angles[free] = settled
    return angles


@njit(cache=True)
def _cheapest(table: Array, endless: Flags, laid: Flags) -> Indices:
    """Which candidate (n) of each sample lies on the way that turns least."""
    n, count, axes = table.shape
    before = np.full((n, count), -1, dtype=np.int16)
    cost = np.full(count, np.inf)
    for s in range(count):
        if not np.isnan(table[0, s, 0]):
            cost[s] = 0.0
            for j in range(axes):
                cost[s] += FROM_ZERO * abs(table[0, s, j])
    for i in range(1, n):
        best = np.full(count, np.inf)
        for s in range(count):
            if np.isnan(table[i, s, 0]):
                continue
            for r in range(count):
                if not cost[r] < best[s]:
                    continue
                step, largest = 0.0, 0.0
                for j in range(axes):
                    d = table[i, s, j] - table[i - 1, r, j]
                    if endless[j]:
                        d -= TURN * np.rint(d / TURN)
                    step += abs(d)
                    largest = max(largest, abs(d))
                if largest > JUMP and laid[i] and laid[i - 1]:
                    step *= DEAR
                if cost[r] + step < best[s]:
                    best[s] = cost[r] + step
                    before[i, s] = r
        cost = best
    out = np.empty(n, dtype=np.intp)
    out[n - 1] = np.argmin(cost)
    for i in range(n - 1, 0, -1):
        out[i - 1] = before[i, out[i]]
    return out
