"""Local search on an open tour: turn a piece round, or move a short piece, for as long as that shortens the way."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.readonly import Array, Ints

_LONGEST_MOVED = 3  # samples in a piece that is moved (Or-opt)
_GAIN = 1e-9  # of the mean distance: less is rounding


@njit(cache=True)
def improve(order: Ints, distance: Array) -> Ints:
    """The order (n,) of an open tour, improved until no such move shortens it; distance (n, n) symmetric.

    No two chords of the result cross where distance is that of a plane: turning the piece between them round would
    shorten the tour.
    """
    tour = order.copy()
    n = len(tour)
    total = 0.0
    for k in range(n - 1):
        total += distance[tour[k], tour[k + 1]]
    least = _GAIN * total / max(n - 1, 1)
    better = True
    while better:
        better = False
        for i in range(n - 1):
            for j in range(i + 1, n):
                # tour[i..j] turned round: the chords before i and after j change, where there are any
                change = 0.0
                if i > 0:
                    change += distance[tour[i - 1], tour[j]] - distance[tour[i - 1], tour[i]]
                if j < n - 1:
                    change += distance[tour[i], tour[j + 1]] - distance[tour[j], tour[j + 1]]
                if change < -least:
                    for k in range((j - i + 1) // 2):
                        tour[i + k], tour[j - k] = tour[j - k], tour[i + k]
                    better = True
        for size in range(1, _LONGEST_MOVED + 1):
            for i in range(n - size + 1):
                better = _move(tour, distance, i, size, least) or better
    return tour


@njit(cache=True)
def _move(tour: Ints, distance: Array, i: int, size: int, least: float) -> bool:
    """Move tour[i : i + size] to where it costs least, either way round, if that shortens the tour."""
    n = len(tour)
    last = i + size - 1
    freed = 0.0
    if i > 0:
        freed += distance[tour[i - 1], tour[i]]
    if last < n - 1:
        freed += distance[tour[last], tour[last + 1]]
    if i > 0 and last < n - 1:
        freed -= distance[tour[i - 1], tour[last + 1]]
    rest = np.concatenate((tour[:i], tour[last + 1 :]))
    best, place, back = -least, -1, False
    for p in range(len(rest) + 1):
        for turned in (False, True):
            head, tail = (tour[last], tour[i]) if turned else (tour[i], tour[last])
            price = -freed
            if p > 0:
                price += distance[rest[p - 1], head]
            if p < len(rest):
                price += distance[tail, rest[p]]
            if 0 < p < len(rest):
                price -= distance[rest[p - 1], rest[p]]
            if price < best:
                best, place, back = price, p, turned
    if place < 0:
        return False
    piece = tour[i : last + 1].copy()
    for k in range(n):
        if k < place:
            tour[k] = rest[k]
        elif k < place + size:
            tour[k] = piece[place + size - 1 - k] if back else piece[k - place]
        else:
            tour[k] = rest[k - size]
    return True
