"""A move of one joint from rest to rest: seven cubic segments, as two kinds of controllers generate it.

Limited jerk: the acceleration is built up at a constant jerk, and is not fully reached in short moves. Mean over a
fixed time: a profile that limits only speed and acceleration is smoothed by a moving average; whatever the
acceleration, it is then built up in that time. Acceleration and braking have separate limits, as gravity or a
regenerative bus may affect drives differently.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from planner.base.arrays import Array, Indices

LEAST_SPEED = 1e-12  # rad/s, m/s


@dataclass(frozen=True)
class MotionLimits:
    """Greatest speed [rad/s], acceleration and its jerk [rad/s², rad/s³], and those of braking; metres if it slides.

    averaged  the profile has no jerk limit but is smoothed by a mean over acceleration / jerk [s]; the jerk is that
              from rest, and braking is smoothed by the same mean
    lag [s]   time constant of a servo that follows the profile as a first-order system; 0: it follows at once
    """

    speed: float
    acceleration: float
    jerk: float
    braking: float
    braking_jerk: float
    lag: float = 0.0
    averaged: bool = False


@dataclass(frozen=True)
class MoveProfile:
    """Segments of constant jerk (7); the move begins at time 0 and position 0.

    start (7), duration (7) [s];  coefficients (7, 4) of q = c0 + c1 t + c2 t² + c3 t³, t from the segment's start
    follower (7)   position of the lagging servo at each start, if there is a lag [rad]
    end            positions of profile and servo at the end [rad]
    cruise         how long the greatest speed is held [s]
    held           how long the greatest acceleration, and braking, are held, relative to the time taken to reach them
    """

    start: Array
    duration: Array
    coefficients: Array
    follower: Array
    lag: float
    end: tuple[float, float]
    cruise: float
    held: tuple[float, float]

    @property
    def total(self) -> float:
        """How long the move takes [s]."""
        return float(self.start[-1] + self.duration[-1])

    @property
    def top_speed(self) -> float:
        """Greatest speed [rad/s]."""
        # within the segment in which the acceleration changes sign, or at one of its ends
        _, v, half_a, sixth_j = self.coefficients.T
        with np.errstate(divide="ignore", invalid="ignore"):
            turns = np.clip(np.nan_to_num(-half_a / (3.0 * sixth_j)), 0.0, self.duration)
        return float((v + turns * (2.0 * half_a + 3.0 * turns * sixth_j)).max())

    @property
    def top_acceleration(self) -> float:
        """Greatest acceleration [rad/s²]."""
        return float(2.0 * self.coefficients[:, 2].max())

    @property
    def top_braking(self) -> float:
        """Greatest deceleration [rad/s²]."""
        return float(-2.0 * self.coefficients[:, 2].min())

    def at(self, t: Array) -> Array:
        """Positions (m) [rad] of the servo at times (m) [s]; before the start it rests, after the end it settles."""
        k, own = self._places(t)
        if self.lag == 0.0:
            return _cubic(self.coefficients[k], own)
        steady = np.stack(_steady(self.coefficients.T, self.lag), axis=1)
        fading = (self.follower - steady[:, 0])[k] * np.exp(-own / self.lag)
        rest, behind = self.end
        over = np.maximum(t - self.total, 0.0)
        out: Array = np.where(
            t > self.total, rest + (behind - rest) * np.exp(-over / self.lag), _cubic(steady[k], own) + fading
        )
        return np.where(t < 0.0, 0.0, out)

    def speed_at(self, t: Array) -> Array:
        """Speeds (m) [rad/s] at times (m) [s] of the profile, whatever the lag."""
        k, own = self._places(t)
        c = self.coefficients[k]
        out: Array = c[:, 1] + own * (2.0 * c[:, 2] + 3.0 * own * c[:, 3])
        return out

    def states_at(self, t: Array) -> Array:
        """Position, speed and acceleration (m, 3) [rad, s] at times (m) [s] of the profile, whatever the lag."""
        k, own = self._places(t)
        c = self.coefficients[k]
        speed, acceleration = self.speed_at(t), 2.0 * c[:, 2] + 6.0 * own * c[:, 3]
        return np.column_stack([_cubic(c, own), speed, acceleration])

    def _places(self, t: Array) -> tuple[Indices, Array]:
        """The segment (m) of each time, and the time since its start (m), clipped to its duration."""
        k = np.clip(np.searchsorted(self.start, t, side="right") - 1, 0, 6)
        return k, np.clip(t - self.start[k], 0.0, self.duration[k])


def move_profile(distance: float, limits: MotionLimits) -> MoveProfile:
    """The time-optimal move over a distance > 0 [rad] under limits, smoothed if they say so."""
    return _averaged(distance, limits) if limits.averaged else _limited(distance, limits)


def _limited(distance: float, limits: MotionLimits) -> MoveProfile:
    """The time-optimal jerk-limited move."""
    top = _top_speed(distance, limits)
    first, last = _ramp(top, limits.acceleration, limits.jerk), _ramp(top, limits.braking, limits.braking_jerk)
    cruise = max(distance - 0.5 * top * (_length(first) + _length(last)), 0.0) / top
    durations = (first[0], first[1], first[0], cruise, last[0], last[1], last[0])
    up, down = limits.jerk, limits.braking_jerk
    held = (first[1] / first[0], last[1] / last[0])
    return _built(durations, (up, 0.0, -up, 0.0, -down, 0.0, down), limits.lag, cruise, held)


def _averaged(distance: float, limits: MotionLimits) -> MoveProfile:
    """The time-optimal move of limited acceleration, smoothed by a mean over a fixed time."""
    up, down, mean = limits.acceleration, limits.braking, limits.acceleration / limits.jerk
    top = min(limits.speed, math.sqrt(2.0 * distance * up * down / (up + down)))
    cruise = max(distance / top - 0.5 * top / up - 0.5 * top / down, 0.0)
    ends = np.cumsum([0.0, top / up, cruise, top / down]).tolist()
    # the jerk is the change of acceleration over the mean's time: these steps enter the window, and later leave it
    steps = (up, -up, -down, down)
    changes = sorted(
        [*zip(ends, steps, strict=True), *((t + mean, -step) for t, step in zip(ends, steps, strict=True))]
    )
    durations, jerks, jerk = [], [], 0.0
    for (begin, step), (end, _) in zip(changes, changes[1:], strict=False):
        jerk += step / mean
        durations.append(end - begin)
        jerks.append(jerk)
    held = (max(top / up / mean - 1.0, 0.0), max(top / down / mean - 1.0, 0.0))
    return _built(durations, jerks, limits.lag, max(cruise - mean, 0.0), held)


def _built(
    durations: Sequence[float], jerks: Sequence[float], lag: float, cruise: float, held: tuple[float, float]
) -> MoveProfile:
    """The profile of seven segments, from rest."""
    # plain numbers: a fit needs thousands of moves, and short arrays would take ten times as long
    starts, rows, follower = [], [], []
    begun = q = v = a = behind = 0.0
    for t, jerk in zip(durations, jerks, strict=True):
        row = (q, v, 0.5 * a, jerk / 6.0)
        starts.append(begun)
        rows.append(row)
        follower.append(behind)
        if lag > 0.0:
            c0, c1, c2, c3 = _steady(row, lag)
            behind = c0 + t * (c1 + t * (c2 + t * c3)) + (behind - c0) * math.exp(-t / lag)
        q += t * (v + t * (0.5 * a + t * jerk / 6.0))
        v += t * (a + 0.5 * t * jerk)
        a += t * jerk
        begun += t
    return MoveProfile(
        np.array(starts), np.array(durations), np.array(rows), np.array(follower), lag, (q, behind), cruise, held
    )


def _ramp(top: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Times [s] to reach a speed from rest: of each of both jerk phases, and of constant acceleration between them."""
    if top * jerk >= acceleration**2:
        return acceleration / jerk, top / acceleration - acceleration / jerk
    return math.sqrt(top / jerk), 0.0


