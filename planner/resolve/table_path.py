"""The table before the arm: angles of a positioner's last two axes where cones about the vertical bind them.

Where the surface normal must stay near the vertical, few table angles are admissible at a place of the path: sparse
cells of a lattice. A single dynamic programme chooses among them together with the nozzle's heading in the world and
the arm's branch, so that the table goes where the arm can follow. Roll and branch are then searched again along the
table's path, with the actual postures. Here a map of postures with the nozzle straight down represents the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Flags, Ints
from planner.base.compiled import inner_njit, njit
from planner.base.geometry import TURN
from planner.base.processes import in_threads
from planner.cell.cell import Cell
from planner.cell.kinematics.chain import chain_state, largest_singular_value, mul4
from planner.cell.kinematics.inverse import SPHERICAL_WRIST, branches_of, solve_one
from planner.cell.kinematics.spherical_wrist import inverse_jacobian, sines_of
from planner.resolve.joint_path import MARGIN, SampledTasks, at_rest, gone_along, leaned, least_cone, spread
from planner.resolve.prices import (
    BRANCH_PRICE,
    DIP_PRICE,
    HOME_PRICE,
    LIMIT_COMFORT,
    LIMIT_PRICE,
    NO_POSTURE_PRICE,
    SIGMA_COMFORT,
    SIGMA_PRICE,
    TABLE_BEYOND_PRICE,
    TABLE_LEAN_PRICE,
    TABLE_MOVE_PRICE,
    TRAVEL_PRICE,
)
from planner.resolve.reach import (
    arm_limits,
    arm_numbers,
    inverse_in_part,
    nearest_turns,
    room_for_poses,
)
from planner.toolpath.task import NozzleTask

BINDING = np.radians(45.0)  # cone of the surface normal to the vertical below which it binds the table
_STEPS_IN_CONE = 3.3  # lattice steps in that cone
_FINEST, _COARSEST = np.radians(2.0), np.radians(6.0)
_HEADINGS = 30
_VOXEL = 15e-3  # m: tip positions in a cube of this size share their postures
_CONE_ROOM = 0.95  # share of the cone that cells may use: the spline through them needs the rest
_CALM_LEAN = 0.7  # share of the cone beyond which a lean has a price
_SPEED_SHARE = 0.7  # share of an axis's speed that counts as full speed: splines and accelerations need the rest
_CALM_NEED = 0.7  # share of a joint's speed that the tip's speed may take up without a price
_MOST_TURNS = 8  # turns: an axis whose range is shorter may be searched over all of it
_FARTHEST = np.radians([60.0, 90.0, 72.0])  # largest turns of tilt, rotation and heading from rung to rung
_MOST_VALUES = 5e7  # values of the programme kept in memory (4 bytes each); longer paths are searched in blocks, twice


class Lattice(NamedTuple):
    """Angles a (na) and b (nb) [rad] of the two axes, and the part there: the vertical in its frame, up (na, nb, 3),
    and its pose in the world (na, nb, 4, 4); turns (3): which of tilt, rotation and heading go all the way round."""

    a: Array
    b: Array
    up: Array
    T_world_part: Array
    turns: Flags


class Cells(NamedTuple):
    """The cells of r rungs: those of rung k are first[k] .. first[k + 1].

    a, b (m) lattice indices; lean (m) price of the layer's lean [s/s]; voxel (m) of the tip's position
    time (r) [s] from the previous rung; begins (r) whether a bead begins there, after travel
    """

    first: Ints
    a: NDArray[np.int32]
    b: NDArray[np.int32]
    lean: NDArray[np.float32]
    voxel: Ints
    time: Array
    begins: Flags


class Steps(NamedTuple):
    """Lattice steps (3) [rad], full speeds (3) [rad/s] and longest moves (3) [steps] of tilt, rotation and heading.

    anywhere: whether tilt and rotation may also pass angles that are admissible neither before nor after
    """

    step: Array
    speed: Array
    longest: Ints
    anywhere: bool = False


def table_path(cell: Cell, tasks: Sequence[NozzleTask], demand: SampledTasks) -> Array:
    """Angles (r, k) of the cell's chosen joints at the rungs: the holder's last two axes as found, the others at home.

    Where no angles keep within the cones, those that exceed them least are used.
    """
    out, wound = _table_path(cell, tasks, demand, frozenset())
    return _table_path(cell, tasks, demand, wound)[0] if wound else out


def _table_path(
    cell: Cell, tasks: Sequence[NozzleTask], demand: SampledTasks, whole: frozenset[int]
) -> tuple[Array, frozenset[int]]:
    """As `table_path`, and the axes (holder joints) that it winds too far.

    Along some bead these leave their range whatever whole turns are added. Searching the whole range of an axis
    (`whole`) instead of a circle prevents that.
    """
    nh = len(cell.holder)
    axes = (nh - 2, nh - 1)
    home = at_rest(cell)
    cone = _CONE_ROOM * least_cone(demand.cones)
    step = float(np.clip(cone / _STEPS_IN_CONE, _FINEST, _COARSEST))
    lattice = _lattice(cell, axes, step, home, whole)
    cells, middles = _cells(lattice, demand, cone)
    price = _posture_prices(cell, middles, max(task.speed for task in tasks))
    na = len(cell.arm)
    v = cell.limits.velocity
    size = (len(lattice.a), len(lattice.b), _HEADINGS)
    steps = np.array([_spacing(lattice.a), _spacing(lattice.b), 2.0 * np.pi / _HEADINGS])
    speed = _SPEED_SHARE * np.array([v[na + axes[0]], v[na + axes[1]], v[na - 1]])
    longest = np.minimum(np.ceil(_FARTHEST / steps).astype(np.int64), [(n - 1) // 2 for n in size])
    near = np.array([np.argmin(np.abs(lattice.a - home[axes[0]])), np.argmin(np.abs(lattice.b - home[axes[1]]))])
    picked = _cheapest(cells, price, lattice.turns, Steps(steps, speed, np.maximum(longest, 1)), size, near)
    out, wound = np.tile(home, (len(demand.rung), 1)), set[int]()
    for axis, angles, turns, index in zip(axes, lattice[:2], lattice.turns, picked.T, strict=False):
        low, high = cell.limits.q_min[na + axis] + MARGIN, cell.limits.q_max[na + axis] - MARGIN
        for i in range(len(tasks)):
            rungs = demand.rungs_of(i)
            found = angles[index[rungs]]
            out[rungs, axis] = np.unwrap(found) if turns else found
            ends = out[rungs, axis].min(), out[rungs, axis].max()
            if turns and ends[1] + TURN * np.ceil((low - ends[0]) / TURN) > high and high - low < _MOST_TURNS * TURN:
                wound.add(axis)
    return out, frozenset(wound)


def carried(cell: Cell, tasks: Sequence[NozzleTask], demand: SampledTasks, held: Array) -> SampledTasks:
    """The demand while the chosen joints move through angles (r, k) at the rungs.

    Its frames have a fixed heading in the world, whatever the table does, and lean as the cones require; its twists are
    those of the nozzle in the world, expressed in the part frame at the rung.
    """
    nh = len(cell.holder)
    offset = 0
    frames, twists, rates = (np.empty_like(each) for each in (demand.frames, demand.twist, demand.rate))
    for i, task in enumerate(tasks):
        rungs, here = demand.rungs_of(i), slice(offset, offset + len(task))
        offset += len(task)
        T = cell.holder.poses(spread(held[rungs], len(task), demand.place[rungs])[:, :nh])
        R_world_part = T[:, :3, :3]
        down = leaned(_headed(R_world_part @ task.frames[:, :, 2:]), demand.lean)
        frames[here] = np.swapaxes(R_world_part, 1, 2) @ down
        tip = np.einsum("nij,nj->ni", R_world_part, task.tip) + T[:, :3, 3]
        t = task.s / task.speed
        spin = 0.5 * np.cross(down, np.gradient(down, t, axis=0), axisa=1, axisb=1).sum(axis=1)
        twist = np.concatenate([np.gradient(tip, t, axis=0), spin], axis=1)
        rate = np.gradient(twist, t, axis=0)
        owner = np.repeat(np.arange(rungs.stop - rungs.start), (demand.stop - demand.start)[rungs])
        R = cell.holder.poses(held[rungs][:, :nh])[:, :3, :3][owner]
        for out, values in ((twists, twist), (rates, rate)):
            out[here, :3] = np.einsum("nji,nj->ni", R, values[:, :3])
            out[here, 3:] = np.einsum("nji,nj->ni", R, values[:, 3:])
    return replace(demand, frames=frames, twist=twists, rate=rates, lean=1.0)


def _headed(z: Array) -> Array:
    """Orientations (n, 3, 3) with nozzle axes z (n, 3, 1): straight down, x ahead, turned by the least angle."""
    z = z[:, :, 0]
    lean = np.arctan2(np.hypot(z[:, 0], z[:, 1]), -z[:, 2])
    level = np.maximum(np.hypot(z[:, 0], z[:, 1]), 1e-12)
    e, c, s = z[:, :2] / level[:, None], np.cos(lean), np.sin(lean)
    # straight down has x ahead, y to the right: the component along the lean's direction e is lifted, the rest stays
    out = np.empty((len(z), 3, 3))
    for column, (x, y) in enumerate(((1.0, 0.0), (0.0, -1.0))):
        along = e[:, 0] * x + e[:, 1] * y
        out[:, 0, column] = x + (c - 1.0) * along * e[:, 0]
        out[:, 1, column] = y + (c - 1.0) * along * e[:, 1]
        out[:, 2, column] = s * along
    out[:, :, 2] = z
    return out


def _lattice(cell: Cell, axes: tuple[int, int], step: float, home: Array, whole: frozenset[int]) -> Lattice:
    """The lattice of two holder axes, the others at home (k); whole: axes whose entire range is covered."""
    angles, turns = zip(*(_angles(cell, axis, step, axis in whole) for axis in axes), strict=True)
    a, b = np.meshgrid(*angles, indexing="ij")
    holder = np.tile(home[: len(cell.holder)], (a.size, 1))
    holder[:, axes[0]], holder[:, axes[1]] = a.ravel(), b.ravel()
    T = cell.holder.poses(holder).reshape(*a.shape, 4, 4)
    return Lattice(angles[0], angles[1], np.ascontiguousarray(T[:, :, 2, :3]), T, np.array([*turns, True]))


def _angles(cell: Cell, axis: int, step: float, whole: bool = False) -> tuple[Array, bool]:
    """Angles of a holder axis in its range, and whether they form a circle: if it can turn all the way round, unless
    its `whole` range is wanted."""
    joint = len(cell.arm) + axis
    low, high = cell.limits.q_min[joint], cell.limits.q_max[joint]
    if high - low >= 2.0 * np.pi and not whole:
        n = int(np.ceil(2.0 * np.pi / step))
        return np.asarray(-np.pi + 2.0 * np.pi / n * np.arange(n)), True
    room = min(cell.limits.room, 0.25 * (high - low))
    low, high = low + room, high - room
    n = max(int(np.ceil((high - low) / step)), 1)
    return np.asarray(low + (high - low) / n * np.arange(n + 1)), False


def _spacing(angles: Array) -> float:
    return float(angles[1] - angles[0]) if len(angles) > 1 else 1.0


def _cells(lattice: Lattice, demand: SampledTasks, cone: float) -> tuple[Cells, Array]:
    """The cells of all rungs, and the centres (v, 3) [m] of the voxels that contain their tip positions."""
    axes = np.ascontiguousarray(-demand.frames[demand.rung, :, 2])
    first, a, b, lean, tips = _find_cells(lattice.up, lattice.T_world_part, axes, demand.tip[demand.rung], cone)
    box = np.floor(tips / _VOXEL).astype(np.int64)
    box -= box.min(axis=0)
    shape = box.max(axis=0) + 1
    _, where, voxel = np.unique(
        np.ravel_multi_index(tuple(box.T), tuple(shape)), return_index=True, return_inverse=True
    )
    middles = (np.floor(tips[where] / _VOXEL) + 0.5) * _VOXEL
    begins = np.zeros(len(demand.rung), dtype=np.bool_)
    begins[demand.task_rungs[:-1]] = True
    return Cells(first, a, b, lean, voxel.ravel(), demand.time, begins), middles


@njit
def _find_cells(up, T_world_part, normals, tips, cone):
    """Cells of rungs with normals, tips (r, 3): the lattice points whose up (na, nb, 3) is within the cone [rad], or
    nearly as close to it as possible.

    Returns first (r + 1), lattice indices a, b (m), price of the lean (m) [s/s], tip in the world (m, 3) [m].
    """
    na, nb = up.shape[0], up.shape[1]
    r = len(normals)
    first = np.zeros(r + 1, dtype=np.int64)
    least = np.empty(r)
    for k in range(r):
        most = -1.0
        for i in range(na):
            for j in range(nb):
                c = normals[k, 0] * up[i, j, 0] + normals[k, 1] * up[i, j, 1] + normals[k, 2] * up[i, j, 2]
                most = max(most, c)
        # the cone, or a tenth more than the least possible lean if that is larger
        least[k] = min(np.cos(cone), np.cos(min(1.1 * np.arccos(min(most, 1.0)) + 1e-6, np.pi)))
        count = 0
        for i in range(na):
            for j in range(nb):
                c = normals[k, 0] * up[i, j, 0] + normals[k, 1] * up[i, j, 1] + normals[k, 2] * up[i, j, 2]
                if c >= least[k]:
                    count += 1
        first[k + 1] = first[k] + count
    m = first[r]
    a, b, lean = np.empty(m, dtype=np.int32), np.empty(m, dtype=np.int32), np.empty(m, dtype=np.float32)
    at = np.empty((m, 3))
    x = 0
    for k in range(r):
        for i in range(na):
            for j in range(nb):
                c = normals[k, 0] * up[i, j, 0] + normals[k, 1] * up[i, j, 1] + normals[k, 2] * up[i, j, 2]
                if c >= least[k]:
                    share = np.arccos(min(c, 1.0)) / cone
                    over, beyond = max(0.0, share - _CALM_LEAN), max(0.0, share - 1.0)
                    a[x], b[x], lean[x] = i, j, TABLE_LEAN_PRICE * over * over + TABLE_BEYOND_PRICE * cone * beyond
                    for d in range(3):
                        at[x, d] = T_world_part[i, j, d, 3]
                        for e in range(3):
                            at[x, d] += T_world_part[i, j, d, e] * tips[k, e]
                    x += 1
    return first, a, b, lean, at


# The arm's postures with the nozzle straight down, over tip positions, headings and branches.


def _posture_prices(cell: Cell, middles: Array, speed: float) -> NDArray[np.float32]:
    """Prices (v, headings, branches) [s/s] of the arm's postures with the nozzle straight down at positions (v, 3).

    What counts is closeness to singularities and ends of ranges, and the joint speeds needed to move the tip at a speed
    [m/s]. Rails go along with the nozzle, see `gone_along`.
    """
    price = np.full((len(middles), _HEADINGS, cell.inverse.branch_count), NO_POSTURE_PRICE, dtype=np.float32)
    redundant = gone_along(cell, middles) if cell.given else np.zeros((len(middles), 1))
    arm, limits = arm_numbers(cell), arm_limits(cell)

    def part(first: int, last: int) -> None:
        _price_postures(arm, limits, middles[first:last], redundant[first:last], speed, price[first:last])

    in_threads(part, len(middles))
    return price


@njit
def _price_postures(arm, limits, middles, redundant, speed, price) -> None:
    """Fill price (v, headings, branches) for postures that exist; see `_posture_prices`."""
    kind, solver, p, solved = arm.kind, arm.solver, arm.parameters, arm.solved
    q_min, q_max, v_max = limits.q_min, limits.q_max, limits.v_max
    na, headings = q_min.size, price.shape[1]
    middle = 0.5 * (q_min + q_max)
    slots = branches_of(kind)
    room = room_for_poses(na, 0, slots)
    T_world_nozzle, T_base_nozzle, T_base_flange, branch_q, ok = (
        room.T_world_task, room.T_base_nozzle, room.T_base_flange, room.postures, room.ok
    )  # fmt: skip
    T_still = np.eye(4)
    Ji, J6, Jp, J = room.Ji, room.J6, room.Jp, room.J
    T_world_nozzle[:] = 0.0
    T_world_nozzle[3, 3] = 1.0
    for v in range(len(middles)):
        for d in range(3):
            T_world_nozzle[d, 3] = middles[v, d]
        for h in range(headings):
            c, s = np.cos(2.0 * np.pi * h / headings), np.sin(2.0 * np.pi * h / headings)
            T_world_nozzle[0, 0], T_world_nozzle[1, 0] = c, -s
            T_world_nozzle[0, 1], T_world_nozzle[1, 1] = -s, -c
            T_world_nozzle[2, 2] = -1.0
            mul4(arm.T_base_world, T_world_nozzle, T_base_nozzle)
            mul4(T_base_nozzle, arm.T_nozzle_flange, T_base_flange)
            solve_one(kind, solver, p, redundant[v], T_base_flange, branch_q, ok)
            for k in range(slots):
                if not ok[k]:
                    continue
                away = nearest_turns(branch_q[k], middle, q_min, q_max, limits.turns)
                if away < limits.room:
                    continue
                if kind == SPHERICAL_WRIST:
                    regular = inverse_jacobian(p, sines_of(branch_q[k]), T_base_nozzle[:3, 3], Ji)
                else:
                    chain_state(
                        arm.placements,
                        arm.axes,
                        arm.T_last_tip,
                        branch_q[k],
                        room.origins,
                        room.directions,
                        room.T_rolled,
                    )
                    regular = inverse_in_part(room.origins, room.directions, solved, T_still, T_world_nozzle, J, Jp, Ji)
                if not regular:
                    continue
                sigma = 1.0 / largest_singular_value(Ji, J6, Jp)
                need = 0.0
                for j in range(6):
                    rate = np.sqrt(Ji[j, 0] ** 2 + Ji[j, 1] ** 2 + Ji[j, 2] ** 2)
                    need = max(need, speed * rate / v_max[solved[j]])
                close = max(0.0, SIGMA_COMFORT / sigma - 1.0)
                near = max(0.0, 1.0 - away / LIMIT_COMFORT)
                cost = SIGMA_PRICE * close * close + LIMIT_PRICE * near * near + max(0.0, need - _CALM_NEED)
                price[v, h, k] = min(cost, NO_POSTURE_PRICE)


# Dynamic programming over cells, headings and branches.
#
# The price of a move is the sum of those of tilt, rotation and heading, so the cheapest one is found axis by axis: from
# cells to places with their rotation and the new tilt, from there to the new cells, then over headings. Only values are
# kept; tracing back finds out where each came from. No axis passes angles that are admissible neither before nor after:
# the nozzle would leave its cone on the way.


def _cheapest(
    cells: Cells, price: NDArray[np.float32], turns: Flags, steps: Steps, size: tuple[int, int, int], near: Ints
) -> Ints:
    """Lattice indices (r, 2) of the cheapest way, which starts from `near` (2).

    If no way passes cells only, the cheapest past any angles: the postures along it will show what it is worth.
    """
    r = len(cells.time)
    width = price.shape[1] * price.shape[2]
    block = r if cells.first[-1] * width <= _MOST_VALUES else max(int(np.ceil(np.sqrt(r))), 2)
    edges = [*range(0, r - 1, block), r - 1] if r > 1 else [0, 0]
    start = _begin(cells, price, steps, turns, near)
    begun = [start]
    kept: NDArray[np.float32] | None = None
    for k0, k1 in zip(edges[:-1], edges[1:], strict=True):
        kept = _sweep(cells, price, turns, steps, size, k0, k1, begun[-1])
        begun.append(kept[(cells.first[k1] - cells.first[k0]) :].copy())
    if not (steps.anywhere or np.isfinite(begun[-1]).any()):
        return _cheapest(cells, price, turns, steps._replace(anywhere=True), size, near)
    picked = np.empty((r, 2), dtype=np.int64)
    at = int(np.argmin(begun[-1]))
    for number in range(len(edges) - 2, -1, -1):
        k0, k1 = edges[number], edges[number + 1]
        if kept is None or number < len(edges) - 2:
            kept = _sweep(cells, price, turns, steps, size, k0, k1, begun[number])
        at = _trace(cells, price, turns, steps, size, k0, k1, kept, at, picked)
    return picked


@njit
def _begin(cells, price, steps, turns, near):
    """Values (m, headings * branches) of the first rung's cells."""
    m = cells.first[1]
    headings, branches = price.shape[1], price.shape[2]
    out = np.empty((m, headings * branches), dtype=np.float32)
    spell = cells.time[min(1, len(cells.time) - 1)]
    for x in range(m):
        far = abs(cells.a[x] - near[0]) * steps.step[0] / steps.speed[0]
        far += abs(cells.b[x] - near[1]) * steps.step[1] / steps.speed[1]
        for h in range(headings):
            for k in range(branches):
                own = spell * (cells.lean[x] + price[cells.voxel[x], h, k])
                out[x, h * branches + k] = HOME_PRICE * far + own
    return out


