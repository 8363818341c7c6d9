"""Compiled: the terms of a path's price, their parts of the quadratic program around it, and what that watches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints
from planner.base.compiled import inner_njit, njit
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
# What a path costs, compiled: one function for each term of `terms`, where the formulas are given.
#
# The price of a path is in seconds. At the commanded speed v, the joints' rates follow from the path, so each sample
# has a greatest speed that the limits allow, v / (1 + slack): the slack is the share of its time that is lost.


@njit
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


@inner_njit
def allowed(order: int, slack: float):
    """Bound (1 + slack)^(order + 1) on a rate, as a share of its limit, and the bound's slope by the slack."""
    if order == 0:
        return 1.0 + slack, 1.0
    if order == 1:
        return (1.0 + slack) ** 2, 2.0 * (1.0 + slack)
    return (1.0 + slack) ** 3, 3.0 * (1.0 + slack) ** 2


@inner_njit
def lost(slack: float) -> float:
    """Price per second of a slack: for the time lost, and for there being a dip at all."""
    return slack + DIP_PRICE * slack / (slack + DIP)


@inner_njit
def lost_slope(slack: float) -> float:
    """Derivative of `lost`, which is concave: its tangent is never below it."""
    return 1.0 + DIP_PRICE * DIP / (slack + DIP) ** 2


@njit
def slack_of(rates, limits, slack) -> None:
    """Fill slack (n): the share of its time that a sample loses, with rates (n, 3, nj) and their limits (3, nj)."""
    n, _, nj = rates.shape
    for i in range(n):
        v, a, y = 0.0, 0.0, 0.0
        for j in range(nj):
            v = max(v, abs(rates[i, 0, j]) / limits[0, j])
            a = max(a, abs(rates[i, 1, j]) / limits[1, j])
            y = max(y, abs(rates[i, 2, j]) / limits[2, j])
        slack[i] = max(v, np.sqrt(a), np.cbrt(y), 1.0) - 1.0


@njit
def price_time_lost(step, deposits, slack):
    """Price [s] of the time that slacks (n) lose where material is laid down."""
    total = 0.0
    for i in range(slack.size):
        total += step[i] * deposits[i] * lost(slack[i])
    return total


@njit
def price_effort(rates, limits, step, peak):
    """Price [s] of the joints' rates (n, 3, nj), and of speed peaks: the eighth power, PEAK_PRICE at `peak`."""
    n, _, nj = rates.shape
    total = 0.0
    for i in range(n):
        effort = 0.0
        for o in range(3):
            for j in range(nj):
                square = (rates[i, o, j] / limits[o, j]) ** 2
                effort += EFFORT[o] * square / (1.0 + square)
        if peak < np.inf:
            for j in range(nj):
                effort += PEAK_PRICE * (rates[i, 0, j] / peak) ** 8
        total += step[i] * effort
    return total / nj


@njit
def price_singularity(weight, step, deposits, sigma, least_sigma):
    """Price [s] of closeness to singularities, `weight` times; and of singular values sigma (n) below `least_sigma`."""
    total = 0.0
    for i in range(sigma.size):
        close = max(0.0, SIGMA_COMFORT / sigma[i] - 1.0)
        hard = deposits[i] * HARD_PRICE * max(0.0, least_sigma - sigma[i])
        total += step[i] * (weight * SIGMA_PRICE * close * close + hard)
    return total


@njit
def price_joint_limits(weight, step, q, low, high):
    """Price [s] of closeness to the ends low, high (na) of the arm's ranges, `weight` times; and of exceeding them."""
    total = 0.0
    for i in range(len(q)):
        cost = 0.0
        for j in range(low.size):
            room = min(q[i, j] - low[j], high[j] - q[i, j])
            near = max(0.0, 1.0 - room / LIMIT_COMFORT)
            cost += weight * LIMIT_PRICE * near * near + HARD_PRICE * max(0.0, -room)
        total += step[i] * cost
    return total


# ----------------------------------------------------------------------------------------------------
# Which rates and ends of ranges a program watches, compiled: those near from the start, and those that a step violates.

NEAR_RATE = 0.7  # share of a rate's limit above which the program watches it from the start
MISSED = 1e-2  # slack that a rate must require beyond the watched ones before the program watches it too
_NEAR_END = 0.7  # share of what a step may move a joint: an end of its range that close is watched from the start
_MISSED_END = 1e-5  # rad that a step must exceed an end by before the program watches it too


