"""Read robots/*.yaml and the URDF that each names into a Robot. The URDF may come from an installed package."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from planner.base.arrays import Array
from planner.base.errors import nearest_name
from planner.base.shipped import ROBOTS
from planner.cell.bodies import CAPS, OTHERS, BodyRules, read_bodies, read_looks
from planner.cell.kinematics.axes import OtherGeometry
from planner.cell.kinematics.chain import Chain
from planner.cell.kinematics.inverse import Corrected, InverseKinematics
from planner.cell.kinematics.offset_wrist import OffsetWrist, read_offset_wrist
from planner.cell.kinematics.placed_wrist import PlacedWrist, read_spherical_wrist
from planner.cell.kinematics.seven_axes import FAR, SevenAxes, read_seven_axes
from planner.cell.kinematics.skew_wrist import SkewWrist, read_skew_wrist
from planner.cell.kinematics.spherical_wrist import SphericalWrist
from planner.cell.robot_file import KINDS, LENGTHS, RobotFile, is_number, read_robot_file
from planner.cell.solids import Body, Look
from planner.cell.urdf import (
    Urdf,
    first_links,
    link_frame,
    model_of,
    moving_joints,
    names_of,
    read_urdf,
    sliding_joints,
)
from planner.problem import Problem
from planner.problem.settings import LANGUAGE_NAMES, USUAL_LANGUAGE

_INVERSE = ("spherical_wrist", "inverse_kinematics")  # keys of a robot's file: an arm has one of them
_SAME_POSE = 1e-9  # m: within this, closed form and URDF are the same arm
_ROUNDED = 1e-4  # m: within this, they differ only by the URDF's rounded angles, such as 1.57 for a quarter turn
_POSTURES = 20


@dataclass(frozen=True)
class Robot:
    """One robot as its files describe it: a Pinocchio model of the joints from base to tip, its tip frame, and what
    a URDF cannot say; no inverse kinematics if it is not an arm.

    stand    link in which the first joint turns: for an arm, its own base, whatever that stands on in the URDF
    language that its controller is programmed in: one of LANGUAGE_NAMES
    bodies   one tuple for each joint index of the model (0: bodies that do not move), in the joint's frame; all empty
             if the URDF has no collision shapes
    looks    visual meshes of its links, arranged likewise; empty if the URDF has none
    measured which of its limits were measured, and from what, in words; empty if none were
    controller  its controller's measured behaviour: fields of its model (planner.export.player.model) and values [SI]
    """

    key: str
    name: str
    model: pin.Model
    tip: str
    stand: str
    acceleration: Array
    jerk: Array
    inverse: InverseKinematics | None
    assumed: tuple[str, ...]
    language: str
    bodies: tuple[tuple[Body, ...], ...]
    looks: tuple[tuple[Look, ...], ...]
    measured: str = ""
    controller: tuple[tuple[str, float], ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in joint order, base first."""
        return tuple(self.model.names[1:])

    @property
    def counts_as_controllers(self) -> bool:
        """Whether its joints are those of the usual industrial arm, counted as in data sheets and by controllers."""
        return isinstance(self.inverse, SphericalWrist)

    @cached_property
    def slides(self) -> tuple[bool, ...]:
        """Whether each joint slides, so that its positions are in metres."""
        return tuple(not joint_axis(self.model, i)[:3].any() for i in range(1, self.model.njoints))

    @property
    def T_base_stand(self) -> Array:
        """Pose (4, 4) of `stand` in the base frame; for an arm on a moving carrier, in the carrying joint's frame."""
        return _placement(self.model, self.stand)


def robot_names(folder: Path = ROBOTS) -> list[str]:
    """Keys of the robots that ship."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def shipped_robots(arms: bool) -> dict[str, str]:
    """Maker and type of the robots that ship, by key: the arms, or the others, which hold parts or carry arms.

    Only their YAML files are read.
    """
    return {
        file.path.stem: file.text("name")
        for file in _shipped_files()
        if any(key in file.data for key in _INVERSE) == arms
    }


@cache
def _shipped_files() -> tuple[RobotFile, ...]:
    return tuple(read_robot_file(ROBOTS / f"{key}.yaml") for key in robot_names())


def load_robot(robot: str | Path, problem: Problem, field: str) -> Robot:
    """Read a robot that ships, by its key, or the user's own, by its file.

    Raises InputError for the problem's field if there is no such robot, and for any error in its files.
    """
    if isinstance(robot, Path):
        if not robot.is_file():
            hint = "paths are relative to the problem file's folder; shipped robots go by name"
            raise problem.error(field, f"no file {robot}", hint)
        return read_robot(robot)
    if robot not in robot_names():
        raise problem.error(field, f"unknown robot {robot!r}", names_meant(robot))
    return read_robot(ROBOTS / f"{robot}.yaml")


def names_meant(key: str) -> str:
    """A hint for the name of an unknown robot: a similar name, or all that are known."""
    near = nearest_name(key, robot_names())
    if near:
        return f"did you mean {near}?"
    known = ", ".join(robot_names()) or "none"
    return f"in {ROBOTS}: {known}; a robot of your own is a file: my_robot.yaml"


def read_robot(path: Path) -> Robot:
    """Read a robot's YAML file and its URDF. Raises InputError for any error in them."""
    file = read_robot_file(path)
    urdf = read_urdf(file.urdf())
    model = _model(file, urdf)
    stand, _ = first_links(urdf, file.text("tip"))
    n = model.njoints - 1
    rules = _body_rules(file, urdf)
    return Robot(
        key=path.stem,
        name=file.text("name"),
        model=model,
        tip=file.text("tip"),
        acceleration=file.numbers("acceleration_rad_s2", n),
        jerk=file.numbers("jerk_rad_s3", n),
        inverse=_inverse(file, model, stand),
        assumed=file.texts("assumed"),
        language=_language(file),
        bodies=read_bodies(urdf, model, rules),
        looks=read_looks(urdf, model, rules),
        measured=file.text("measured") if "measured" in file.data else "",
        controller=file.controller(),
        stand=stand,
    )


