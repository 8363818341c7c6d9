"""From samples to lines of G-code: the fewest targets between which axes that move evenly keep the tip on its path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.export.axes.follow import Followed
from planner.export.moves import ANGLE_TOLERANCE, ROUNDING, TIME_TOLERANCE, nearest_fraction
from planner.export.rests import ON_TIME
from planner.export.thinning import Indices, by_samples, thin
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


FILAMENT_TOLERANCE = 5e-6  # m of filament that a line may be ahead or behind
STILL = 1e-7  # m, rad by which nothing moves


def kept(plan: Plan, motion: Followed, due: Array) -> Indices:
    """Samples of the motion that become targets, the first and the last among them.

    due: times [s] at which something else is said between lines.
    """
    n = len(motion)
    must = np.zeros(n, dtype=bool)
    must[[0, n - 1]] = True
    edge = np.flatnonzero(np.diff(motion.laid.astype(np.int8)))
    must[edge] = must[edge + 1] = True
    bead = plan.trajectory.bead[motion.sample]
    must[1:] |= (np.diff(bead) != 0) & motion.laid[1:] & motion.laid[:-1]
    moved = np.column_stack([motion.tip, motion.straight, motion.angles, motion.station])
    still = (np.abs(np.diff(moved, axis=0)) < STILL).all(axis=1)
    change = np.flatnonzero(np.diff(still.astype(np.int8))) + 1
    must[change] = True
    must[np.minimum(np.searchsorted(motion.t, due - ON_TIME), n - 1)] = True
    for event in plan.trajectory.events:
        if event.amount:
            ends = np.array([event.start, event.start + event.duration]) - plan.trajectory.t[0]
            must[np.minimum(np.searchsorted(motion.t, ends - ON_TIME), n - 1)] = True
    return thin(np.flatnonzero(must), by_samples(_Misfit(plan, motion)))


class _Misfit:
    """How far even motion of all axes between two samples misses a third, in tolerances."""

    def __init__(self, plan: Plan, motion: Followed) -> None:
        self._m = motion
        self._chord = plan.problem.program.chord - ROUNDING

    def __call__(self, a: Indices, b: Indices, k: Indices) -> Array:
        m = self._m
        share = (m.t[k] - m.t[a]) / (m.t[b] - m.t[a])
        u = nearest_fraction(m.tip[a], m.tip[b], m.tip[k], share)

        def between(values: Array, w: Array) -> Array:
            w = w if values.ndim == 1 else w[:, None]
            out: Array = values[a] + w * (values[b] - values[a])
            return out

        angles = between(m.angles, u)
        tip = m.machine.tip(between(m.straight, u), angles)
        worst = np.linalg.norm(tip - m.tip[k], axis=1) / self._chord
        worst = np.maximum(worst, m.machine.leaning(angles, m.quat[k]) / ANGLE_TOLERANCE)
        worst = np.maximum(worst, np.abs(between(m.feed, u) - m.feed[k]) / FILAMENT_TOLERANCE)
        late = np.where(m.laid[k], np.abs(share - u) * (m.t[b] - m.t[a]) / TIME_TOLERANCE, 0.0)
        worst = np.maximum(worst, late)
        for e in m.station.T:
            worst = np.maximum(worst, np.abs(between(e, u) - e[k]) / ANGLE_TOLERANCE)
        return worst
