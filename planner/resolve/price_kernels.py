"""Compiled: what a path costs, the quadratic program around it, and what it watches of rates and ranges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.compiled import njit
from planner.resolve.cone_kernels import facet
from planner.resolve.prices import (
    DIP,
    DIP_PRICE,
    EFFORT,
    HARD_PRICE,
    LIMIT_COMFORT,
    LIMIT_PRICE,
    PEAK_PRICE,
    SIGMA_COMFORT,
    SIGMA_PRICE,
)
from planner.resolve.quadratic import SUMS

# ----------------------------------------------------------------------------------------------------
# What a path costs, compiled.
#
# The price of a path is in seconds. At the commanded speed v the joints' rates are known from the path, so each
# sample has a greatest speed that the limits allow, v / (1 + slack): the slack is the share of its time that is lost.
#
#     price = sum over samples of  step * (deposits * lost(slack) + effort + closeness + excess)
#
# lost is the time that a slack loses, and a little for every dip.
# effort is small and grows with the squares of the rates' shares of their limits, ever more slowly beyond them: of two
# choices at full speed the calmer one wins. Where no time is lost anyway, peaks of the joints' speed are part of it.
# closeness grows towards singularities of the arm and the ends of the joints' ranges.
# excess is dear: what goes beyond bounds. Tilt, and ends of beads that move, are priced in `refine`.


@njit(cache=True, nogil=True, error_model="numpy")
def differentiate(values, centre, D, out) -> None:
    """Fill out (n, 3, k) with the first three time derivatives of values (n, k)."""
    n, k = values.shape
    for i in range(n):
        for o in range(3):
            for j in range(k):
                total = 0.0
                for s in range(5):
                    total += D[i, o, s] * values[centre[i] + s - 2, j]
                out[i, o, j] = total


@njit(cache=True, nogil=True, error_model="numpy")
def allowed(order: int, slack: float):
    """Bound of a rate's share of its limit at a slack, linear from there on, and its slope: (1 + slack)^order."""
    if order == 0:
        return 1.0 + slack, 1.0
    if order == 1:
        return (1.0 + slack) ** 2, 2.0 * (1.0 + slack)
    return (1.0 + slack) ** 3, 3.0 * (1.0 + slack) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def lost(slack: float) -> float:
    """Price a second of a slack: the time lost, and that there is a dip at all."""
    return slack + DIP_PRICE * slack / (slack + DIP)


@njit(cache=True, nogil=True, error_model="numpy")
def lost_slope(slack: float) -> float:
    """Derivative of `lost`, which is concave: its tangent is never below it."""
    return 1.0 + DIP_PRICE * DIP / (slack + DIP) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def price_of(rates, limits, step, deposits, q, low, high, sigma, least_sigma, bounds, peak, slack):
    """Price of a path [s]; fills slack (n). bounds (n, b): what must not be positive, for instance a cone's excess.

    peak: see `peak_price`.
    """
    n, _, nj = rates.shape
    na = low.size
    total = 0.0
    for i in range(n):
        v, a, y = 0.0, 0.0, 0.0
        for j in range(nj):
            v = max(v, abs(rates[i, 0, j]) / limits[0, j])
            a = max(a, abs(rates[i, 1, j]) / limits[1, j])
            y = max(y, abs(rates[i, 2, j]) / limits[2, j])
        slack[i] = max(v, np.sqrt(a), np.cbrt(y), 1.0) - 1.0
        effort = 0.0
        for o in range(3):
            for j in range(nj):
                square = (rates[i, o, j] / limits[o, j]) ** 2
                effort += EFFORT[o] * square / (1.0 + square)
        cost = deposits[i] * lost(slack[i]) + effort / nj
        close = max(0.0, SIGMA_COMFORT / sigma[i] - 1.0)
        cost += SIGMA_PRICE * close * close + deposits[i] * HARD_PRICE * max(0.0, least_sigma - sigma[i])
        for j in range(na):
            room = min(q[i, j] - low[j], high[j] - q[i, j])
            near = max(0.0, 1.0 - room / LIMIT_COMFORT)
            cost += LIMIT_PRICE * near * near + HARD_PRICE * max(0.0, -room)
        for c in range(bounds.shape[1]):
            cost += HARD_PRICE * max(0.0, bounds[i, c])
        total += step[i] * cost
    return total + peak_price(rates, step, peak)


