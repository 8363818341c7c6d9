"""Facets of a body from a file: STL, PLY, OBJ, OFF, 3MF, STEP or IGES; unusable files are refused."""

from __future__ import annotations

import io
import logging
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Ints
from planner.base.budgets import MESH_BYTES, MESH_FACETS
from planner.base.errors import Complaint
from planner.base.extras import missing_extra
from planner.base.files import read_bytes
from planner.base.warned import warnings_are
from planner.problem.cad_files import IGES_ENDINGS, STEP_ENDINGS, facets_of_bodies, is_cad
from planner.problem.part import UNITS, MeshSpec

if TYPE_CHECKING:
    import trimesh

MOST_FACETS, LARGEST_FILE = MESH_FACETS.most, MESH_BYTES.most
FARTHEST = 100_000.0  # mm from the origin: a hall
SUFFIXES = (".stl", ".ply", ".obj", ".off", ".3mf", *STEP_ENDINGS, *IGES_ENDINGS)
SMALLEST, GREATEST = 5.0, 20_000.0  # mm across, of a body to print or to print on: outside, the unit must be wrong
_LIKELY = (20.0, 2000.0)  # mm across: units that give such a size are suggested
_HEADER = 84  # bytes of a binary STL file before its facets, of _FACET bytes each
_FACET = 50
_SOLID = re.compile(rb"^([ \t]*(?:end)?solid)\b[^\r\n]*", re.MULTILINE | re.IGNORECASE)  # with any name
_THINNEST = 1e-9  # mm, height of a facet over its longest side: below, it is a line without a normal
_MODEL_HEAD = 65_536  # bytes of a 3MF model that contain its unit
_UNITS_3MF = {"micron": "um", "millimeter": "mm", "centimeter": "cm", "inch": "in", "foot": "ft", "meter": "m"}
_MODEL_3MF = "3d/3dmodel.model"  # in lower case: the model that the other parts of a file belong to
_NUMBER_3MF = re.compile(rb"<(?:\w+:)?object\b[^>]*?\sid\s*=\s*[\"'](\d+)")
_BODY_3MF = re.compile(rb"<(?:\w+:)?mesh\b")
_OFF_REMARK = re.compile(rb"#[^\n]*")
_OFF_MANY = re.compile(rb"^[ \t]*(?:[5-9]|[1-9]\d+)(?:[ \t]+\d+){5}", re.MULTILINE)  # a facet of five corners or more
_FOLD = 1e-4  # × the file's extent: how far rounded corners may be off the line between others
# Raised by trimesh's readers for files that are damaged or of another format.
_UNREADABLE = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, NameError, NotImplementedError, RuntimeError,
    SyntaxError, TypeError, ValueError, Warning, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def read_facets(spec: MeshSpec, where: Complaint, lines: bool = False) -> Array:
    """Facets (n, 3, 3) of a body [m] in the part frame; otherwise as `read_corners`.

    Also raises the InputError of `where` for a body of implausible size, if no unit is given.
    """
    corners = read_corners(spec.file, where, spec.unit, spec.scale, lines)
    across = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) * 1e3
    if spec.unit is None and not SMALLEST <= across <= GREATEST:
        unit = unit_of(spec.file, where)
        sizes = {name: across * mm / UNITS[unit] for name, mm in UNITS.items() if name != unit}
        likely = [
            f"unit: {name} makes it {size:.4g} mm" for name, size in sizes.items() if _LIKELY[0] <= size <= _LIKELY[1]
        ]
        what = f"{spec.file.name} is {across:.4g} mm across" + (
            "" if spec.scale == 1.0 else f" at scale {spec.scale:g}"
        )
        hint = "; ".join([*likely, f"unit: {unit} keeps that size", "or give scale"])
        raise where(f"{what}, with lengths in {unit}", hint=hint)
    turn = Rotation.from_euler("xyz", spec.rpy).as_matrix()
    return np.asarray(corners @ turn.T + np.asarray(spec.origin))


