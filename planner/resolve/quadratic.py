"""Convex quadratic programs with banded structure: matrices, and a primal-dual interior-point method; compiled."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints
from planner.base.compiled import inner_njit, njit

# ----------------------------------------------------------------------------------------------------
# Compiled kernels on banded symmetric matrices: products, Cholesky, and sums of rows' outer products.
#
# A matrix to be factorised is stored as its upper band, U (n, w): U[i, d] is the entry (i, i + d). So a row of the
# factor updates the rows after it along contiguous memory.

# Sums may be taken in any order, and products be fused into them without rounding: vector instructions need both. A
# loop that accumulates a sum must not fill an array as well: whether such a loop can be vectorised depends on where
# arrays are in memory, and so would its last digit.
SUMS = {"reassoc", "contract"}
_ROWS = 64  # rows that are multiplied at once: few enough for one thread
_PANEL = 8  # rows of the factor that update the rows after them at once, as one product of matrices


@inner_njit(fastmath=SUMS)
def times_band(H, x, out) -> None:
    """Fill out with H x; H (n, w) is the lower band, H[i, d] the entry (i, i - d)."""
    n, w = H.shape
    for i in range(n):
        total = H[i, 0] * x[i]
        for d in range(1, min(w, i + 1)):
            total += H[i, d] * x[i - d]
        out[i] = total
        for d in range(1, min(w, i + 1)):
            out[i - d] += H[i, d] * x[i]


@inner_njit(fastmath=SUMS)
def upper_band(H, U) -> None:
    """Fill U (n, w) with the matrix whose lower band is H (n, w)."""
    n, w = H.shape
    U[:] = 0.0
    for i in range(n):
        for d in range(min(w, i + 1)):
            U[i - d, d] = H[i, d]


@inner_njit(fastmath=SUMS)
def factorise(U) -> bool:
    """Banded Cholesky in place: U (n, w) holds the upper band of a symmetric matrix, then that of its upper factor.

    Entries beyond the matrix's last column must be zero. False if the matrix is not positive definite.
    """
    n, w = U.shape
    panel = np.zeros((_PANEL, w + _PANEL))  # finished rows, each from the first one's diagonal on
    beyond, product = np.zeros((_PANEL, w - 1)), np.empty((w - 1, w - 1))
    for j in range(0, n, _PANEL):
        size = min(_PANEL, n - j)
        for e in range(size):
            for f in range(e):
                share = panel[f, e]
                for d in range(w):
                    U[j + e, d] -= share * panel[f, e + d]
            pivot = U[j + e, 0]
            if not pivot > 0.0:
                return False
            inverse = 1.0 / np.sqrt(pivot)
            for d in range(w):
                U[j + e, d] *= inverse
                panel[e, e + d] = U[j + e, d]
        if j + size < n and w > 1:
            for e in range(size):
                for c in range(w - 1):
                    beyond[e, c] = panel[e, size + c]
            np.dot(beyond.T, beyond, product)
            for c in range(min(w - 1, n - j - size)):
                for d in range(w - 1 - c):
                    U[j + size + c, d] -= product[c, c + d]
    return True


@inner_njit(fastmath=SUMS)
def substitute(U, x) -> None:
    """Solve with a factor of `factorise`, in place."""
    n, w = U.shape
    for i in range(n):
        x[i] /= U[i, 0]
        value = x[i]
        for d in range(1, min(w, n - i)):
            x[i + d] -= U[i, d] * value
    for i in range(n - 1, -1, -1):
        s = x[i]
        for d in range(1, min(w, n - i)):
            s -= U[i, d] * x[i + d]
        x[i] = s / U[i, 0]


@inner_njit
def chunks_of(at, group):
    """First groups of chunks, and the number of groups: the rows of a chunk begin at the same variable and are few."""
    groups = group.size - 1
    chunks = np.empty(groups + 1, dtype=np.int64)
    count, rows = 0, 0
    for k in range(groups):
        own = group[k + 1] - group[k]
        if k == 0 or rows + own > _ROWS or (own and rows and at[group[k]] != at[group[k] - 1]):
            chunks[count] = k
            count += 1
            rows = 0
        rows += own
    chunks[count] = groups
    return chunks[: count + 1]


@inner_njit(fastmath=SUMS)
def add_rows(A, at, group, chunks, D, own, S, U) -> None:
    """Add all groups' rows to the Newton matrix U (n, w), with their slacks eliminated.

    D (rows) are the rows' weights, own (groups) that of the slack, S (groups) the sum of both. A group adds the outer
    products of its rows, less one for its slack: that is, of its rows with D times their differences from a mean.
    Those of a chunk are one product of two matrices, which is added to the band once.
    """
    w = U.shape[1]
    most = 0
    for k in range(chunks.size - 1):
        most = max(most, group[chunks[k + 1]] - group[chunks[k]])
    product, scaled, mean = np.empty((w, w)), np.empty((most, w)), np.empty(w)
    for chunk in range(chunks.size - 1):
        start, stop = group[chunks[chunk]], group[chunks[chunk + 1]]
        if start == stop:
            continue
        for k in range(chunks[chunk], chunks[chunk + 1]):
            first, end = group[k], group[k + 1]
            if end == first + 1:
                weight = D[first] * own[k] / S[k]  # D - D^2 / S
                for c in range(w):
                    scaled[first - start, c] = weight * A[first, c]
                continue
            mean[:] = 0.0
            for r in range(first, end):
                share = D[r] / S[k]
                for c in range(w):
                    mean[c] += share * A[r, c]
            for r in range(first, end):
                for c in range(w):
                    scaled[r - start, c] = D[r] * (A[r, c] - mean[c])
        np.dot(A[start:stop].T, scaled[: stop - start], product)
        for c in range(w):
            for d in range(w - c):
                U[at[start] + c, d] += product[c, c + d]


@inner_njit(fastmath=SUMS)
def rows_times(A, at, group, chunks, x, out) -> None:
    """Fill out (rows) with A x."""
    w = A.shape[1]
    own = np.empty(w)
    for chunk in range(chunks.size - 1):
        start, stop = group[chunks[chunk]], group[chunks[chunk + 1]]
        if start < stop:
            for c in range(w):
                own[c] = x[at[start] + c]
        for r in range(start, stop):
            total = 0.0
            for c in range(w):
                total += A[r, c] * own[c]
            out[r] = total


@inner_njit(fastmath=SUMS)
def add_times_rows(A, at, group, chunks, y, out) -> None:
    """Add A^T y to out (n)."""
    w = A.shape[1]
    own = np.empty(w)
    for chunk in range(chunks.size - 1):
        start, stop = group[chunks[chunk]], group[chunks[chunk + 1]]
        own[:] = 0.0
        r = start
        while r + 4 <= stop:  # four at once, so that their sum is read and written once
            for c in range(w):
                own[c] += y[r] * A[r, c] + y[r + 1] * A[r + 1, c] + y[r + 2] * A[r + 2, c] + y[r + 3] * A[r + 3, c]
            r += 4
        while r < stop:
            for c in range(w):
                own[c] += y[r] * A[r, c]
            r += 1
        if start < stop:
            for c in range(w):
                out[at[start] + c] += own[c]


# ----------------------------------------------------------------------------------------------------
# A convex quadratic program with shared slacks and banded structure, by a primal-dual interior-point method.
#
#     minimise   1/2 x^T H x + g^T x + sum_k price_k slack_k
#     subject to A_r x - b_r <= slack_k for every row r of group k,   slack_k >= 0,   |x_i| <= box_i
#
# A row touches `width` consecutive variables from an index of its own, so the Newton matrix is banded: the slacks are
# eliminated group by group (a rank-one term each), and the rest is one banded Cholesky factorisation per step. Cost is
# linear in rows and variables. Predictor and corrector after Mehrotra (1992). The method starts and stays feasible, and
# starts with every group central.

_STEPS = 60
_FREE = 1e-9  # price of a slack that has none, as a share of what there is to gain
# Share of what there is to gain at all: steps are judged by the true price, so more accuracy costs more than it gains.
ACCURACY = 1e-3
_START = 5.0  # complementarity to begin with, as a share of what there is to gain
_HALVINGS = 12  # bisections of the interval in which a group's slack is sought
_TO_THE_WALL = 0.99  # share of the way to the nearest wall that a step may go


@dataclass(frozen=True)
class QuadraticProgram:
    """H (n, width) lower band: H[i, d] is the entry (i, i - d); g (n); box (n), positive.

    A (r, width), b (r), at (r) first variable of each row; group k has the rows group[k] .. group[k + 1], which begin
    at the same variable, and price[k], positive
    """

    H: Array
    g: Array
    box: Array
    A: Array
    b: Array
    at: Ints
    group: Ints
    price: Array

    def value(self, x: Array) -> float:
        """The objective at x, with the least slacks that x allows."""
        return float(_value(self.H, self.g, self.A, self.b, self.at, self.group, self.price, x))


class Status(IntEnum):
    """How a program was left."""

    SOLVED = 0  # to the required accuracy
    STOPPED = 1  # earlier: out of steps, or unable to factorise the matrix or compute a step because of rounding
    FAILED = 2  # with values that are not numbers


@dataclass(frozen=True)
class Solution:
    """A solver's result for a program.

    x (n) within the box, 0 where that is no worse; steps taken; status
    gap, residual: what complementarity and the remaining gradient of the Lagrangian may still gain within the box, in
    the program's units: the least value is at most gap + 2 residual below that of x
    """

    x: Array
    steps: int
    status: Status = Status.SOLVED
    gap: float = 0.0
    residual: float = 0.0


def solve_qp(qp: QuadraticProgram, accuracy: float = ACCURACY) -> Solution:
    """Solve a program by Newton steps.

    accuracy: share of what there is to gain at all at which complementarity and residual end the method.
    """
    x, steps, status, gap, residual = minimise(qp.H, qp.g, qp.box, qp.A, qp.b, qp.at, qp.group, qp.price, accuracy)
    return Solution(x, steps, Status(status), gap, residual)


@njit(fastmath=SUMS)
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


class _ProgramRows(NamedTuple):
    """The rows of a program: A (r, width), at (r) and group as in `QuadraticProgram`, chunks of `chunks_of`."""

    A: Array
    at: Ints
    group: Ints
    chunks: Ints


class _Newton(NamedTuple):
    """The Newton matrix's factor U (n, width), the rows' weights D (r), and the groups' S (k), as in `add_rows`."""

    U: Array
    D: Array
    S: Array


