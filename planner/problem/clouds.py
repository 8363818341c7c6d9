"""Point clouds from scanners' files (PLY, text, NumPy), and scans of parts, which may be facets, too.

Text has one point per line: x y z first, or in columns that a header names (x, or x_mm, or x_m), separated by blanks,
commas, semicolons or tabs. Arrays are (n, 3) or wider, or x, y, z, or points.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import Complaint, InputError
from planner.base.files import read_bytes, read_text
from planner.problem.mesh_files import GREATEST, SMALLEST, read_corners, unit_of
from planner.problem.mesh_files import SUFFIXES as MESHES
from planner.problem.part import UNITS, ScanSpec

CLOUD_UNITS = ("mm", "m")  # that may be given for a cloud, and that a header may name
SUFFIXES = (".ply", ".xyz", ".txt", ".csv", ".asc", ".pts", ".npz", ".npy")
LARGEST_FILE = 500_000_000  # bytes: some ten million points of text
FARTHEST = 1e9  # largest coordinate, in any unit
_HEAD = 65_536  # bytes of a PLY file that announce its elements
FEWEST, MOST = 200, 20_000_000  # points: fewer say nothing about a layer, more may not fit into memory
_COLUMN = re.compile(r"([xyz])(?:[_\[( ]*(mm|m)[\])]?)?", re.IGNORECASE)
_COMMENTS = ("#", "//", "%")
_UNREADABLE = (ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, OSError, OverflowError,
               MemoryError, zipfile.BadZipFile)  # fmt: skip


def read_cloud(path: Path, unit: str | None = None) -> Array:
    """The points (n, 3) [m] of a file, in its own frame.

    unit: one of CLOUD_UNITS; default: the one that the file states, else mm
    Raises InputError with file and line for a file that cannot be read, numbers that are not finite, too few or too
    many points, and conflicting units.
    """
    return _cloud_and_unit(path, unit, "--unit")[0]


def _cloud_and_unit(path: Path, unit: str | None, option: str) -> tuple[Array, str | None]:
    """As `read_cloud`, with the unit that the file itself states; option: the option or key that `unit` comes from."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path.suffix or 'a missing ending'} is not the ending of a point cloud",
            file=path,
            hint=", ".join(SUFFIXES),
        )
    complain = partial(InputError, file=path)
    kind = path.suffix.lower()
    told: str | None = None
    if kind == ".ply":
        points = _ply(path, complain)
    elif kind in (".npz", ".npy"):
        points = _arrays(path, complain)
    else:
        points, told = _text(path, complain)
    if unit is not None and told is not None and unit != told:
        raise complain(f"its header says {told}, but {option} says {unit}", hint=f"leave {option} out")
    if not FEWEST <= len(points) <= MOST:
        raise complain(f"holds {len(points)} points", hint=f"{FEWEST} to {MOST:,}")
    finite = (np.abs(points) < FARTHEST).all(axis=1)
    if not finite.all():
        count, first = int((~finite).sum()), int(np.argmin(finite))
        reason = f"{count} of its {len(points)} points are not finite, or too far away; the first is number {first}"
        raise complain(reason, hint="leave them out")
    return points * (UNITS[unit or told or "mm"] * 1e-3), told


def read_scan(spec: ScanSpec, where: Complaint) -> Array:
    """Points (n, 3) [m] of a scanned part in the part frame; from facets, the corners of those that face upwards.

    Raises InputError for a file that cannot be read, and that of `where` for a scan too small or large to be a part.
    """
    if spec.file.suffix.lower() in MESHES and not (spec.file.suffix.lower() == ".ply" and not _has_facets(spec.file)):
        known, told = unit_of(spec.file, where), None
        corners = read_corners(spec.file, where, spec.unit, spec.scale)
        turned = Rotation.from_euler("xyz", spec.rpy).apply(corners.reshape(-1, 3)).reshape(-1, 3, 3)
        up = np.cross(turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0])[:, 2] > 0.0
        points = np.unique(turned[up].reshape(-1, 3), axis=0)
        if len(points) < FEWEST:
            raise where(f"{spec.file.name} has {len(points)} corners of facets that face upwards", hint=_TURN)
    else:
        points, told = _cloud_and_unit(spec.file, spec.unit, "unit")
        known = told or "mm"
        points = Rotation.from_euler("xyz", spec.rpy).apply(points * spec.scale)
    across = float(np.ptp(points, axis=0).max()) * 1e3
    if not SMALLEST <= across <= GREATEST:
        times = {name: mm / UNITS[spec.unit or known] for name, mm in UNITS.items()}
        sizes = {f"unit: {name}" if told is None else f"scale: {x:g}": across * x for name, x in times.items()}
        likely = [f"{key} makes it {size:.4g} mm" for key, size in sizes.items() if 20.0 <= size <= 2000.0]
        raise where(f"{spec.file.name} is {across:.4g} mm across", hint="; ".join([*likely, "or give scale"]))
    return np.asarray(points + np.asarray(spec.origin))


