"""TimedPath: the joints along one bead as a function of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq

from planner.cell import Cell
from planner.cubics import State
from planner.readonly import Array
from planner.resolve.jointpath import JointPath, refuse_at
from planner.timing.curve import Curve, curve_of
from planner.timing.leg import Leg
from planner.timing.profile import Profile, fastest_profile

BRACKETS = 256  # in which an instant is sought at which the nozzle is at a place
LOOKS = 4  # between two samples of the task, to see that its arc length grows
ROUNDING = 1e-9  # of the path's length, by which it may fall
RAMP = 60e-3  # s at the commanded speed: what an arm takes, about, from rest to that speed


@dataclass(frozen=True)
class TimedPath:
    """One bead with its runs in time, from t = 0: legs of the path, and rests between them.

    curve: joints and arc length over the path parameter; starts (k) of each leg, and how long it rests before it
    """

    path: JointPath
    curve: Curve
    legs: tuple[Profile, ...]
    starts: tuple[float, ...]

    @property
    def duration(self) -> float:
        """From the start of the run-in to the end of the run-out [s]."""
        return self.starts[-1] + self.legs[-1].duration

    @property
    def start(self) -> State:
        """Joints, velocities and accelerations (nj) at t = 0."""
        return self._end(last=False)

    @property
    def end(self) -> State:
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

    def _end(self, last: bool) -> State:
        profile = self.legs[-1 if last else 0]
        u = profile.leg.last if last else profile.leg.first
        first, second = profile.rates_at_end(last)
        return State(self.curve(np.array([u]))[0, :-1], first[:-1], second[:-1])


def time_path(cell: Cell, path: JointPath, moving: tuple[bool, bool] = (False, False)) -> TimedPath:
    """Time one bead as fast as speed, acceleration and jerk limits and the commanded speed allow.

    It starts and ends at rest, but where it is `moving`, and comes to rest at the task's stops. Raises Refusal for a
    task whose arc length does not grow from sample to sample.
    """
    curve, legs = legs_of(path, moving)
    profiles = tuple(fastest_profile(leg, cell.limits, path.task.speed) for leg in legs)
    waits = [0.0, *(stop.wait for stop in path.task.stops)]
    starts, now = [], 0.0
    for wait, profile in zip(waits, profiles, strict=True):
        starts.append(now + wait)
        now = starts[-1] + profile.duration
    return TimedPath(path, curve, profiles, tuple(starts))


def legs_of(path: JointPath, moving: tuple[bool, bool]) -> tuple[Curve, tuple[Leg, ...]]:
    """Joints and arc length over time at the commanded speed, and the legs from rest to rest of that curve."""
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
        at_start, at_end = i > 0 or not moving[0], i + 2 < len(ends) or not moving[1]
        ramp = min(RAMP, (b - a) / 3.0)
        legs.append(Leg(curve, a, b, (ramp if at_start else 0.0, ramp if at_end else 0.0)))
    return curve, tuple(legs)


def at_arc_length(curve: Curve, wanted: float) -> float:
    """Parameter where the curve's last column, which never falls, has the value wanted; or the nearer end."""
    ends = curve.breaks[0], curve.breaks[-1]
    low, high = curve(np.array(ends))[:, -1]
    if wanted <= low or wanted >= high:
        return float(ends[0] if wanted <= low else ends[1])
    return float(brentq(lambda u: float(curve(np.array([u]))[0, -1]) - wanted, *ends, xtol=1e-14))
