"""robots/*.yaml and the URDF that each names -> Robot. The URDF may come from an installed package."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError

from planner.errors import InputError, nearest_name
from planner.kinematics.axes import OtherGeometry
from planner.kinematics.chain import Chain
from planner.kinematics.corrected import Corrected
from planner.kinematics.inverse import InverseKinematics
from planner.kinematics.offset_wrist import OffsetWrist, read_offset_wrist
from planner.kinematics.seven_axes import SevenAxes, read_seven_axes
from planner.kinematics.spherical_wrist import SphericalWrist
from planner.problem import Problem
from planner.robot_bodies import read_bodies
from planner.robot_urdf import Urdf, model_of, read_urdf, turning_joints
from planner.solids import Body

Array = NDArray[np.float64]
ROBOTS = Path(__file__).resolve().parent.parent / "robots"
REQUIRED = ("name", "urdf", "tip", "acceleration_rad_s2", "jerk_rad_s3")
OPTIONAL = (
    "speed_rad_s",
    "range_deg",
    "without",
    "assumed",
    "spherical_wrist",
    "inverse_kinematics",
    "redundant_joint",
)
KINDS = ("offset_wrist", "seven_axes")  # spherical wrists have a section of their own, with their lengths
_SAME_POSE = 1e-9  # m: closed form and URDF are one arm
_POSTURES = 20


@dataclass(frozen=True)
class Robot:
    """One robot as its files describe it: a Pinocchio model of the joints from base to tip, its tip frame, and what
    a URDF cannot say; no inverse kinematics if it is not an arm.

    bodies   one tuple for each joint index of the model (0: what does not move), in the joint's frame; all empty if
             the URDF has no collision shapes
    """

    key: str
    name: str
    model: pin.Model
    tip: str
    acceleration: Array
    jerk: Array
    inverse: InverseKinematics | None
    assumed: tuple[str, ...]
    bodies: tuple[tuple[Body, ...], ...]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in joint order, base first."""
        return tuple(self.model.names[1:])


@dataclass(frozen=True)
class RobotFile:
    """A robot's YAML file, read: its values, and where they stand."""

    path: Path
    data: Mapping[str, Any]

    def error(self, field: str, reason: str, hint: str | None = None) -> InputError:
        """Return the error of a field, with file and line."""
        line = self.data.lc.key(field)[0] + 1 if field in self.data else None  # type: ignore[attr-defined]
        return InputError(reason, file=self.path, line=line, field=field, hint=hint)

    def numbers(self, field: str, count: int) -> Array:
        """The positive numbers (count) of a field."""
        value = self.data[field]
        right = isinstance(value, list) and all(_is_number(v) and 0.0 < v < np.inf for v in value)
        if not right or len(value) != count:
            raise self.error(field, f"must be a list of {count} positive numbers", "one for each joint, base first")
        return np.array([float(v) for v in value])

    def ranges(self, joints: Collection[str]) -> dict[str, tuple[float, float]]:
        """Ranges [rad] by joint that stand in place of the URDF's."""
        given = self.data.get("range_deg", {})
        if not isinstance(given, Mapping):
            raise self.error("range_deg", "must be ranges by joint", "for example {joint_6: [-400, 400]}")
        for name, pair in given.items():
            if name not in joints:
                near = nearest_name(str(name), joints)
                hint = f"did you mean {near}?" if near else f"joints: {', '.join(joints)}"
                raise self.error("range_deg", f"no joint {name!r}", hint)
            right = isinstance(pair, list) and len(pair) == 2 and all(_is_number(v) and np.isfinite(v) for v in pair)
            if not right or not pair[0] < pair[1]:
                raise self.error(
                    "range_deg", f"{name} must have a least and a greatest angle", "for example [-400, 400]"
                )
        return {
            name: (np.radians(float(pair[0])).item(), np.radians(float(pair[1])).item()) for name, pair in given.items()
        }