@inner_njit
def _move_prices(axis, begins, time, steps, size, turns, out) -> int:
    """Fill out (2 w + 1) with prices [s] of moves by -w .. w steps of an axis, and return w.

    Within a bead, a mild square, and the time lost where the axis is too slow; between beads, the price of travel.
    """
    step, speed = steps.step[axis], steps.speed[axis]
    w = steps.longest[axis]
    if begins:
        w = size[axis] // 2 if turns[axis] else size[axis] - 1
    for d in range(-w, w + 1):
        need = abs(d) * step / speed
        if begins:
            out[d + w] = TRAVEL_PRICE * need
        else:
            share = min(need / time, 1.0)
            out[d + w] = TABLE_MOVE_PRICE * time * share * share + (1.0 + DIP_PRICE) * max(0.0, need - time)
    return w


@njit
def _sweep(cells, price, turns, steps, size, k0, k1, begun):
    """Values (m, headings * branches) of the cells of rungs k0 .. k1, one after the other, from those of rung k0."""
    na, nb, headings = size
    branches = price.shape[2]
    width = headings * branches
    base = cells.first[k0]
    out = np.empty((cells.first[k1 + 1] - base, width), dtype=np.float32)
    for x in range(len(begun)):
        for m in range(width):
            out[x, m] = begun[x, m]
    far = np.empty((3, 2 * max(na, nb, headings) + 1), dtype=np.float32)
    slot = np.full((na, nb), -1, dtype=np.int64)  # of a place with the old rotation and the new tilt
    open_to = np.full((na, nb), False)
    wanted = np.zeros(na, dtype=np.bool_)
    places = np.empty(0, dtype=np.int64)
    moved = np.empty((0, width), dtype=np.float32)
    row = np.empty(width, dtype=np.float32)
    for k in range(k0 + 1, k1 + 1):
        old, new, end = cells.first[k - 1], cells.first[k], cells.first[k + 1]
        w = np.empty(3, dtype=np.int64)
        for axis in range(3):
            w[axis] = _move_prices(axis, cells.begins[k], cells.time[k], steps, size, turns, far[axis])
        free = cells.begins[k] or steps.anywhere
        _mark(cells, old, end, True, open_to)
        # over tilt
        wanted[:] = False
        for x in range(new, end):
            wanted[cells.a[x]] = True
        count = 0
        for x in range(old, new):
            for sign in (-1, 1):
                for d in range(w[0] + 1):
                    i = _stepped(cells.a[x], sign * d, na, turns[0])
                    if i < 0:
                        break
                    if wanted[i] and slot[i, cells.b[x]] < 0:
                        slot[i, cells.b[x]] = count
                        count += 1
                        if count > len(places):
                            places = np.concatenate((places, np.empty(len(places) + 64, dtype=np.int64)))
                        places[count - 1] = i * nb + cells.b[x]
                    if not (open_to[i, cells.b[x]] or free):
                        break
        if count > len(moved):
            moved = np.empty((2 * count, width), dtype=np.float32)
        moved[:count] = np.inf
        for x in range(old, new):
            for sign in (-1, 1):
                for d in range(w[0] + 1):
                    i = _stepped(cells.a[x], sign * d, na, turns[0])
                    if i < 0:
                        break
                    if wanted[i]:
                        _least(moved[slot[i, cells.b[x]]], out[x - base], far[0, sign * d + w[0]])
                    if not (open_to[i, cells.b[x]] or free):
                        break
        # over rotation
        for x in range(new, end):
            own = out[x - base]
            own[:] = np.inf
            for sign in (-1, 1):
                for d in range(w[1] + 1):
                    j = _stepped(cells.b[x], -sign * d, nb, turns[1])
                    if j < 0:
                        break
                    if slot[cells.a[x], j] >= 0:
                        _least(own, moved[slot[cells.a[x], j]], far[1, sign * d + w[1]])
                    if not (open_to[cells.a[x], j] or free):
                        break
            # over heading
            for m in range(width):
                row[m] = own[m]
            if cells.begins[k]:
                _change_branch(row, branches)
                for m in range(width):
                    own[m] = row[m]
            for d in range(-w[2], w[2] + 1):
                if d:
                    for h in range(headings):
                        g = (h + d) % headings
                        _least(
                            own[h * branches : (h + 1) * branches],
                            row[g * branches : (g + 1) * branches],
                            far[2, d + w[2]],
                        )
            time = cells.time[k] if not cells.begins[k] else cells.time[min(k + 1, len(cells.time) - 1)]
            for h in range(headings):
                for c in range(branches):
                    own[h * branches + c] += time * (cells.lean[x] + price[cells.voxel[x], h, c])
        for n in range(count):
            slot[places[n] // nb, places[n] % nb] = -1
        _mark(cells, old, end, False, open_to)
    return out


@inner_njit
def _mark(cells, first, last, mark, open_to) -> None:
    """Mark the lattice points (na, nb) of some cells."""
    for x in range(first, last):
        open_to[cells.a[x], cells.b[x]] = mark


@inner_njit
def _stepped(index: int, d: int, n: int, turns: bool) -> int:
    """Index (of n) that is d steps further on, around the circle if it turns; -1 beyond the ends."""
    if turns:
        return (index + d) % n
    return index + d if 0 <= index + d < n else -1


@inner_njit
def _leads(open_to, a0, b0, d0, d1, turns) -> bool:
    """Whether tilt can move from (a0, b0) by d0 steps and then rotation by d1, past marked lattice points only."""
    na, nb = open_to.shape
    a1, past = _stepped(a0, d0, na, turns[0]), True
    for d in range(1, abs(d0)):
        past &= open_to[_stepped(a0, d if d0 > 0 else -d, na, turns[0]), b0]
    for d in range(1, abs(d1)):
        past &= open_to[a1, _stepped(b0, d if d1 > 0 else -d, nb, turns[1])]
    return past


@inner_njit
def _least(to, values, more) -> None:
    """Replace `to` by values + more where that is less."""
    for m in range(to.size):
        to[m] = min(to[m], values[m] + more)


@inner_njit
def _change_branch(row, branches) -> None:
    """Let travel change the branch."""
    for g in range(0, row.size, branches):
        least = np.inf
        for c in range(branches):
            least = min(least, row[g + c])
        for c in range(branches):
            row[g + c] = min(row[g + c], least + BRANCH_PRICE)


@njit
def _trace(cells, price, turns, steps, size, k0, k1, values, at, picked):
    """Fill picked (r, 2) back from rung k1 to k0, from the value `at` (cell and column) of k1; returns that of k0."""
    headings, branches = size[2], price.shape[2]
    width = headings * branches
    base = cells.first[k0]
    far = np.empty((3, 2 * max(size[0], size[1], headings) + 1), dtype=np.float32)
    open_to = np.full((size[0], size[1]), False)
    for k in range(k1, k0, -1):
        old, new = cells.first[k - 1], cells.first[k]
        free = cells.begins[k] or steps.anywhere
        _mark(cells, old, cells.first[k + 1], True, open_to)
        x, column = new + at // width, at % width
        h, c = column // branches, column % branches
        picked[k, 0], picked[k, 1] = cells.a[x], cells.b[x]
        w = np.empty(3, dtype=np.int64)
        for axis in range(3):
            w[axis] = _move_prices(axis, cells.begins[k], cells.time[k], steps, size, turns, far[axis])
        best = np.inf
        at = 0
        for y in range(old, new):
            d0, d1 = cells.a[x] - cells.a[y], cells.b[x] - cells.b[y]
            if turns[0]:
                d0 = _short(d0, size[0])
            if turns[1]:
                d1 = _short(d1, size[1])
            if abs(d0) > w[0] or abs(d1) > w[1]:
                continue
            if not (free or _leads(open_to, cells.a[y], cells.b[y], d0, d1, turns)):
                continue
            move = far[0, d0 + w[0]] + far[1, d1 + w[1]]
            for d in range(-w[2], w[2] + 1):
                g = (h + d) % headings
                for e in range(branches):
                    if e != c and not cells.begins[k]:
                        continue
                    t = values[y - base, g * branches + e] + move + far[2, d + w[2]] + (BRANCH_PRICE if e != c else 0.0)
                    if t < best:
                        best, at = t, (y - old) * width + g * branches + e
        _mark(cells, old, cells.first[k + 1], False, open_to)
    x = cells.first[k0] + at // width
    picked[k0, 0], picked[k0, 1] = cells.a[x], cells.b[x]
    return at


@inner_njit
def _short(d: int, n: int) -> int:
    """A move of d steps around a circle of n, the short way."""
    return (d + n // 2) % n - n // 2
