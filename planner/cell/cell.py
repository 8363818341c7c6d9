"""The robot cell: arm, positioner, nozzle, limits and the placement of everything, from robots/*.yaml and URDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from planner.base.arrays import Array, Flags, Indices
from planner.base.errors import Refusal, nearest_name
from planner.cell.bodies import OF, fixture_bodies, head_bodies
from planner.cell.carrier import Carrier, carried_arm, given_limits, in_words
from planner.cell.kinematics.chain import Chain
from planner.cell.kinematics.inverse import InverseKinematics, OnRail, given_joints, with_rest
from planner.cell.kinematics.placed_wrist import PlacedWrist
from planner.cell.kinematics.skew_wrist import SkewWrist
from planner.cell.kinematics.spherical_wrist import SphericalWrist
from planner.cell.robot import Robot, chain_of, load_robot
from planner.cell.solids import Body
from planner.problem import Problem
from planner.problem.cell import CellSpec, PositionerSpec

REVOLUTION = 2.0 * np.pi
_STRAIGHT = 1e-3  # sine of the angle between axes 4 and 6 at joint 5's zero: below, they count as parallel there
LIMIT_ROOM = 0.07  # rad, m: margin that a search keeps from the joint limits; motion between its rungs needs it
LEAST_ROOM = 0.01  # the same, if a search finds no way with LIMIT_ROOM
_ROUNDING = 1e-9  # rad: an angle at the end of its range stays inside it when converted from degrees


@dataclass(frozen=True)
class Limits:
    """Joint limits (n) in the cell's joint order: rad, rad/s, rad/s^2, rad/s^3; metres for sliding joints.

    Attributes:
        q_min: Least positions (n,) [rad; m for sliding joints].
        q_max: Greatest positions (n,) [rad; m for sliding joints].
        velocity: Greatest speeds (n,) [rad/s; m/s for sliding joints].
        acceleration: Greatest accelerations (n,) [rad/s^2; m/s^2 for sliding joints].
        jerk: Greatest jerks (n,) [rad/s^3; m/s^3 for sliding joints].
        sliding: Indices of the sliding joints.
        room: Margin that a search keeps from the ends of the ranges [rad; m for sliding joints]; its results are not
            judged by it.
    """

    q_min: Array
    q_max: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    sliding: tuple[int, ...] = ()
    room: float = LIMIT_ROOM

    @property
    def turns(self) -> Flags:
        """Which joints (n,) turn, so that whole turns lead to the same posture."""
        return ~np.isin(np.arange(len(self.q_min)), self.sliding)


@dataclass(frozen=True)
class FlangeNozzle:
    """One of several nozzles: its name, its pose on the flange (z out of the tip), and all bodies on the flange while
    it is in use, in the nozzle's frame."""

    name: str
    T_flange_nozzle: Array
    head: tuple[Body, ...]