def _length(ramp: tuple[float, float]) -> float:
    return 2.0 * ramp[0] + ramp[1]


def _top_speed(distance: float, limits: MotionLimits) -> float:
    """The greatest speed of the quickest move over a distance."""

    def spare(top: float) -> float:
        ramps = _ramp(top, limits.acceleration, limits.jerk), _ramp(top, limits.braking, limits.braking_jerk)
        return distance - 0.5 * top * sum(map(_length, ramps))

    if spare(limits.speed) >= 0.0:
        return limits.speed
    # a search tries limits so far off that no speed is left
    return max(float(brentq(spare, 0.0, limits.speed, xtol=1e-14 * limits.speed, rtol=1e-13)), LEAST_SPEED)


def _cubic(c: Array, t: Array) -> Array:
    """Cubics with coefficients (m, 4) at times (m)."""
    out: Array = c[:, 0] + t * (c[:, 1] + t * (c[:, 2] + t * c[:, 3]))
    return out


def _steady(c: Any, lag: float) -> tuple[Any, Any, Any, Any]:
    """Coefficients (4) of a first-order system's steady response to a cubic (4); numbers or arrays."""
    # u - T Du + T² D²u - T³ D³u solves T Dx + x = u
    c0, c1, c2, c3 = c
    return (
        c0 - lag * (c1 - 2.0 * lag * (c2 - 3.0 * lag * c3)),
        c1 - 2.0 * lag * (c2 - 3.0 * lag * c3),
        c2 - 3.0 * lag * c3,
        c3,
    )
