"""Nodes of the ladder graph: postures at rungs, with what each would cost while it is held, compiled.

A node is a roll, a holder angle and a branch. Its price is in seconds: the time that the joints' limits would
take away from a print at the commanded speed if roll and holder rested there, plus margins' worth of time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from planner.cell import Cell, rigid_inverse
from planner.kinematics.chain import mul4, rotate_about
from planner.kinematics.spherical_wrist import BRANCHES, solve_one
from planner.resolve.demand import Demand

Array = NDArray[np.float64]

SIGMA_COMFORT = 0.20  # singular value below which closeness to a singularity is priced
SIGMA_PRICE = 0.2  # seconds a second of printing, at half of SIGMA_COMFORT
LIMIT_COMFORT = 0.35  # rad from a joint's limit, below which closeness is priced
LIMIT_PRICE = 0.2  # seconds a second of printing, at the limit
LIMIT_ROOM = 0.07  # rad from a joint's limit that a node must keep: what moves between rungs needs it
DIP_PRICE = 0.25  # seconds a second of printing below the commanded speed: one deep dip beats two shallow ones
AT_SPEED = 0.96  # squared share of the commanded speed above which there is no dip
RAMP_SHARE = 0.7  # of the joints' acceleration, for gaining and losing speed: bends need the rest


@dataclass(frozen=True)
class Grid:
    """Which rolls, holder angles and branches are tried at each rung (r rungs).

    roll_step, holder_step [rad]; roll_from, holder_from (r) first grid index of each rung's window, so that a
    node's roll is (roll_from + i) * roll_step; rolls, holders: the window's widths; periodic: the windows are
    the whole circle; branch (r, c) branch numbers to try
    """

    roll_step: float
    holder_step: float
    roll_from: NDArray[np.int64]
    holder_from: NDArray[np.int64]
    rolls: int
    holders: int
    periodic: bool
    branch: NDArray[np.int64]


@dataclass(frozen=True)
class Nodes:
    """q (r, rolls, holders, c, 6) arm joints, each within pi of the middle of its range; price (same less 6) [s],
    infinite where there is no posture; the grid that they stand on."""

    grid: Grid
    q: NDArray[np.float32]
    price: NDArray[np.float64]


def full_grid(demand: Demand, roll_step: float, holder_step: float, has_holder: bool) -> Grid:
    """All rolls, all holder angles, all branches at every rung; steps are rounded to divide the circle."""
    r = len(demand.rung)
    rolls = int(np.ceil(2 * np.pi / roll_step - 1e-9))
    holders = int(np.ceil(2 * np.pi / holder_step - 1e-9)) if has_holder else 1
    zero = np.zeros(r, dtype=np.int64)
    branch = np.tile(np.arange(BRANCHES), (r, 1))
    return Grid(2 * np.pi / rolls, 2 * np.pi / holders, zero, zero, rolls, holders, True, branch)


def evaluate(cell: Cell, demand: Demand, grid: Grid, min_sigma: float) -> Nodes:
    """Postures and prices of every node of a grid."""
    geometry = _geometry(cell)
    limits = cell.limits
    r = len(demand.rung)
    shape = (r, grid.rolls, grid.holders, grid.branch.shape[1])
    q = np.zeros((*shape, 6), dtype=np.float32)
    price = np.full(shape, np.inf)
    _evaluate(
        *geometry,
        limits.q_min[:6], limits.q_max[:6], limits.velocity[:6], limits.acceleration[:6],
        demand.tip, demand.frames, demand.twist, demand.rate, demand.weight,
        demand.rung, demand.start, demand.stop,
        grid.roll_step, grid.holder_step, grid.roll_from, grid.holder_from, grid.branch,
        min_sigma, q, price,
    )  # fmt: skip
    return Nodes(grid, q, price)


def _geometry(cell: Cell) -> tuple[Array, ...]:
    """Constant transforms of the cell, flat, for the kernel; a fixed bed is a holder that never turns."""
    if len(cell.holder):
        before, axis, after = cell.holder.placements[0], cell.holder.axes[0], cell.holder.T_last_tip
    else:
        before, axis, after = cell.T_world_holder, np.array([0.0, 0.0, 1.0]), np.eye(4)
    return (
        cell.wrist.parameters,
        rigid_inverse(cell.T_world_base) @ before,
        axis,
        after,
        rigid_inverse(cell.T_flange_nozzle),
    )


@njit(cache=True)
def jacobian_in_base(p: Array, q: Array, tip: Array, J: Array) -> None:
    """Fill J (6, 6), linear rows first, of an OPW arm at a point `tip` given in its base frame."""
    a1, a2, b, c1, c2, c3 = p[0], p[1], p[2], p[3], p[4], p[5]
    theta3 = q[2] + 0.5 * np.pi
    s1, co1 = np.sin(q[0]), np.cos(q[0])
    s2, co2 = np.sin(q[1]), np.cos(q[1])
    s23, c23 = np.sin(q[1] + theta3), np.cos(q[1] + theta3)
    s4, co4 = np.sin(q[3]), np.cos(q[3])
    s5, co5 = np.sin(q[4]), np.cos(q[4])
    z = np.empty((6, 3))
    o = np.empty((6, 3))
    z[0] = (0.0, 0.0, 1.0)
    z[1] = (-s1, co1, 0.0)
    z[2] = z[1]
    z[3] = (co1 * s23, s1 * s23, c23)
    x3 = (co1 * c23, s1 * c23, -s23)
    for i in range(3):
        z[4, i] = -s4 * x3[i] + co4 * z[1, i]
        z[5, i] = s5 * (co4 * x3[i] + s4 * z[1, i]) + co5 * z[3, i]
    o[0] = (0.0, 0.0, c1)
    o[1] = (co1 * a1 - s1 * b, s1 * a1 + co1 * b, c1)
    for i in range(3):
        o[2, i] = o[1, i]
    o[2, 0] += c2 * co1 * s2
    o[2, 1] += c2 * s1 * s2
    o[2, 2] += c2 * co2
    for i in range(3):
        o[3, i] = o[2, i] + c3 * z[3, i] + a2 * x3[i]
        o[4, i] = o[3, i]
        o[5, i] = o[3, i]
    for j in range(6):
        rx, ry, rz = tip[0] - o[j, 0], tip[1] - o[j, 1], tip[2] - o[j, 2]
        J[0, j] = z[j, 1] * rz - z[j, 2] * ry
        J[1, j] = z[j, 2] * rx - z[j, 0] * rz
        J[2, j] = z[j, 0] * ry - z[j, 1] * rx
        J[3, j], J[4, j], J[5, j] = z[j, 0], z[j, 1], z[j, 2]


@njit(cache=True)
def invert6(A: Array, B: Array) -> bool:
    """Fill B with the inverse of A (6, 6), which is spoilt; False if A is singular to rounding."""
    n = 6
    for i in range(n):
        for j in range(n):
            B[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if abs(A[best, k]) < 1e-12:
            return False
        if best != k:
            for j in range(n):
                A[k, j], A[best, j] = A[best, j], A[k, j]
                B[k, j], B[best, j] = B[best, j], B[k, j]
        scale = 1.0 / A[k, k]
        for j in range(n):
            A[k, j] *= scale
            B[k, j] *= scale
        for i in range(n):
            if i != k:
                f = A[i, k]
                for j in range(n):
                    A[i, j] -= f * A[k, j]
                    B[i, j] -= f * B[k, j]
    return True


@njit(cache=True)
def largest_singular_value(B: Array) -> float:
    """Of B (6, 6), by power iteration on B B^T; within some 1 % from below, for prices only."""
    v = np.ones(6)
    value = 0.0
    for _ in range(12):
        w = np.zeros(6)
        for i in range(6):
            for j in range(6):
                w[j] += B[i, j] * v[i]
        norm = 0.0
        for i in range(6):
            v[i] = 0.0
            for j in range(6):
                v[i] += B[i, j] * w[j]
            norm += v[i] * v[i]
        norm = np.sqrt(norm)
        for i in range(6):
            v[i] /= norm
        value = np.sqrt(norm)
    return value


@njit(cache=True)
def _time_lost(Ji, twist, rate, weight, start: int, stop: int, v_max, a_max, x) -> float:  # type: ignore[no-untyped-def]
    """Time [s] that the joints' limits take from samples start..stop, with the Jacobian's inverse Ji of their middle.

    x (stop - start) is room for the squared speed over the commanded one: first what the path's bends allow,
    then, forwards and backwards, what the joints can gain or lose along the path.
    """
    for i in range(start, stop):
        least = 1.0
        gain = np.inf
        for j in range(6):
            qd = 0.0
            qdd = 0.0
            for m in range(6):
                qd += Ji[j, m] * twist[i, m]
                qdd += Ji[j, m] * rate[i, m]
            qd, qdd = abs(qd), abs(qdd)
            if qd * qd * least > v_max[j] * v_max[j]:
                least = (v_max[j] / qd) ** 2
            if qdd * least > a_max[j]:
                least = a_max[j] / qdd
            if qd * gain > a_max[j]:
                gain = a_max[j] / qd
        x[i - start] = least
        if i > start:
            x[i - start] = min(least, x[i - start - 1] + 2.0 * RAMP_SHARE * weight[i] * gain)
    lost = 0.0
    for i in range(stop - 1, start - 1, -1):
        k = i - start
        if i + 1 < stop:
            gain = np.inf
            for j in range(6):
                qd = 0.0
                for m in range(6):
                    qd += Ji[j, m] * twist[i, m]
                if abs(qd) * gain > a_max[j]:
                    gain = a_max[j] / abs(qd)
            x[k] = min(x[k], x[k + 1] + 2.0 * RAMP_SHARE * weight[i] * gain)
        lost += weight[i] * (1.0 / np.sqrt(x[k]) - 1.0)
        if x[k] < AT_SPEED:
            lost += weight[i] * DIP_PRICE
    return lost


@njit(cache=True, parallel=True)
def _evaluate(
    p, T_base_before, axis, T_after, T_nozzle_flange,
    q_min, q_max, v_max, a_max,
    tip, frames, twist, rate, weight,
    rung, start, stop,
    roll_step, holder_step, roll_from, holder_from, branch,
    min_sigma, q_out, price,
):  # fmt: skip
    n_rolls, n_holders, n_branches = price.shape[1], price.shape[2], price.shape[3]
    middle = 0.5 * (q_min + q_max)
    for r in prange(rung.size):
        T = np.eye(4)
        H = np.eye(4)
        roll_turn = np.eye(4)
        eight = np.empty((8, 6))
        ok = np.empty(8, dtype=np.bool_)
        J = np.empty((6, 6))
        Jp = np.empty((6, 6))
        Ji = np.empty((6, 6))
        z_axis = np.array((0.0, 0.0, 1.0))
        x = np.empty(stop[r] - start[r])
        i0 = rung[r]
        T_part_task = np.eye(4)
        T_part_task[:3, :3] = frames[i0]
        T_part_task[:3, 3] = tip[i0]
        duration = 0.0
        for i in range(start[r], stop[r]):
            duration += weight[i]
        for b in range(n_holders):
            H[:3, :3] = rotate_about(axis, (holder_from[r] + b) * holder_step)
            T_base_part = mul4(mul4(T_base_before, H), T_after)
            T_base_task = mul4(T_base_part, T_part_task)
            for a in range(n_rolls):
                roll_turn[:3, :3] = rotate_about(z_axis, (roll_from[r] + a) * roll_step)
                T = mul4(mul4(T_base_task, roll_turn), T_nozzle_flange)
                solve_one(p, T[:3, :3].copy(), T[:3, 3].copy(), eight, ok)
                for c in range(n_branches):
                    k = branch[r, c]
                    if not ok[k]:
                        continue
                    room = np.inf
                    for j in range(6):
                        # the turn nearest the middle of the joint's range
                        angle = eight[k, j] - middle[j]
                        angle = middle[j] + angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
                        eight[k, j] = angle
                        room = min(room, min(angle - q_min[j], q_max[j] - angle))
                    if room < LIMIT_ROOM:
                        continue
                    jacobian_in_base(p, eight[k], T_base_task[:3, 3].copy(), J)
                    # rows into the part frame, where the demand is given
                    for j in range(6):
                        for i in range(3):
                            lin = 0.0
                            ang = 0.0
                            for m in range(3):
                                lin += T_base_part[m, i] * J[m, j]
                                ang += T_base_part[m, i] * J[3 + m, j]
                            Jp[i, j] = lin
                            Jp[3 + i, j] = ang
                    if not invert6(Jp, Ji):
                        continue
                    sigma = 1.0 / largest_singular_value(Ji)
                    if sigma < min_sigma:
                        continue
                    lost = _time_lost(Ji, twist, rate, weight, start[r], stop[r], v_max, a_max, x)
                    close = max(0.0, SIGMA_COMFORT / sigma - 1.0)
                    near = max(0.0, 1.0 - room / LIMIT_COMFORT)
                    lost += duration * (SIGMA_PRICE * close * close + LIMIT_PRICE * near * near)
                    price[r, a, b, c] = lost
                    for j in range(6):
                        q_out[r, a, b, c, j] = eight[k, j]
