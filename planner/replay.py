"""What the joints of a trajectory really do: Pinocchio on q(t), from the robots' own URDF models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.background import in_halves, shared
from planner.cell import Cell, Robot
from planner.least_singular import least_singular_values
from planner.plan import Trajectory

Array = NDArray[np.float64]
UNKNOWN = -1  # branch that is numbered by no convention but that of the inverse kinematics itself
BLOCK = 8192  # samples at once: bounds the memory, since a Jacobian takes more than all that is kept of a sample


@dataclass(frozen=True)
class Motion:
    """The samples of a trajectory as its joints have them (n samples).

    tip, axis (n, 3) and rotation (n, 3, 3) of the nozzle in the part frame, where up (n, 3) is the world's
    vertical; of the arm's Jacobian at the tip the
    smallest singular value sigma (NaN in travel, where no limit stands on it) and the determinant, of seven axes
    without the redundant one; branch (n), ABB's cfx, or UNKNOWN without a spherical wrist
    """

    tip: Array
    axis: Array
    rotation: Array
    up: Array
    sigma: Array
    det: Array
    branch: NDArray[np.int8]


def replay(cell: Cell, trajectory: Trajectory, second_process: bool = False) -> Motion:
    """Forward kinematics and Jacobians of every sample, half of them in a second process if that is wanted."""
    n = len(trajectory)
    vector = (n, 3)
    rotation = shared((n, 3, 3))
    whole = Motion(
        tip=shared(vector),
        axis=rotation[:, :, 2],
        rotation=rotation,
        up=shared(vector),
        sigma=shared((n,)),
        det=shared((n,)),
        branch=shared((n,), np.int8),
    )

    def fill(first: int, last: int) -> None:
        for start in range(first, last, BLOCK):
            rows = slice(start, min(start + BLOCK, last))
            block = _replay(cell, np.ascontiguousarray(trajectory.q[rows]), trajectory.deposit[rows])
            for name, values in vars(block).items():
                getattr(whole, name)[rows] = values

    in_halves(fill, n, second_process)
    return whole


def _replay(cell: Cell, q: Array, deposit: NDArray[np.bool_]) -> Motion:
    """The same of postures q (n, nj)."""
    arm, na = cell.arm_robot, len(cell.arm)
    T_base_nozzle, J = _nozzle(arm, cell.T_flange_nozzle, q[:, :na])
    T_world_nozzle = cell.T_world_base @ T_base_nozzle
    T_world_part = _part(cell, q[:, na:])
    R_part_world = np.swapaxes(T_world_part[:, :3, :3], 1, 2)
    tip = np.einsum("nij,nj->ni", R_part_world, T_world_nozzle[:, :3, 3] - T_world_part[:, :3, 3])
    rotation = R_part_world @ T_world_nozzle[:, :3, :3]
    sigma = np.full(len(q), np.nan)
    sigma[deposit] = least_singular_values(J[deposit])
    det = np.linalg.det(J[:, :, list(cell.solved)])
    branch = np.full(len(q), UNKNOWN, dtype=np.int8)
    if cell.spherical:
        branch = _branch(arm, T_base_nozzle @ np.linalg.inv(cell.T_flange_nozzle), q[:, :na], det)
    return Motion(tip, rotation[:, :, 2], rotation, R_part_world[:, :, 2], sigma, det, branch)


def _branch(arm: Robot, T_base_flange: Array, q: Array, det: Array) -> NDArray[np.int8]:
    """ABB's cfx (n): 4 wrist centre behind axis 1, 2 behind the lower arm, 1 axis 5 negative.

    The sign of the Jacobian's determinant changes with each of the three: the second one follows from the others.
    """
    model, data = arm.model, arm.model.createData()
    flange = model.getFrameId(arm.tip)

    def wrist_to_flange(posture: Array) -> tuple[float, float]:
        J = pin.computeFrameJacobian(model, data, posture, flange, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacement(model, data, flange)
        return float(np.linalg.norm(data.oMf[flange].translation - data.oMi[5].translation)), float(np.linalg.det(J))

    # forearm horizontal forwards, axis 5 bent: no bit is set here
    length, reference = wrist_to_flange(np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.0]))
    centre = T_base_flange[:, :3, 3] - length * T_base_flange[:, :3, 2]
    shoulder = centre[:, 0] * np.cos(q[:, 0]) + centre[:, 1] * np.sin(q[:, 0]) < 0.0
    wrist = np.sin(q[:, 4]) < 0.0
    elbow = (det * reference < 0.0) ^ shoulder ^ wrist
    return (4 * shoulder + 2 * elbow + wrist).astype(np.int8)


def _nozzle(arm: Robot, T_flange_nozzle: Array, q: Array) -> tuple[Array, Array]:
    """Nozzle poses in the arm's base (n, 4, 4) and Jacobians at the nozzle tip (n, 6, na), world axes."""
    model = arm.model.copy()
    flange = model.frames[model.getFrameId(arm.tip)]
    placement = flange.placement * pin.SE3(T_flange_nozzle)
    nozzle = model.addFrame(pin.Frame("nozzle", flange.parentJoint, placement, pin.FrameType.OP_FRAME))
    data = model.createData()
    jacobian, pose, axes = pin.computeFrameJacobian, pin.updateFramePlacement, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    T = np.empty((len(q), 4, 4))
    J = np.empty((len(q), 6, model.nv))
    for i, row in enumerate(q):
        J[i] = jacobian(model, data, row, nozzle, axes)
        T[i] = pose(model, data, nozzle).homogeneous
    return T, J


