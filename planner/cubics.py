"""Joints as piecewise cubics of time: motion with piecewise constant jerk, exact between its breakpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import ruckig
from numpy.typing import NDArray

from planner.readonly import ReadOnlyArrays

Array = NDArray[np.float64]


class State(NamedTuple):
    """Joints q, their velocities v and accelerations a, each (nj) or (k, nj) [rad, rad/s, rad/s^2]."""

    q: Array
    v: Array
    a: Array


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
    def start(self) -> State:
        """State at t = 0."""
        return State(*(each[0] for each in self.state(np.zeros(1))))

    @property
    def end(self) -> State:
        """State at t = duration."""
        return State(*(each[0] for each in self.state(self.times[-1:])))

    def joints(self, t: Array) -> Array:
        """Joints (k, nj) at times t (k); outside [0, duration] those of the nearer end."""
        tau, (c3, c2, c1, c0) = self._at(t)
        return c0 + tau * (c1 + tau * (c2 + tau * c3))

    def state(self, t: Array) -> State:
        """Joints, velocities and accelerations (k, nj) at times t (k); outside [0, duration] those of the nearer end."""
        tau, (c3, c2, c1, c0) = self._at(t)
        return State(
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
    """Pieces laid end to end in time; where they meet they are taken as they are. There is at least one piece."""
    lasting = [piece for piece in pieces if piece.duration > 0.0] or pieces[:1]
    starts = np.cumsum([0.0, *(piece.duration for piece in lasting)])
    times = [start + piece.times[:-1] for start, piece in zip(starts[:-1], lasting, strict=True)]
    return Cubics(
        np.concatenate([*times, starts[-1:]]), np.concatenate([piece.coefficients for piece in lasting], axis=1)
    )


def from_ruckig(trajectory: ruckig.Trajectory) -> Cubics:
    """The same motion as ruckig's trajectory: per joint up to eleven pieces of constant jerk, at common breakpoints."""
    rows = [_constant_jerk(profile) for profile in trajectory.profiles[0]]
    n = max(len(durations) for durations, _ in rows)
    starts, states = np.zeros((len(rows), n)), np.zeros((len(rows), n, 4))
    for j, (durations, begin) in enumerate(rows):
        k = len(durations)
        starts[j, 1:k], starts[j, k:] = np.cumsum(durations[:-1]), np.inf
        states[j, :k] = begin
    duration = trajectory.duration
    times = np.unique(np.concatenate([[0.0, duration], starts[(starts > 0.0) & (starts < duration)]]))
    if len(times) == 1:
        times = np.zeros(2)
    middle = 0.5 * (times[1:] + times[:-1])
    joint = np.arange(len(rows))
    piece = (starts[None] <= middle[:, None, None]).sum(axis=-1) - 1
    tau = times[:-1, None] - starts[joint, piece]
    jerk, a, v, q = np.moveaxis(states[joint, piece], -1, 0)
    coefficients = np.stack(
        [
            jerk / 6.0,
            0.5 * (a + jerk * tau),
            v + tau * (a + 0.5 * tau * jerk),
            q + tau * (v + tau * (a / 2.0 + tau * jerk / 6.0)),
        ]
    )
    return Cubics(times, coefficients)


def _constant_jerk(profile: ruckig.Profile) -> tuple[list[float], Array]:
    """Durations (k) of one joint's pieces that last, and jerk, acceleration, velocity and joint (k, 4) at their start."""
    before, after = profile.brake, profile.accel
    durations = [*before.t, *profile.t, *after.t]
    n = len(profile.t)
    columns = (
        [*before.j, *profile.j, *after.j],
        [*before.a, *profile.a[:n], *after.a],
        [*before.v, *profile.v[:n], *after.v],
        [*before.p, *profile.p[:n], *after.p],
    )
    lasting = [i for i, each in enumerate(durations) if each > 0.0] or [len(before.t)]
    return [durations[i] for i in lasting], np.array(columns).T[lasting]
