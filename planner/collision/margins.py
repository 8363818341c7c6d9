"""How much clearance postures and motions have left, between which bodies, and its slope by the joints; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.cell.solids import BOX, CAPSULE, HULL
from planner.collision.gjk import solids_distance
from planner.collision.point_tree import SolidNumbers, TipRule, TreeArrays, nearest_point, solid_distance
from planner.collision.table import workspace_for

# ----------------------------------------------------------------------------------------------------
# Compiled: how much clearance a posture has left, between which bodies, and how that changes with the joints.
#
# A margin is a distance less what is required there: below 0, clearance is missing. Frame 0 is the world, then comes
# one for each joint, after its motion: the arm's, then the holder's. Loops use local names for arrays: counting
# references to a slice, or to a field of a tuple, costs more than the arithmetic.

NONE = -np.inf
# Flags and numbers handed on to other kernels: plain ones are other types, for which all would be compiled again.
YES, NO, FIRST = np.bool_(True), np.bool_(False), np.int64(0)
MIDDLE, TIP, NORMAL, PLACE = 0, 1, 2, 3  # rows of `Workspace.few`
_DEEPEST = 128  # most intervals pending at once: twice the halvings of as many postures as an index can count
SUNK = 20e-3  # m: of points deeper than this in a body, any will do; finding the deepest takes a hundred times as long


@inner_njit(inline="never")
def _frames(placements, axes, na, q, row, frames, lines) -> None:
    """Fill frames and lines for the posture in a row of q."""
    for j in range(len(axes)):
        f = 0 if j == na else j
        x, y, z = axes[j, 0], axes[j, 1], axes[j, 2]
        slides = x == 0.0 and y == 0.0 and z == 0.0
        way = q[row, j] if slides else 0.0
        turned = 0.0 if slides else q[row, j]
        c, s = np.cos(turned), np.sin(turned)
        t = 1.0 - c
        for i in range(3):
            a0, a1, a2 = frames[f, i, 0], frames[f, i, 1], frames[f, i, 2]
            b0 = a0 * placements[j, 0, 0] + a1 * placements[j, 1, 0] + a2 * placements[j, 2, 0]
            b1 = a0 * placements[j, 0, 1] + a1 * placements[j, 1, 1] + a2 * placements[j, 2, 1]
            b2 = a0 * placements[j, 0, 2] + a1 * placements[j, 1, 2] + a2 * placements[j, 2, 2]
            b3 = a0 * placements[j, 0, 3] + a1 * placements[j, 1, 3] + a2 * placements[j, 2, 3] + frames[f, i, 3]
            lines[j, i] = b3
            lines[j, 3 + i] = b0 * x + b1 * y + b2 * z
            if slides:  # its direction of motion, and no axis of rotation
                lines[j, i] = b0 * axes[j, 3] + b1 * axes[j, 4] + b2 * axes[j, 5]
                b3 += way * lines[j, i]
            frames[j + 1, i, 0] = b0 * (t * x * x + c) + b1 * (t * x * y + s * z) + b2 * (t * x * z - s * y)
            frames[j + 1, i, 1] = b0 * (t * x * y - s * z) + b1 * (t * y * y + c) + b2 * (t * y * z + s * x)
            frames[j + 1, i, 2] = b0 * (t * x * z + s * y) + b1 * (t * y * z - s * x) + b2 * (t * z * z + c)
            frames[j + 1, i, 3] = b3


@inner_njit(inline="never")
def _middles(frame, ball, frames, middle, known) -> None:
    for b in range(len(frame)):
        f = frame[b]
        x, y, z = ball[b, 0], ball[b, 1], ball[b, 2]
        for k in range(3):
            middle[b, k] = frames[f, k, 0] * x + frames[f, k, 1] * y + frames[f, k, 2] * z + frames[f, k, 3]
        known[b] = False


@njit(inline="always")
def put(table, room, q, row) -> None:
    """Bring everything to the posture in a row of q."""
    _frames(table.placements, table.axes, table.arm[0], q, row, room.frames, room.lines)
    _middles(table.frame, table.ball, room.frames, room.middle, room.known)


@inner_njit(inline="never")
def place_solid(frames, frame, T_frame_solid, pose, known, b) -> None:
    """Compute the pose of a body's solid in the world, if it is not known yet."""
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