@dataclass(frozen=True)
class Cell:
    """Arm with nozzle, and the holder of the part.

    Attributes:
        arm: Chain from the world to the nozzle frame (z = nozzle axis), with the joints that carry the arm, if any.
        holder: Chain from the world to the part frame; only the free axes, none for a fixed bed.
        limits: Limits of the arm's joints, then the holder's.
        inverse: Inverse kinematics of the arm, base to flange.
        T_world_base: Pose (4, 4) of the base at one end of `inverse`, in the world.
        T_flange_nozzle: Pose (4, 4) of the nozzle on the flange, the other end of `inverse`.
        T_world_holder: Pose (4, 4) of the part frame in the world, with the holder's free axes at 0.
        home: Start posture (n,), arm then holder [rad; m for sliding joints].
        arm_robot: The arm's own model, for independent checks; an arm's carrier is joined with it.
        holder_robot: The holder's own model, for independent checks; None for a fixed bed.
        held: Positions of the held axes, by name [rad; m for sliding ones], for independent checks.
        T_world_holder_base: Pose (4, 4) of the holder's base in the world, at one end of the holder.
        T_plate_part: Pose (4, 4) of the part on the holder's plate, at the other end.
        head: Bodies of nozzle and print head, in the nozzle frame; those of the robots are stored with the robots.
        fixtures: Bodies that stand still, in the world frame.
        carried: Bodies that move with the part, in its frame.
        carrier: The arm's carrier, if any; in `arm_robot`, it is joined with the arm.
        nozzles: All nozzles, if there are several; the cell is that of one of them, see `at`.
        nozzle_of: Index of the nozzle that lays each material, by name.
        in_use: Index of the nozzle whose cell this is.
        moving_only: Whether the controller has no external axes that stand still: a holder with all its axes held is no
            station then.
        held_range: Least and greatest position of each held axis, by name [rad; m for sliding ones].
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
    carrier: Carrier | None = None
    nozzles: tuple[FlangeNozzle, ...] = ()
    nozzle_of: Mapping[str, int] = field(default_factory=dict)
    in_use: int = 0
    moving_only: bool = False
    held_range: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def at(self, material: str) -> Cell:
        """The cell using the nozzle that lays a material: itself, if one nozzle lays all.

        Args:
            material: Name of the material.
        """
        return self.with_nozzle(self.nozzle_of[material]) if self.nozzles else self

    def with_nozzle(self, k: int) -> Cell:
        """The cell with one of several nozzles in use.

        Args:
            k: Index of the nozzle in `nozzles`.
        """
        return self if k == self.in_use else self._by_nozzle[k]

    @property
    def nozzle_name(self) -> str:
        """The name of the nozzle in use; empty if there is only one."""
        return self.nozzles[self.in_use].name if self.nozzles else ""

    @cached_property
    def _by_nozzle(self) -> tuple[Cell, ...]:
        T_last_flange = self.arm.T_last_tip @ rigid_inverse(self.T_flange_nozzle)
        return tuple(
            replace(
                self,
                arm=replace(self.arm, T_last_tip=T_last_flange @ nozzle.T_flange_nozzle),
                T_flange_nozzle=nozzle.T_flange_nozzle,
                head=nozzle.head,
                in_use=k,
            )
            for k, nozzle in enumerate(self.nozzles)
        )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in joint order: arm, then holder; a holder's joint with the name of an arm's is `positioner_<name>`."""
        return _joint_names(self.arm, self.holder)

    @property
    def chosen(self) -> tuple[int, ...]:
        """Joints (indices) whose angles are chosen, not solved for: the holder's, then the arm's `given` ones."""
        na = len(self.arm)
        return (*range(na, na + len(self.holder)), *self.given)

    @property
    def given(self) -> tuple[int, ...]:
        """Joints (indices) of the arm that are chosen: those that carry it, and the redundant one of seven."""
        return given_joints(self.inverse)

    @property
    def solved(self) -> tuple[int, ...]:
        """The six arm joints (indices) that follow from a nozzle pose."""
        return tuple(j for j in range(len(self.arm)) if j not in self.given)

    @property
    def rails(self) -> int:
        """Number of joints that carry the arm; they come before its own."""
        return len(self.inverse.rail) if isinstance(self.inverse, OnRail) else 0

    @property
    def T_world_foot(self) -> Array:
        """Pose (4, 4) of the arm's own base in the world, with the free joints that carry it at 0."""
        return self._foot(np.zeros(self.rails))

    @property
    def T_world_foot_home(self) -> Array:
        """Pose (4, 4) of the arm's own base in the world at home."""
        return self._foot(self.home[: self.rails])

    def _foot(self, q: Array) -> Array:
        if not isinstance(self.inverse, OnRail):
            return self.T_world_base
        T: Array = self.T_world_base @ self.inverse.rail.poses(q[None])[0]
        return T

    @property
    def own(self) -> slice:
        """The arm's own joints, without its carrier's, as a slice of the posture."""
        return slice(self.rails, len(self.arm))

    @property
    def station(self) -> Robot | None:
        """The robot that programs treat as external axes holding the part.

        A second arm whose joints are all held is none, nor is such a positioner with `moving_only`.
        """
        robot = self.holder_robot
        if robot is None or len(self.holder):
            return robot
        return None if self.moving_only or robot.inverse is not None else robot

    @property
    def second_arm(self) -> Robot | None:
        """The arm that moves the part in a controller task of its own; None if an axis moves it, or nothing does."""
        return self.station if self.station is not None and self.station.inverse is not None else None

    @property
    def besides(self) -> tuple[int, ...]:
        """The joints (indices) that a controller counts as external axes: the carrier's and the holder's."""
        na = len(self.arm)
        return (*range(self.rails), *range(na, na + len(self.holder)))

    @property
    def own_inverse(self) -> InverseKinematics:
        """Inverse kinematics of the arm alone, without its carrier."""
        return self.inverse.arm if isinstance(self.inverse, OnRail) else self.inverse

    @property
    def spherical(self) -> bool:
        """Whether the arm's wrist is spherical and its own six joints are those of the usual industrial arm."""
        return isinstance(self.own_inverse, SphericalWrist)

    @property
    def tells_posture(self) -> bool:
        """Whether a pose and a branch define a posture in the way controllers of industrial arms do.

        `as_counted` then has a spherical wrist, its joints counted as in data sheets.
        """
        return isinstance(self.own_inverse, SphericalWrist | PlacedWrist)

    def counted(self, q: Array) -> Array:
        """Joints of `as_counted` at given postures.

        Args:
            q: Postures (m, n) of this cell [rad; m for sliding joints].

        Returns:
            Joints (m, n) of `as_counted` [rad; m for sliding joints].
        """
        placed = self.own_inverse
        if not isinstance(placed, PlacedWrist):
            return q
        out = q.copy()
        out[:, self.own] = placed.counted(q[:, self.own])
        return out

    @property
    def as_counted(self) -> Cell:
        """The same cell with the joints of a spherical-wrist arm counted as in data sheets.

        They count from upper arm upright and forearm level, between the frames that controllers use. It is the cell
        itself if they are counted so already, and for other arms.

        Only the speeds of the arm's model still hold: take poses from the chain `arm`.
        """
        placed, k = self.own_inverse, self.rails
        if not isinstance(placed, PlacedWrist):
            return self
        T_flange_nozzle = placed.T_end_flange @ self.T_flange_nozzle
        others = [replace(one, T_flange_nozzle=placed.T_end_flange @ one.T_flange_nozzle) for one in self.nozzles]
        inverse: InverseKinematics = placed.arm
        if isinstance(self.inverse, OnRail):
            rail, T_world_base = self.inverse.rail, self.T_world_base
            T_foot = rail.T_last_tip @ placed.T_base_foot  # on the last joint that carries the arm
            inverse = replace(self.inverse, arm=placed.arm, rail=replace(rail, T_last_tip=T_foot))
        else:
            T_foot = T_world_base = self.T_world_base @ placed.T_base_foot
        own = placed.arm.chain(self.arm.names[k:])
        first = T_foot[None] @ own.placements[:1]
        placements = np.concatenate([self.arm.placements[:k], first, own.placements[1:]])
        axes = np.concatenate([self.arm.axes[:k], own.axes])
        na, limits = len(self.arm), self.limits
        ends = np.sort([self.counted(each[None])[0] for each in (limits.q_min, limits.q_max)], axis=0)
        return replace(
            self,
            arm=Chain(self.arm.names, placements, axes, own.T_last_tip @ T_flange_nozzle),
            limits=replace(
                limits,
                q_min=np.append(ends[0, :na], limits.q_min[na:]),
                q_max=np.append(ends[1, :na], limits.q_max[na:]),
            ),
            inverse=inverse,
            T_world_base=T_world_base,
            T_flange_nozzle=T_flange_nozzle,
            home=self.counted(self.home[None])[0],
            arm_robot=replace(self.arm_robot, inverse=inverse),
            nozzles=tuple(others),
        )

    @property
    def straightens(self) -> bool:
        """Whether the arm has six axes of its own and is singular where axes 4 and 6 are parallel."""
        return len(self.arm) - self.rails == 6 and not isinstance(self.own_inverse, SkewWrist)

    @property
    def straight_at(self) -> float:
        """Angle of joint 5 of six at which axes 4 and 6 are parallel [rad], the same way or opposite; usually 0."""
        if len(self.solved) != 6 or self.given not in ((), tuple(range(self.rails))):
            return 0.0
        fourth, fifth, sixth = self.arm.screws[self.rails + 3 : self.rails + 6, 3:]
        angle = float(np.arctan2(np.cross(fourth, sixth) @ fifth, fourth @ sixth))
        return -angle if abs(np.sin(angle)) > _STRAIGHT else 0.0

    @property
    def wrist(self) -> SphericalWrist:
        """`inverse`, for code that supports spherical wrists only.

        Raises:
            Refusal: For any other arm.
        """
        if not isinstance(self.inverse, SphericalWrist):
            raise Refusal(f"this cannot be done yet with {self.arm_robot.name}: its wrist is not spherical")
        return self.inverse

    def flange_of_second_arm(self, q: Array) -> Array:
        """Flange poses of the second arm in the world.

        Args:
            q: Positions (m, k) of its free joints [rad; m for sliding joints].

        Returns:
            Poses (m, 4, 4) in the world.
        """
        return self.holder.poses(q) @ rigid_inverse(self.T_plate_part[None])

    def T_part_nozzle(self, q: Array) -> Array:
        """Nozzle poses in the part frame.

        Args:
            q: Postures (m, n), arm then holder [rad; m for sliding joints].

        Returns:
            Poses (m, 4, 4) in the part frame.
        """
        na = len(self.arm)
        T_world_nozzle = self.arm.poses(q[:, :na])
        T_world_part = self.holder.poses(q[:, na:])
        return rigid_inverse(T_world_part) @ T_world_nozzle

    def postures(self, T_part_nozzle: Array, near: Array, branch: Indices) -> tuple[Array, Flags]:
        """Joints that hold the nozzle at given poses, and whether they exist.

        Chosen joints are those of `near`, and each joint is in the turn nearest to `near`.

        Args:
            T_part_nozzle: Nozzle poses (m, 4, 4) in the part frame.
            near: Postures (m, n), arm then holder [rad; m for sliding joints].
            branch: Branch (m,) of the inverse kinematics, for each pose.

        Returns:
            Joints (m, n) [rad; m for sliding joints], those of `near` where there are none.
            Whether they exist (m,).
        """
        na, given = len(self.arm), list(self.given)
        T_base_flange = (
            np.linalg.inv(self.T_world_base)
            @ self.holder.poses(np.ascontiguousarray(near[:, na:]))
            @ T_part_nozzle
            @ np.linalg.inv(self.T_flange_nozzle)
        )
        found, exist = self.inverse.solve(T_base_flange, np.ascontiguousarray(near[:, given]) if given else None)
        each = np.arange(len(near))
        off = found[each, branch] - near[:, :na]
        off -= np.where(self.limits.turns[:na], REVOLUTION * np.round(off / REVOLUTION), 0.0)
        there = exist[each, branch]
        out = near.copy()
        out[:, :na] += np.where(there[:, None], off, 0.0)
        return out, there


