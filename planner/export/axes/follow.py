"""The plan's motion as a machine makes it: its axes at every sample, or where and why it cannot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from planner.export.axes.choice import chosen, missing
from planner.export.axes.machine import FiveAxes, Machine, Robot, machine_of
from planner.export.rotations import continuous, slerp
from planner.readonly import Array, Flags, Indices

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem.machine import MachineSpec


FINEST = np.radians(2.0)  # that an axis turns between two samples: poses between them are added where it turns more
MOST_ADDED = 60  # between two samples, each time
ROUNDS = 2  # of adding
OFF, LEANING = 0.05e-3, np.radians(0.1)  # m, rad by which the tip may miss its path between two samples


@dataclass(frozen=True)
class Followed:
    """Motion of a machine (n samples, at least the plan's).

    t                   (n)     since the trajectory began [s]
    tip, quat           (n, 3), (n, 4) in the part
    feed                (n)     filament pushed since the start [m]
    laid                (n)     material flows
    straight, angles    (n, 3), (n, k) X Y Z [m] and the axes that turn [rad], all turns kept
    station             (n, e)  what moves a robot's part [rad]
    sample              (n)     the plan's own sample, or the last one before it
    """

    machine: Machine
    t: Array
    tip: Array
    quat: Array
    feed: Array
    laid: Flags
    straight: Array
    angles: Array
    station: Array
    sample: Indices

    def __len__(self) -> int:
        return len(self.t)


def spec_of(plan: Plan) -> MachineSpec:
    """The machine that the problem describes; ValueError where it describes none, a mistake of the caller's."""
    spec = plan.problem.program.machine
    if spec is None:
        raise ValueError("the problem describes no machine")
    return spec


def follow(plan: Plan) -> Followed:
    """A plan as the machine of `program.machine` makes it; InputError with bead and place where it cannot.

    A machine of five axes has another home than the robot: it stands still above the first bead while the robot
    comes from home, and above the last one while it goes there.
    """
    t, spec = plan.trajectory, spec_of(plan)
    machine = machine_of(spec)
    tip, quat = t.tip.copy(), continuous(t.quat)
    station = np.empty((len(t), 0))
    if isinstance(machine, Robot):
        station = t.q[:, len(plan.cell.arm) :]
    else:
        first, last = above(plan)
        tip[:first], quat[:first], tip[last:], quat[last:] = tip[first], quat[first], tip[last], quat[last]
    empty = np.empty((len(t), 0))
    now = Followed(
        machine, t.t - t.t[0], tip, quat, t.feed - t.feed[0], t.deposit, empty, empty, station, np.arange(len(t))
    )
    for _ in range(ROUNDS):
        now = _turned(plan, now)
        most = np.abs(np.diff(now.angles, axis=0)).max(axis=1)
        parts = np.clip(np.ceil(most / FINEST), 1, MOST_ADDED).astype(np.intp)
        if (parts == 1).all():
            break
        now = _finer(now, parts)
    else:
        now = _turned(plan, now)
    now = replace(now, straight=machine.straight(now.tip, now.angles))
    _check_slides(plan, now)
    _check_between(plan, now)
    return now


def above(plan: Plan) -> tuple[int, int]:
    """Samples where the nozzle first, and last, is as high above the print as it travels."""
    t, process = plan.trajectory, plan.problem.process
    laid = np.flatnonzero(t.deposit)
    high = process.lift + process.run_in
    before = np.flatnonzero(np.linalg.norm(t.tip[: laid[0]] - t.tip[laid[0]], axis=1) >= high)
    after = np.flatnonzero(np.linalg.norm(t.tip[laid[-1] :] - t.tip[laid[-1]], axis=1) >= high)
    first = int(before[-1]) if len(before) else 0
    return first, int(laid[-1] + after[0]) if len(after) else len(t) - 1


def _turned(plan: Plan, now: Followed) -> Followed:
    """The same with its axes' angles chosen."""
    ways = now.machine.ways(now.quat)
    if len(lost := missing(ways, now.machine)):
        i = int(lost[0])
        why = "no angles of its axes give the nozzle's direction"
        if ways.reached[i]:
            both = ["/".join(f"{np.degrees(v):.2f}" for v in way) for way in ways.angles[i]]
            why = (
                f"{'/'.join(now.machine.letters)} would have to stand at {' or '.join(both)} degrees, beyond range_deg"
            )
        raise plan.problem.error("program.machine", f"{where(plan, int(now.sample[i]))}: {why}")
    return replace(now, angles=chosen(ways, now.machine, now.t, now.laid, now.quat))


def _finer(now: Followed, parts: Indices) -> Followed:
    """Poses added, so that each interval becomes `parts` (n - 1) of them."""
    a = np.append(np.repeat(np.arange(len(parts)), parts), len(parts))
    u = np.append((np.arange(len(a) - 1) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[a[:-1]], 0.0)
    b = np.minimum(a + 1, len(parts))

    def between(values: Array) -> Array:
        w = u if values.ndim == 1 else u[:, None]
        out: Array = np.where(w == 0.0, values[a], values[a] + w * (values[b] - values[a]))
        return out

    return replace(
        now,
        t=between(now.t),
        tip=between(now.tip),
        quat=np.where(u[:, None] == 0.0, now.quat[a], slerp(now.quat[a], now.quat[b], u)),
        feed=between(now.feed),
        laid=now.laid[a] & (now.laid[b] | (u == 0.0)),
        station=between(now.station),
        sample=now.sample[a],
    )


def _check_slides(plan: Plan, now: Followed) -> None:
    """Raise the InputError of a place where X, Y or Z would have to go beyond the machine's limits."""
    machine = now.machine
    if not isinstance(machine, FiveAxes):
        return
    slides = machine.slides(now.tip, now.angles)
    beyond = (slides < machine.least) | (slides > machine.greatest)
    wrong = np.flatnonzero(beyond.any(axis=1))
    if len(wrong):
        i = int(wrong[0])
        j = int(np.argmax(beyond[i]))
        low, high = machine.least[j] * 1e3, machine.greatest[j] * 1e3
        reason = f"{'XYZ'[j]} would have to stand at {slides[i, j] * 1e3:.2f} mm, its limits are {low:g} and {high:g}"
        raise plan.problem.error("program.machine", f"{where(plan, int(now.sample[i]))}: {reason}")


def _check_between(plan: Plan, now: Followed) -> None:
    """Raise the InputError of a place where the axes, moving evenly, take the nozzle elsewhere between two samples."""
    halves = [0.5 * (values[1:] + values[:-1]) for values in (now.straight, now.angles, now.tip)]
    off = np.linalg.norm(now.machine.tip(halves[0], halves[1]) - halves[2], axis=1)
    quat = slerp(now.quat[:-1], now.quat[1:], np.full(len(off), 0.5))
    lean = now.machine.leaning(halves[1], quat)
    wrong = np.flatnonzero((off > OFF) | (lean > LEANING))
    if len(wrong):
        i = int(wrong[0])
        j = int(np.argmax(np.abs(now.angles[i + 1] - now.angles[i])))
        a, b = np.degrees(now.angles[i : i + 2, j])
        reason = f"{now.machine.letters[j]} would have to turn from {a:.1f} to {b:.1f} degrees at one place"
        hint = "another part_rpy_deg takes the print away from where the axis is free; a wider range_deg may do"
        raise plan.problem.error("program.machine", f"{where(plan, int(now.sample[i]))}: {reason}", hint)


def where(plan: Plan, sample: int) -> str:
    """A sample's place in words."""
    t = plan.trajectory
    if t.bead[sample] >= 0:
        return f"bead {t.bead[sample]}, {t.s[sample] * 1e3:.1f} mm along it"
    later = t.bead[sample:][t.bead[sample:] >= 0]
    return f"on the way to bead {later[0]}" if len(later) else "on the way from the last bead"
