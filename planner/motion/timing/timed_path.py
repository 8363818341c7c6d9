"""TimedPath: the joints along one bead as a function of time; and the lower bound that timing is measured against."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.cell.cell import Cell, Limits
from planner.motion.cubics import JointState
from planner.motion.timing.profile import Leg, PiecewiseCurve, Profile, curve_of, fastest_profile
from planner.resolve.joint_path import JointPath, refuse_at

# ----------------------------------------------------------------------------------------------------
# TimedPath: the joints along one bead as a function of time.

BRACKETS = 256  # intervals that bracket the instant at which the nozzle is at a place
LOOKS = 4  # checks between two samples of the task that its arc length grows
ROUNDING = 1e-9  # share of the path's length by which it may decrease
RAMP = 60e-3  # s at the commanded speed: about what an arm takes from rest to that speed


@dataclass(frozen=True)
class TimedPath:
    """One bead with its runs in time, from t = 0: legs of the path, and rests between them.

    curve: joints and arc length over the path parameter; starts (k): instant at which each leg starts [s]
    """

    path: JointPath
    curve: PiecewiseCurve
    legs: tuple[Profile, ...]
    starts: tuple[float, ...]

    @property
    def duration(self) -> float:
        """From the start of the run-in to the end of the run-out [s]."""
        return self.starts[-1] + self.legs[-1].duration

    @property
    def start(self) -> JointState:
        """Joints, velocities and accelerations (nj) at t = 0."""
        return self._end(last=False)

    @property
    def end(self) -> JointState:
        """Joints, velocities and accelerations (nj) at t = duration."""
        return self._end(last=True)

    def joints(self, t: Array) -> Array:
        """Joints (k, nj) at times t (k), which are held within [0, duration]."""
        return self.at(t)[0]

    def at(self, t: Array) -> tuple[Array, Array]:
        """Joints (k, nj) and arc length (k) [m] at times t (k), which are held within [0, duration]."""
        values = self.curve(self._u(t))
        return values[:, :-1], values[:, -1]

    def when(self, s: float) -> float:
        """An instant at which the nozzle is at arc length s [m], or at the nearer end [s]."""
        times = np.linspace(0.0, self.duration, BRACKETS + 1)
        way = self.at(times)[1]
        if not way[0] < s < way[-1]:
            return 0.0 if s <= way[0] else self.duration
        i = int(np.searchsorted(way, s))
        return float(brentq(lambda t: float(self.at(np.array([t]))[1][0]) - s, times[i - 1], times[i], xtol=1e-12))

    @property
    def rests(self) -> tuple[tuple[float, float], ...]:
        """First and last instant of the rest at each of the task's stops [s]."""
        ends = [start + each.duration for start, each in zip(self.starts, self.legs, strict=True)]
        return tuple(zip(ends[:-1], self.starts[1:], strict=True))

    def _u(self, t: Array) -> Array:
        u = np.empty(len(t))
        which = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.starts) - 1)
        for i, (profile, begin) in enumerate(zip(self.legs, self.starts, strict=True)):
            rows = which == i
            u[rows] = profile.u(t[rows] - begin)
        return u

    def _end(self, last: bool) -> JointState:
        profile = self.legs[-1 if last else 0]
        u = profile.leg.last if last else profile.leg.first
        first, second = profile.rates_at_end(last)
        return JointState(self.curve(np.array([u]))[0, :-1], first[:-1], second[:-1])


def time_path(
    cell: Cell, path: JointPath, moving: tuple[bool, bool] = (False, False), timing: str = "jerk_limited"
) -> TimedPath:
    """Time one bead as fast as speed, acceleration and jerk limits and the commanded speed allow.

    timing: as `resolve.timing` of a problem; toppra has no limits on jerk. The bead starts and ends at rest, except at
    ends that are `moving` along a run, and comes to rest at the task's stops. Raises Refusal for a task whose arc
    length does not grow from sample to sample.
    """
    curve, legs = legs_of(path, moving)
    profiles = tuple(_timing(timing)(leg, cell.limits, path.task.speed) for leg in legs)
    waits = [0.0, *(stop.wait for stop in path.task.stops)]
    starts, now = [], 0.0
    for wait, profile in zip(waits, profiles, strict=True):
        starts.append(now + wait)
        now = starts[-1] + profile.duration
    return TimedPath(path, curve, profiles, tuple(starts))


def _timing(name: str) -> Callable[[Leg, Limits, float], Profile]:
    """The function that times a leg; toppra is loaded only if it is requested."""
    if name == "toppra":
        from planner.motion.timing.toppra_profile import toppra_profile

        return toppra_profile
    return fastest_profile


