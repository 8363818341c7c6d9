"""Where along its plan a robot was: each sample of a recorded run against the planned path, in order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.compiled import njit
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.feedback.identify_log import RobotLog
from planner.feedback.identify_program import counting
from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# A recording, read as the cell's joints.

AT_START = np.radians(0.5)  # of each joint, or 1 mm where it slides: the robot is where the program begins
AT_START_SLIDING = 1e-3  # m
LOST = 5e-3  # m off the plan on a bead: it is another program's, or no program's
GAP = 4.0  # times the usual step, from which samples are missing
SEEN = 10  # samples before a gap, by which it is told how fast the robot was
LEAST_GAP = 0.02  # s: what is missing for less is known from both sides
COARSE = 0.02  # s between samples at most: with fewer, corners are not seen
DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class RecordedWay(ReadOnlyArrays):
    """A recorded run along a plan (m samples).

    time (m) [s];  tip (m, 3) of the executed nozzle, part frame [m];  turned (m): its axis off the plan's there [rad]
    place (m)      where along the plan, in samples of it;  off (m): how far from there [m]
    gaps (g, 2)    samples before and behind what is missing
    remarks        how the file was read, in words
    """

    time: Array
    tip: Array
    turned: Array
    place: Array
    off: Array
    gaps: Ints
    remarks: tuple[str, ...]


def recorded_way(plan: Plan, log: RobotLog, language: str) -> RecordedWay:
    """The recording of a run of a plan's program, held against the plan.

    language: of the program, by which its controller counts joints. Raises InputError with what was found for what is no
    such recording: too few samples, one that never is where the program begins, one that goes elsewhere.
    """
    if log.step > COARSE:
        hint = f"at least one every {1e3 * COARSE:g} ms"
        raise InputError(f"too few samples: one every {1e3 * log.step:.3g} ms", file=log.file, hint=hint)
    q, begin, remarks = _read_as(plan, log, language)
    way = way_along(plan, plan.cell, log.time, q, begin)
    _check_followed(plan, log, way.place, way.off)
    if len(way.gaps):
        lost = float(np.diff(log.time[way.gaps], axis=1).sum())
        remarks = (
            *remarks,
            f"samples are missing for {lost:.2f} s in all (gaps: {len(way.gaps)}): nothing is learned there",
        )
    return replace(way, remarks=remarks)


def way_along(plan: Plan, cell: Cell, time: Array, q: Array, begin: int = 0) -> RecordedWay:
    """Where along a plan a robot was at times (m) [s], by its joints q (m, n) [rad, m].

    cell: the plan's, or the same as its controller counts joints; begin: the sample at which the robot sets out
    """
    t = plan.trajectory
    T = cell.T_part_nozzle(np.ascontiguousarray(q))
    tip, axis = np.ascontiguousarray(T[:, :3, 3]), np.ascontiguousarray(T[:, :3, 2])
    run, steps = planned_way(tip, axis), np.diff(time)
    missing = np.flatnonzero(steps > max(GAP * float(np.median(steps)), LEAST_GAP))
    gone = np.diff(run.way, prepend=0.0)
    before = np.maximum(missing - SEEN, 0)
    took = np.maximum(time[missing] - time[before], 1e-9)
    # across a gap the robot may have gone round in a circle: it is taken to have gone on at its speed
    gone[missing + 1] = np.maximum(gone[missing + 1], (run.way[missing] - run.way[before]) / took * steps[missing])
    gone[:begin] = -np.inf
    place, off = track(planned_way(t.tip, t.axis), run.points, gone)
    nearest = np.minimum(np.rint(place).astype(np.int64), len(t) - 1)
    turned = np.arccos(np.clip((axis * t.axis[nearest]).sum(axis=1), -1.0, 1.0))
    return RecordedWay(time, tip, turned, place, off, np.column_stack([missing, missing + 1]), ())


def _read_as(plan: Plan, log: RobotLog, language: str) -> tuple[Array, int, tuple[str, ...]]:
    """Joints (m, n) [rad, m] of a recording, the sample at which the robot leaves the program's start, and how it was read.

    Raises InputError where the robot never is there, however the numbers are read.
    """
    start, best = plan.trajectory.q[0], (np.inf, 0, 0)
    near = np.full(len(start), AT_START)
    near[list(plan.cell.limits.sliding)] = AT_START_SLIDING
    for q, remarks in _readings(plan.cell, log, language):
        off = np.abs(q - start) / near
        there = off.max(axis=1) <= 1.0
        if there.any():
            first = int(np.argmax(there))
            left = np.flatnonzero(~there[first:])
            return q, first + (int(left[0]) - 1 if len(left) else len(q) - first - 1), remarks
        i = int(np.argmin(off.max(axis=1)))
        best = min(best, (float(off[i].max()), i, int(np.argmax(off[i]))))
    times, i, j = best
    far = times * near[j]
    sliding = j in plan.cell.limits.sliding
    words = f"{far * 1e3:.1f} mm" if sliding else f"{np.degrees(far):.1f} degrees"
    reason = (
        f"the robot never is where the program begins: {plan.cell.joint_names[j]} is {words} off when it is nearest"
    )
    hint = "record from before the program starts, joints in degrees, radians or mm, the plan that was run"
    raise InputError(reason, file=log.file, line=int(log.lines[i]), hint=hint)


def _readings(cell: Cell, log: RobotLog, language: str) -> Iterator[tuple[Array, tuple[str, ...]]]:
    """Ways to read a file's numbers as joints (m, n) [rad, m]: in degrees, in radians, counted by us or by the controller."""
    _, signs, offsets = counting(cell, language)
    sliding = np.zeros(len(signs), dtype=bool)
    sliding[list(cell.limits.sliding)] = True
    own = bool((signs != 1.0).any() or (offsets != 0.0).any())
    for turning, slide in ((DEGREE, 1e-3), (1.0, 1.0)):
        unit = np.where(np.isnan(log.unit), np.where(sliding, slide, turning), log.unit)
        told = () if not np.isnan(log.unit[~sliding]).any() else (
            f"joints read in {'degrees' if turning == DEGREE else 'radians'}: the file does not say",
        )  # fmt: skip
        yield log.executed * unit, told
        if own:
            yield (log.executed * unit - offsets) * signs, (*told, "joints counted as the controller does")