_TURN = f"at least {FEWEST}; turn it with rpy_deg until what is printed on faces upwards"


def _has_facets(path: Path) -> bool:
    """Whether a PLY file announces facets."""
    with suppress(OSError), path.open("rb") as stream:
        found = re.search(rb"^element\s+face\s+(\d+)", stream.read(_HEAD), re.MULTILINE)
        return found is not None and int(found[1]) > 0
    return False


def _ply(path: Path, complain: Complaint) -> Array:
    """Vertices of a PLY file, whether of points alone or of facets."""
    read_bytes(path, LARGEST_FILE, complain, "thin it out")
    import trimesh

    try:
        # numbers too large for a float are reported later, once they are infinite
        with path.open("rb") as stream, np.errstate(all="ignore"):
            found: Any = trimesh.load(stream, file_type="ply", process=False)
        points = np.asarray(found.vertices, dtype=np.float64)
    except _UNREADABLE as error:
        raise complain("is not a readable PLY file", hint="vertices with x, y and z") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise complain("has no vertices with x, y and z")
    return points


def _arrays(path: Path, complain: Complaint) -> Array:
    """The array of a NumPy file, or those of an archive."""
    read_bytes(path, LARGEST_FILE, complain, "thin it out")
    try:
        with path.open("rb") as stream, np.errstate(all="ignore"):
            held: Any = np.load(stream, allow_pickle=False)
            if isinstance(held, np.ndarray):
                points = np.asarray(held, dtype=np.float64)
            else:
                with held:
                    points = _of_archive(held)
    except (*_UNREADABLE, RuntimeError) as error:
        raise complain("is not a NumPy file of points", hint="an array (n, 3), or x, y and z") from error
    if points.ndim != 2 or points.shape[1] < 3:
        raise complain(f"has an array of shape {points.shape}", hint="points are (n, 3)")
    return np.ascontiguousarray(points[:, :3])


def _of_archive(held: Mapping[str, Any]) -> Array:
    """The points of an archive's arrays. Raises KeyError if there are none."""
    if all(name in held for name in "xyz"):
        return np.stack([np.asarray(held[name], dtype=np.float64).ravel() for name in "xyz"], axis=1)
    name = next((each for each in ("points", "xyz", *held) if each in held), None)
    if name is None:
        raise KeyError("no array")
    return np.asarray(held[name], dtype=np.float64)


def _text(path: Path, complain: Complaint) -> tuple[Array, str | None]:
    """The points of a table, and the unit that its header states."""
    lines = read_text(path, LARGEST_FILE, complain)
    rows = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith(_COMMENTS)]
    if not rows:
        raise complain("holds no points")
    mark = next((each for each in (";", ",", "\t") if each in rows[0][1]), None)
    if len(rows) > 1 and rows[0][1].strip().isdecimal():  # PTS files begin with the number of points
        rows = rows[1:]
        mark = next((each for each in (";", ",", "\t") if each in rows[0][1]), None)
    columns, units = _columns(rows[0][1], mark)
    if len(units) > 1:
        raise complain(
            "names x, y and z in different units", line=rows[0][0], hint="use one unit, such as x_mm, y_mm, z_mm"
        )
    unit = next(iter(units), None)
    if columns is not None:
        rows = rows[1:]
    if not rows:
        raise complain("holds no points")
    at = columns or [0, 1, 2]
    try:
        table = np.loadtxt((text for _, text in rows), delimiter=mark, usecols=at, ndmin=2, comments=None)
    except ValueError:
        raise _wrong_row(rows, mark, at, path) from None
    return np.asarray(table, dtype=np.float64).reshape(-1, 3), unit


def _columns(head: str, mark: str | None) -> tuple[list[int] | None, set[str | None]]:
    """The columns of x, y and z according to a header, and their units; None for a line of numbers."""
    words = [word.strip(" \t\"'") for word in head.split(mark)]
    found: dict[str, tuple[int, str | None]] = {}
    for i, word in enumerate(words):
        match = _COLUMN.fullmatch(word)
        if match:
            found.setdefault(match[1].lower(), (i, match[2] and match[2].lower()))
    if len(found) < 3:
        return None, set()
    return [found[name][0] for name in "xyz"], {unit for _, unit in found.values()}


def _wrong_row(rows: Sequence[tuple[int, str]], mark: str | None, at: Sequence[int], path: Path) -> InputError:
    """The error of the first row without three numbers."""
    for line, text in rows:
        words = text.split(mark)
        try:
            for k in at:
                float(words[k])
        except (ValueError, IndexError):
            reason = f"does not hold three numbers: {text.strip()[:40]!r}"
            return InputError(reason, file=path, line=line, hint="x y z, or a header that names x, y and z")
    return InputError("is not a table of numbers", file=path)