def near_ends(cell: Cell) -> Cell:
    """The cell, to be searched as close to the joint limits as allowed, see `Limits.room`."""
    return replace(cell, limits=replace(cell.limits, room=LEAST_ROOM))


def build_cell(problem: Problem) -> Cell:
    """Read the robots that the problem names and place them.

    Raises InputError for an unknown robot, axis or joint, and for a home posture outside the limits.
    """
    spec = problem.cell
    arm_robot = load_robot(spec.arm, problem, "cell.arm")
    if arm_robot.inverse is None:
        raise problem.error("cell.arm", f"{arm_robot.key} is not an arm: its file names no inverse kinematics")
    T_world_base = translation(np.asarray(spec.base))
    T_world_base[:3, :3] = pin.rpy.rpyToMatrix(*spec.base_rpy)
    nozzles = _flange_nozzles(problem)
    T_flange_nozzle = nozzles[0].T_flange_nozzle
    holder_robot = (
        None if spec.positioner is None else load_robot(spec.positioner.robot, problem, "cell.positioner.robot")
    )
    others = () if holder_robot is None else holder_robot.joint_names
    carried = None if spec.carrier is None else carried_arm(problem, spec.carrier, arm_robot, others)
    if carried is not None:
        arm_robot, T_world_base = carried.robot, T_world_base @ carried.T_carrier_base
    arm = chain_of(arm_robot, T_world_base, T_flange_nozzle, arm_robot.joint_names, {})

    T_plate_part = np.eye(4)
    if spec.positioner is None or holder_robot is None:
        held: dict[str, float] = {}
        held_range: dict[str, tuple[float, float]] = {}
        T_world_holder_base = translation(np.asarray(spec.bed))
        T_world_holder_base[:3, :3] = pin.rpy.rpyToMatrix(*spec.bed_rpy)
        holder = Chain((), np.empty((0, 4, 4)), np.empty((0, 6)), T_world_holder_base)
    else:
        held, held_range = _held(problem, spec.positioner, holder_robot, arm)
        T_plate_part[:3, :3] = pin.rpy.rpyToMatrix(*spec.positioner.part_rpy)
        T_plate_part[:3, 3] = spec.positioner.part
        T_world_holder_base = _holder_base(spec.positioner, holder_robot)
        holder = chain_of(holder_robot, T_world_holder_base, T_plate_part, spec.positioner.free, held)

    limits = _limits(problem, spec, arm_robot, arm, holder_robot, holder, () if carried is None else carried.still)
    before = () if carried is None else carried.home
    na, own = len(arm), arm.names[len(before) :]
    if len(spec.home) != len(own):
        reason = f"{arm_robot.name} has {len(own)} joints, not {len(spec.home)}"
        raise problem.error("cell.home_deg", reason, f"one angle for each of {', '.join(own)}")
    rest = np.clip(np.zeros(len(holder)), limits.q_min[na:], limits.q_max[na:])
    if spec.positioner is not None:
        at_home = spec.positioner.home | spec.positioner.home_mm
        rest = np.array([at_home.get(name, at) for name, at in zip(holder.names, rest, strict=True)])
    home = np.concatenate([before, np.asarray(spec.home), rest])
    outside = (home < limits.q_min) | (home > limits.q_max)
    if outside.any():
        j = int(np.argmax(outside))
        low, high = np.degrees(limits.q_min[j]), np.degrees(limits.q_max[j])
        field, joint = "cell.home_deg", f"joint {j + 1 - len(before)}"
        valid = f"{low:.0f} to {high:.0f}"
        if j >= na or j < len(before):
            section = "positioner" if j >= na else "base"
            unit = "mm" if j in limits.sliding else "deg"
            name = holder.names[j - na] if j >= na else arm.names[j]
            field, joint = f"cell.{section}.home_{unit}.{name}", "it"
            valid = in_words(limits.q_min[j], limits.q_max[j], j in limits.sliding)
        raise problem.error(field, f"{joint} is outside its range", valid)
    inverse = arm_robot.inverse
    if inverse is None:
        raise TypeError(f"{arm_robot.key} lost its inverse kinematics")
    given = given_joints(inverse)
    if given:
        inverse = with_rest(inverse, *home[list(given)].tolist())
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
        head=nozzles[0].head,
        fixtures=fixture_bodies(problem, "world"),
        carried=fixture_bodies(problem, "part"),
        carrier=None if carried is None else carried.carrier,
        nozzles=nozzles if spec.nozzles else (),
        nozzle_of=_nozzle_of(problem),
        held_range=held_range,
    )


