"""Nodes of the ladder graph: postures at rungs, with what each costs while it is held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Ints
from planner.base.compiled import inner_njit, njit
from planner.base.processes import in_threads
from planner.cell.cell import Cell
from planner.cell.kinematics.chain import chain_state, largest_singular_value, mul4, pose_of
from planner.cell.kinematics.inverse import SPHERICAL_WRIST, branches_of, solve_one
from planner.cell.kinematics.spherical_wrist import inverse_jacobian, sines_of, solve_within
from planner.collision.scene import NOTHING, Obstacles
from planner.collision.table import workspace_for
from planner.resolve.joint_path import SampledTasks, least_cone
from planner.resolve.prices import (
    AT_SPEED,
    DIP_PRICE,
    LEAN_PRICE,
    LIMIT_COMFORT,
    LIMIT_PRICE,
    SIGMA_COMFORT,
    SIGMA_PRICE,
)
from planner.resolve.reach import (
    GridNumbers,
    angle_in_range,
    arm_limits,
    arm_numbers,
    flange_pose,
    inverse_in_part,
    lacks_clearance,
    lean_nozzle,
    nearest_turns,
    part_pose,
    room_for_poses,
    rung_numbers,
    swept_joint,
)

# ----------------------------------------------------------------------------------------------------
# Compiled body of the ladder's nodes: inverse kinematics, Jacobian, and the time lost to the joints' limits.

RAMP_SHARE = 0.7  # share of the joints' acceleration for speeding up and slowing down: bends need the rest
_ROUNDING = 1e-9  # rad by which the solver may miss a limit: limits are checked once, for all joints together


@inner_njit
def _sigma(Ji, enough, M, S) -> float:
    """Smallest singular value of a Jacobian from its inverse Ji (6, 6), by `largest_singular_value`; or `enough` if it
    is at least that. M, S (6, 6) are scratch."""
    square = 0.0
    for i in range(6):
        for j in range(6):
            square += Ji[i, j] * Ji[i, j]
    if square * enough * enough <= 1.0:  # the sum of all singular values' squares
        return enough
    return 1.0 / largest_singular_value(Ji, M, S)


@inner_njit
def _time_lost(Ji, solved, twist, rate, weight, v_max, a_max, speeds, x, gain) -> float:
    """Time [s] lost to the joints' limits over n samples, with the inverse Jacobian Ji at their middle.

    twist, rate (n, 6) in the frame of Ji; weight (n). Scratch: speeds (n, 6) for the joints' speeds; x (n) for the
    squared ratio of speed to commanded speed, first as the path's bends allow, then, forwards and backwards, as it can
    be gained and lost along the path; gain (n) for how fast it may change.
    """
    n = len(weight)
    slowest = 1.0
    for i in range(n):
        x[i] = 1.0
        if weight[i] == 0.0:
            continue
        least = 1.0
        for k6 in range(6):
            j = solved[k6]
            qd = 0.0
            qdd = 0.0
            for m in range(6):
                qd += Ji[k6, m] * twist[i, m]
                qdd += Ji[k6, m] * rate[i, m]
            qd, qdd = abs(qd), abs(qdd)
            speeds[i, k6] = qd
            if qd * qd * least > v_max[j] * v_max[j]:
                least = (v_max[j] / qd) ** 2
            if qdd * least > a_max[j]:
                least = a_max[j] / qdd
        x[i] = least
        slowest = min(slowest, least)
    if slowest == 1.0:
        return 0.0
    for i in range(n):
        most = np.inf
        if weight[i] > 0.0:
            for k6 in range(6):
                if speeds[i, k6] * most > a_max[solved[k6]]:
                    most = a_max[solved[k6]] / speeds[i, k6]
        gain[i] = 2.0 * RAMP_SHARE * weight[i] * most if weight[i] > 0.0 else np.inf
    for i in range(1, n):
        x[i] = min(x[i], x[i - 1] + gain[i])
    lost = 0.0
    for i in range(n - 1, -1, -1):
        if i + 1 < n:
            x[i] = min(x[i], x[i + 1] + gain[i])
        if x[i] < 1.0:
            lost += weight[i] * (1.0 / np.sqrt(x[i]) - 1.0)
            if x[i] < AT_SPEED:
                lost += weight[i] * DIP_PRICE
    return lost


@inner_njit
def _turned(R, twist, out) -> None:
    """Fill out (n, 6) with twists (n, 6), or their rates, turned by R (at least 3, 3)."""
    for i in range(len(twist)):
        for a in range(3):
            out[i, a] = R[a, 0] * twist[i, 0] + R[a, 1] * twist[i, 1] + R[a, 2] * twist[i, 2]
            out[i, 3 + a] = R[a, 0] * twist[i, 3] + R[a, 1] * twist[i, 4] + R[a, 2] * twist[i, 5]


class NodeFloors(NamedTuple):
    """What a node must keep: min_sigma, the least singular value; upright, the cosine of the surface normal's lean
    beyond which cones cannot be kept (priced, not forbidden); lean, the nozzle's share of it, as in `SampledTasks`."""

    min_sigma: float
    upright: float
    lean: float


