"""What the joints of a trajectory really do, against Pinocchio asked for one posture and one frame at a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from solved import small_plan

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.problem import load_problem
from planner.verify.executed import _determinant, executed_motion, joint_poses

ON_BED = """\
name: any
cell:
  arm: {arm}
  nozzle: {{tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}}
  home_deg: [{home}]
  bed_mm: [450, 0, 150]
layers: {{source: {{waypoints: any.txt}}}}
process: {{speed_mm_s: 40, travel_speed_mm_s: 200, bead: {{width_mm: 0.6, height_mm: 0.5}}}}
"""


def on_bed(arm: str, joints: int, folder: Path) -> Cell:
    file = folder / "any.yaml"
    file.write_text(ON_BED.format(arm=arm, home=", ".join(["0"] * joints)))
    return build_cell(load_problem(file))


@pytest.mark.parametrize("arm, joints", [("irb140", 6), ("ur5e", 6), ("iiwa", 7)])
def test_motion_is_that_of_each_posture_by_itself_on_a_bed(arm: str, joints: int, tmp_path: Path) -> None:
    check(on_bed(arm, joints, tmp_path))


def test_motion_is_that_of_each_posture_by_itself_on_a_table() -> None:
    check(small_plan().cell)


def check(cell: Cell) -> None:
    """Tip, rotation, up, least singular value and determinant at postures all over the joints' ranges."""
    t = small_plan().trajectory
    limits = cell.limits
    low, high = np.maximum(limits.q_min, -np.pi), np.minimum(limits.q_max, np.pi)
    q = np.random.default_rng(5).uniform(low, high, (len(t), len(low)))
    motion = executed_motion(cell, replace(t, q=q))
    for i in range(0, len(t), max(len(t) // 40, 1)):
        T_world_nozzle, J = of_nozzle(cell, q[i])
        T = np.linalg.inv(of_part(cell, q[i])) @ T_world_nozzle
        np.testing.assert_allclose(motion.tip[i], T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(motion.rotation[i], T[:3, :3], atol=1e-12)
        np.testing.assert_allclose(motion.axis[i], T[:3, 2], atol=1e-12)
        np.testing.assert_allclose(motion.up[i], np.linalg.inv(of_part(cell, q[i]))[:3, 2], atol=1e-12)
        np.testing.assert_allclose(motion.det[i], np.linalg.det(J[:, list(cell.solved)]), atol=1e-12)
        sigma = np.linalg.svd(J, compute_uv=False)[-1] if t.deposit[i] else np.nan
        np.testing.assert_allclose(motion.sigma[i], sigma, atol=1e-12)


def of_nozzle(cell: Cell, q: Array) -> tuple[Array, Array]:
    """The nozzle's pose in the world and the arm's Jacobian at its tip, in the arm's base: by a frame of Pinocchio's."""
    model = cell.arm_robot.model.copy()
    flange = model.frames[model.getFrameId(cell.arm_robot.tip)]
    placement = flange.placement * pin.SE3(cell.T_flange_nozzle)
    nozzle = model.addFrame(pin.Frame("nozzle", flange.parentJoint, placement, pin.FrameType.OP_FRAME))
    data, arm = model.createData(), np.ascontiguousarray(q[: model.nq])
    J = pin.computeFrameJacobian(model, data, arm, nozzle, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return cell.T_world_base @ pin.updateFramePlacement(model, data, nozzle).homogeneous, J


def of_part(cell: Cell, q: Array) -> Array:
    """The part's pose in the world."""
    robot = cell.holder_robot
    if robot is None:
        return cell.T_world_holder
    angles = dict(cell.held) | dict(zip(cell.holder.names, q[len(cell.arm) :], strict=True))
    data = robot.model.createData()
    turned = np.array([angles.get(name, 0.0) for name in robot.model.names[1:]])
    pin.framesForwardKinematics(robot.model, data, turned)
    tip = data.oMf[robot.model.getFrameId(robot.tip)].homogeneous
    return np.asarray(cell.T_world_holder_base @ tip @ cell.T_plate_part)


def test_poses_of_all_joints_are_those_that_pinocchio_tells_one_by_one() -> None:
    model = small_plan().cell.arm_robot.model
    q = np.random.default_rng(6).uniform(-3.0, 3.0, (20, model.nq))
    found, data = joint_poses(model, q), model.createData()
    for i, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        for k in range(1, model.njoints):
            np.testing.assert_array_equal(found[i, k - 1], data.oMi[k].homogeneous)


@given(arrays(float, (6, 6), elements=st.floats(-4.0, 4.0, width=16)))
def test_determinant(matrix: Array) -> None:
    assert _determinant(matrix.copy()) == pytest.approx(np.linalg.det(matrix), rel=1e-9, abs=1e-9)
