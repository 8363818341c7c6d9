"""Stops of a followed path, and how many moves ahead its controller knows: how long before a stop it begins to brake."""

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

REST = 0.02  # of the greatest speed, below which the tip rests
HELD = 0.95  # of the programmed speed, below which something holds the robot back
STOP_SPAN = (-0.5, 0.2)  # s around a stop within which it is looked at
STOP_NEAR = 3e-4  # m from a target, within which the robot rests at it
STOP_UNITS = np.array([1.0, 1.0, 1e-3])  # of speed, instant and ramp in a search [m/s, s, s]
MOST_LAG, LAG_STEP = 0.05, 2e-3  # s of a lag that is looked for, and by which it is varied
CLEAR_SPEED = 15.0  # times its noise, from which a speed is known well enough for its stop
SAME_SPEED = 0.15  # by which a stop's fitted speed may be off the one before it
SHORTEST_RAMP = 5e-3  # s
MOST_STOPS = 12  # that are fitted
ALIKE_SPEED = 1.1  # times, by which speeds of stops differ that are told together
NO_STOP = "it never stops from a steady speed"
STEADY = 0.2  # of the deceleration of stops, below which its speed is steady
LEAST_HELD = 10  # samples on moves of one length
ALIKE_COUNTS = 0.6  # of the scatter of ways, relative, that numbers of moves have at most which tell a look-ahead
MOST_SCATTER = 1.0  # moves
LEAST_AHEAD = 1.5  # moves: fewer are what a least time for each move looks like
APART = 1.5  # times, by which lengths of moves differ where a look-ahead is told from other causes


@dataclass(frozen=True)
class Braking:
    """Stops from one speed [m/s]: how many, and how long an even ramp to rest takes [s], with its standard error; the robot
    begins to brake so much ahead, and half of that times the speed before the place."""

    speed: float
    count: int
    time: float
    error: float

    @property
    def way(self) -> float:
        """How far ahead of the stop it begins [m]."""
        return 0.5 * self.speed * self.time


@dataclass(frozen=True)
class FittedStop:
    """A stop from a steady speed [m/s]: how long an even ramp to it takes [s], its standard error, and how far it goes [m]."""

    speed: float
    time: float
    error: float

    @property
    def way(self) -> float:
        """How far the robot goes while it brakes [m]."""
        return 0.5 * self.speed * self.time


def fitted_stops(path: CommandedPath, followed: FollowedPath) -> list[FittedStop]:
    """Stops at `fine` targets of lines, from the fastest ones on."""
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
            # to where it moves on
            moves_on = np.flatnonzero(~still[end : window.stop])
            last = end + int(moves_on[0]) if len(moves_on) else window.stop
            found.append((top, slice(int(fast[0]), last), float(at[i])))
    found.sort(key=lambda each: -each[0])
    return _with_one_lag(followed, found[:MOST_STOPS])


def _with_one_lag(followed: FollowedPath, parts: Sequence[tuple[float, slice, float]]) -> list[FittedStop]:
    """Stops with the one lag [s] that explains all of them best, from their speeds [m/s], samples and places [m]."""
    if not parts:
        return []

    def fits(lag: float) -> list[Any]:
        return [_stop(followed, part, place, top, lag) for top, part, place in parts]

    def squares(lag: float) -> float:
        return float(sum(2.0 * fit.cost for fit in fits(lag)))

    best = minimize_scalar(squares, bounds=(0.0, MOST_LAG), method="bounded", options={"xatol": 3e-4, "maxiter": 14})
    lag = float(best.x)
    # how well the lag is known, and what that does to the ramps
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
    """An even ramp from a steady speed to rest at a place, behind a lag as that of corners, fitted to samples: speed, instant
    of rest, and time of the ramp, in STOP_UNITS."""
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
    """Stops from speeds that are alike together."""
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
    """How many moves ahead of the one that runs the controller knows: so many as the way holds in which it could stop.

    A controller that knows few is never faster than that allows: its speed is steady below the programmed one, and the way
    in which it could stop holds the same number of moves, however long these are. One that knows enough shows only what
    it needs at least.
    """
    none = float("nan")
    if not stops:
        return ShownValue(none, none, False, NO_STOP)
    at, known = path.way[path.target], sorted(stops, key=lambda stop: stop.speed)
    speeds = np.array([0.0, *(stop.speed for stop in known)])
    # ramps from speeds that it never stopped from are taken to grow with the speed, as with an even acceleration
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
    # the move that runs is one of them; so much as a move more is left to how well stops are known
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
        # what else holds a robot back leaves it a way that is the same, and not a number of moves
        alike = scatter / share < ALIKE_COUNTS * float(ways.std(ddof=1) / ways.mean())
        if alike and scatter < max(MOST_SCATTER, SHOWN * share) and share > LEAST_AHEAD:
            return ShownValue(share, max(scatter, 1.0), True)
    if most < 1.0:
        return ShownValue(none, none, False, "stops are too short beside its moves")
    return ShownValue(most, none, False, "at least")
