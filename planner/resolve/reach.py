"""How an arm reaches nozzle poses, compiled: arm, limits, rungs and grid as numbers, and steps that all postures share.

Both the ladder's nodes (`nodes`) and the score of a placement (`planner.place.rating`) visit every posture of a grid:
at each rung, angle of the swept joint and roll there is one nozzle pose, and the arm's postures for it. What both have
in common is here; what a posture is worth is up to them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.compiled import inner_njit
from planner.cell.cell import Cell, Limits, rigid_inverse
from planner.cell.kinematics.chain import Chain, invert6, jacobian_at, mul4, rotate_about, turn
from planner.cell.kinematics.inverse import SolverAddresses, kind_of, solver_of
from planner.collision.margins import FIRST, NO, first_lacking, head_lacking
from planner.resolve.joint_path import SampledTasks

CLEAR_ROOM = 3e-3  # m of clearance that a node must keep beyond what is required: motion between rungs needs it

# ----------------------------------------------------------------------------------------------------
# What kernels are given: the arm, its limits, the swept joint, the rungs, and scratch.


class ArmNumbers(NamedTuple):
    """An arm of na joints.

    kind, solver, parameters             of its closed form: `kind_of`, `solver_of`, `InverseKinematics.parameters`
    solved (6)                           indices of the joints that follow from a pose
    T_base_world, T_nozzle_flange (4, 4) fixed transforms at the two ends of the closed form
    placements (na, 4, 4), axes (na, 3), T_last_tip (4, 4)   as in Chain, from the world to the nozzle
    """

    kind: int
    solver: SolverAddresses
    parameters: Array
    solved: Ints
    T_base_world: Array
    T_nozzle_flange: Array
    placements: Array
    axes: Array
    T_last_tip: Array


class ArmLimits(NamedTuple):
    """Limits (na) of the arm's joints: ends of their ranges [rad], speed [rad/s], acceleration [rad/s^2]; in metres for
    joints that slide. room: distance that nodes keep from those ends."""

    q_min: Array
    q_max: Array
    v_max: Array
    a_max: Array
    turns: Flags
    room: float


class SweptJoint(NamedTuple):
    """The joint that the grid's second index moves at r rungs, and the angles [rad] of those that it does not move.

    T_before, T_after (r, 4, 4), axis (6)   world to part: T_before, the swept joint's motion about or along its axis
                                            (as in Chain), T_after
    sweeps                                  0: nothing, 1: a holder joint, 2 and up: the arm's given joints, in order
    joint                                   index of that joint among all, or -1; low, high: ends of its range [rad],
                                            from which nodes keep `room`
    slides, zero, unit                      whether it slides; its place is then zero + unit times the swept angle [m]
    holder (r, nh), redundant (r, k)        angles of the holder's joints and of the arm's given ones (one, if there are
                                            none)
    """

    T_before: Array
    axis: Array
    T_after: Array
    sweeps: int
    joint: int
    low: float
    high: float
    room: float
    slides: bool
    zero: float
    unit: float
    holder: Array
    redundant: Array


class GridNumbers(NamedTuple):
    """Steps [rad], first indices (r) and branches (r, c) of a `Grid`."""

    roll_step: float
    holder_step: float
    roll_from: Ints
    holder_from: Ints
    branch: Ints


class RungNumbers(NamedTuple):
    """Samples (n) and rungs (r) of `SampledTasks`, whose fields these are."""

    tip: Array
    normals: Array
    frames: Array
    twist: Array
    rate: Array
    now: Array
    weight: Array
    rung: Ints
    start: Ints
    stop: Ints


class PoseRoom(NamedTuple):
    """Scratch for one thread, refilled at each pose.

    R (3, 3), T_held, T_rolled (4, 4)       intermediate results
    T_part_task, T_world_part, T_world_task, T_base_nozzle, T_base_flange (4, 4)   a rung's task, and its poses
    z_axis (3)                              about which the nozzle rolls
    postures (branches, na), ok (branches)  of all branches [rad], and which exist
    origins, directions (na, 3), J (6, na)  of the chain; Jp, Ji (6, 6): solved columns, and their inverse; J6 (6, 6)
    posture (1, na + nh)                    arm and holder
    """

    R: Array
    T_held: Array
    T_rolled: Array
    T_part_task: Array
    T_world_part: Array
    T_world_task: Array
    T_base_nozzle: Array
    T_base_flange: Array
    z_axis: Array
    postures: Array
    ok: Flags
    origins: Array
    directions: Array
    J: Array
    Jp: Array
    Ji: Array
    J6: Array
    posture: Array


def arm_numbers(cell: Cell) -> ArmNumbers:
    """The cell's arm for kernels."""
    return ArmNumbers(
        kind_of(cell.inverse), solver_of(cell.inverse), cell.inverse.parameters, np.array(cell.solved),
        rigid_inverse(cell.T_world_base), rigid_inverse(cell.T_flange_nozzle),
        cell.arm.placements, cell.arm.axes, cell.arm.T_last_tip,
    )  # fmt: skip


