"""Bodies for collision checks: links from a URDF's <collision> shapes, print head and fixtures from the problem.

A link's bodies are in the frame of the joint that carries it. A nozzle whose outline is not given is long and slender,
like those sold for printing next to walls.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import unquote, urlparse
from xml.etree import ElementTree as ET

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import QhullError
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import Complaint, InputError
from planner.cell.collada import unit_of, write_without_unit
from planner.cell.pieces import convex_pieces, lean_hull
from planner.cell.solids import Body, Box, Capsule, ConvexSolid, Frustum, Hull, Look, Mesh, Solid
from planner.cell.urdf import FARTHEST, Urdf, hanging_on, link_frame, origin_of
from planner.problem import Problem
from planner.problem.cell import BodySpec, NozzleSpec
from planner.problem.mesh_files import read_corners

SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
NOZZLE, OF = "nozzle", " of "  # name of a nozzle's outline, and the text before its own name if there are several
OTHERS, CAPS = "others", "caps"  # stand for all links whose colour is not named, and for the covers on joints
THINNEST = 1e-6  # m: anything thinner is a mistake
_FLAT = 1e-6  # m: a thinner mesh has no hull
# For a nozzle whose outline is not given.
_CONE = np.radians(30.0)  # rad, half angle above the face, whose radius is the bore's diameter
_THICKNESS = 4e-3  # m by which its radius exceeds that of its face
_LENGTH = 40e-3  # m
_TUBE = 15e-3  # m, least radius of the tube that holds it, from its upper end to the middle of the flange


@dataclass(frozen=True)
class BodyRules:
    """How a robot's file wants the shapes of its URDF to be used.

    without    links that are left out, with all that hangs on them except the arm
    pieces     by link, the largest number of convex pieces for each of its meshes; one for links that are not named
    may_touch  pairs of links that may touch
    colours    of links and of their shapes, by name; `others` for all that are not named, `caps` for covers on joints
    first      the link in which the first joint turns, and the one that it moves: where the arm begins
    """

    without: tuple[str, ...] = ()
    pieces: Mapping[str, int] = field(default_factory=dict)
    may_touch: tuple[tuple[str, str], ...] = ()
    colours: Mapping[str, str] = field(default_factory=dict)
    first: tuple[str, ...] = ()

    def left_out(self, urdf: Urdf) -> set[str]:
        """Links to leave out: those of `without` and all that hangs on them, except the arm."""
        found = set[str]()
        for link in self.without:
            own = hanging_on(urdf, [link])
            above = [each for each in self.first if each in own and each != link]
            found |= own - hanging_on(urdf, above[:1])
        return found

    def beside(self, link: str) -> frozenset[str]:
        """The links that one link may touch."""
        return frozenset(b if a == link else a for a, b in self.may_touch if link in (a, b))

    def colour(self, link: str, shape: str | None = None) -> str:
        """The colour of a link's shape; empty if the file names none."""
        known = (self.colours.get(name) for name in (shape, link, OTHERS) if name)
        return next(filter(None, known), "")


def read_bodies(
    urdf: Urdf, model: pin.Model, rules: BodyRules, only: Collection[str] | None = None
) -> tuple[tuple[Body, ...], ...]:
    """Bodies by the joint of the model that carries them (0: none does), in that joint's frame; only: links to read.

    A body has its link's name, with the shape's own in brackets if it has one. Meshes become convex hulls, or several
    convex pieces. Raises InputError for shapes that cannot be read.
    """
    bodies: list[list[Body]] = [[] for _ in range(model.njoints)]
    absent = rules.left_out(urdf)
    for name, link in urdf.links().items():
        if name in absent or (only is not None and name not in only):
            continue
        frame = model.frames[link_frame(model, name)]
        for element in link.findall("collision"):
            own = element.get("name")
            called = f"{name} ({own})" if own else name
            T, solids = _link_solids(urdf, element, f"link {name}", frame.placement, rules.pieces.get(name, 1))
            look = rules.colour(name, own), rules.colours.get(CAPS, "")
            bodies[frame.parentJoint] += [Body(called, solid, T, name, rules.beside(name), *look) for solid in solids]
    return tuple(map(tuple, bodies))


