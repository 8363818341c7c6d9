"""Tesseract's Descartes: a ladder of postures at sampled rolls (and table angles), and TrajOpt from what it finds.

Options: the roll's and the table's step in degrees, then `trajopt` if that is to follow.
"""

from __future__ import annotations

import os
import sys

import tesseract_robotics  # noqa: F401  before numpy, for it brings the libstdc++ that both can use

# isort: split
import numpy as np
from numpy.typing import NDArray
from side import Case, Plan, main
from tesseract_robotics.tesseract_command_language import (
    CartesianWaypoint,
    CartesianWaypointPoly_wrap_CartesianWaypoint,
    CompositeInstruction,
    InstructionPoly_as_MoveInstructionPoly,
    MoveInstruction,
    MoveInstructionPoly_wrap_MoveInstruction,
    MoveInstructionType_LINEAR,
    ProfileDictionary,
    WaypointPoly_as_StateWaypointPoly,
)
from tesseract_robotics.tesseract_common import FilesystemPath, GeneralResourceLocator, Isometry3d, ManipulatorInfo
from tesseract_robotics.tesseract_environment import Environment
from tesseract_robotics.tesseract_motion_planners import PlannerRequest
from tesseract_robotics.tesseract_motion_planners_descartes import (
    DescartesDefaultMoveProfileD,
    DescartesLadderGraphSolverProfileD,
    DescartesMotionPlannerD,
)
from tesseract_robotics.tesseract_motion_planners_trajopt import (
    TrajOptDefaultCompositeProfile,
    TrajOptDefaultPlanProfile,
    TrajOptMotionPlanner,
    TrajOptOSQPSolverProfile,
)

Array = NDArray[np.float64]
DESCARTES = "DescartesMotionPlannerTask"
TRAJOPT = "TrajOptMotionPlannerTask"
THREADS = len(os.sched_getaffinity(0))
HOLD = 10.0  # weight of the pose's constraint, position and two angles; the third, roll, is free
ITERATIONS = 100
TABLE = np.pi  # rad: the table is sampled within so much either way, whatever its range
REACH = 5.0  # m: no arm here reaches farther


def semantics(case: Case, table: float) -> str:
    """Write the kinematics' plugins beside the URDF; returns the text of the SRDF."""
    opw = ", ".join(f"{name}: {value!r}" for name, value in (case.opw or {}).items())
    arm = f"""class: OPWInvKinFactory
          config:
            base_link: base
            tip_link: flange
            params: {{{opw}, offsets: [0, 0, -1.5707963267948966, 0, 0, 0], sign_corrections: [1, 1, 1, 1, 1, 1]}}"""
    head = """kinematic_plugins:
  search_libraries: [tesseract_kinematics_kdl_factories, tesseract_kinematics_opw_factories]
"""
    chain = "class: KDLFwdKinChainFactory"
    if len(case.joints) == case.arm_joints:
        text = f"""{head}  fwd_kin_plugins:
    manipulator:
      default: Fwd
      plugins:
        Fwd: {{{chain}, config: {{base_link: base, tip_link: flange}}}}
  inv_kin_plugins:
    manipulator:
      default: Inv
      plugins:
        Inv:
          {arm}
"""
        group = '<group name="manipulator"><chain base_link="base" tip_link="flange"/></group>'
    else:
        joints = case.joints[case.arm_joints :]
        low_ends = np.maximum(case.q_min[case.arm_joints :], -TABLE).tolist()
        high_ends = np.minimum(case.q_max[case.arm_joints :], TABLE).tolist()
        samples = "".join(
            f"\n              - {{name: {name}, value: {table!r}, min: {low!r}, max: {high!r}}}"
            for name, low, high in zip(joints, low_ends, high_ends, strict=True)
        )
        deeper = arm.replace("\n", "\n    ")
        text = f"""{head}  inv_kin_plugins:
    manipulator:
      default: Inv
      plugins:
        Inv:
          class: REPInvKinFactory
          config:
            manipulator_reach: {REACH}
            positioner_sample_resolution:{samples}
            positioner: {{{chain}, config: {{base_link: world, tip_link: part}}}}
            manipulator:
              {deeper}
"""
        names = "".join(f'<joint name="{name}"/>' for name in joints + case.joints[: case.arm_joints])
        group = f'<group name="manipulator">{names}</group>'
    plugins = case.folder / "plugins.yaml"
    plugins.write_text(text, encoding="utf-8")
    config = f'<kinematics_plugin_config filename="{plugins.resolve().as_uri()}"/>'
    return f'<robot name="case" version="1.0.0">{group}{config}</robot>'