def arm_limits(cell: Cell) -> ArmLimits:
    """The limits of the cell's arm for kernels."""
    limits, na = cell.limits, len(cell.arm)
    ends = limits.q_min[:na], limits.q_max[:na]
    return ArmLimits(*ends, limits.velocity[:na], limits.acceleration[:na], limits.turns[:na], limits.room)


def grid_scale(limits: Limits, joint: int) -> tuple[float, float]:
    """Zero and unit of a joint on a grid of angles, where its value is zero + unit times the angle.

    The range of a joint that slides is spread over the circle; other joints are their own angle.
    """
    if joint not in limits.sliding:
        return 0.0, 1.0
    low, high = float(limits.q_min[joint]), float(limits.q_max[joint])
    return low, (high - low) / (2.0 * np.pi)


def looked_at(cell: Cell) -> tuple[Array, Array]:
    """Ends of what is tried of the chosen joints (k): half a turn to each side of home; all of it if they slide."""
    limits, chosen = cell.limits, list(cell.chosen)
    half = np.where(limits.turns[chosen], np.pi, limits.q_max[chosen] - limits.q_min[chosen])
    home = cell.home[chosen]
    return np.maximum(limits.q_min[chosen], home - half), np.minimum(limits.q_max[chosen], home + half)


def swept_joint(cell: Cell, swept: int | None, held: Array) -> SweptJoint:
    """What moves if the chosen joint of this index is swept, or none, with chosen joints held at angles (r, k)."""
    limits, nh = cell.limits, len(cell.holder)
    swept = swept if cell.chosen else None
    sweeps = 0 if swept is None else (1 if swept < nh else 2 + swept - nh)
    T_before, axis, T_after = _holder_around(cell, nh if swept is None else swept, held[:, :nh])
    joint = -1 if swept is None else cell.chosen[swept]
    low, high = (-np.inf, np.inf) if swept is None else (float(limits.q_min[joint]), float(limits.q_max[joint]))
    redundant = held[:, nh:].copy() if cell.given else np.zeros((len(held), 1))
    scale = joint in limits.sliding, *grid_scale(limits, joint)
    ends = low, high, limits.room
    return SweptJoint(T_before, axis, T_after, sweeps, joint, *ends, *scale, held[:, :nh].copy(), redundant)


def rung_numbers(demand: SampledTasks) -> RungNumbers:
    """The samples and rungs of a demand for kernels."""
    return RungNumbers(
        demand.tip, demand.normals, demand.frames, demand.twist, demand.rate, demand.now, demand.weight,
        demand.rung, demand.start, demand.stop,
    )  # fmt: skip


def _holder_around(cell: Cell, swept: int, held: Array) -> tuple[Array, Array, Array]:
    """World to part as T_before, the swept joint's motion on its axis (6), and T_after, the others held (r, nh).

    If no holder joint is swept, T_before is the whole transform and the axis is arbitrary.
    """
    r = len(held)
    holder = cell.holder
    if swept >= len(holder):
        return holder.poses(held), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.tile(np.eye(4), (r, 1, 1))
    first = Chain(holder.names[:swept], holder.placements[:swept], holder.axes[:swept], holder.placements[swept])
    rest = Chain(holder.names[swept + 1 :], holder.placements[swept + 1 :], holder.axes[swept + 1 :], holder.T_last_tip)
    return first.poses(held[:, :swept]), holder.axes[swept], rest.poses(held[:, swept + 1 :])


# ----------------------------------------------------------------------------------------------------
# Angles, poses, Jacobians and clearance of one posture.


@inner_njit
def room_for_poses(na, nh, branches):
    """Scratch for a thread, for an arm with na joints and a number of branches, and a holder with nh joints."""
    return PoseRoom(
        np.empty((3, 3)), np.empty((4, 4)), np.empty((4, 4)),
        np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.array((0.0, 0.0, 1.0)),
        np.empty((branches, na)), np.empty(branches, dtype=np.bool_),
        np.empty((na, 3)), np.empty((na, 3)), np.empty((6, na)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6)),
        np.empty((1, na + nh)),
    )  # fmt: skip


