"""The bodies of a robot: the <collision> shapes of its URDF, each in the frame of the joint that carries it."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlparse
from xml.etree import ElementTree as ET

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from planner.robot.urdf import FARTHEST, Urdf, hanging_on, origin_of
from planner.solids import Body, Box, Capsule, ConvexSolid, Frustum, Hull

SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
THINNEST = 1e-6  # m: what is thinner is a mistake


def read_bodies(urdf: Urdf, model: pin.Model, without: tuple[str, ...]) -> tuple[tuple[Body, ...], ...]:
    """Bodies by the joint of the model that carries them (0: none does), in that joint's frame.

    A link's body bears its name, with the shape's own in brackets where it has one. Meshes become their convex hulls.
    Links `without`, and what hangs on them, are left out. Raises InputError for shapes that cannot be read.
    """
    bodies: list[list[Body]] = [[] for _ in range(model.njoints)]
    absent = hanging_on(urdf, without)
    for name, link in urdf.links().items():
        if name in absent:
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        for element in link.findall("collision"):
            own = element.get("name")
            body = _body(urdf, element, f"{name} ({own})" if own else name, f"link {name}", frame.placement)
            bodies[frame.parentJoint].append(body)
    return tuple(map(tuple, bodies))


def _body(urdf: Urdf, element: ET.Element, name: str, field: str, place: pin.SE3) -> Body:
    geometry = element.find("geometry")
    shapes = [] if geometry is None else list(geometry)
    if len(shapes) != 1:
        raise urdf.error(element, field, "a collision needs one shape", f"one of {', '.join(SHAPES)}")
    solid, shift = _solid(urdf, shapes[0], field)
    xyz, rpy = origin_of(urdf, element, field)
    T = place.homogeneous @ pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz)).homogeneous
    T[:3, 3] -= shift * T[:3, 2]
    return Body(name, solid, T)


def _solid(urdf: Urdf, shape: ET.Element, field: str) -> tuple[ConvexSolid, float]:
    """The solid, and how far below the shape's origin its own lies along z [m]."""
    if shape.tag == "mesh":
        return _hull(urdf, shape, field), 0.0
    keys = {"box": ("size",), "sphere": ("radius",)}.get(shape.tag, ("radius", "length"))
    if shape.tag not in SHAPES:
        raise urdf.error(shape, field, f"unknown shape <{shape.tag}>", f"one of {', '.join(SHAPES)}")
    values = [value for key in keys for value in urdf.numbers(shape, key, field, 3 if key == "size" else 1)]
    if min(values) < THINNEST:
        raise urdf.error(shape, field, f"the {shape.tag} has a size of {min(values):g} m", "sizes are metres, above 0")
    if max(values) > FARTHEST:
        raise urdf.error(shape, field, f"the {shape.tag} has a size of {max(values):g} m", "sizes are metres")
    if shape.tag == "box":
        return Box((values[0], values[1], values[2])), 0.0
    if shape.tag == "sphere":
        return Capsule(values[0], 0.0), 0.0
    if shape.tag == "capsule":
        return Capsule(values[0], values[1]), 0.0
    return Frustum(values[0], values[0], values[1]), 0.5 * values[1]


def _hull(urdf: Urdf, shape: ET.Element, field: str) -> Hull:
    path = _mesh_path(urdf, shape, field)
    scale = np.array(urdf.numbers(shape, "scale", field, 3, "1 1 1"))
    try:
        vertices = np.asarray(coal.MeshLoader().load(str(path), scale).vertices(), dtype=np.float64)
    except ValueError as error:
        told = [
            line for line in str(error).splitlines() if line and not line.startswith(("From", "in func", "at line"))
        ]
        hint = told[1] if len(told) > 1 else None
        raise urdf.error(shape, field, f"mesh {path.name} cannot be read", hint) from None
    if not np.isfinite(vertices).all():
        raise urdf.error(shape, field, f"mesh {path.name} holds numbers that are not finite")
    if (size := float(np.ptp(vertices, axis=0).max(initial=0.0))) > FARTHEST:
        hint = 'sizes are metres; of a file in mm, scale="0.001 0.001 0.001"'
        raise urdf.error(shape, field, f"mesh {path.name} is {size:g} m large", hint)
    try:
        return Hull(vertices[ConvexHull(vertices).vertices])
    except (QhullError, ValueError):
        raise urdf.error(
            shape, field, f"mesh {path.name} encloses nothing", "all its points lie in one plane"
        ) from None


def _mesh_path(urdf: Urdf, shape: ET.Element, field: str) -> Path:
    """Where a mesh is: beside the URDF, or in the package that a folder around the URDF holds."""
    name = shape.get("filename")
    if not name:
        raise urdf.error(shape, field, "<mesh> has no filename")
    address = urlparse(name)
    if address.scheme == "package":
        inside = unquote(address.netloc + address.path)
        for folder in urdf.path.resolve().parents:
            if (folder / inside).is_file():
                return folder / inside
        hint = f"looked for {inside} in all folders around {urdf.path.name}"
        raise urdf.error(shape, field, f"no mesh {name}", hint)
    path = Path(unquote(address.path)) if address.scheme == "file" else urdf.path.parent / name
    if not path.is_file():
        raise urdf.error(shape, field, f"no mesh {name}", f"looked for {path}")
    return path
