"""Lengths of steps of the interior-point method that differ along a leg, slowly: compiled.

A step's length is bounded by the place where a limit would be overrun first. Only its neighbourhood has to step less:
what a length that varies adds to the limits' residuals is small where it varies over many intervals, and the next step
sees it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.readonly import Array

APART = 256  # intervals over which lengths change: thirty times what an arm takes to build up its acceleration
_TO_BOUNDARY = 0.99  # share of the way to the nearest limit that a step may go
_POSITIVE = 0.9  # share of the way to rest that a step may go


@njit(cache=True, nogil=True, error_model="numpy")
def even_out(lengths: Array, sums: Array, mins: Array) -> None:
    """Lower lengths (m), in place, until they change slowly; sums (m + 1) and mins (m) are room."""
    m = len(lengths)
    blocks = (m + APART - 1) // APART
    for b in range(blocks):
        sums[b] = lengths[b * APART : min((b + 1) * APART, m)].min()
    for b in range(blocks):
        least = min(sums[max(b - 1, 0)], sums[b], sums[min(b + 1, blocks - 1)])
        mins[b * APART : min((b + 1) * APART, m)] = least
    average(mins, APART // 2, sums, lengths)
    for i in range(m):
        mins[i] = lengths[i]
    average(mins, APART // 2, sums, lengths)


@njit(cache=True, nogil=True, error_model="numpy")
def average(values: Array, half: int, sums: Array, out: Array) -> None:
    """Fill out (m) with the means of values (m) over `half` neighbours to both sides; sums (m + 1) is room."""
    m = len(values)
    sums[0] = 0.0
    for i in range(m):
        sums[i + 1] = sums[i] + values[i]
    for i in range(m):
        low, high = max(i - half, 0), min(i + half + 1, m)
        out[i] = (sums[high] - sums[low]) / (high - low)


@njit(cache=True, inline="always")
def _falls(mu: float, ds: float, slack: float, dual: float) -> tuple[float, float]:
    """By which share of itself a slack falls in a full step that changes it by ds, and its dual."""
    fall = -ds / slack
    return fall, 1.0 - fall - mu / (slack * dual)


@njit(cache=True, nogil=True, error_model="numpy")
def lengths_of(
    c: Array, step: Array, point: Array, middle: Array, end: Array, a: Array, j: Array, ceiling: Array, mu: Array,
    rooms: tuple[Array, Array, Array], slacks: tuple[Array, Array, Array], duals: tuple[Array, Array, Array],
    primal_lengths: Array, dual_lengths: Array,
) -> None:  # fmt: skip
    """How far along the step c and the slacks (m), and how far the duals (m) may go by each interval; rooms become the
    steps of the slacks."""
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
                    s = slacks[2][e, k, side]
                    ds = rooms[2][e, k, side] - s + (dr - change if side == 0 else dr + change)
                    rooms[2][e, k, side] = ds
                    fall, dual_fall = _falls(mu[i], ds, s, duals[2][e, k, side])
                    primal, dual = max(primal, fall), max(dual, dual_fall)
        primal_lengths[i], dual_lengths[i] = primal, dual
    for i in range(m + 1):
        at = min(i, m - 1)
        s = slacks[0][i]
        ds = rooms[0][i] - s - (point[i, 0] * step[i] + point[i, 1] * step[i + 1]) / ceiling[i]
        rooms[0][i] = ds
        primal, dual = _falls(mu[at], ds, s, duals[0][i])
        for k in range(nj):
            change = a[i, k, 0] * step[i] + a[i, k, 1] * step[i + 1]
            for side in range(2):
                s = slacks[1][i, k, side]
                ds = rooms[1][i, k, side] - s + (-change if side == 0 else change)
                rooms[1][i, k, side] = ds
                fall, dual_fall = _falls(mu[at], ds, s, duals[1][i, k, side])
                primal, dual = max(primal, fall), max(dual, dual_fall)
        primal_lengths[at] = max(primal_lengths[at], primal)
        dual_lengths[at] = max(dual_lengths[at], dual)
    for i in range(m):
        primal_lengths[i], dual_lengths[i] = _TO_BOUNDARY / primal_lengths[i], _TO_BOUNDARY / dual_lengths[i]


@njit(cache=True)
def go(c: Array, step: Array, middle: Array, end: Array, lengths: Array) -> None:
    """Go along the step of c, in place, as far as lengths (m) say; where x would not stay positive, they become the
    least of them, as which it does."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def move(
    primal: Array, dual: Array, mu: Array, steps: Array, slacks: Array, duals: Array, places: int, gaps: Array
) -> None:  # fmt: skip
    """Go these lengths along the steps of slacks and duals, in place; adds their products to gaps (m).

    `places`: of the limits, each with as many of them: points, or twice as many ends as there are intervals.
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