@njit(cache=True, nogil=True, error_model="numpy")
def peak_price(rates, step, peak):
    """Price [s] of peaks of the joints' speed in rates (n, 3, nj): of its eighth power, PEAK_PRICE at the speed `peak`."""
    n, _, nj = rates.shape
    total = 0.0
    if peak < np.inf:
        for i in range(n):
            for j in range(nj):
                total += step[i] * (rates[i, 0, j] / peak) ** 8
    return PEAK_PRICE / nj * total


# ----------------------------------------------------------------------------------------------------
# What a program watches of rates and ends of ranges, compiled: what is near from the start, and what a step has missed.

NEAR_RATE = 0.7  # share of a rate's limit above which the program watches it from the start
MISSED = 1e-2  # slack that a rate must ask for beyond the watched ones before the program watches it too
_NEAR_END = 0.7  # of what a step may move a joint: who is as near to the end of its range has it watched from the start
_MISSED_END = 1e-5  # rad beyond that end that the program must go before it watches it too


@njit(cache=True, nogil=True, error_model="numpy")
def watch_near(rates, limits, deposits, slack, watch) -> None:
    """Mark in watch (n, 3, nj, 2), upwards and downwards, the rates that are near what their sample's slack allows."""
    n, _, nj = rates.shape
    for i in range(n):
        for o in range(3):
            bound, _ = allowed(o, slack[i])
            for j in range(nj):
                if deposits[i] > 0.0 and abs(rates[i, o, j]) > NEAR_RATE * bound * limits[o, j]:
                    watch[i, o, j, 0 if rates[i, o, j] > 0.0 else 1] = True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def watch_missed(rates, limits, deposits, slack, slopes, at, x, watch):
    """Mark the rates that a step x takes beyond what the watched ones of their sample ask for; returns how many.

    slopes (n, 3 nj, w) are those of `rate_slopes`, from the variable at (n) on.
    """
    n, _, nj = rates.shape
    w = slopes.shape[2]
    over, own = np.empty((3, nj, 2)), np.empty(w)
    missed = 0
    for i in range(n):
        if deposits[i] == 0.0:
            continue
        for p in range(w):
            own[p] = x[at[i] + p]
        needed = 0.0
        for o in range(3):
            bound, slope = allowed(o, slack[i])
            for j in range(nj):
                share = rates[i, o, j] / limits[o, j]
                for p in range(w):
                    share += slopes[i, o * nj + j, p] * own[p]
                for side in range(2):
                    over[o, j, side] = ((share if side == 0 else -share) - bound) / slope + slack[i]
                    if watch[i, o, j, side]:
                        needed = max(needed, over[o, j, side])
        for o in range(3):
            for j in range(nj):
                for side in range(2):
                    if over[o, j, side] > needed + MISSED and not watch[i, o, j, side]:
                        watch[i, o, j, side] = True
                        missed += 1
    return missed


@njit(cache=True, nogil=True, error_model="numpy")
def watch_near_ends(q, G, low, high, step, trust, watch) -> None:
    """Mark in watch (n, na) the arm's joints that a share of a step within `trust` [rad] may take to the end of their range
    that is nearer now."""
    for i in range(len(q)):
        if step[i] > 0.0:
            for j in range(low.size):
                reach = 0.0
                for c in range(G.shape[2]):
                    reach += abs(G[i, j, c])
                watch[i, j] = min(q[i, j] - low[j], high[j] - q[i, j]) < _NEAR_END * trust * reach


@njit(cache=True, nogil=True, error_model="numpy")
def watch_missed_ends(now, then, low, high, step, watch):
    """Mark in watch (n, na) the ends that joints `then` (n, nj) go beyond, of those nearer `now`; returns how many."""
    missed = 0
    for i in range(len(now)):
        if step[i] > 0.0:
            for j in range(low.size):
                below = now[i, j] - low[j] < high[j] - now[i, j]
                room = then[i, j] - low[j] if below else high[j] - then[i, j]
                if room < -_MISSED_END and not watch[i, j]:
                    watch[i, j] = True
                    missed += 1
    return missed


# ----------------------------------------------------------------------------------------------------
# The quadratic program around a path, compiled: its price (see `price_kernels`) to first order, with a convex second one.

