"""Compiled: how much clearance a posture has left, between which bodies, and how that changes with the joints.

Margin is the word for a distance less what is needed there: below 0 clearance lacks. Frames are numbered 0 for the
world, then one for each joint, after its turn: the arm's, then the holder's. Loops stay within functions that take
their arrays one by one: to count who refers to a slice, or to a field of a tuple, costs more than the arithmetic.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.obstacles.gjk import solids_distance
from planner.point_tree import nearest_point
from planner.solids import BOX, CAPSULE, HULL

NONE = -np.inf
# Flags and numbers handed on to other kernels: plain ones are types of their own, for each of which all is compiled anew.
YES, NO, FIRST = np.bool_(True), np.bool_(False), np.int64(0)
MIDDLE, TIP, NORMAL, PLACE = 0, 1, 2, 3  # rows of `Room.few`


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _frames(placements, axes, na, q, row, frames, lines) -> None:
    """Fill frames and lines for the posture in a row of q."""
    for j in range(len(axes)):
        f = 0 if j == na else j
        x, y, z = axes[j, 0], axes[j, 1], axes[j, 2]
        c, s = np.cos(q[row, j]), np.sin(q[row, j])
        t = 1.0 - c
        for i in range(3):
            a0, a1, a2 = frames[f, i, 0], frames[f, i, 1], frames[f, i, 2]
            b0 = a0 * placements[j, 0, 0] + a1 * placements[j, 1, 0] + a2 * placements[j, 2, 0]
            b1 = a0 * placements[j, 0, 1] + a1 * placements[j, 1, 1] + a2 * placements[j, 2, 1]
            b2 = a0 * placements[j, 0, 2] + a1 * placements[j, 1, 2] + a2 * placements[j, 2, 2]
            b3 = a0 * placements[j, 0, 3] + a1 * placements[j, 1, 3] + a2 * placements[j, 2, 3] + frames[f, i, 3]
            lines[j, i] = b3
            lines[j, 3 + i] = b0 * x + b1 * y + b2 * z
            frames[j + 1, i, 0] = b0 * (t * x * x + c) + b1 * (t * x * y + s * z) + b2 * (t * x * z - s * y)
            frames[j + 1, i, 1] = b0 * (t * x * y - s * z) + b1 * (t * y * y + c) + b2 * (t * y * z + s * x)
            frames[j + 1, i, 2] = b0 * (t * x * z + s * y) + b1 * (t * y * z - s * x) + b2 * (t * z * z + c)
            frames[j + 1, i, 3] = b3


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _middles(frame, ball, frames, middle, known) -> None:
    for b in range(len(frame)):
        f = frame[b]
        x, y, z = ball[b, 0], ball[b, 1], ball[b, 2]
        for k in range(3):
            middle[b, k] = frames[f, k, 0] * x + frames[f, k, 1] * y + frames[f, k, 2] * z + frames[f, k, 3]
        known[b] = False


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def put(table, room, q, row) -> None:
    """Bring everything to the posture in a row of q."""
    _frames(table.placements, table.axes, table.arm[0], q, row, room.frames, room.lines)
    _middles(table.frame, table.ball, room.frames, room.middle, room.known)


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def place_solid(frames, frame, T_frame_solid, pose, known, b) -> None:
    """The pose of a body's solid in the world, if it is not known."""
    if known[b]:
        return
    known[b] = True
    f = frame[b]
    for i in range(3):
        for j in range(4):
            total = frames[f, i, 3] if j == 3 else 0.0
            for k in range(3):
                total += frames[f, i, k] * T_frame_solid[b, k, j]
            pose[b, i, j] = total


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def outside(kind, size, pose, middle, b, other):
    """A bound of how far outside of body b the middle of another one lies [m]."""
    if kind[b] == HULL:
        return NONE
    x, y, z = middle[other, 0] - pose[b, 0, 3], middle[other, 1] - pose[b, 1, 3], middle[other, 2] - pose[b, 2, 3]
    u = pose[b, 0, 0] * x + pose[b, 1, 0] * y + pose[b, 2, 0] * z
    v = pose[b, 0, 1] * x + pose[b, 1, 1] * y + pose[b, 2, 1] * z
    w = pose[b, 0, 2] * x + pose[b, 1, 2] * y + pose[b, 2, 2] * z
    if kind[b] == BOX:
        u, v, w = max(abs(u) - size[b, 0], 0.0), max(abs(v) - size[b, 1], 0.0), max(abs(w) - size[b, 2], 0.0)
        return np.sqrt(u * u + v * v + w * w)
    if kind[b] == CAPSULE:
        w = max(abs(w) - size[b, 1], 0.0)
        return np.sqrt(u * u + v * v + w * w) - size[b, 0]
    r = max(np.sqrt(u * u + v * v) - max(size[b, 0], size[b, 1]), 0.0)
    w = max(-w, w - size[b, 2], 0.0)
    return np.sqrt(r * r + w * w)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def pair_distance(kind, size, span, vertices, pose, middle, a, b, enough, little, way, k, S):
    """`solids_distance` of a pair; solids that overlap are apart by their middles."""
    distance = solids_distance(kind, size, span, vertices, pose, a, b, enough, little, way, k, S)
    if way[k, 0] == 0.0 and way[k, 1] == 0.0 and way[k, 2] == 0.0:
        for m in range(3):
            way[k, m] = middle[a, m] - middle[b, m]
            S[0, 3 + m], S[0, 6 + m] = middle[a, m], middle[b, m]
    return distance


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _each_pair(
    first, last, enough, stop,
    pair, needed, ball, middle, frames, frame, T_frame_solid, pose, known, kind, size, span, vertices, way, S,
):  # fmt: skip
    """The least margin of pairs first .. last, if below `enough` [m], and which has it, or -1: exact, or with `stop`
    the first one below, told no better than that."""
    best, which = enough, -1
    for k in range(first, last):
        a, b = pair[k, 0], pair[k, 1]
        x, y, z = middle[a, 0] - middle[b, 0], middle[a, 1] - middle[b, 1], middle[a, 2] - middle[b, 2]
        far = ball[a, 3] + ball[b, 3] + needed[k] + best
        if far < 0.0 or x * x + y * y + z * z > far * far:
            continue
        large, small = (a, b) if ball[a, 3] > ball[b, 3] else (b, a)
        if not known[large]:
            place_solid(frames, frame, T_frame_solid, pose, known, large)
        if outside(kind, size, pose, middle, large, small) - ball[small, 3] - needed[k] >= best:
            continue
        if not known[small]:
            place_solid(frames, frame, T_frame_solid, pose, known, small)
        little = best + needed[k] if stop else NONE
        margin = pair_distance(kind, size, span, vertices, pose, middle, a, b, best + needed[k], little, way, k, S)
        margin -= needed[k]
        if margin < best:
            best, which = margin, k
            if stop:
                break
    return best, which


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def over_pairs(table, room, first, last, enough, stop):
    return _each_pair(
        first, last, enough, stop, table.pair, table.needed, table.ball, room.middle, room.frames, table.frame,
        table.T_frame_solid, room.pose, room.known, table.kind, table.size, table.span, table.vertices, room.way,
        room.simplex,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _into_tree(frames, tree_frame, T_frame_tree, middle, tip, last, few, b, t) -> None:
    """Fill rows of `few` with a body's middle and the nozzle's tip in a tree's frame."""
    f = tree_frame[t]
    for row in range(2):
        x, y, z = middle[b, 0], middle[b, 1], middle[b, 2]
        if row == TIP:
            x, y, z = frames[last, 0, 3], frames[last, 1, 3], frames[last, 2, 3]
            for k in range(3):
                x += frames[last, 0, k] * tip[k]
                y += frames[last, 1, k] * tip[k]
                z += frames[last, 2, k] * tip[k]
        x, y, z = x - frames[f, 0, 3], y - frames[f, 1, 3], z - frames[f, 2, 3]
        u = frames[f, 0, 0] * x + frames[f, 1, 0] * y + frames[f, 2, 0] * z - T_frame_tree[t, 0, 3]
        v = frames[f, 0, 1] * x + frames[f, 1, 1] * y + frames[f, 2, 1] * z - T_frame_tree[t, 1, 3]
        w = frames[f, 0, 2] * x + frames[f, 1, 2] * y + frames[f, 2, 2] * z - T_frame_tree[t, 2, 3]
        for k in range(3):
            few[row, k] = T_frame_tree[t, 0, k] * u + T_frame_tree[t, 1, k] * v + T_frame_tree[t, 2, k] * w


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _solid_from_tree(frames, tree_frame, T_frame_tree, pose, b, t, out) -> None:
    """Fill out (4, 4) with what takes points of a tree's frame into a body's solid."""
    f = tree_frame[t]
    for j in range(4):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(3):
            x += frames[f, 0, k] * T_frame_tree[t, k, j]
            y += frames[f, 1, k] * T_frame_tree[t, k, j]
            z += frames[f, 2, k] * T_frame_tree[t, k, j]
        if j == 3:
            x += frames[f, 0, 3] - pose[b, 0, 3]
            y += frames[f, 1, 3] - pose[b, 1, 3]
            z += frames[f, 2, 3] - pose[b, 2, 3]
        for i in range(3):
            out[i, j] = pose[b, 0, i] * x + pose[b, 1, i] * y + pose[b, 2, i] * z


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _each_look(
    begin, end, now, enough, stop, on_part, off_part,
    look, keep, slack, head_on_part, first, tree_frame, T_frame_tree, points, radius, time, node_centre, node_reach, since,
    left, right, ball, middle, tip, arm, frames, frame, T_frame_solid, pose, known, kind, size, planes, few, into, stack,
):  # fmt: skip
    """The same of bodies looked at by trees, whose points are there before `now`; and the point, or -1.

    on_part, off_part: whether head and part, and whether all else is wanted
    """
    best, which, point = enough, -1, -1
    for k in range(begin, end):
        if not (on_part if head_on_part[k] else off_part):
            continue
        b, t = look[k, 0], look[k, 1]
        p0, n0 = first[t, 0], first[t, 2]
        if first[t, 1] == 0 or since[n0] >= now:
            continue
        _into_tree(frames, tree_frame, T_frame_tree, middle, tip, arm[0], few, b, t)
        square = 0.0
        for m in range(3):
            square += (few[MIDDLE, m] - node_centre[n0, m]) ** 2
        far = ball[b, 3] + node_reach[n0] + keep[k, 0] + best
        if far < 0.0 or square > far * far:
            continue
        if not known[b]:
            place_solid(frames, frame, T_frame_solid, pose, known, b)
        _solid_from_tree(frames, tree_frame, T_frame_tree, pose, b, t, into)
        p1, n1 = p0 + first[t, 1], n0 + first[t, 3]
        margin, found = nearest_point(
            points[p0:p1], radius[p0:p1], time[p0:p1], node_centre[n0:n1], node_reach[n0:n1], since[n0:n1],
            left[n0:n1], right[n0:n1], kind[b], size[b], planes, into, now, best, keep[k, 0], few[TIP], keep[k, 1],
            slack[min(max(int(now), 0), len(slack) - 1)] if head_on_part[k] else keep[k, 2], stack,
        )  # fmt: skip
        if found >= 0:
            best, which, point = margin, k, found
            if stop:
                break
    return best, which, point


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def over_looks(table, room, begin, end, now, enough, stop, on_part, off_part):
    return _each_look(
        begin, end, now, enough, stop, on_part, off_part, table.look, table.keep, table.slack, table.head_on_part, table.first,
        table.tree_frame, table.T_frame_tree, table.points, table.radius, table.time, table.node_centre,
        table.node_reach, table.since, table.left, table.right, table.ball, room.middle, table.tip, table.arm,
        room.frames, table.frame, table.T_frame_solid, room.pose, room.known, table.kind, table.size, table.planes,
        room.few, room.T_solid_tree, room.stack,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def first_lacking(table, room, q, row, now, more, head_on_part):
    """The first pair that lacks clearance at a row of q, or -1: pairs of bodies, then from p on those with trees.

    `more` [m] is asked for between bodies besides; head and part are left out where `head_on_part` is False.
    """
    p = len(table.pair)
    put(table, room, q, row)
    # what hit at the posture before mostly hits again
    before = room.last[0]
    if before < p and over_pairs(table, room, before, before + 1, more, YES)[1] >= 0:
        return before
    _, which = over_pairs(table, room, FIRST, p, more, YES)
    if which >= 0:
        room.last[0] = which
        return which
    _, which, _ = over_looks(table, room, FIRST, len(table.look), now, 0.0, YES, head_on_part, YES)
    return p + which if which >= 0 else -1


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def head_lacking(table, room, q, row, now):
    """Which pair of head and part lacks clearance at a row of q, as in `first_lacking`, or -1.

    Only the nozzle's pose in the part decides that.
    """
    put(table, room, q, row)
    _, which, _ = over_looks(table, room, FIRST, len(table.look), now, 0.0, YES, YES, NO)
    return len(table.pair) + which if which >= 0 else -1


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def least_margin(table, room, q, row, now, enough, more):
    """The least margin at a row of q, if below `enough` [m], and which pair has it, as in `first_lacking`, or -1.

    `more` [m] is asked for between bodies besides.
    """
    put(table, room, q, row)
    p = len(table.pair)
    best, which = over_pairs(table, room, FIRST, p, enough + more, NO)
    best -= more
    nearer, look, _ = over_looks(table, room, FIRST, len(table.look), now, best, NO, YES, YES)
    return (nearer, p + look) if look >= 0 else (best, which)