def _check_followed(plan: Plan, log: RobotLog, place: Array, off: Array) -> None:
    """Raise InputError for a recording that leaves the plan on a bead, or never comes to the end of one."""
    t = plan.trajectory
    at = np.minimum(np.rint(place).astype(np.int64), len(t) - 1)
    lost = np.flatnonzero(t.deposit[at] & (off > LOST))
    if len(lost):
        i = int(lost[0])
        reason = (
            f"the robot is {off[i] * 1e3:.1f} mm off the plan at bead {t.bead[at[i]]}, {t.s[at[i]] * 1e3:.1f} mm: "
            "a recording of something else"
        )
        raise InputError(reason, file=log.file, line=int(log.lines[i]), hint="the plan whose program was run")
    ends = np.flatnonzero(t.deposit[:-1] & ~t.deposit[1:])
    if not len(ends) or place.max() < ends[0]:
        reason = "the recording ends before the first bead does"
        raise InputError(reason, file=log.file, line=int(log.lines[-1]), hint="record until the program ends")


# ----------------------------------------------------------------------------------------------------
# Places along the plan.

LEVER = 0.05  # m/rad: turning of the nozzle counts as way, where the tip stands still
AHEAD = 25e-3  # m of planned way in which the next place is sought: beyond corners that a controller cuts in travel
BACK = 0.3e-3  # m by which a place may lie before the last one: noise
# Price of going on by more or less than the robot did, over the square of that: it decides where lines lie beside each
# other. 20 mm of way count as 1 mm of distance.
ASTRAY = 0.05**2


class PlannedWay(NamedTuple):
    """What a run is held against (n samples): points (n, 6) of tip and LEVER times axis [m], way (n) up to each [m]."""

    points: Array
    way: Array


def planned_way(tip: Array, axis: Array) -> PlannedWay:
    """The way of a nozzle's tips (n, 3) [m] and axes (n, 3) in the part frame."""
    points = np.column_stack([tip, LEVER * axis])
    return PlannedWay(points, np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]))


def track(plan: PlannedWay, points: Array, gone: Array) -> tuple[Array, Array]:
    """Place (m) of each sample of a run along the plan, in samples, and its distance from there (m) [m]. Linear in both.

    points (m, 6) as the plan's; gone (m): how far the robot went on since the sample before [m], -inf where it is at the
    start of the plan
    """
    return _track(plan, points, gone)


@njit(cache=True)
def _track(plan: PlannedWay, run: Array, gone: Array) -> tuple[Array, Array]:
    points, way = plan.points, plan.way
    m, n, d = len(run), len(points), points.shape[1]
    place, off = np.zeros(m), np.zeros(m)
    at = 0.0  # the way behind the robot
    first = 0  # segment from which on places are sought
    for i in range(m):
        rests = gone[i] < 0.0
        while first < n - 2 and way[first + 1] < at - BACK:
            first += 1
        best, found, where = np.inf, 0.0, at
        k = first
        while k < n - 1:
            if k > first and (rests or way[k] > at + AHEAD + 2.0 * gone[i]):
                break
            dot, square = 0.0, 0.0
            for j in range(d):
                step = points[k + 1, j] - points[k, j]
                dot += step * (run[i, j] - points[k, j])
                square += step * step
            u = 0.0
            if square > 0.0 and not rests:
                u = min(max(dot / square, 0.0), 1.0)
            distance = 0.0
            for j in range(d):
                gap = points[k, j] + u * (points[k + 1, j] - points[k, j]) - run[i, j]
                distance += gap * gap
            there = way[k] + u * (way[k + 1] - way[k])
            price = distance
            if not rests:
                price += ASTRAY * (there - at - gone[i]) ** 2
            if price < best:
                best, found, where = price, k + u, there
                off[i] = np.sqrt(distance)
            k += 1
        place[i] = found
        at = max(at, where)
    return place, off