class NodesFilled(NamedTuple):
    """The arrays q and price of `Nodes`, to be filled."""

    q: NDArray[np.float32]
    price: Array


@njit
def evaluate_nodes(first, last, arm, limits, swept, grid, rungs, table, floors, out) -> None:
    """Fill the nodes `out` of rungs first .. last that have a posture, see `Nodes`.

    arm: ArmNumbers, limits: ArmLimits, swept: SweptJoint, grid: GridNumbers, rungs: RungNumbers, table: Table of the
    obstacles, floors: NodeFloors, out: NodesFilled
    """
    kind, solver, p, solved, T_base_world = arm.kind, arm.solver, arm.parameters, arm.solved, arm.T_base_world
    q_min, q_max, v_max, a_max = limits.q_min, limits.q_max, limits.v_max, limits.a_max
    twist, rate, weight, start, stop = rungs.twist, rungs.rate, rungs.weight, rungs.start, rungs.stop
    branch, min_sigma, q_out, price = grid.branch, floors.min_sigma, out.q, out.price
    n_rolls, n_holders, n_branches, na = price.shape[1], price.shape[2], price.shape[3], q_out.shape[4]
    middle = 0.5 * (q_min + q_max)
    q_least, q_most = q_min + limits.room - _ROUNDING, q_max - limits.room + _ROUNDING
    comfort = max(SIGMA_COMFORT, min_sigma)
    crowded = len(table.pair) + len(table.look) > 0
    slots = branches_of(kind)
    room = room_for_poses(na, swept.holder.shape[1], slots)
    placements, axes, T_last_tip = arm.placements, arm.axes, arm.T_last_tip
    origins, directions, J, T_world_part = room.origins, room.directions, room.J, room.T_world_part
    branch_q, ok, J6, Jp, Ji = room.postures, room.ok, room.J6, room.Jp, room.Ji
    R, z_axis, T_world_task, T_rolled = room.R, room.z_axis, room.T_world_task, room.T_rolled
    T_base_nozzle, T_base_flange, posture = room.T_base_nozzle, room.T_base_flange, room.posture
    T_nozzle_flange, roll_from, redundant, now = arm.T_nozzle_flange, grid.roll_from, swept.redundant, rungs.now
    known, sigmas, times = np.empty(slots, dtype=np.int64), np.empty(slots), np.empty(slots)
    for r in range(first, last):
        given = redundant[r].copy()
        wanted = np.zeros(slots, dtype=np.bool_)
        for c in range(n_branches):
            wanted[branch[r, c]] = True
        here = slice(start[r], stop[r])
        n_here = stop[r] - start[r]
        own_twist, own_rate = twist[here].copy(), rate[here].copy()
        speeds, x, gain = np.empty((n_here, 6)), np.empty(n_here), np.empty(n_here)
        bodies = workspace_for(table)  # new for each rung: what it remembers of others would depend on the threads
        head = np.full(n_rolls, -1, dtype=np.int8)
        for h in range(swept.holder.shape[1]):
            posture[0, na + h] = swept.holder[r, h]
        i0 = rungs.rung[r]
        pose_of(rungs.frames[i0], rungs.tip[i0], room.T_part_task)
        duration = 0.0
        for i in range(start[r], stop[r]):
            duration += weight[i]
        for b in range(n_holders):
            angle, inside = angle_in_range(swept, (grid.holder_from[r] + b) * grid.holder_step)
            if not inside:
                continue
            if swept.sweeps == 1:
                posture[0, swept.joint] = angle
            part_pose(swept, r, angle, room)
            lean_nozzle(T_world_task, floors.lean, R, T_rolled)
            if kind == SPHERICAL_WRIST:  # its inverse Jacobian is in its base frame, not in the part frame
                mul4(T_base_world, T_world_part, T_rolled)
                _turned(T_rolled, twist[here], own_twist)
                _turned(T_rolled, rate[here], own_rate)
            up = 0.0
            for m in range(3):
                up += T_world_part[2, m] * rungs.normals[i0, m]
            leans = duration * LEAN_PRICE * max(0.0, floors.upright - up)
            for a in range(n_rolls):
                roll = (roll_from[r] + a) * grid.roll_step
                flange_pose(
                    T_base_world, T_nozzle_flange, T_world_task, z_axis, roll, R, T_rolled, T_base_nozzle, T_base_flange
                )
                if kind == SPHERICAL_WRIST:
                    solve_within(p, T_base_flange[:3, :3], T_base_flange[:3, 3], q_least, q_most, wanted, branch_q, ok)
                else:
                    if swept.sweeps >= 2:
                        given[swept.sweeps - 2] = angle
                    solve_one(kind, solver, p, given, T_base_flange, branch_q, ok)
                known[:] = -1
                for c in range(n_branches):
                    k = branch[r, c]
                    if not ok[k]:
                        continue
                    away = nearest_turns(branch_q[k], middle, q_min, q_max, limits.turns)
                    if away < limits.room:
                        continue
                    # flipping a spherical wrist keeps its axes, one of them reversed: same rates and sigma
                    pair = k // 2 if kind == SPHERICAL_WRIST else k
                    if known[pair] < 0:
                        if kind == SPHERICAL_WRIST:
                            regular = inverse_jacobian(p, sines_of(branch_q[k]), T_base_nozzle[:3, 3], Ji)
                        else:
                            chain_state(placements, axes, T_last_tip, branch_q[k], origins, directions, T_rolled)
                            regular = inverse_in_part(
                                origins, directions, solved, T_world_part, T_world_task, J, Jp, Ji
                            )
                        sigmas[pair] = _sigma(Ji, comfort, J6, Jp) if regular else 0.0
                        if regular and sigmas[pair] >= min_sigma:
                            times[pair] = _time_lost(
                                Ji, solved, own_twist, own_rate, weight[here], v_max, a_max, speeds, x, gain
                            )
                        known[pair] = 1
                    sigma, lost = sigmas[pair], times[pair]
                    if sigma < min_sigma or sigma == 0.0:
                        continue
                    if crowded and lacks_clearance(table, bodies, posture, branch_q[k], now[i0], head, a):
                        continue
                    close = max(0.0, SIGMA_COMFORT / sigma - 1.0)
                    near = max(0.0, 1.0 - away / LIMIT_COMFORT)
                    lost += duration * (SIGMA_PRICE * close * close + LIMIT_PRICE * near * near) + leans
                    price[r, a, b, c] = lost
                    for j in range(na):
                        q_out[r, a, b, c, j] = branch_q[k, j]