class _Iterate(NamedTuple):
    """The method's iterate, all of it positive: slacks of rows (r), groups (k) and the box (n), and their duals.

    s, lam (r); slack, mu (k); low, high (n) distances to the two walls of the box, lam_low, lam_high (n)
    """

    s: Array
    lam: Array
    slack: Array
    mu: Array
    low: Array
    high: Array
    lam_low: Array
    lam_high: Array


class _NewtonStep(NamedTuple):
    """A direction: of x (n), and of the iterate's s, lam (r) and slack, mu (k); the box follows from x."""

    x: Array
    s: Array
    lam: Array
    slack: Array
    mu: Array


class _Products(NamedTuple):
    """Products of a direction's steps of a slack and its dual, which the corrector subtracts: of rows (r), groups (k)
    and the walls of the box (n)."""

    s: Array
    slack: Array
    low: Array
    high: Array


@inner_njit(fastmath=SUMS)
def _sum(values, first, end) -> float:
    total = 0.0
    for r in range(first, end):
        total += values[r]
    return total


@inner_njit(fastmath=SUMS)
def _direction(rows, newton, at, residual, price, target, second, step) -> None:
    """Fill a step with Newton's direction from an iterate `at` towards complementarity `target`.

    residual (n) of the Lagrangian's gradient; price (k); second: products of the previous direction, for the corrector
    """
    D, S = newton.D, newton.S
    s, lam, slack, mu = at.s, at.lam, at.slack, at.mu
    low, high, lam_low, lam_high = at.low, at.high, at.lam_low, at.lam_high
    second_s, second_slack, second_low, second_high = second.s, second.slack, second.low, second.high
    dx, ds, dlam, dslack, dmu = step.x, step.s, step.lam, step.slack, step.mu
    group = rows.group
    for i in range(dx.size):
        r_low, r_high = target - second_low[i], target - second_high[i]
        dx[i] = -residual[i] + r_low / low[i] - lam_low[i] - r_high / high[i] + lam_high[i]
    for k in range(price.size):
        first, end = group[k], group[k + 1]
        for r in range(first, end):
            dlam[r] = (target - second_s[r]) / s[r]
        own = (target - second_slack[k]) / slack[k] - price[k] + _sum(dlam, first, end)
        for r in range(first, end):
            ds[r] = lam[r] - dlam[r] + D[r] * (own / S[k])
        dslack[k] = own
    add_times_rows(rows.A, rows.at, group, rows.chunks, ds, dx)
    substitute(newton.U, dx)
    rows_times(rows.A, rows.at, group, rows.chunks, dx, ds)
    for k in range(price.size):
        first, end = group[k], group[k + 1]
        sum_ = dslack[k]
        for r in range(first, end):
            sum_ += D[r] * ds[r]
        dslack[k] = sum_ / S[k]
        for r in range(first, end):
            ds[r] = dslack[k] - ds[r]
            dlam[r] += -lam[r] - D[r] * ds[r]
        dmu[k] = (target - second_slack[k]) / slack[k] - mu[k] - mu[k] / slack[k] * dslack[k]