@inner_njit(inline="never")
def outside(kind, size, pose, middle, b, other):
    """A lower bound on how far outside body b the middle of another one is [m]."""
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


@njit(inline="always")
def part_by_middles(middle, a, b, way, k, S) -> None:
    """After `solids_distance` of a pair k: solids that overlap are separated along the line of their middles."""
    if way[k, 0] == 0.0 and way[k, 1] == 0.0 and way[k, 2] == 0.0:
        for m in range(3):
            way[k, m] = middle[a, m] - middle[b, m]
            S[0, 3 + m], S[0, 6 + m] = middle[a, m], middle[b, m]


@inner_njit(inline="never")
def over_pairs(table, room, first, last, enough, stop):
    """The least margin of pairs first .. last, if below `enough` [m], and which has it, or -1: exact, or with `stop`
    the first one below, known no better than that."""
    pair, needed, ball, frame, T_frame_solid = table.pair, table.needed, table.ball, table.frame, table.T_frame_solid
    kind, size, span, vertices = table.kind, table.size, table.span, table.vertices
    middle, frames, pose, known = room.middle, room.frames, room.pose, room.known
    way, S = room.way, room.simplex
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
        margin = solids_distance(kind, size, span, vertices, pose, a, b, best + needed[k], little, way, k, S)
        part_by_middles(middle, a, b, way, k, S)
        margin -= needed[k]
        if margin < best:
            best, which = margin, k
            if stop:
                break
    return best, which


@inner_njit(inline="never")
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


@inner_njit(inline="never")
def _solid_from_tree(frames, tree_frame, T_frame_tree, pose, b, t, out) -> None:
    """Fill out (4, 4) with the transform from a tree's frame to that of a body's solid."""
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


@inner_njit(inline="never")
def over_looks(table, room, begin, end, now, enough, stop, on_part, off_part):
    """The same for looks, each a body and a tree, with points that are there before `now`; and the point, or -1.

    on_part, off_part: whether looks of head and part are wanted, and whether all others are
    """
    look, keep, slack, graze = table.look, table.keep, table.slack, table.graze
    head_on_part = table.head_on_part
    first, tree_frame, T_frame_tree = table.first, table.tree_frame, table.T_frame_tree
    points, radius, time, since = table.points, table.radius, table.time, table.since
    node_centre, node_reach, left, right = table.node_centre, table.node_reach, table.left, table.right
    ball, frame, T_frame_solid = table.ball, table.frame, table.T_frame_solid
    kind, size, planes, tip, arm = table.kind, table.size, table.planes, table.tip, table.arm
    middle, frames, pose, known = room.middle, room.frames, room.pose, room.known
    few, into = room.few, room.T_solid_tree
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
        tree = TreeArrays(
            points[p0:p1], radius[p0:p1], time[p0:p1], node_centre[n0:n1], node_reach[n0:n1], since[n0:n1],
            left[n0:n1], right[n0:n1],
        )  # fmt: skip
        own, deep = keep[k, 2], np.inf
        if head_on_part[k]:
            bead = min(max(int(now), 0), len(slack) - 1)
            own, deep = slack[bead], graze[bead]
        solid, rule = SolidNumbers(kind[b], size[b], planes), TipRule(keep[k, 0], keep[k, 1], own, deep)
        margin, found = nearest_point(tree, solid, into, few[TIP], rule, now, best, SUNK, room.search)
        if found >= 0:
            best, which, point = margin, k, found
            if stop:
                break
    return best, which, point