def read_corners(
    path: Path, where: Complaint, unit: str | None = None, scale: float = 1.0, lines: bool = False
) -> Array:
    """Facets (n, 3, 3) of a file [m], counter-clockwise seen from outside; those without an area only if `lines`.

    `where(reason, hint=...)` makes the InputError for what is wrong with the file, such as facets that are inside out.
    unit: of the file's lengths, one of UNITS; default: the one that it states, else mm.
    """
    data = read_bytes(path, LARGEST_FILE, where, _FEWER)
    kind = _kind(path, data)
    with np.errstate(invalid="ignore", over="ignore"):  # corners that are not numbers are refused below
        mesh = _READERS[kind](path, data, where)
    name = path.name
    faces = np.asarray(mesh.faces).reshape(-1, 3)
    if len(faces) == 0:
        raise where(f"{name} holds no facets")
    if len(faces) > MOST_FACETS:
        raise where(f"{name} has {len(faces)} facets", hint=_FEWER)
    if np.shape(mesh.vertices)[1:] != (3,):
        raise where(f"{name} is damaged: its corners do not have three coordinates each")
    if faces.min() < 0 or faces.max() >= len(mesh.vertices):
        raise where(f"{name} is damaged: a facet refers to a corner that is not among its {len(mesh.vertices)}")
    mm = UNITS[unit or _unit(kind, data)] * scale
    corners = np.asarray(mesh.vertices, dtype=float)[faces] * mm
    if not (np.abs(corners) <= FARTHEST).all():  # NaN is not
        raise where(
            f"{name} has a corner that is not a number, or is farther than {FARTHEST / 1e3:g} m from the origin"
        )
    mesh.merge_vertices(merge_tex=True, merge_norm=True)  # by position alone
    corners = corners[_once(np.asarray(mesh.faces))]
    areas = with_area(corners)
    if len(areas) == 0:
        raise where(f"{name} holds no facet with an area")
    if mesh.is_watertight and mesh.volume < 0.0:
        raise where(f"{name} is inside out: its facets face inwards", hint="flip its normals in a CAD program")
    return np.asarray((corners if lines else areas) * 1e-3)


def _once(faces: Ints) -> Ints:
    """Indices of the facets (n, 3), given by their corners, to keep: of equal ones facing the same way, the first."""
    first = np.argmin(faces, axis=1)
    turned = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    return np.sort(np.unique(turned, axis=0, return_index=True)[1])


def with_area(corners: Array) -> Array:
    """Those of facets (n, 3, 3) that have an area."""
    edges = np.roll(corners, -1, axis=1) - corners
    across = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    return corners[across > _THINNEST * np.maximum(longest, _THINNEST)]


def unit_of(path: Path, where: Complaint) -> str:
    """The unit that a file states for its lengths, else mm."""
    data = read_bytes(path, LARGEST_FILE, where, _FEWER)
    return _unit(_kind(path, data), data)


_FEWER = f"make a mesh of fewer facets, at most {MOST_FACETS}"


def _kind(path: Path, data: bytes) -> str:
    """A file's format by its first bytes, or by its name if these say nothing; else STL."""
    if is_cad(path, data):
        return "cad"
    first = data[:6].lstrip()
    if first[:3] == b"ply" and first[3:4] in (b"\n", b"\r"):
        return "ply"
    if first[:2] == b"PK":
        return "3mf"
    if first[:3] == b"OFF" or path.suffix.lower() == ".off":
        return "off"
    return "obj" if path.suffix.lower() == ".obj" else "stl"


def _unit(kind: str, data: bytes) -> str:
    """The unit that a file states for its lengths, else mm."""
    if kind != "3mf":
        return "mm"
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            name = next(name for name in archive.namelist() if name.lower().endswith(".model"))
            with archive.open(name) as model:
                head = model.read(_MODEL_HEAD)
    except (*_UNREADABLE, StopIteration):
        return "mm"
    found = re.search(rb"<model\b[^>]*\bunit\s*=\s*[\"'](\w+)", head)
    return _UNITS_3MF.get(found.group(1).decode("ascii", "replace"), "mm") if found else "mm"


# Importing trimesh takes a third of a second: done only where there is a file to read.


