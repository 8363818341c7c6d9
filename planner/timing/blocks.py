"""Blocks of intervals that are settled or not, and where the limits of places stand among all: compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.readonly import Array
from planner.timing.lengths import APART


@njit(cache=True)
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


@njit(cache=True, inline="always")
def limits_of(
    at: slice, ends: slice, m: int, nj: int
) -> tuple[tuple[slice, int], tuple[slice, int], tuple[slice, int]]:
    """Where the limits of some points and ends stand among all, and of how many places: x, acceleration, jerk."""
    first, last = m + 1, (m + 1) * (1 + 2 * nj)
    points = at.stop - at.start
    return (
        (at, points),
        (slice(first + 2 * nj * at.start, first + 2 * nj * at.stop), points),
        (slice(last + 2 * nj * ends.start, last + 2 * nj * ends.stop), ends.stop - ends.start),
    )


@njit(cache=True)
def split(flat: Array, m: int, nj: int) -> tuple[Array, Array, Array]:
    """One value for each limit (count), seen as those of x (m + 1), of acceleration (m + 1, nj, 2) and of jerk
    (2 m, nj, 2)."""
    first, last = m + 1, (m + 1) * (1 + 2 * nj)
    return flat[:first], flat[first:last].reshape((m + 1, nj, 2)), flat[last:].reshape((2 * m, nj, 2))


@njit(cache=True)
def overrun(room: Array, slack: Array) -> float:
    """Largest share of a limit by which there is less room than slack."""
    worst = -np.inf
    for i in range(len(room)):
        worst = max(worst, slack[i] - room[i])
    return worst
