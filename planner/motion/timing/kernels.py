"""The fastest jerk-limited profile along a path: a primal-dual interior-point method, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit

# ----------------------------------------------------------------------------------------------------
# Bundles of arguments of the kernels.


class LimitRows(NamedTuple):
    """The limits of a leg of m intervals and nj joints, as rows that are multiplied by coefficients c (m + 2).

    point (m + 1, 2)              x at grid point i from c[i : i + 2]
    middle (m, 3)                 x in the middle of interval i from c[i : i + 3]
    ends (2 m, 3)                 x at its two ends, rows 2 i and 2 i + 1, from the same coefficients
    acceleration (m + 1, nj, 2)   shares of the acceleration limit at points
    jerk (2 m, nj, 3)             shares of the jerk limit over sqrt(x) at ends
    ceiling (m + 1)               largest x at points
    h (m)                         widths of the intervals
    """

    point: Array
    middle: Array
    ends: Array
    acceleration: Array
    jerk: Array
    ceiling: Array
    h: Array


class OfLimits(NamedTuple):
    """One value for each side of each limit: of x (m + 1), of acceleration (m + 1, nj, 2), of jerk (2 m, nj, 2)."""

    x: Array
    acceleration: Array
    jerk: Array


@njit(inline="always")
def _rows_of(limits: LimitRows, at: slice, on: slice, ends: slice) -> LimitRows:
    """The rows of some points, intervals and ends."""
    acceleration, jerk = limits.acceleration[at], limits.jerk[ends]
    return LimitRows(
        limits.point[at], limits.middle[on], limits.ends[ends], acceleration, jerk, limits.ceiling[at], limits.h[on]
    )


@njit(inline="always")
def _values_of(values: OfLimits, at: slice, ends: slice) -> OfLimits:
    """The values of the limits at some points and ends."""
    return OfLimits(values.x[at], values.acceleration[at], values.jerk[ends])


# ----------------------------------------------------------------------------------------------------
# Running minimum and mean of values at ordered places: compiled.


@njit
def least_nearby(values: Array, at: Array, reach: float) -> Array:
    """Running minimum (n) of values (n) at places `at` (n), which never decrease, within `reach` of each place."""
    n = len(values)
    out = np.empty(n)
    waiting = np.empty(n, dtype=np.int64)  # candidates for later minima, with growing values
    first, last, ahead = 0, -1, 0
    for i in range(n):
        while ahead < n and at[ahead] <= at[i] + reach:
            while last >= first and values[waiting[last]] >= values[ahead]:
                last -= 1
            last += 1
            waiting[last] = ahead
            ahead += 1
        while at[waiting[first]] < at[i] - reach:
            first += 1
        out[i] = values[waiting[first]]
    return out


@njit
def mean_nearby(values: Array, at: Array, reach: float) -> Array:
    """Running mean (n) of values (n) at places `at` (n), which never decrease, within `reach` of each place."""
    n = len(values)
    out = np.empty(n)
    low, high, total = 0, 0, 0.0
    for i in range(n):
        while high < n and at[high] <= at[i] + reach:
            total += values[high]
            high += 1
        while at[low] < at[i] - reach:
            total -= values[low]
            low += 1
        out[i] = total / (high - low)
    return out


# ----------------------------------------------------------------------------------------------------
# Step lengths of the interior-point method, which vary slowly along a leg: compiled.
#
# A step's length is bounded by the place where a limit would be overrun first. Only the neighbourhood of that place
# needs a shorter step: the residuals that a varying length adds are small if it varies over many intervals, and the
# next step accounts for them.

APART = 256  # intervals over which step lengths change: thirty times what an arm takes to build up acceleration
_TO_BOUNDARY = 0.99  # share of the way to the nearest limit that a step may go
_POSITIVE = 0.9  # share of the way to rest that a step may go


@inner_njit
def even_out(lengths: Array, sums: Array, mins: Array) -> None:
    """Lower lengths (m), in place, until they change slowly; sums (m + 1) and mins (m) are work space."""
    m = len(lengths)
    blocks = (m + APART - 1) // APART
    for b in range(blocks):
        sums[b] = lengths[b * APART : min((b + 1) * APART, m)].min()
    for b in range(blocks):
        least = min(sums[max(b - 1, 0)], sums[b], sums[min(b + 1, blocks - 1)])
        mins[b * APART : min((b + 1) * APART, m)] = least
    average(mins, np.int64(APART // 2), sums, lengths)
    for i in range(m):
        mins[i] = lengths[i]
    average(mins, np.int64(APART // 2), sums, lengths)


@inner_njit
def average(values: Array, half: int, sums: Array, out: Array) -> None:
    """Fill out (m) with the means of values (m) over `half` neighbours on each side; sums (m + 1) is work space."""
    m = len(values)
    sums[0] = 0.0
    for i in range(m):
        sums[i + 1] = sums[i] + values[i]
    for i in range(m):
        low, high = max(i - half, 0), min(i + half + 1, m)
        out[i] = (sums[high] - sums[low]) / (high - low)


@njit(inline="always")
def _falls(mu: float, ds: float, slack: float, dual: float) -> tuple[float, float]:
    """Shares of themselves by which a slack, changed by ds, and its dual fall in a full step."""
    fall = -ds / slack
    return fall, 1.0 - fall - mu / (slack * dual)


@inner_njit
def lengths_of(
    c: Array,
    step: Array,
    limits: LimitRows,
    mu: Array,
    rooms: OfLimits,
    slacks: OfLimits,
    duals: OfLimits,
    primal_lengths: Array,
    dual_lengths: Array,
) -> None:
    """Step lengths allowed by each interval, of c and slacks (m) and of duals (m); rooms become the slacks' steps."""
    point, middle, end, a, j, ceiling, _ = limits
    m, nj = len(middle), a.shape[1]
    positive = _TO_BOUNDARY / _POSITIVE
    for i in range(m):
        primal, dual = _TO_BOUNDARY, _TO_BOUNDARY  # largest falls
        x = middle[i, 0] * c[i] + middle[i, 1] * c[i + 1] + middle[i, 2] * c[i + 2]
        dx = middle[i, 0] * step[i] + middle[i, 1] * step[i + 1] + middle[i, 2] * step[i + 2]
        primal = max(primal, -positive * dx / x)
        for e in range(2 * i, 2 * i + 2):
            x = end[e, 0] * c[i] + end[e, 1] * c[i + 1] + end[e, 2] * c[i + 2]
            dx = end[e, 0] * step[i] + end[e, 1] * step[i + 1] + end[e, 2] * step[i + 2]
            primal = max(primal, -positive * dx / x)
            dr = -0.5 * dx / (x * np.sqrt(x))
            for k in range(nj):
                change = j[e, k, 0] * step[i] + j[e, k, 1] * step[i + 1] + j[e, k, 2] * step[i + 2]
                for side in range(2):
                    s = slacks.jerk[e, k, side]
                    ds = rooms.jerk[e, k, side] - s + (dr - change if side == 0 else dr + change)
                    rooms.jerk[e, k, side] = ds
                    fall, dual_fall = _falls(mu[i], ds, s, duals.jerk[e, k, side])
                    primal, dual = max(primal, fall), max(dual, dual_fall)
        primal_lengths[i], dual_lengths[i] = primal, dual
    for i in range(m + 1):
        at = min(i, m - 1)
        s = slacks.x[i]
        ds = rooms.x[i] - s - (point[i, 0] * step[i] + point[i, 1] * step[i + 1]) / ceiling[i]
        rooms.x[i] = ds
        primal, dual = _falls(mu[at], ds, s, duals.x[i])
        for k in range(nj):
            change = a[i, k, 0] * step[i] + a[i, k, 1] * step[i + 1]
            for side in range(2):
                s = slacks.acceleration[i, k, side]
                ds = rooms.acceleration[i, k, side] - s + (-change if side == 0 else change)
                rooms.acceleration[i, k, side] = ds
                fall, dual_fall = _falls(mu[at], ds, s, duals.acceleration[i, k, side])
                primal, dual = max(primal, fall), max(dual, dual_fall)
        primal_lengths[at] = max(primal_lengths[at], primal)
        dual_lengths[at] = max(dual_lengths[at], dual)
    for i in range(m):
        primal_lengths[i], dual_lengths[i] = _TO_BOUNDARY / primal_lengths[i], _TO_BOUNDARY / dual_lengths[i]