def read_looks(urdf: Urdf, model: pin.Model, rules: BodyRules) -> tuple[tuple[Look, ...], ...]:
    """Visual meshes of links, by the joint that carries them, as in `read_bodies`; their files are not read yet."""
    looks: list[list[Look]] = [[] for _ in range(model.njoints)]
    absent = rules.left_out(urdf)
    for name, link in urdf.links().items():
        if name in absent:
            continue
        frame = model.frames[link_frame(model, name)]
        for element in link.findall("visual"):
            shape = element.find("geometry/mesh")
            if shape is None:
                continue
            field = f"link {name}"
            try:
                path = _mesh_path(urdf, shape, field)
                scale = urdf.numbers(shape, "scale", field, 3, "1 1 1")
                xyz, rpy = origin_of(urdf, element, field)
            except InputError:
                continue
            T = frame.placement.homogeneous @ _pose(xyz, rpy)
            colour = rules.colour(name, element.get("name")) or _material(urdf, element)
            looks[frame.parentJoint].append(Look(name, path, (scale[0], scale[1], scale[2]), T, colour))
    return tuple(map(tuple, looks))


def _material(urdf: Urdf, element: ET.Element) -> str:
    """Colour of a <visual>: its own, or that of the robot's material of the same name; empty if there is none."""
    material = element.find("material")
    if material is None:
        return ""
    known = (each for each in urdf.root.findall("material") if each.get("name") == material.get("name"))
    for each in (material, *known):
        colour = each.find("color")
        if colour is not None:
            try:
                values = np.clip(urdf.numbers(colour, "rgba", "material", 4)[:3], 0.0, 1.0)
            except InputError:
                return ""
            return "#" + "".join(f"{round(255 * value):02x}" for value in values)
    return ""


def _pose(xyz: Sequence[float], rpy: Sequence[float]) -> Array:
    return np.asarray(pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz)).homogeneous)


def _link_solids(
    urdf: Urdf, element: ET.Element, field: str, place: pin.SE3, pieces: int
) -> tuple[Array, Sequence[ConvexSolid]]:
    """Pose (4, 4) of a <collision>'s solids in the joint's frame, and the solids."""
    geometry = element.find("geometry")
    shapes = [] if geometry is None else list(geometry)
    if len(shapes) != 1:
        raise urdf.error(element, field, "a collision needs one shape", f"one of {', '.join(SHAPES)}")
    solids, shift = _solids(urdf, shapes[0], field, pieces)
    xyz, rpy = origin_of(urdf, element, field)
    T = place.homogeneous @ _pose(xyz, rpy)
    T[:3, 3] -= shift * T[:3, 2]
    return T, solids


def _solids(urdf: Urdf, shape: ET.Element, field: str, pieces: int) -> tuple[Sequence[ConvexSolid], float]:
    """The solids of a shape, and how far their origin lies below the shape's along z [m]."""
    if shape.tag == "mesh":
        return _link_hulls(urdf, shape, field, pieces), 0.0
    keys = {"box": ("size",), "sphere": ("radius",)}.get(shape.tag, ("radius", "length"))
    if shape.tag not in SHAPES:
        raise urdf.error(shape, field, f"unknown shape <{shape.tag}>", f"one of {', '.join(SHAPES)}")
    values = [value for key in keys for value in urdf.numbers(shape, key, field, 3 if key == "size" else 1)]
    if min(values) < THINNEST:
        raise urdf.error(
            shape, field, f"the {shape.tag} has a size of {min(values):g} m", "sizes are in metres, above 0"
        )
    if max(values) > FARTHEST:
        raise urdf.error(shape, field, f"the {shape.tag} has a size of {max(values):g} m", "sizes are in metres")
    if shape.tag == "box":
        return [Box((values[0], values[1], values[2]))], 0.0
    if shape.tag == "sphere":
        return [Capsule(values[0], 0.0)], 0.0
    if shape.tag == "capsule":
        return [Capsule(values[0], values[1])], 0.0
    return [Frustum(values[0], values[0], values[1])], 0.5 * values[1]


def _link_hulls(urdf: Urdf, shape: ET.Element, field: str, pieces: int) -> list[Hull]:
    try:
        if pieces > 1:
            mesh = _link_mesh(urdf, shape, field)
            return [Hull(points) for points in convex_pieces(mesh.vertices[mesh.triangles], pieces)]
        return [Hull(lean_hull(np.asarray(_loaded(urdf, shape, field).vertices(), dtype=np.float64)))]
    except (QhullError, ValueError):
        name = shape.get("filename", "").rsplit("/", 1)[-1]
        raise urdf.error(shape, field, f"mesh {name} encloses nothing", "all its points lie in one plane") from None


def _link_mesh(urdf: Urdf, shape: ET.Element, field: str) -> Mesh:
    """The triangles of a <mesh>, in the shape's frame [m]. Raises InputError if it cannot be read."""
    return _mesh(_loaded(urdf, shape, field))


