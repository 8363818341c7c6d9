"""Compiled: what need not be looked at along a motion, since it was far enough a moment ago.

A margin changes by no more than the two things have moved.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.obstacles.kernel import NO, NONE, YES, outside, over_looks, pair_distance, place_solid

_AHEAD = 30e-3  # m: margins are found that far above what is asked for, which then lasts for some samples
_QUICK = 0.3  # of that: what moves farther from one sample to the next is not looked at ahead


@njit(cache=True, nogil=True, error_model="numpy")
def room_to_spare(table):
    """Room for `let_go`: what margins of pairs, then looks, have to spare (p + k), frames as they were,
    and how far bodies (b) and trees (t) have moved since."""
    b, t = len(table.frame), len(table.tree_frame)
    spare = np.full(len(table.pair) + len(table.look), -np.inf)
    return spare, np.zeros((1 + len(table.axes), 3, 4)), np.zeros(b), np.zeros(t)


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _moved(frames, old, frame, x, y, z, reach):
    """How far a place of a ball around a point of a frame has moved at most [m]: its middle, and the turn's chord."""
    square, chord = 0.0, 0.0
    for i in range(3):
        way = frames[frame, i, 3] - old[frame, i, 3]
        way += (frames[frame, i, 0] - old[frame, i, 0]) * x
        way += (frames[frame, i, 1] - old[frame, i, 1]) * y
        way += (frames[frame, i, 2] - old[frame, i, 2]) * z
        square += way * way
        for k in range(3):
            chord += (frames[frame, i, k] - old[frame, i, k]) ** 2
    return np.sqrt(square) + reach * np.sqrt(0.5 * chord)


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _let_go(
    frame, ball, pair, look, first, tree_frame, T_frame_tree, node_centre, node_reach, frames, spare, old, moved, shifted,
) -> None:  # fmt: skip
    for b in range(len(frame)):
        moved[b] = _moved(frames, old, frame[b], ball[b, 0], ball[b, 1], ball[b, 2], ball[b, 3])
    for t in range(len(tree_frame)):
        if first[t, 1] > 0:
            n0, T = first[t, 2], T_frame_tree[t]
            c = node_centre[n0]
            x = T[0, 0] * c[0] + T[0, 1] * c[1] + T[0, 2] * c[2] + T[0, 3]
            y = T[1, 0] * c[0] + T[1, 1] * c[1] + T[1, 2] * c[2] + T[1, 3]
            z = T[2, 0] * c[0] + T[2, 1] * c[1] + T[2, 2] * c[2] + T[2, 3]
            shifted[t] = _moved(frames, old, tree_frame[t], x, y, z, node_reach[n0])
    p = len(pair)
    for k in range(p):
        spare[k] -= moved[pair[k, 0]] + moved[pair[k, 1]]
    for k in range(len(look)):
        spare[p + k] -= moved[look[k, 0]] + shifted[look[k, 1]]
    for f in range(len(frames)):
        for i in range(3):
            for j in range(4):
                old[f, i, j] = frames[f, i, j]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def let_go(table, room, spare, old, moved, shifted):
    """Lower what margins have to spare by how far their two have moved since the posture before."""
    _let_go(
        table.frame, table.ball, table.pair, table.look, table.first, table.tree_frame, table.T_frame_tree,
        table.node_centre, table.node_reach, room.frames, spare, old, moved, shifted,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _spared_pairs(
    begin, end, enough, stop, spare, moved,
    pair, needed, ball, middle, frames, frame, T_frame_solid, pose, known, kind, size, span, vertices, way, S,
):  # fmt: skip
    best, which = enough, -1
    for k in range(begin, end):
        if spare[k] >= best:
            continue
        a, b = pair[k, 0], pair[k, 1]
        most = best + (_AHEAD if moved[a] + moved[b] < _QUICK * _AHEAD else 0.0)
        square = 0.0
        for m in range(3):
            square += (middle[a, m] - middle[b, m]) ** 2
        spare[k] = np.sqrt(square) - ball[a, 3] - ball[b, 3] - needed[k]
        if spare[k] < most:
            large, small = (a, b) if ball[a, 3] > ball[b, 3] else (b, a)
            place_solid(frames, frame, T_frame_solid, pose, known, large)
            spare[k] = outside(kind, size, pose, middle, large, small) - ball[small, 3] - needed[k]
            if spare[k] < most:
                place_solid(frames, frame, T_frame_solid, pose, known, small)
                spare[k] = pair_distance(
                    kind, size, span, vertices, pose, middle, a, b, most + needed[k], NONE, way, k, S
                )
                spare[k] -= needed[k]
        if spare[k] < best:
            best, which = spare[k], k
            if stop:
                break
    return best, which


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def spared_pairs(table, room, begin, end, enough, stop, spare, moved):
    """The least margin of pairs begin .. end, exact if below `enough` [m], and which has it, or -1; with `stop` the
    first one below. What has enough to spare is passed over, and what the others have is kept."""
    return _spared_pairs(
        begin, end, enough, stop, spare, moved, table.pair, table.needed, table.ball, room.middle, room.frames,
        table.frame, table.T_frame_solid, room.pose, room.known, table.kind, table.size, table.span, table.vertices,
        room.way, room.simplex,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def spared_looks(table, room, begin, end, now, late, enough, stop, spare, moved, shifted):
    """The same of looks, and the point, or -1; without `stop` more looks may have to be asked for, from the next one on.

    late: a time up to which what looks have to spare is to hold, whatever is printed until then.
    """
    p = len(table.pair)
    for k in range(begin, end):
        if spare[p + k] >= enough:
            continue
        if moved[table.look[k, 0]] + shifted[table.look[k, 1]] >= _QUICK * _AHEAD:  # all at once, which takes less time
            spare[p + k : p + end] = NONE
            return over_looks(table, room, k, end, now, enough, stop, YES, YES)
        if not table.head_on_part[k]:  # the head is always near
            spare[p + k], _, _ = over_looks(table, room, k, k + 1, late, enough + _AHEAD, NO, YES, YES)
            if spare[p + k] >= enough:
                continue
        margin, found, point = over_looks(table, room, k, k + 1, now, enough, NO, YES, YES)
        if found >= 0:
            return margin, k, point
    return enough, -1, -1