@njit
def watch_near(rates, limits, deposits, slack, watch) -> None:
    """Mark in watch (n, 3, nj, 2), upwards and downwards, the rates that are near what their sample's slack allows."""
    n, _, nj = rates.shape
    for i in range(n):
        for o in range(3):
            bound, _ = allowed(o, slack[i])
            for j in range(nj):
                if deposits[i] > 0.0 and abs(rates[i, o, j]) > NEAR_RATE * bound * limits[o, j]:
                    watch[i, o, j, 0 if rates[i, o, j] > 0.0 else 1] = True


@njit(fastmath=SUMS)
def watch_missed(rates, limits, deposits, slack, slopes, at, x, watch):
    """Mark the rates that a step x takes beyond the slack that the watched ones of their sample need; returns how many.

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


@njit
def watch_near_ends(q, G, low, high, step, trust, watch) -> None:
    """Mark in watch (n, na) the arm's joints that a share of a step within `trust` [rad] may take to the nearer end of
    their range."""
    for i in range(len(q)):
        if step[i] > 0.0:
            for j in range(low.size):
                reach = 0.0
                for c in range(G.shape[2]):
                    reach += abs(G[i, j, c])
                watch[i, j] = min(q[i, j] - low[j], high[j] - q[i, j]) < _NEAR_END * trust * reach


@njit
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
# The quadratic program around a path, compiled: what each term adds, to first order, with a convex second-order part.

NEAR_SIGMA = 1.3  # × the least singular value allowed, below which the program has a row for it
_TOGETHER = 8  # greatest number of samples whose effort is one product of matrices: few enough for one thread


class SplineSamples(NamedTuple):
    """Samples (n) of a stretch and the control values (k) that they depend on, as in `PathSegment`."""

    step: Array
    deposits: Array
    first: Ints
    B: Array
    free: Array


class RowPlaces(NamedTuple):
    """Where a term's rows and groups of each sample begin in a program: row (n), group (n)."""

    row: Ints
    group: Ints


class RowsFilled(NamedTuple):
    """The arrays A (r, w), b, at (r), group (k + 1) and price (k) of a `QuadraticProgram`, to be filled."""

    A: Array
    b: Array
    at: Ints
    group: Ints
    price: Array


@njit(fastmath=SUMS)
def rate_slopes(limits, G, centre, D, first, B, free, slopes) -> None:
    """Fill slopes (n, 3 nj, w) with the slopes of the rates, as shares of their limits, by the control values.

    free (controls) is 1 for those that may move, else 0. q(t) moves by G(t) times the spline of x: its rates follow by
    the product rule, with those of G from finite differences.
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


@njit
def foreseen(q, G, moved):
    """Joints (n, nj) that a move of the free variables by moved (n, m) leads to, to first order."""
    out = q.copy()
    for i in range(len(q)):
        for j in range(q.shape[1]):
            for c in range(moved.shape[1]):
                out[i, j] += G[i, j, c] * moved[i, c]
    return out


@njit(fastmath=SUMS)
def expand_effort(weight, limits, samples, rates, peak, slopes, H, g) -> None:
    """Add effort and peaks to the program, `weight` times: H (n, w), a lower band, and g (n).

    g is exact, H the convex part: for effort its slope over the rate, for peaks all of it.

    samples: SplineSamples; rates (n, 3, nj); peak [rad/s]: see `price_effort`; slopes (n, 3 nj, w): of `rate_slopes`
    """
    step, first = samples.step, samples.first
    n, _, nj = rates.shape
    w = slopes.shape[2]
    m = w // samples.B.shape[2]
    scaled, product = np.empty((_TOGETHER, 3 * nj, w)), np.empty((w, w))
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
                    curve = 2.0 * weight * step[i] * EFFORT[o] / nj / (1.0 + share * share) ** 2
                    slope = share * curve
                    if o == 0 and peak < np.inf:
                        unit = limits[0, j] / peak
                        own = 8.0 * weight * PEAK_PRICE * step[i] / nj * unit * unit * (unit * share) ** 6
                        slope += share * own
                        curve += 7.0 * own
                    for p in range(w):
                        scaled[i - start, r, p] = curve * slopes[i, r, p]
                        g[at + p] += slope * slopes[i, r, p]
        rows = 3 * nj * (end - start)
        np.dot(scaled[: end - start].reshape(rows, w).T, slopes[start:end].reshape(rows, w), product)
        for p in range(w):
            for d in range(p + 1):
                H[at + p, d] += product[p, p - d]
        start = end


@njit(fastmath=SUMS)
def expand_joint_limits(weight, samples, q, G, low, high, H, g) -> None:
    """Add closeness of joints q (n, nj) to the ends of the arm's ranges to the program, `weight` times."""
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    row = np.empty(B.shape[2] * G.shape[2])
    for i in range(len(q)):
        if step[i] == 0.0:
            continue
        for j in range(low.size):
            room_low, room_high = q[i, j] - low[j], high[j] - q[i, j]
            near = 1.0 - min(room_low, room_high) / LIMIT_COMFORT
            if near > 0.0:
                sign = (-1.0 if room_low < room_high else 1.0) / LIMIT_COMFORT
                _row_of(i, sign, G[i, j], first, B, free, row)
                _add(H, g, first[i] * G.shape[2], row, 2.0 * weight * step[i] * LIMIT_PRICE, near)


