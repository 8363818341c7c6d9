"""The URDF of a Pinocchio model: its joints, links and limits, and the shapes given with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from planner.base.arrays import Array
from planner.base.errors import InputError, OutputError
from planner.robots.survey import key_of

_STRAIGHT = 1e-9  # tolerance on a joint's motion: it only turns, about its own origin, or only slides
_SAME = 1e-12  # tolerance at which a placement is the identity
_ENDLESS = 1e6  # rad, m: limits beyond this count as none


def written_urdf(model: Any, bodies: Any, robot_file: Path | None) -> tuple[Path, bool]:
    """Write a model's URDF next to a robot's file, or into the current folder; return its path, and whether it is new.

    Raises InputError for anything but a model that a URDF can describe, OutputError if it cannot be written.
    """
    if not isinstance(model, pin.Model):
        hint = "a path, or what pinocchio.buildModelFromUrdf gives"
        raise InputError(
            f"must be a URDF or a model of Pinocchio, not of type {type(model).__name__}", field="urdf", hint=hint
        )
    if bodies is not None and not isinstance(bodies, pin.GeometryModel):
        raise InputError(f"must be a GeometryModel, not of type {type(bodies).__name__}", field="bodies")
    text = urdf_of(model, bodies)
    target = Path(f"{key_of(model.name)}.urdf") if robot_file is None else robot_file.with_suffix(".urdf")
    try:
        there = target.exists()
        if there:
            if target.read_text(encoding="utf-8") != text:
                raise OutputError(f"{target} is there already, and does not describe this model: choose another name")
        else:
            target.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error
    return target, not there


def urdf_of(model: pin.Model, bodies: pin.GeometryModel | None) -> str:
    """The text of a URDF with the same kinematics. Raises InputError for joints that move in more than one way."""
    robot = ET.Element("robot", name=model.name or "robot")
    links = _link_names(model)
    shapes = {j: ET.SubElement(robot, "link", name=name) for j, name in links.items()}
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for j in range(1, model.njoints):
        _joint(
            robot, model, j, np.reshape(pin.getJointJacobian(model, data, j, pin.ReferenceFrame.LOCAL), (6, -1)), links
        )
    taken = {*links.values()}
    for frame in model.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME) and frame.name not in taken:
            taken.add(frame.name)
            ET.SubElement(robot, "link", name=frame.name)
            fixed = ET.SubElement(robot, "joint", name=f"to_{frame.name}", type="fixed")
            _ends(fixed, links[int(frame.parentJoint)], frame.name, frame.placement)
    for i, shape in enumerate(bodies.geometryObjects if bodies is not None else ()):
        _collision(shapes[int(shape.parentJoint)], shape, i)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _link_names(model: pin.Model) -> dict[int, str]:
    """Link names by joint (0: the base): that of a body frame that coincides with the joint's, or one from its name."""
    names: dict[int, str] = {}
    for frame in model.frames:
        j = int(frame.parentJoint)
        if (
            frame.type == pin.FrameType.BODY
            and j not in names
            and frame.name != "universe"
            and _is_none(frame.placement)
        ):
            names[j] = frame.name
    taken = {*names.values(), *(frame.name for frame in model.frames)}
    for j in range(model.njoints):
        if j not in names:
            name = "base_of_the_model" if j == 0 else f"link_of_{model.names[j]}"
            while name in taken:
                name += "_"
            names[j] = name
    return dict(sorted(names.items()))


def _is_none(placement: pin.SE3) -> bool:
    return bool(np.abs(placement.homogeneous - np.eye(4)).max() <= _SAME)


def _joint(robot: ET.Element, model: pin.Model, j: int, motion: Array, links: dict[int, str]) -> None:
    name, q, v = model.names[j], model.idx_qs[j], model.idx_vs[j]
    if model.nvs[j] != 1:
        reason = f"joint {name} has {model.nvs[j]} degrees of freedom"
        raise InputError(reason, field="urdf", hint="joints of an arm turn about one axis, or slide along one")
    along, about = motion[:3, v], motion[3:, v]
    turns = np.linalg.norm(about) > 0.5
    if np.linalg.norm(along if turns else about) > _STRAIGHT:
        raise InputError(f"joint {name} neither turns about an axis nor slides along one", field="urdf")
    endless = model.nqs[j] != 1 or max(abs(model.lowerPositionLimit[q]), abs(model.upperPositionLimit[q])) > _ENDLESS
    kind = ("continuous" if endless else "revolute") if turns else "prismatic"
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    _ends(joint, links[int(model.parents[j])], links[j], model.jointPlacements[j])
    ET.SubElement(joint, "axis", xyz=_text(about if turns else along))
    limit = {"effort": _number(model.effortLimit[v]), "velocity": _number(model.velocityLimit[v])}
    if not endless:
        limit |= {"lower": repr(float(model.lowerPositionLimit[q])), "upper": repr(float(model.upperPositionLimit[q]))}
    ET.SubElement(joint, "limit", limit)


def _ends(joint: ET.Element, parent: str, child: str, placement: pin.SE3) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    _origin(joint, placement)


def _origin(element: ET.Element, placement: pin.SE3) -> None:
    ET.SubElement(
        element, "origin", xyz=_text(placement.translation), rpy=_text(pin.rpy.matrixToRpy(placement.rotation))
    )


def _collision(link: ET.Element, shape: Any, index: int) -> None:
    """Add a shape to its link, whose frame is that of its joint."""
    geometry, kind = shape.geometry, type(shape.geometry).__name__
    collision = ET.SubElement(link, "collision", name=shape.name)
    _origin(collision, shape.placement)
    inside = ET.SubElement(collision, "geometry")
    if kind == "Box":
        ET.SubElement(inside, "box", size=_text(2.0 * np.asarray(geometry.halfSide)))
    elif kind == "Sphere":
        ET.SubElement(inside, "sphere", radius=repr(float(geometry.radius)))
    elif kind == "Cylinder":
        length = repr(2.0 * float(geometry.halfLength))
        ET.SubElement(inside, "cylinder", radius=repr(float(geometry.radius)), length=length)
    elif shape.meshPath and Path(shape.meshPath).is_file():
        path = str(Path(shape.meshPath).resolve())
        ET.SubElement(inside, "mesh", filename=path, scale=_text(np.asarray(shape.meshScale).ravel()))
    else:
        hint = "boxes, balls, cylinders and meshes with their files"
        raise InputError(f"{shape.name} is of type {kind}", field=f"bodies.geometryObjects[{index}]", hint=hint)


def _number(value: float) -> str:
    """A limit as text; 0, which means none, if it is endless."""
    return repr(float(value)) if np.isfinite(value) and abs(value) < _ENDLESS else "0"


def _text(values: Array) -> str:
    return " ".join(repr(float(value) + 0.0) for value in np.asarray(values).ravel())