def _body_rules(file: RobotFile, urdf: Urdf) -> BodyRules:
    links = urdf.links()
    shapes = {shape.get("name", "") for link in links.values() for shape in link}
    return BodyRules(
        without=file.of_these("without", "link", links),
        pieces=file.pieces(links),
        may_touch=file.link_pairs(links),
        colours=file.colours([*links, *sorted(shapes - {""}), OTHERS, CAPS]),
        first=first_links(urdf, file.text("tip")),
    )


def _language(file: RobotFile) -> str:
    name = file.data.get("language", USUAL_LANGUAGE)
    file.known("language", "language", name, LANGUAGE_NAMES)
    return str(name)


def _model(file: RobotFile, urdf: Urdf) -> pin.Model:
    """Pinocchio's model of the joints from base to tip, with the ranges and speeds that the robot's file gives."""
    tip = file.text("tip")
    file.known("tip", "link", tip, urdf.links())
    joints = names_of(moving_joints(urdf, tip))
    if not joints:
        raise file.error("tip", f"no joint moves between the base and {tip}")
    ranges = file.ranges(joints, sliding_joints(urdf, tip))
    model = model_of(urdf, tip, ranges, "speed_rad_s" in file.data)
    if "speed_rad_s" in file.data:
        model.velocityLimit = file.numbers("speed_rad_s", len(joints))
    return model


def _inverse(file: RobotFile, model: pin.Model, stand: str) -> InverseKinematics | None:
    """The inverse kinematics that the file names, checked against the URDF, and corrected for an arm that is only
    nearly of that kind. stand: as in `Robot`."""
    data = file.data
    given = [key for key in _INVERSE if key in data]
    if not given:
        return None
    if len(given) > 1:
        raise file.error(given[1], "spherical_wrist is given as well", "an arm has only one inverse kinematics")
    field = given[0]
    if slides := [name for i, name in enumerate(model.names[1:], 1) if not joint_axis(model, i)[:3].any()]:
        hint = "a rail has a file of its own, and carries the arm: cell.base of the problem file"
        raise file.error(field, f"joint {slides[0]} slides, but those of an arm turn", hint)
    chain = base_to_tip(model, data["tip"])
    T_base_stand = _placement(model, stand)
    inverse = _spherical(file, chain) if field == "spherical_wrist" else _read_off(file, chain, T_base_stand)
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (_POSTURES, len(chain)))
    seen, own = chain.poses(q), inverse.poses(q)
    apart = np.abs(seen - own).max(axis=(1, 2))
    if apart.max() <= _SAME_POSE:
        return inverse.arm if isinstance(inverse, PlacedWrist) and inverse.usual else inverse
    if isinstance(inverse, PlacedWrist | OffsetWrist | SevenAxes):
        return Corrected(inverse, chain)
    if apart.max() <= _ROUNDED:
        read = read_spherical_wrist(chain, T_base_stand)  # this absorbs a rounded tip
        return read if np.abs(seen - read.poses(q)).max() <= _SAME_POSE else Corrected(read, chain)
    worst = int(np.argmax(apart))
    at, by = (np.round(T[worst, :3, 3] * 1e3, 3) for T in (seen, own))
    raise file.error(
        field,
        f"these lengths and the URDF disagree about the flange: URDF says {at} mm, the lengths {by} mm",
        "if its zero, directions of axes or frames differ, inverse_kinematics: spherical_wrist reads them off the URDF",
    )


def _spherical(file: RobotFile, chain: Chain) -> SphericalWrist:
    lengths = file.data["spherical_wrist"]
    if not isinstance(lengths, Mapping) or set(lengths) != set(LENGTHS):
        raise file.error("spherical_wrist", "must give the seven OPW lengths", ", ".join(LENGTHS))
    if not all(is_number(value) for value in lengths.values()):
        raise file.error("spherical_wrist", "the lengths must be numbers", "millimetres")
    if len(chain) != 6:
        raise file.error("spherical_wrist", f"an arm with a spherical wrist has 6 joints, not {len(chain)}")
    return SphericalWrist(*(float(lengths[key]) * 1e-3 for key in LENGTHS))


