"""Joints as piecewise cubics of time: motion with piecewise constant jerk, exact between its breakpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.compiled import inner_njit, njit


class JointState(NamedTuple):
    """Joints q, their velocities v and accelerations a, each (nj) or (k, nj) [rad, rad/s, rad/s^2]."""

    q: Array
    v: Array
    a: Array

    @property
    def resting(self) -> bool:
        """Whether nothing moves."""
        return not (self.v.any() or self.a.any())


@dataclass(frozen=True)
class Cubics(ReadOnlyArrays):
    """Joints as piecewise cubics of time, from t = 0.

    times (m + 1) breakpoints, not decreasing, from 0 [s]; coefficients (4, m, nj) of the powers 3, 2, 1, 0 of the time
    since the piece began [rad/s^3, rad/s^2, rad/s, rad]
    """

    times: Array
    coefficients: Array

    @property
    def duration(self) -> float:
        """From the first to the last breakpoint [s]."""
        return float(self.times[-1])

    @property
    def start(self) -> JointState:
        """State at t = 0."""
        return JointState(*(each[0] for each in self.state(np.zeros(1))))

    @property
    def end(self) -> JointState:
        """State at t = duration."""
        return JointState(*(each[0] for each in self.state(self.times[-1:])))

    def joints(self, t: Array) -> Array:
        """Joints (k, nj) at times t (k); outside [0, duration] those of the nearer end."""
        tau, (c3, c2, c1, c0) = self._at(t)
        return c0 + tau * (c1 + tau * (c2 + tau * c3))

    def state(self, t: Array) -> JointState:
        """Joints, velocities, accelerations (k, nj) at times t (k); outside [0, duration], those of the nearer end."""
        tau, (c3, c2, c1, c0) = self._at(t)
        return JointState(
            c0 + tau * (c1 + tau * (c2 + tau * c3)), c1 + tau * (2.0 * c2 + tau * (3.0 * c3)), 2.0 * c2 + 6.0 * tau * c3
        )

    def _at(self, t: Array) -> tuple[Array, Array]:
        t = np.clip(t, 0.0, self.times[-1])
        piece = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        return (t - self.times[piece])[:, None], self.coefficients[:, piece]


def rest(q: Array, duration: float) -> Cubics:
    """Joints that stay at q (nj) for a duration [s], which may be 0."""
    coefficients = np.zeros((4, 1, len(q)))
    coefficients[3] = q
    return Cubics(np.array([0.0, duration]), coefficients)


def chain(pieces: Sequence[Cubics]) -> Cubics:
    """Join pieces end to end in time, without adjusting their states where they meet; at least one is required."""
    lasting = [piece for piece in pieces if piece.duration > 0.0] or pieces[:1]
    starts = np.cumsum([0.0, *(piece.duration for piece in lasting)])
    times = [start + piece.times[:-1] for start, piece in zip(starts[:-1], lasting, strict=True)]
    return Cubics(
        np.concatenate([*times, starts[-1:]]), np.concatenate([piece.coefficients for piece in lasting], axis=1)
    )


def add(a: Cubics, b: Cubics) -> Cubics:
    """The sum of two motions; the shorter one must end at rest, and holds its end."""
    return Cubics(*_add(a.times, a.coefficients, b.times, b.coefficients))


@inner_njit
def _merged(a: Array, b: Array) -> Array:
    """The breakpoints of both, without duplicates; at least two."""
    both = np.zeros(len(a) + len(b))
    i, j, n = 0, 0, 0
    while i < len(a) or j < len(b):
        if j == len(b) or (i < len(a) and a[i] <= b[j]):
            t = a[i]
            i += 1
        else:
            t = b[j]
            j += 1
        if n == 0 or t > both[n - 1]:
            both[n] = t
            n += 1
    return both[: max(n, 2)].copy()


@njit
def _add(times_a: Array, a: Array, times_b: Array, b: Array) -> tuple[Array, Array]:
    times = _merged(times_a, times_b)
    out = np.zeros((4, len(times) - 1, a.shape[2]))
    for own, c in ((times_a, a), (times_b, b)):
        piece, last = 0, len(own) - 2
        for i in range(len(times) - 1):
            while piece < last and own[piece + 1] <= times[i]:
                piece += 1
            over = times[i] >= own[-1] > 0.0
            tau = min(times[i], own[-1]) - own[piece]
            for j in range(a.shape[2]):
                c3, c2, c1, c0 = c[0, piece, j], c[1, piece, j], c[2, piece, j], c[3, piece, j]
                out[3, i, j] += c0 + tau * (c1 + tau * (c2 + tau * c3))
                if not over:
                    out[0, i, j] += c3
                    out[1, i, j] += c2 + 3.0 * c3 * tau
                    out[2, i, j] += c1 + tau * (2.0 * c2 + 3.0 * c3 * tau)
    return times, out


@dataclass(frozen=True)
class Extremes:
    """Exact extremes of a motion: least and greatest joints; greatest |velocity|, |acceleration|, |jerk|; all (nj)."""

    low: Array
    high: Array
    velocity: Array
    acceleration: Array
    jerk: Array


def extremes(cubics: Cubics) -> Extremes:
    """Extremes of every joint over the whole motion, between breakpoints too."""
    return Extremes(*_extremes(cubics.times, cubics.coefficients))


@njit
def _extremes(times: Array, coefficients: Array) -> Array:
    m, nj = coefficients.shape[1:]
    out = np.zeros((5, nj))
    out[0], out[1] = np.inf, -np.inf
    for i in range(m):
        h = times[i + 1] - times[i]
        for j in range(nj):
            c3, c2, c1, c0 = coefficients[0, i, j], coefficients[1, i, j], coefficients[2, i, j], coefficients[3, i, j]
            out[4, j] = max(out[4, j], abs(6.0 * c3))
            # candidates for extremes: the ends, and zeros of the velocity c1 + 2 c2 t + 3 c3 t^2
            root = c2 * c2 - 3.0 * c3 * c1
            far = -(c2 + np.copysign(np.sqrt(max(root, 0.0)), c2))
            first = far / (3.0 * c3) if c3 != 0.0 else 0.0
            second = c1 / far if far != 0.0 else 0.0
            top = -c2 / (3.0 * c3) if c3 != 0.0 else 0.0  # extreme of the velocity
            for t in (0.0, h, first, second, top):
                if 0.0 <= t <= h:
                    q = c0 + t * (c1 + t * (c2 + t * c3))
                    out[0, j], out[1, j] = min(out[0, j], q), max(out[1, j], q)
                    out[2, j] = max(out[2, j], abs(c1 + t * (2.0 * c2 + 3.0 * c3 * t)))
                    out[3, j] = max(out[3, j], abs(2.0 * c2 + 6.0 * c3 * t))
    return out
