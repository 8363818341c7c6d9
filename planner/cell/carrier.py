"""Join an arm and its carrier, such as a rail or a gantry, into one robot: the joints that carry the arm come first."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import pinocchio as pin

from planner.base.arrays import Array
from planner.base.errors import nearest_name
from planner.cell.kinematics.chain import Chain
from planner.cell.kinematics.inverse import Corrected, OnRail
from planner.cell.kinematics.offset_wrist import OffsetWrist
from planner.cell.kinematics.placed_wrist import PlacedWrist
from planner.cell.kinematics.seven_axes import SevenAxes
from planner.cell.kinematics.skew_wrist import SkewWrist
from planner.cell.kinematics.spherical_wrist import SphericalWrist
from planner.cell.robot import Robot, chain_of, load_robot
from planner.cell.solids import Body, Look
from planner.cell.urdf import link_frame
from planner.problem import Problem
from planner.problem.cell import CarrierSpec, JointLimitsSpec

_ROUNDING = 1e-9  # m, rad: a position at the end of its range stays inside it when converted from mm or degrees

Piece = TypeVar("Piece", Body, Look)


@dataclass(frozen=True)
class Carrier:
    """An arm's carrier: a robot, its joints that are free to move, base first (none: it stands still), and the
    positions at which the others are held [rad, m]."""

    robot: Robot
    free: tuple[str, ...]
    held: dict[str, float]


@dataclass(frozen=True)
class CarriedArm:
    """An arm with its carrier.

    robot          both as one, the carrier's free joints before the arm's own
    T_carrier_base (4, 4) pose of that robot's base in the carrier's base frame
    home           start positions of the free joints [rad, m]
    still          names of the held joints, as `cell.limits` calls them
    """

    robot: Robot
    carrier: Carrier
    T_carrier_base: Array
    home: tuple[float, ...]
    still: tuple[str, ...]


def carried_arm(problem: Problem, spec: CarrierSpec, arm: Robot, others: Collection[str]) -> CarriedArm:
    """The arm on the carrier that the problem names.

    others: joint names of the part's holder; a held joint of the carrier with such a name is called `base_<name>`

    Raises InputError for joints that the carrier does not have, and for positions out of their range.
    """
    robot = load_robot(spec.robot, problem, "cell.base.robot")
    if robot.inverse is not None:
        hint = "give a rail, a column or a gantry; an arm that holds the part is cell.positioner"
        raise problem.error("cell.base.robot", f"{robot.key} is an arm, and cannot carry one", hint)
    taken = _taken(arm)
    called = {
        name: f"base_{name}" if name in taken or (name in others and name not in spec.free) else name
        for name in robot.joint_names
    }
    values = _values(problem, spec, robot, called)
    free = tuple(name for name in robot.joint_names if name in spec.free)
    held = {name: values[name] for name in robot.joint_names if name not in free}
    still = tuple(called[name] for name in held)
    carrier = Carrier(robot, free, held)
    if not free:
        T = chain_of(robot, np.eye(4), np.eye(4), (), held).T_last_tip
        return CarriedArm(_standing(robot, held, arm, T), carrier, T, (), still)
    return CarriedArm(_joined(robot, free, held, arm), carrier, np.eye(4), tuple(values[name] for name in free), still)


def _taken(arm: Robot) -> set[str]:
    """Names of an arm's joints and links, which no joint or link of its carrier may have."""
    return {*arm.joint_names, *(frame.name for frame in arm.model.frames)}


