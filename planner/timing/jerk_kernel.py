"""The fastest jerk-limited profile along a path: a primal-dual interior-point method, compiled.

Notation: x is the squared rate of the path parameter, a quadratic B-spline with coefficients c (m + 2) over m
intervals of widths h, so that the acceleration x'/2 is continuous and jerk limits bind x'' interval by interval:

    |q' x'/2 + q'' x|                 <= a_max            at grid points
    |q' x''/2 + 3/2 q'' x' + q''' x|  <= j_max / sqrt(x)  at both ends of every interval
    x                                 <= ceiling          at grid points

The time, the sum of h / sqrt(x), is convex. So is 1/sqrt(x), which makes the jerk limit the only part that is not:
there a linear function is bounded by a convex one, and in every step the tangent of that one, which lies below it,
takes its place. A step within the tangents is within the limits; the curvature that is left out is that of the
limits alone, and the systems of equations, banded with half-bandwidth 2, stay positive definite.

Places that are far apart do not touch each other: each has a length of step and a gap of its own (`lengths.py`), so
that one hard place does not hold up all others. Those that are settled are left alone while others go on.

Debrouwere et al., "Time-optimal path following for robots with convex-concave constraints using sequential convex
programming", IEEE T-RO 2013, solve the same program by a general solver, one convex program after the other.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.readonly import Array
from planner.timing.blocks import limits_of, overrun, runs_of, split
from planner.timing.lengths import APART, average, even_out, go, lengths_of, move

OVERRUN = 1e-3  # of a limit: the most by which a solution may miss it; who asks for one keeps more in reserve
_STEPS = 80  # most of the method's steps: 20 to 40 are usual
_LEAST_SLACK = 1e-1  # of a limit, at the start, where the start does not keep it: less, and steps stay short
_FIRST_GAP = 1.0  # of the time: the duality gap to begin with; with less, and with more, steps are short at first
_FASTEST_FALL = 0.1  # of the gap in one step
# A block of intervals whose steps are not shortened, whose gap is at its least and which keeps its limits is settled.
_FULL = 0.99  # of a step
_AT_REST = 1.5  # times the least gap
_KEPT = 0.1  # of the overrun that a solution may have
_LEAST_GAP = 0.05  # of what the accuracy leaves to a limit: where less is left there is nothing to gain


@njit(cache=True, nogil=True, error_model="numpy")
def fastest(
    point: Array,
    middle: Array,
    end: Array,
    a: Array,
    j: Array,
    ceiling: Array,
    h: Array,
    start: Array,
    level: tuple[bool, bool],
    accuracy: float,
    wanted: NDArray[np.bool_],
) -> tuple[Array, bool]:
    """Coefficients c (m + 2) of the fastest profile, and whether it was found to the accuracy asked for.

    point (m + 1, 2): x at grid point i from c[i : i + 2]; middle (m, 3): x in the middle of interval i from
    c[i : i + 3]; end (2 m, 3): at its two ends, 2 i and 2 i + 1, from the same; a (m + 1, nj, 2) and j (2 m, nj, 3):
    shares of the acceleration limit at points, and of the jerk limit over sqrt(x) at ends; ceiling (m + 1): largest x;
    h (m); start (m + 2): positive, need not hold the limits; level: x is constant in front of, and behind the grid;
    accuracy: share of the time by which it may be missed; wanted (blocks of APART intervals): where start is not to be
    kept as it is.
    """  # fmt: skip
    m, nj = len(h), a.shape[1]
    c = start.copy()
    # all limits in a row: those of x, of acceleration, and of jerk, of which the latter two are seen as boxes too
    jerks = (m + 1) * (2 * nj + 1)
    count = jerks + 4 * m * nj
    room, slack, price = np.empty(count), np.empty(count), np.empty(count)
    rooms, slacks, duals = split(room, m, nj), split(slack, m, nj), split(price, m, nj)
    _rooms(c, point, middle, end, a, j, ceiling, rooms)
    time = _time(c, middle, h)
    mu = np.full(m, _FIRST_GAP * time / count)
    for i in range(count):
        slack[i] = max(room[i], _LEAST_SLACK)  # the room there is, where there is some
        price[i] = mu[0] / slack[i]
    step, band = np.empty(m + 2), np.empty((m + 2, 3))
    primal, dual, gaps, sums, mins = np.empty(m), np.empty(m), np.zeros(m), np.empty(m + 1), np.empty(m)
    unsettled = wanted.copy()
    over = np.where(wanted, np.inf, -np.inf)  # largest overrun of each block, if it is known
    for _ in range(_STEPS):
        runs = runs_of(unsettled, m)
        primal[:] = dual[:] = 1.0
        for lo, hi in runs:
            at, on, ends, all_c = slice(lo, hi + 1), slice(lo, hi), slice(2 * lo, 2 * hi), slice(lo, hi + 2)
            own = (rooms[0][at], rooms[1][at], rooms[2][ends])
            own_slacks = (slacks[0][at], slacks[1][at], slacks[2][ends])
            own_duals = (duals[0][at], duals[1][at], duals[2][ends])
            _assemble(
                c[all_c], point[at], middle[on], end[ends], a[at], j[ends], ceiling[at], h[on], mu[on], own, own_slacks,
                own_duals, step[all_c], band[all_c],
            )  # fmt: skip
            first, last = level[0] and lo == 0, level[1] and hi == m
            _keep_level((first, last), step[all_c], band[all_c])
            _hold((lo > 0, hi < m), step[all_c], band[all_c])
            if not _solve(band[all_c], step[all_c]):
                return c, False
            if first:
                step[0] = step[1]
            if last:
                step[m + 1] = step[m]
            lengths_of(
                c[all_c], step[all_c], point[at], middle[on], end[ends], a[at], j[ends], ceiling[at], mu[on], own,
                own_slacks, own_duals, primal[on], dual[on],
            )  # fmt: skip
        even_out(primal, sums, mins)
        even_out(dual, sums, mins)
        for lo, hi in runs:
            go(c[lo : hi + 2], step[lo : hi + 2], middle[lo:hi], end[2 * lo : 2 * hi], primal[lo:hi])
            for b in range(lo, hi, APART):  # block by block, so that all that is done to one stays near the processor
                e = min(b + APART, hi)
                at, on = slice(b, e + 1 if e == hi else e), slice(b, e)
                ends, all_c = slice(2 * b, 2 * e), slice(b, e + 2)
                gaps[on] = 0.0
                for which, places in limits_of(at, ends, m, nj):
                    move(primal[on], dual[on], mu[on], room[which], slack[which], price[which], places, gaps[on])
                own = (rooms[0][at], rooms[1][at], rooms[2][ends])
                _rooms(c[all_c], point[at], middle[on], end[ends], a[at], j[ends], ceiling[at], own)
        gap, time = gaps.sum(), _time(c, middle, h)
        least_mu = _LEAST_GAP * accuracy * time / count
        all_full = True  # shortened steps leave some of the conditions on the duals: then the gap says too little
        for b in range(len(unsettled)):
            if not unsettled[b]:
                continue
            lo, hi = b * APART, min((b + 1) * APART, m)
            full = min(primal[lo:hi].min(), dual[lo:hi].min()) > _FULL
            at_rest = full and gaps[lo:hi].sum() < _AT_REST * (hi - lo) * least_mu * count / m
            over[b] = np.inf
            if at_rest or gap < accuracy * time:
                over[b] = -np.inf
                for which, _ in limits_of(slice(lo, hi + 1), slice(2 * lo, 2 * hi), m, nj):
                    over[b] = max(over[b], overrun(room[which], slack[which]))
            unsettled[b] = not (at_rest and over[b] < _KEPT * OVERRUN)
            all_full = all_full and full
        if all_full and gap < accuracy * time and over.max() < OVERRUN:
            return c, True
        average(gaps, APART, sums, mu)
        for i in range(m):
            least = min(primal[i], dual[i])
            fall = max(_FASTEST_FALL, (1.0 - least) ** 2) if least > 0.1 else 1.0
            mu[i] = max(mu[i] * m / count * fall, least_mu)
    return c, False


@njit(cache=True, nogil=True, error_model="numpy")
def _time(c: Array, middle: Array, h: Array) -> float:
    """The time that all intervals take."""
    time = 0.0
    for i in range(len(h)):
        time += h[i] / np.sqrt(middle[i, 0] * c[i] + middle[i, 1] * c[i + 1] + middle[i, 2] * c[i + 2])
    return time


@njit(cache=True, nogil=True, error_model="numpy")
def _rooms(
    c: Array, point: Array, middle: Array, end: Array, a: Array, j: Array, ceiling: Array,
    rooms: tuple[Array, Array, Array],
) -> None:  # fmt: skip
    """Room below every limit, on either side, into `rooms`."""
    m, nj = len(middle), a.shape[1]
    for i in range(m):
        for e in range(2 * i, 2 * i + 2):
            r = 1.0 / np.sqrt(end[e, 0] * c[i] + end[e, 1] * c[i + 1] + end[e, 2] * c[i + 2])
            for k in range(nj):
                value = j[e, k, 0] * c[i] + j[e, k, 1] * c[i + 1] + j[e, k, 2] * c[i + 2]
                rooms[2][e, k, 0], rooms[2][e, k, 1] = r - value, r + value
    for i in range(len(ceiling)):
        rooms[0][i] = 1.0 - (point[i, 0] * c[i] + point[i, 1] * c[i + 1]) / ceiling[i]
        for k in range(nj):
            value = a[i, k, 0] * c[i] + a[i, k, 1] * c[i + 1]
            rooms[1][i, k, 0], rooms[1][i, k, 1] = 1.0 - value, 1.0 + value


@njit(cache=True, inline="always")
def _weights(mu: float, room: float, slack: float, dual: float) -> tuple[float, float]:
    """What a limit adds to the matrix, per square of its gradient, and to the right-hand side, per gradient."""
    inverse = 1.0 / slack
    w = dual * inverse
    return w, mu * inverse - w * (room - slack)


@njit(cache=True, nogil=True, error_model="numpy")
def _assemble(
    c: Array, point: Array, middle: Array, end: Array, a: Array, j: Array, ceiling: Array, h: Array, mu: Array,
    rooms: tuple[Array, Array, Array], slacks: tuple[Array, Array, Array], duals: tuple[Array, Array, Array],
    rhs: Array, band: Array,
) -> None:  # fmt: skip
    """Newton's equations for c, slacks and duals eliminated: right-hand side, and matrix as `_solve` takes it.

    The two sides of a jerk limit have gradients t g - d and t g + d, with g that of x, t the tangent of 1 / sqrt(x) and
    d the row: their squares are summed over the joints in these terms.
    """
    m, nj = len(h), a.shape[1]
    rhs[:] = 0.0
    band[:] = 0.0
    for i in range(m):
        g0, g1, g2 = middle[i]
        r = 1.0 / np.sqrt(g0 * c[i] + g1 * c[i + 1] + g2 * c[i + 2])
        w, p = 0.75 * h[i] * r**5, 0.5 * h[i] * r**3
        b00, b11, b22, b01, b12, b02 = w * g0 * g0, w * g1 * g1, w * g2 * g2, w * g0 * g1, w * g1 * g2, w * g0 * g2
        t0, t1, t2 = p * g0, p * g1, p * g2
        for e in range(2 * i, 2 * i + 2):
            both, push, x0, x1, x2 = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(nj):
                d0, d1, d2 = j[e, k]
                low, p_low = _weights(mu[i], rooms[2][e, k, 0], slacks[2][e, k, 0], duals[2][e, k, 0])
                high, p_high = _weights(mu[i], rooms[2][e, k, 1], slacks[2][e, k, 1], duals[2][e, k, 1])
                w, skew, p = low + high, high - low, p_high - p_low
                both += w
                push += p_low + p_high
                x0 += skew * d0
                x1 += skew * d1
                x2 += skew * d2
                t0 += p * d0
                t1 += p * d1
                t2 += p * d2
                b00 += w * d0 * d0
                b11 += w * d1 * d1
                b22 += w * d2 * d2
                b01 += w * d0 * d1
                b12 += w * d1 * d2
                b02 += w * d0 * d2
            g0, g1, g2 = end[e]
            r = 1.0 / np.sqrt(g0 * c[i] + g1 * c[i + 1] + g2 * c[i + 2])
            t = -0.5 * r**3
            g0, g1, g2 = t * g0, t * g1, t * g2
            t0 += push * g0
            t1 += push * g1
            t2 += push * g2
            b00 += g0 * (both * g0 + 2.0 * x0)
            b11 += g1 * (both * g1 + 2.0 * x1)
            b22 += g2 * (both * g2 + 2.0 * x2)
            b01 += both * g0 * g1 + g0 * x1 + g1 * x0
            b12 += both * g1 * g2 + g1 * x2 + g2 * x1
            b02 += both * g0 * g2 + g0 * x2 + g2 * x0
        rhs[i] += t0
        rhs[i + 1] += t1
        rhs[i + 2] += t2
        band[i, 0] += b00
        band[i + 1, 0] += b11
        band[i + 2, 0] += b22
        band[i + 1, 1] += b01
        band[i + 2, 1] += b12
        band[i + 2, 2] += b02
    for i in range(m + 1):
        g0, g1 = point[i, 0] / ceiling[i], point[i, 1] / ceiling[i]
        w, p = _weights(mu[min(i, m - 1)], rooms[0][i], slacks[0][i], duals[0][i])
        b00, b11, b01 = w * g0 * g0, w * g1 * g1, w * g0 * g1
        t0, t1 = -p * g0, -p * g1
        for k in range(nj):
            d0, d1 = a[i, k]
            low, p_low = _weights(mu[min(i, m - 1)], rooms[1][i, k, 0], slacks[1][i, k, 0], duals[1][i, k, 0])
            high, p_high = _weights(mu[min(i, m - 1)], rooms[1][i, k, 1], slacks[1][i, k, 1], duals[1][i, k, 1])
            w, p = low + high, p_high - p_low
            b00 += w * d0 * d0
            b11 += w * d1 * d1
            b01 += w * d0 * d1
            t0 += p * d0
            t1 += p * d1
        rhs[i] += t0
        rhs[i + 1] += t1
        band[i, 0] += b00
        band[i + 1, 0] += b11
        band[i + 1, 1] += b01


@njit(cache=True)
def _keep_level(level: tuple[bool, bool], rhs: Array, band: Array) -> None:
    """Make the outermost two coefficients one variable, where x has to leave the grid with slope 0."""
    m = len(rhs) - 2
    if level[0]:
        rhs[1] += rhs[0]
        band[1, 0] += band[0, 0] + 2.0 * band[1, 1]
        band[2, 1] += band[2, 2]
        rhs[0], band[0, 0], band[1, 1], band[2, 2] = 0.0, 1.0, 0.0, 0.0
    if level[1]:
        rhs[m] += rhs[m + 1]
        band[m, 0] += band[m + 1, 0] + 2.0 * band[m + 1, 1]
        band[m, 1] += band[m + 1, 2]
        rhs[m + 1], band[m + 1, 0], band[m + 1, 1], band[m + 1, 2] = 0.0, 1.0, 0.0, 0.0


@njit(cache=True)
def _hold(ends: tuple[bool, bool], rhs: Array, band: Array) -> None:
    """Leave the outermost two coefficients where they are, at the ends where the grid goes on: settled intervals see
    them too."""
    m = len(rhs) - 2
    if ends[0]:
        band[2, 1] = band[2, 2] = band[3, 2] = 0.0
        for i in range(2):
            rhs[i], band[i, 0], band[i, 1], band[i, 2] = 0.0, 1.0, 0.0, 0.0
    if ends[1]:
        for i in range(m, m + 2):
            rhs[i], band[i, 0], band[i, 1], band[i, 2] = 0.0, 1.0, 0.0, 0.0


@njit(cache=True)
def _solve(band: Array, rhs: Array) -> bool:
    """Solve in place by Cholesky's method; False if the matrix is not positive definite.

    band (n, 3): the diagonal, and the entries one and two to the left of it.
    """
    n = len(rhs)
    for i in range(n):
        l2 = 0.0
        l1 = band[i, 1]
        if i > 1:
            l2 = band[i, 2] / band[i - 2, 0]
            l1 -= l2 * band[i - 1, 1]
        if i > 0:
            l1 /= band[i - 1, 0]
        d = band[i, 0] - l1 * l1 - l2 * l2
        if not d > 0.0:
            return False
        band[i, 0], band[i, 1], band[i, 2] = np.sqrt(d), l1, l2
        value = rhs[i]
        if i > 0:
            value -= l1 * rhs[i - 1]
        if i > 1:
            value -= l2 * rhs[i - 2]
        rhs[i] = value / band[i, 0]
    for i in range(n - 1, -1, -1):
        value = rhs[i]
        if i + 1 < n:
            value -= band[i + 1, 1] * rhs[i + 1]
        if i + 2 < n:
            value -= band[i + 2, 2] * rhs[i + 2]
        rhs[i] = value / band[i, 0]
    return True