@inner_njit
def go(c: Array, step: Array, middle: Array, end: Array, lengths: Array) -> None:
    """Move c along its step, in place, by lengths (m).

    If x would not stay positive, the least of the lengths is used throughout and replaces the others.
    """
    m = len(lengths)
    for i in range(m + 2):
        c[i] += lengths[min(max(i - 1, 0), m - 1)] * step[i]
    least = np.inf
    for i in range(m):
        for row in (middle[i], end[2 * i], end[2 * i + 1]):
            least = min(least, row[0] * c[i] + row[1] * c[i + 1] + row[2] * c[i + 2])
    if not least > 0.0:
        for i in range(m + 2):
            c[i] -= (lengths[min(max(i - 1, 0), m - 1)] - lengths.min()) * step[i]
        lengths[:] = lengths.min()


@inner_njit
def move(
    primal: Array, dual: Array, mu: Array, steps: Array, slacks: Array, duals: Array, places: int, gaps: Array
) -> None:  # fmt: skip
    """Move slacks and duals along their steps by these lengths, in place; add their products to gaps (m).

    places: at how many places the limits act, equally many at each: points, or two ends per interval.
    """
    m = len(primal)
    each, ends = len(slacks) // places, 2 if places == 2 * m else 1
    for e in range(places):
        i = min(e // ends, m - 1)
        for k in range(e * each, (e + 1) * each):
            s, y = slacks[k], duals[k]
            y += dual[i] * ((mu[i] - y * steps[k]) / s - y)
            s += primal[i] * steps[k]
            slacks[k], duals[k] = s, y
            gaps[i] += s * y


# ----------------------------------------------------------------------------------------------------
# Settled and unsettled blocks of intervals, and where a place's limits are in the flat arrays of all limits: compiled.


@inner_njit
def runs_of(unsettled: NDArray[np.bool_], m: int) -> list[tuple[int, int]]:
    """First interval, and the one after the last, of runs of neighbouring blocks that are unsettled."""
    out = []
    first = -1
    for b in range(len(unsettled) + 1):
        now = b < len(unsettled) and unsettled[b]
        if now and first < 0:
            first = b
        elif not now and first >= 0:
            out.append((first * APART, min(b * APART, m)))
            first = -1
    return out


@njit(inline="always")
def limits_of(
    at: slice, ends: slice, m: int, nj: int
) -> tuple[tuple[slice, int], tuple[slice, int], tuple[slice, int]]:
    """Slices of the flat arrays for the limits of some points and ends, and how many places: x, acceleration, jerk."""
    first, last = m + 1, (m + 1) * (1 + 2 * nj)
    points = at.stop - at.start
    return (
        (at, points),
        (slice(first + 2 * nj * at.start, first + 2 * nj * at.stop), points),
        (slice(last + 2 * nj * ends.start, last + 2 * nj * ends.stop), ends.stop - ends.start),
    )


@inner_njit
def split(flat: Array, m: int, nj: int) -> OfLimits:
    """Views of a flat array (count), one value for each side of each limit: those of x, acceleration and jerk."""
    first, last = m + 1, (m + 1) * (1 + 2 * nj)
    return OfLimits(flat[:first], flat[first:last].reshape((m + 1, nj, 2)), flat[last:].reshape((2 * m, nj, 2)))


@inner_njit
def overrun(room: Array, slack: Array) -> float:
    """Largest amount, as a share of a limit, by which the room falls short of the slack."""
    worst = -np.inf
    for i in range(len(room)):
        worst = max(worst, slack[i] - room[i])
    return worst


# ----------------------------------------------------------------------------------------------------
# The fastest jerk-limited profile along a path: a primal-dual interior-point method, compiled.
#
# Notation: x is the squared rate of the path parameter, a quadratic B-spline with coefficients c (m + 2) over m
# intervals of widths h, so that the acceleration x'/2 is continuous and jerk limits bind x'' interval by interval:
#
#     |q' x'/2 + q'' x|                 <= a_max            at grid points
#     |q' x''/2 + 3/2 q'' x' + q''' x|  <= j_max / sqrt(x)  at both ends of every interval
#     x                                 <= ceiling          at grid points
#
# The time, the sum of h / sqrt(x), is convex. So is 1/sqrt(x), which makes the jerk limits the only non-convex part:
# they bound a linear function by a convex one. In every step the convex function is replaced by its tangent, which lies
# below it, so a step within the tangents is within the limits. Only the curvature of the limits is neglected, and the
# linear systems, banded with half-bandwidth 2, stay positive definite.
#
# Places that are far apart do not affect each other: each has its own step length and gap (`lengths_of`, `even_out`),
# so that one hard place does not hold up all others. Settled places are left alone while the others continue.
#
# Debrouwere et al., "Time-optimal path following for robots with convex-concave constraints using sequential convex
# programming", IEEE T-RO 2013, solve the same program with a general solver, as a sequence of convex programs.

OVERRUN = 1e-3  # share of a limit: greatest overrun of a solution; callers keep a larger reserve
_STEPS = 80  # at most: 20 to 40 are usual
_LEAST_SLACK = 1e-1  # share of a limit: least initial slack, even where the start overruns it; less keeps steps short
_FIRST_GAP = 1.0  # share of the time: initial duality gap; with less or more, the first steps are short
_FASTEST_FALL = 0.1  # least share of itself to which the gap may fall in one step
# A block of intervals is settled once its steps are not shortened, its gap is at its least, and it keeps its limits.
_FULL = 0.99  # of a full step: longer ones count as not shortened
_AT_REST = 1.5  # × the least gap
_KEPT = 0.1  # × OVERRUN: limits of a settled block are overrun by less
_LEAST_GAP = 0.05  # × each limit's share of the gap that the accuracy allows: a smaller gap gains nothing


@njit
def fastest(
    limits: LimitRows, start: Array, level: tuple[bool, bool], accuracy: float, wanted: NDArray[np.bool_]
) -> tuple[Array, bool]:
    """Coefficients c (m + 2) of the fastest profile, and whether it was found to the required accuracy.

    start (m + 2): positive, need not keep the limits; level: whether x is constant before and after the grid; accuracy:
    share of the time by which the optimum may be missed; wanted (blocks of APART intervals): those to optimise, all
    others keep their start values.
    """
    middle, end, h = limits.middle, limits.ends, limits.h
    m, nj = len(h), limits.acceleration.shape[1]
    c = start.copy()
    # all limits in flat arrays, those of x, acceleration and jerk in order, with views (`OfLimits`) of each kind
    jerks = (m + 1) * (2 * nj + 1)
    count = jerks + 4 * m * nj
    room, slack, price = np.empty(count), np.empty(count), np.empty(count)
    rooms, slacks, duals = split(room, m, nj), split(slack, m, nj), split(price, m, nj)
    _rooms(c, limits, rooms)
    time = _time(c, middle, h)
    mu = np.full(m, _FIRST_GAP * time / count)
    for i in range(count):
        slack[i] = max(room[i], _LEAST_SLACK)  # the room there is, if any
        price[i] = mu[0] / slack[i]
    step, band = np.empty(m + 2), np.empty((m + 2, 3))
    primal, dual, gaps, sums, mins = np.empty(m), np.empty(m), np.zeros(m), np.empty(m + 1), np.empty(m)
    unsettled = wanted.copy()
    over = np.where(wanted, np.inf, -np.inf)  # largest overrun of each block, inf while unknown
    for _ in range(_STEPS):
        runs = runs_of(unsettled, m)
        primal[:] = dual[:] = 1.0
        for lo, hi in runs:
            at, on, ends, all_c = slice(lo, hi + 1), slice(lo, hi), slice(2 * lo, 2 * hi), slice(lo, hi + 2)
            rows, own = _rows_of(limits, at, on, ends), _values_of(rooms, at, ends)
            own_slacks, own_duals = _values_of(slacks, at, ends), _values_of(duals, at, ends)
            _assemble(c[all_c], rows, mu[on], own, own_slacks, own_duals, step[all_c], band[all_c])
            first, last = level[0] and lo == 0, level[1] and hi == m
            _keep_level((first, last), step[all_c], band[all_c])
            _hold((lo > 0, hi < m), step[all_c], band[all_c])
            if not _solve(band[all_c], step[all_c]):
                return c, False
            if first:
                step[0] = step[1]
            if last:
                step[m + 1] = step[m]
            lengths_of(c[all_c], step[all_c], rows, mu[on], own, own_slacks, own_duals, primal[on], dual[on])
        even_out(primal, sums, mins)
        even_out(dual, sums, mins)
        for lo, hi in runs:
            go(c[lo : hi + 2], step[lo : hi + 2], middle[lo:hi], end[2 * lo : 2 * hi], primal[lo:hi])
            for b in range(lo, hi, APART):  # block by block, so that each block's data stays in the cache
                e = min(b + APART, hi)
                at, on = slice(b, e + 1 if e == hi else e), slice(b, e)
                ends, all_c = slice(2 * b, 2 * e), slice(b, e + 2)
                gaps[on] = 0.0
                for which, places in limits_of(at, ends, m, nj):
                    move(primal[on], dual[on], mu[on], room[which], slack[which], price[which], places, gaps[on])
                _rooms(c[all_c], _rows_of(limits, at, on, ends), _values_of(rooms, at, ends))
        gap, time = gaps.sum(), _time(c, middle, h)
        least_mu = _LEAST_GAP * accuracy * time / count
        all_full = True  # after shortened steps the duals miss some conditions, and the gap says too little
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
        average(gaps, np.int64(APART), sums, mu)  # not a literal, whose type differs
        for i in range(m):
            least = min(primal[i], dual[i])
            fall = max(_FASTEST_FALL, (1.0 - least) ** 2) if least > 0.1 else 1.0
            mu[i] = max(mu[i] * m / count * fall, least_mu)
    return c, False


@inner_njit
def _time(c: Array, middle: Array, h: Array) -> float:
    """Total time of all intervals."""
    time = 0.0
    for i in range(len(h)):
        time += h[i] / np.sqrt(middle[i, 0] * c[i] + middle[i, 1] * c[i + 1] + middle[i, 2] * c[i + 2])
    return time


@inner_njit
def _rooms(c: Array, limits: LimitRows, rooms: OfLimits) -> None:
    """Fill `rooms` with the room left to every limit, on both sides."""
    point, middle, end, a, j, ceiling, _ = limits
    m, nj = len(middle), a.shape[1]
    for i in range(m):
        for e in range(2 * i, 2 * i + 2):
            r = 1.0 / np.sqrt(end[e, 0] * c[i] + end[e, 1] * c[i + 1] + end[e, 2] * c[i + 2])
            for k in range(nj):
                value = j[e, k, 0] * c[i] + j[e, k, 1] * c[i + 1] + j[e, k, 2] * c[i + 2]
                rooms.jerk[e, k, 0], rooms.jerk[e, k, 1] = r - value, r + value
    for i in range(len(ceiling)):
        rooms.x[i] = 1.0 - (point[i, 0] * c[i] + point[i, 1] * c[i + 1]) / ceiling[i]
        for k in range(nj):
            value = a[i, k, 0] * c[i] + a[i, k, 1] * c[i + 1]
            rooms.acceleration[i, k, 0], rooms.acceleration[i, k, 1] = 1.0 - value, 1.0 + value


@njit(inline="always")
def _weights(mu: float, room: float, slack: float, dual: float) -> tuple[float, float]:
    """A limit's contribution to the matrix, per square of its gradient, and to the right-hand side, per gradient."""
    inverse = 1.0 / slack
    w = dual * inverse
    return w, mu * inverse - w * (room - slack)


@inner_njit
def _assemble(
    c: Array,
    limits: LimitRows,
    mu: Array,
    rooms: OfLimits,
    slacks: OfLimits,
    duals: OfLimits,
    rhs: Array,
    band: Array,
) -> None:
    """Newton's equations for c, with slacks and duals eliminated: right-hand side, and matrix as `_solve` takes it.

    The two sides of a jerk limit have gradients t g - d and t g + d, with g that of x, t the tangent of 1 / sqrt(x) and
    d the row: their squares are summed over the joints in these terms.
    """
    point, middle, end, a, j, ceiling, h = limits
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
                low, p_low = _weights(mu[i], rooms.jerk[e, k, 0], slacks.jerk[e, k, 0], duals.jerk[e, k, 0])
                high, p_high = _weights(mu[i], rooms.jerk[e, k, 1], slacks.jerk[e, k, 1], duals.jerk[e, k, 1])
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
    room, slack, dual = rooms.acceleration, slacks.acceleration, duals.acceleration
    for i in range(m + 1):
        g0, g1 = point[i, 0] / ceiling[i], point[i, 1] / ceiling[i]
        w, p = _weights(mu[min(i, m - 1)], rooms.x[i], slacks.x[i], duals.x[i])
        b00, b11, b01 = w * g0 * g0, w * g1 * g1, w * g0 * g1
        t0, t1 = -p * g0, -p * g1
        for k in range(nj):
            d0, d1 = a[i, k]
            low, p_low = _weights(mu[min(i, m - 1)], room[i, k, 0], slack[i, k, 0], dual[i, k, 0])
            high, p_high = _weights(mu[min(i, m - 1)], room[i, k, 1], slack[i, k, 1], dual[i, k, 1])
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


@inner_njit
def _keep_level(level: tuple[bool, bool], rhs: Array, band: Array) -> None:
    """Make the outermost two coefficients one variable at ends where x must leave the grid with slope 0."""
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


@inner_njit
def _hold(ends: tuple[bool, bool], rhs: Array, band: Array) -> None:
    """Fix the outermost two coefficients at ends where the grid continues: settled intervals depend on them too."""
    m = len(rhs) - 2
    if ends[0]:
        band[2, 1] = band[2, 2] = band[3, 2] = 0.0
        for i in range(2):
            rhs[i], band[i, 0], band[i, 1], band[i, 2] = 0.0, 1.0, 0.0, 0.0
    if ends[1]:
        for i in range(m, m + 2):
            rhs[i], band[i, 0], band[i, 1], band[i, 2] = 0.0, 1.0, 0.0, 0.0


@inner_njit
def _solve(band: Array, rhs: Array) -> bool:
    """Solve in place by Cholesky factorisation; False if the matrix is not positive definite.

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
