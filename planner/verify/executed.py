"""The motion that a trajectory's joints really execute: Pinocchio on q(t), with the robots' own URDF models."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.base.arrays import Array, read_only
from planner.base.compiled import inner_njit, njit
from planner.base.singular_values import least_singular_value
from planner.cell.cell import Cell
from planner.cell.robot import joint_axis
from planner.cell.urdf import link_frame
from planner.plan import Trajectory
from planner.plan.plan import by_nozzle

UNKNOWN = -1  # branch that no convention numbers but that of the inverse kinematics
_STRAIGHT = 1e-3  # sine of joint 5's angle where axes 4 and 6 are parallel: if smaller, it is taken as 0, as by makers
_PARALLEL = 0.02  # sine of the angle between axes that count as parallel
_MEETS = 5e-3  # m: axes of a measured wrist that ought to meet come at least this near
_AHEAD = 4  # most blocks waiting
BLOCK = 8192  # samples at once: bounds the memory, since a Jacobian takes more than all that is kept of a sample


@dataclass(frozen=True)
class ExecutedMotion:
    """The samples of a trajectory as its joints execute them (n samples).

    tip, axis (n, 3), rotation (n, 3, 3)   of the nozzle, in the part frame
    up (n, 3)      the world's vertical in the part frame
    sigma, det (n) smallest singular value (NaN in travel, where it has no limit) and determinant of the Jacobian at the
                   tip: of the arm alone where a rail carries it; det of seven axes without the redundant one
    branch (n)     ABB's cfx, or UNKNOWN without a spherical wrist
    """

    tip: Array
    axis: Array
    rotation: Array
    up: Array
    sigma: Array
    det: Array
    branch: NDArray[np.int8]

    def rows(self, rows: slice) -> ExecutedMotion:
        """Some samples of the motion, as views of its arrays."""
        return ExecutedMotion(**{name: values[rows] for name, values in vars(self).items()})


def executed_motion(cell: Cell, trajectory: Trajectory) -> ExecutedMotion:
    """Forward kinematics and Jacobians of every sample by Pinocchio; a second thread derives the rest from them."""
    n = len(trajectory)
    rotation = np.empty((n, 3, 3))
    whole = ExecutedMotion(
        tip=np.empty((n, 3)),
        axis=rotation[:, :, 2],
        rotation=rotation,
        up=np.empty((n, 3)),
        sigma=np.empty(n),
        det=np.empty(n),
        branch=np.full(n, UNKNOWN, dtype=np.int8),
    )
    with ThreadPoolExecutor(1) as pool:
        found = []
        for own, stretch in by_nozzle(cell, trajectory.events, trajectory.t):
            for start in range(stretch.start, stretch.stop, BLOCK):
                rows = slice(start, min(start + BLOCK, stretch.stop))
                q, block = np.ascontiguousarray(trajectory.q[rows]), whole.rows(rows)
                found.append(pool.submit(_fill, block, own, q, trajectory.deposit[rows], *_nozzle(own, q)))
                if len(found) > _AHEAD:  # waiting poses and Jacobians take far more memory than all results
                    found.pop(0).result()
        for each in found:
            each.result()
    return whole


def _fill(
    motion: ExecutedMotion, cell: Cell, q: Array, deposit: NDArray[np.bool_], T_base_nozzle: Array, J: Array
) -> None:
    """Fill in the motion of postures q (n, nj) from nozzle poses (n, 4, 4) and Jacobians (n, 6, na): see `_nozzle`."""
    T_world_part = read_only(_part(cell, q[:, len(cell.arm) :]))
    _judge(
        T_base_nozzle, J, deposit, cell.T_world_base, T_world_part, cell.rails, np.array(cell.solved),
        motion.tip, motion.rotation, motion.up, motion.sigma, motion.det,
    )  # fmt: skip
    if cell.spherical:
        T_base_flange = T_base_nozzle @ np.linalg.inv(cell.T_flange_nozzle)
        motion.branch[:] = _branch(cell, T_base_flange, q[:, : len(cell.arm)], motion.det)


@njit
def _judge(
    T_base_nozzle: Array, J: Array, deposit: NDArray[np.bool_], T_world_base: Array, T_world_part: Array, rails: int,
    solved: NDArray[np.int64], tip: Array, rotation: Array, up: Array, sigma: Array, det: Array,
) -> None:  # fmt: skip
    """Fill in the fields of `ExecutedMotion` except the branch."""
    na = J.shape[2] - rails
    A, square, q, e = np.empty((max(6, na), min(6, na))), np.empty((6, 6)), np.empty(min(6, na)), np.empty(min(6, na))
    R, p = np.empty((3, 3)), np.empty(3)
    for i in range(len(J)):
        for a in range(3):
            p[a] = T_world_base[a, 3] - T_world_part[i, a, 3]
            for b in range(3):
                p[a] += T_world_base[a, b] * T_base_nozzle[i, b, 3]
                R[a, b] = 0.0
                for c in range(3):
                    R[a, b] += T_world_base[a, c] * T_base_nozzle[i, c, b]
        for a in range(3):
            tip[i, a], up[i, a] = 0.0, T_world_part[i, 2, a]
            for b in range(3):
                tip[i, a] += T_world_part[i, b, a] * p[b]
                rotation[i, a, b] = 0.0
                for c in range(3):
                    rotation[i, a, b] += T_world_part[i, c, a] * R[c, b]
        sigma[i] = np.nan
        if deposit[i]:
            for a in range(6):
                for b in range(na):
                    A[(b, a) if na > 6 else (a, b)] = J[i, a, rails + b]
            sigma[i] = least_singular_value(A, q, e)
        for a in range(6):
            for b in range(6):
                square[a, b] = J[i, a, solved[b]]
        det[i] = _determinant(square)


@inner_njit
def _determinant(A: Array) -> float:
    """Determinant of a square matrix, which is overwritten: elimination with partial pivoting."""
    n, out = len(A), 1.0
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if A[pivot, k] == 0.0:
            return 0.0
        if pivot != k:
            out = -out
            for j in range(k, n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
        out *= A[k, k]
        for i in range(k + 1, n):
            share = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= share * A[k, j]
    return out


def _branch(cell: Cell, T_base_flange: Array, q: Array, det: Array) -> NDArray[np.int8]:
    """ABB's cfx (n): 4 wrist centre behind axis 1, 2 behind the lower arm, 1 axis 5 negative.

    The sign of the Jacobian's determinant changes with each of the three, so the second follows from it and the others.
    """
    arm, k = cell.arm_robot, cell.rails
    model, data = arm.model, arm.model.createData()
    flange = link_frame(model, arm.tip)

    def wrist_to_flange(posture: Array) -> tuple[float, float]:
        J = pin.computeFrameJacobian(model, data, posture, flange, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:, k:]
        pin.updateFramePlacement(model, data, flange)
        wrist = _crossing(data.oMi[6 + k], joint_axis(model, 6 + k)[:3], data.oMi[5 + k], joint_axis(model, 5 + k)[:3])
        return float(np.linalg.norm(data.oMf[flange].translation - wrist)), float(np.linalg.det(J))

    # forearm horizontal and forward, axis 5 bent: no bit is set here
    length, reference = wrist_to_flange(np.array([0.0] * k + [0.0, 0.0, 0.0, 0.0, 0.5, 0.0]))
    centre = T_base_flange[:, :3, 3] - length * T_base_flange[:, :3, 2]
    if k:
        centre = _from_first_axis(model, q[:, :k], centre)
    shoulder = centre[:, 0] * np.cos(q[:, k]) + centre[:, 1] * np.sin(q[:, k]) < 0.0
    wrist = np.sin(q[:, 4 + k]) < 0.0
    elbow = (det * reference < 0.0) ^ shoulder ^ wrist
    return (4 * shoulder + 2 * elbow + wrist).astype(np.int8)


def _crossing(one: pin.SE3, its_axis: Array, other: pin.SE3, other_axis: Array) -> Array:
    """The point (3) on one joint's axis nearest to another's; axes (3) are in the joints' own frames."""
    u, v = one.rotation @ its_axis, other.rotation @ other_axis
    away = other.translation - one.translation
    across = u @ v
    out: Array = one.translation + (away @ u - across * (away @ v)) / (1.0 - across * across) * u
    return out