def _stl(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    """Some binary files begin with the keyword of text files: what counts is whether facets are in text."""
    text = data.lstrip()[:5].lower() == b"solid" and (b"facet" in data[:4096].lower() or len(data) < _HEADER)
    return _text(path, data, where) if text else _binary(path, data, where)


def _binary(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    import trimesh

    if len(data) < _HEADER:
        raise where(f"{path.name} is not an STL file: it has {len(data)} bytes")
    (count,) = struct.unpack("<I", data[80:_HEADER])
    there = (len(data) - _HEADER) // _FACET
    if len(data) != _HEADER + _FACET * count:
        raise where(
            f"{path.name} is not an STL file, or is damaged: it announces {count} facets but has room for {there}"
        )
    _check_count(path, count, where)
    parts = trimesh.exchange.stl.load_stl_binary(io.BytesIO(data))
    return trimesh.Trimesh(vertices=parts["vertices"], faces=parts["faces"], process=False)


def _text(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    import trimesh

    data = _SOLID.sub(rb"\1", data)
    words = data.lower()
    count = words.count(b"endfacet")
    _check_count(path, count, where)
    reason = f"{path.name} is damaged"
    try:
        with warnings_are("error"):
            mesh = trimesh.load_mesh(io.BytesIO(data), file_type="stl_ascii", process=False)
    except (ValueError, IndexError, KeyError, TypeError, Warning, trimesh.exchange.stl.HeaderError) as error:
        raise where(f"{reason}: {error}") from error
    found = len(mesh.faces)
    if not words.count(b"facet normal") == count == words.count(b"vertex") / 3 or b"endsolid" not in words:
        raise where(f"{reason}: it ends, or has a gap, within a facet")
    if not 0 < found <= count:
        raise where(f"{reason}: {count} facets begin but only {found} can be read")
    return mesh


def _ply(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    head = data[: data.find(b"end_header")].decode("ascii", "replace") if b"end_header" in data else ""
    counts = re.search(r"^element\s+face\s+(\d+)", head, re.MULTILINE)
    if counts is None or int(counts.group(1)) == 0:
        raise where(f"{path.name} holds no facets", hint="points alone are not a surface: make a mesh of them")
    announced = int(counts.group(1))
    _check_count(path, announced, where)
    mesh = _by_trimesh(path, data, "ply", where)
    if len(mesh.faces) < announced:
        raise where(f"{path.name} is damaged: it announces {announced} facets but only {len(mesh.faces)} can be read")
    if len(mesh.faces) > announced:
        _check_pieces(path, data, "ply", where)
    return mesh


def _obj(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    count = len(re.findall(rb"^[ \t]*f[ \t]", data, re.MULTILINE))
    _check_count(path, count, where)
    mesh = _by_trimesh(path, _as_utf8(data), "obj", where, skip_materials=True)
    if len(mesh.faces) < count:
        raise where(f"{path.name} is damaged: of {count} facets only {len(mesh.faces)} can be read")
    if len(mesh.faces) > count:
        _check_pieces(path, data, "obj", where)
    return mesh


def _off(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    if _OFF_MANY.search(data):
        _check_pieces(path, data, "off", where)
        return _by_trimesh(path, _off_in_triangles(data), "off", where)
    mesh = _by_trimesh(path, _as_utf8(data), "off", where)
    head = re.search(rb"OFF\s+\d+\s+(\d+)", _OFF_REMARK.sub(b"", data))
    if head is None or len(mesh.faces) > int(head[1]):
        _check_pieces(path, data, "off", where)
    return mesh


def _off_in_triangles(data: bytes) -> bytes:
    """An OFF file with all facets split from their first corners: trimesh reads none with more than four corners."""
    places, polygons = _polygons_of_off(data)
    facets = [(each[0], *pair) for each in polygons for pair in pairwise(each[1:])]
    head = f"OFF\n{len(places)} {len(facets)} 0"
    rows = (*(" ".join(map(repr, row)) for row in places.tolist()), *(f"3 {a} {b} {c}" for a, b, c in facets))
    return "\n".join((head, *rows)).encode()


def _as_utf8(data: bytes) -> bytes:
    """A text with ASCII numbers as UTF-8, whatever the encoding of its comments."""
    return data.decode("utf-8", "replace").encode()


def _3mf(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    try:
        import lxml.etree  # noqa: F401
        import networkx  # noqa: F401
    except ImportError as error:
        missing = missing_extra(error, "a 3MF file")
        if missing is None:
            raise
        raise where(missing.reason, hint=missing.hint) from None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(each.file_size for each in archive.infolist())
            told_apart = size > LARGEST_FILE or _told_apart(archive)
    except _UNREADABLE as error:
        raise where(f"{path.name} is not a 3MF file, or is damaged: {error}") from None
    if size > LARGEST_FILE:
        raise where(f"{path.name} is larger than {LARGEST_FILE // 10**6} MB once unpacked", hint=_FEWER)
    if not told_apart:
        reason = (
            f"bodies in the parts of {path.name} cannot be told apart, as Bambu Studio and OrcaSlicer save assemblies"
        )
        raise where(reason, hint="export it as STL")
    return _by_trimesh(path, data, "3mf", where)


def _told_apart(archive: zipfile.ZipFile) -> bool:
    """Whether trimesh can tell apart the bodies in the parts of a 3MF file: when one is requested, it takes all bodies
    of its part, and those of the same number in all parts."""
    texts = {name.lower(): archive.read(name) for name in archive.namelist() if name.lower().endswith(".model")}
    numbers = [number for text in texts.values() for number in set(_NUMBER_3MF.findall(text))]
    apart = [text for name, text in texts.items() if _MODEL_3MF not in name]
    return len(set(numbers)) == len(numbers) and all(len(_BODY_3MF.findall(text)) <= 1 for text in apart)


def _by_trimesh(path: Path, data: bytes, kind: str, where: Complaint, **options: Any) -> trimesh.Trimesh:
    """All bodies of a file as one mesh, in their places."""
    import trimesh

    # we report files that it cannot read, without its traceback
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    try:
        with warnings_are("ignore"):
            found: Any = trimesh.load(io.BytesIO(data), file_type=kind, process=False, **options)
            mesh = found.to_mesh() if isinstance(found, trimesh.Scene) else found
    except _UNREADABLE as error:
        said = " ".join(str(error).split())[:120]
        raise where(
            f"{path.name} is not in {kind.upper()} format, or is damaged" + (f": {said}" if said else "")
        ) from None
    if not isinstance(mesh, trimesh.Trimesh):
        raise where(
            f"{path.name} holds no facets", hint="points and lines alone are not a surface: make a mesh of them"
        )
    return mesh


def _check_pieces(path: Path, data: bytes, kind: str, where: Complaint) -> None:
    """Raise the InputError of `where` for facets that trimesh splits wrongly: it splits each from its first corner."""
    try:
        with warnings_are("ignore"):
            count = _wrongly_cut(*_POLYGONS[kind](data))
    except _UNREADABLE as error:
        raise where(f"{path.name} is not in {kind.upper()} format, or is damaged: {error}") from None
    if count:
        raise where(
            f"{path.name} has a facet of {count} corners that is not convex", hint="triangulate facets on export"
        )


def _wrongly_cut(places: Array, polygons: Sequence[Sequence[int]]) -> int:
    """The number of corners of a polygon that is wrongly split from its first corner; 0 if there is none.

    In such a polygon, a piece between the first corner and two consecutive ones faces the other way than the whole.
    places: corners (n, 3)
    """
    slack = _FOLD * float(np.ptp(places, axis=0).max())
    for count in sorted({len(each) for each in polygons if len(each) > 3}):
        corners = places[np.array([each for each in polygons if len(each) == count])]
        ways = corners[:, 1:] - corners[:, :1]
        pieces = np.cross(ways[:, :-1], ways[:, 1:])  # normals, as long as twice the area
        whole = pieces.sum(axis=1, keepdims=True)
        whole = whole / np.maximum(np.linalg.norm(whole, axis=2, keepdims=True), np.finfo(float).tiny)
        sides = np.stack([ways[:, :-1], ways[:, 1:], np.diff(ways, axis=1)])
        if ((pieces * whole).sum(axis=2) < -slack * np.linalg.norm(sides, axis=3).max(axis=0)).any():
            return count
    return 0


def _polygons_of_ply(data: bytes) -> tuple[Array, Any]:
    """Corners (n, 3), and for each facet the indices of its own."""
    import trimesh

    raw = trimesh.exchange.ply.load_ply(io.BytesIO(data), skip_materials=True)["metadata"]["_ply_raw"]
    places = np.column_stack([raw["vertex"]["data"][axis] for axis in "xyz"]).astype(float)
    faces = raw["face"]["data"]
    names = list(faces) if isinstance(faces, dict) else faces.dtype.names
    listed = faces[max(names, key=lambda name: name.startswith("vertex_ind"))]
    return places, listed if isinstance(faces, dict) else listed["f1"]


def _polygons_of_obj(data: bytes) -> tuple[Array, list[list[int]]]:
    """Corners (n, 3), and for each facet with more than three the indices of its own."""
    text = re.sub(rb"\\\r?\n", b" ", data)
    places = np.array(re.findall(rb"^v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", text, re.MULTILINE), dtype=float)
    found = re.findall(rb"^[ \t]*f((?:[ \t]+[-\d/]+){4,})", text, re.MULTILINE)
    numbers = [[int(word.partition(b"/")[0]) for word in words.split()] for words in found]
    return places, [[number - (number > 0) for number in each] for each in numbers]


def _polygons_of_off(data: bytes) -> tuple[Array, list[list[int]]]:
    """Corners (n, 3), and for each facet the indices of its own."""
    text = _OFF_REMARK.sub(b"", data).partition(b"OFF")[2]
    lines = [words for line in text.splitlines() if (words := line.split())]
    first = int(lines[0][0]) + 1
    places = np.array([words[:3] for words in lines[1:first]], dtype=float)
    facets = lines[first : first + int(lines[0][1])]
    return places, [[int(number) for number in words[1 : int(words[0]) + 1]] for words in facets]


_POLYGONS: dict[str, Callable[[bytes], tuple[Array, Sequence[Sequence[int]]]]] = {
    "ply": _polygons_of_ply,
    "obj": _polygons_of_obj,
    "off": _polygons_of_off,
}


def _cad(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    import trimesh

    corners, facets = facets_of_bodies(path, MOST_FACETS, where)
    return trimesh.Trimesh(vertices=corners, faces=facets, process=False)


_READERS = {"cad": _cad, "stl": _stl, "ply": _ply, "obj": _obj, "off": _off, "3mf": _3mf}


def _check_count(path: Path, count: int, where: Complaint) -> None:
    if count == 0:
        raise where(f"{path.name} holds no facets")
    if count > MOST_FACETS:
        raise where(f"{path.name} has {count} facets", hint=_FEWER)
