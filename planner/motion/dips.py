"""Dips: where a bead is printed slower than commanded, which joint's limit causes it, and what would avoid it.

At a constant speed v along the path, a joint's velocity, acceleration and jerk are q' v, q'' v^2 and q''' v^3, with
derivatives by arc length. So each place has a greatest constant speed, and the limit that sets the lowest one within a
dip is its cause. The effect of another speed or limit follows exactly, on the same joint path. The effect of another
corner tolerance is an estimate: a rounded corner grows with the tolerance, so second derivatives are inversely
proportional to it, and third derivatives to its square.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths
from planner.cell.cell import Cell
from planner.motion.extrusion import bead_area, deposited_volume
from planner.motion.timing.profile import HEADROOM
from planner.plan import Dip, Remedy, Trajectory
from planner.problem import Problem
from planner.problem.process import ProcessSpec
from planner.resolve.joint_path import ORDERS, JointPath, by_arc_length, spline_of
from planner.toolpath.bead import Bead, Toolpath

AT_SPEED = 0.98  # share of the commanded speed: slower samples are in a dip
MERGE = 5  # samples at speed between two dips that still count as one
LIMITS = ("velocity", "acceleration", "jerk")
# A joint's limits in the problem file: key, unit in SI, greatest value that the file may hold.
KEYS = (("speed_deg_s", np.pi / 180.0, 1e4), ("acceleration_rad_s2", 1.0, 1e4), ("jerk_rad_s3", 1.0, 1e7))
SLIDING_KEYS = (("speed_mm_s", 1e-3, 1e5), ("acceleration_mm_s2", 1e-3, 1e7), ("jerk_mm_s3", 1e-3, 1e10))
WIDEST_TOLERANCE, LONGEST_RUN = 5e-3, 0.1  # m: greatest values that the problem file may hold
_CORNER_LENGTH = 10.0  # × the tolerance: length of a rounded corner, which has to fit into the bead
SLOWEST = 1e-4  # m/s: least speed that the problem file may hold
MOST_TIMES = 100.0  # × a limit: larger values are not suggested, no robot is so much better than its file says
CORNER = np.radians(20.0)  # turn of the drawn path over two tolerances above which rounding shapes the bead
_BESIDE = 2.0  # × the tolerance: greatest distance of such a corner from the bead
REFINE = 4  # places checked between two samples of the task
DIGITS = 3  # significant digits of a reported value
_ROUNDING = 1e-12  # relative
_NEGLIGIBLE = 5e-3  # share of a dip's volume: smaller over-extrusion is not reported


@dataclass(frozen=True)
class _BeadContext:
    """What all dips of a bead share.

    The task's geometry by sample index (path, bead, spline); a tree of the drawn path's corners; the joints' names,
    their velocity, acceleration and jerk limits (nj, 3), and the indices of sliding joints.
    """

    path: JointPath
    bead: Bead
    spline: BSpline
    corners: cKDTree
    names: tuple[str, ...]
    limits: Array
    sliding: tuple[int, ...]

    def ceilings(self, low: float, high: float) -> tuple[Array, Array]:
        """Greatest constant speed (k, nj, 3) that each limit allows between two arc lengths, and the places (k).

        A place where samples coincide has no direction and is left out.
        """
        found = by_arc_length(self.path, self.spline, low, high, REFINE)
        rates = np.abs(found.rates)
        with np.errstate(divide="ignore", over="ignore"):
            return (HEADROOM * self.limits / rates) ** (1.0 / ORDERS), found.s

    def corner(self, low: float, high: float, tolerance: float) -> bool:
        """Whether the drawn path has a corner near the bead between two arc lengths."""
        points = self.bead.points[(self.bead.s >= low) & (self.bead.s <= high)]
        if len(points) == 0:
            return False
        return bool(self.corners.query(points)[0].min() <= _BESIDE * tolerance)  # infinite where there is none


@dataclass(frozen=True)
class _Stretch:
    """A dip between two arc lengths: whether these are the bead's own ends, where it is slowest, and how slow [m/s]."""

    low: float
    high: float
    begins: bool
    ends: bool
    at: float
    lowest: float