def straight_at(cell: Cell) -> float:
    """Angle [rad] of joint 5 of six at which axes 4 and 6 are parallel, as half a turn from there; 0 if almost 0."""
    model, k = cell.arm_robot.model, cell.rails
    J = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))
    fourth, fifth, sixth = J[3:, k + 3 : k + 6].T
    angle = float(np.arctan2(np.cross(fourth, sixth) @ fifth, fourth @ sixth))
    return -angle if abs(np.sin(angle)) > _STRAIGHT else 0.0


def wrist_straightens(cell: Cell) -> bool:
    """Whether a six-axis arm is singular where axes 4 and 6 are parallel: all three axes of its wrist meet, or axis 4 is
    parallel to axis 3. Where axis 6 misses the intersection of axes 4 and 5, it is not."""
    model, k = cell.arm_robot.model, cell.rails
    data = model.createData()
    J = pin.computeJointJacobians(model, data, pin.neutral(model))
    third, fourth = J[3:, k + 2 : k + 4].T
    if np.linalg.norm(np.cross(third, fourth)) < _PARALLEL:
        return True
    meeting = _crossing(data.oMi[4 + k], joint_axis(model, 4 + k)[:3], data.oMi[5 + k], joint_axis(model, 5 + k)[:3])
    sixth = data.oMi[6 + k]
    away = meeting - sixth.translation
    return bool(np.linalg.norm(np.cross(away, sixth.rotation @ joint_axis(model, 6 + k)[:3])) < _MEETS)