def _flange_nozzles(problem: Problem) -> tuple[FlangeNozzle, ...]:
    """A problem's nozzle, or all of them, each with its print head, and with the others if they are mounted next to it.

    If there are several, their bodies' names contain the nozzle's. Raises InputError for a mesh that cannot be read.
    """
    spec, found = problem.cell, []
    for name, own in (spec.nozzles or {"": spec.nozzle}).items():
        T = frame_from_z(np.asarray(own.tip), np.asarray(own.axis))
        bodies = head_bodies(problem, own, f"cell.nozzles.{name}" if name else "cell.nozzle", T)
        named = tuple(replace(body, name=f"{body.name}{OF}{name}") for body in bodies) if name else bodies
        found.append(FlangeNozzle(name, T, named))
    if spec.mounted == "one":
        return tuple(found)
    beside = [tuple(body for other in found if other is not own for body in _beside(own, other)) for own in found]
    return tuple(replace(own, head=(*own.head, *others)) for own, others in zip(found, beside, strict=True))


def _beside(own: FlangeNozzle, other: FlangeNozzle) -> tuple[Body, ...]:
    """The bodies of another nozzle, in the frame of the one in use."""
    T = rigid_inverse(own.T_flange_nozzle) @ other.T_flange_nozzle
    return tuple(replace(body, T_frame_solid=T @ body.T_frame_solid) for body in other.head)