@njit(fastmath=SUMS)
def expand_singularity(weight, samples, sigma, sigma_slope, H, g) -> None:
    """Add closeness to singularities to the program, `weight` times: of sigma (n) with its slope (n, m)."""
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    m = sigma_slope.shape[1]
    row = np.empty(B.shape[2] * m)
    for i in range(sigma.size):
        close = SIGMA_COMFORT / sigma[i] - 1.0
        if step[i] > 0.0 and close > 0.0:
            _row_of(i, -SIGMA_COMFORT / (sigma[i] * sigma[i]), sigma_slope[i], first, B, free, row)
            _add(H, g, first[i] * m, row, 2.0 * weight * step[i] * SIGMA_PRICE, close)


@inner_njit
def _row_of(i, factor, by_z, first, B, free, row) -> None:
    """Fill row (w) with factor times a slope by the control values, from the slope by_z (m) at sample i."""
    m = by_z.size
    for e in range(B.shape[2]):
        share = factor * B[i, 0, e] * free[first[i] + e]
        for c in range(m):
            row[e * m + c] = share * by_z[c]


@njit
def count_rows(wanted, flags):
    """Numbers of rows (n) and groups (n) of the samples that are wanted (n): a row for each flag (n, b, f) that is set,
    a group for those of each b."""
    n, groups_at_most, flags_of_group = flags.shape
    rows, groups = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    for i in range(n):
        if wanted[i] > 0.0:
            for b in range(groups_at_most):
                own = 0
                for f in range(flags_of_group):
                    if flags[i, b, f]:
                        own += 1
                rows[i] += own
                if own:
                    groups[i] += 1
    return rows, groups


@njit
def places_of(counts):
    """Where each term's counts (terms, n) begin, sample by sample and in the order of terms, and their total."""
    terms, n = counts.shape
    places = np.empty((terms, n), dtype=np.int64)
    total = 0
    for i in range(n):
        for t in range(terms):
            places[t, i] = total
            total += counts[t, i]
    return places, total


@njit
def rows_of_rates(weight, limits, samples, rates, slack, slopes, watch, places, rows) -> None:
    """Fill the rows of watched rates: all of a sample's are a group, whose slack is lost time, priced `weight` times.

    samples: SplineSamples; slopes (n, 3 nj, w): of `rate_slopes`; watch (n, 3, nj, 2); places: RowPlaces, rows:
    RowsFilled
    """
    step, deposits, first, B = samples.step, samples.deposits, samples.first, samples.B
    row, own = places.row, places.group
    A, b, at, group, price = rows.A, rows.b, rows.at, rows.group, rows.price
    n, _, nj = rates.shape
    w = slopes.shape[2]
    m = w // B.shape[2]
    for i in range(n):
        if step[i] == 0.0 or deposits[i] == 0.0:
            continue
        r = row[i]
        for o in range(3):
            bound, slope = allowed(o, slack[i])
            for j in range(nj):
                share = rates[i, o, j] / limits[o, j]
                for side in range(2):
                    if watch[i, o, j, side]:
                        sign = 1.0 if side == 0 else -1.0
                        for p in range(w):
                            A[r, p] = sign * slopes[i, o * nj + j, p] / slope
                        b[r] = (bound - sign * share) / slope - slack[i]
                        at[r] = first[i] * m
                        r += 1
        if r > row[i]:
            price[own[i]] = weight * step[i] * deposits[i] * lost_slope(slack[i])
            group[own[i] + 1] = r


