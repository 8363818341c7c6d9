"""Program: the limits of a leg of a path, on a grid of its own, as the interior-point method takes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.readonly import Array
from planner.timing.leg import Leg
from planner.timing.lengths import APART
from planner.timing.nearby import least_nearby, mean_nearby

Allowed = Callable[[Array], tuple[Array, Array]]

_GRID = 0.125  # of the time in which joints build up their acceleration: the time between grid points, about
_GRID_BETWEEN = (2.5e-3, 5e-3)  # s, the same at least and at most: slow joints follow quick bends too
LEAST_RATE = 1e-12  # squared: keeps what rounding leaves of rest above 0
_DIP = 20e-3  # s: the width over which a slow place slows its neighbourhood, where the method starts
_START = 0.9  # of what limits allow at constant rates: where the method starts
_SLOWEST = 1e-3  # of the commanded rate: the grid is not made finer for slower places
_FASTEST = 1e4  # times the nominal motion: where samples coincide there is no other bound
_LEAD = 0.08  # share of a ramp from rest that is begun with a constant rate, where limits bind only together
_LEAD_LOOKS = 65  # places of a lead at which limits are looked at
_COARSE = 20e-3  # s between grid points where nothing but the commanded speed limits the speed, for _FAR around:
_FAR = 80e-3  # s: more than an arm takes to gather speed
_EASY = 4.0  # times the commanded speed's squared rate that the joints allow there
_QUIET = 0.3  # s of that around a place at which a grid may be cut in two, where the ceiling is _STEADY besides:
_STEADY = 1e-2  # share by which it may vary from one point to the next
_WORTH_A_CUT = 2048  # intervals
_BELOW = 1e-3  # share of the ceiling that a cut keeps below it: what cannot move needs room
_LEAST_INTERVALS = 60
_LOOKS_A_SAMPLE = 3  # of the path, at which the grid's fineness is chosen
_BETWEEN = (0.25, 0.5, 0.75)  # fractions of intervals at which limits are looked at again


@dataclass(frozen=True)
class Program:
    """The limits of a leg as `fastest` takes them, and where they are looked at again.

    left, right (m): what the first and last of three coefficients give of x at an interval's own ends; looks: fractions
    of intervals with the path's rates (3, m, nj + 1) there, where limits are looked at again; v (nj + 1), a, j (nj): the
    limits; cut: where a block of intervals begins at which the commanded speed is held, and so long around it that what
    is before does not feel what is behind, or 0; start is nearly at that speed there
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
    looks: tuple[tuple[float, Array], ...]
    v: Array
    a: Array
    j: Array
    ceiling: Array
    start: Array
    level: tuple[bool, bool]
    cut: int


def program_of(leg: Leg, v: Array, a: Array, j: Array, known: tuple[Array, Array] | None = None) -> Program:
    """The program of a leg under limits of velocity (nj + 1), the last of arc length, acceleration and jerk (nj).

    known: places and the squared rates that a solution on another grid has there, so that this one fits it better.
    """
    leads = (_LEAD * leg.lasts[0], _LEAD * leg.lasts[1])
    level = (leads[0] > 0.0, leads[1] > 0.0)
    allowed = partial(_allowed, leg, v, a, j)
    apart = float(np.clip(_GRID * (a / j).min(), *_GRID_BETWEEN))
    sigma, envelope, quiet = _grid(leg, leads, allowed, apart, known)
    h = np.diff(sigma)
    around = np.concatenate([h[:1], h, h[-1:]])
    left, right = h / (around[:-2] + h), h / (h + around[2:])
    share = np.append(left, 0.5)
    slope = 2.0 / (around[:-1] + around[1:])
    points = leg.rates(sigma, 3)
    ceiling = np.minimum(*_ceilings(leg, v, sigma, points[0]))
    for end, lead in enumerate(leads):  # rows of the grid do not see the leads: there x is that of the grid's end
        if lead > 0.0:
            within = np.linspace(0.0, lead, _LEAD_LOOKS)
            at = sigma[0] - within if end == 0 else sigma[-1] + within
            ceiling[-end] = min(ceiling[-end], float(np.minimum(*allowed(at)).min()))
    start, cut = _start(envelope, ceiling, level), _cut(ceiling, quiet)
    if cut > 0:  # coefficients belong to the middles of intervals
        start[cut : cut + 2] = 0.5 * (ceiling[cut - 1 : cut + 1] + ceiling[cut : cut + 2])
        here = float(start[cut : cut + 2] @ (share[cut], 1.0 - share[cut]))
        start[cut : cut + 2] *= min(1.0, (1.0 - _BELOW) * ceiling[cut] / here)
    first, second = points[0][:, :-1], points[1][:, :-1]
    bases = [_basis(left, right, h, f) for f in (0.0, 0.5, 1.0)]
    return Program(
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
            _jerk_rows(bases[0], points[:, :-1], j),
            _jerk_rows(bases[2], points[:, 1:], j),
        ),
        looks=(
            (0.0, np.ascontiguousarray(points[:, :-1])),
            *((f, leg.rates(sigma[:-1] + f * h, 3)) for f in _BETWEEN),
            (1.0, np.ascontiguousarray(points[:, 1:])),
        ),
        v=v,
        a=a,
        j=j,
        ceiling=ceiling,
        start=start,
        level=level,
        cut=cut,
    )