def _from_first_axis(model: pin.Model, rail: Array, places: Array) -> Array:
    """Places (n, 3) in the frame of the arm's first own joint at 0; rail (n, k): positions of the joints before it."""
    data, out = model.createData(), np.empty_like(places)
    q = pin.neutral(model)
    for i, at in enumerate(rail):
        q[: len(at)] = at
        pin.forwardKinematics(model, data, q)
        out[i] = data.oMi[1 + len(at)].actInv(places[i])
    return out


def _nozzle(cell: Cell, q: Array) -> tuple[Array, Array]:
    """Nozzle poses (n, 4, 4) and Jacobians at the nozzle tip (n, 6, na) in the arm's base, at postures q (n, nj)."""
    arm, model = cell.arm_robot, cell.arm_robot.model
    data = model.createData()
    flange = model.frames[link_frame(model, arm.tip)]
    last, turning = _pose_memory([data.oMi[flange.parentJoint]]), data.J.T.reshape(-1)
    poses, J = np.empty((len(q), 12)), np.empty((len(q), model.nv * 6))
    jacobians = pin.computeJointJacobians  # at the base's origin, for a point that moves with the last joint
    for i, row in enumerate(np.ascontiguousarray(q[:, : model.nq])):
        jacobians(model, data, row)
        poses[i], J[i] = last, turning
    T = _matrices(poses) @ (flange.placement.homogeneous @ cell.T_flange_nozzle)
    J = np.swapaxes(J.reshape(len(q), model.nv, 6), 1, 2)
    _shift(J, np.ascontiguousarray(T[:, :3, 3]))
    return T, J


@njit
def _shift(J: Array, p: Array) -> None:
    """Shift Jacobians J (n, 6, nv) in place from the origin to points p (n, 3) of the same body."""
    for i in range(len(J)):
        x, y, z = p[i, 0], p[i, 1], p[i, 2]
        for k in range(J.shape[2]):
            J[i, 0, k] += J[i, 4, k] * z - J[i, 5, k] * y
            J[i, 1, k] += J[i, 5, k] * x - J[i, 3, k] * z
            J[i, 2, k] += J[i, 3, k] * y - J[i, 4, k] * x


def _part(cell: Cell, q_free: Array) -> Array:
    """Part poses in the world (n, 4, 4), from the holder's URDF model with its held axes at their angles."""
    if cell.holder_robot is None:
        return np.broadcast_to(cell.T_world_holder, (len(q_free), 4, 4))
    model = cell.holder_robot.model
    names = list(model.names[1:])
    free = [names.index(name) for name in cell.holder.names]
    turned = np.append(True, (np.diff(q_free, axis=0) != 0.0).any(axis=1))  # a positioner often rests
    held = np.array([cell.held.get(name, 0.0) for name in names])
    q = np.tile(held, (int(np.count_nonzero(turned)), 1))
    q[:, free] = q_free[turned]
    tip = model.frames[link_frame(model, cell.holder_robot.tip)]
    T = joint_poses(model, q)[:, tip.parentJoint - 1] @ tip.placement.homogeneous
    return (cell.T_world_holder_base @ T @ cell.T_plate_part)[np.cumsum(turned) - 1]


def joint_poses(model: pin.Model, q: Array) -> Array:
    """Poses (n, joints, 4, 4) of all joints, moved by their angles, in the robot's base frame at postures q (n, nq)."""
    data, n = model.createData(), model.njoints - 1
    placed = _pose_memory([data.oMi[k] for k in range(1, n + 1)])
    poses = np.empty((len(q), 12 * n))
    forward = pin.forwardKinematics
    for i, row in enumerate(np.ascontiguousarray(q)):
        forward(model, data, row)
        poses[i] = placed
    return _matrices(poses.reshape(len(q), n, 12))


def _pose_memory(poses: list[pin.SE3]) -> Array:
    """A flat view of poses that Pinocchio keeps contiguous in memory; it changes as they do.

    For each pose its rotation, column by column, then its translation; see `_matrices`. Reading poses one by one takes
    far longer than computing them, and a flat view is copied far faster than one of matrices.
    """
    address = [array.__array_interface__["data"][0] for each in poses for array in (each.rotation, each.translation)]
    first = poses[0].rotation
    wanted = address[0] + first.itemsize * np.cumsum([0, *(9, 3) * len(poses)])[:-1]
    if first.strides != (first.itemsize, 3 * first.itemsize) or not np.array_equal(address, wanted):
        raise ValueError("the poses are not contiguous in memory")
    return np.lib.stride_tricks.as_strided(first, (12 * len(poses),), (first.itemsize,), writeable=False)


def _matrices(poses: Array) -> Array:
    """Poses (..., 4, 4) from 12 numbers each (..., 12): a rotation column by column, and a translation."""
    T = np.zeros((*poses.shape[:-1], 4, 4))
    T[..., :3, :] = np.swapaxes(poses.reshape(*poses.shape[:-1], 4, 3), -1, -2)
    T[..., 3, 3] = 1.0
    return T