def _read_off(file: RobotFile, chain: Chain, T_base_stand: Array) -> PlacedWrist | OffsetWrist | SkewWrist | SevenAxes:
    kind = file.data["inverse_kinematics"]
    if kind not in KINDS:
        raise file.error("inverse_kinematics", f"unknown kind {kind!r}", f"known: {', '.join(KINDS)}")
    redundant = file.data.get("redundant_joint")
    if (redundant is None) == (kind == "seven_axes"):
        field = "inverse_kinematics" if redundant is None else "redundant_joint"
        raise file.error(
            field, "an arm of seven axes, and only such an arm, names its redundant_joint", "one of its joints"
        )
    try:
        if kind == "offset_wrist":
            return read_offset_wrist(chain)
        if kind == "skew_wrist":
            return read_skew_wrist(chain)
        if kind == "spherical_wrist":
            return read_spherical_wrist(chain, T_base_stand)
        file.known("redundant_joint", "joint", redundant, chain.names)
        return read_seven_axes(chain, chain.names.index(str(redundant)), FAR)
    except OtherGeometry as error:
        raise file.error("inverse_kinematics", f"not an arm of the kind {kind}: {error}") from None


def _placement(model: pin.Model, link: str) -> Array:
    """Pose (4, 4) of a link in the frame that carries it: a joint's, or the base's."""
    return np.asarray(model.frames[link_frame(model, link)].placement.homogeneous)


def base_to_tip(model: pin.Model, tip: str) -> Chain:
    """Chain from a model's base to a link over all its joints."""
    return _fold(model, tip, np.eye(4), np.eye(4), tuple(model.names[1:]), {})


def chain_of(
    robot: Robot, T_world_base: Array, T_tip_tool: Array, free: Collection[str], held: Mapping[str, float]
) -> Chain:
    """Chain from the world to a tool over a robot's free joints; held ones (angles by name [rad]) are folded in."""
    return _fold(robot.model, robot.tip, T_world_base, T_tip_tool, free, held)


def _fold(
    model: pin.Model,
    tip: str,
    T_world_base: Array,
    T_tip_tool: Array,
    free: Collection[str],
    held: Mapping[str, float],
) -> Chain:
    placements, axes, names = [], [], []
    T = T_world_base.copy()
    for i in range(1, model.njoints):
        T = T @ model.jointPlacements[i].homogeneous
        axis = joint_axis(model, i)
        name = model.names[i]
        if name in free:
            placements.append(T)
            axes.append(axis)
            names.append(name)
            T = np.eye(4)
        else:
            turn = pin.AngleAxis(held[name] if axis[:3].any() else 0.0, axis[:3]).toRotationMatrix()
            T = T @ pin.SE3(turn, held[name] * axis[3:]).homogeneous
    frame = model.frames[link_frame(model, tip)]
    T = T @ frame.placement.homogeneous @ T_tip_tool
    n = len(names)
    return Chain(tuple(names), np.array(placements).reshape(n, 4, 4), np.array(axes).reshape(n, 6), T)


def bodies_with_tip(robot: Robot, free: Collection[str], held: Mapping[str, float]) -> tuple[Body, ...]:
    """Bodies fixed relative to a robot's tip whatever its free joints do, in the tip's frame; held: see `chain_of`."""
    model, data = robot.model, robot.model.createData()
    q = np.array([held.get(name, 0.0) for name in robot.joint_names])
    pin.forwardKinematics(model, data, q)
    T_tip_base = pin.updateFramePlacement(model, data, link_frame(model, robot.tip)).inverse()
    first = max((1 + robot.joint_names.index(name) for name in free), default=0)
    return tuple(
        Body(body.name, body.solid, (T_tip_base * data.oMi[i]).homogeneous @ body.T_frame_solid)
        for i in range(first, model.njoints)
        for body in robot.bodies[i]
    )


def joint_axis(model: pin.Model, i: int) -> Array:
    """A joint's motion in its own frame (6), as in Chain, read off its motion subspace."""
    q = pin.neutral(model)
    data = model.createData()
    whole = np.reshape(pin.computeJointJacobians(model, data, q), (6, model.nv))  # for a single joint, it comes flat
    J = whole[:, model.joints[i].idx_v]
    R = data.oMi[i].rotation.T
    # a sliding joint moves all points alike; for a turning one, the velocity at the world's origin does not matter
    return np.concatenate([R @ J[3:], np.zeros(3) if J[3:].any() else R @ J[:3]])


def joint_axes(model: pin.Model, i: int) -> Array:
    """Axes (k, 6) at and behind a joint (0: the base), in its frame: a point on each and its direction.

    First the axis of the joint itself, then those of the joints that hang on it.
    """
    found = [] if i == 0 else [np.concatenate([np.zeros(3), _direction(model, i)])]
    for j in range(1, model.njoints):
        if model.parents[j] == i:
            place = model.jointPlacements[j]
            found.append(np.concatenate([place.translation, place.rotation @ _direction(model, j)]))
    return np.array(found).reshape(-1, 6)


def _direction(model: pin.Model, i: int) -> Array:
    axis = joint_axis(model, i)
    return axis[:3] if axis[:3].any() else axis[3:]