def legs_of(path: JointPath, moving: tuple[bool, bool]) -> tuple[PiecewiseCurve, tuple[Leg, ...]]:
    """Joints and arc length over time at the commanded speed, and the legs of that curve from rest to rest.

    An end is passed in motion if the path is `moving` there and the bead has a run.
    """
    task = path.task
    n = len(task)
    # The path parameter is time at the commanded speed, so that its rate is 1 where that speed is held.
    u = np.linspace(0.0, (task.s[-1] - task.s[0]) / task.speed, n)
    curve = curve_of(make_interp_spline(u, np.column_stack([path.q, task.s]), k=min(5, n - 1)))
    way = curve.columns(slice(-1, None))(np.linspace(0.0, u[-1], LOOKS * (n - 1) + 1))[:, 0]
    falls = np.flatnonzero(np.diff(way) < -ROUNDING * (task.s[-1] - task.s[0]))
    if len(falls):
        refuse_at(task, int(falls[0]) // LOOKS, "the path turns back on itself between samples")
    ends = [0.0, *(at_arc_length(curve, stop.s) for stop in task.stops), float(u[-1])]
    legs = []
    for i, (a, b) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
        at_start = i > 0 or not moving[0] or task.first == 0
        at_end = i + 2 < len(ends) or not moving[1] or task.last == n - 1
        ramp = min(RAMP, (b - a) / 3.0)
        legs.append(Leg(curve, a, b, (ramp if at_start else 0.0, ramp if at_end else 0.0)))
    return curve, tuple(legs)


def at_arc_length(curve: PiecewiseCurve, wanted: float) -> float:
    """Parameter where the curve's last column, which never decreases, has the wanted value; or the nearer end."""
    ends = curve.breaks[0], curve.breaks[-1]
    low, high = curve(np.array(ends))[:, -1]
    if wanted <= low or wanted >= high:
        return float(ends[0] if wanted <= low else ends[1])
    return float(brentq(lambda u: float(curve(np.array([u]))[0, -1]) - wanted, *ends, xtol=1e-14))


# ----------------------------------------------------------------------------------------------------
# The fastest profile without jerk limits: what timing is measured against.
#
# Time-optimal path parameterisation by reachability analysis, after Pham and Pham, "A new approach to time-optimal
# path parameterization based on reachability analysis", IEEE T-RO 2018 (TOPP-RA). With x the squared rate of the
# path parameter u and a its acceleration, joint limits are linear in (a, x):
#
#     |q' a + q'' x| <= a_max,   |q'| sqrt(x) <= v_max,   s' sqrt(x) <= commanded speed
#
# and each interval has constant a. The limits are imposed with the geometry of both ends of every interval. Rest
# (a = x = 0) always satisfies them, so the controllable sets are never empty, however the path is shaped.

REFINE = 4  # grid intervals for each interval of the task's samples
_HALVINGS = 44  # of the interval searched for the largest feasible x: to 1e-13 of it


def bound_time(cell: Cell, path: JointPath, moving: tuple[bool, bool] = (False, False)) -> float:
    """Lower bound [s] on the time of deposition, without limits on jerk.

    From rest to rest, with stops as the task has them; ends that are `moving` along a run are passed in motion. No
    headroom is kept below the limits. Rests at stops are not counted.
    """
    task, total = path.task, 0.0
    curve, legs = legs_of(path, moving)
    v = np.append(cell.limits.velocity, task.speed)
    for leg in legs:
        intervals = max(int(np.ceil(REFINE * (leg.last - leg.first) / leg.spacing)), REFINE)
        grid = np.linspace(leg.first, leg.last, intervals + 1)
        first, second = curve.derivatives(grid, 2)
        with np.errstate(divide="ignore", over="ignore"):
            ceiling = (v / np.abs(first)).min(axis=1) ** 2
        slopes, bends = (np.ascontiguousarray(each[:, :-1]) for each in (first, second))
        free = leg.ramps[0] == 0.0, leg.ramps[1] == 0.0
        x = fastest_without_jerk(slopes, bends, ceiling, cell.limits.acceleration, float(grid[1] - grid[0]), *free)
        rate = np.sqrt(x)
        times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(grid) / (rate[1:] + rate[:-1]))])
        s = curve(grid)[:, -1]
        start, end = np.interp([0.0, task.s[task.last]], s, times)
        total += float(end - start)
    return total


@inner_njit
def _accelerations(
    x: float, i: int, low: float, high: float, slopes: Array, bends: Array, a_max: Array, step: float
) -> tuple[float, float]:
    """Interval of accelerations that the limits at both ends of interval i allow, starting with squared rate x.

    The squared rate reached, x + 2 step a, lies in [low, high]. Empty if the first value exceeds the second.
    """
    least, most = (low - x) / (2.0 * step), (high - x) / (2.0 * step)
    for end in range(2):
        for j in range(slopes.shape[1]):
            # at the far end x has become x + 2 step a
            k = slopes[i + end, j] + (2.0 * step * bends[i + 1, j] if end == 1 else 0.0)
            base = bends[i + end, j] * x
            if abs(k) < 1e-12 * a_max[j]:
                if abs(base) > a_max[j]:
                    return 1.0, 0.0
                continue
            p, q = (-a_max[j] - base) / k, (a_max[j] - base) / k
            least, most = max(least, min(p, q)), min(most, max(p, q))
    return least, most


@njit
def fastest_without_jerk(
    slopes: Array, bends: Array, ceiling: Array, a_max: Array, step: float, free_start: bool, free_end: bool
) -> Array:
    """Largest squared rates x (n) on a uniform grid, 0 at its ends unless they are free.

    slopes, bends (n, nj): q' and q''; ceiling (n): largest x that speed limits allow; a_max (nj).
    """
    n = len(ceiling)
    reachable = np.zeros(n)  # the largest x from which the end can be reached
    if free_end:
        reachable[n - 1] = min(ceiling[n - 1], 1e6)
    for i in range(n - 2, -1, -1):
        low, high = 0.0, min(ceiling[i], 1e6)
        least, most = _accelerations(high, i, 0.0, reachable[i + 1], slopes, bends, a_max, step)
        if least <= most:
            reachable[i] = high
            continue
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            least, most = _accelerations(middle, i, 0.0, reachable[i + 1], slopes, bends, a_max, step)
            if least <= most:
                low = middle
            else:
                high = middle
        reachable[i] = low
    x = np.zeros(n)
    if free_start:
        x[0] = reachable[0]
    for i in range(n - 1):
        _, most = _accelerations(x[i], i, 0.0, reachable[i + 1], slopes, bends, a_max, step)
        x[i + 1] = min(max(x[i] + 2.0 * step * most, 0.0), reachable[i + 1])
    return x