def _values(problem: Problem, spec: CarrierSpec, robot: Robot, called: Mapping[str, str]) -> dict[str, float]:
    """Start or held position of each joint [rad, m], within its range, taken from `cell.limits` if given there;
    InputError for unknown names and for values out of range."""
    joints = robot.joint_names
    slides = dict(zip(joints, robot.slides, strict=True))
    ranges = {}
    for i, name in enumerate(joints):
        own = problem.cell.limits.get(called[name])
        range_ = None if own is None else given_limits(problem, called[name], own, slides[name])[0]
        ranges[name] = range_ or (float(robot.model.lowerPositionLimit[i]), float(robot.model.upperPositionLimit[i]))
    given = {"held_mm": spec.held_mm, "held_deg": spec.held_deg, "home_mm": spec.home_mm, "home_deg": spec.home_deg}
    out = {name: float(np.clip(0.0, *ranges[name])) for name in joints}
    for field, names in {"free": spec.free, **given}.items():
        for name in names:
            if name not in joints:
                near = nearest_name(name, joints)
                hint = f"did you mean {near}?" if near else f"joints: {', '.join(joints)}"
                raise problem.error(f"cell.base.{field}", f"no joint {name!r}", hint)
    for field, values in given.items():
        for name, value in values.items():
            where = f"cell.base.{field}.{name}"
            if field.startswith("home") != (name in spec.free):
                kind = "held" if field.startswith("home") else "free"
                hint = "a held joint's value goes in held_mm or held_deg, a free joint's in home_mm or home_deg"
                raise problem.error(where, f"joint {name!r} is {kind}", hint)
            if field.endswith("mm") != slides[name]:
                way, unit = ("slides", "mm") if slides[name] else ("turns", "deg")
                raise problem.error(where, f"joint {name!r} {way}", f"{field.split('_')[0]}_{unit}")
            low, high = ranges[name]
            if not low - _ROUNDING <= value <= high + _ROUNDING:
                valid = in_words(low, high, slides[name])
                raise problem.error(where, f"it is outside the range of joint {name!r}", valid)
            out[name] = value
    return out


def given_limits(
    problem: Problem, name: str, own: JointLimitsSpec, slides: bool
) -> tuple[tuple[float, float] | None, tuple[float | None, ...]]:
    """Range and greatest speed, acceleration and jerk of a joint, as far as `cell.limits` gives them; InputError if
    they are for the other kind of joint, turning or sliding."""
    ways = {
        False: (own.range, own.speed, own.acceleration, own.jerk),
        True: (own.range_mm, own.speed_mm_s, own.acceleration_mm_s2, own.jerk_mm_s3),
    }
    if any(value is not None for value in ways[not slides]):
        way, keys = ("slides", "range_mm, speed_mm_s, acceleration_mm_s2, jerk_mm_s3") if slides else (
            "turns", "range_deg, speed_deg_s, acceleration_rad_s2, jerk_rad_s3"
        )  # fmt: skip
        raise problem.error(f"cell.limits.{name}", f"this joint {way}", f"its limits are {keys}")
    range_, *rates = ways[slides]
    return range_, tuple(rates)


def in_words(low: float, high: float, slides: bool) -> str:
    """A joint's range in mm or degrees."""
    unit, scale = ("mm", 1e3) if slides else ("deg", np.degrees(1.0))
    return f"{low * scale:.0f} to {high * scale:.0f} {unit}"


def _standing(robot: Robot, held: dict[str, float], arm: Robot, T_carrier_base: Array) -> Robot:
    """The arm on a carrier that does not move, whose bodies become part of the arm's foot."""
    back: Array = np.asarray(np.linalg.inv(T_carrier_base), dtype=np.float64)
    foot = tuple(_moved(body, back) for body in _bodies(robot, held, ())[0])
    feet = tuple(_moved(look, back) for look in _carried(robot, robot.looks, held, ())[0])
    return replace(
        arm,
        name=_name(robot, arm),
        bodies=(foot + arm.bodies[0], *arm.bodies[1:]),
        looks=(feet + arm.looks[0], *arm.looks[1:]),
        assumed=_both(robot, arm),
    )


