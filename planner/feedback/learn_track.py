"""Where along its plan a robot was: each sample of a recorded run matched to the planned path, in order."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.feedback.readings import LEAVES, JointCounting, check_digits, counting, near_start, readings, run_starts
from planner.feedback.recordings import RobotLog
from planner.feedback.tracking import TrackedPath, track, tracked_path
from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# A recording, read as the cell's joints.

LOST = 5e-3  # m off the plan on a bead: the recording is not of this program
GAP = 4.0  # × the median step, from which samples are missing
SEEN = 10  # samples before a gap that give the robot's speed
LEAST_GAP = 0.02  # s: shorter gaps are bridged by interpolation
COARSE = 0.02  # s: greatest sample interval; with fewer samples, corners are not seen
LEVER = 0.05  # m/rad: rotation of the nozzle counts as path length, for when the tip stands still


@dataclass(frozen=True)
class RecordedWay(ReadOnlyArrays):
    """A recorded run along a plan (m samples).

    time (m) [s];  tip (m, 3) of the executed nozzle, part frame [m];  turned (m): its axis off the plan's there [rad]
    place (m)      position along the plan, in samples of it;  off (m): distance from there [m]
    gaps (g, 2)    samples before and after each gap
    remarks        notes on how the file was read
    """

    time: Array
    tip: Array
    turned: Array
    place: Array
    off: Array
    gaps: Ints
    remarks: tuple[str, ...]


def recorded_way(plan: Plan, log: RobotLog, language: str) -> RecordedWay:
    """Match the recording of a run of a plan's program to the plan.

    language: of the program, which determines how its controller counts joints. Raises InputError that names the cause
    for any other recording: with too few samples, that never is where the program begins, or that goes elsewhere.
    """
    if log.step > COARSE:
        hint = f"at least one every {1e3 * COARSE:g} ms"
        raise InputError(f"too few samples: one every {1e3 * log.step:.3g} ms", file=log.file, hint=hint)
    counted, start = counting(plan.cell, language), plan.trajectory.q[0]
    starts = run_starts(log, plan.cell, counted, start)
    if not starts:
        raise _never_there(plan, log, counted)
    ways = [(each, way_along(plan, plan.cell, log.time, each.q, each.first)) for each in starts]
    begun, way = max(ways, key=lambda each: _gone_on(each[1]))
    check_digits(log, begun.reading, plan.cell)
    _check_followed(plan, log, way.place, way.off)
    remarks = (*begun.reading.words, *log.remarks)
    if len(way.gaps):
        lost = float(np.diff(log.time[way.gaps], axis=1).sum())
        remarks = (
            *remarks,
            f"samples are missing for {lost:.2f} s in all (gaps: {len(way.gaps)}): nothing is learned there",
        )
    return replace(way, remarks=remarks)


def _gone_on(way: RecordedWay) -> float:
    """How far along the plan a run came before departing from it, in samples."""
    left = np.flatnonzero(way.off > LEAVES)
    return float(way.place[: int(left[0]) if len(left) else None].max(initial=0.0))


def way_along(plan: Plan, cell: Cell, time: Array, q: Array, begin: int = 0) -> RecordedWay:
    """Where along a plan a robot was at times (m) [s], by its joints q (m, n) [rad, m].

    cell: the plan's, or the same with joints as its controller counts them; begin: the sample at which the run starts
    """
    t = plan.trajectory
    T = cell.T_part_nozzle(np.ascontiguousarray(q))
    tip, axis = np.ascontiguousarray(T[:, :3, 3]), np.ascontiguousarray(T[:, :3, 2])
    run, steps = nozzle_path(tip, axis), np.diff(time)
    missing = np.flatnonzero(steps > max(GAP * float(np.median(steps)), LEAST_GAP))
    gone = np.diff(run.way, prepend=0.0)
    before = np.maximum(missing - SEEN, 0)
    took = np.maximum(time[missing] - time[before], 1e-9)
    # across a gap the robot may have gone in a circle: assume that it went on at its speed
    gone[missing + 1] = np.maximum(gone[missing + 1], (run.way[missing] - run.way[before]) / took * steps[missing])
    gone[:begin] = -np.inf
    place, off = track(nozzle_path(t.tip, t.axis), run.points, gone)
    nearest = np.minimum(np.rint(place).astype(np.int64), len(t) - 1)
    turned = np.arccos(np.clip((axis * t.axis[nearest]).sum(axis=1), -1.0, 1.0))
    return RecordedWay(time, tip, turned, place, off, np.column_stack([missing, missing + 1]), ())


def nozzle_path(tip: Array, axis: Array) -> TrackedPath:
    """The path of a nozzle's tips (n, 3) [m] and axes (n, 3) in the part frame."""
    return tracked_path(np.column_stack([tip, LEVER * axis]))


def _never_there(plan: Plan, log: RobotLog, counted: JointCounting) -> InputError:
    """An error with the robot's least distance from the start of the program, however the numbers are read."""
    cell, start = plan.cell, plan.trajectory.q[0]
    best = (np.inf, 0, 0, 0.0)
    for reading in readings(log, cell.limits.sliding, counted):
        q = reading.of(log.executed)
        off = near_start(q, start, cell)
        i = int(np.argmin(off.max(axis=1)))
        j = int(np.argmax(off[i]))
        best = min(best, (float(off[i, j]), i, j, float(np.abs(q[i, j] - start[j]))))
    _, i, j, far = best
    words = f"{far * 1e3:.1f} mm" if j in cell.limits.sliding else f"{np.degrees(far):.1f} degrees"
    reason = f"the robot is never where the program begins: {cell.joint_names[j]} is {words} off at the closest"
    hint = (
        "start recording before the program does, with joints in degrees, radians or mm, and name the plan that was run"
    )
    return InputError(reason, file=log.file, line=int(log.lines[i]), hint=hint)


def _check_followed(plan: Plan, log: RobotLog, place: Array, off: Array) -> None:
    """Raise InputError for a recording that leaves the plan on a bead, or ends before the first bead does."""
    t = plan.trajectory
    at = np.minimum(np.rint(place).astype(np.int64), len(t) - 1)
    lost = np.flatnonzero(t.deposit[at] & (off > LOST))
    if len(lost):
        i = int(lost[0])
        reason = (
            f"the robot is {off[i] * 1e3:.1f} mm off the plan at bead {t.bead[at[i]]}, {t.s[at[i]] * 1e3:.1f} mm: "
            "a recording of something else"
        )
        raise InputError(reason, file=log.file, line=int(log.lines[i]), hint="name the plan whose program was run")
    ends = np.flatnonzero(t.deposit[:-1] & ~t.deposit[1:])
    if not len(ends) or place.max() < ends[0]:
        reason = "the recording ends before the first bead does"
        raise InputError(reason, file=log.file, line=int(log.lines[-1]), hint="record until the program ends")
