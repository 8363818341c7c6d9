"""The table before the arm: angles of a positioner's last two axes that hold the layer upright.

Where the surface normal must stay near the vertical, the table has to follow the path, and few of its angles will
do: they are found by dynamic programming on a lattice of their own, and roll and branch are searched afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.cell import Cell
from planner.resolve.demand import Demand
from planner.resolve.node_kernel import LIMIT_ROOM
from planner.task import NozzleTask

Array = NDArray[np.float64]

_SHARE = 0.6  # of the cone that is aimed at: splines cut what is found on the lattice
_STEPS_IN_CONE = 2.0  # lattice steps in that share
_FINEST = np.radians(2.0)
_SPEED_SHARE = 0.7  # of an axis' speed
ARM_SHARES = (1.5, 3.0)  # times as long, there: the arm has to follow as well; tried one after the other
LEAN = 50.0  # seconds a second, at twice the lean that is aimed at
BEYOND = 1e4  # seconds a second and rad, beyond most of the cone: no way past that costs less
_MOST = 0.9  # of the cone, there: paths between the rungs need the rest
MOVE = 1.0  # seconds a second, for an axis at its full speed
RETURN = 0.02  # s per rad between the end of a bead and the start of the next


def upright_table(cell: Cell, tasks: Sequence[NozzleTask], demand: Demand) -> Array:
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


def slowed(cell: Cell, demand: Demand, held: Array, share: float) -> Demand:
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


@njit(cache=True, error_model="numpy")
def _after_moves(
    cost: Array, weight: float, turns: bool, least: Array, came: NDArray[np.int64], room: tuple[NDArray[np.int64], Array, Array]
) -> None:  # fmt: skip
    """Fill least (n) with the least of cost (n) plus weight times the move's square, and came with where that is from.

    The lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012), in time linear in n. Where the axis turns all
    round, half of it is repeated at both ends. Parabolas from u and v, with heights h = cost / (2 weight) + v^2 / 2, cross
    at (h_u - h_v) / (u - v). `room` is for 2 n values each.
    """
    n = cost.size
    beside = n // 2 if turns else 0
    at, edge, height = room
    inverse = 0.5 / weight
    for i in range(n):
        height[beside + i] = cost[i] * inverse + 0.5 * i * i
    for i in range(-beside, 0):
        height[beside + i] = cost[i + n] * inverse + 0.5 * i * i
    for i in range(n, n + beside):
        height[beside + i] = cost[i - n] * inverse + 0.5 * i * i
    top = 0
    at[0], edge[0] = -beside, -np.inf
    for i in range(1 - beside, n + beside):
        own = height[beside + i]
        while top >= 0 and own - height[beside + at[top]] <= edge[top] * (i - at[top]):
            top -= 1
        start = (own - height[beside + at[top]]) / (i - at[top]) if top >= 0 else -np.inf
        top += 1
        at[top], edge[top] = i, start
    k = 0
    for i in range(n):
        while k < top and edge[k + 1] < i:
            k += 1
        v = at[k]
        came[i] = v + n if v < 0 else (v - n if v >= n else v)
        least[i] = cost[came[i]] + weight * (i - v) ** 2


@njit(cache=True)
def _cheapest(
    normals: Array, up: Array, time: Array, step: float, speed: Array, aim: float, most: float, turns: NDArray[np.bool_],
    start: NDArray[np.int64],
) -> NDArray[np.int64]:  # fmt: skip
    """Lattice indices (r, 2) along one task; up (na, nb, 3) the vertical in the part frame, start where travel begins."""
    r, na, nb = len(normals), up.shape[0], up.shape[1]
    cost = np.empty((na, nb))
    for i in range(na):
        for j in range(nb):
            di, dj = abs(i - start[0]), abs(j - start[1])
            di = min(di, na - di) if turns[0] else di
            dj = min(dj, nb - dj) if turns[1] else dj
            cost[i, j] = RETURN * step * (di + dj)
    back = np.empty((r, na, nb, 2), dtype=np.int16)
    moved, came = np.empty((na, nb)), np.empty(max(na, nb), dtype=np.int64)
    most_places = 2 * max(na, nb)
    room = (np.empty(most_places, dtype=np.int64), np.empty(most_places), np.empty(most_places))
    upright = np.cos(aim)
    for k in range(r):
        if k:
            # moves of the two axes cost independently of each other: one axis after the other is the least of both
            for j in range(nb):
                _after_moves(
                    cost[:, j], MOVE * step * step / (time[k] * speed[0] ** 2), turns[0], moved[:, j], came, room
                )
                for i in range(na):
                    back[k, i, j, 0] = came[i]
            for i in range(na):
                _after_moves(moved[i], MOVE * step * step / (time[k] * speed[1] ** 2), turns[1], cost[i], came, room)
                for j in range(nb):
                    back[k, i, j, 1] = came[j]
        spell = time[k] if k else time[min(1, r - 1)]  # no time leads to the first rung, but it is printed
        for i in range(na):
            for j in range(nb):
                cosine = 0.0
                for c in range(3):
                    cosine += normals[k, c] * up[i, j, c]
                if cosine > upright:  # as upright as is aimed at: free, and `most` is beyond
                    continue
                lean = np.arccos(max(cosine, -1.0))
                over = max(0.0, lean / aim - 1.0)
                cost[i, j] += spell * (LEAN * over * over + BEYOND * max(0.0, lean - most))
    picked = np.empty((r, 2), dtype=np.int64)
    flat = cost.argmin()
    picked[r - 1] = (flat // nb, flat % nb)
    for k in range(r - 1, 0, -1):
        j = back[k, picked[k, 0], picked[k, 1], 1]
        picked[k - 1] = (back[k, picked[k, 0], j, 0], j)
    return picked
