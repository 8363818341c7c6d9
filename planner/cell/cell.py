"""The robot cell: arm, positioner, nozzle, limits and where everything stands, from robots/*.yaml and URDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from planner.base.arrays import Array
from planner.base.errors import Refusal, nearest_name
from planner.cell.bodies import fixture_bodies, head_bodies
from planner.cell.kinematics.chain import Chain
from planner.cell.kinematics.inverse import InverseKinematics, with_rest
from planner.cell.kinematics.spherical_wrist import SphericalWrist
from planner.cell.robot import Robot, chain_of, load_robot
from planner.cell.solids import Body
from planner.problem import Problem
from planner.problem.cell import CellSpec, PositionerSpec

_ROUNDING = 1e-9  # rad: an angle at the end of its range is inside, though degrees became radians


@dataclass(frozen=True)
class Limits:
    """Joint limits (n) in the cell's joint order: rad, rad/s, rad/s^2, rad/s^3."""

    q_min: Array
    q_max: Array
    velocity: Array
    acceleration: Array
    jerk: Array


@dataclass(frozen=True)
class Cell:
    """Arm with nozzle, and whatever holds the part.

    arm        chain from the world to the nozzle frame (z = nozzle axis)
    holder     chain from the world to the part frame; only the free axes, none for a fixed bed
    limits     of the arm's joints, then the holder's
    inverse    closed-form inverse kinematics of the arm, base to flange
    T_world_base, T_flange_nozzle   what stands at the two ends of `inverse`
    T_world_holder                  the part frame with the holder's free axes at 0
    T_world_holder_base, T_plate_part   what stands at the two ends of the holder: its base, the part on its plate
    head       bodies of nozzle and print head, in the nozzle frame; the robots' own bodies are theirs
    fixtures   bodies that stand in the world frame; carried: those that turn with the part, in its frame
    home       (n) start posture, arm then holder
    arm_robot, holder_robot, held   the robots' own models, for whoever wants to check independently
    """

    arm: Chain
    holder: Chain
    limits: Limits
    inverse: InverseKinematics
    T_world_base: Array
    T_flange_nozzle: Array
    T_world_holder: Array
    home: Array
    arm_robot: Robot
    holder_robot: Robot | None
    held: dict[str, float]
    T_world_holder_base: Array
    T_plate_part: Array
    head: tuple[Body, ...]
    fixtures: tuple[Body, ...]
    carried: tuple[Body, ...]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in joint order: arm, then holder; a holder's joint named as one of the arm's is `positioner_<name>`."""
        return _joint_names(self.arm, self.holder)

    @property
    def chosen(self) -> tuple[int, ...]:
        """Joints (indices) whose angles are chosen, not solved for: the holder's, then the arm's redundant one."""
        na, redundant = len(self.arm), self.inverse.redundant_joint
        return (*range(na, na + len(self.holder)), *(() if redundant is None else (redundant,)))

    @property
    def solved(self) -> tuple[int, ...]:
        """The six arm joints (indices) that follow from a nozzle pose."""
        return tuple(j for j in range(len(self.arm)) if j != self.inverse.redundant_joint)

    @property
    def spherical(self) -> bool:
        """Whether the arm's wrist is spherical and its six joints are those of the usual industrial arm."""
        return isinstance(self.inverse, SphericalWrist)

    @property
    def wrist(self) -> SphericalWrist:
        """`inverse`, for what is written for spherical wrists only; raises Refusal for any other arm."""
        if not isinstance(self.inverse, SphericalWrist):
            raise Refusal(f"this cannot be done yet with {self.arm_robot.name}: its wrist is not spherical")
        return self.inverse

    def T_part_nozzle(self, q: Array) -> Array:
        """Nozzle poses in the part frame (m, 4, 4) of postures q (m, n)."""
        na = len(self.arm)
        T_world_nozzle = self.arm.poses(q[:, :na])
        T_world_part = self.holder.poses(q[:, na:])
        return rigid_inverse(T_world_part) @ T_world_nozzle


