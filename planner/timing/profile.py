"""Profile: how fast a stretch of path is followed, the fastest that speed, acceleration and jerk limits allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d, uniform_filter1d

from planner.cell import Limits
from planner.timing.jerk_kernel import fastest
from planner.timing.stretch import Stretch

Array = NDArray[np.float64]

HEADROOM = 0.975  # share of the joint limits that is used: the rest covers the path between grid points
GRID = 2.5e-3  # s between grid points, about: an eighth of the time in which an arm builds up its acceleration
ACCURACY = 1e-4  # share of the time by which the optimum may be missed
_DIP = 20e-3  # s: the width over which a slow place slows its neighbourhood, where the method starts
_SLOWEST = 1e-3  # of the commanded rate: the grid is not made finer for slower places
_FASTEST = 1e4  # times the nominal motion: where samples coincide there is no other bound
_LEAD = 0.08  # share of a ramp from rest that is begun with a constant rate, where limits bind only together
_LEAST_INTERVALS = 60
_LEAST_RATE = 1e-12  # squared: keeps what rounding leaves of rest above 0
_NEWTON_STEPS = 8
_ON_TIME = 1e-13  # s: a thousandth of what the third difference of samples would show
_ROUNDS = 4  # of tightening limits where the path between grid points overruns them
_BETWEEN = (0.25, 0.5, 0.75)  # fractions of intervals at which limits are looked at again
_ENOUGH = 1.015  # of the limit less its headroom, between grid points: no need to tighten it

_NODES, _WEIGHTS = (np.ascontiguousarray(each) for each in np.polynomial.legendre.leggauss(6))


@dataclass(frozen=True)
class Profile:
    """Squared rate x of sigma along a stretch, quadratic in each of k intervals, and the time at their ends.

    sigma (k + 1); x (k, 3): x = x0 + x1 f + x2 f^2 at the fraction f of an interval; times (k + 1) from 0 [s]
    """

    stretch: Stretch
    sigma: Array
    x: Array
    times: Array

    @property
    def duration(self) -> float:
        """Time that the stretch takes [s]."""
        return float(self.times[-1])

    def u(self, t: Array) -> Array:
        """Path parameter (k) at times t (k), which are held within [0, duration]."""
        return self.stretch.u(_when(np.clip(t, 0.0, self.times[-1]), self.sigma, self.x, self.times))

    def rates_at_end(self, last: bool) -> tuple[Array, Array]:
        """First and second derivative by time of joints and arc length (nj + 1) where the stretch begins or ends."""
        i, f = (-1, 1.0) if last else (0, 0.0)
        x0, x1, x2 = self.x[i]
        x, slope = x0 + f * (x1 + f * x2), (x1 + 2.0 * f * x2) / (self.sigma[1:] - self.sigma[:-1])[i]
        first, second = (each[0] for each in self.stretch.rates(self.sigma[[i if last else 0]], 2))
        return first * np.sqrt(x), second * x + 0.5 * first * slope


@dataclass(frozen=True)
class _Program:
    """The limits of a stretch as `fastest` takes them, and where they are looked at again.

    left, right (m): what the first and last of three coefficients give of x at an interval's own ends; looks: fractions
    of intervals with the path's rates there, where limits are looked at again; a, j (nj): the limits
    """

    sigma: Array
    h: Array
    left: Array
    right: Array
    point: Array
    middle: Array
    ends: Array
    acceleration: Array
    jerk: Array
    looks: tuple[tuple[float, list[Array]], ...]
    a: Array
    j: Array
    ceiling: Array
    start: Array
    level: tuple[bool, bool]


def fastest_profile(stretch: Stretch, limits: Limits, speed: float) -> Profile:
    """The fastest profile of a stretch whose last column is arc length, of rate at most `speed` [m/s].

    Limits hold between grid points too: where the path overruns them there, they are tightened, and in the end the
    whole stretch is slowed down by what is left over.
    """
    v = np.append(HEADROOM * limits.velocity, speed)
    program = _program(stretch, v, HEADROOM * limits.acceleration, HEADROOM * limits.jerk)
    shares = [np.ones(len(program.h) + 1), np.ones(len(program.h))]  # of acceleration and jerk limits that are used
    c = program.start
    for _ in range(_ROUNDS):
        c, _ = fastest(
            program.point,
            program.middle,
            program.ends,
            program.acceleration / shares[0][:, None, None],
            program.jerk / np.repeat(shares[1], 2)[:, None, None],
            program.ceiling,
            program.h,
            np.maximum(c, _LEAST_RATE),
            program.level,
            ACCURACY,
        )
        c = np.maximum(c, _LEAST_RATE)
        acceleration, jerk = _overruns(program, c)
        if max(acceleration.max(), jerk.max()) <= _ENOUGH:
            break
        shares[0][:-1] /= np.maximum(acceleration, 1.0)
        shares[0][1:] /= np.maximum(acceleration, 1.0)
        shares[1] /= np.maximum(jerk, 1.0)
    speed_up = max(float(((program.point * np.column_stack([c[:-1], c[1:]])).sum(axis=1) / program.ceiling).max()), 1.0)
    worst = max(speed_up, float(acceleration.max()) / _ENOUGH, (float(jerk.max()) / _ENOUGH) ** (2.0 / 3.0))
    return _profile(stretch, program, c / worst)


def _program(stretch: Stretch, v: Array, a: Array, j: Array) -> _Program:
    leads = (_LEAD * stretch.lasts[0], _LEAD * stretch.lasts[1])
    level = (leads[0] > 0.0, leads[1] > 0.0)
    allowed = partial(_allowed, stretch, v, a, j)
    sigma, envelope = _grid(stretch, leads, allowed)
    h = np.diff(sigma)
    around = np.concatenate([h[:1], h, h[-1:]])
    left, right = h / (around[:-2] + h), h / (h + around[2:])
    share = np.append(left, 0.5)
    slope = 2.0 / (around[:-1] + around[1:])
    points = stretch.rates(sigma, 3)
    ceiling = _ceiling(stretch, v, sigma, points[0])
    for end, lead in enumerate(leads):  # rows of the grid do not see the leads: there x is that of the grid's end
        if lead > 0.0:
            within = np.linspace(0.0, lead, 9)
            at = sigma[0] - within if end == 0 else sigma[-1] + within
            ceiling[-end] = min(ceiling[-end], float(allowed(at).min()))
    first, second = points[0][:, :-1], points[1][:, :-1]
    bases = [_basis(left, right, h, f) for f in (0.0, 0.5, 1.0)]
    return _Program(
        sigma=sigma,
        h=h,
        left=left,
        right=right,
        point=np.column_stack([share, 1.0 - share]),
        middle=bases[1][0],
        ends=_in_turn(bases[0][0], bases[2][0]),
        acceleration=np.stack(
            [
                second * share[:, None] - 0.5 * first * slope[:, None],
                second * (1.0 - share)[:, None] + 0.5 * first * slope[:, None],
            ],
            axis=-1,
        )
        / a[:, None],
        jerk=_in_turn(
            _jerk_rows(bases[0], [each[:-1] for each in points], j),
            _jerk_rows(bases[2], [each[1:] for each in points], j),
        ),
        looks=(
            (0.0, [each[:-1] for each in points]),
            *((f, stretch.rates(sigma[:-1] + f * h, 3)) for f in _BETWEEN),
            (1.0, [each[1:] for each in points]),
        ),
        a=a,
        j=j,
        ceiling=ceiling,
        start=_start(envelope, ceiling, level),
        level=level,
    )


def _allowed(stretch: Stretch, v: Array, a: Array, j: Array, sigma: Array) -> Array:
    """Largest constant x (k) that the limits allow at sigma (k)."""
    first, second, third = stretch.rates(sigma, 3)
    with np.errstate(divide="ignore"):
        x = np.minimum(_ceiling(stretch, v, sigma, first), (a / np.abs(second[:, :-1])).min(axis=1))
        x = np.minimum(x, (j / np.abs(third[:, :-1])).min(axis=1) ** (2.0 / 3.0))
    return np.asarray(np.maximum(x, _LEAST_RATE))


def _ceiling(stretch: Stretch, v: Array, sigma: Array, first: Array) -> Array:
    """Largest x (k) that speed limits allow at sigma (k), where first (k, nj + 1) are the rates of order 1."""
    with np.errstate(divide="ignore"):
        rate = np.minimum((v[:-1] / np.abs(first[:, :-1])).min(axis=1), v[-1] / np.abs(stretch.along(sigma)))
    return np.asarray(np.minimum(rate, _FASTEST) ** 2)


def _grid(stretch: Stretch, leads: tuple[float, float], allowed: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Grid points (m + 1) between the leads, denser where the path is slow, and a guess of x there."""
    a, b = leads[0], stretch.end - leads[1]
    step = min(GRID, stretch.spacing)
    even = np.linspace(a, b, max(int(np.ceil((b - a) / step)), _LEAST_INTERVALS) + 1)
    step = float(even[1] - even[0])
    width = int(_DIP / step) | 1
    envelope = uniform_filter1d(minimum_filter1d(allowed(even), width, mode="nearest"), width, mode="nearest")
    # as fine as the path's own samples, and as GRID in the time that it will take
    density = np.maximum(1.0 / step, 1.0 / (GRID * np.clip(np.sqrt(envelope), _SLOWEST, 1.0)))
    count = np.concatenate([[0.0], np.cumsum(0.5 * step * (density[1:] + density[:-1]))])
    m = int(np.ceil(count[-1]))
    grid = np.interp(np.linspace(0.0, count[-1], m + 1), count, even)
    grid[[0, -1]] = a, b
    return grid, np.interp(grid, even, envelope)


