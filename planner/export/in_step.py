"""When a board waits for the robot: stretches for which the output of an extruder is on, and what is due before one."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array
from planner.export.moves import fed_spans, passed
from planner.export.support import by_bead
from planner.plan.plan import filament_areas, materials_of

if TYPE_CHECKING:
    from planner.plan import Plan, Trajectory

SEEN = (
    0.05  # s for which an output must be off to be waited for: boards look at their inputs some hundred times a second
)
NEAR = 0.024  # s by which pressure is built up before a bead, and let off behind it, at most (motion.extrusion)
# A prime has ended, and the fan is switched, a little before the robot is due: no controller is ahead of its program by
# more than what zones cut off. By so much more a prime comes early.
READY, SHARE = 0.02, 0.02  # s, and of the time since what came before

HOME = ("heat", "purge", "change", "pause", "cool", "select", "retract")  # events that a prime does not move before


@dataclass(frozen=True)
class Stretch:
    """From when to when [s after the trajectory's start] an output is on, its signal and the board's input for it."""

    on: float
    off: float
    signal: str
    number: int


def stretches(plan: Plan) -> tuple[Stretch, ...]:
    """All of a plan, in order of time; those between which an output is off too shortly to be seen are one."""
    t, program = plan.trajectory, plan.problem.program
    signals = [each.signal for each in materials_of(plan.problem)] or [program.extruder_signal]
    own = by_bead(plan, signals)
    found: list[Stretch] = []
    for a, b in zip(*(ends.tolist() for ends in fed_spans(t)), strict=True):
        signal = own[int(t.bead[a])]
        on, off = float(t.t[a] - t.t[0]), float(t.t[b] - t.t[0])
        if found and found[-1].signal == signal and on - found[-1].off < SEEN:
            found[-1] = Stretch(found[-1].on, off, signal, found[-1].number)
        else:
            found.append(Stretch(on, off, signal, program.board.input + signals.index(signal)))
    return tuple(found)


def busy_ends(t: Trajectory) -> list[float]:
    """When [s after the trajectory's start] beads and the events end that a prime does not move before, in order.

    Of a bead of fibre the output goes off at its cut already: behind that the rest of it is drawn.
    """
    begin = float(t.t[0])
    beads = (t.t[np.flatnonzero(np.diff(t.deposit.astype(np.int8)) < 0)] - begin).tolist()
    return sorted([*beads, *(event.start + event.duration - begin for event in t.events if event.kind in HOME)])


def early(ends: Sequence[float], at: float, since: float) -> float:
    """By how much [s] what is due `at` a time before a bead comes earlier; the output went off at time `since`.

    ends: as `busy_ends` has them
    """
    gone = bisect_right(ends, at)
    free = max([since, *ends[gone - 1 : gone]])
    return min(READY + SHARE * (at - free), at - free)


def laid_filament(trajectory: Trajectory) -> Array:
    """Filament (n) [m] that was fed until each sample, without what events move: primes, retracts and purges."""
    moving = [event for event in trajectory.events if event.amount != 0.0]
    return trajectory.feed - trajectory.feed[0] - passed(trajectory.t, moving, [event.amount for event in moving])


def without_lag(plan: Plan) -> Array:
    """Filament (n - 1) [m] of what is laid in each sample, which the motor would feed there if flow followed at once."""
    t = plan.trajectory
    area = np.broadcast_to(np.asarray(filament_areas(plan.problem, t.events, t.t)), t.t.shape)[1:]
    out: Array = np.diff(t.extruded) / np.where(area > 0.0, area, np.inf)
    return out


def fed_within(plan: Plan, found: tuple[Stretch, ...]) -> Array:
    """Filament (k) [m] that beads take in each stretch, with the pressure that is built up before and let off behind it."""
    t = plan.trajectory
    at, laid = t.t - t.t[0], laid_filament(t)
    events = [
        sum(event.amount for event in t.events if event.amount and each.on + t.dt < event.start < each.off - t.dt)
        for each in found
    ]
    begin = np.interp([each.on - NEAR for each in found], at, laid)
    end = np.interp([each.off + NEAR for each in found], at, laid)
    out: Array = end - begin + np.array(events)
    return out