@inner_njit(fastmath=SUMS)
def _residual(H, g, box, rows, x, at, residual) -> float:
    """Fill residual (n) with the gradient of the Lagrangian at x, with the duals of the iterate `at`; returns what it
    may gain within the box."""
    lam_low, lam_high = at.lam_low, at.lam_high
    times_band(H, x, residual)
    for i in range(x.size):
        residual[i] += g[i] - lam_low[i] + lam_high[i]
    add_times_rows(rows.A, rows.at, rows.group, rows.chunks, at.lam, residual)
    return np.abs(residual * box).sum()


@inner_njit(fastmath=SUMS)
def _centre(room, first, end, price, target, k, s, lam, slack, mu) -> None:
    """Set the slack of group k, whose rows have `room`, and all duals so that the products are `target` and the duals
    add up to the price: by bisection, since their sum falls as the slack grows."""
    most = 0.0
    for r in range(first, end):
        most = max(most, -room[r])
    low, high = target / price, (1 + end - first) * target / price
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        dual = 1.0 / (most + middle)
        for r in range(first, end):
            dual += 1.0 / (most + middle + room[r])
        if target * dual > price:
            low = middle
        else:
            high = middle
    slack[k] = most + high
    mu[k] = target / slack[k]
    for r in range(first, end):
        s[r] = slack[k] + room[r]
        lam[r] = target / s[r]