def _part(cell: Cell, q_free: Array) -> Array:
    """Part poses in the world (n, 4, 4), from the holder's URDF model with its held axes at their angles."""
    if cell.holder_robot is None:
        return np.broadcast_to(cell.T_world_holder, (len(q_free), 4, 4))
    model = cell.holder_robot.model
    names = list(model.names[1:])
    free = [names.index(name) for name in cell.holder.names]
    turned = np.append(True, (np.diff(q_free, axis=0) != 0.0).any(axis=1))  # a table often rests
    held = np.array([cell.held.get(name, 0.0) for name in names])
    q = np.tile(held, (int(np.count_nonzero(turned)), 1))
    q[:, free] = q_free[turned]
    tip = model.frames[model.getFrameId(cell.holder_robot.tip)]
    T = joint_poses(model, q)[:, tip.parentJoint - 1] @ tip.placement.homogeneous
    return (cell.T_world_holder_base @ T @ cell.T_plate_part)[np.cumsum(turned) - 1]


def joint_poses(model: pin.Model, q: Array) -> Array:
    """Poses (n, joints, 4, 4) of all joints after their turns, in the frame of the robot's base, at postures q (n, nq).

    Pinocchio keeps them one behind the other, so that one view reads them all: each by itself takes far longer to ask for
    than to compute.
    """
    data, n = model.createData(), model.njoints - 1
    placed = [data.oMi[k] for k in range(1, n + 1)]
    R, p = _one_view([each.rotation for each in placed]), _one_view([each.translation for each in placed])
    T = np.zeros((len(q), n, 4, 4))
    T[..., 3, 3] = 1.0
    turn, shift = T[..., :3, :3], T[..., :3, 3]
    for i, row in enumerate(np.ascontiguousarray(q)):
        pin.forwardKinematics(model, data, row)
        turn[i], shift[i] = R, p
    return T


def _one_view(arrays: list[Array]) -> Array:
    """Arrays of one shape that lie at even distances in memory, seen as one (n, ...) that changes as they do."""
    address = [each.__array_interface__["data"][0] for each in arrays]
    steps = set(np.diff(address).tolist())
    if len(steps) > 1:
        raise ValueError("the arrays do not lie at even distances")
    shape, strides = (len(arrays), *arrays[0].shape), (*(steps or {0}), *arrays[0].strides)
    return np.lib.stride_tricks.as_strided(arrays[0], shape, strides, writeable=False)
