"""The quadratic program around a path, compiled: its price (see `price_kernel`) convex and to second order."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.resolve.cone_kernel import facet
from planner.resolve.node_kernel import LIMIT_COMFORT, LIMIT_PRICE, SIGMA_COMFORT, SIGMA_PRICE
from planner.resolve.price_kernel import EFFORT, HARD_PRICE, PEAK_PRICE, allowed, lost_slope

Array = NDArray[np.float64]

NEAR_RATE = 0.7  # share of a rate's limit above which the program watches it from the start
MISSED = 1e-2  # slack that a rate must ask for beyond the watched ones before the program watches it too
NEAR_RANGE = 0.3  # rad from the end of a joint's range below which the program watches it
NEAR_SIGMA = 1.3  # times the least singular value allowed, likewise


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(i: int, limits, G, centre, D, first, B, free, Gd, Bf, a) -> None:
    """Fill a (3, nj, w) with the slopes of a sample's rates, as shares of their limits, by the control values.

    Fills Bf (4, nb), the B-splines of those that may move, on the way; Gd (3, nj, m) is room.
    """
    _, nj, m = G.shape
    nb = B.shape[2]
    for e in range(nb):
        for o in range(4):
            Bf[o, e] = B[i, o, e] * free[first[i] + e]
    for o in range(3):
        for j in range(nj):
            for c in range(m):
                total = 0.0
                for s in range(5):
                    total += D[i, o, s] * G[centre[i] + s - 2, j, c]
                Gd[o, j, c] = total
    for j in range(nj):
        v, y, z = 1.0 / limits[0, j], 1.0 / limits[1, j], 1.0 / limits[2, j]
        for e in range(nb):
            b0, b1, b2, b3 = Bf[0, e], Bf[1, e], Bf[2, e], Bf[3, e]
            for c in range(m):
                g0, g1, g2, g3 = G[i, j, c], Gd[0, j, c], Gd[1, j, c], Gd[2, j, c]
                p = e * m + c
                a[0, j, p] = v * (g0 * b1 + g1 * b0)
                a[1, j, p] = y * (g0 * b2 + 2.0 * g1 * b1 + g2 * b0)
                a[2, j, p] = z * (g0 * b3 + 3.0 * g1 * b2 + 3.0 * g2 * b1 + g3 * b0)


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


@njit(cache=True, nogil=True, error_model="numpy")
def watch_missed(rates, limits, deposits, slack, G, centre, D, first, B, free, x, watch):
    """Mark the rates that a step x takes beyond what the watched ones of their sample ask for; returns how many."""
    n, _, nj = rates.shape
    m = G.shape[2]
    w = B.shape[2] * m
    Gd, a, Bf = np.empty((3, nj, m)), np.empty((3, nj, w)), np.empty((4, B.shape[2]))
    over = np.empty((3, nj, 2))
    missed = 0
    for i in range(n):
        if deposits[i] == 0.0:
            continue
        _slopes(i, limits, G, centre, D, first, B, free, Gd, Bf, a)
        needed = 0.0
        for o in range(3):
            bound, slope = allowed(o, slack[i])
            for j in range(nj):
                share = rates[i, o, j] / limits[o, j]
                for p in range(w):
                    share += a[o, j, p] * x[first[i] * m + p]
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
def count_rows(step, deposits, watch, q, low, high, sigma, least_sigma, watch_lean):
    """Rows (r) and groups (k) that `quadratic_program` will write."""
    n = len(q)
    rows, groups = 0, 0
    for i in range(n):
        if step[i] == 0.0:
            continue
        own = watch[i].sum() if deposits[i] > 0.0 else 0
        rows += own
        groups += 1 if own else 0
        for j in range(low.size):
            if min(q[i, j] - low[j], high[j] - q[i, j]) < NEAR_RANGE:
                rows += 1
                groups += 1
        if deposits[i] > 0.0 and sigma[i] < NEAR_SIGMA * least_sigma:
            rows += 1
            groups += 1
        for c in range(watch_lean.shape[1]):
            own = watch_lean[i, c].sum()
            rows += own
            groups += 1 if own else 0
    return rows, groups


@njit(cache=True, nogil=True, error_model="numpy")
def quadratic_program(
    rates, limits, step, deposits, slack, watch, q, G, low, high, sigma, sigma_slope, least_sigma,
    lean, lean_slope, cones, watch_lean, peak,
    centre, D, first, B, free,
    H, g, A, b, at, group, price,
):  # fmt: skip
    """Fill the program around a path whose control values move by x; free (controls) is 1 for those that may, else 0.

    q(t) moves by G(t) times the spline of x: its rates by the product rule, with rates of G by differences.
    """
    n, _, nj = rates.shape
    na = low.size
    m = G.shape[2]
    nb = B.shape[2]
    w = nb * m
    Gd = np.empty((3, nj, m))
    a = np.empty((3, nj, w))
    scaled, product = np.empty((3, nj, w)), np.empty((w, w))
    a0 = np.empty(w)
    r, k = 0, 0
    group[0] = 0
    H[:] = 0.0
    g[:] = 0.0
    row = np.empty(w)
    Bf = np.empty((4, nb))
    for k_free in range(free.size):
        if free[k_free] == 0.0:
            for c in range(m):
                H[k_free * m + c, 0] = 1.0
    for i in range(n):
        if step[i] == 0.0:
            continue
        at_i = first[i] * m
        _slopes(i, limits, G, centre, D, first, B, free, Gd, Bf, a)
        # effort: what single rates add is one product of matrices
        for o in range(3):
            for j in range(nj):
                share = rates[i, o, j] / limits[o, j]
                weight = 2.0 * step[i] * EFFORT[o] / nj / (1.0 + share * share) ** 2
                slope = share * weight
                if o == 0 and peak < np.inf:
                    unit = limits[0, j] / peak
                    own = 8.0 * PEAK_PRICE * step[i] / nj * unit * unit * (unit * share) ** 6
                    slope += share * own
                    weight += 7.0 * own
                for p in range(w):
                    scaled[o, j, p] = weight * a[o, j, p]
                    g[at_i + p] += slope * a[o, j, p]
        np.dot(scaled.reshape(3 * nj, w).T, a.reshape(3 * nj, w), product)
        for p in range(w):
            for d in range(p + 1):
                H[at_i + p, d] += product[p, p - d]
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
                                A[r, p] = sign * a[o, j, p] / slope
                            b[r] = (bound - sign * share) / slope - slack[i]
                            at[r] = at_i
                            r += 1
                            own += 1
            if own:
                price[k] = step[i] * deposits[i] * lost_slope(slack[i])
                k += 1
                group[k] = r
        # closeness to the ends of the joints' ranges
        for j in range(na):
            room_low, room_high = q[i, j] - low[j], high[j] - q[i, j]
            room = min(room_low, room_high)
            if room < NEAR_RANGE or room < LIMIT_COMFORT:
                sign = -1.0 if room_low < room_high else 1.0
                for e in range(nb):
                    for c in range(m):
                        row[e * m + c] = sign * G[i, j, c] * Bf[0, e]
                near = 1.0 - room / LIMIT_COMFORT
                if near > 0.0:
                    for p in range(w):
                        a0[p] = row[p] / LIMIT_COMFORT
                    _add(H, g, at_i, a0, 2.0 * step[i] * LIMIT_PRICE, near)
                if room < NEAR_RANGE:
                    for p in range(w):
                        A[r, p] = row[p]
                    b[r] = room
                    at[r] = at_i
                    price[k] = step[i] * HARD_PRICE
                    r += 1
                    k += 1
                    group[k] = r
        # closeness to singularities
        close = SIGMA_COMFORT / sigma[i] - 1.0
        if close > 0.0 or (deposits[i] > 0.0 and sigma[i] < NEAR_SIGMA * least_sigma):
            for e in range(nb):
                for c in range(m):
                    row[e * m + c] = sigma_slope[i, c] * Bf[0, e]
            if close > 0.0:
                for p in range(w):
                    a0[p] = -SIGMA_COMFORT / (sigma[i] * sigma[i]) * row[p]
                _add(H, g, at_i, a0, 2.0 * step[i] * SIGMA_PRICE, close)
            if deposits[i] > 0.0 and sigma[i] < NEAR_SIGMA * least_sigma:
                for p in range(w):
                    A[r, p] = -row[p]
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
                    for e in range(nb):
                        for c in range(m):
                            slope = u_x * lean_slope[i, v, 0, c] + u_y * lean_slope[i, v, 1, c]
                            A[r, e * m + c] = slope * Bf[0, e]
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