NEAR_SIGMA = 1.3  # times the least singular value allowed below which the program has a row for it
_TOGETHER = 8  # samples at most whose effort is one product of matrices: few enough for one thread


class JointBounds(NamedTuple):
    """Bounds of joints: limits (3, nj) of velocity, acceleration, jerk [rad/s and so on]; low, high (na) ends of the
    ranges of the arm's joints [rad]."""

    limits: Array
    low: Array
    high: Array


class SplineSamples(NamedTuple):
    """Samples (n) of a stretch and the control values (k) that they depend on, as in `PathSegment`."""

    step: Array
    deposits: Array
    first: Ints
    B: Array
    free: Array


class PathSlopes(NamedTuple):
    """A path at its samples (n), and its slopes by the free variables (m), as in `PathState`; of b cones."""

    rates: Array
    slack: Array
    q: Array
    G: Array
    sigma: Array
    sigma_slope: Array
    lean: Array
    lean_slope: Array
    cones: Array


class RowsWatched(NamedTuple):
    """What has rows, as in `Watch`: rates (n, 3, nj, 2), the arm's joints (n, na) at ends, facets (n, b, facets)."""

    rates: Flags
    ends: Flags
    facets: Flags


class RowsFilled(NamedTuple):
    """The arrays A (r, w), b, at (r), group (k + 1) and price (k) of a `QuadraticProgram`, to be filled."""

    A: Array
    b: Array
    at: Ints
    group: Ints
    price: Array


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def rate_slopes(limits, G, centre, D, first, B, free, slopes) -> None:
    """Fill slopes (n, 3 nj, w) with the slopes of the rates, as shares of their limits, by the control values.

    free (controls) is 1 for those that may move, else 0. q(t) moves by G(t) times the spline of x: its rates by the
    product rule, with rates of G by differences.
    """
    n, nj, m = G.shape
    nb = B.shape[2]
    Gd, Bf = np.empty((3, nj, m)), np.empty((4, nb))
    for i in range(n):
        for e in range(nb):
            for o in range(4):
                Bf[o, e] = B[i, o, e] * free[first[i] + e]
        s = centre[i]
        for o in range(3):
            d0, d1, d2, d3, d4 = D[i, o, 0], D[i, o, 1], D[i, o, 2], D[i, o, 3], D[i, o, 4]
            for j in range(nj):
                for c in range(m):
                    Gd[o, j, c] = (
                        d0 * G[s - 2, j, c]
                        + d1 * G[s - 1, j, c]
                        + d2 * G[s, j, c]
                        + d3 * G[s + 1, j, c]
                        + d4 * G[s + 2, j, c]
                    )
        for j in range(nj):
            v, y, z = 1.0 / limits[0, j], 1.0 / limits[1, j], 1.0 / limits[2, j]
            for e in range(nb):
                b0, b1, b2, b3 = Bf[0, e], Bf[1, e], Bf[2, e], Bf[3, e]
                for c in range(m):
                    g0, g1, g2, g3 = G[i, j, c], Gd[0, j, c], Gd[1, j, c], Gd[2, j, c]
                    p = e * m + c
                    slopes[i, j, p] = v * (g0 * b1 + g1 * b0)
                    slopes[i, nj + j, p] = y * (g0 * b2 + 2.0 * g1 * b1 + g2 * b0)
                    slopes[i, 2 * nj + j, p] = z * (g0 * b3 + 3.0 * g1 * b2 + 3.0 * g2 * b1 + g3 * b0)


