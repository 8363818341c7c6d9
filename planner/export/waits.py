"""Whether a program that was read back stands still where its plan does, and for as long."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.export.program import Program
from planner.export.rests import LEAST_WAIT, ON_TIME, STILL, cuts, rested_for, samples_of_rest
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan, Trajectory


PLACE = 0.05e-3  # m between the nozzle's tip and the target at which it waits
DOUBT = 2.0  # samples: so well do they tell how long a rest lasts, where no event does


def waits_differ(plan: Plan, program: Program) -> float:
    """Longest time [s] by which a wait of the program is longer or shorter than the plan's.

    inf where the number of waits, their order or their places differ, where the robot would not come to rest for one,
    or where it does not come to rest on a straight line where fibre is cut.
    """
    t = plan.trajectory
    rests = [*_before_and_between_beads(t), *((event.start, event.duration, 0.0) for event in cuts(t))]
    planned = sorted(rest for rest in rests if rest[1] > 0.0)
    written = np.flatnonzero(program.wait > 0.0)
    if len(planned) != len(written) or not program.fine[written].all():
        return float("inf")
    worst = 0.0
    for (start, duration, doubt), i in zip(planned, written.tolist(), strict=True):
        tip = t.tip[min(int(np.searchsorted(t.t, start - ON_TIME)), len(t) - 1)]
        if np.linalg.norm(program.position[i] - tip) > PLACE:
            return float("inf")
        worst = max(worst, abs(float(program.wait[i]) - duration) - doubt)
    for event in cuts(t):
        tip = t.tip[samples_of_rest(t, event)[0]]
        there = np.linalg.norm(program.position - tip, axis=1) <= PLACE
        if not (there & program.fine & program.linear).any():
            return float("inf")
    return worst


def moving_time(t: Trajectory) -> Array:
    """Time (n) [s] of every sample without the rests within beads."""
    clock = t.t - t.t[0]
    for event in cuts(t):
        clock -= np.clip(t.t - event.start, 0.0, event.duration)
    return clock


def _before_and_between_beads(t: Trajectory) -> list[tuple[float, float, float]]:
    """Start, duration and doubt [s] of each time that the robot stands still while nothing is laid."""
    still = (np.abs(np.diff(t.q, axis=0)).max(axis=1) < STILL) & ~(t.deposit[1:] & t.deposit[:-1])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    found = []
    for a, b in edges.reshape(-1, 2).tolist():
        lasts = (b - a) * t.dt
        known = sum(event.duration for event in rested_for(t, a, b))
        if known > 0.0 and abs(lasts - known) < LEAST_WAIT:
            found.append((float(t.t[a] - t.t[0]), known, 0.0))
        elif lasts >= LEAST_WAIT:
            found.append((float(t.t[a]), lasts, DOUBT * t.dt))
    return found