@inner_njit(inline="never")
def first_lacking(table, room, q, row, now, more, head_on_part):
    """The first pair that lacks clearance at a row of q, or -1: pairs of bodies, then from p on those with trees.

    `more` [m] is required between bodies in addition; head and part are left out if `head_on_part` is False.
    """
    p = len(table.pair)
    put(table, room, q, row)
    # what hit at the previous posture mostly hits again
    before = room.last[0]
    if before < p and over_pairs(table, room, before, before + 1, more, YES)[1] >= 0:
        return before
    _, which = over_pairs(table, room, FIRST, p, more, YES)
    if which >= 0:
        room.last[0] = which
        return which
    _, which, _ = over_looks(table, room, FIRST, len(table.look), now, 0.0, YES, head_on_part, YES)
    return p + which if which >= 0 else -1


@inner_njit(inline="never")
def head_lacking(table, room, q, row, now):
    """Which pair of head and part lacks clearance at a row of q, as in `first_lacking`, or -1.

    This depends only on the nozzle's pose in the part.
    """
    put(table, room, q, row)
    _, which, _ = over_looks(table, room, FIRST, len(table.look), now, 0.0, YES, YES, NO)
    return len(table.pair) + which if which >= 0 else -1


@inner_njit(inline="never")
def least_margin(table, room, q, row, now, enough, more):
    """The least margin at a row of q, if below `enough` [m], and which pair has it, as in `first_lacking`, or -1.

    `more` [m] is required between bodies in addition.
    """
    put(table, room, q, row)
    p = len(table.pair)
    best, which = over_pairs(table, room, FIRST, p, enough + more, NO)
    best -= more
    nearer, look, _ = over_looks(table, room, FIRST, len(table.look), now, best, NO, YES, YES)
    return (nearer, p + look) if look >= 0 else (best, which)


# ----------------------------------------------------------------------------------------------------
# Compiled: which pairs need no check along a motion, since they were far enough apart a moment ago.
#
# A margin changes by no more than the two things have moved.

_AHEAD = 30e-3  # m: margins are found up to this far above what is required, which then lasts for some samples
_QUICK = 0.3  # share of that: pairs that move farther from one sample to the next are not checked ahead


class ToSpare(NamedTuple):
    """What need not be checked yet, from posture to posture; one for each thread.

    spare (p + k) [m]          lower bounds on the margins of pairs, then of looks
    frames (1 + nj, 3, 4)      as they were at the previous posture
    moved (b), shifted (t) [m] the farthest that bodies and trees may have moved since then
    """

    spare: Array
    frames: Array
    moved: Array
    shifted: Array


@inner_njit
def room_to_spare(table):
    """Nothing to spare yet."""
    b, t = len(table.frame), len(table.tree_frame)
    spare = np.full(len(table.pair) + len(table.look), -np.inf)
    return ToSpare(spare, np.zeros((1 + len(table.axes), 3, 4)), np.zeros(b), np.zeros(t))


@inner_njit(inline="never")
def _moved(frames, old, frame, x, y, z, reach):
    """Upper bound on how far a ball around a point of a frame has moved [m]: its centre, and the turn's chord."""
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


@inner_njit(inline="never")
def let_go(table, room, past) -> None:
    """Reduce each stored lower bound by how far its two bodies have moved since the previous posture."""
    frame, ball, pair, look, first = table.frame, table.ball, table.pair, table.look, table.first
    tree_frame, T_frame_tree = table.tree_frame, table.T_frame_tree
    node_centre, node_reach = table.node_centre, table.node_reach
    frames, old = room.frames, past.frames
    spare, moved, shifted = past.spare, past.moved, past.shifted
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