@njit(cache=True, nogil=True, error_model="numpy")
def foreseen(q, G, moved):
    """Joints (n, nj) that a move of the free variables by moved (n, m) leads to, to first order."""
    out = q.copy()
    for i in range(len(q)):
        for j in range(q.shape[1]):
            for c in range(moved.shape[1]):
                out[i, j] += G[i, j, c] * moved[i, c]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def count_rows(step, deposits, watch, watch_end, sigma, least_sigma, watch_lean):
    """Rows (r) and groups (k) that `bound_rows` will write."""
    rows, groups = 0, 0
    for i in range(len(step)):
        if step[i] == 0.0:
            continue
        own = watch[i].sum() if deposits[i] > 0.0 else 0
        rows += own
        groups += 1 if own else 0
        own = watch_end[i].sum()
        rows += own
        groups += own
        if deposits[i] > 0.0 and sigma[i] < NEAR_SIGMA * least_sigma:
            rows += 1
            groups += 1
        for c in range(watch_lean.shape[1]):
            own = watch_lean[i, c].sum()
            rows += own
            groups += 1 if own else 0
    return rows, groups


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def smooth_price(bounds, samples, path, peak, slopes, H, g) -> None:
    """Fill H (n, w), a lower band, and g (n) with the part of the price around a path that has no bounds: effort, peaks, and
    closeness to ends of ranges and to singularities. g is exact, H what is convex: of effort its slope over the rate, of
    peaks all of it. What is held has a one on the diagonal.

    bounds: JointBounds, samples: SplineSamples, path: PathSlopes; peak [rad/s]: see `peak_price`
    slopes (n, 3 nj, w): of `rate_slopes`
    """
    limits, low, high = bounds.limits, bounds.low, bounds.high
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    rates, q, G, sigma, sigma_slope = path.rates, path.q, path.G, path.sigma, path.sigma_slope
    n, _, nj = rates.shape
    m = G.shape[2]
    w = slopes.shape[2]
    scaled, product = np.empty((_TOGETHER, 3 * nj, w)), np.empty((w, w))
    row = np.empty(w)
    H[:] = 0.0
    g[:] = 0.0
    for k in range(free.size):
        if free[k] == 0.0:
            for c in range(m):
                H[k * m + c, 0] = 1.0
    start = 0
    while start < n:
        end = start + 1
        while end < n and end - start < _TOGETHER and first[end] == first[start]:
            end += 1
        at = first[start] * m
        for i in range(start, end):
            for o in range(3):
                for j in range(nj):
                    r = o * nj + j
                    share = rates[i, o, j] / limits[o, j]
                    weight = 2.0 * step[i] * EFFORT[o] / nj / (1.0 + share * share) ** 2
                    slope = share * weight
                    if o == 0 and peak < np.inf:
                        unit = limits[0, j] / peak
                        own = 8.0 * PEAK_PRICE * step[i] / nj * unit * unit * (unit * share) ** 6
                        slope += share * own
                        weight += 7.0 * own
                    for p in range(w):
                        scaled[i - start, r, p] = weight * slopes[i, r, p]
                        g[at + p] += slope * slopes[i, r, p]
        rows = 3 * nj * (end - start)
        np.dot(scaled[: end - start].reshape(rows, w).T, slopes[start:end].reshape(rows, w), product)
        for p in range(w):
            for d in range(p + 1):
                H[at + p, d] += product[p, p - d]
        start = end
    for i in range(n):
        if step[i] == 0.0:
            continue
        at = first[i] * m
        for j in range(low.size):
            room_low, room_high = q[i, j] - low[j], high[j] - q[i, j]
            near = 1.0 - min(room_low, room_high) / LIMIT_COMFORT
            if near > 0.0:
                sign = (-1.0 if room_low < room_high else 1.0) / LIMIT_COMFORT
                _row_of(i, sign, G[i, j], first, B, free, row)
                _add(H, g, at, row, 2.0 * step[i] * LIMIT_PRICE, near)
        close = SIGMA_COMFORT / sigma[i] - 1.0
        if close > 0.0:
            _row_of(i, -SIGMA_COMFORT / (sigma[i] * sigma[i]), sigma_slope[i], first, B, free, row)
            _add(H, g, at, row, 2.0 * step[i] * SIGMA_PRICE, close)


@njit(cache=True, nogil=True, error_model="numpy")
def _row_of(i, factor, by_z, first, B, free, row) -> None:
    """Fill row (w) with factor times the slope by the control values of what has the slope by_z (m) at sample i."""
    m = by_z.size
    for e in range(B.shape[2]):
        share = factor * B[i, 0, e] * free[first[i] + e]
        for c in range(m):
            row[e * m + c] = share * by_z[c]


