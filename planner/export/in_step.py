"""How a board waits for the robot: stretches in which an extruder's output is on, and what must be done before them."""

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

SEEN = 0.05  # [s] that an output must be off to be waited for: boards check their inputs some hundred times a second
NEAR = 0.024  # [s] at most in which pressure builds up before a bead, and is let off after it (motion.extrusion)
# A prime ends, and the fan is switched, a little before the robot is due: enough for a controller that is ahead of its
# program, which it can be by no more than the zones cut off.
READY, SHARE = 0.02, 0.02  # [s], plus this share of the time since the board was last busy

HOME = ("heat", "purge", "change", "pause", "cool", "select", "retract")  # events that a prime never moves ahead of


@dataclass(frozen=True)
class Stretch:
    """When [s after the trajectory's start] an output goes on and off, its signal, and the board's input for it."""

    on: float
    off: float
    signal: str
    number: int


def stretches(plan: Plan) -> tuple[Stretch, ...]:
    """All stretches of a plan in order of time; joined where the output between them is off too briefly to be seen."""
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
    """When [s after the trajectory's start] beads, and the events that a prime never moves ahead of, end; in order.

    A bead of fibre ends later than its output goes off, which is at the cut: the rest of the fibre is still drawn.
    """
    begin = float(t.t[0])
    beads = (t.t[np.flatnonzero(np.diff(t.deposit.astype(np.int8)) < 0)] - begin).tolist()
    return sorted([*beads, *(event.start + event.duration - begin for event in t.events if event.kind in HOME)])


def early(ends: Sequence[float], at: float, since: float) -> float:
    """How much earlier [s] than `at` a prime or fan order before a bead comes; the output went off at `since`.

    ends: as from `busy_ends`
    """
    gone = bisect_right(ends, at)
    free = max([since, *ends[gone - 1 : gone]])
    return min(READY + SHARE * (at - free), at - free)


def laid_filament(trajectory: Trajectory) -> Array:
    """Filament (n) [m] fed up to each sample, excluding events: primes, retracts and purges."""
    moving = [event for event in trajectory.events if event.amount != 0.0]
    return trajectory.feed - trajectory.feed[0] - passed(trajectory.t, moving, [event.amount for event in moving])


def without_lag(plan: Plan) -> Array:
    """Filament (n - 1) [m] laid in each sample: what the motor would feed there if the flow followed at once."""
    t = plan.trajectory
    area = np.broadcast_to(np.asarray(filament_areas(plan.problem, t.events, t.t)), t.t.shape)[1:]
    out: Array = np.diff(t.extruded) / np.where(area > 0.0, area, np.inf)
    return out


def fed_within(plan: Plan, found: tuple[Stretch, ...]) -> Array:
    """Filament (k) [m] of each stretch, with what builds up pressure just before it and lets it off just after it."""
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