@inner_njit(inline="never")
def spared_pairs(table, room, past, begin, end, enough, stop):
    """The least margin of pairs begin .. end, exact if below `enough` [m], and which has it, or -1; with `stop` the
    first one below. Pairs with enough to spare are skipped, and what the others have is stored."""
    spare, moved = past.spare, past.moved
    pair, needed, ball, frame, T_frame_solid = table.pair, table.needed, table.ball, table.frame, table.T_frame_solid
    kind, size, span, vertices = table.kind, table.size, table.span, table.vertices
    middle, frames, pose, known = room.middle, room.frames, room.pose, room.known
    way, S = room.way, room.simplex
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
                spare[k] = solids_distance(kind, size, span, vertices, pose, a, b, most + needed[k], NONE, way, k, S)
                part_by_middles(middle, a, b, way, k, S)
                spare[k] -= needed[k]
        if spare[k] < best:
            best, which = spare[k], k
            if stop:
                break
    return best, which


@njit(inline="always")
def spared_looks(table, room, past, begin, end, now, late, enough, stop):
    """The same for looks, and the point, or -1; without `stop`, the caller may have to continue from the next look on.

    late: a time up to which the stored bounds of looks have to hold, whatever is printed until then.
    """
    p, spare, moved, shifted = len(table.pair), past.spare, past.moved, past.shifted
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


# ----------------------------------------------------------------------------------------------------
# Compiled: margins of many postures, and of the motion between them.


@njit
def least_margins(table, q, now, enough, more, margin, which) -> None:
    """`least_margin` of postures q (n, nj) at times now (n) into margin and which (n)."""
    room = workspace_for(table)
    past = room_to_spare(table)
    p, looks = len(table.pair), len(table.look)
    late = now.max() if len(now) else 0.0
    for i in range(len(q)):
        put(table, room, q, i)
        let_go(table, room, past)
        best, found = spared_pairs(table, room, past, FIRST, p, enough + more, NO)
        best, k = best - more, FIRST
        while k < looks:
            near, k, _ = spared_looks(table, room, past, k, looks, now[i], late, best, NO)
            if k < 0:
                break
            best, found, k = near, p + k, k + 1
        margin[i], which[i] = best, found


@njit
def lacking_at(table, q, now, lacking) -> None:
    """Fill lacking (n, p + k): which pairs, then looks, lack clearance at postures q (n, nj) at a time of the print."""
    room, p = workspace_for(table), len(table.pair)
    for i in range(len(q)):
        put(table, room, q, i)
        for k in range(p):
            lacking[i, k] = over_pairs(table, room, k, k + 1, 0.0, YES)[1] >= 0
        for k in range(len(table.look)):
            lacking[i, p + k] = over_looks(table, room, k, k + 1, now, 0.0, YES, YES, YES)[1] >= 0


@njit
def hit_along(table, q, gone, now, allowed, enough):
    """The first pair found whose margin falls below `allowed` [m] along postures q (n, nj), or -1.

    gone (n): by how much any margin may have changed since the first posture [m]. Nothing is checked between two
    postures whose margins beyond `allowed` add up to at least the change between them; above `enough`, margins are not
    distinguished.
    """
    room = workspace_for(table)
    last = len(q) - 1
    margin, which = least_margin(table, room, q, FIRST, now, enough, 0.0)
    if margin < allowed:
        return which
    right, which = least_margin(table, room, q, last, now, enough, 0.0)
    if right < allowed:
        return which
    begin, end = np.empty(_DEEPEST, dtype=np.int64), np.empty(_DEEPEST, dtype=np.int64)
    before, after = np.empty(_DEEPEST), np.empty(_DEEPEST)
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


# ----------------------------------------------------------------------------------------------------
# Compiled: how the least margins of a posture change with its joints.

_STEP = 1e-6  # m, of the finite differences that give the direction of a solid's distance


@inner_njit
def _add_slope(lines, na, frame, normal, at, sign, slope, row, col) -> None:
    """Add to slope, times a sign, how fast a place that moves with a frame goes along a normal (three numbers each)."""
    n0, n1, n2 = normal
    x, y, z = at
    for j in range(0 if frame <= na else na, frame):
        d0, d1, d2 = lines[j, 3], lines[j, 4], lines[j, 5]
        if d0 == 0.0 and d1 == 0.0 and d2 == 0.0:
            slope[row, col, j] += sign * (n0 * lines[j, 0] + n1 * lines[j, 1] + n2 * lines[j, 2])
            continue
        u, v, w = x - lines[j, 0], y - lines[j, 1], z - lines[j, 2]
        slope[row, col, j] += sign * (n0 * (d1 * w - d2 * v) + n1 * (d2 * u - d0 * w) + n2 * (d0 * v - d1 * u))


