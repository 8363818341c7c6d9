"""Where the robot stands still, for how long, and what for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from planner.readonly import Array, Flags, Indices

if TYPE_CHECKING:
    from planner.plan import Event, Trajectory


LEAST_WAIT = 0.05  # [s]; a shorter rest is no more than the turn of a motion
STILL = 1e-9  # rad that a joint moves in a sample, at most, where the robot stands still
ON_TIME = 1e-9  # s: by which an event may miss a sample and still fall on it
SLOW, SHARE = 5e-3, 0.05  # rad/s, and of the speed around: below both a motion comes to rest
AROUND = 0.1  # s
AT_HOME = ("heat", "purge", "change")  # events for which the robot rests at home
NEAR = 2.0  # samples by which a rest may seem to begin behind its event


class Wait(NamedTuple):
    """One reason to stand still, in words, and for how long [s]."""

    why: str
    time: float


@dataclass(frozen=True)
class Rests:
    """Where a trajectory (n samples) stands still.

    fine   (n,)  the motion comes to rest at this sample
    waits        sample → what it waits for there, one after the other
    inside (n,)  the robot stands still from the sample before to this one, in a wait
    clock  (n,)  time without waits [s]
    """

    fine: Flags
    waits: dict[int, tuple[Wait, ...]]
    inside: Flags
    clock: Array


def rests_of(trajectory: Trajectory, first: Indices, last: Indices) -> Rests:
    """Rests between beads as the samples show them, and those that events ask for in beads and at home.

    first, last: samples between which material is laid. Within a bead the nozzle rests only where its fibre is cut.
    """
    fine, found = _between_beads(trajectory, first, last)
    waits: dict[int, tuple[Wait, ...]] = {}
    inside = np.zeros(len(trajectory), dtype=bool)
    clock = trajectory.t - trajectory.t[0]
    for at, a, b in found:
        own = [Wait(event.words, event.duration) for event in rested_for(trajectory, a, b)]
        spare = (b - a) * trajectory.dt - sum(wait.time for wait in own)
        if spare >= LEAST_WAIT:
            own.append(Wait(_meanwhile(trajectory, a, b), spare))
        if own:
            fine[[at, a]] = False, True
            waits[a] = tuple(own)
            inside[a + 1 : b + 1] = True
            clock[a + 1 :] -= np.minimum(np.arange(1, len(clock) - a), b - a) * trajectory.dt
    for event in cuts(trajectory):
        a, b = samples_of_rest(trajectory, event)
        fine[a] = True
        waits[a] = (Wait(event.words, event.duration),)
        inside[a + 1 : b + 1] = True
        clock -= np.clip(trajectory.t - event.start, 0.0, event.duration)
    return Rests(fine, waits, inside, clock)


def cuts(trajectory: Trajectory) -> list[Event]:
    """The events for which the nozzle rests on a bead."""
    return [event for event in trajectory.events if event.kind == "cut"]


def samples_of_rest(trajectory: Trajectory, event: Event) -> tuple[int, int]:
    """First and last sample of an event that rests; the nearest one, twice, where it passes between two samples."""
    end = event.start + event.duration
    a, b = np.searchsorted(trajectory.t, [event.start - ON_TIME, end + ON_TIME])
    if a >= b:
        a = int(np.argmin(np.abs(trajectory.t - event.start)))
        return a, a
    return int(a), int(b) - 1


def rested_for(trajectory: Trajectory, a: int, b: int) -> list[Event]:
    """The events that take time for which the robot rests at home from sample a to b."""
    since, until = trajectory.t[a] - NEAR * trajectory.dt, trajectory.t[b]
    return [
        event
        for event in trajectory.events
        if event.kind in AT_HOME and event.duration > 0.0 and since <= event.start < until
    ]


def _meanwhile(trajectory: Trajectory, a: int, b: int) -> str:
    """What the extruder does while the robot stands still from sample a to b, beside what it stands still for."""
    start, end = trajectory.t[a], trajectory.t[b]
    during = [
        event.words
        for event in trajectory.events
        if event.kind not in AT_HOME and event.start < end and event.start + event.duration > start
    ]
    return "; ".join(during)


def _between_beads(trajectory: Trajectory, first: Indices, last: Indices) -> tuple[Flags, list[tuple[int, int, int]]]:
    """Samples (n) at which the robot comes to rest outside of beads; each with first and last sample of standing still.

    The exact moment of rest lies between two samples, so rest shows as a speed that is small against the speed
    0.1 s around it: a slow bead is slow everywhere, and is not mistaken for it.
    """
    n = len(trajectory)
    change = np.abs(np.diff(trajectory.q, axis=0)).max(axis=1)
    rate = np.empty(n)
    rate[1:-1] = np.abs(trajectory.q[2:] - trajectory.q[:-2]).max(axis=1) / (2.0 * trajectory.dt)
    rate[[0, -1]] = 0.0
    half = max(1, round(AROUND / trajectory.dt))
    around = _sliding_maximum(np.pad(rate, half, mode="edge"), 2 * half + 1)
    slow = (rate < SLOW) & (rate <= SHARE * around)
    edge = np.zeros(n, dtype=bool)
    edge[first], edge[last] = True, True
    slow &= edge | ~trajectory.deposit

    fine: Flags = np.zeros(n, dtype=bool)
    found: list[tuple[int, int, int]] = []
    bounds = np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8))
    for a, b in zip(np.flatnonzero(bounds > 0), np.flatnonzero(bounds < 0), strict=True):
        # a bead's own end is the better place for the stop, where there is one
        at = a + int(np.argmin(np.where(edge[a:b], -1.0, rate[a:b])))
        fine[at] = True
        still = a + np.flatnonzero(change[a : b - 1] < STILL)
        if len(still):  # and nothing is switched in between
            parts = np.concatenate([still[:1], a + np.flatnonzero(edge[a:b]), still[-1:] + 1])
            parts = np.unique(np.clip(parts, still[0], still[-1] + 1))
            longest = int(np.argmax(np.diff(parts)))
            found.append((int(at), int(parts[longest]), int(parts[longest + 1])))
    fine[[0, n - 1]] = True
    return fine, found


def _sliding_maximum(values: Array, width: int) -> Array:
    """Largest of each `width` neighbouring values (n), n - width + 1 of them."""
    out, covered = values, 1
    while covered < width:  # each step joins two windows, which may overlap
        step = min(covered, width - covered)
        out, covered = np.maximum(out[:-step], out[step:]), covered + step
    return out