@njit
def rows_of_ends(samples, q, G, low, high, watch, places, rows) -> None:
    """Fill the rows of joints q (n, nj) that are watched (n, na) for the nearer end of their range: a group each."""
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    row, own = places.row, places.group
    A, b, at, group, price = rows.A, rows.b, rows.at, rows.group, rows.price
    for i in range(len(q)):
        if step[i] == 0.0:
            continue
        r, k = row[i], own[i]
        for j in range(low.size):
            if watch[i, j]:
                room_low, room_high = q[i, j] - low[j], high[j] - q[i, j]
                _row_of(i, -1.0 if room_low < room_high else 1.0, G[i, j], first, B, free, A[r])
                b[r] = min(room_low, room_high)
                at[r] = first[i] * G.shape[2]
                price[k] = step[i] * HARD_PRICE
                r += 1
                k += 1
                group[k] = r


@njit
def rows_of_sigma(samples, sigma, sigma_slope, least_sigma, watch, places, rows) -> None:
    """Fill the rows of the samples watched (n) that keep the least singular value: a group each."""
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    row, own = places.row, places.group
    A, b, at, group, price = rows.A, rows.b, rows.at, rows.group, rows.price
    for i in range(sigma.size):
        if watch[i]:
            r, k = row[i], own[i]
            _row_of(i, -1.0, sigma_slope[i], first, B, free, A[r])
            b[r] = sigma[i] - least_sigma
            at[r] = first[i] * sigma_slope.shape[1]
            price[k] = step[i] * HARD_PRICE
            group[k + 1] = r + 1


@njit
def rows_of_cones(samples, lean, lean_slope, cones, watch, places, rows) -> None:
    """Fill the rows of watched facets (n, b, facets) around leans (n, b, 2): those of a cone (b) [rad] are a group."""
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    row, own = places.row, places.group
    A, b, at, group, price = rows.A, rows.b, rows.at, rows.group, rows.price
    m = lean_slope.shape[3]
    slope = np.empty(m)
    for i in range(len(lean)):
        if step[i] == 0.0:
            continue
        r, k = row[i], own[i]
        for c in range(cones.size):
            start = r
            for f in range(watch.shape[2]):
                if watch[i, c, f]:
                    u_x, u_y = facet(lean[i, c], f)
                    for v in range(m):
                        slope[v] = u_x * lean_slope[i, c, 0, v] + u_y * lean_slope[i, c, 1, v]
                    _row_of(i, 1.0, slope, first, B, free, A[r])
                    b[r] = cones[c] - u_x * lean[i, c, 0] - u_y * lean[i, c, 1]
                    at[r] = first[i] * m
                    r += 1
            if r > start:
                price[k] = step[i] * HARD_PRICE
                k += 1
                group[k] = r


@njit
def expand_tilt(price, samples, lean, lean_slope, H, g) -> None:
    """Add the nozzle's lean (n, 2) from the surface normal to the program, at a price [s/s per rad^2] of its square;
    lean_slope (n, 2, m)."""
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    m = lean_slope.shape[2]
    row = np.empty(B.shape[2] * m)
    for i in range(len(step)):
        for k in range(2):
            _row_of(i, 1.0, lean_slope[i, k], first, B, free, row)
            _add(H, g, first[i] * m, row, 2.0 * step[i] * price, lean[i, k])


@inner_njit
def _add(H, g, at, row, weight, value) -> None:
    """Add weight / 2 (value + row x)^2 to the program."""
    for c in range(row.size):
        scaled = weight * row[c]
        g[at + c] += scaled * value
        for d in range(c + 1):
            H[at + c, c - d] += scaled * row[d]


@njit
def expand_own(samples, G, speed_slopes, by, curve, H, g) -> None:
    """Add a user's term to the program: by, curve (2, n, nj) are its slopes and curvatures by joints and by speeds.

    samples: SplineSamples; G (n, nj, m); speed_slopes (n, nj, w) of the joints' speeds by the control values
    """
    step, first, B, free = samples.step, samples.first, samples.B, samples.free
    n, nj, m = G.shape
    w = speed_slopes.shape[2]
    row = np.empty(w)
    for i in range(n):
        if step[i] == 0.0:
            continue
        at = first[i] * m
        for o in range(2):
            for j in range(nj):
                if by[o, i, j] == 0.0 and curve[o, i, j] == 0.0:
                    continue
                if o == 0:
                    _row_of(i, 1.0, G[i, j], first, B, free, row)
                else:
                    for p in range(w):
                        row[p] = speed_slopes[i, j, p]
                for p in range(w):
                    g[at + p] += step[i] * by[o, i, j] * row[p]
                    for d in range(p + 1):
                        H[at + p, p - d] += step[i] * curve[o, i, j] * row[p] * row[d]