@inner_njit(inline="never")
def _pair_slope(table, room, k, slope, row, col) -> None:
    """Fill slope[row, col] (nj) with the change of a pair's margin by the joints, after `over_pairs` found it."""
    slope[row, col] = 0.0
    x, y, z = room.way[k, 0], room.way[k, 1], room.way[k, 2]
    size = np.sqrt(x * x + y * y + z * z)
    if size == 0.0:
        return
    x, y, z = x / size, y / size, z / size
    S, na = room.simplex, table.arm[0]
    a, b = table.frame[table.pair[k, 0]], table.frame[table.pair[k, 1]]
    _add_slope(room.lines, na, a, (x, y, z), (S[0, 3], S[0, 4], S[0, 5]), 1.0, slope, row, col)
    _add_slope(room.lines, na, b, (x, y, z), (S[0, 6], S[0, 7], S[0, 8]), -1.0, slope, row, col)


@inner_njit(inline="never")
def _look_slope(table, room, k, point, slope, row, col) -> None:
    """The same for a body and a point of a tree, after `over_looks` found it; the tip is taken to stay on the part."""
    slope[row, col] = 0.0
    b, t, na = table.look[k, 0], table.look[k, 1], table.arm[0]
    p, f = table.first[t, 0] + point, table.tree_frame[t]
    inside, normal, place = room.few[MIDDLE], room.few[NORMAL], room.few[PLACE]
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
    along, at = (normal[0], normal[1], normal[2]), (place[0], place[1], place[2])
    _add_slope(room.lines, na, f, along, at, 1.0, slope, row, col)
    _add_slope(room.lines, na, table.frame[b], along, at, -1.0, slope, row, col)


@inner_njit
def _greatest(margin, row):
    worst = 0
    for k in range(margin.shape[1]):
        if margin[row, k] > margin[row, worst]:
            worst = k
    return worst


@njit
def nearest_margins(table, q, now, wanted, enough, enough_of_points, margin, slope, which) -> None:
    """The least margins below `enough` [m] at postures q (n, nj) where wanted (n), at most m of each, and their slopes.

    enough_of_points [m] is the same for pairs with trees, and no more than `enough`.

    margin (n, m), slope (n, m, nj) by the joints, which (n, m): pairs as in `first_lacking`. Unused entries have the
    margin `enough`, no slope, and -1; rows that are not wanted stay as they are.
    """
    room = workspace_for(table)
    p, looks = len(table.pair), len(table.look)
    past = room_to_spare(table)
    late = now.max() if len(now) else 0.0
    for i in range(len(q)):
        if not wanted[i]:
            continue
        margin[i] = enough
        slope[i] = 0.0
        which[i] = -1
        put(table, room, q, i)
        let_go(table, room, past)
        worst, k = FIRST, FIRST
        while k < p:  # from one near pair to the next
            found, k = spared_pairs(table, room, past, k, p, margin[i, worst], YES)
            if k < 0:
                break
            _pair_slope(table, room, k, slope, i, worst)
            margin[i, worst], which[i, worst] = found, k
            worst = _greatest(margin, i)
            k += 1
        k = FIRST
        while k < looks:
            most = min(margin[i, worst], enough_of_points)
            found, k, point = spared_looks(table, room, past, k, looks, now[i], late, most, YES)
            if k < 0:
                break
            _look_slope(table, room, k, point, slope, i, worst)
            margin[i, worst], which[i, worst] = found, p + k
            worst = _greatest(margin, i)
            k += 1
