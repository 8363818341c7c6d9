"""A convex quadratic program with shared slacks and banded structure, by a primal-dual interior-point method.

    minimise   1/2 x^T H x + g^T x + sum_k price_k slack_k
    subject to A_r x - b_r <= slack_k for every row r of group k,   slack_k >= 0,   |x_i| <= box_i

A row touches `width` neighbouring variables from a place of its own, so the Newton matrix is banded: the slacks are
eliminated group by group (a rank-one term each), and the rest is one banded Cholesky factorisation a step. Cost is
linear in rows and variables. Predictor and corrector after Mehrotra (1992). It starts, and stays, feasible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.resolve.banded import SUMS, add_rows, factorise, substitute, times_band

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_STEPS = 60
_FREE = 1e-9  # of what there is to gain: price of a slack that has none
_GAP = 1e-4  # of what there is to gain at all: complementarity and residual at which the solution is taken
_TO_THE_WALL = 0.99  # share of the way to the nearest wall that a step may go


@dataclass(frozen=True)
class QuadraticProgram:
    """H (n, width) lower band: H[i, d] is the entry (i, i - d); g (n); box (n), positive.

    A (r, width), b (r), at (r) first variable of each row; group k has the rows group[k] .. group[k + 1], which begin at
    the same variable, and price[k], positive
    """

    H: Array
    g: Array
    box: Array
    A: Array
    b: Array
    at: Index
    group: Index
    price: Array

    def value(self, x: Array) -> float:
        """The objective at x, with the least slacks that x allows."""
        return float(_value(self.H, self.g, self.A, self.b, self.at, self.group, self.price, x))


def solve_qp(qp: QuadraticProgram) -> tuple[Array, int]:
    """The minimiser x (n) and the number of Newton steps; x = 0 where that is no worse."""
    return minimise(qp.H, qp.g, qp.box, qp.A, qp.b, qp.at, qp.group, qp.price)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def _value(H, g, A, b, at, group, price, x):
    n = x.size
    Hx = np.empty(n)
    times_band(H, x, Hx)
    total = 0.0
    for i in range(n):
        total += x[i] * (0.5 * Hx[i] + g[i])
    for k in range(price.size):
        slack = 0.0
        for r in range(group[k], group[k + 1]):
            over = -b[r]
            for c in range(A.shape[1]):
                over += A[r, c] * x[at[r] + c]
            slack = max(slack, over)
        total += price[k] * slack
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def _direction(
    H, A, at, group, L, D, S, mu, x, box, g, Hx, price, s, lam, slack, low, high, lam_low, lam_high, Aty,
    target, second_s, second_slack, second_low, second_high, dx, dslack, ds, dlam, dmu,
):  # fmt: skip
    """Newton's direction towards complementarity `target`, with the factor L; second_* are the corrector's products."""
    n, w = H.shape
    for i in range(n):
        r_low, r_high = target - second_low[i], target - second_high[i]
        dx[i] = -(Hx[i] + g[i] + Aty[i]) + r_low / low[i] - r_high / high[i]
    # Hx + g + A^T lam - lam_low + lam_high is the gradient; r / low - lam_low cancels lam_low
    for k in range(price.size):
        own = (target - second_slack[k]) / slack[k] - price[k]
        for r in range(group[k], group[k + 1]):
            y = (target - second_s[r]) / s[r] - lam[r]
            own += y + lam[r]
        for r in range(group[k], group[k + 1]):
            y = (target - second_s[r]) / s[r] - lam[r] - D[r] * own / S[k]
            for c in range(w):
                dx[at[r] + c] -= A[r, c] * y
        dslack[k] = own
    substitute(L, dx)
    for k in range(price.size):
        sum_ = dslack[k]
        for r in range(group[k], group[k + 1]):
            move = 0.0
            for c in range(w):
                move += A[r, c] * dx[at[r] + c]
            ds[r] = -move
            sum_ += D[r] * move
        dslack[k] = sum_ / S[k]
        for r in range(group[k], group[k + 1]):
            ds[r] += dslack[k]
            dlam[r] = (target - second_s[r]) / s[r] - lam[r] - D[r] * ds[r]
        dmu[k] = (target - second_slack[k]) / slack[k] - mu[k] - mu[k] / slack[k] * dslack[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def minimise(H, g, box, A, b, at, group, price) -> tuple[Array, int]:
    """Compiled body of `solve_qp`."""
    n, w = H.shape
    rows, groups = b.size, price.size
    x = np.zeros(n)
    # not the prices' sum: of what must not be exceeded the prices are huge, and most of it is far away
    now = _value(H, g, A, b, at, group, price, x)
    scale = now + np.abs(g * box).sum()
    if scale == 0.0:
        return x, 0
    price = np.maximum(price, _FREE * scale)  # without a price a group would have no interior
    low, high = box.copy(), box.copy()  # distances to the two walls of the box
    slack = np.empty(groups)
    s, lam = np.empty(rows), np.empty(rows)
    mu = np.empty(groups)
    for k in range(groups):
        most = 0.0
        reach = 0.0
        for r in range(group[k], group[k + 1]):
            most = max(most, -b[r])
            move = 0.0
            for c in range(w):
                move += abs(A[r, c]) * box[at[r] + c]
            reach = max(reach, move)
        slack[k] = most + max(0.1 * min(reach, 1.0), 1e-3)
        m = group[k + 1] - group[k]
        for r in range(group[k], group[k + 1]):
            s[r] = slack[k] + b[r]
            lam[r] = 0.5 * price[k] / m
        mu[k] = 0.5 * price[k]
    total = rows + groups + 2 * n
    gap = 0.0
    for r in range(rows):
        gap += s[r] * lam[r]
    for k in range(groups):
        gap += slack[k] * mu[k]
    start = max(gap / max(rows + groups, 1), 1e-3 * scale / total)
    lam_low, lam_high = start / low, start / high
    Hx, Aty = np.zeros(n), np.empty(n)
    L = np.empty((n, w))
    D, S = np.empty(rows), np.empty(groups)
    dx, ds, dlam = np.empty(n), np.empty(rows), np.empty(rows)
    dslack, dmu = np.empty(groups), np.empty(groups)
    second_s, second_slack = np.zeros(rows), np.zeros(groups)
    second_low, second_high = np.zeros(n), np.zeros(n)
    taken = 0
    while taken < _STEPS:
        gap = 0.0
        for r in range(rows):
            gap += s[r] * lam[r]
        for k in range(groups):
            gap += slack[k] * mu[k]
        for i in range(n):
            gap += low[i] * lam_low[i] + high[i] * lam_high[i]
        times_band(H, x, Hx)
        Aty[:] = 0.0
        for k in range(groups):
            for r in range(group[k], group[k + 1]):
                for c in range(w):
                    Aty[at[r] + c] += A[r, c] * lam[r]
        dual = 0.0
        for i in range(n):
            dual += abs(Hx[i] + g[i] + Aty[i] - lam_low[i] + lam_high[i]) * box[i]
        if gap <= _GAP * scale and dual <= _GAP * scale:
            break
        for i in range(n):
            for d in range(w):
                L[i, d] = H[i, d]
            L[i, 0] += lam_low[i] / low[i] + lam_high[i] / high[i]
        add_rows(A, at, group, lam, s, mu, slack, D, S, L)
        if not factorise(L):
            break
        second_s[:] = 0.0
        second_slack[:] = 0.0
        second_low[:] = 0.0
        second_high[:] = 0.0
        _direction(
            H, A, at, group, L, D, S, mu, x, box, g, Hx, price, s, lam, slack, low, high, lam_low, lam_high, Aty,
            0.0, second_s, second_slack, second_low, second_high, dx, dslack, ds, dlam, dmu,
        )  # fmt: skip
        length = _step_length(
            s, ds, lam, dlam, slack, dslack, mu, dmu, low, high, lam_low, lam_high, dx, 0.0, second_low, second_high
        )
        after = 0.0
        for r in range(rows):
            after += (s[r] + length * ds[r]) * (lam[r] + length * dlam[r])
            second_s[r] = ds[r] * dlam[r]
        for k in range(groups):
            after += (slack[k] + length * dslack[k]) * (mu[k] + length * dmu[k])
            second_slack[k] = dslack[k] * dmu[k]
        for i in range(n):
            d_low = -lam_low[i] - lam_low[i] / low[i] * dx[i]
            d_high = -lam_high[i] + lam_high[i] / high[i] * dx[i]
            after += (low[i] + length * dx[i]) * (lam_low[i] + length * d_low)
            after += (high[i] - length * dx[i]) * (lam_high[i] + length * d_high)
            second_low[i] = dx[i] * d_low
            second_high[i] = -dx[i] * d_high
        target = (after / gap) ** 3 * gap / total
        _direction(
            H, A, at, group, L, D, S, mu, x, box, g, Hx, price, s, lam, slack, low, high, lam_low, lam_high, Aty,
            target, second_s, second_slack, second_low, second_high, dx, dslack, ds, dlam, dmu,
        )  # fmt: skip
        length = _step_length(
            s, ds, lam, dlam, slack, dslack, mu, dmu, low, high, lam_low, lam_high, dx, target, second_low, second_high
        )
        length = min(1.0, _TO_THE_WALL * length)
        for r in range(rows):
            s[r] += length * ds[r]
            lam[r] += length * dlam[r]
        for k in range(groups):
            slack[k] += length * dslack[k]
            mu[k] += length * dmu[k]
        for i in range(n):
            d_low = (target - second_low[i]) / low[i] - lam_low[i] - lam_low[i] / low[i] * dx[i]
            d_high = (target - second_high[i]) / high[i] - lam_high[i] + lam_high[i] / high[i] * dx[i]
            x[i] += length * dx[i]
            low[i], high[i] = box[i] + x[i], box[i] - x[i]
            lam_low[i] += length * d_low
            lam_high[i] += length * d_high
        taken += 1
    if not _value(H, g, A, b, at, group, price, x) < now:
        x[:] = 0.0
    return x, taken


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def _step_length(s, ds, lam, dlam, slack, dslack, mu, dmu, low, high, lam_low, lam_high, dx, target, sec_low, sec_high):
    """Longest step, up to 1 / _TO_THE_WALL, that keeps everything positive.

    One length for primal and dual: with different ones H dx would spoil the dual residual.
    """
    length = 1.0 / _TO_THE_WALL
    for r in range(s.size):
        if ds[r] < 0.0:
            length = min(length, -s[r] / ds[r])
        if dlam[r] < 0.0:
            length = min(length, -lam[r] / dlam[r])
    for k in range(slack.size):
        if dslack[k] < 0.0:
            length = min(length, -slack[k] / dslack[k])
        if dmu[k] < 0.0:
            length = min(length, -mu[k] / dmu[k])
    for i in range(dx.size):
        if dx[i] < 0.0:
            length = min(length, -low[i] / dx[i])
        elif dx[i] > 0.0:
            length = min(length, high[i] / dx[i])
        d_low = (target - sec_low[i]) / low[i] - lam_low[i] - lam_low[i] / low[i] * dx[i]
        d_high = (target - sec_high[i]) / high[i] - lam_high[i] + lam_high[i] / high[i] * dx[i]
        if d_low < 0.0:
            length = min(length, -lam_low[i] / d_low)
        if d_high < 0.0:
            length = min(length, -lam_high[i] / d_high)
    return length