def find_dips(
    problem: Problem, cell: Cell, toolpath: Toolpath, paths: Sequence[JointPath], trajectory: Trajectory
) -> tuple[Dip, ...]:
    """All dips of a trajectory along its joint paths, in order of time, each with its cause and remedies.

    paths: of all beads, or of the last ones
    """
    t, commanded = trajectory, np.array([bead.commanded(problem.process.speed) for bead in toolpath.beads])
    slow = np.flatnonzero(t.deposit & (t.speed < AT_SPEED * commanded[t.bead]))
    if len(slow) == 0:
        return ()
    cut = np.flatnonzero((np.diff(slow) > MERGE + 1) | (np.diff(t.bead[slow]) != 0)) + 1
    dips, before = [], len(toolpath.beads) - len(paths)
    line: _BeadContext | None = None
    for first, last in zip(slow[np.append(0, cut)], slow[np.append(cut - 1, -1)], strict=True):
        i = int(t.bead[first])
        if line is None or line.path.task.bead != i:
            line = _line(cell, toolpath.beads[i], paths[i - before], problem.process.corner_tolerance)
        dips.append(_dip(problem, line, t, int(first), int(last)))
    return tuple(dips)


def _line(cell: Cell, bead: Bead, path: JointPath, tolerance: float) -> _BeadContext:
    limits = np.column_stack([cell.limits.velocity, cell.limits.acceleration, cell.limits.jerk])
    corners = cKDTree(bead.source[_turns(bead.source, tolerance) > CORNER])
    return _BeadContext(path, bead, spline_of(path), corners, cell.joint_names, limits, cell.limits.sliding)


def _turns(path: Array, reach: float) -> Array:
    """Angle [rad] between a polyline's (m, 3) directions before and after each vertex, over `reach` [m]."""
    arc = arc_lengths(path)

    def at(s: Array) -> Array:
        return np.column_stack([np.interp(s, arc, column) for column in path.T])

    come, leave = path - at(arc - reach), at(arc + reach) - path
    return np.arctan2(np.linalg.norm(np.cross(come, leave), axis=1), (come * leave).sum(axis=1))


def _dip(problem: Problem, line: _BeadContext, t: Trajectory, first: int, last: int) -> Dip:
    """The dip between two samples, both included."""
    rows = slice(first, last + 1)
    at = first + int(np.argmin(t.speed[rows]))
    begins = first == 0 or bool(t.bead[first - 1] != t.bead[first])
    ends = last + 1 == len(t) or bool(t.bead[last + 1] != t.bead[last])
    low = 0.0 if begins else 0.5 * float(t.s[first - 1] + t.s[first])
    high = line.bead.length if ends else 0.5 * float(t.s[last] + t.s[last + 1])
    stretch = _Stretch(low, high, begins, ends, float(t.s[at]), float(t.speed[at]))
    joint, limit, remedies = _cause(problem, line, stretch)
    return Dip(
        bead=line.path.task.bead,
        layer=int(t.layer[at]),
        from_s=low,
        to_s=high,
        at_s=stretch.at,
        t=float(t.t[at]),
        speed=stretch.lowest,
        lost=float((1.0 - t.speed[rows] / line.path.task.speed).sum()) * t.dt,
        joint=joint,
        limit=limit,
        # the first and last samples of a bead also carry the flow just beyond them
        over_extruded=_over_extruded(problem.process, line.bead, t, slice(first + begins, last + 1 - ends), low, high),
        remedies=remedies,
    )


def _over_extruded(process: ProcessSpec, bead: Bead, t: Trajectory, rows: slice, low: float, high: float) -> float:
    """Material [m^3] that flows during some samples in excess of what the bead holds from low to high [m]."""
    if high <= low:  # at rest throughout: use the bead's mean
        low, high = 0.0, bead.length
    volume = deposited_volume(bead, bead_area(bead, process), np.array([low, high]))
    area = float(volume[1] - volume[0]) / (high - low)
    held = area * float(t.speed[rows].sum()) * t.dt
    over = float(t.flow[rows].sum()) * t.dt - held
    return over if abs(over) > _NEGLIGIBLE * held else 0.0


def _cause(problem: Problem, line: _BeadContext, dip: _Stretch) -> tuple[str, str, tuple[Remedy, ...]]:
    """Joint, limit and remedies of a dip."""
    task = line.path.task
    if any(dip.low <= stop.s <= dip.high for stop in task.stops):
        return "", "stop", ()
    # the cause of a low speed at a bead's end may lie in its run
    ceilings, places = line.ceilings(task.s[0] if dip.begins else dip.low, task.s[-1] if dip.ends else dip.high)
    if len(places) == 0:
        return "", "shape", ()
    _, joint, order = np.unravel_index(int(np.argmin(ceilings)), ceilings.shape)
    if ceilings.min() < AT_SPEED * task.speed:
        return line.names[joint], LIMITS[order], _remedies(problem, line, dip, ceilings, places)
    if dip.begins or dip.ends:
        start = dip.begins and (not dip.ends or dip.at < 0.5 * line.bead.length)
        more = dip.high if start else line.bead.length - dip.low
        # a strut may have no run, and then cannot get a longer one
        runs = not line.bead.round or (task.first > 0 if start else task.last < len(task) - 1)
        longer = _longer_run(problem, line.bead, (not start,), problem.process.run_in + more) if runs else ()
        return "", "start" if start else "end", longer
    return line.names[joint], LIMITS[order], ()  # no limit requires it: the nearest one is named