def read_mesh(path: Path) -> Mesh:
    """The triangles of a mesh file, in its own unit, or metres for COLLADA. Raises ValueError if it cannot be read."""
    return _mesh(_read(path, np.ones(3)))


def _mesh(read: coal.BVHModelBase) -> Mesh:
    corners = (read.tri_indices(i) for i in range(read.num_tris))
    triangles = np.array([(each[0], each[1], each[2]) for each in corners], dtype=np.int64).reshape(-1, 3)
    return Mesh(np.asarray(read.vertices(), dtype=np.float64), triangles)


def drawn_meshes(urdf: Urdf, link: str, tag: str, place: Array) -> list[tuple[coal.CollisionGeometry, Array]]:
    """The meshes of a link's shapes with a tag, `visual` or `collision`, unchanged, hollows and all, and their poses
    (4, 4), with the link's frame at `place`.

    Raises InputError for meshes that cannot be read.
    """
    out, field = [], f"link {link}"
    for element in urdf.links()[link].findall(tag):
        shape = element.find("geometry/mesh")
        if shape is not None:
            xyz, rpy = origin_of(urdf, element, field)
            T = place @ _pose(xyz, rpy)
            out.append((_loaded(urdf, shape, field), T))
    return out


def _loaded(urdf: Urdf, shape: ET.Element, field: str) -> coal.BVHModelBase:
    path = _mesh_path(urdf, shape, field)
    scale = np.array(urdf.numbers(shape, "scale", field, 3, "1 1 1"))
    try:
        read = _read(path, scale)
    except ValueError as error:
        told = [
            line for line in str(error).splitlines() if line and not line.startswith(("From", "in func", "at line"))
        ]
        hint = told[1] if len(told) > 1 else None
        raise urdf.error(shape, field, f"mesh {path.name} cannot be read", hint) from None
    vertices = read.vertices()
    if not np.isfinite(vertices).all():
        raise urdf.error(shape, field, f"mesh {path.name} holds numbers that are not finite")
    if (size := float(np.ptp(vertices, axis=0).max(initial=0.0))) > FARTHEST:
        hint = 'sizes are in metres; for a file in mm, give scale="0.001 0.001 0.001"'
        raise urdf.error(shape, field, f"mesh {path.name} is {size:g} m across", hint)
    return read


def _read(path: Path, scale: Array) -> coal.BVHModelBase:
    """A mesh file as coal reads it, scaled along x, y and z. Raises ValueError if it cannot be read.

    The unit of a COLLADA file is applied, as in ROS. coal leaves that to its importer, so it gets a copy without.
    """
    if (unit := unit_of(path)) == 1.0:
        return coal.MeshLoader().load(str(path), scale)
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        write_without_unit(path, copy)
        return coal.MeshLoader().load(str(copy), unit * scale)


def _mesh_path(urdf: Urdf, shape: ET.Element, field: str) -> Path:
    """Path of a mesh: relative to the URDF, or in a package found from the folders around the URDF."""
    name = shape.get("filename")
    if not name:
        raise urdf.error(shape, field, "<mesh> has no filename")
    address = urlparse(name)
    if address.scheme == "package":
        inside = unquote(address.netloc + address.path)
        package, _, rest = inside.partition("/")
        for folder in urdf.path.resolve().parents:
            if (folder / inside).is_file():
                return folder / inside
            if (folder / rest).is_file() and _is_package(folder, package):
                return folder / rest
        if beside := _in_package_beside(urdf.path.resolve(), package, rest):
            return beside
        hint = (
            f"looked for {inside} in all folders around {urdf.path.name}, and {rest} in any whose package.xml names {package}, "
            "there and beside its own package"
        )
        raise urdf.error(shape, field, f"no mesh {name}", hint)
    path = Path(unquote(address.path)) if address.scheme == "file" else urdf.path.parent / name
    if not path.is_file():
        raise urdf.error(shape, field, f"no mesh {name}", f"looked for {path}")
    return path


def _in_package_beside(urdf: Path, package: str, rest: str) -> Path | None:
    """A file of a package next to the URDF's own, as in a ROS workspace, or in a repository of several packages."""
    own = next((folder for folder in urdf.parents if (folder / "package.xml").is_file()), None)
    if own is None:
        return None
    around = own.parent
    found = (*around.glob("*/package.xml"), *around.glob("*/*/package.xml"), *around.parent.glob("*/*/package.xml"))
    folders = (manifest.parent for manifest in sorted(found))
    return next((each / rest for each in folders if (each / rest).is_file() and _is_package(each, package)), None)


