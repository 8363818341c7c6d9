"""Profile: how fast a leg of a path is followed, the fastest that speed, acceleration and jerk limits allow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.background import in_threads
from planner.cell import Limits
from planner.readonly import Array
from planner.timing.jerk_kernel import fastest
from planner.timing.leg import Leg
from planner.timing.lengths import APART
from planner.timing.program import LEAST_RATE, Program, overruns, program_of

HEADROOM = 0.99  # share of the joint limits that is used: the rest covers the path between grid points
ACCURACY = 1e-4  # share of the time by which the optimum may be missed
_NEWTON_STEPS = 8
_ON_TIME = 1e-13  # s: a thousandth of what the third difference of samples would show
_LONGEST = 30e-3  # s that an interval of the grid may take
_ROUNDS = 4  # of tightening limits where the path between grid points overruns them
# Of limits less their headroom, between grid points, of squared speed, acceleration and jerk: no need to tighten them.
_ENOUGH = (1.003, 1.005, 1.005)

_NODES, _WEIGHTS = (np.ascontiguousarray(each) for each in np.polynomial.legendre.leggauss(6))


@dataclass(frozen=True)
class Profile:
    """Squared rate x of sigma along a leg, quadratic in each of k intervals, and the time at their ends.

    sigma (k + 1); x (k, 3): x = x0 + x1 f + x2 f^2 at the fraction f of an interval; times (k + 1) from 0 [s]
    """

    leg: Leg
    sigma: Array
    x: Array
    times: Array

    @property
    def duration(self) -> float:
        """Time that the leg takes [s]."""
        return float(self.times[-1])

    def u(self, t: Array) -> Array:
        """Path parameter (k) at times t (k), which are held within [0, duration]."""
        return self.leg.u(_when(np.clip(t, 0.0, self.times[-1]), self.sigma, self.x, self.times))

    def rates_at_end(self, last: bool) -> tuple[Array, Array]:
        """First and second derivative by time of joints and arc length (nj + 1) where the leg begins or ends."""
        i, f = (-1, 1.0) if last else (0, 0.0)
        x0, x1, x2 = self.x[i]
        x, slope = x0 + f * (x1 + f * x2), (x1 + 2.0 * f * x2) / (self.sigma[1:] - self.sigma[:-1])[i]
        first, second = (each[0] for each in self.leg.rates(self.sigma[[i if last else 0]], 2))
        return first * np.sqrt(x), second * x + 0.5 * first * slope


def fastest_profile(leg: Leg, limits: Limits, speed: float) -> Profile:
    """The fastest profile of a leg whose last column is arc length, of rate at most `speed` [m/s].

    Limits hold between grid points too: where the path overruns them there, they are tightened, and in the end the
    whole leg is slowed down by what is left over.
    """
    v = np.append(HEADROOM * limits.velocity, speed)
    program_on = partial(program_of, leg, v, HEADROOM * limits.acceleration, HEADROOM * limits.jerk)
    profile = _within_limits(leg, program_on())
    if float(np.diff(profile.times).max()) > _LONGEST:  # it is slower there than the grid was made for
        profile = _within_limits(leg, program_on((profile.sigma[:-1], profile.x[:, 0])))
    return profile


def _within_limits(leg: Leg, program: Program) -> Profile:
    """The fastest profile on a program's grid, its limits tightened as told above."""
    m = len(program.h)
    at_speed, acceleration, jerk = np.ones(m + 1), np.ones(m + 1), np.ones(m)  # shares of the limits that are used
    c, wanted = program.start, np.ones(-(-m // APART), dtype=np.bool_)
    for _ in range(_ROUNDS):
        tightened = replace(
            program,
            acceleration=program.acceleration / acceleration[:, None, None],
            jerk=program.jerk / np.repeat(jerk, 2)[:, None, None],
            ceiling=program.ceiling * at_speed,
            start=np.maximum(c, LEAST_RATE),
        )
        c = _fastest(tightened, wanted)
        c = np.maximum(c, LEAST_RATE)
        over = overruns(program, c)
        if all(float(values.max()) <= enough for values, enough in zip(over, _ENOUGH, strict=True)):
            break
        tighter = [np.where(values > enough, values, 1.0) for values, enough in zip(over, _ENOUGH, strict=True)]
        for share, overrun in ((at_speed, tighter[0]), (acceleration, tighter[1])):
            share[:-1] /= overrun
            share[1:] /= overrun
        jerk /= tighter[2]
        wanted = _blocks_beside(np.any([values > 1.0 for values in tighter], axis=0))
    left = [float(values.max()) / enough for values, enough in zip(over, _ENOUGH, strict=True)]
    worst = max(1.0, left[0], left[1], left[2] ** (2.0 / 3.0))
    return _profile(leg, program, c / worst)


def _fastest(program: Program, wanted: NDArray[np.bool_]) -> Array:
    """Coefficients (m + 2) of the fastest profile, sought in the blocks that are wanted; in two threads if that is all of
    them and the program can be cut, unless a half is not found so."""
    p, blocks = program, np.arange(len(wanted))
    before = blocks < p.cut // APART
    parts = [before, ~before] if p.cut > 0 and wanted.all() else [wanted]
    found = [(p.start, False)] * len(parts)

    def seek(first: int, last: int) -> None:
        for k in range(first, last):
            found[k] = fastest(
                p.point, p.middle, p.ends, p.acceleration, p.jerk, p.ceiling, p.h, p.start, p.level, ACCURACY, parts[k]
            )

    if len(parts) == 2:
        in_threads(seek, 2)
        if all(reached for _, reached in found):
            return np.concatenate([found[0][0][: p.cut], found[1][0][p.cut :]])
        parts[0] = wanted
    seek(0, 1)
    return found[0][0]


def _blocks_beside(tightened: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The blocks with intervals (m) whose limits were tightened, and their neighbours: what else there is, stays."""
    blocks = np.zeros(-(-len(tightened) // APART) + 2, dtype=np.bool_)
    at = np.flatnonzero(tightened) // APART + 1
    for beside in (-1, 0, 1):
        blocks[at + beside] = True
    return blocks[1:-1]


def _profile(leg: Leg, program: Program, c: Array) -> Profile:
    """The profile of coefficients c (m + 2), with its leads."""
    x = np.column_stack(
        [
            program.left * c[:-2] + (1.0 - program.left) * c[1:-1],
            2.0 * program.left * (c[1:-1] - c[:-2]),
            program.left * (c[:-2] - c[1:-1]) + program.right * (c[2:] - c[1:-1]),
        ]
    )
    sigma = program.sigma
    if program.level[0]:
        x, sigma = np.vstack([[[c[0], 0.0, 0.0]], x]), np.append(0.0, sigma)
    if program.level[1]:
        x, sigma = np.vstack([x, [[c[-1], 0.0, 0.0]]]), np.append(sigma, leg.end)
    times = np.concatenate([[0.0], np.cumsum(_durations(np.diff(sigma), x))])
    return Profile(leg, sigma, x, times)


@njit(cache=True)
def _lasts(h: float, x: Array, f: float) -> float:
    """Time from an interval's start to its fraction f: the integral of h / sqrt(x)."""
    total = 0.0
    for k in range(len(_NODES)):
        at = 0.5 * f * (1.0 + _NODES[k])
        total += _WEIGHTS[k] / np.sqrt(x[0] + at * (x[1] + at * x[2]))
    return 0.5 * f * h * total


@njit(cache=True)
def _durations(h: Array, x: Array) -> Array:
    """Time (k) that each interval takes."""
    out = np.empty(len(h))
    for i in range(len(h)):
        out[i] = _lasts(h[i], x[i], 1.0)
    return out


@njit(cache=True)
def _when(t: Array, sigma: Array, x: Array, times: Array) -> Array:
    """Sigma (k) at times t (k), by Newton's method in the interval of each."""
    out = np.empty(len(t))
    last = len(times) - 2
    for k in range(len(t)):
        i = min(max(np.searchsorted(times, t[k], side="right") - 1, 0), last)
        h = sigma[i + 1] - sigma[i]
        wanted, whole = t[k] - times[i], times[i + 1] - times[i]
        f = min(max(wanted / whole, 0.0), 1.0)
        for _ in range(_NEWTON_STEPS):
            off = _lasts(h, x[i], f) - wanted
            f = min(max(f - off * np.sqrt(x[i, 0] + f * (x[i, 1] + f * x[i, 2])) / h, 0.0), 1.0)
            if abs(off) <= _ON_TIME:
                break
        out[k] = sigma[i] + h * f
    return out
