"""What would help most: changes that a user could make, each planned on some slow beads and reported with its effect.

A change is tried with the search, refinement and timing of the plan itself, but only on the beads with most length
below speed, as far as that is cheap: each trial of the whole print would take as long as the plan. The effect reported
for the whole print is therefore that of these beads alone. Another speed is tried along the same joint paths. Clearance
is that of the print as planned; only a new plan shows the effect on travel and the outcome of verification.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.motion.timing.timed_path import TimedPath, time_path
from planner.plan import Advice, Dip, Trajectory
from planner.planning.candidates import SPEED_PRICE
from planner.planning.context import PlanningContext
from planner.problem import Problem
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.sqp import refine_paths
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of
from planner.verify.checks import SPEED_TOLERANCE

SHARE = 0.08  # greatest share of the print's waypoints that each change is tried on
LEAST = 400  # waypoints that may be tried whatever their share: they take next to no time
SLOWER = 0.75  # × the commanded speed
CORNER = 0.5  # × a bead's width: the widest corner tolerance
LEAN = math.radians(5.0)
WIDEST_CORNER = 1e-3  # m, whatever the bead's width
STEP = 4e-3  # s between the instants at which a timed bead is judged
GAIN = 2e-3  # least gain that is reported, in share of the print's length at speed
_ROUNDING = 1e-12  # m, rad
_EVERY = 4  # of many slow beads, one in so many is tried first
_MANY = 16  # beads from which on they count as many
_PROMISING = 0.5  # × GAIN: least gain that these few must promise for all slow beads to be tried


@dataclass(frozen=True)
class SpeedTotals:
    """Beads in time: length at the commanded speed, total length [m], and how long they take [s]."""

    at_speed: float
    length: float
    time: float

    @property
    def slow(self) -> float:
        """Length below speed [m]."""
        return self.length - self.at_speed

    @property
    def share(self) -> float:
        """Share of the length at speed."""
        return self.at_speed / self.length if self.length else 1.0


@dataclass(frozen=True)
class Changed:
    """A change of one field: its kind, the field, its value as in the file, and the changed problem."""

    kind: str
    field: str
    value: float
    problem: Problem


def advise(
    given: PlanningContext, paths: Sequence[JointPath], trajectory: Trajectory, dips: Sequence[Dip]
) -> tuple[Advice, ...]:
    """Changes within bounds that raise the print's length at speed, those with the lowest cost for their gain first.

    None if nothing is slow, or if all slow beads are too large to try.
    given: what was planned; paths: those of its beads, in order; trajectory: along these
    """
    commanded = np.array([path.task.speed for path in paths])
    whole = recorded(trajectory, commanded, range(len(paths)))
    below = below_speed(trajectory, commanded)
    worst = worst_beads(paths, {bead: float(below[bead]) for bead in sorted({dip.bead for dip in dips})})
    if not worst:
        return ()
    now = recorded(trajectory, commanded, worst)
    found = []
    for change in changes(given.problem):
        trial = _trial(given, change, paths)
        if len(worst) >= _MANY:
            first = worst[::_EVERY]
            tried, before = trial(first), recorded(trajectory, commanded, first)
            if tried is None or not promises(before, tried, now, whole):
                continue
        tried = trial(worst)
        if tried is None:
            continue
        share = (whole.at_speed - now.at_speed + tried.at_speed) / (whole.length - now.length + tried.length)
        if share < whole.share + GAIN:
            continue
        others = whole.time * (given.problem.process.speed / change.problem.process.speed - 1.0)
        others *= 1.0 - now.time / whole.time
        advice = Advice(
            kind=change.kind,
            field=change.field,
            value=change.value,
            beads=tuple(worst),
            covered=min(now.slow / whole.slow, 1.0),
            share_now=now.share,
            share=tried.share,
            time_now=now.time,
            time=tried.time,
            whole_now=whole.share,
            whole=share,
            seconds=tried.time - now.time + others,
        )
        price = (whole.time + advice.seconds) * (1.0 + SPEED_PRICE * (1.0 - share))
        found.append((price, advice))
    return tuple(advice for _, advice in sorted(found, key=lambda each: each[0]))


def promises(before: SpeedTotals, tried: SpeedTotals, now: SpeedTotals, whole: SpeedTotals) -> bool:
    """Whether a change is worth trying on all slow beads, judged by its effect on a few of them.

    before, tried: these few, as planned and with the change; now: all slow beads as planned; whole: the print.
    """
    return (tried.share - before.share) * now.length >= _PROMISING * GAIN * whole.length


def recorded(trajectory: Trajectory, commanded: Array, beads: Sequence[int]) -> SpeedTotals:
    """Totals of some beads as a trajectory lays them, without rests; commanded: speeds of all beads [m/s]."""
    t = trajectory
    own = t.deposit & np.isin(t.bead, list(beads))
    speed = t.speed[own]
    fast = speed >= (1.0 - SPEED_TOLERANCE) * commanded[t.bead[own]]
    return SpeedTotals(float(speed[fast].sum()) * t.dt, float(speed.sum()) * t.dt, np.count_nonzero(speed) * t.dt)


def below_speed(trajectory: Trajectory, commanded: Array) -> Array:
    """Length (beads) of each bead that a trajectory lays below its commanded speed [m]; commanded: speeds [m/s]."""
    t = trajectory
    own = t.deposit & (t.bead >= 0)
    bead, speed = t.bead[own], t.speed[own]
    slow = speed < (1.0 - SPEED_TOLERANCE) * commanded[bead]
    return np.asarray(np.bincount(bead[slow], speed[slow], minlength=len(commanded)) * t.dt)


def worst_beads(paths: Sequence[JointPath], slow: Mapping[int, float]) -> list[int]:
    """Indices of the beads with most length below speed, as many as may be tried, in order of the print.

    slow: that length [m], by bead. Beads that are too large are left out: length at speed counts the same on any bead.
    """
    left = max(SHARE * sum(len(path.q) for path in paths), LEAST)
    out = []
    for bead in sorted(slow, key=lambda i: (-slow[i], i)):
        if slow[bead] > 0.0 and len(paths[bead].q) <= left:
            left -= len(paths[bead].q)
            out.append(bead)
    return sorted(out)


def changes(problem: Problem) -> Iterator[Changed]:
    """What a user could change, one at a time: rounder corners, a leaning nozzle, or a lower speed."""
    process = problem.process
    # in hundredths of a millimetre, as a user would write it
    widest = math.floor(min(CORNER * process.bead.width, WIDEST_CORNER) * 1e5 + _ROUNDING) * 1e-5
    if widest > process.corner_tolerance + _ROUNDING:
        changed = process.model_copy(update={"corner_tolerance": widest})
        yield _change(problem, "corner_tolerance", "process.corner_tolerance_mm", widest * 1e3, changed)
    if process.cones.tilt + _ROUNDING < LEAN:
        changed = process.model_copy(update={"cones": process.cones.model_copy(update={"tilt": LEAN})})
        yield _change(problem, "lean", "process.cones.nozzle_normal_deg", math.degrees(LEAN), changed)
    if not process.speeds and process.layer_time is None:  # beads with speeds of their own would keep them
        speed = SLOWER * process.speed
        yield _change(problem, "speed", "process.speed_mm_s", speed * 1e3, process.model_copy(update={"speed": speed}))


def _change(problem: Problem, kind: str, field: str, value: float, process: object) -> Changed:
    return Changed(kind, field, float(f"{value:.4g}"), problem.model_copy(update={"process": process}))


def _trial(
    given: PlanningContext, change: Changed, paths: Sequence[JointPath]
) -> Callable[[Sequence[int]], SpeedTotals | None]:
    """A function that plans some beads with a change and gives their totals; None if they have no way, or if the change
    makes other beads of them. At another speed the joints keep to their paths."""
    problem = change.problem
    toolpath = given.toolpath
    if change.kind == "corner_tolerance":
        try:
            toolpath = build_toolpath(problem)
        except InputError:
            return lambda _: None
        if len(toolpath.beads) != len(given.toolpath.beads):
            return lambda _: None
        both = zip(toolpath.beads, given.toolpath.beads, strict=True)
        toolpath = replace(toolpath, beads=tuple(replace(new, short_runs=bead.short_runs) for new, bead in both))

    def at_speed(beads: Sequence[int]) -> SpeedTotals:
        speed = problem.process.speed
        same = [replace(paths[i], task=replace(paths[i].task, speed=speed)) for i in beads]
        return _laid(replace(given, problem=problem), same)

    def planned(beads: Sequence[int]) -> SpeedTotals | None:
        few = replace(toolpath, beads=tuple(toolpath.beads[i] for i in beads))
        try:
            some = [replace(task, bead=i) for i, task in zip(beads, tasks_of(problem, few), strict=True)]
            start = ladder(given.cell, some, problem.resolve, given.obstacles)
            found = refine_paths(given.cell, start, problem.resolve, given.obstacles, given.terms)
        except (Refusal, InputError):
            return None
        return _laid(replace(given, problem=problem), found)

    return at_speed if change.kind == "speed" else planned


def _laid(given: PlanningContext, paths: Sequence[JointPath]) -> SpeedTotals:
    """Time the beads, and judge them every few milliseconds."""
    process = given.problem.process
    moving = process.hand_over == "motion"
    each = [laid(time_path(given.cell, path, (moving, moving), given.problem.resolve.timing)) for path in paths]
    return SpeedTotals(
        sum(one.at_speed for one in each), sum(one.length for one in each), sum(one.time for one in each)
    )


def laid(timed: TimedPath) -> SpeedTotals:
    """Totals of one timed bead, without its runs and rests."""
    task = timed.path.task
    low, high = float(task.s[task.first]), float(task.s[task.last])
    t = np.append(np.arange(0.0, timed.duration, STEP), timed.duration)
    s = np.clip(timed.at(t)[1], low, high)
    step, dt = np.diff(s), np.diff(t)
    fast = step >= (1.0 - SPEED_TOLERANCE) * task.speed * dt
    return SpeedTotals(float(step[fast].sum()), float(step.sum()), float(dt[step > 0.0].sum()))
