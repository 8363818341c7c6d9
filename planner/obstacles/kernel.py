"""Compiled: how much clearance a posture has left, between which bodies, and how that changes with the joints.

Margin is the word for a distance less what is needed there: below 0 clearance lacks. Frames are numbered 0 for the
world, then one for each joint, after its turn: the arm's, then the holder's. Loops stay within functions that take
their arrays one by one: to count who refers to a slice, or to a field of a tuple, costs more than the arithmetic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.obstacles.gjk import solids_distance
from planner.point_tree import nearest_point, solid_distance
from planner.solids import BOX, CAPSULE, HULL

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

_DEEP = 128  # nodes of a tree that wait at once, see `search_room`
_STEP = 1e-6  # m, of the differences that give the direction of a solid's distance
_NONE = -np.inf
_MIDDLE, _TIP, _NORMAL, _PLACE = 0, 1, 2, 3  # rows of `Room.few`


class Table(NamedTuple):
    """Everything that may touch, as numbers (nj joints, b bodies, p pairs of them, t trees, k bodies looked at by trees).

    placements (nj, 4, 4), axes (nj, 3)   as in Chain, of the arm and then the holder; arm (1): how many are the arm's
    tip (3)                               of the nozzle in the arm's last frame
    frame, kind (b), size (b, 4), planes, vertices, span (b, 2)   solids as in Packed; span: first vertex and how many
    T_frame_solid (b, 4, 4), ball (b, 4)  middle and reach of a ball around each, in its frame
    pair (p, 2), needed (p)               bodies that may touch, the distance that they keep [m]
    points .. right                       the trees of `PointTree` end to end
    first (t, 4)                          of each tree: first point, points, first node, nodes
    tree_frame (t), T_frame_tree (t, 4, 4)
    look (k, 2)                           body and tree
    keep (k, 3)                           clearance, slope and slack, see `nearest_point`
    slack (n beads)                       in the place of the third where head and part are, by the bead that is printed
    head_on_part (k)                      head and part: a nozzle's pose in the part alone says how they are
    """

    placements: Array
    axes: Array
    arm: Index
    tip: Array
    frame: Index
    kind: Index
    size: Array
    planes: Array
    vertices: Array
    span: Index
    T_frame_solid: Array
    ball: Array
    pair: Index
    needed: Array
    points: Array
    radius: Array
    time: Array
    node_centre: Array
    node_reach: Array
    since: Array
    left: Index
    right: Index
    first: Index
    tree_frame: Index
    T_frame_tree: Array
    look: Index
    keep: Array
    slack: Array
    head_on_part: Flags


class Room(NamedTuple):
    """Room for one thread: frames (nf, 4, 4), joints' origins and directions (nj, 6), bodies' middles (b, 3) and poses
    of solids (b, 4, 4) in the world, which of these are known, directions that parted pairs (p, 3), simplex (4, 9)."""

    frames: Array
    lines: Array
    middle: Array
    pose: Array
    known: Flags
    way: Array
    simplex: Array
    few: Array
    T_solid_tree: Array
    stack: Index
    last: Index


@njit(cache=True, nogil=True)
def room_for(table):
    """A thread's room."""
    nj, b = len(table.axes), len(table.frame)
    frames = np.zeros((1 + nj, 4, 4))
    frames[:, 3, 3] = 1.0
    for k in range(3):
        frames[0, k, k] = 1.0
    pose = np.zeros((b, 4, 4))
    pose[:, 3, 3] = 1.0
    into = np.zeros((4, 4))
    into[3, 3] = 1.0
    return Room(
        frames, np.zeros((nj, 6)), np.zeros((b, 3)), pose, np.zeros(b, dtype=np.bool_), np.ones((len(table.pair), 3)),
        np.zeros((4, 9)), np.zeros((4, 3)), into, np.zeros(_DEEP, dtype=np.int64), np.zeros(1, dtype=np.int64),
    )  # fmt: skip


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
def _put(table, room, q, row) -> None:
    """Bring everything to the posture in a row of q."""
    _frames(table.placements, table.axes, table.arm[0], q, row, room.frames, room.lines)
    _middles(table.frame, table.ball, room.frames, room.middle, room.known)


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _solid(frames, frame, T_frame_solid, pose, known, b) -> None:
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
def _outside(kind, size, pose, middle, b, other):
    """A bound of how far outside of body b the middle of another one lies [m]."""
    if kind[b] == HULL:
        return _NONE
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


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _over_pairs(
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
            _solid(frames, frame, T_frame_solid, pose, known, large)
        if _outside(kind, size, pose, middle, large, small) - ball[small, 3] - needed[k] >= best:
            continue
        if not known[small]:
            _solid(frames, frame, T_frame_solid, pose, known, small)
        little = best + needed[k] if stop else _NONE
        margin = solids_distance(kind, size, span, vertices, pose, a, b, best + needed[k], little, way, k, S)
        margin -= needed[k]
        if way[k, 0] == 0.0 and way[k, 1] == 0.0 and way[k, 2] == 0.0:  # they overlap: apart by their middles
            for m in range(3):
                way[k, m] = middle[a, m] - middle[b, m]
                S[0, 3 + m], S[0, 6 + m] = middle[a, m], middle[b, m]
        if margin < best:
            best, which = margin, k
            if stop:
                break
    return best, which


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _pairs(table, room, first, last, enough, stop):
    return _over_pairs(
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
        if row == _TIP:
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
def _over_looks(
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
            square += (few[_MIDDLE, m] - node_centre[n0, m]) ** 2
        far = ball[b, 3] + node_reach[n0] + keep[k, 0] + best
        if far < 0.0 or square > far * far:
            continue
        if not known[b]:
            _solid(frames, frame, T_frame_solid, pose, known, b)
        _solid_from_tree(frames, tree_frame, T_frame_tree, pose, b, t, into)
        p1, n1 = p0 + first[t, 1], n0 + first[t, 3]
        margin, found = nearest_point(
            points[p0:p1], radius[p0:p1], time[p0:p1], node_centre[n0:n1], node_reach[n0:n1], since[n0:n1],
            left[n0:n1], right[n0:n1], kind[b], size[b], planes, into, now, best, keep[k, 0], few[_TIP], keep[k, 1],
            slack[min(max(int(now), 0), len(slack) - 1)] if head_on_part[k] else keep[k, 2], stack,
        )  # fmt: skip
        if found >= 0:
            best, which, point = margin, k, found
            if stop:
                break
    return best, which, point


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _looks(table, room, begin, end, now, enough, stop, on_part, off_part):
    return _over_looks(
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
    _put(table, room, q, row)
    # what hit at the posture before mostly hits again
    before = room.last[0]
    if before < p and _pairs(table, room, before, before + 1, more, True)[1] >= 0:
        return before
    _, which = _pairs(table, room, 0, p, more, True)
    if which >= 0:
        room.last[0] = which
        return which
    _, which, _ = _looks(table, room, 0, len(table.look), now, 0.0, True, head_on_part, True)
    return p + which if which >= 0 else -1


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def head_lacking(table, room, q, row, now):
    """Which pair of head and part lacks clearance at a row of q, as in `first_lacking`, or -1.

    Only the nozzle's pose in the part decides that.
    """
    _put(table, room, q, row)
    _, which, _ = _looks(table, room, 0, len(table.look), now, 0.0, True, True, False)
    return len(table.pair) + which if which >= 0 else -1


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def least_margin(table, room, q, row, now, enough, more):
    """The least margin at a row of q, if below `enough` [m], and which pair has it, as in `first_lacking`, or -1.

    `more` [m] is asked for between bodies besides.
    """
    _put(table, room, q, row)
    p = len(table.pair)
    best, which = _pairs(table, room, 0, p, enough + more, False)
    best -= more
    nearer, look, _ = _looks(table, room, 0, len(table.look), now, best, False, True, True)
    return (nearer, p + look) if look >= 0 else (best, which)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_slope(lines, na, frame, n0, n1, n2, x, y, z, sign, slope, row, col) -> None:
    """Add to slope how fast a place of the world that moves with a frame goes along a normal, times a sign."""
    for j in range(0 if frame <= na else na, frame):
        d0, d1, d2 = lines[j, 3], lines[j, 4], lines[j, 5]
        u, v, w = x - lines[j, 0], y - lines[j, 1], z - lines[j, 2]
        slope[row, col, j] += sign * (n0 * (d1 * w - d2 * v) + n1 * (d2 * u - d0 * w) + n2 * (d0 * v - d1 * u))


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _pair_slope(table, room, k, slope, row, col) -> None:
    """Fill slope[row, col] (nj) with the change of a pair's margin by the joints, after `_pairs` found it."""
    slope[row, col] = 0.0
    x, y, z = room.way[k, 0], room.way[k, 1], room.way[k, 2]
    size = np.sqrt(x * x + y * y + z * z)
    if size == 0.0:
        return
    x, y, z = x / size, y / size, z / size
    S, na = room.simplex, table.arm[0]
    a, b = table.frame[table.pair[k, 0]], table.frame[table.pair[k, 1]]
    _add_slope(room.lines, na, a, x, y, z, S[0, 3], S[0, 4], S[0, 5], 1.0, slope, row, col)
    _add_slope(room.lines, na, b, x, y, z, S[0, 6], S[0, 7], S[0, 8], -1.0, slope, row, col)


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _look_slope(table, room, k, point, slope, row, col) -> None:
    """The same of a body and a point of a tree, after `_looks` found it; the tip stays on the part."""
    slope[row, col] = 0.0
    b, t, na = table.look[k, 0], table.look[k, 1], table.arm[0]
    p, f = table.first[t, 0] + point, table.tree_frame[t]
    inside, normal, place = room.few[_MIDDLE], room.few[_NORMAL], room.few[_PLACE]
    for i in range(3):
        inside[i], normal[i] = room.T_solid_tree[i, 3], table.T_frame_tree[t, i, 3]
        for m in range(3):
            inside[i] += room.T_solid_tree[i, m] * table.points[p, m]
            normal[i] += table.T_frame_tree[t, i, m] * table.points[p, m]
    for i in range(3):
        place[i] = room.frames[f, i, 3]
        for m in range(3):
            place[i] += room.frames[f, i, m] * normal[m]
    x, y, z = inside[0], inside[1], inside[2]
    kind, size, planes = table.kind[b], table.size[b], table.planes
    h = _STEP
    dx = solid_distance(kind, size, planes, x + h, y, z) - solid_distance(kind, size, planes, x - h, y, z)
    dy = solid_distance(kind, size, planes, x, y + h, z) - solid_distance(kind, size, planes, x, y - h, z)
    dz = solid_distance(kind, size, planes, x, y, z + h) - solid_distance(kind, size, planes, x, y, z - h)
    for m in range(3):  # from the solid to the point
        normal[m] = (room.pose[b, m, 0] * dx + room.pose[b, m, 1] * dy + room.pose[b, m, 2] * dz) / (2.0 * h)
    n0, n1, n2 = normal[0], normal[1], normal[2]
    _add_slope(room.lines, na, f, n0, n1, n2, place[0], place[1], place[2], 1.0, slope, row, col)
    _add_slope(room.lines, na, table.frame[b], n0, n1, n2, place[0], place[1], place[2], -1.0, slope, row, col)


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_margins(table, q, now, wanted, enough, margin, slope, which) -> None:
    """The least margins below `enough` [m] at postures q (n, nj) where wanted (n), at most m of each, and their slopes.

    margin (n, m), slope (n, m, nj) by the joints, which (n, m): pairs as in `first_lacking`. What is left over has the
    margin `enough`, no slope, and -1.
    """
    room = room_for(table)
    p = len(table.pair)
    margin[:] = enough
    slope[:] = 0.0
    which[:] = -1
    for i in range(len(q)):
        if not wanted[i]:
            continue
        _put(table, room, q, i)
        worst = 0
        for k in range(p + len(table.look)):
            most = margin[i, worst]
            if k < p:
                found, pair = _pairs(table, room, k, k + 1, most, False)
                if pair >= 0:
                    _pair_slope(table, room, k, slope, i, worst)
            else:
                found, pair, point = _looks(table, room, k - p, k - p + 1, now[i], most, False, True, True)
                if pair >= 0:
                    _look_slope(table, room, k - p, point, slope, i, worst)
            if pair < 0:
                continue
            margin[i, worst], which[i, worst] = found, k
            for m in range(margin.shape[1]):
                if margin[i, m] > margin[i, worst]:
                    worst = m


@njit(cache=True, nogil=True, error_model="numpy")
def least_margins(table, q, now, enough, more, margin, which) -> None:
    """`least_margin` of postures q (n, nj) at times now (n) into margin and which (n)."""
    room = room_for(table)
    for i in range(len(q)):
        margin[i], which[i] = least_margin(table, room, q, i, now[i], enough, more)


@njit(cache=True, nogil=True, error_model="numpy")
def lacking_at(table, q, lacking) -> None:
    """Which pairs of bodies lack clearance at postures q (n, nj), into lacking (n, p)."""
    room = room_for(table)
    for i in range(len(q)):
        _put(table, room, q, i)
        for k in range(len(table.pair)):
            lacking[i, k] = _pairs(table, room, k, k + 1, 0.0, True)[1] >= 0


@njit(cache=True, nogil=True, error_model="numpy")
def hit_along(table, q, gone, now, allowed, enough):
    """The first pair found whose margin falls below `allowed` [m] along postures q (n, nj), or -1.

    gone (n): how far anything may have moved since the first [m]. Between two postures that are clear by more than half
    of what may move between them nothing is looked at; margins above `enough` are not told apart.
    """
    room = room_for(table)
    last = len(q) - 1
    margin, which = least_margin(table, room, q, 0, now, enough, 0.0)
    if margin < allowed:
        return which
    right, which = least_margin(table, room, q, last, now, enough, 0.0)
    if right < allowed:
        return which
    begin, end = np.empty(_DEEP, dtype=np.int64), np.empty(_DEEP, dtype=np.int64)
    before, after = np.empty(_DEEP), np.empty(_DEEP)
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