def _start(envelope: Array, ceiling: Array, level: tuple[bool, bool]) -> Array:
    """Coefficients (m + 2) to begin with: most of the guess."""
    c = np.concatenate([envelope[:1], np.minimum(envelope[1:], envelope[:-1]), envelope[-1:]])
    c[:2], c[-2:] = np.minimum(c[:2], ceiling[0]), np.minimum(c[-2:], ceiling[-1])
    if level[0]:
        c[0] = c[1]
    if level[1]:
        c[-1] = c[-2]
    return 0.9 * c


def _basis(left: Array, right: Array, h: Array, f: float) -> tuple[Array, Array, Array]:
    """What c[i : i + 3] give of x, x' and x'' at the fraction f of each interval, (m, 3) each."""
    ends = (
        (left * (1.0 - f) ** 2, right * f**2, 1.0),
        (-2.0 * left * (1.0 - f) / h, 2.0 * right * f / h, 0.0),
        (2.0 * left / h**2, 2.0 * right / h**2, 0.0),
    )
    x, slope, bend = (np.column_stack([a, total - a - b, b]) for a, b, total in ends)
    return x, slope, bend


def _rows(terms: Sequence[tuple[Array, Array, float]], limit: Array) -> Array:
    """Sum of rates (m, nj + 1) times what c[i : i + 3] give (m, 3) times a factor, as a share of a limit (nj)."""
    total = sum(factor * rate[:, :-1, None] * basis[:, None, :] for rate, basis, factor in terms)
    return np.ascontiguousarray(total / limit[:, None])