def robot_names(folder: Path = ROBOTS) -> list[str]:
    """Keys of the robots that ship."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def load_robot(key: str, problem: Problem, field: str) -> Robot:
    """Read robots/<key>.yaml and the URDF that it names; InputError where there is none."""
    if key not in robot_names():
        near = nearest_name(key, robot_names())
        known = ", ".join(robot_names())
        raise problem.error(field, f"unknown robot {key!r}", f"did you mean {near}?" if near else f"known: {known}")
    return read_robot(ROBOTS / f"{key}.yaml")


def read_robot(path: Path) -> Robot:
    """Read a robot's YAML file and its URDF. Raises InputError for whatever is wrong with them."""
    file = _read(path)
    data = file.data
    urdf = read_urdf(urdf_path(file))
    model = _model(file, urdf)
    n = model.njoints - 1
    return Robot(
        key=path.stem,
        name=str(data["name"]),
        model=model,
        tip=data["tip"],
        acceleration=file.numbers("acceleration_rad_s2", n),
        jerk=file.numbers("jerk_rad_s3", n),
        inverse=_inverse(file, model),
        assumed=tuple(data.get("assumed", ())),
        bodies=read_bodies(urdf, model, _without(file, urdf)),
    )


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _read(path: Path) -> RobotFile:
    try:
        data = YAML().load(path)
    except MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise InputError("is not valid YAML", file=path, line=line, hint=error.problem) from None
    if not isinstance(data, Mapping):
        raise InputError("must be `key: value` lines", file=path)
    file = RobotFile(path, data)
    for key in data:
        if key not in REQUIRED + OPTIONAL:
            near = nearest_name(str(key), REQUIRED + OPTIONAL)
            hint = f"did you mean {near}?" if near else f"known keys: {', '.join(REQUIRED + OPTIONAL)}"
            raise file.error(key, "unknown key", hint)
    for key in REQUIRED:
        if key not in data:
            raise file.error(key, "is missing")
    return file


def urdf_path(file: RobotFile) -> Path:
    """Where a robot's URDF is: beside its YAML file, or `path` in the shared files of an installed `package`."""
    urdf = file.data["urdf"]
    if isinstance(urdf, str):
        path, hint = file.path.parent / urdf, "counted from the robot's file"
    elif isinstance(urdf, Mapping) and set(urdf) == {"package", "path"}:
        package = str(urdf["package"])
        try:
            found = metadata.distribution(package)
        except metadata.PackageNotFoundError:
            hint = f"pip install -r requirements.txt, or pip install {package}"
            raise file.error("urdf", f"package {package} is not installed", hint) from None
        # wheels made by cmeel keep what would be below /usr in a folder of their own, and have no module to import
        path = Path(str(found.locate_file("cmeel.prefix"))) / "share" / package / str(urdf["path"])
        hint = f"counted from share/{package} of {package} {found.version}"
    else:
        raise file.error("urdf", "must be a file name, or a package and a path", "for example arm.urdf")
    if not path.is_file():
        raise file.error("urdf", f"no file {path.name}", hint)
    return path


def _model(file: RobotFile, urdf: Urdf) -> pin.Model:
    """Pinocchio's model of the joints from base to tip, with the ranges and speeds that the robot's file knows."""
    tip, links = file.data["tip"], urdf.links()
    if tip not in links:
        near = nearest_name(str(tip), links)
        raise file.error("tip", f"no link {tip!r}", f"did you mean {near}?" if near else f"links: {', '.join(links)}")
    joints = turning_joints(urdf, tip)
    if not joints:
        raise file.error("tip", f"no joint turns between the base and {tip}")
    model = model_of(urdf, tip, file.ranges(joints), "speed_rad_s" in file.data)
    if "speed_rad_s" in file.data:
        model.velocityLimit = file.numbers("speed_rad_s", len(joints))
    return model


def _without(file: RobotFile, urdf: Urdf) -> tuple[str, ...]:
    """Links of the URDF that this robot has not."""
    names = file.data.get("without", [])
    if not isinstance(names, list):
        raise file.error("without", "must be a list of links", "for example [hand]")
    links = urdf.links()
    for name in names:
        if name not in links:
            near = nearest_name(str(name), links)
            hint = f"did you mean {near}?" if near else f"links: {', '.join(links)}"
            raise file.error("without", f"no link {name!r}", hint)
    return tuple(names)