def _joined(robot: Robot, free: tuple[str, ...], held: dict[str, float], arm: Robot) -> Robot:
    """Both as one robot: the carrier's free joints, then the arm's own. A joint or link of the carrier whose name the
    arm uses too becomes `base_<name>`."""
    q = np.array([held.get(name, 0.0) for name in robot.joint_names])
    locked = [robot.model.getJointId(name) for name in held]
    model = pin.buildReducedModel(robot.model, locked, q)
    taken = _taken(arm)
    tip = link_frame(model, robot.tip)
    for i in range(1, model.njoints):
        if model.names[i] in taken:
            model.names[i] = f"base_{model.names[i]}"
    for frame in model.frames:
        if frame.name in taken and frame.name != "universe":
            frame.name = f"base_{frame.name}"
    upper = arm.model.copy()
    for one in (model, upper):
        one.lowerVelocityLimit = -one.velocityLimit  # a URDF leaves it non-negative, and models cannot be joined so
    whole = pin.appendModel(model, upper, tip, pin.SE3.Identity())
    moving = [robot.joint_names.index(name) for name in free]
    chain = chain_of(robot, np.eye(4), np.eye(4), free, held)
    return replace(
        arm,
        name=_name(robot, arm),
        model=whole,
        acceleration=np.append(robot.acceleration[moving], arm.acceleration),
        jerk=np.append(robot.jerk[moving], arm.jerk),
        inverse=_on_rail(arm, chain),
        assumed=_both(robot, arm),
        bodies=_stacked(_bodies(robot, held, free), arm.bodies, chain.T_last_tip),
        looks=_stacked(_carried(robot, robot.looks, held, free), arm.looks, chain.T_last_tip),
    )


def _on_rail(arm: Robot, chain: Chain) -> OnRail:
    if not isinstance(arm.inverse, SphericalWrist | PlacedWrist | OffsetWrist | SkewWrist | SevenAxes | Corrected):
        raise TypeError(f"{arm.key} is not an arm that stands")
    rest = getattr(getattr(arm.inverse, "nominal", arm.inverse), "rest", None)
    return OnRail(arm.inverse, chain, (*(0.0,) * len(chain), *(() if rest is None else (rest,))))


def _bodies(robot: Robot, held: dict[str, float], free: tuple[str, ...]) -> list[tuple[Body, ...]]:
    """Bodies as returned by `_carried`. Of those fixed relative to the arm's foot, only the last link's are neighbours
    of the arm's first link, just as if every joint were free."""
    first = max((1 + robot.joint_names.index(name) for name in free), default=0)
    last = len(robot.joint_names)
    own = [tuple(replace(body, below=first <= i < last) for body in bodies) for i, bodies in enumerate(robot.bodies)]
    return _carried(robot, own, held, free)


def _carried(
    robot: Robot, pieces: Sequence[Sequence[Piece]], held: dict[str, float], free: tuple[str, ...]
) -> list[tuple[Piece, ...]]:
    """Bodies or looks: those before the first free joint in the base's frame, those after each one in its frame."""
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, np.array([held.get(name, 0.0) for name in robot.joint_names]))
    parts: list[list[Piece]] = [[]]
    T_part_base = np.eye(4)
    for i, own in enumerate(pieces):
        if i and robot.joint_names[i - 1] in free:
            parts.append([])
            T_part_base = data.oMi[i].inverse().homogeneous
        parts[-1].extend(_moved(piece, T_part_base @ data.oMi[i].homogeneous) for piece in own)
    return [tuple(part) for part in parts]


def _stacked(
    below: list[tuple[Piece, ...]], above: tuple[tuple[Piece, ...], ...], T_last_tip: Array
) -> tuple[tuple[Piece, ...], ...]:
    """The bodies or looks of a carrier and of the arm on it, whose foot stands on the carrier's last joint."""
    whole: list[tuple[Piece, ...]] = list(below)
    whole[-1] += tuple(_moved(piece, T_last_tip) for piece in above[0])
    whole.extend(above[1:])
    return tuple(whole)


def _moved(piece: Piece, T: Array) -> Piece:
    return replace(piece, T_frame_solid=T @ piece.T_frame_solid)


def _name(robot: Robot, arm: Robot) -> str:
    return f"{arm.name} on {robot.name}"


def _both(robot: Robot, arm: Robot) -> tuple[str, ...]:
    return (*arm.assumed, *(word for word in robot.assumed if word not in arm.assumed))