@njit(fastmath=SUMS)
def minimise(H, g, box, A, b, at, group, price, accuracy) -> tuple[Array, int, int, float, float]:
    """Compiled body of `solve_qp`; returns the fields of a `Solution`."""
    n, w = H.shape
    count, groups = b.size, price.size
    x = np.zeros(n)
    # not the sum of prices: those of hard bounds are huge, and most of these bounds are far away
    now = _value(H, g, A, b, at, group, price, x)
    scale = now + np.abs(g * box).sum()
    if scale == 0.0:
        return x, 0, 0, 0.0, 0.0
    price = np.maximum(price, _FREE * scale)  # without a price a group would have no interior
    low, high = box.copy(), box.copy()  # distances to the two walls of the box
    slack, mu = np.empty(groups), np.empty(groups)
    s, lam = np.empty(count), np.empty(count)
    total = count + groups + 2 * n
    start = _START * scale / total
    for k in range(groups):
        _centre(b, group[k], group[k + 1], price[k], start, k, s, lam, slack, mu)
    lam_low, lam_high = start / low, start / high
    here = _Iterate(s, lam, slack, mu, low, high, lam_low, lam_high)
    rows = _ProgramRows(A, at, group, chunks_of(at, group))
    residual = np.empty(n)
    dual = _residual(H, g, box, rows, x, here, residual)
    exact = True  # whether the residual was computed, not assumed to shrink as it does except for rounding
    H_upper, U = np.empty((n, w)), np.empty((n, w))
    upper_band(H, H_upper)
    D, own, S = np.empty(count), np.empty(groups), np.empty(groups)
    newton = _Newton(U, D, S)
    dx, ds, dlam = np.empty(n), np.empty(count), np.empty(count)
    dslack, dmu = np.empty(groups), np.empty(groups)
    step = _NewtonStep(dx, ds, dlam, dslack, dmu)
    second_s, second_slack = np.zeros(count), np.zeros(groups)
    second_low, second_high = np.zeros(n), np.zeros(n)
    second = _Products(second_s, second_slack, second_low, second_high)
    taken, status = 0, 1
    while True:
        gap = _complementarity(here)
        if gap <= accuracy * scale and dual <= accuracy * scale:
            if not exact:
                dual = _residual(H, g, box, rows, x, here, residual)
                exact = True
            if dual <= accuracy * scale:
                status = 0
                break
        if taken == _STEPS:
            break
        for i in range(n):
            for d in range(w):
                U[i, d] = H_upper[i, d]
            U[i, 0] += lam_low[i] / low[i] + lam_high[i] / high[i]
        for k in range(groups):
            own[k] = mu[k] / slack[k]
            for r in range(group[k], group[k + 1]):
                D[r] = lam[r] / s[r]
            S[k] = own[k] + _sum(D, group[k], group[k + 1])
        add_rows(A, at, group, rows.chunks, D, own, S, U)
        if not factorise(U):
            break
        second_s[:] = 0.0
        second_slack[:] = 0.0
        second_low[:] = 0.0
        second_high[:] = 0.0
        _direction(rows, newton, here, residual, price, 0.0, second, step)
        length = _step_length(here, step, 0.0, second)
        target = (_complementarity_after(here, step, length) / gap) ** 3 * gap / total
        for r in range(count):
            second_s[r] = ds[r] * dlam[r]
        for k in range(groups):
            second_slack[k] = dslack[k] * dmu[k]
        for i in range(n):
            second_low[i] = dx[i] * (-lam_low[i] - lam_low[i] / low[i] * dx[i])
            second_high[i] = -dx[i] * (-lam_high[i] + lam_high[i] / high[i] * dx[i])
        _direction(rows, newton, here, residual, price, target, second, step)
        moved = (
            _sum(dx, 0, n) + _sum(ds, 0, count) + _sum(dlam, 0, count) + _sum(dslack, 0, groups) + _sum(dmu, 0, groups)
        )
        if not np.isfinite(moved):
            break  # nothing is left to gain within floating-point precision
        length = _step_length(here, step, target, second)
        length = min(1.0, _TO_THE_WALL * length)
        for r in range(count):
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
        residual *= 1.0 - length
        dual *= 1.0 - length
        exact = False
        taken += 1
    if not _value(H, g, A, b, at, group, price, x) < now:
        x[:] = 0.0
    return x, taken, status if np.isfinite(gap + dual) else 2, gap, dual