def _allowed(leg: Leg, v: Array, a: Array, j: Array, sigma: Array) -> tuple[Array, Array]:
    """Largest constant x (k) that the joints' limits allow at sigma (k), and the one that the commanded speed allows."""
    first, second, third = leg.rates(sigma, 3)
    with np.errstate(divide="ignore", over="ignore"):
        x = np.minimum(_ceilings(leg, v, sigma, first)[0], (a / np.abs(second[:, :-1])).min(axis=1))
        x = np.minimum(x, (j / np.abs(third[:, :-1])).min(axis=1) ** (2.0 / 3.0))
    return np.maximum(x, LEAST_RATE), np.maximum(_ceilings(leg, v, sigma, first)[1], LEAST_RATE)


def _ceilings(leg: Leg, v: Array, sigma: Array, first: Array) -> tuple[Array, Array]:
    """Largest x (k) by the joints' and by the commanded speed at sigma (k); first (k, nj + 1) are rates of order 1."""
    with np.errstate(divide="ignore", over="ignore"):
        joints = (v[:-1] / np.abs(first[:, :-1])).min(axis=1)
        along = v[-1] / np.abs(leg.along(sigma))
    return np.minimum(joints, _FASTEST) ** 2, np.minimum(along, _FASTEST) ** 2


def _grid(
    leg: Leg, leads: tuple[float, float], allowed: Allowed, apart: float, known: tuple[Array, Array] | None
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Grid points (m + 1) between the leads, about `apart` [s], a guess of x there, and which are far from all dips.

    As fine as is asked for in the time that the path will take, and as the path's own samples: where these draw
    together, it is not finer than they are.
    """
    a, b = leads[0], leg.end - leads[1]
    step = min(max(apart, leg.spacing / _LOOKS_A_SAMPLE), leg.spacing)
    even = np.linspace(a, b, max(int(np.ceil((b - a) / step)), _LEAST_INTERVALS) + 1)
    joints, commanded = allowed(even)
    # the time at the commanded speed, in which what is near is near, however close the samples are
    time = _cumulated(1.0 / np.sqrt(commanded), even)
    guess = np.minimum(joints, commanded) if known is None else np.interp(even, *known)
    envelope = _smoothed(guess, time, 0.5 * _DIP)
    calm = _smoothed(np.where(_calm(leg, even, time, joints, commanded), 1.0, 0.0), time, 0.5 * _FAR)
    lasting = (apart + calm * (_COARSE - apart)) * np.clip(np.sqrt(envelope), _SLOWEST, None)
    count = _cumulated(1.0 / np.minimum(lasting, leg.spacing), even)
    m = max(int(np.ceil(count[-1])), _LEAST_INTERVALS)
    grid = np.interp(np.linspace(0.0, count[-1], m + 1), count, even)
    grid[[0, -1]] = a, b
    quiet = np.interp(grid, even, least_nearby(calm, time, _QUIET)) == 1.0
    return grid, np.interp(grid, even, envelope), quiet


def _cut(ceiling: Array, quiet: NDArray[np.bool_]) -> int:
    """Where a grid may be cut in two, as near to its middle as can be; 0 if nowhere, or if it is not worth it."""
    m = len(quiet) - 1
    at = np.arange(APART, m - APART, APART)
    if m < _WORTH_A_CUT:
        return 0
    steady = np.abs(ceiling[at[:, None] + (-1, 1)] / ceiling[at, None] - 1.0).max(axis=1) < _STEADY
    at = at[quiet[at] & steady]
    return int(at[np.argmin(np.abs(at - m // 2))]) if len(at) else 0


def _smoothed(values: Array, time: Array, reach: float) -> Array:
    """Values (k) that change slowly over times (k), and are as small as the least nearby."""
    least = least_nearby(values, time, reach)
    return np.maximum(mean_nearby(least, time, reach), least.min())


def _cumulated(density: Array, even: Array) -> Array:
    """Integral (k) of a density over an even grid (k) up to each place."""
    step = float(even[1] - even[0])
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (density[1:] + density[:-1]))])


def _calm(leg: Leg, even: Array, time: Array, joints: Array, commanded: Array) -> NDArray[np.bool_]:
    """Places (k) of an even grid far around which the commanded speed alone sets the speed."""
    start, end = leg.lasts
    inside = (even > start + _FAR) & (even < leg.end - end - _FAR)
    return np.asarray((least_nearby(joints / commanded, time, _FAR) > _EASY) & inside)


def _start(envelope: Array, ceiling: Array, level: tuple[bool, bool]) -> Array:
    """Coefficients (m + 2) to begin with: most of the guess."""
    c = np.concatenate([envelope[:1], np.minimum(envelope[1:], envelope[:-1]), envelope[-1:]])
    c[:2], c[-2:] = np.minimum(c[:2], ceiling[0]), np.minimum(c[-2:], ceiling[-1])
    if level[0]:
        c[0] = c[1]
    if level[1]:
        c[-1] = c[-2]
    return _START * c


def _basis(left: Array, right: Array, h: Array, f: float) -> tuple[Array, Array, Array]:
    """What c[i : i + 3] give of x, x' and x'' at the fraction f of each interval, (m, 3) each."""
    ends = (
        (left * (1.0 - f) ** 2, right * f**2, 1.0),
        (-2.0 * left * (1.0 - f) / h, 2.0 * right * f / h, 0.0),
        (2.0 * left / h**2, 2.0 * right / h**2, 0.0),
    )
    x, slope, bend = (np.column_stack([a, total - a - b, b]) for a, b, total in ends)
    return x, slope, bend


@njit(cache=True, nogil=True)
def _jerk_rows(basis: tuple[Array, Array, Array], rates: Array, limit: Array) -> Array:
    """Jerk over sqrt(x) from c[i : i + 3], as a share of its limit (nj), (m, nj, 3); rates (3, m, nj + 1)."""
    m, joints = rates.shape[1], len(limit)
    out = np.empty((m, joints, 3))
    for i in range(m):
        for k in range(joints):
            for n in range(3):
                by_x, by_slope = rates[2, i, k] * basis[0][i, n], 1.5 * rates[1, i, k] * basis[1][i, n]
                out[i, k, n] = (0.5 * rates[0, i, k] * basis[2][i, n] + by_slope + by_x) / limit[k]
    return out


def _in_turn(a: Array, b: Array) -> Array:
    """Rows of a and b (m, ...) by turns, (2 m, ...)."""
    return np.ascontiguousarray(np.stack([a, b], axis=1).reshape(2 * len(a), *a.shape[1:]))


def overruns(program: Program, c: Array) -> tuple[Array, Array, Array]:
    """Largest squared speed, acceleration and jerk (m) as shares of their limits in each interval, ends included."""
    p, worst = program, np.zeros((3, len(program.h)))
    for f, rates in p.looks:
        _raise_worst(f, rates, c, p.h, p.left, p.right, p.v, p.a, p.j, worst)
    return worst[0], worst[1], worst[2]


@njit(cache=True, nogil=True)
def _raise_worst(
    f: float, rates: Array, c: Array, h: Array, left: Array, right: Array, v: Array, a: Array, j: Array, worst: Array
) -> None:
    """Raise worst (3, m) to the shares of the limits at the fraction f of each interval, where rates (3, m, nj + 1)
    are those of the path."""
    joints = len(a)
    for i in range(len(h)):
        before, after = left[i] * (c[i] - c[i + 1]), right[i] * (c[i + 2] - c[i + 1])
        x = c[i + 1] + before * (1.0 - f) ** 2 + after * f**2
        slope = 2.0 * (after * f - before * (1.0 - f)) / h[i]
        bend = 2.0 * (before + after) / h[i] ** 2
        root = np.sqrt(x)
        speed, acceleration, jerk = abs(rates[0, i, joints]) / v[joints], 0.0, 0.0
        for k in range(joints):
            first, second, third = rates[0, i, k], rates[1, i, k], rates[2, i, k]
            speed = max(speed, abs(first) / v[k])
            acceleration = max(acceleration, abs(second * x + 0.5 * first * slope) / a[k])
            jerk = max(jerk, abs(third * x + 1.5 * second * slope + 0.5 * first * bend) / j[k])
        worst[0, i] = max(worst[0, i], speed**2 * x)
        worst[1, i] = max(worst[1, i], acceleration)
        worst[2, i] = max(worst[2, i], root * jerk)
