"""Nodes of the ladder graph: postures at rungs, with what each would cost while it is held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Ints
from planner.base.compiled import njit
from planner.base.processes import in_threads
from planner.cell.cell import Cell, rigid_inverse
from planner.cell.kinematics.chain import (
    Chain,
    chain_state,
    invert6,
    jacobian_at,
    largest_singular_value,
    mul4,
    pose_of,
    rotate_about,
    turn,
)
from planner.cell.kinematics.inverse import SPHERICAL_WRIST, kind_of, solve_one
from planner.cell.kinematics.spherical_wrist import inverse_jacobian, sines_of, solve_within
from planner.collision.margins import FIRST, NO, first_lacking, head_lacking
from planner.collision.scene import NOTHING, Obstacles
from planner.collision.table import workspace_for
from planner.resolve.joint_path import SampledTasks

# ----------------------------------------------------------------------------------------------------
# Compiled body of the ladder's nodes: inverse kinematics, Jacobian, and the time that the limits would take.

SIGMA_COMFORT = 0.20  # singular value below which closeness to a singularity is priced
SIGMA_PRICE = 0.3  # seconds a second of printing, at half of SIGMA_COMFORT
LIMIT_COMFORT = 0.35  # rad from a joint's limit, below which closeness is priced
LIMIT_PRICE = 0.4  # seconds a second of printing, at the limit
LIMIT_ROOM = 0.07  # rad from a joint's limit that a node must keep: what moves between rungs needs it
CLEAR_ROOM = 3e-3  # m of clearance that a node must keep besides what is needed: what moves between rungs needs it
LEAN_PRICE = 10.0  # seconds a second of printing, for each 1 of cosine beyond the cones to gravity
DIP_PRICE = 0.25  # seconds a second of printing below the commanded speed: one deep dip beats two shallow ones
AT_SPEED = 0.96  # squared share of the commanded speed above which there is no dip
RAMP_SHARE = 0.7  # of the joints' acceleration, for gaining and losing speed: bends need the rest
_ROUNDING = 1e-9  # rad: what is as near to a limit as may be is judged once, of all joints together


@njit(cache=True, nogil=True, error_model="numpy")
def _sigma(Ji, enough, M, S) -> float:
    """Smallest singular value of a Jacobian from its inverse Ji (6, 6), as `largest_singular_value` has it; or `enough`
    if it is no less than that. M, S (6, 6) are room."""
    square = 0.0
    for i in range(6):
        for j in range(6):
            square += Ji[i, j] * Ji[i, j]
    if square * enough * enough <= 1.0:  # the sum of all singular values' squares
        return enough
    return 1.0 / largest_singular_value(Ji, M, S)


@njit(cache=True, nogil=True, error_model="numpy")
def _time_lost(Ji, solved, twist, rate, weight, v_max, a_max, speeds, x, gain) -> float:
    """Time [s] that the joints' limits take from n samples, with the Jacobian's inverse Ji of their middle.

    twist, rate (n, 6) in the frame of Ji; weight (n). speeds (n, 6) and x, gain (n) are room for the joints' speeds, for
    the squared speed over the commanded one and for how fast it may change: first what the path's bends allow, then,
    forwards and backwards, what can be gained or lost along the path.
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


@njit(cache=True, nogil=True, error_model="numpy")
def _turned(R, twist, out) -> None:
    """Fill out (n, 6) with twists (n, 6), or their rates, whose frame is turned by R (at least 3, 3)."""
    for i in range(len(twist)):
        for a in range(3):
            out[i, a] = R[a, 0] * twist[i, 0] + R[a, 1] * twist[i, 1] + R[a, 2] * twist[i, 2]
            out[i, 3 + a] = R[a, 0] * twist[i, 3] + R[a, 1] * twist[i, 4] + R[a, 2] * twist[i, 5]


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_turn(angle: float, middle: float) -> float:
    """The angle, in whole turns as near to the middle of a joint's range as can be."""
    away = angle - middle
    return middle + away - 2.0 * np.pi * np.rint(away / (2.0 * np.pi))


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_turns(q, middle, q_min, q_max) -> float:
    """Turn all joints of q (na) so; returns the least angle [rad] from the end of a range, negative beyond it."""
    room = np.inf
    for j in range(q.size):
        q[j] = nearest_turn(q[j], middle[j])
        room = min(room, min(q[j] - q_min[j], q_max[j] - q[j]))
    return room