def _is_package(folder: Path, name: str) -> bool:
    """Whether a folder holds the ROS package of a name, whatever it is called: downloads add their branch's name."""
    try:
        said = re.search(r"<name>\s*([^<]*?)\s*</name>", (folder / "package.xml").read_text("utf-8", "replace"))
    except OSError:
        return False
    return said is not None and said[1] == name


def nozzle_profile(spec: NozzleSpec) -> tuple[tuple[float, float], ...]:
    """Pairs of height above the tip and radius [m], from the tip up: as given, or assumed from the bore."""
    if spec.profile is not None:
        return spec.profile
    face, thick = spec.diameter, spec.diameter + _THICKNESS
    return (0.0, face), (_THICKNESS / float(np.tan(_CONE)), thick), (_LENGTH, thick)


def head_bodies(problem: Problem, spec: NozzleSpec, key: str, T_flange_nozzle: Array) -> tuple[Body, ...]:
    """Nozzle and print head in the nozzle frame, whose z points into the part; key: of the nozzle in the problem file.

    Raises InputError for a mesh that cannot be read.
    """
    profile = nozzle_profile(spec)
    upwards = np.diag([1.0, -1.0, -1.0, 1.0])
    bodies = []
    for (low, bottom), (high, top) in itertools.pairwise(profile):
        if high > low:
            T = upwards.copy()
            T[2, 3] = -low
            bodies.append(Body(NOZZLE, Frustum(bottom, top, high - low), T))
    T_nozzle_flange = np.asarray(np.linalg.inv(T_flange_nozzle), dtype=float)
    if spec.head is None:
        thick = _TUBE if spec.profile is not None else profile[-1][1]
        bodies += _tube(np.array([0.0, 0.0, -profile[-1][0]]), T_nozzle_flange[:3, 3], thick)
    for name, own in (spec.head or {}).items():
        where = partial(problem.error, f"{key}.head.{name}")
        body = _solid_body(f"head {name}", own, where)
        solid = _mesh_hull(body.solid, where) if isinstance(body.solid, Mesh) else body.solid
        bodies.append(Body(body.name, solid, T_nozzle_flange @ body.T_frame_solid))
    return tuple(bodies)


def _tube(low: Array, flange: Array, thick: float) -> list[Body]:
    """The assumed holder of the nozzle: a tube from its upper end to the middle of the flange, if there is room for it.

    thick: the tube's radius [m], if that is more than _TUBE
    """
    way = flange - low
    length = float(np.linalg.norm(way))
    if length <= 2.0 * _TUBE:
        return []
    radius = max(_TUBE, min(thick, 0.5 * length))
    way = way / length
    # its round ends lie within the nozzle's upper end and the flange
    aside = np.cross(way, np.eye(3)[int(np.argmin(np.abs(way)))])
    aside /= np.linalg.norm(aside)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([aside, np.cross(way, aside), way])
    T[:3, 3] = low + 0.5 * (_TUBE + length) * way
    return [Body("print head", Capsule(radius, length - _TUBE - 2.0 * (radius - _TUBE)), T)]


def fixture_bodies(problem: Problem, carrier: str) -> tuple[Body, ...]:
    """Fixtures on `carrier`, "world" or "part", in its frame. Raises InputError for a mesh that cannot be read."""
    return tuple(
        _solid_body(name, spec, partial(problem.error, f"cell.fixtures.{name}"))
        for name, spec in problem.cell.fixtures.items()
        if spec.on == carrier
    )


def _solid_body(name: str, spec: BodySpec, where: Complaint) -> Body:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", spec.rpy).as_matrix()
    T[:3, 3] = spec.centre
    if spec.mesh is not None:
        corners = read_corners(spec.mesh, where)
        return Body(name, Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)), T)
    solid: Solid
    if spec.cylinder is not None:
        solid = Frustum(spec.cylinder.radius, spec.cylinder.radius, spec.cylinder.height)
        T[:3, 3] -= 0.5 * spec.cylinder.height * T[:3, 2]
    else:
        solid = Box(spec.box or (0.0, 0.0, 0.0))
    return Body(name, solid, T)


def _mesh_hull(mesh: Mesh, where: Complaint) -> Hull:
    if np.linalg.matrix_rank(mesh.vertices - mesh.vertices[0], tol=_FLAT) < 3:
        raise where("its facets lie in one plane", hint="a body needs a volume")
    return Hull(lean_hull(mesh.vertices))
