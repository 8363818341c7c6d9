"""Jerk-limited moves from state to state as piecewise cubics of time: by ruckig, or in closed form between rests.

Most moves are from rest to rest with all joints in proportion, so that one scalar, the share of the way, describes
them. Its closed form takes a tenth of the time that ruckig takes, including the reading of its profiles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import ruckig

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.motion.cubics import Cubics, JointState

_REACHED = (ruckig.Result.Working, ruckig.Result.Finished)
_EXACT = 1e-9  # rad, rad/s, rad/s^2: how far a move may end from its target; ruckig's own tolerance is 1e-8
_LONGER, _TRIES = 1.001, 4  # if it misses: × the duration for the next try, and how many tries
LEAST_LEFT = 1e-6  # share of a bound that a move always leaves to another
_TIME_RESOLUTION = 1e-4  # s
_ROUNDING = 1e-12  # relative widening of a velocity or acceleration limit for a state that is exactly at it


@dataclass(frozen=True)
class Bounds:
    """Greatest velocity, acceleration and jerk (nj) of a move."""

    velocity: Array
    acceleration: Array
    jerk: Array

    def capped(self, velocity: Array) -> Bounds:
        """The same with velocities (nj) that are no greater than these."""
        return replace(self, velocity=np.minimum(self.velocity, velocity))


def between(bounds: Bounds, start: JointState, end: JointState, least: float = 0.0) -> Cubics | None:
    """The quickest move from state to state within bounds, lasting at least `least` [s]; None if ruckig finds none.

    All joints arrive together. Bounds on velocity and acceleration are widened to the start's and the end's own.
    """
    if start.resting and end.resting:
        return resting(bounds, start.q, end.q, least)
    for _ in range(_TRIES):
        motion = _ruckig(bounds, start, end, least)
        if motion is None or _misses(motion, end) <= _EXACT:
            return motion
        least = motion.duration * _LONGER
    return None


def _misses(motion: Cubics, end: JointState) -> float:
    return max(float(np.abs(a - b).max()) for a, b in zip(motion.end, end, strict=True))


def _ruckig(bounds: Bounds, start: JointState, end: JointState, least: float) -> Cubics | None:
    n = len(start.q)
    inputs = ruckig.InputParameter(n)
    inputs.current_position, inputs.target_position = start.q.tolist(), end.q.tolist()
    inputs.current_velocity, inputs.target_velocity = start.v.tolist(), end.v.tolist()
    inputs.current_acceleration, inputs.target_acceleration = start.a.tolist(), end.a.tolist()
    own = np.maximum(np.abs(start.v) + 0.5 * start.a**2 / bounds.jerk, np.abs(end.v) + 0.5 * end.a**2 / bounds.jerk)
    inputs.max_velocity = np.maximum(bounds.velocity, own * (1.0 + _ROUNDING)).tolist()
    own = np.maximum(np.abs(start.a), np.abs(end.a))
    inputs.max_acceleration = np.maximum(bounds.acceleration, own * (1.0 + _ROUNDING)).tolist()
    inputs.max_jerk = bounds.jerk.tolist()
    if least > 0.0:
        inputs.minimum_duration = least
    trajectory = ruckig.Trajectory(n)
    try:
        reached = ruckig.Ruckig(n).calculate(inputs, trajectory) in _REACHED
    except ruckig.RuckigError:  # it may find no profile of the duration that another joint needs
        return None
    if not reached:
        return None
    return from_ruckig(trajectory)


def stopped(bounds: Bounds, state: JointState, sign: float) -> JointState:
    """A state at rest that joints can reach soon after a state (sign 1), or can have left soon before it (sign -1)."""
    time = (np.abs(state.v) / bounds.acceleration + bounds.acceleration / bounds.jerk).max()
    still = np.zeros_like(state.q)
    return JointState(state.q + sign * 0.5 * time * state.v, still, still)


def resting(bounds: Bounds, a: Array, b: Array, least: float = 0.0) -> Cubics:
    """The quickest move from rest at a to rest at b (nj), all joints in proportion; slowed to `least` duration [s]."""
    return Cubics(*_resting(bounds.velocity, bounds.acceleration, bounds.jerk, a, b, least))


@njit
def time_beside(bounds: Array, caps: Array, taken: Array, duration: float, vias: Array) -> float:
    """Least duration [s] of a move from rest to rest during which another one over vias (k, na) has time to finish.

    The two are added and share bounds (3, na) of velocity, acceleration and jerk. The first takes `taken` (3, na) of
    them if it lasts `duration`, and less if it lasts longer; the other rests at every via and is capped in velocity.
    """
    if _needed(bounds, caps, taken, 1.0, vias) <= duration:
        return duration
    low = max(duration, _TIME_RESOLUTION)
    high = 2.0 * low
    while _needed(bounds, caps, taken, duration / high, vias) > high:
        low, high = high, 2.0 * high
    while high - low > _TIME_RESOLUTION:
        middle = 0.5 * (low + high)
        if _needed(bounds, caps, taken, duration / middle, vias) > middle:
            low = middle
        else:
            high = middle
    return high


@inner_njit
def _needed(bounds: Array, caps: Array, taken: Array, rate: float, vias: Array) -> float:
    n = bounds.shape[1]
    left, way, phases = np.empty((3, n)), np.empty(n), np.empty(7)
    for order in range(3):
        for j in range(n):
            left[order, j] = max(
                bounds[order, j] - rate ** (order + 1) * taken[order, j], LEAST_LEFT * bounds[order, j]
            )
    for j in range(n):
        left[0, j] = min(left[0, j], caps[j])
    total = 0.0
    for i in range(len(vias) - 1):
        for j in range(n):
            way[j] = vias[i + 1, j] - vias[i, j]
        _phases(left[0], left[1], left[2], way, phases)
        total += _sum(phases)
    return total


@inner_njit
def _sum(phases: Array) -> float:
    total = 0.0
    for k in range(len(phases)):
        total += phases[k]
    return total


@inner_njit
def _phases(velocity: Array, acceleration: Array, jerk: Array, way: Array, out: Array) -> float:
    """Fill out (7) with the durations of the phases from rest to rest over `way` (nj).

    Returns the jerk of the share of the way, 0 if there is no way to go.
    """
    v, w, j = np.inf, np.inf, np.inf  # bounds of the share's velocity, acceleration and jerk
    for i in range(len(way)):
        size = abs(way[i])
        if size > 0.0:
            v, w, j = min(v, velocity[i] / size), min(w, acceleration[i] / size), min(j, jerk[i] / size)
    if v == np.inf:
        for k in range(7):
            out[k] = 0.0
        return 0.0
    rise = min(w / j, np.sqrt(v / j))  # s of growing acceleration, before it is held, and shrinks again
    held = v / (j * rise) - rise
    if v * (2.0 * rise + held) > 1.0:  # the way is too short to reach full velocity
        rise = min(w / j, np.cbrt(0.5 / j))
        held = max(-1.5 * rise + np.sqrt(0.25 * rise * rise + 1.0 / (j * rise)), 0.0)
    cruise = max(1.0 / (j * rise * (rise + held)) - 2.0 * rise - held, 0.0)
    out[0], out[1], out[2], out[3], out[4], out[5], out[6] = rise, held, rise, cruise, rise, held, rise
    return j


@njit
def _resting(
    velocity: Array, acceleration: Array, jerk: Array, a: Array, b: Array, least: float
) -> tuple[Array, Array]:
    """Seven phases of constant jerk in closed form, for a share of the way that grows from 0 to 1."""
    n = len(a)
    way, phases = np.empty(n), np.empty(7)
    for i in range(n):
        way[i] = b[i] - a[i]
    j = _phases(velocity, acceleration, jerk, way, phases)
    if j == 0.0:
        times, out = np.zeros(2), np.zeros((4, 1, n))
        times[1] = least
        for i in range(n):
            out[3, 0, i] = a[i]
        return times, out
    sign = (1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0)
    slower = max(least / _sum(phases), 1.0)
    j /= slower**3
    times, out = np.zeros(8), np.empty((4, 7, n))
    q, dq, ddq = 0.0, 0.0, 0.0
    shares = np.empty((4, 7))
    for k in range(7):
        h = phases[k] * slower
        times[k + 1] = times[k] + h
        shares[0, k], shares[1, k], shares[2, k], shares[3, k] = sign[k] * j / 6.0, ddq / 2.0, dq, q
        q += h * (dq + h * (ddq / 2.0 + h * sign[k] * j / 6.0))
        dq += h * (ddq + h * sign[k] * j / 2.0)
        ddq += h * sign[k] * j
    for i in range(n):
        for k in range(7):
            for power in range(4):
                out[power, k, i] = shares[power, k] * (way[i] / q)  # q is 1, except for rounding
            out[3, k, i] += a[i]
    return times, out


def from_ruckig(trajectory: ruckig.Trajectory) -> Cubics:
    """The same motion as ruckig's trajectory: per joint up to eleven pieces of constant jerk, at common breakpoints."""
    return Cubics(
        *_common(np.array([_constant_jerk(profile) for profile in trajectory.profiles[0]]), trajectory.duration)
    )