@njit(cache=True, nogil=True, error_model="numpy")
def into_part(J, solved, T_world_part, Jp) -> None:
    """Fill Jp (6, 6) with the columns `solved` of a Jacobian J (6, na), their rows turned from the world into the part
    frame, where twists are given."""
    for j in range(6):
        for i in range(3):
            lin, ang = 0.0, 0.0
            for m in range(3):
                lin += T_world_part[m, i] * J[m, solved[j]]
                ang += T_world_part[m, i] * J[3 + m, solved[j]]
            Jp[i, j], Jp[3 + i, j] = lin, ang


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate_nodes(
    first, last, kind, p, solved, redundant, T_base_world, T_nozzle_flange, arm_placements, arm_axes, arm_tip,
    T_before, axis, T_after, sweeps, swept_joint, held_holder, swept_low, swept_high, held_redundant, least_upright,
    q_min, q_max, v_max, a_max,
    table, now,
    tip, frames, twist, rate, weight,
    rung, start, stop,
    roll_step, holder_step, roll_from, holder_from, branch,
    min_sigma, q_out, price,
):  # fmt: skip
    """Fill q_out and price (see `Nodes`) of rungs first .. last; most arguments are fields of Demand, Grid and Cell.

    solved (6) arm joints that follow from a pose; redundant: the arm's joint that does not, or -1
    T_before, T_after (r, 4, 4), axis (3)   world to part: T_before Rot(axis, swept angle) T_after
    table, now (n)   obstacles, and when a sample is reached
    sweeps   what the grid's second index turns: 0 nothing, 1 a holder joint, 2 the redundant joint
    swept_joint   that joint among all, or -1
    held_holder (r, nh)   angles of the holder's joints that are not swept
    held_redundant (r)                      its angle where it is not swept
    """
    n_rolls, n_holders, n_branches, na = price.shape[1], price.shape[2], price.shape[3], q_out.shape[4]
    middle = 0.5 * (q_min + q_max)
    q_least, q_most = q_min + LIMIT_ROOM - _ROUNDING, q_max - LIMIT_ROOM + _ROUNDING
    comfort = max(SIGMA_COMFORT, min_sigma)
    crowded = len(table.pair) + len(table.look) > 0
    for r in range(first, last):
        R = np.empty((3, 3))
        eight = np.empty((8, na))
        ok = np.empty(8, dtype=np.bool_)
        wanted = np.zeros(8, dtype=np.bool_)
        for c in range(n_branches):
            wanted[branch[r, c]] = True
        known = np.empty(8, dtype=np.int64)
        sigmas, times = np.empty(8), np.empty(8)
        J, J6, Jp, Ji = np.empty((6, na)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
        T_held, T_world_part, T_world_task = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
        T_rolled, T_base_nozzle, T_base_flange = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
        origins, directions = np.empty((na, 3)), np.empty((na, 3))
        z_axis = np.array((0.0, 0.0, 1.0))
        here = slice(start[r], stop[r])
        n_here = stop[r] - start[r]
        own_twist, own_rate = twist[here].copy(), rate[here].copy()
        speeds, x, gain = np.empty((n_here, 6)), np.empty(n_here), np.empty(n_here)
        posture, bodies = np.empty((1, na + held_holder.shape[1])), workspace_for(table)
        head = np.full(n_rolls, -1)  # whether the head lacks clearance from the part: only roll decides that
        for h in range(held_holder.shape[1]):
            posture[0, na + h] = held_holder[r, h]
        i0 = rung[r]
        T_part_task = np.empty((4, 4))
        pose_of(frames[i0], tip[i0], T_part_task)
        duration = 0.0
        for i in range(start[r], stop[r]):
            duration += weight[i]
        for b in range(n_holders):
            swept = (holder_from[r] + b) * holder_step
            if sweeps > 0 and swept_high - swept_low < 2.0 * np.pi:
                swept = nearest_turn(swept, 0.5 * (swept_low + swept_high))
                if min(swept - swept_low, swept_high - swept) < LIMIT_ROOM:
                    continue
            if sweeps == 1:
                posture[0, swept_joint] = swept
            rotate_about(axis, swept if sweeps == 1 else 0.0, R)
            turn(T_before[r], R, T_held)
            mul4(T_held, T_after[r], T_world_part)
            mul4(T_world_part, T_part_task, T_world_task)
            if kind == SPHERICAL_WRIST:  # whose rates are known in its base's frame, not in that of the part
                mul4(T_base_world, T_world_part, T_rolled)
                _turned(T_rolled, twist[here], own_twist)
                _turned(T_rolled, rate[here], own_rate)
            leans = duration * LEAN_PRICE * max(0.0, least_upright + T_world_task[2, 2])
            for a in range(n_rolls):
                rotate_about(z_axis, (roll_from[r] + a) * roll_step, R)
                turn(T_world_task, R, T_rolled)
                mul4(T_base_world, T_rolled, T_base_nozzle)
                mul4(T_base_nozzle, T_nozzle_flange, T_base_flange)
                given = swept if sweeps == 2 else held_redundant[r]
                if kind == SPHERICAL_WRIST:
                    solve_within(p, T_base_flange[:3, :3], T_base_flange[:3, 3], q_least, q_most, wanted, eight, ok)
                else:
                    solve_one(kind, p, given, T_base_flange[:3, :3], T_base_flange[:3, 3], eight, ok)
                known[:] = -1
                for c in range(n_branches):
                    k = branch[r, c]
                    if not ok[k]:
                        continue
                    room = nearest_turns(eight[k], middle, q_min, q_max)
                    if room < LIMIT_ROOM:
                        continue
                    # a spherical wrist turned over has the same axes, one of them reversed: the same rates and sigma
                    pair = k // 2 if kind == SPHERICAL_WRIST else k
                    if known[pair] < 0:
                        if kind == SPHERICAL_WRIST:
                            regular = inverse_jacobian(p, sines_of(eight[k]), T_base_nozzle[:3, 3], Ji)
                        else:
                            chain_state(arm_placements, arm_axes, arm_tip, eight[k], origins, directions, T_held)
                            jacobian_at(origins, directions, T_world_task[:3, 3], J)
                            into_part(J, solved, T_world_part, Jp)
                            regular = invert6(Jp, Ji)
                        sigmas[pair] = _sigma(Ji, comfort, J6, Jp) if regular else 0.0
                        if regular and sigmas[pair] >= min_sigma:
                            times[pair] = _time_lost(
                                Ji, solved, own_twist, own_rate, weight[here], v_max, a_max, speeds, x, gain
                            )
                        known[pair] = 1
                    sigma, lost = sigmas[pair], times[pair]
                    if sigma < min_sigma or sigma == 0.0:
                        continue
                    if crowded:
                        for j in range(na):
                            posture[0, j] = eight[k, j]
                        if head[a] < 0:
                            head[a] = 1 if head_lacking(table, bodies, posture, FIRST, now[i0]) >= 0 else 0
                        if head[a] or first_lacking(table, bodies, posture, FIRST, now[i0], CLEAR_ROOM, NO) >= 0:
                            continue
                    close = max(0.0, SIGMA_COMFORT / sigma - 1.0)
                    near = max(0.0, 1.0 - room / LIMIT_COMFORT)
                    lost += duration * (SIGMA_PRICE * close * close + LIMIT_PRICE * near * near) + leans
                    price[r, a, b, c] = lost
                    for j in range(na):
                        q_out[r, a, b, c, j] = eight[k, j]


# ----------------------------------------------------------------------------------------------------
# Nodes of the ladder graph: postures at rungs, with what each would cost while it is held.
#
# A node is a roll, a holder angle and a branch. Its price is in seconds: the time that the joints' limits would
# take away from a print at the commanded speed if roll and holder rested there, plus margins' worth of time.

BRANCHES = 8  # of every kind of arm


@dataclass(frozen=True)
class Grid:
    """Which rolls, branches and angles of one chosen joint are tried at each rung (r rungs).

    The chosen joint that is tried, the swept one, is called the holder here, which it mostly is.

    roll_step, holder_step [rad]; roll_from, holder_from (r) first grid index of each rung's window, so that a
    node's roll is (roll_from + i) * roll_step; rolls, holders: the window's widths; periodic: the windows are
    the whole circle; branch (r, c) branch numbers to try
    swept: which of the cell's chosen joints is tried, None: none of them; held (r, k): angles of all chosen joints, used for the others
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


@dataclass(frozen=True)
class Nodes:
    """q (r, rolls, holders, c, na) arm joints, each within pi of the middle of its range; price (same less 6) [s],
    infinite where there is no posture; the grid that they stand on; joint: index of the swept one among all joints,
    beyond them where there is none."""

    grid: Grid
    q: NDArray[np.float32]
    price: NDArray[np.float64]
    joint: int = 6


def full_grid(
    demand: SampledTasks,
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
    branch = np.tile(np.arange(BRANCHES), (r, 1))
    return Grid(2 * np.pi / rolls, 2 * np.pi / holders, zero, zero, rolls, holders, True, branch, swept, held)


def evaluate(cell: Cell, demand: SampledTasks, grid: Grid, min_sigma: float, obstacles: Obstacles = NOTHING) -> Nodes:
    """Postures and prices of every node of a grid. Where the nozzle may tilt, that may give the head its clearance from
    part and print, which is not asked for here then."""
    nodes, fill = nodes_to_fill(cell, demand, grid, min_sigma)
    fill(np.arange(len(demand.rung)), obstacles)
    return nodes


def nodes_to_fill(
    cell: Cell, demand: SampledTasks, grid: Grid, min_sigma: float
) -> tuple[Nodes, Callable[[Ints, Obstacles], None]]:
    """Nodes without a posture yet, and what evaluates those of some rungs, as `evaluate` does; also once more."""
    limits, na, nh = cell.limits, len(cell.arm), len(cell.holder)
    r = len(demand.rung)
    held = grid.chosen(r, len(cell.chosen))
    swept = grid.swept if cell.chosen else None
    sweeps = 0 if swept is None else (1 if swept < nh else 2)
    T_before, axis, T_after = holder_around(cell, nh if swept is None else swept, held[:, :nh])
    joint = len(cell.joint_names) if swept is None else cell.chosen[swept]
    low, high = (-np.inf, np.inf) if swept is None else (limits.q_min[joint], limits.q_max[joint])
    redundant = cell.inverse.redundant_joint
    shape = (r, grid.rolls, grid.holders, grid.branch.shape[1])
    q = np.zeros((*shape, na), dtype=np.float32)
    price = np.full(shape, np.inf)
    before = (
        kind_of(cell.inverse), cell.inverse.parameters, np.array(cell.solved), -1 if redundant is None else redundant,
        rigid_inverse(cell.T_world_base), rigid_inverse(cell.T_flange_nozzle),
        cell.arm.placements, cell.arm.axes, cell.arm.T_last_tip,
        T_before, axis, T_after, sweeps, -1 if swept is None else joint, held[:, :nh].copy(),
        low, high, np.zeros(r) if redundant is None else held[:, nh].copy(),
        np.cos(min(demand.cones.layer_gravity, demand.cones.nozzle_gravity)),
        limits.q_min[:na], limits.q_max[:na], limits.velocity[:na], limits.acceleration[:na],
    )  # fmt: skip
    after = (
        demand.now,
        demand.tip, demand.frames, demand.twist, demand.rate, demand.weight,
        demand.rung, demand.start, demand.stop,
        grid.roll_step, grid.holder_step, grid.roll_from, grid.holder_from, grid.branch,
        min_sigma, q, price,
    )  # fmt: skip

    def fill(rungs: Ints, obstacles: Obstacles) -> None:
        table = (obstacles.but_head_on_part if demand.cones.tilt > 0.0 else obstacles).table
        price[rungs] = np.inf

        def part(first: int, last: int) -> None:
            some = rungs[first:last]
            for run in np.split(some, np.flatnonzero(np.diff(some) != 1) + 1):
                evaluate_nodes(run[0], run[-1] + 1, *before, table, *after)

        if len(rungs):
            in_threads(part, len(rungs))

    return Nodes(grid, q, price, joint), fill


def holder_around(cell: Cell, swept: int, held: Array) -> tuple[Array, Array, Array]:
    """World to part as T_before Rot(axis, angle of the swept joint) T_after, the other axes held (r, nh).

    Where no holder joint is swept, T_before is the whole way and the axis any.
    """
    r = len(held)
    holder = cell.holder
    if swept >= len(holder):
        return holder.poses(held), np.array([0.0, 0.0, 1.0]), np.tile(np.eye(4), (r, 1, 1))
    first = Chain(holder.names[:swept], holder.placements[:swept], holder.axes[:swept], holder.placements[swept])
    rest = Chain(holder.names[swept + 1 :], holder.placements[swept + 1 :], holder.axes[swept + 1 :], holder.T_last_tip)
    return first.poses(held[:, :swept]), holder.axes[swept], rest.poses(held[:, swept + 1 :])
