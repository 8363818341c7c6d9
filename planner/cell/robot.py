"""robots/*.yaml and the URDF that each names -> Robot. The URDF may come from an installed package."""

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

_INVERSE = ("spherical_wrist", "inverse_kinematics")  # keys, one of which an arm has
_SAME_POSE = 1e-9  # m: closed form and URDF are one arm
_ROUNDED = 1e-4  # m: so near they are one but for a URDF's rounded angles, such as 1.57 of a quarter turn
_POSTURES = 20


@dataclass(frozen=True)
class Robot:
    """One robot as its files describe it: a Pinocchio model of the joints from base to tip, its tip frame, and what
    a URDF cannot say; no inverse kinematics if it is not an arm.

    stand    link in which the first joint turns: of an arm its own base, whatever that stands on in the URDF
    language what its controller is programmed in: one of LANGUAGE_NAMES
    bodies   one tuple for each joint index of the model (0: what does not move), in the joint's frame; all empty if
             the URDF has no collision shapes
    looks    meshes that its links show, in the same way; empty where the URDF shows none
    measured what of its limits was measured, and from what, in words; empty where nothing was
    controller  what its controller was measured to do: fields of its model (planner.export.player.model) and values [SI]
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
        """Whether its joints are those of the usual industrial arm, counted as data sheets and controllers do."""
        return isinstance(self.inverse, SphericalWrist)

    @cached_property
    def slides(self) -> tuple[bool, ...]:
        """Of each joint whether it slides: its places are metres."""
        return tuple(not joint_axis(self.model, i)[:3].any() for i in range(1, self.model.njoints))

    @property
    def T_base_stand(self) -> Array:
        """Where `stand` is (4, 4), seen from the base; of an arm on what may move, from the joint that carries it."""
        return _placement(self.model, self.stand)


def robot_names(folder: Path = ROBOTS) -> list[str]:
    """Keys of the robots that ship."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def shipped_robots(arms: bool) -> dict[str, str]:
    """Robots that ship, by key: maker and type; those that are arms, or those that are none and only hold parts.

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

    Raises InputError, of the problem's field, where there is none, and for whatever is wrong with its files.
    """
    if isinstance(robot, Path):
        if not robot.is_file():
            hint = "counted from the problem file's folder; robots that ship go by name"
            raise problem.error(field, f"no file {robot}", hint)
        return read_robot(robot)
    if robot not in robot_names():
        raise problem.error(field, f"unknown robot {robot!r}", names_meant(robot))
    return read_robot(ROBOTS / f"{robot}.yaml")


def names_meant(key: str) -> str:
    """What somebody may have meant who named a robot that there is not."""
    near = nearest_name(key, robot_names())
    if near:
        return f"did you mean {near}?"
    known = ", ".join(robot_names()) or "none"
    return f"in {ROBOTS}: {known}; a robot of your own is a file: my_robot.yaml"


def read_robot(path: Path) -> Robot:
    """Read a robot's YAML file and its URDF. Raises InputError for whatever is wrong with them."""
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
    """Pinocchio's model of the joints from base to tip, with the ranges and speeds that the robot's file knows."""
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
    """The closed form that the file names, held to the URDF; corrected where an arm is nearly of its kind. stand: as of a
    `Robot`."""
    data = file.data
    given = [key for key in _INVERSE if key in data]
    if not given:
        return None
    if len(given) > 1:
        raise file.error(given[1], "spherical_wrist is given as well", "an arm has one inverse kinematics")
    field = given[0]
    if slides := [name for i, name in enumerate(model.names[1:], 1) if not joint_axis(model, i)[:3].any()]:
        hint = "a rail has a file of its own, and carries the arm: cell.base of the problem file"
        raise file.error(field, f"joint {slides[0]} slides, and those of an arm turn", hint)
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
        read = read_spherical_wrist(chain, T_base_stand)  # which takes in a tip that is rounded
        return read if np.abs(seen - read.poses(q)).max() <= _SAME_POSE else Corrected(read, chain)
    worst = int(np.argmax(apart))
    at, by = (np.round(T[worst, :3, 3] * 1e3, 3) for T in (seen, own))
    raise file.error(
        field,
        f"these lengths and the URDF disagree about the flange: URDF says {at} mm, the lengths {by} mm",
        "where its zero, senses of axes or frames are others, inverse_kinematics: spherical_wrist reads them off the URDF",
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
        raise file.error(field, "an arm of seven axes, and no other, names its redundant_joint", "one of its joints")
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
    """Where a link is (4, 4) against what carries it: a joint, or the base."""
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
    """Bodies that do not move against a robot's tip while its free joints do, in the tip's frame; held ones: as `chain_of`."""
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
    """What a joint does in its own frame (6), as in Chain, read off the joint's own motion subspace."""
    q = pin.neutral(model)
    data = model.createData()
    whole = np.reshape(pin.computeJointJacobians(model, data, q), (6, model.nv))  # of one joint it comes flat
    J = whole[:, model.joints[i].idx_v]
    R = data.oMi[i].rotation.T
    # at rest a joint that slides moves all places alike; of one that turns the world's origin is of no concern
    return np.concatenate([R @ J[3:], np.zeros(3) if J[3:].any() else R @ J[:3]])


def joint_axes(model: pin.Model, i: int) -> Array:
    """Axes (k, 6) at and behind a joint (0: the base), in its frame: a point of each and its direction.

    First that of the joint itself, then those of the joints that hang on it.
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