@inner_njit
def nearest_turn(angle: float, middle: float) -> float:
    """The angle, with the whole turns added that bring it closest to the middle of a joint's range."""
    away = angle - middle
    return middle + away - 2.0 * np.pi * np.rint(away / (2.0 * np.pi))


@inner_njit
def nearest_turns(q, middle, q_min, q_max, turns) -> float:
    """Apply `nearest_turn` to all joints of q (na) that turn; returns the least distance [rad, m] from a range's end,
    negative beyond it."""
    room = np.inf
    for j in range(q.size):
        if turns[j]:
            q[j] = nearest_turn(q[j], middle[j])
        room = min(room, min(q[j] - q_min[j], q_max[j] - q[j]))
    return room


@inner_njit
def angle_in_range(swept, angle: float):
    """An angle of the swept joint [rad], turned into its range, and whether it keeps room from the ends; for a joint
    that slides, its place [m]."""
    if swept.slides:
        place = swept.zero + swept.unit * angle
        return place, not min(place - swept.low, swept.high - place) < swept.room
    if swept.sweeps == 0 or not swept.high - swept.low < 2.0 * np.pi:
        return angle, True
    turned = nearest_turn(angle, 0.5 * (swept.low + swept.high))
    return turned, not min(turned - swept.low, swept.high - turned) < swept.room


@inner_njit
def part_pose(swept, r: int, angle: float, room) -> None:
    """Fill the poses of part and task in the world, at rung r and an angle [rad] of the swept joint."""
    turns = swept.sweeps == 1 and not swept.slides
    rotate_about(swept.axis, angle if turns else 0.0, room.R)
    turn(swept.T_before[r], room.R, room.T_held)
    if swept.sweeps == 1 and swept.slides:
        for i in range(3):
            for j in range(3):
                room.T_held[i, 3] += room.T_held[i, j] * swept.axis[3 + j] * angle
    mul4(room.T_held, swept.T_after[r], room.T_world_part)
    mul4(room.T_world_part, room.T_part_task, room.T_world_task)


@inner_njit
def lean_nozzle(T_world_task, share: float, R, T_rolled) -> None:
    """Turn a task's pose about its tip so that its z leans from straight down by a share of what it did, see `leaned`.

    R (3, 3) and T_rolled (4, 4) are scratch.
    """
    x, y, z = T_world_task[0, 2], T_world_task[1, 2], T_world_task[2, 2]
    level = np.sqrt(x * x + y * y)
    if share == 1.0 or level < 1e-12:
        return
    angle = (1.0 - share) * np.arctan2(level, -z)
    rotate_about(np.array((-y / level, x / level, 0.0)), angle, R)
    for a in range(3):
        for b in range(3):
            T_rolled[a, b] = R[a, 0] * T_world_task[0, b] + R[a, 1] * T_world_task[1, b] + R[a, 2] * T_world_task[2, b]
    for a in range(3):
        for b in range(3):
            T_world_task[a, b] = T_rolled[a, b]


@inner_njit
def flange_pose(
    T_base_world, T_nozzle_flange, T_world_task, z_axis, roll: float, R, T_rolled, T_base_nozzle, T_base_flange
) -> None:
    """Fill the poses of nozzle and flange in the arm's base, at a roll [rad] of the nozzle about the task's axis."""
    rotate_about(z_axis, roll, R)
    turn(T_world_task, R, T_rolled)
    mul4(T_base_world, T_rolled, T_base_nozzle)
    mul4(T_base_nozzle, T_nozzle_flange, T_base_flange)


@inner_njit
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


@inner_njit
def inverse_in_part(origins, directions, solved, T_world_part, T_world_task, J, Jp, Ji) -> bool:
    """Fill Ji (6, 6) with the rates of the joints `solved` for twists in the part frame; False if singular to rounding.

    The twists are those of the tip of a chain whose joints have origins and directions (na, 3). J (6, na) and Jp (6, 6)
    are scratch.
    """
    jacobian_at(origins, directions, T_world_task[:3, 3], J)
    into_part(J, solved, T_world_part, Jp)
    return invert6(Jp, Ji)


@inner_njit
def lacks_clearance(table, bodies, posture, q, now: float, head, roll: int) -> bool:
    """Whether a posture, with the arm's joints set to q (na), lacks clearance at a time of the print [beads].

    head (rolls): whether the head lacks clearance from the part, which depends on roll only; filled in where it is not
    known yet, -1.
    """
    for j in range(q.size):
        posture[0, j] = q[j]
    if head[roll] < 0:
        head[roll] = 1 if head_lacking(table, bodies, posture, FIRST, now) >= 0 else 0
    return head[roll] != 0 or first_lacking(table, bodies, posture, FIRST, now, CLEAR_ROOM, NO) >= 0
