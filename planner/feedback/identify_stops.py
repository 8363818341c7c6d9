"""Stops of a followed path, how long before them braking begins, and how many moves the controller looks ahead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from planner.base.arrays import Array
from planner.export.player.path import lagging_both_ways
from planner.feedback.identify_corners import CORNER_SPAN, CORNER_TICK, TRUE
from planner.feedback.identify_path import SHOWN, CommandedPath, FollowedPath, ShownValue

REST = 0.02  # × the greatest speed, below which the tip rests
HELD = 0.95  # × the programmed speed, below which something holds the robot back
STOP_SPAN = (-0.5, 0.2)  # s around a stop that are examined
STOP_NEAR = 3e-4  # m from a target, within which the robot rests at it
STOP_UNITS = np.array([1.0, 1.0, 1e-3])  # of speed, instant and ramp in a search [m/s, s, s]
MOST_LAG, LAG_STEP = 0.05, 2e-3  # s: largest lag of the search, and its finite difference
CLEAR_SPEED = 15.0  # × its noise, from which a speed is known well enough to fit its stop
SAME_SPEED = 0.15  # relative: how far a stop's fitted speed may be off the recorded one before it
SHORTEST_RAMP = 5e-3  # s
MOST_STOPS = 12  # the number of stops fitted, fastest first
ALIKE_SPEED = 1.1  # ratio of speeds up to which stops are reported together
NO_STOP = "it never stops from a steady speed"
STEADY = 0.2  # × the deceleration of stops, below which the speed is steady
LEAST_HELD = 10  # samples on moves of one length
ALIKE_COUNTS = 0.6  # × the relative scatter of distances: counts of moves must scatter less to show a look-ahead
MOST_SCATTER = 1.0  # moves
LEAST_AHEAD = 1.5  # moves: fewer could also result from a minimum time per move
APART = 1.5  # ratio of move lengths needed to tell a look-ahead from other causes


@dataclass(frozen=True)
class Braking:
    """Stops from one speed [m/s]: their count, and the duration of a linear ramp to rest [s], with its standard error.
    The robot begins to brake that long before the stop."""

    speed: float
    count: int
    time: float
    error: float

    @property
    def way(self) -> float:
        """How far before the stop braking begins [m]."""
        return 0.5 * self.speed * self.time


@dataclass(frozen=True)
class FittedStop:
    """A stop from a steady speed [m/s]: the duration of a linear ramp to rest [s], and its standard error."""

    speed: float
    time: float
    error: float

    @property
    def way(self) -> float:
        """How far the robot moves while it brakes [m]."""
        return 0.5 * self.speed * self.time


def fitted_stops(path: CommandedPath, followed: FollowedPath) -> list[FittedStop]:
    """Stops at `fine` targets of lines, fastest first."""
    at = path.way[path.target]
    rest = max(REST * float(followed.speed.max(initial=0.0)), 3.0 * followed.speed_noise)
    still = followed.speed < rest
    found = []
    for i in np.flatnonzero(path.fine & path.line):
        there = np.flatnonzero(still & (np.abs(followed.way - at[i]) < STOP_NEAR + 5.0 * followed.noise))
        if not len(there):
            continue
        end = int(there[0])
        window = slice(*np.searchsorted(followed.time, followed.time[end] + np.array(STOP_SPAN)).tolist())
        top = float(np.percentile(followed.speed[window], 90.0))
        fast = np.flatnonzero(followed.speed[window] >= 0.9 * top) + window.start
        if top > max(3.0 * rest, CLEAR_SPEED * followed.speed_noise) and len(fast) and fast[-1] - fast[0] > 3:
            # until it moves on
            moves_on = np.flatnonzero(~still[end : window.stop])
            last = end + int(moves_on[0]) if len(moves_on) else window.stop
            found.append((top, slice(int(fast[0]), last), float(at[i])))
    found.sort(key=lambda each: -each[0])
    return _with_one_lag(followed, found[:MOST_STOPS])


def _with_one_lag(followed: FollowedPath, parts: Sequence[tuple[float, slice, float]]) -> list[FittedStop]:
    """Stops fitted with the single lag [s] that fits all of them best; parts: speeds [m/s], samples and places [m]."""
    if not parts:
        return []

    def fits(lag: float) -> list[Any]:
        return [_stop(followed, part, place, top, lag) for top, part, place in parts]

    def squares(lag: float) -> float:
        return float(sum(2.0 * fit.cost for fit in fits(lag)))

    best = minimize_scalar(squares, bounds=(0.0, MOST_LAG), method="bounded", options={"xatol": 3e-4, "maxiter": 14})
    lag = float(best.x)
    # the error of the lag, and its effect on the ramps
    sides = (max(lag - LAG_STEP, 0.0), lag + LAG_STEP)
    around = [fits(each) for each in sides]
    rise = float(np.mean([sum(2.0 * fit.cost for fit in each) for each in around])) - float(best.fun)
    lag_error = LAG_STEP / float(np.sqrt(max(rise, 1e-3)))
    out = []
    for (top, _, _), fit, low, high in zip(parts, fits(lag), *around, strict=True):
        speed, _, time = fit.x * STOP_UNITS
        scale = max(2.0 * float(fit.cost) / max(len(fit.fun) - 3, 1), 1.0)
        own = float(np.sqrt(np.linalg.pinv(fit.jac.T @ fit.jac)[2, 2] * scale)) * float(STOP_UNITS[2])
        by_lag = float((high.x[2] - low.x[2]) * STOP_UNITS[2]) / (sides[1] - sides[0]) * lag_error
        error = float(np.hypot(own, by_lag))
        near = abs(speed / top - 1.0) < SAME_SPEED and time > SHORTEST_RAMP
        if near and error < SHOWN * time:
            out.append(FittedStop(float(speed), float(time), error))
    return out


def _stop(followed: FollowedPath, part: slice, place: float, top: float, lag: float) -> Any:
    """Fit a linear ramp from a steady speed to rest at a place, smoothed by a lag as in corners, to samples: speed,
    instant of rest, and duration of the ramp, in STOP_UNITS."""
    t, way = followed.time[part] - followed.time[part.start], followed.way[part] - place
    grid = np.arange(t[0] - CORNER_SPAN, t[-1] + CORNER_SPAN, CORNER_TICK)
    weight = 1.0 / max(followed.noise, 1e-6)

    def residuals(x: Array) -> Array:
        speed, arrives, time = x * STOP_UNITS
        left = arrives - grid
        own = np.where(
            left > time, speed * (left - 0.5 * time), np.where(left > 0.0, 0.5 * speed * left**2 / time, 0.0)
        )
        own = own[:, None]
        if lag > CORNER_TICK:
            own = lagging_both_ways(own, float(np.exp(-CORNER_TICK / lag)), moving=True)
        out: Array = (-np.interp(t, grid, own[:, 0]) - way) * weight
        return out

    slow = float(t[np.argmax(followed.speed[part] < 0.5 * top)]) if (followed.speed[part] < 0.5 * top).any() else t[-1]
    start = np.array([top, slow + 0.05, 0.1]) / STOP_UNITS
    bounds = ([0.1 * start[0], 0.0, 1.0], [3.0 * start[0], 1e4, 1000.0])
    return least_squares(residuals, np.clip(start, bounds[0], bounds[1]), bounds=bounds, diff_step=1e-3, max_nfev=30)


def brakings(stops: Sequence[FittedStop]) -> list[Braking]:
    """Group stops from similar speeds."""
    groups: list[list[FittedStop]] = []
    for stop in sorted(stops, key=lambda each: each.speed):
        if groups and stop.speed < ALIKE_SPEED * groups[-1][0].speed:
            groups[-1].append(stop)
        else:
            groups.append([stop])
    out = []
    for group in groups:
        times = np.array([stop.time for stop in group])
        weights = 1.0 / np.maximum([stop.error for stop in group], 1e-5) ** 2
        scatter = float(times.std(ddof=1) / np.sqrt(len(times))) if len(times) > 1 else 0.0
        speed, time = float(np.mean([stop.speed for stop in group])), float(np.average(times, weights=weights))
        error = float(np.hypot(max(float(weights.sum() ** -0.5), scatter), TRUE * time))
        out.append(Braking(speed, len(group), time, error))
    return out


def looked_ahead(path: CommandedPath, followed: FollowedPath, stops: Sequence[FittedStop]) -> ShownValue:
    """The controller's look-ahead: the number of moves after the current one that its braking distance covers.

    A controller that knows few moves is never faster than these allow: its speed is steady below the programmed one,
    and its braking distance covers the same number of moves, however long they are. One that knows enough only shows a
    lower bound.
    """
    none = float("nan")
    if not stops:
        return ShownValue(none, none, False, NO_STOP)
    at, known = path.way[path.target], sorted(stops, key=lambda stop: stop.speed)
    speeds = np.array([0.0, *(stop.speed for stop in known)])
    # ramps from other speeds are interpolated, growing with the speed as at constant acceleration
    need = 0.5 * followed.speed * np.interp(followed.speed, speeds, np.array([0.0, *(stop.time for stop in known)]))
    places = np.append(0.0, at)
    turn = np.append(True, np.diff(places) > 0.0)
    count = np.arange(len(places), dtype=np.float64)
    held_by = np.interp(followed.way + need, places[turn], count[turn]) - np.interp(
        followed.way, places[turn], count[turn]
    )
    move = np.minimum(np.searchsorted(at, followed.way, side="right"), len(at) - 1)
    size = np.diff(places)[move]
    step = float(np.median(np.diff(followed.time)))
    steep = float(np.median([stop.speed / stop.time for stop in stops]))
    slope = np.abs(np.gradient(followed.speed, step))
    cruising = path.line[move] & (slope < STEADY * steep) & (followed.speed > 0.2 * speeds[1])
    cruising &= (followed.speed < 1.05 * speeds[-1]) & (followed.way + need < at[-1])
    if not cruising.any():
        return ShownValue(none, none, False, "no steady speed from which it stops")
    # the current move is one of them; one more is subtracted for the uncertainty of the stops
    most = max(float(np.floor(np.percentile(held_by[cruising], 90.0) - 2.0)), 0.0)
    held = cruising & (followed.speed < HELD * path.speed[move])
    groups = []
    for length in np.unique(np.round(size[held], 5)):
        own = held & (np.abs(size - length) < 1e-5)
        if own.sum() >= LEAST_HELD:
            groups.append((float(length), float(np.median(held_by[own])) - 1.0))
    lengths, counts = np.array(groups).reshape(-1, 2).T
    if len(counts) > 1 and lengths.max() > APART * lengths.min():
        ways = counts * lengths
        scatter, share = float(counts.std(ddof=1)), float(counts.mean())
        # other causes keep the distance constant, not the number of moves
        alike = scatter / share < ALIKE_COUNTS * float(ways.std(ddof=1) / ways.mean())
        if alike and scatter < max(MOST_SCATTER, SHOWN * share) and share > LEAST_AHEAD:
            return ShownValue(share, max(scatter, 1.0), True)
    if most < 1.0:
        return ShownValue(none, none, False, "stops are too short beside its moves")
    return ShownValue(most, none, False, "at least")