@njit(cache=True, nogil=True, error_model="numpy")
def bound_rows(bounds, least_sigma, samples, path, slopes, watch, rows) -> None:
    """Fill the rows of what is watched around a path whose control values move by x, and the price of their slacks.

    bounds: JointBounds, samples: SplineSamples, path: PathSlopes, watch: RowsWatched, rows: RowsFilled
    least_sigma: that a sample in deposition must have; slopes (n, 3 nj, w): of `rate_slopes`
    """
    limits, low, high = bounds.limits, bounds.low, bounds.high
    step, deposits, first, B, free = samples.step, samples.deposits, samples.first, samples.B, samples.free
    rates, slack, q, G, sigma, sigma_slope = path.rates, path.slack, path.q, path.G, path.sigma, path.sigma_slope
    lean, lean_slope, cones = path.lean, path.lean_slope, path.cones
    watch_rates, watch_end, watch_lean = watch.rates, watch.ends, watch.facets
    A, b, at, group, price = rows.A, rows.b, rows.at, rows.group, rows.price
    n, _, nj = rates.shape
    m, w = G.shape[2], slopes.shape[2]
    r, k = 0, 0
    group[0] = 0
    for i in range(n):
        if step[i] == 0.0:
            continue
        at_i = first[i] * m
        # lost time: all rates of a sample share its slack
        if deposits[i] > 0.0:
            own = 0
            for o in range(3):
                bound, slope = allowed(o, slack[i])
                for j in range(nj):
                    share = rates[i, o, j] / limits[o, j]
                    for side in range(2):
                        if watch_rates[i, o, j, side]:
                            sign = 1.0 if side == 0 else -1.0
                            for p in range(w):
                                A[r, p] = sign * slopes[i, o * nj + j, p] / slope
                            b[r] = (bound - sign * share) / slope - slack[i]
                            at[r] = at_i
                            r += 1
                            own += 1
            if own:
                price[k] = step[i] * deposits[i] * lost_slope(slack[i])
                k += 1
                group[k] = r
        # closeness to the ends of the joints' ranges
        for j in range(low.size):
            if watch_end[i, j]:
                room_low, room_high = q[i, j] - low[j], high[j] - q[i, j]
                _row_of(i, -1.0 if room_low < room_high else 1.0, G[i, j], first, B, free, A[r])
                b[r] = min(room_low, room_high)
                at[r] = at_i
                price[k] = step[i] * HARD_PRICE
                r += 1
                k += 1
                group[k] = r
        # closeness to singularities
        if deposits[i] > 0.0 and sigma[i] < NEAR_SIGMA * least_sigma:
            _row_of(i, -1.0, sigma_slope[i], first, B, free, A[r])
            b[r] = sigma[i] - least_sigma
            at[r] = at_i
            price[k] = step[i] * HARD_PRICE
            r += 1
            k += 1
            group[k] = r
        # cones: of a direction's lean, all facets share a slack
        for v in range(cones.size):
            own = 0
            for f in range(watch_lean.shape[2]):
                if watch_lean[i, v, f]:
                    u_x, u_y = facet(lean[i, v], f)
                    for e in range(B.shape[2]):
                        share = B[i, 0, e] * free[first[i] + e]
                        for c in range(m):
                            slope = u_x * lean_slope[i, v, 0, c] + u_y * lean_slope[i, v, 1, c]
                            A[r, e * m + c] = slope * share
                    b[r] = cones[v] - u_x * lean[i, v, 0] - u_y * lean[i, v, 1]
                    at[r] = at_i
                    r += 1
                    own += 1
            if own:
                price[k] = step[i] * HARD_PRICE
                k += 1
                group[k] = r


@njit(cache=True, nogil=True, error_model="numpy")
def price_tilt(step, tilt, price, first, B, free, columns, H, g) -> None:
    """Add what tilt (n, 2) costs, in the control values' columns (2), to the program."""
    m = len(g) // len(free)
    row = np.zeros(B.shape[2] * m)
    for i in range(len(step)):
        for k in range(2):
            row[:] = 0.0
            for e in range(B.shape[2]):
                row[e * m + columns[k]] = B[i, 0, e] * free[first[i] + e]
            _add(H, g, first[i] * m, row, 2.0 * step[i] * price, tilt[i, k])


@njit(cache=True, nogil=True, error_model="numpy")
def _add(H, g, at, row, weight, value) -> None:
    """Add weight / 2 (value + row x)^2 to the program."""
    for c in range(row.size):
        scaled = weight * row[c]
        g[at + c] += scaled * value
        for d in range(c + 1):
            H[at + c, c - d] += scaled * row[d]