def _constant_jerk(profile: ruckig.Profile) -> list[list[float]]:
    """Durations of one joint's pieces, and jerk, acceleration, velocity and joint at their start (5, 11)."""
    before, after = profile.brake, profile.accel
    return [
        [*before.t, *profile.t, *after.t],
        [*before.j, *profile.j, *after.j],
        [*before.a, *profile.a[:-1], *after.a],
        [*before.v, *profile.v[:-1], *after.v],
        [*before.p, *profile.p[:-1], *after.p],
    ]


@inner_njit
def _in_order(breaks: list[float]) -> Array:
    """Breakpoints sorted, without duplicates, at least two; by insertion, since there are a few dozen at most."""
    times = np.zeros(len(breaks))
    n = 0
    for t in breaks:
        k = n
        while k > 0 and times[k - 1] > t:
            k -= 1
        if k > 0 and times[k - 1] == t:
            continue
        for i in range(n, k, -1):
            times[i] = times[i - 1]
        times[k] = t
        n += 1
    return times[: max(n, 2)].copy()


@njit
def _common(profiles: Array, duration: float) -> tuple[Array, Array]:
    """Breakpoints (m + 1) of all joints and coefficients (4, m, nj) from profiles (nj, 5, k), see `_constant_jerk`."""
    nj, _, k = profiles.shape
    starts = np.zeros((nj, k))
    breaks = [0.0, duration]
    for j in range(nj):
        for i in range(1, k):
            starts[j, i] = starts[j, i - 1] + profiles[j, 0, i - 1]
            if 0.0 < starts[j, i] < duration and profiles[j, 0, i] > 0.0:
                breaks.append(starts[j, i])
    times = _in_order(breaks)
    m = len(times) - 1
    out = np.empty((4, m, nj))
    for j in range(nj):
        piece = -1
        for i in range(m):
            while True:  # on to the piece that lasts here
                further = piece + 1
                while further < k and profiles[j, 0, further] <= 0.0:
                    further += 1
                if piece >= 0 and (further == k or starts[j, further] > times[i]):
                    break
                piece = further if further < k else 2  # nothing lasts: the profile stands still
                if further == k:
                    break
            tau = times[i] - starts[j, piece]
            jerk, a, v, q = profiles[j, 1, piece], profiles[j, 2, piece], profiles[j, 3, piece], profiles[j, 4, piece]
            out[0, i, j] = jerk / 6.0
            out[1, i, j] = 0.5 * (a + jerk * tau)
            out[2, i, j] = v + tau * (a + 0.5 * tau * jerk)
            out[3, i, j] = q + tau * (v + tau * (0.5 * a + tau * jerk / 6.0))
    return times, out
