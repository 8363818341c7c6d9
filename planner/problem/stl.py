"""Facets of a body from an STL file; what cannot be printed on is refused."""

from __future__ import annotations

import io
import struct
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import Complaint
from planner.base.files import read_bytes
from planner.problem.part import MeshSpec

if TYPE_CHECKING:
    import trimesh

MOST_FACETS = 2_000_000  # read in 5 s with 1.5 GB as a binary file
FARTHEST = 100_000.0  # mm from the origin: a hall
LARGEST_FILE = 600_000_000  # bytes: so many as text
_HEADER = 84  # bytes of a binary file before its facets, of _FACET bytes each
_FACET = 50
_THINNEST = 1e-9  # mm, height of a facet over its longest side: below, it is a line and has no normal


def read_facets(spec: MeshSpec, where: Complaint) -> Array:
    """Facets (n, 3, 3) of a body [m] in the part frame; otherwise as `read_corners`."""
    turn = Rotation.from_euler("xyz", spec.rpy).as_matrix()
    return np.asarray(read_corners(spec.file, where) @ turn.T + np.asarray(spec.origin))


def read_corners(path: Path, where: Complaint) -> Array:
    """Facets (n, 3, 3) of a file in mm [m], counter-clockwise seen from outside; none without an area.

    `where(reason, hint=...)` makes the InputError for what is wrong with the file, as for what stands inside out.
    """
    data = read_bytes(path, LARGEST_FILE, where, _FEWER)
    mesh = _binary(path, data, where) if _is_binary(data) else _text(path, data, where)
    name = path.name
    corners = np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)]
    if not (np.abs(corners) <= FARTHEST).all():  # NaN is not
        raise where(f"{name} has a corner that is no number, or farther than {FARTHEST / 1e3:g} m from the origin")
    edges = np.roll(corners, -1, axis=1) - corners
    across = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    keep = across > _THINNEST * np.maximum(longest, _THINNEST)
    if not keep.any():
        raise where(f"{name} holds no facet that has an area")
    mesh.merge_vertices()
    if mesh.is_watertight and mesh.volume < 0.0:
        raise where(f"{name} is inside out: its facets face inwards", hint="flip its normals in a CAD program")
    return np.asarray(corners[keep] * 1e-3)


_FEWER = f"make a mesh of fewer facets, at most {MOST_FACETS}"


def _is_binary(data: bytes) -> bool:
    """Some binary files begin with the word of text files: what counts is whether there are facets in words."""
    return not (data.lstrip()[:5].lower() == b"solid" and (b"facet" in data[:4096].lower() or len(data) < _HEADER))


# Trimesh takes a third of a second to be imported: only where there is a file to read.


def _binary(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    import trimesh

    if len(data) < _HEADER:
        raise where(f"{path.name} is no STL file: it has {len(data)} bytes")
    (count,) = struct.unpack("<I", data[80:_HEADER])
    there = (len(data) - _HEADER) // _FACET
    if len(data) != _HEADER + _FACET * count:
        raise where(f"{path.name} is no STL file, or damaged: it announces {count} facets and has room for {there}")
    _check_count(path, count, where)
    parts = trimesh.exchange.stl.load_stl_binary(io.BytesIO(data))
    return trimesh.Trimesh(vertices=parts["vertices"], faces=parts["faces"], process=False)


def _text(path: Path, data: bytes, where: Complaint) -> trimesh.Trimesh:
    import trimesh

    words = data.lower()
    count = words.count(b"endfacet")
    _check_count(path, count, where)
    reason = f"{path.name} is damaged"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            mesh = trimesh.load_mesh(io.BytesIO(data), file_type="stl_ascii", process=False)
    except (ValueError, IndexError, KeyError, TypeError, Warning, trimesh.exchange.stl.HeaderError) as error:
        raise where(f"{reason}: {error}") from error
    found = len(mesh.faces)
    if not words.count(b"facet normal") == count == words.count(b"vertex") / 3 or b"endsolid" not in words:
        raise where(f"{reason}: it ends, or has a gap, within a facet")
    if not 0 < found <= count:
        raise where(f"{reason}: {count} facets are begun and {found} can be read")
    return mesh


def _check_count(path: Path, count: int, where: Complaint) -> None:
    if count == 0:
        raise where(f"{path.name} holds no facets")
    if count > MOST_FACETS:
        raise where(f"{path.name} has {count} facets", hint=_FEWER)
