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
_HURRY = 4.0  # times that speed which an axis may need: the print slows down there
_ARM_SHARE = 1.5  # times as long, there: the arm has to follow as well
LEAN = 50.0  # seconds a second, at twice the lean that is aimed at
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
            normals[rungs], up, demand.time[rungs], step, speed, aim, np.array([turns for _, turns in lattices]), near
        )
        near = picked[-1]
        for axis, (angles, turns), k in zip((a, b), lattices, range(2), strict=True):
            found = angles[picked[:, k]]
            out[rungs, axis] = np.unwrap(found) if turns else found
    return out


def slowed(cell: Cell, demand: Demand, held: Array) -> Demand:
    """The demand with more time between rungs where the held angles (r, k) need it: the print slows down there."""
    time = demand.time.copy()
    nh = len(cell.holder)
    if nh:
        na = len(cell.arm)
        need = (np.abs(np.diff(held[:, :nh], axis=0)) / (_SPEED_SHARE * cell.limits.velocity[na:])).max(axis=1)
        inside = np.ones(len(time) - 1, dtype=bool)
        inside[demand.task_rungs[1:-1] - 1] = False  # between tasks there is travel
        late = inside & (need > time[1:])
        time[1:][late] = _ARM_SHARE * need[late]
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


@njit(cache=True)
def _cheapest(
    normals: Array, up: Array, time: Array, step: float, speed: Array, aim: float, turns: NDArray[np.bool_],
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
    moved = np.empty((na, nb))
    for k in range(r):
        if k:
            # moves of the two axes cost independently of each other: one axis after the other is the least of both
            pace_i, pace_j = step / (time[k] * speed[0]), step / (time[k] * speed[1])
            reach_i, reach_j = max(int(_HURRY / pace_i), 1), max(int(_HURRY / pace_j), 1)
            for i in range(na):
                for j in range(nb):
                    least = np.inf
                    for di in range(-reach_i, reach_i + 1):
                        i0 = (i + di) % na if turns[0] else i + di
                        if 0 <= i0 < na and cost[i0, j] + MOVE * time[k] * (di * pace_i) ** 2 < least:
                            least = cost[i0, j] + MOVE * time[k] * (di * pace_i) ** 2
                            back[k, i, j, 0] = i0
                    moved[i, j] = least
            for i in range(na):
                for j in range(nb):
                    least = np.inf
                    for dj in range(-reach_j, reach_j + 1):
                        j0 = (j + dj) % nb if turns[1] else j + dj
                        if 0 <= j0 < nb and moved[i, j0] + MOVE * time[k] * (dj * pace_j) ** 2 < least:
                            least = moved[i, j0] + MOVE * time[k] * (dj * pace_j) ** 2
                            back[k, i, j, 1] = j0
                    cost[i, j] = least
        for i in range(na):
            for j in range(nb):
                cosine = 0.0
                for c in range(3):
                    cosine += normals[k, c] * up[i, j, c]
                lean = np.arccos(min(max(cosine, -1.0), 1.0))
                over = max(0.0, lean / aim - 1.0)
                cost[i, j] += time[k] * LEAN * over * over
    picked = np.empty((r, 2), dtype=np.int64)
    flat = cost.argmin()
    picked[r - 1] = (flat // nb, flat % nb)
    for k in range(r - 1, 0, -1):
        j = back[k, picked[k, 0], picked[k, 1], 1]
        picked[k - 1] = (back[k, picked[k, 0], j, 0], j)
    return picked
