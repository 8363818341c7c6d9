"""Least and mean of values around each place of a row of places: compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.readonly import Array


@njit(cache=True, nogil=True)
def least_nearby(values: Array, at: Array, reach: float) -> Array:
    """Least of values (n) whose places `at` (n), which never fall, are within `reach` of each place's own."""
    n = len(values)
    out = np.empty(n)
    waiting = np.empty(n, dtype=np.int64)  # places that may be the least for some time yet, their values growing
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


@njit(cache=True, nogil=True)
def mean_nearby(values: Array, at: Array, reach: float) -> Array:
    """Means of values (n) whose places `at` (n), which never fall, are within `reach` of each place's own."""
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
