"""Compiled: how the least margins of a posture change with its joints."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.obstacles.far import let_go, room_to_spare, spared_looks, spared_pairs
from planner.obstacles.kernel import FIRST, MIDDLE, NORMAL, PLACE, YES, put
from planner.obstacles.table import room_for
from planner.point_tree import solid_distance

_STEP = 1e-6  # m, of the differences that give the direction of a solid's distance


@njit(cache=True, nogil=True, error_model="numpy")
def _add_slope(lines, na, frame, n0, n1, n2, x, y, z, sign, slope, row, col) -> None:
    """Add to slope how fast a place of the world that moves with a frame goes along a normal, times a sign."""
    for j in range(0 if frame <= na else na, frame):
        d0, d1, d2 = lines[j, 3], lines[j, 4], lines[j, 5]
        u, v, w = x - lines[j, 0], y - lines[j, 1], z - lines[j, 2]
        slope[row, col, j] += sign * (n0 * (d1 * w - d2 * v) + n1 * (d2 * u - d0 * w) + n2 * (d0 * v - d1 * u))


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
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
    _add_slope(room.lines, na, a, x, y, z, S[0, 3], S[0, 4], S[0, 5], 1.0, slope, row, col)
    _add_slope(room.lines, na, b, x, y, z, S[0, 6], S[0, 7], S[0, 8], -1.0, slope, row, col)


@njit(cache=True, nogil=True, error_model="numpy", inline="never")
def _look_slope(table, room, k, point, slope, row, col) -> None:
    """The same of a body and a point of a tree, after `over_looks` found it; the tip stays on the part."""
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
    n0, n1, n2 = normal[0], normal[1], normal[2]
    _add_slope(room.lines, na, f, n0, n1, n2, place[0], place[1], place[2], 1.0, slope, row, col)
    _add_slope(room.lines, na, table.frame[b], n0, n1, n2, place[0], place[1], place[2], -1.0, slope, row, col)


@njit(cache=True, nogil=True, error_model="numpy")
def _greatest(margin, row):
    worst = 0
    for k in range(margin.shape[1]):
        if margin[row, k] > margin[row, worst]:
            worst = k
    return worst


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_margins(table, q, now, wanted, enough, enough_of_points, margin, slope, which) -> None:
    """The least margins below `enough` [m] at postures q (n, nj) where wanted (n), at most m of each, and their slopes.

    enough_of_points [m] is the same for pairs with trees, and no more than `enough`.

    margin (n, m), slope (n, m, nj) by the joints, which (n, m): pairs as in `first_lacking`. What is left over has the
    margin `enough`, no slope, and -1; rows that are not wanted stay as they are.
    """
    room = room_for(table)
    p, looks = len(table.pair), len(table.look)
    spare, old, moved, shifted = room_to_spare(table)
    late = now.max() if len(now) else 0.0
    for i in range(len(q)):
        if not wanted[i]:
            continue
        margin[i] = enough
        slope[i] = 0.0
        which[i] = -1
        put(table, room, q, i)
        let_go(table, room, spare, old, moved, shifted)
        worst, k = FIRST, FIRST
        while k < p:  # from each pair that is near to the next one
            found, k = spared_pairs(table, room, k, p, margin[i, worst], YES, spare, moved)
            if k < 0:
                break
            _pair_slope(table, room, k, slope, i, worst)
            margin[i, worst], which[i, worst] = found, k
            worst = _greatest(margin, i)
            k += 1
        k = FIRST
        while k < looks:
            most = min(margin[i, worst], enough_of_points)
            found, k, point = spared_looks(table, room, k, looks, now[i], late, most, YES, spare, moved, shifted)
            if k < 0:
                break
            _look_slope(table, room, k, point, slope, i, worst)
            margin[i, worst], which[i, worst] = found, p + k
            worst = _greatest(margin, i)
            k += 1