def prepare(case: Case, options: list[str]) -> Plan:
    """The environment and the profiles."""
    roll, table = (float(np.radians(float(option))) for option in options[:2])
    follow = "trajopt" in options
    locator = GeneralResourceLocator()
    environment = Environment()
    srdf = case.folder / "robot.srdf"
    srdf.write_text(semantics(case, table), encoding="utf-8")
    if not environment.init(FilesystemPath(str(case.folder / "robot.urdf")), FilesystemPath(str(srdf)), locator):
        raise RuntimeError("the environment does not take the case's URDF and SRDF")
    kept.append(locator)
    info = ManipulatorInfo()
    info.manipulator, info.tcp_frame = "manipulator", "nozzle"
    info.working_frame = "part"
    group = environment.getKinematicGroup("manipulator")
    names = list(group.getJointNames())
    order = [names.index(name) for name in case.joints]

    move = DescartesDefaultMoveProfileD()
    move.target_pose_fixed = False
    move.target_pose_sample_axis = np.array([0.0, 0.0, 1.0])
    move.target_pose_sample_resolution = roll
    move.target_pose_sample_min, move.target_pose_sample_max = -np.pi, np.pi - roll
    move.allow_collision = True
    move.enable_collision = move.enable_edge_collision = False
    solver = DescartesLadderGraphSolverProfileD()
    solver.num_threads = THREADS
    profiles = ProfileDictionary()
    profiles.addProfile(DESCARTES, "DEFAULT", move)
    profiles.addProfile(DESCARTES, "DEFAULT", solver)

    plan_profile = TrajOptDefaultPlanProfile()
    plan_profile.joint_cost_config.enabled = plan_profile.joint_constraint_config.enabled = False
    plan_profile.cartesian_cost_config.enabled = False
    plan_profile.cartesian_constraint_config.enabled = True
    plan_profile.cartesian_constraint_config.coeff = np.array([HOLD, HOLD, HOLD, HOLD, HOLD, 0.0])
    composite = TrajOptDefaultCompositeProfile()
    composite.collision_cost_config.enabled = composite.collision_constraint_config.enabled = False
    composite.smooth_velocities = composite.smooth_accelerations = composite.smooth_jerks = True
    composite.velocity_coeff = composite.acceleration_coeff = composite.jerk_coeff = np.ones(len(names))
    optimiser = TrajOptOSQPSolverProfile()
    optimiser.opt_params.max_iter = ITERATIONS
    for profile in (plan_profile, composite, optimiser):
        profiles.addProfile(TRAJOPT, "DEFAULT", profile)

    def bead_plan(poses: Array) -> tuple[Array, str]:
        program = CompositeInstruction("DEFAULT")
        program.setManipulatorInfo(info)
        for pose in poses:
            waypoint = CartesianWaypointPoly_wrap_CartesianWaypoint(CartesianWaypoint(Isometry3d(pose)))
            move = MoveInstruction(waypoint, MoveInstructionType_LINEAR, "DEFAULT")
            program.appendMoveInstruction(MoveInstructionPoly_wrap_MoveInstruction(move))
        request = PlannerRequest()
        request.instructions, request.env, request.profiles = program, environment, profiles
        request.format_result_as_input = follow
        response = DescartesMotionPlannerD(DESCARTES).solve(request)
        said = "" if response.successful else response.message or "no solution"
        if follow and not said:
            request.instructions, request.format_result_as_input = response.results, False
            response = TrajOptMotionPlanner(TRAJOPT).solve(request)
            said = "" if response.successful else response.message or "no convergence"
        if said and not (follow and len(response.results.getInstructions()) == len(poses)):
            return np.empty((0, len(names))), said
        q = np.array([positions(each) for each in response.results.getInstructions()])
        return q[:, order], said

    def plan(beads: list[Array]) -> tuple[list[Array], str]:
        out, sayings = [], []
        for i, poses in enumerate(beads):
            q, said = bead_plan(poses)
            sayings += [f"bead {i}: {said}"] if said else []
            if len(q) < len(poses):
                return [], sayings[-1]
            out.append(q)
        return out, "; ".join(sayings[:1])

    return plan


kept: list[object] = []  # the environment does not keep its resource locator alive


def positions(instruction: object) -> Array:
    """Joints (nj) of a planned instruction, in the group's order."""
    waypoint = InstructionPoly_as_MoveInstructionPoly(instruction).getWaypoint()
    return np.asarray(WaypointPoly_as_StateWaypointPoly(waypoint).getPosition()).ravel()


if __name__ == "__main__":
    sys.exit(main("tesseract-robotics-nanobind", prepare))
