"""The quadratic program around a path, compiled: its price (see `price_kernel`) to first order, with a convex second one."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.resolve.banded import SUMS
from planner.resolve.cone_kernel import facet
from planner.resolve.node_kernel import LIMIT_COMFORT, LIMIT_PRICE, SIGMA_COMFORT, SIGMA_PRICE
from planner.resolve.price_kernel import EFFORT, HARD_PRICE, PEAK_PRICE, allowed, lost_slope

NEAR_SIGMA = 1.3  # times the least singular value allowed below which the program has a row for it
_TOGETHER = 8  # samples at most whose effort is one product of matrices: few enough for one thread


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
def smooth_price(
    rates, limits, step, q, G, low, high, sigma, sigma_slope, peak, slopes, first, B, free, H, g
):  # fmt: skip
    """Fill H (n, w), a lower band, and g (n) with the part of the price around a path that has no bounds: effort, peaks, and
    closeness to ends of ranges and to singularities. g is exact, H what is convex: of effort its slope over the rate, of
    peaks all of it. What is held has a one on the diagonal."""
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
def bound_rows(
    rates, limits, step, deposits, slack, watch, q, G, low, high, watch_end, sigma, sigma_slope, least_sigma,
    lean, lean_slope, cones, watch_lean, slopes, first, B, free,
    A, b, at, group, price,
):  # fmt: skip
    """Fill the rows of what is watched around a path whose control values move by x, and the price of their slacks."""
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
                        if watch[i, o, j, side]:
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