# ----------------------------------------------------------------------------------------------------
# Nodes of the ladder graph: postures at rungs, with what each costs while it is held.
#
# A node is a roll, a holder angle and a branch. Its price is in seconds: the time that the joints' limits would
# cost a print at the commanded speed with roll and holder at rest there, plus what small margins are worth.


@dataclass(frozen=True)
class Grid:
    """Which rolls, branches and angles of one chosen joint are tried at each rung (r rungs).

    The chosen joint that is varied, the swept one, is called the holder here, which it usually is.

    roll_step, holder_step [rad]; roll_from, holder_from (r) first grid index of each rung's window, so that a
    node's roll is (roll_from + i) * roll_step; rolls, holders: the window's widths; periodic: the windows are
    the whole circle; branch (r, c) branch numbers to try
    swept: which of the cell's chosen joints is varied, None for none; held (r, k): angles of all chosen joints, used
    for the others
    """

    roll_step: float
    holder_step: float
    roll_from: NDArray[np.int64]
    holder_from: NDArray[np.int64]
    rolls: int
    holders: int
    periodic: bool
    branch: NDArray[np.int64]
    swept: int | None = 0
    held: Array | None = None

    def chosen(self, r: int, k: int) -> Array:
        """Held angles (r, k) of a cell with k chosen joints: 0 where none were given."""
        return np.zeros((r, k)) if self.held is None else self.held

    @property
    def numbers(self) -> GridNumbers:
        """The grid for kernels."""
        return GridNumbers(self.roll_step, self.holder_step, self.roll_from, self.holder_from, self.branch)


