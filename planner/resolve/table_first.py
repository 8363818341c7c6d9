"""The table before the arm: angles of a positioner's last two axes that hold the layer upright.

Where the surface normal must stay near the vertical, the table has to follow the path, and few of its angles will
do: they are found by dynamic programming on a lattice of their own, and roll and branch are searched afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import njit
from planner.cell.cell import Cell
from planner.resolve.joint_path import SampledTasks
from planner.resolve.prices import TABLE_BEYOND_PRICE, TABLE_LEAN_PRICE, TABLE_MOVE_PRICE, TABLE_RETURN_PRICE
from planner.resolve.reach import LIMIT_ROOM
from planner.toolpath.task import NozzleTask

_SHARE = 0.6  # of the cone that is aimed at: splines cut what is found on the lattice
_STEPS_IN_CONE = 2.0  # lattice steps in that share
_FINEST = np.radians(2.0)
_SPEED_SHARE = 0.7  # of an axis' speed
ARM_SHARES = (1.5, 3.0)  # times as long, there: the arm has to follow as well; tried one after the other
_MOST = 0.9  # of the cone, beyond which TABLE_BEYOND_PRICE counts: paths between the rungs need the rest


def upright_table(cell: Cell, tasks: Sequence[NozzleTask], demand: SampledTasks) -> Array:
    """Angles (r, k) of the cell's chosen joints at the rungs: the holder's last two axes found, the others at home."""
    nh = len(cell.holder)
    a, b = nh - 2, nh - 1
    aim = _SHARE * demand.cones.layer_gravity
    step = max(aim / _STEPS_IN_CONE, _FINEST)
    home = cell.home[list(cell.chosen)]
    out = np.tile(home, (len(demand.rung), 1))
    lattices = [_lattice(cell, axis, step) for axis in (a, b)]
    first, second = (x.ravel() for x in np.meshgrid(*(angles for angles, _ in lattices), indexing="ij"))
    holder = np.tile(home[:nh], (len(first), 1))
    holder[:, a], holder[:, b] = first, second
    up = cell.holder.poses(holder)[:, 2, :3].reshape(len(lattices[0][0]), len(lattices[1][0]), 3)
    normals = -demand.frames[demand.rung][:, :, 2]
    speed = _SPEED_SHARE * cell.limits.velocity[[len(cell.arm) + a, len(cell.arm) + b]]
    near = np.array(
        [np.argmin(np.abs(angles - home[axis])) for (angles, _), axis in zip(lattices, (a, b), strict=True)]
    )
    for i in range(len(tasks)):
        rungs = demand.rungs_of(i)
        picked = _cheapest(
            normals[rungs],
            up,
            demand.time[rungs],
            step,
            speed,
            aim,
            _MOST / _SHARE * aim,
            np.array([turns for _, turns in lattices]),
            near,
        )
        near = picked[-1]
        for axis, (angles, turns), k in zip((a, b), lattices, range(2), strict=True):
            found = angles[picked[:, k]]
            out[rungs, axis] = np.unwrap(found) if turns else found
    return out


def slowed(cell: Cell, demand: SampledTasks, held: Array, share: float) -> SampledTasks:
    """The demand with more time between rungs where the held angles (r, k) need it: the print slows down there.

    share: times the table's own time that its move is given, one of ARM_SHARES; a greater one slows down earlier, too.
    """
    time = demand.time.copy()
    nh = len(cell.holder)
    if nh:
        na = len(cell.arm)
        need = (np.abs(np.diff(held[:, :nh], axis=0)) / (_SPEED_SHARE * cell.limits.velocity[na:])).max(axis=1)
        inside = np.ones(len(time) - 1, dtype=bool)
        inside[demand.task_rungs[1:-1] - 1] = False  # between tasks there is travel
        late = inside & (need > (ARM_SHARES[0] / share) * time[1:])
        time[1:][late] = np.maximum(time[1:], share * need)[late]
    return replace(demand, time=time)


def _lattice(cell: Cell, axis: int, step: float) -> tuple[Array, bool]:
    """Angles of a holder axis in its range, and whether they are the whole circle."""
    joint = len(cell.arm) + axis
    low, high = cell.limits.q_min[joint], cell.limits.q_max[joint]
    if high - low >= 2.0 * np.pi:
        n = int(np.ceil(2.0 * np.pi / step))
        return np.asarray(-np.pi + 2.0 * np.pi / n * np.arange(n)), True
    room = min(LIMIT_ROOM, 0.25 * (high - low))
    low, high = low + room, high - room
    n = max(int(np.ceil((high - low) / step)), 1)
    return np.asarray(low + (high - low) / n * np.arange(n + 1)), False


@njit(cache=True, nogil=True, error_model="numpy")
def _after_moves(
    cost: Array, weight: float, turns: bool, least: Array, came: NDArray[np.int64], room: tuple[NDArray[np.int64], Array, Array]
) -> None:  # fmt: skip
    """Fill least (n) with the least of cost (n) plus weight times the move's square, and came with where that is from.

    The lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012), in time linear in n. Where the axis turns all
    round, half of it is repeated at both ends. Parabolas from u and v, with heights h = cost / (2 weight) + v^2 / 2, cross
    at (h_u - h_v) / (u - v). An infinite cost has no parabola; one at least is finite. `room` is for 2 n values each.
    """
    n = cost.size
    beside = n // 2 if turns else 0
    at, edge, height = room
    inverse = 0.5 / weight
    top = -1
    for i in range(-beside, n + beside):
        own = cost[i + n if i < 0 else (i - n if i >= n else i)] * inverse + 0.5 * i * i
        if own == np.inf:
            continue
        while top >= 0 and own - height[top] <= edge[top] * (i - at[top]):
            top -= 1
        start = (own - height[top]) / (i - at[top]) if top >= 0 else -np.inf
        top += 1
        at[top], edge[top], height[top] = i, start, own
    k = 0
    for i in range(n):
        while k < top and edge[k + 1] < i:
            k += 1
        v = at[k]
        came[i] = v + n if v < 0 else (v - n if v >= n else v)
        least[i] = cost[came[i]] + weight * (i - v) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def _apart(i: int, j: int, n: int, turns: bool) -> int:
    """Steps from one of n places of an axis to another."""
    d = abs(i - j)
    return min(d, n - d) if turns else d


@njit(cache=True, nogil=True, error_model="numpy")
def _price_of_lean(cosine: float, aim: float, most: float) -> float:
    """Seconds a second of a layer that leans beyond what is aimed at."""
    lean = np.arccos(max(cosine, -1.0))
    over = max(0.0, lean / aim - 1.0)
    return TABLE_LEAN_PRICE * over * over + TABLE_BEYOND_PRICE * max(0.0, lean - most)


@njit(cache=True, nogil=True, error_model="numpy")
def _cheapest(
    normals: Array, up: Array, time: Array, step: float, speed: Array, aim: float, most: float, turns: NDArray[np.bool_],
    start: NDArray[np.int64],
) -> NDArray[np.int64]:  # fmt: skip
    """Lattice indices (r, 2) along one task; up (na, nb, 3) the vertical in the part frame, start where travel begins.

    A place that costs more than the best one of its rung and the longest move from there is left out: no cheapest way
    leads through it. What remains are the places about the cone, few of all.
    """
    r, na, nb = len(normals), up.shape[0], up.shape[1]
    weight = np.zeros((r + 1, 2))  # s for a move by a step, squared, to each rung; to the first one there is none
    farthest = np.zeros(r + 1)  # s for the longest move to it
    for k in range(1, r):
        for axis in range(2):
            weight[k, axis] = TABLE_MOVE_PRICE * step * step / (time[k] * speed[axis] ** 2)
            longest = up.shape[axis] // 2 if turns[axis] else up.shape[axis] - 1
            farthest[k] += weight[k, axis] * longest**2
    cost = np.empty((na, nb))
    for i in range(na):
        for j in range(nb):
            cost[i, j] = (
                TABLE_RETURN_PRICE * step * (_apart(i, start[0], na, turns[0]) + _apart(j, start[1], nb, turns[1]))
            )
    back = np.empty((r, na, nb, 2), dtype=np.int16)
    cosine, moved = np.empty((na, nb)), np.empty((na, nb))
    column, came = np.empty(na), np.empty(max(na, nb), dtype=np.int64)
    most_places = 2 * max(na, nb)
    room = (np.empty(most_places, dtype=np.int64), np.empty(most_places), np.empty(most_places))
    upright = np.cos(aim)
    best = 0
    for k in range(r):
        spell = time[k] if k else time[min(1, r - 1)]  # no time leads to the first rung, but it is printed
        nearest = np.inf  # s for the move from the best place to one that is upright
        for i in range(na):
            a = weight[k, 0] * _apart(i, best // nb, na, turns[0]) ** 2
            for j in range(nb):
                cosine[i, j] = normals[k, 0] * up[i, j, 0] + normals[k, 1] * up[i, j, 1] + normals[k, 2] * up[i, j, 2]
                if cosine[i, j] > upright:
                    nearest = min(nearest, a + weight[k, 1] * _apart(j, best % nb, nb, turns[1]) ** 2)
        leaning = np.pi  # a place that leans by more costs too much whatever the way there
        if k:
            leaning = min(most + (nearest + farthest[k + 1]) / (spell * TABLE_BEYOND_PRICE), np.pi)
            moved[:] = np.inf
            for j in range(nb):
                column[:] = cost[:, j]
                if column.min() < np.inf:
                    _after_moves(column, weight[k, 0], turns[0], moved[:, j], came, room)
                    back[k, :, j, 0] = came[:na]
        least_cosine = np.cos(leaning) if leaning < np.pi else -np.inf
        least = np.inf
        for i in range(na):
            if k:
                if cosine[i].max() < least_cosine:
                    cost[i] = np.inf
                    continue
                _after_moves(moved[i], weight[k, 1], turns[1], cost[i], came, room)
                back[k, i, :, 1] = came[:nb]
            for j in range(nb):
                if cosine[i, j] < least_cosine:
                    cost[i, j] = np.inf
                elif cosine[i, j] <= upright:  # as upright as is aimed at: free, and `most` is beyond
                    cost[i, j] += spell * _price_of_lean(cosine[i, j], aim, most)
                if cost[i, j] < least:
                    least, best = cost[i, j], i * nb + j
        for i in range(na):
            for j in range(nb):
                if cost[i, j] > least + farthest[k + 1]:
                    cost[i, j] = np.inf
    picked = np.empty((r, 2), dtype=np.int64)
    picked[r - 1] = (best // nb, best % nb)
    for k in range(r - 1, 0, -1):
        j = back[k, picked[k, 0], picked[k, 1], 1]
        picked[k - 1] = (back[k, picked[k, 0], j, 0], j)
    return picked
