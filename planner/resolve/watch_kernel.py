"""What a program watches of rates and ends of ranges, compiled: what is near from the start, and what a step has missed."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.resolve.banded import SUMS
from planner.resolve.price_kernel import allowed

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