@inner_njit(fastmath=SUMS)
def _complementarity(at) -> float:
    """Sum of an iterate's products of slacks and duals."""
    s, lam, slack, mu = at.s, at.lam, at.slack, at.mu
    low, high, lam_low, lam_high = at.low, at.high, at.lam_low, at.lam_high
    gap = 0.0
    for r in range(s.size):
        gap += s[r] * lam[r]
    for k in range(slack.size):
        gap += slack[k] * mu[k]
    for i in range(low.size):
        gap += low[i] * lam_low[i] + high[i] * lam_high[i]
    return gap


@inner_njit(fastmath=SUMS)
def _complementarity_after(at, step, length) -> float:
    """The same sum after a share of a step towards complementarity 0."""
    s, lam, slack, mu = at.s, at.lam, at.slack, at.mu
    low, high, lam_low, lam_high = at.low, at.high, at.lam_low, at.lam_high
    dx, ds, dlam, dslack, dmu = step.x, step.s, step.lam, step.slack, step.mu
    gap = 0.0
    for r in range(s.size):
        gap += (s[r] + length * ds[r]) * (lam[r] + length * dlam[r])
    for k in range(slack.size):
        gap += (slack[k] + length * dslack[k]) * (mu[k] + length * dmu[k])
    for i in range(low.size):
        d_low = -lam_low[i] - lam_low[i] / low[i] * dx[i]
        d_high = -lam_high[i] + lam_high[i] / high[i] * dx[i]
        gap += (low[i] + length * dx[i]) * (lam_low[i] + length * d_low)
        gap += (high[i] - length * dx[i]) * (lam_high[i] + length * d_high)
    return gap


@inner_njit(fastmath=SUMS)
def _step_length(at, step, target, second) -> float:
    """Longest share of a step, up to 1 / _TO_THE_WALL, that keeps everything of an iterate `at` positive.

    One length for primal and dual: with different ones H dx would spoil the dual residual.
    """
    s, lam, slack, mu = at.s, at.lam, at.slack, at.mu
    low, high, lam_low, lam_high = at.low, at.high, at.lam_low, at.lam_high
    dx, ds, dlam, dslack, dmu = step.x, step.s, step.lam, step.slack, step.mu
    sec_low, sec_high = second.low, second.high
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
