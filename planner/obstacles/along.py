"""Compiled: margins of many postures, and of the motion between them."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.obstacles.far import let_go, room_to_spare, spared_looks, spared_pairs
from planner.obstacles.kernel import FIRST, NO, YES, least_margin, over_pairs, put
from planner.obstacles.table import DEEP, room_for


@njit(cache=True, nogil=True, error_model="numpy")
def least_margins(table, q, now, enough, more, margin, which) -> None:
    """`least_margin` of postures q (n, nj) at times now (n) into margin and which (n)."""
    room = room_for(table)
    spare, old, moved, shifted = room_to_spare(table)
    p, looks = len(table.pair), len(table.look)
    late = now.max() if len(now) else 0.0
    for i in range(len(q)):
        put(table, room, q, i)
        let_go(table, room, spare, old, moved, shifted)
        best, found = spared_pairs(table, room, FIRST, p, enough + more, NO, spare, moved)
        best, k = best - more, FIRST
        while k < looks:
            near, k, _ = spared_looks(table, room, k, looks, now[i], late, best, NO, spare, moved, shifted)
            if k < 0:
                break
            best, found, k = near, p + k, k + 1
        margin[i], which[i] = best, found


@njit(cache=True, nogil=True, error_model="numpy")
def lacking_at(table, q, lacking) -> None:
    """Which pairs of bodies lack clearance at postures q (n, nj), into lacking (n, p)."""
    room = room_for(table)
    for i in range(len(q)):
        put(table, room, q, i)
        for k in range(len(table.pair)):
            lacking[i, k] = over_pairs(table, room, k, k + 1, 0.0, YES)[1] >= 0


@njit(cache=True, nogil=True, error_model="numpy")
def hit_along(table, q, gone, now, allowed, enough):
    """The first pair found whose margin falls below `allowed` [m] along postures q (n, nj), or -1.

    gone (n): how far anything may have moved since the first [m]. Between two postures that are clear by more than half
    of what may move between them nothing is looked at; margins above `enough` are not told apart.
    """
    room = room_for(table)
    last = len(q) - 1
    margin, which = least_margin(table, room, q, FIRST, now, enough, 0.0)
    if margin < allowed:
        return which
    right, which = least_margin(table, room, q, last, now, enough, 0.0)
    if right < allowed:
        return which
    begin, end = np.empty(DEEP, dtype=np.int64), np.empty(DEEP, dtype=np.int64)
    before, after = np.empty(DEEP), np.empty(DEEP)
    begin[0], end[0], before[0], after[0] = 0, last, margin, right
    waiting = 1
    while waiting:
        waiting -= 1
        a, b, m_a, m_b = begin[waiting], end[waiting], before[waiting], after[waiting]
        if b - a < 2 or gone[b] - gone[a] <= m_a + m_b - 2.0 * allowed:
            continue
        c = (a + b) // 2
        m_c, which = least_margin(table, room, q, c, now, enough, 0.0)
        if m_c < allowed:
            return which
        begin[waiting], end[waiting], before[waiting], after[waiting] = a, c, m_a, m_c
        begin[waiting + 1], end[waiting + 1], before[waiting + 1], after[waiting + 1] = c, b, m_c, m_b
        waiting += 2
    return -1