def _remedies(
    problem: Problem, line: _BeadContext, dip: _Stretch, ceilings: Array, places: Array
) -> tuple[Remedy, ...]:
    """Changes of speed, limits or geometry that would let the commanded speed be held; ceilings are (k, nj, 3)."""
    speed = line.path.task.speed
    slowest = ceilings.min(axis=(1, 2))
    # in a run the speed need not be held throughout, so a smaller change may do
    exact = bool(0.0 <= places[np.argmin(slowest)] <= line.bead.length)
    out = []
    slower = float(slowest.min())
    if slower >= SLOWEST and line.bead.speed is None:
        out.append(Remedy("speed", (("process.speed_mm_s", _down(slower * 1e3)),), exact))
    each = ceilings.min(axis=0)
    needed = line.limits * (speed / each) ** ORDERS
    short = np.argwhere(each < speed)
    short = short[np.argsort(each[each < speed], kind="stable")]  # the limit that sets the speed comes first
    keys = [(SLIDING_KEYS if j in line.sliding else KEYS)[k] for j, k in short]
    values = [float(needed[j, k]) / unit for (j, k), (_, unit, _) in zip(short, keys, strict=True)]
    told = (needed / line.limits).max() <= MOST_TIMES
    if told and all(value <= most for value, (_, _, most) in zip(values, keys, strict=True)):
        names = [f"cell.limits.{line.names[j]}.{key}" for (j, _), (key, _, _) in zip(short, keys, strict=True)]
        out.append(Remedy("limits", tuple(zip(names, map(_up, values), strict=True)), exact))
    return (*out, *_larger_shape(problem, line, dip, ceilings, places))


def _larger_shape(
    problem: Problem, line: _BeadContext, dip: _Stretch, ceilings: Array, places: Array
) -> tuple[Remedy, ...]:
    """The run length or corner tolerance at which the commanded speed can be held, where these shape the path.

    Along a longer run all speeds grow, with its square root where accelerations limit them. In a larger corner the
    commanded speed has to be held throughout.
    """
    process, length, speed = problem.process, line.bead.length, line.path.task.speed
    tight = places[(ceilings < AT_SPEED * speed).any(axis=(1, 2))]
    if np.minimum(tight, length - tight).max() < process.corner_tolerance:  # all in a run, or just before it
        longer = process.run_in * (speed / dip.lowest) ** 2 if dip.lowest > 0.0 else np.inf
        return _longer_run(problem, line.bead, (tight[[0, -1]] > 0.5 * length).tolist(), longer)
    wider = process.corner_tolerance * _growth(ceilings, speed)
    if wider > min(WIDEST_TOLERANCE, length / _CORNER_LENGTH) or not line.corner(
        float(tight[0]), float(tight[-1]), process.corner_tolerance
    ):
        return ()
    return (Remedy("corner_tolerance", (("process.corner_tolerance_mm", _up(wider * 1e3, 2)),), False),)


def _longer_run(problem: Problem, bead: Bead, ends: Sequence[bool], length: float) -> tuple[Remedy, ...]:
    """A run-in and run-out of a length [m]; none if a run at one of these ends (False: the start) had to be cut short,
    since a longer one would not fit."""
    short = any(bead.short_runs[end] for end in ends)
    if short or not problem.process.run_in < length <= LONGEST_RUN:
        return ()
    return (Remedy("run_in", (("process.run_in_mm", _up(length * 1e3, 2)),), False),)


def _growth(ceilings: Array, speed: float) -> float:
    """How many times larger a shape must be for a speed to be held along it.

    Infinite where a joint's velocity limit is too low, since a larger shape turns a joint no less per length.
    """
    lowest = ceilings.min(axis=(0, 1))
    if lowest[0] < speed:
        return np.inf
    return float(((speed / lowest[1:]) ** (ORDERS[1:] / (ORDERS[1:] - 1.0))).max())


def _down(value: float) -> float:
    """A positive value rounded down to DIGITS significant digits."""
    places = DIGITS - 1 - math.floor(math.log10(value))
    return round(math.floor(value * 10.0**places * (1.0 + _ROUNDING)) / 10.0**places, max(places, 0))


def _up(value: float, digits: int = DIGITS) -> float:
    """A positive value rounded up to this many significant digits."""
    places = digits - 1 - math.floor(math.log10(value))
    return round(math.ceil(value * 10.0**places * (1.0 - _ROUNDING)) / 10.0**places, max(places, 0))