def _jerk_rows(basis: tuple[Array, Array, Array], rates: Sequence[Array], limit: Array) -> Array:
    """Jerk over sqrt(x) from c[i : i + 3], as a share of its limit, (m, nj, 3)."""
    x, slope, bend = basis
    return _rows([(rates[0], bend, 0.5), (rates[1], slope, 1.5), (rates[2], x, 1.0)], limit)


def _in_turn(a: Array, b: Array) -> Array:
    """Rows of a and b (m, ...) by turns, (2 m, ...)."""
    return np.ascontiguousarray(np.stack([a, b], axis=1).reshape(2 * len(a), *a.shape[1:]))


def _overruns(program: _Program, c: Array) -> tuple[Array, Array]:
    """Largest acceleration and jerk (m) as shares of their limits in each interval, at its ends and between."""
    worst = np.zeros((2, len(program.h)))
    before, after = program.left * (c[:-2] - c[1:-1]), program.right * (c[2:] - c[1:-1])
    bend = (2.0 * (before + after) / program.h**2)[:, None]
    for f, rates in program.looks:
        first, second, third = (each[:, :-1] for each in rates)
        x = (c[1:-1] + before * (1.0 - f) ** 2 + after * f**2)[:, None]
        slope = (2.0 * (after * f - before * (1.0 - f)) / program.h)[:, None]
        acceleration = second * x + 0.5 * first * slope
        jerk = np.sqrt(x) * (third * x + 1.5 * second * slope + 0.5 * first * bend)
        for k, (value, limit) in enumerate(((acceleration, program.a), (jerk, program.j))):
            np.maximum(worst[k], (np.abs(value) / limit).max(axis=1), out=worst[k])
    return worst[0], worst[1]


def _profile(stretch: Stretch, program: _Program, c: Array) -> Profile:
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
        x, sigma = np.vstack([x, [[c[-1], 0.0, 0.0]]]), np.append(sigma, stretch.end)
    times = np.concatenate([[0.0], np.cumsum(_durations(np.diff(sigma), x))])
    return Profile(stretch, sigma, x, times)


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