def _inverse(file: RobotFile, model: pin.Model) -> InverseKinematics | None:
    """The closed form that the file names, held to the URDF; corrected where an arm is nearly of its kind."""
    data = file.data
    given = [key for key in ("spherical_wrist", "inverse_kinematics") if key in data]
    if not given:
        return None
    if len(given) > 1:
        raise file.error(given[1], "spherical_wrist is given as well", "an arm has one inverse kinematics")
    field = given[0]
    chain = _fold(model, data["tip"], np.eye(4), np.eye(4), tuple(model.names[1:]), {})
    inverse = _spherical(file, chain) if field == "spherical_wrist" else _read_off(file, chain)
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (_POSTURES, len(chain)))
    seen, own = chain.poses(q), inverse.poses(q)
    if np.allclose(seen, own, rtol=0.0, atol=_SAME_POSE):
        return inverse
    if not isinstance(inverse, SphericalWrist):
        return Corrected(inverse, chain)
    worst = int(np.argmax(np.abs(seen - own).max(axis=(1, 2))))
    raise file.error(
        field,
        "these lengths and the URDF disagree about the flange",
        f"URDF says {np.round(seen[worst, :3, 3] * 1e3, 3)} mm, the lengths {np.round(own[worst, :3, 3] * 1e3, 3)} mm",
    )


def _spherical(file: RobotFile, chain: Chain) -> SphericalWrist:
    lengths = file.data["spherical_wrist"]
    keys = [f"{name}_mm" for name in ("a1", "a2", "b", "c1", "c2", "c3", "c4")]
    if not isinstance(lengths, Mapping) or set(lengths) != set(keys):
        raise file.error("spherical_wrist", "must give the seven OPW lengths", ", ".join(keys))
    if not all(_is_number(value) for value in lengths.values()):
        raise file.error("spherical_wrist", "the lengths must be numbers", "millimetres")
    if len(chain) != 6:
        raise file.error("spherical_wrist", f"an arm with a spherical wrist has 6 joints, not {len(chain)}")
    return SphericalWrist(*(float(lengths[key]) * 1e-3 for key in keys))


def _read_off(file: RobotFile, chain: Chain) -> OffsetWrist | SevenAxes:
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
        if redundant not in chain.names:
            raise file.error("redundant_joint", f"no joint {redundant!r}", f"joints: {', '.join(chain.names)}")
        return read_seven_axes(chain, chain.names.index(str(redundant)))
    except OtherGeometry as error:
        raise file.error("inverse_kinematics", f"not an arm of the kind {kind}: {error}") from None


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
            T = T @ pin.SE3(pin.AngleAxis(held[name], axis).toRotationMatrix(), np.zeros(3)).homogeneous
    frame = model.frames[model.getFrameId(tip)]
    T = T @ frame.placement.homogeneous @ T_tip_tool
    n = len(names)
    return Chain(tuple(names), np.array(placements).reshape(n, 4, 4), np.array(axes).reshape(n, 3), T)


def bodies_with_tip(robot: Robot, free: Collection[str], held: Mapping[str, float]) -> tuple[Body, ...]:
    """Bodies that do not move against a robot's tip while its free joints do, in the tip's frame; held ones: as `chain_of`."""
    model, data = robot.model, robot.model.createData()
    q = np.array([held.get(name, 0.0) for name in robot.joint_names])
    pin.forwardKinematics(model, data, q)
    T_tip_base = pin.updateFramePlacement(model, data, model.getFrameId(robot.tip)).inverse()
    first = max((1 + robot.joint_names.index(name) for name in free), default=0)
    return tuple(
        Body(body.name, body.solid, (T_tip_base * data.oMi[i]).homogeneous @ body.T_frame_solid)
        for i in range(first, model.njoints)
        for body in robot.bodies[i]
    )


def joint_axis(model: pin.Model, i: int) -> Array:
    """Unit axis of a revolute joint in its own frame, read off the joint's own motion subspace."""
    q = pin.neutral(model)
    data = model.createData()
    J = pin.computeJointJacobians(model, data, q)
    return np.asarray(data.oMi[i].rotation.T @ J[3:, model.joints[i].idx_v])