def _nozzle_of(problem: Problem) -> dict[str, int]:
    """Index of the nozzle, of several, that lays each material, by name."""
    names = list(problem.cell.nozzles)
    return {name: names.index(spec.nozzle) for name, spec in problem.process.materials.items() if spec.nozzle}


def _held(
    problem: Problem, spec: PositionerSpec, robot: Robot, arm: Chain
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Positions [rad, m] of the axes that are not free, by name, and their ranges, taken from `cell.limits` if given
    there; InputError for unknown names and for values out of range."""
    axes, slides = robot.joint_names, dict(zip(robot.joint_names, robot.slides, strict=True))
    given = {"held_deg": spec.held, "held_mm": spec.held_mm, "home_deg": spec.home, "home_mm": spec.home_mm}
    for named, names in {"free": spec.free, **given}.items():
        for name in names:
            if name not in axes:
                near = nearest_name(name, axes)
                hint = f"did you mean {near}?" if near else f"axes: {', '.join(axes)}"
                raise problem.error(f"cell.positioner.{named}", f"no axis {name!r}", hint)
            if named != "free" and named.endswith("mm") != slides[name]:
                way, unit = ("slides", "mm") if slides[name] else ("turns", "deg")
                hint = f"{named.split('_')[0]}_{unit}"
                raise problem.error(f"cell.positioner.{named}.{name}", f"axis {name!r} {way}", hint)
    for named in ("home_deg", "home_mm"):
        for name in given[named]:
            if name not in spec.free:
                hint = f"the value of a held axis goes in {named.replace('home', 'held')}"
                raise problem.error(f"cell.positioner.{named}.{name}", f"axis {name!r} is not free", hint)
    out, ranges = {}, {}
    for i, name in enumerate(axes):
        if name in spec.free:
            continue
        called = _in_cell(name, arm)
        own = problem.cell.limits.get(called)
        range_ = None if own is None else given_limits(problem, called, own, slides[name])[0]
        low, high = range_ or (float(robot.model.lowerPositionLimit[i]), float(robot.model.upperPositionLimit[i]))
        ranges[name] = low, high
        named = "held_mm" if slides[name] else "held_deg"
        # by default 0; for an axis that slides, the position in its range nearest to 0
        out[name] = at = given[named].get(name, float(np.clip(0.0, low, high)) if slides[name] else 0.0)
        if not low - _ROUNDING <= at <= high + _ROUNDING:
            reason = (
                "it is outside the axis's range" if name in given[named] else "0, its default, is outside its range"
            )
            raise problem.error(f"cell.positioner.{named}.{name}", reason, in_words(low, high, slides[name]))
    return out, ranges


def _holder_base(spec: PositionerSpec, robot: Robot) -> Array:
    """Pose (4, 4) of the holder's base: at base_mm, or such that the plate's centre is at origin_mm."""
    turn = np.eye(4)
    turn[:3, :3] = pin.rpy.rpyToMatrix(0.0, 0.0, spec.turn)
    if spec.base is not None:
        return translation(np.asarray(spec.base)) @ turn
    at_zero = chain_of(robot, turn, np.eye(4), (), dict.fromkeys(robot.joint_names, 0.0)).T_last_tip
    return translation(np.asarray(spec.origin) - at_zero[:3, 3]) @ turn


def _joint_names(arm: Chain, holder: Chain) -> tuple[str, ...]:
    return arm.names + tuple(_in_cell(name, arm) for name in holder.names)


def _in_cell(name: str, arm: Chain) -> str:
    """The name of a holder's axis among the cell's joints."""
    return f"positioner_{name}" if name in arm.names else name


def _limits(
    problem: Problem,
    spec: CellSpec,
    arm_robot: Robot,
    arm: Chain,
    holder_robot: Robot | None,
    holder: Chain,
    below: tuple[str, ...],
) -> Limits:
    """Limits of all joints that move. Those of the holder's held axes are checked by `_held`, those of the carrier's
    held joints (below) by `carried_arm`."""
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
    sliding = tuple(np.flatnonzero(np.concatenate([arm.slides, holder.slides])).tolist())
    still = () if holder_robot is None else (_in_cell(name, arm) for name in holder_robot.joint_names)
    held = {*still, *below} - set(names)
    for name, own in spec.limits.items():
        if name in held:
            continue
        if name not in names:
            near = nearest_name(name, names)
            hint = f"did you mean {near}?" if near else f"joints: {', '.join(names)}"
            raise problem.error(f"cell.limits.{name}", "no such joint", hint)
        j = names.index(name)
        row = table[j]
        range_, rates = given_limits(problem, name, own, j in sliding)
        if range_ is not None:
            row[:2] = range_
        for k, value in enumerate(rates, 2):
            if value is not None:
                row[k] = value
    q_min, q_max, velocity, acceleration, jerk = np.ascontiguousarray(table.T)
    return Limits(q_min, q_max, velocity, acceleration, jerk, sliding)


def turned_into(q: Array, low: Array, high: Array) -> Array:
    """Angles (..., n) [rad] of turning joints, each in the turn nearest to the middle of its range (n), low to high:
    within the range, if any turn is."""
    return np.asarray(q + REVOLUTION * np.round((0.5 * (low + high) - q) / REVOLUTION))


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