def build_cell(problem: Problem) -> Cell:
    """Read the robots that the problem names and place them.

    Raises InputError for an unknown robot, axis or joint, and for a home posture outside the limits.
    """
    spec = problem.cell
    arm_robot = load_robot(spec.arm, problem, "cell.arm")
    if arm_robot.inverse is None:
        raise problem.error("cell.arm", f"{arm_robot.key} is not an arm: its file names no inverse kinematics")
    T_world_base = translation(np.asarray(spec.base))
    T_flange_nozzle = frame_from_z(np.asarray(spec.nozzle.tip), np.asarray(spec.nozzle.axis))
    arm = chain_of(arm_robot, T_world_base, T_flange_nozzle, arm_robot.joint_names, {})

    T_plate_part = np.eye(4)
    if spec.positioner is None:
        holder_robot, held = None, {}
        T_world_holder_base = translation(np.asarray(spec.bed))
        T_world_holder_base[:3, :3] = pin.rpy.rpyToMatrix(*spec.bed_rpy)
        holder = Chain((), np.empty((0, 4, 4)), np.empty((0, 3)), T_world_holder_base)
    else:
        holder_robot = load_robot(spec.positioner.robot, problem, "cell.positioner.robot")
        held = _held(problem, spec.positioner, holder_robot)
        T_plate_part[:3, :3] = pin.rpy.rpyToMatrix(*spec.positioner.part_rpy)
        T_plate_part[:3, 3] = spec.positioner.part
        T_world_holder_base = _holder_base(spec.positioner, holder_robot)
        holder = chain_of(holder_robot, T_world_holder_base, T_plate_part, spec.positioner.free, held)

    limits = _limits(problem, spec, arm_robot, arm, holder_robot, holder)
    na = len(arm)
    if len(spec.home) != na:
        reason = f"{arm_robot.name} has {na} joints, not {len(spec.home)}"
        raise problem.error("cell.home_deg", reason, f"one angle for each of {', '.join(arm.names)}")
    rest = np.clip(np.zeros(len(holder)), limits.q_min[na:], limits.q_max[na:])
    if spec.positioner is not None:
        rest = np.array([spec.positioner.home.get(name, at) for name, at in zip(holder.names, rest, strict=True)])
    home = np.concatenate([np.asarray(spec.home), rest])
    outside = (home < limits.q_min) | (home > limits.q_max)
    if outside.any():
        j = int(np.argmax(outside))
        low, high = np.degrees(limits.q_min[j]), np.degrees(limits.q_max[j])
        field, joint = "cell.home_deg", f"joint {j + 1}"
        if j >= na:
            field, joint = f"cell.positioner.home_deg.{holder.names[j - na]}", "the angle"
        raise problem.error(field, f"{joint} is outside its range", f"{low:.0f} to {high:.0f}")
    inverse = arm_robot.inverse
    if inverse.redundant_joint is not None:
        inverse = with_rest(inverse, float(home[inverse.redundant_joint]))
    return Cell(
        arm=arm,
        holder=holder,
        limits=limits,
        inverse=inverse,
        T_world_base=T_world_base,
        T_flange_nozzle=T_flange_nozzle,
        T_world_holder=holder.poses(np.zeros((1, len(holder))))[0],
        home=home,
        arm_robot=arm_robot,
        holder_robot=holder_robot,
        held=held,
        T_world_holder_base=T_world_holder_base,
        T_plate_part=T_plate_part,
        head=head_bodies(problem, T_flange_nozzle),
        fixtures=fixture_bodies(problem, "world"),
        carried=fixture_bodies(problem, "part"),
    )


def _held(problem: Problem, spec: PositionerSpec, robot: Robot) -> dict[str, float]:
    """Angles [rad] of the axes that are not free, by name; InputError for names and angles that the robot has not."""
    axes = robot.joint_names
    for field, names in (("free", spec.free), ("held_deg", spec.held), ("home_deg", spec.home)):
        for name in names:
            if name not in axes:
                near = nearest_name(name, axes)
                hint = f"did you mean {near}?" if near else f"axes: {', '.join(axes)}"
                raise problem.error(f"cell.positioner.{field}", f"no axis {name!r}", hint)
    for name in spec.home:
        if name not in spec.free:
            where = f"cell.positioner.home_deg.{name}"
            raise problem.error(where, f"axis {name!r} is not free", "the angle of a held axis stands in held_deg")
    for name, angle in spec.held.items():
        low, high = (
            float(limit[axes.index(name)]) for limit in (robot.model.lowerPositionLimit, robot.model.upperPositionLimit)
        )
        if not low - _ROUNDING <= angle <= high + _ROUNDING:
            valid = f"{np.degrees(low):.0f} to {np.degrees(high):.0f}"
            raise problem.error(f"cell.positioner.held_deg.{name}", "the angle is outside the axis' range", valid)
    return {name: spec.held.get(name, 0.0) for name in axes if name not in spec.free}


def _holder_base(spec: PositionerSpec, robot: Robot) -> Array:
    """Where the base of what holds the part stands (4, 4): at base_mm, or so that the plate's centre is at origin_mm."""
    turn = np.eye(4)
    turn[:3, :3] = pin.rpy.rpyToMatrix(0.0, 0.0, spec.turn)
    if spec.base is not None:
        return translation(np.asarray(spec.base)) @ turn
    at_zero = chain_of(robot, turn, np.eye(4), (), dict.fromkeys(robot.joint_names, 0.0)).T_last_tip
    return translation(np.asarray(spec.origin) - at_zero[:3, 3]) @ turn


def _joint_names(arm: Chain, holder: Chain) -> tuple[str, ...]:
    return arm.names + tuple(f"positioner_{name}" if name in arm.names else name for name in holder.names)


def _limits(
    problem: Problem, spec: CellSpec, arm_robot: Robot, arm: Chain, holder_robot: Robot | None, holder: Chain
) -> Limits:
    rows = []
    for robot, chain in ((arm_robot, arm), (holder_robot, holder)):
        if robot is None:
            continue
        for name in chain.names:
            i = robot.joint_names.index(name)
            m = robot.model
            row = [m.lowerPositionLimit[i], m.upperPositionLimit[i], m.velocityLimit[i]]
            rows.append([*row, robot.acceleration[i], robot.jerk[i]])
    table = np.array(rows)
    names = list(_joint_names(arm, holder))
    for name, own in spec.limits.items():
        if name not in names:
            near = nearest_name(name, names)
            hint = f"did you mean {near}?" if near else f"joints: {', '.join(names)}"
            raise problem.error(f"cell.limits.{name}", "no such joint", hint)
        row = table[names.index(name)]
        if own.range is not None:
            row[:2] = own.range
        for k, value in ((2, own.speed), (3, own.acceleration), (4, own.jerk)):
            if value is not None:
                row[k] = value
    return Limits(*np.ascontiguousarray(table.T))


def translation(p: Array) -> Array:
    """Homogeneous transform (4, 4) of a pure translation [m]."""
    T = np.eye(4)
    T[:3, 3] = p
    return T


def rigid_inverse(T: Array) -> Array:
    """Inverses of rigid transforms (..., 4, 4)."""
    out = np.zeros_like(T)
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = R
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def frame_from_z(origin: Array, z: Array) -> Array:
    """Frame (4, 4) at `origin` whose z points along `z`, turned from the parent's frame by the least angle."""
    z = z / np.linalg.norm(z)
    T = translation(origin)
    T[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), z).toRotationMatrix()
    return T