@dataclass(frozen=True)
class Nodes:
    """Postures and prices on a grid.

    q (r, rolls, holders, c, na)   arm joints, each within pi of the middle of its range
    price (r, rolls, holders, c)   [s], infinite where there is no posture
    joint, scale                   index of the swept joint among all joints, beyond them if there is none; zero and
                                   unit of its values, see `grid_scale`
    """

    grid: Grid
    q: NDArray[np.float32]
    price: NDArray[np.float64]
    joint: int
    scale: tuple[float, float] = (0.0, 1.0)

    def swept_at(self, index: Ints | int) -> Array:
        """Values [rad, m] of the swept joint at grid indices."""
        zero, unit = self.scale
        return np.asarray(zero + unit * index * self.grid.holder_step)

    def holder_joints(self, cell: Cell, rung: int) -> Array:
        """Holder joints (holders, nh) at a rung's angles of the swept joint."""
        grid, k = self.grid, len(cell.chosen)
        rung %= len(self.price)
        chosen = np.repeat(grid.chosen(len(self.price), k)[rung : rung + 1], self.price.shape[2], axis=0)
        if k and grid.swept is not None:
            chosen[:, grid.swept] = self.swept_at(grid.holder_from[rung] + np.arange(len(chosen)))
        return chosen[:, : len(cell.holder)]


def full_grid(
    demand: SampledTasks,
    branches: int,
    roll_step: float,
    holder_step: float,
    has_holder: bool,
    swept: int | None = 0,
    held: Array | None = None,
) -> Grid:
    """All rolls, all angles of the swept joint, all branches at every rung; steps are rounded to divide the circle."""
    r = len(demand.rung)
    rolls = int(np.ceil(2 * np.pi / roll_step - 1e-9))
    holders = int(np.ceil(2 * np.pi / holder_step - 1e-9)) if has_holder else 1
    zero = np.zeros(r, dtype=np.int64)
    branch = np.tile(np.arange(branches), (r, 1))
    return Grid(2 * np.pi / rolls, 2 * np.pi / holders, zero, zero, rolls, holders, True, branch, swept, held)


def evaluate(cell: Cell, demand: SampledTasks, grid: Grid, min_sigma: float, obstacles: Obstacles = NOTHING) -> Nodes:
    """Postures and prices of every node of a grid.

    Where the nozzle may tilt, the head need not be clear of part and print here: tilt may still provide that.
    """
    nodes, fill = nodes_to_fill(cell, demand, grid, min_sigma)
    fill(np.arange(len(demand.rung)), obstacles)
    return nodes


def nodes_to_fill(
    cell: Cell, demand: SampledTasks, grid: Grid, min_sigma: float
) -> tuple[Nodes, Callable[[Ints, Obstacles], None]]:
    """Nodes without postures yet, and a function that (re-)evaluates those of some rungs as `evaluate` does."""
    r, na = len(demand.rung), len(cell.arm)
    swept = swept_joint(cell, grid.swept, grid.chosen(r, len(cell.chosen)))
    shape = (r, grid.rolls, grid.holders, grid.branch.shape[1])
    q = np.zeros((*shape, na), dtype=np.float32)
    price = np.full(shape, np.inf)
    upright = np.cos(min(least_cone(demand.cones), np.pi))
    before = arm_numbers(cell), arm_limits(cell), swept, grid.numbers, rung_numbers(demand)
    after = NodeFloors(float(min_sigma), float(upright), demand.lean), NodesFilled(q, price)

    def fill(rungs: Ints, obstacles: Obstacles) -> None:
        table = (obstacles.but_head_on_part if demand.cones.tilt > 0.0 else obstacles).table
        price[rungs] = np.inf

        def part(first: int, last: int) -> None:
            some = rungs[first:last]
            for run in np.split(some, np.flatnonzero(np.diff(some) != 1) + 1):
                evaluate_nodes(run[0], run[-1] + 1, *before, table, *after)

        if len(rungs):
            in_threads(part, len(rungs))

    joint = len(cell.joint_names) if swept.joint < 0 else swept.joint
    return Nodes(grid, q, price, joint, (swept.zero, swept.unit)), fill
