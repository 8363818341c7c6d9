"""A file of waypoints: points and surface normals, split into the paths that become beads.

The file is text, with or without a header that names its columns, or holds arrays by name.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.budgets import WAYPOINT_BYTES, WAYPOINTS
from planner.base.errors import Complaint, InputError, nearest_name
from planner.base.files import read_bytes, read_text
from planner.base.geometry import angles_between, arc_lengths
from planner.base.warned import warnings_are
from planner.problem.layers import WaypointsSpec
from planner.problem.waypoint_arrays import WaypointArrays
from planner.toolpath.waypoints.nameless import meant_otherwise, odd_lengths

NEEDED = ("x", "y", "z", "nx", "ny", "nz")
OPTIONAL = ("layer", "bead", "width", "height")
LENGTHS = ("x", "y", "z", "width", "height")
LARGEST_FILE = WAYPOINT_BYTES.most
COMMENTS = ("#", "//", "%", ";")
_TITLES = 20  # lines at most among which the header may be
_OBJ_WORDS = ("v", "vn", "vt", "o", "g", "mtllib")  # a file of vertices begins with one of these
_AXIS = {"i": "nx", "j": "ny", "k": "nz"}  # names of the tool axis in milling programs
# pos_x, Points:0; normal_x, Normals:0: names in exported tables and meshes
_POINT = re.compile(r"(?:p|pos|position|point|points|tcp)[ _:.-]?([xyz012])")
_DIRECTION = re.compile(r"(?:n|norm|normal|normals)[ _:.-]?([xyz012])")
_NUMBERED = {"0": "x", "1": "y", "2": "z"}
_ENDS_IN_AXIS = re.compile(r".*[_:.-][xyz012]|[xyz]", re.IGNORECASE)  # words that name a column
_NAMING = 3  # of the needed names, at least, that a line must hold to be a header
_UNREAD = ("cm", "um", "in", "inch", "inches", "ft")  # units in column names in which files are not read
_UNIT = re.compile(rf"\s*[\[(]\s*(mm|m|{'|'.join(_UNREAD)})\s*[\])]")
# raised by numpy and zipfile for files that are truncated, damaged, encrypted, or misstate their size
_UNREADABLE = (zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, RuntimeError, MemoryError, OverflowError)
_NAME = re.compile(rf"(.+)_(mm|m|{'|'.join(_UNREAD)})")

FARTHEST = 1e5  # mm: a 100 m hall
SPLIT = 3.0  # median steps: a longer step is travel to the next bead
_STRAIGHT_ON = np.radians(30.0)  # greatest angle to its neighbours at which a long step may still belong to the path
SAME_POINT = 0.02  # × the median step: a point closer than this to the one before repeats it
SAME_PLACE = 1e-7  # m: so does a point closer than this, whatever the steps; files are rounded to it
_LOOKED = 1000  # lines that are checked for something other than waypoints
_CONTRADICTS = np.radians(5.0)  # least difference between normals at one place that is reported
_NAMED_LINES = 5  # most lines that a note lists
_AROUND = 3  # waypoints to either side that decide which way a normal points:
_FEWEST = 3  # at least this many, since with fewer these may be wrong themselves;
_AGREE = 0.3  # they agree if the sum of their normals is at least this long per normal;
_OPPOSITE = 0.7  # the normal is opposite if the cosine of its angle to that sum is below minus this
SIZES = (1e-5, 50e-3)  # m: widths and heights of beads, from a fibre to large concrete beads
MOST_LAYERS = 1e6  # greatest number of a layer or bead
_SHORTEST = 1e-6  # × the longest normal's length, or × 1 if that is less: shorter ones are rounding, not directions
_TINIEST = 1e-150  # least length of a normal: its square is still a number above 0
_FEWER = "thin them out, or print the part in several files"
_SIZED, _COUNTED = ("width", "height"), ("layer", "bead")
TO_SI = {"mm": 1e-3, "m": 1.0}


@dataclass(frozen=True)
class Columns:
    """Columns (n) of numbers by name, as in the file; all of NEEDED, some of OPTIONAL; n is at least 1.

    lines (n): their lines in the file, from 1; for an NPZ file, their places in the arrays.
    unused: names of columns that mean nothing here; remark: a further note on the columns.
    """

    values: dict[str, Array]
    lines: NDArray[np.int64]
    unused: tuple[str, ...]
    remark: str = ""


@dataclass(frozen=True)
class _Layout:
    """Positions of the columns in a line, by name; their separator (None: blanks or commas); their number."""

    places: dict[str, int]
    separator: str | None
    count: int
    unused: tuple[str, ...] = ()

    def split(self, line: str) -> list[str]:
        """The words of a line."""
        if self.separator is not None and self.separator in line:
            return [word.strip() for word in line.split(self.separator)]
        return line.replace(",", " ").split()


_PLAIN = _Layout({name: i for i, name in enumerate(NEEDED)}, None, len(NEEDED))


def read_columns(path: Path, unit: str, complain: Complaint) -> Columns:
    """Read a file's columns; lengths in it should be in `unit`, mm or m: a header that states another one is refused.

    Text: comments (#, //, %, ;) and empty lines are skipped. A header names the columns, in a line of words or in the
    comment above the first waypoint; without one they are x y z nx ny nz, and further columns are ignored.
    NPZ: one array for each column. `complain(reason, hint=...)` makes the InputError for a fault of the file as a
    whole. Raises InputError with file and line for a line without such numbers.
    """
    data = read_bytes(path, LARGEST_FILE, complain)
    if path.suffix.lower() == ".npz" or data.startswith(b"PK\x03\x04"):
        return _arrays(path, data, unit, complain)
    return _text(path, unit, complain)


def number(word: str) -> float | None:
    """The number that a word spells, finite or not; None if it is not a number."""
    try:
        return float(word) if "_" not in word else None
    except ValueError:
        return None


# Names
def _named(names: Sequence[str], unit: str, wrong: Complaint) -> tuple[dict[str, int], tuple[str, ...]]:
    """Positions of the named columns, and the names that are not used."""
    places: dict[str, int] = {}
    unused: list[str] = []
    for i, (word, (name, stated)) in enumerate(zip(names, _names(names), strict=True)):
        if not name:
            continue
        if name not in (*NEEDED, *OPTIONAL):
            near = nearest_name(name, OPTIONAL)
            if near is not None and near not in places:
                raise wrong(f"unknown column {word[:40]!r}", hint=f"did you mean {near}? {_known()}")
            unused.append(word)
            continue
        if name in places:
            raise wrong(f"column {name} occurs twice")
        if stated in _UNREAD and name in LENGTHS:
            raise wrong(f"column {name} is in {stated}", hint="lengths are read in mm or m, see layers.source.unit")
        if stated is not None and name in LENGTHS and stated != unit:
            raise wrong(f"column {name} is in {stated}, but layers.source.unit is {unit}", hint=f"unit: {stated}")
        places[name] = i
    missing = [name for name in NEEDED if name not in places]
    if missing:
        columns = f"columns {', '.join(missing)} are" if len(missing) > 1 else f"column {missing[0]} is"
        raise wrong(f"{columns} missing", hint=_known())
    return places, tuple(unused)


def _known() -> str:
    return f"columns: {' '.join(NEEDED)}, and if wanted {' '.join(OPTIONAL)}"


def _names(words: Sequence[str]) -> list[tuple[str, str | None]]:
    """The names of columns, and their units if stated.

    x, y, z, i, j, k also mean points and normals; so do pos_x and normal_x, if no column is called x or nx.
    """
    found = [_name(word) for word in words]
    names = {name for name, _ in found}
    if not names & set(_AXIS.values()):
        if set(_AXIS) <= names:
            found = [(_AXIS.get(name, name), stated) for name, stated in found]
        else:
            found = [(_plainly(name, _DIRECTION, "n"), stated) for name, stated in found]
    if not names & set(NEEDED[:3]):
        found = [(_plainly(name, _POINT, ""), stated) for name, stated in found]
    return found


def _plainly(name: str, pattern: re.Pattern[str], before: str) -> str:
    """x, y or z after the prefix `before`, for a longer name of the same; any other name unchanged."""
    match = pattern.fullmatch(name)
    return name if match is None else before + _NUMBERED.get(match[1], match[1])


def _name(word: str) -> tuple[str, str | None]:
    """The name of a column, and its unit if stated: x_mm, X [mm]."""
    plain = _UNIT.sub(r"_\1", word.strip().strip("\"'").lower())
    match = _NAME.fullmatch(plain)
    return (plain, None) if match is None else (match[1], match[2])


# Text
def _text(path: Path, unit: str, complain: Complaint) -> Columns:
    lines = read_text(path, LARGEST_FILE, complain)
    if _first_word(lines) in _OBJ_WORDS:
        return _vertices(path, lines, complain)
    if _semicolons(lines):
        lines = [line if line.lstrip()[:1] in COMMENTS else line.replace(",", ".").replace(";", ",") for line in lines]
    layout, numbers = _layout(path, lines, unit)
    if not numbers:
        raise complain(f"{path.name} holds no waypoints", hint="lines x y z nx ny nz, in mm")
    WAYPOINTS.check(len(numbers), f"{path.name} has", complain, _FEWER)
    rows = [lines[i - 1] for i in numbers]
    if layout.separator is None:
        rows = [row.replace(",", " ") for row in rows]
    use = list(layout.places.values())
    try:
        with warnings_are("error", UserWarning):
            table = np.loadtxt(rows, dtype=float, comments=None, delimiter=layout.separator, usecols=use, ndmin=2)
    except (ValueError, UserWarning):
        table = np.array([_row(path, layout, row, i) for row, i in zip(rows, numbers, strict=True)])
    values = {name: table[:, k] for k, name in enumerate(layout.places)}
    remark = ""
    if layout is _PLAIN:
        reason, hint = meant_otherwise([[number(word) for word in layout.split(row)] for row in rows[:_LOOKED]])
        if reason:
            raise complain(f"{path.name} {reason}", hint=hint)
        remark = odd_lengths(table[:, len(NEEDED) - 3 :])
    return Columns(values, np.array(numbers, dtype=np.int64), layout.unused, remark)


def _semicolons(lines: Sequence[str]) -> bool:
    """Whether semicolons separate values, as in spreadsheets with decimal commas."""
    content = (line for line in lines if line.strip() and line.lstrip()[0] not in COMMENTS)
    return any(line.count(";") >= len(NEEDED) - 1 for line in islice(content, _TITLES + 1))


def _first_word(lines: Sequence[str]) -> str:
    """The first word outside comments; empty if there is none."""
    content = (line for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS))
    return next(content, "").partition(" ")[0]


def _vertices(path: Path, lines: Sequence[str], complain: Complaint) -> Columns:
    """Waypoints from an OBJ file: all points in lines `v x y z`, and as many normals in lines `vn nx ny nz`."""
    rows: dict[str, list[int]] = {"v": [], "vn": []}
    others: set[str] = set()
    for i, line in enumerate(lines, 1):
        word = line.split(None, 1)[0] if line.strip() else ""
        if word in rows:
            rows[word].append(i)
        elif word and not word.startswith(COMMENTS):
            others.add(word[:40])
    points, normals = rows["v"], rows["vn"]
    if not points or len(points) != len(normals):
        counts = f"{len(points)} points (v) and {len(normals)} normals (vn)"
        raise complain(f"{path.name} has {counts}", hint="a normal for each point, in their order")
    table = np.hstack([_numbered(path, lines, points), _numbered(path, lines, normals)])
    values = {name: table[:, k] for k, name in enumerate(NEEDED)}
    return Columns(values, np.array(points, dtype=np.int64), tuple(sorted(others)))


def _numbered(path: Path, lines: Sequence[str], numbers: Sequence[int]) -> Array:
    """The three numbers after the first word of lines (n) → (n, 3); InputError for the first line without them."""
    try:
        return np.array([line.split()[1:4] for line in (lines[i - 1] for i in numbers)], dtype=float).reshape(-1, 3)
    except ValueError:
        wrong = next(
            i
            for i in numbers
            if [number(word) for word in lines[i - 1].split()[1:4]].count(None) or len(lines[i - 1].split()) < 4
        )
        raise InputError("is not a point or normal of three numbers", file=path, line=wrong) from None


def _layout(path: Path, lines: list[str], unit: str) -> tuple[_Layout, list[int]]:
    """The layout of the columns, and the numbers from 1 of the lines that hold a waypoint, or should."""
    full = [i for i, line in enumerate(lines, 1) if line.strip()]
    content = [i for i in full if not lines[i - 1].lstrip().startswith(COMMENTS)]
    if not content:
        return _PLAIN, []
    first = _header(lines, content[:_TITLES])
    if first is not None:
        content = [i for i in content if i > first]
        words = _words(lines[first - 1])
        if content and not _numbers_in(lines[content[0] - 1]):  # a line of units
            words = [_with_unit(word, lines[content[0] - 1], k) for k, word in enumerate(words)]
            content = content[1:]
    else:
        if not _numbers_in(lines[content[0] - 1]):
            return _PLAIN, content[1:]  # a title
        above = [i for i in full if i < content[0]]
        head = lines[above[-1] - 1].lstrip().lstrip("#/%; ") if above else ""
        words = _words(head)
        if not set(NEEDED) <= {name for name, _ in _names(words)}:
            return _PLAIN, content  # a remark
        first = above[-1]
    head = lines[first - 1]
    places, unused = _named(words, unit, partial(InputError, file=path, line=first))
    return _Layout(places, "," if "," in head else None, len(words), unused), content


def _header(lines: Sequence[str], content: Sequence[int]) -> int | None:
    """The number of the header line, below any titles, if there is one."""
    above = None
    for i in content:
        numbers = _numbers_in(lines[i - 1])
        if not numbers and len({name for name, _ in _names(_words(lines[i - 1]))} & set(NEEDED)) >= _NAMING:
            return i
        if numbers >= len(NEEDED):
            return above if above is not None and _names_columns(lines[above - 1], numbers) else None
        above = None if numbers else i
    return None


def _names_columns(line: str, count: int) -> bool:
    """Whether a line of words names `count` columns, by whatever names: a title does not have five commas."""
    words = _words(line)
    return len(words) == count and ("," in line or sum(map(bool, map(_ENDS_IN_AXIS.fullmatch, words))) >= _NAMING)


def _numbers_in(line: str) -> int:
    """How many words of a line are numbers."""
    return sum(number(word) is not None for word in _words(line))


def _with_unit(name: str, units: str, column: int) -> str:
    """The name of a column with its unit from a line of units below."""
    below = _words(units)
    unit = below[column].strip("[]() ").lower() if column < len(below) else ""
    return f"{name}_{unit}" if unit in (*TO_SI, *_UNREAD) and _name(name)[1] is None else name


def _words(line: str) -> list[str]:
    """The words of a header: between commas, or else between blanks."""
    if "," in line:
        return [word.strip() for word in line.split(",")]
    return _UNIT.sub(r"_\1", line).split()


def _row(path: Path, layout: _Layout, line: str, place: int) -> list[float]:
    """The numbers in a line; InputError if there are none."""
    wrong = partial(InputError, file=path, line=place)
    words = layout.split(line)
    if len(words) < layout.count:
        count = f"{len(words)} value{'s' if len(words) != 1 else ''}"
        if layout is _PLAIN:
            raise wrong(f"a waypoint has six numbers, x y z nx ny nz; here are {count}")
        raise wrong(f"the header names {layout.count} columns; here are {count}")
    row = []
    for name, i in layout.places.items():
        value = number(words[i])
        if value is None:
            what = f"{words[i][:40]!r} is not a number" if words[i] else f"{name} is missing"
            raise wrong(what)
        row.append(value)
    return row


# Arrays
def _arrays(path: Path, data: bytes, unit: str, complain: Complaint) -> Columns:
    hint = "made by numpy.savez(file, x=..., y=..., z=..., nx=..., ny=..., nz=...)"
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > LARGEST_FILE:
                raise complain(f"{path.name} unpacks to more than {LARGEST_FILE // 10**6} MB")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            places, unused = _named(arrays.files, unit, complain)
            values = {name: _numbers(arrays[arrays.files[i]], name, complain) for name, i in places.items()}
    except _UNREADABLE as error:
        why = str(error).partition("\n")[0] or type(error).__name__
        raise complain(f"{path.name} is not an NPZ file of numbers: {why}", hint=hint) from error
    sizes = {name: len(column) for name, column in values.items()}
    for name, size in sizes.items():
        if size != sizes["x"]:
            raise complain(f"array {name} has {size} numbers, x has {sizes['x']}", hint="one for each waypoint")
    if sizes["x"] == 0:
        raise complain(f"{path.name} holds no waypoints", hint=hint)
    WAYPOINTS.check(sizes["x"], f"{path.name} has", complain, _FEWER)
    return Columns(values, np.arange(1, sizes["x"] + 1, dtype=np.int64), unused)


def _numbers(array: NDArray[np.generic], name: str, complain: Complaint) -> Array:
    if array.ndim != 1 or array.dtype.kind not in "fiu":
        shape = " x ".join(map(str, array.shape)) or "a single value"
        raise complain(f"array {name} is {shape} of {array.dtype}", hint="one row of numbers each")
    return array.astype(float)


@dataclass(frozen=True)
class Waypoints(ReadOnlyArrays):
    """The waypoints of one bead: points (n, 3) [m] and outward unit normals (n, 3), part frame; n is at least 2.

    lines (n)         their lines in the file, from 1
    width, height (n) of the bead [m]; None if the file does not give them
    layer             as numbered in the file; None if it is not
    """

    name: str
    points: Array
    normals: Array
    lines: Ints
    width: Array | None
    height: Array | None
    layer: int | None


@dataclass(frozen=True)
class WaypointFile:
    """The beads of a file in its order, notes on what was left out or changed, and the share of the length left out."""

    beads: tuple[Waypoints, ...]
    notes: tuple[str, ...]
    left_out: float = 0.0


@dataclass(frozen=True)
class _FileRows:
    """All waypoints of a file (n), in SI units and the part frame; columns that the file does not have are None."""

    points: Array
    normals: Array
    lines: Ints
    width: Array | None
    height: Array | None
    layer: Array | None
    bead: Array | None

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> _FileRows:
        def taken(column: Array | None) -> Array | None:
            return None if column is None else column[rows].copy()

        return _FileRows(
            self.points[rows].copy(),
            self.normals[rows].copy(),
            self.lines[rows].copy(),
            *map(taken, (self.width, self.height, self.layer, self.bead)),
        )


def read_waypoints(spec: WaypointsSpec, where: Complaint | None = None, width: float = 0.0) -> WaypointFile:
    """Read a file of waypoints (see `read_columns`) and split it, in its order, where a bead ends.

    A bead ends where the columns bead or layer change, and at jumps; if there is a column bead, only at jumps longer
    than a given `split_mm`. Points that repeat the one before are left out, and so are crumbs, if they are few: see
    `_without_crumbs`; beads have this width [m] if the file does not give one.
    `where(reason, hint=...)` makes the InputError for a fault of the file as a whole.
    Raises InputError with file and line, or the index in the arrays, for a row that is not a waypoint.
    """
    given = spec.waypoints
    complain: Complaint
    if isinstance(given, WaypointArrays):
        complain = partial(InputError, field="points")
        columns = columns_of(given)
    else:
        complain = partial(InputError, file=given) if where is None else where
        columns = read_columns(given, spec.unit, complain)
    _check(columns, spec)
    rows = _rows(columns, spec)

    keep = np.concatenate([distinct(rows[part].points) for part in _parts(_changes(rows))])
    repeated = int((~keep).sum())
    turned = _turned_in_place(rows.normals, keep)
    rows = rows[keep]
    if len(rows.points) < 2:
        raise complain(
            f"{'there are' if isinstance(given, WaypointArrays) else f'{spec.name} holds'} no two different waypoints"
        )
    split = _greatest_step(rows, spec)
    parts, crumbs, lost = _without_crumbs(_split(rows, split), spec, width)
    for part in parts.values():
        _check_alone(part, split, spec)
    beads = [
        Waypoints(
            f"path {i}", cut.points, cut.normals, cut.lines, cut.width, cut.height,
            None if cut.layer is None else int(cut.layer[0]),
        )
        for i, cut in parts.items()
    ]  # fmt: skip
    left_out = [f"{spec.name}: {crumbs}"] if crumbs else []
    remark = [f"{spec.name}: {columns.remark}"] if columns.remark else []
    ways = (f"{spec.name}: {each}" for each in _straight_on(parts, split, spec))
    told = (*_notes(spec.name, columns.unused, repeated, turned), *remark, *left_out, *ways)
    return WaypointFile(tuple(beads), told, lost)


def columns_of(arrays: WaypointArrays) -> Columns:
    """The columns that a file of the same waypoints would have, in metres; `lines` are their indices, from 0."""
    values = dict(zip(NEEDED, (*arrays.points.T, *arrays.normals.T), strict=True))
    values |= {name: column for name in OPTIONAL if (column := getattr(arrays, name)) is not None}
    return Columns(values, np.arange(len(arrays), dtype=np.int64), ())


def _turned_in_place(normals: Array, kept: NDArray[np.bool_]) -> float:
    """Greatest angle [rad] between the normals (n, 3) of repeated waypoints and those of the kept ones before them."""
    last = np.maximum.accumulate(np.where(kept, np.arange(len(kept)), 0))
    return float(angles_between(normals[~kept], normals[last[~kept]]).max(initial=0.0))


def _notes(name: str, unused: tuple[str, ...], repeated: int, turned: float) -> Iterator[str]:
    if repeated:
        what = "waypoint that repeats" if repeated == 1 else "waypoints that repeat"
        but = (
            f"; their normals differ from its by up to {np.degrees(turned):.0f} degrees"
            if turned > _CONTRADICTS
            else ""
        )
        yield f"{name}: {repeated} {what} the one before left out{but}"
    if unused:
        yield f"{name}: unused columns: {', '.join(each[:40] for each in unused[:8])}"


def _rows(columns: Columns, spec: WaypointsSpec) -> _FileRows:
    """The file's columns in SI units, turned and moved into the part frame."""
    scale, values = TO_SI[spec.unit], columns.values
    points = scale * np.column_stack([values[name] for name in ("x", "y", "z")])
    normals = np.column_stack([values[name] for name in ("nx", "ny", "nz")])
    points, normals = (_upright(a, spec.up) for a in (points, normals))
    normals = normals / np.linalg.norm(normals, axis=1)[:, None] * (1.0 if spec.normals == "outward" else -1.0)
    width, height = (scale * values[name] if name in values else None for name in ("width", "height"))
    moved = points + np.asarray(spec.origin)
    return _FileRows(moved, normals, columns.lines, width, height, values.get("layer"), values.get("bead"))


def _upright(vectors: Array, up: str) -> Array:
    """Vectors (n, 3) in axes whose z is the file's upward axis."""
    x, y, z = vectors.T
    return np.column_stack({"x": (y, z, x), "y": (x, -z, y), "z": (x, y, z)}[up])


def have_length(normals: Array) -> NDArray[np.bool_]:
    """Which normals (n, 3) are directions, neither zero nor negligible next to the longest.

    All may be short: products of small steps in metres are.
    """
    size = np.abs(normals).max(axis=1)
    longest = float(size.max(initial=0.0, where=np.isfinite(size)))
    return np.asarray(size > max(_SHORTEST * min(1.0, longest), _TINIEST))


def _check(columns: Columns, spec: WaypointsSpec) -> None:
    """Raise InputError for the first row whose numbers are not a waypoint."""
    unit = spec.unit
    values, scale = columns.values, TO_SI[unit]
    table = np.column_stack(list(values.values()))
    bad = ~np.isfinite(table).all(axis=1)
    place = np.column_stack([values[name] for name in ("x", "y", "z")])
    normal = np.column_stack([values[name] for name in ("nx", "ny", "nz")])
    bad |= ~(scale * np.abs(place).max(axis=1) <= 1e-3 * FARTHEST)
    directed = have_length(normal)
    bad |= ~directed
    for name in [name for name in _SIZED if name in values]:
        bad |= ~((scale * values[name] >= SIZES[0]) & (scale * values[name] <= SIZES[1]))
    for name in [name for name in _COUNTED if name in values]:
        bad |= ~((values[name] == np.round(values[name])) & (np.abs(values[name]) <= MOST_LAYERS))
    if not bad.any():
        return
    i = int(np.argmax(bad))
    row = {name: float(column[i]) for name, column in values.items()}

    def wrong(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, **spec.place(columns.lines[i]), hint=hint)

    for value in row.values():
        if not math.isfinite(value):
            raise wrong(f"'{value:g}' is not a number that a waypoint can have")
    if scale * np.abs(place[i]).max() > 1e-3 * FARTHEST:
        hint = f"points are in {unit}; layers.source.unit is mm or m"
        raise wrong(f"the point is farther than {FARTHEST / 1e3:g} m from the origin", hint=hint)
    if not directed[i]:
        raise wrong("the normal is zero", hint="nx ny nz is a direction, of any length")
    for name in [name for name in _SIZED if name in row]:
        if not SIZES[0] <= scale * row[name] <= SIZES[1]:
            valid = f"valid: {SIZES[0] / scale:g} to {SIZES[1] / scale:g} {unit}"
            raise wrong(f"the bead's {name} is {row[name]:g} {unit}", hint=valid)
    for name in [name for name in _COUNTED if name in row]:
        if row[name] != round(row[name]) or abs(row[name]) > MOST_LAYERS:
            raise wrong(f"{name} is {row[name]:g}", hint=f"a whole number, {MOST_LAYERS:g} at most")


def _changes(rows: _FileRows) -> Ints:
    """Rows at which a column starts another bead, followed by the number of rows."""
    changed = np.zeros(len(rows.points) - 1, dtype=bool)
    for column in (rows.layer, rows.bead):
        if column is not None:
            changed |= column[1:] != column[:-1]
    return np.append(np.flatnonzero(changed) + 1, len(rows.points))


def _parts(ends: Ints) -> Iterator[slice]:
    """Slices up to each of the ends."""
    return (slice(int(a), int(b)) for a, b in zip(np.append(0, ends[:-1]), ends, strict=True))


def _greatest_step(rows: _FileRows, spec: WaypointsSpec) -> float:
    """The longest step [m] that is not travel to the next bead."""
    if spec.split is not None:
        return spec.split
    step = np.linalg.norm(np.diff(rows.points, axis=0), axis=1)
    within = np.ones(len(step), dtype=bool)
    within[_changes(rows)[:-1] - 1] = False
    return SPLIT * float(np.median(step[within])) if rows.bead is None and within.any() else math.inf


def _split(rows: _FileRows, split: float) -> list[_FileRows]:
    """The rows of each bead, in order."""
    step = np.linalg.norm(np.diff(rows.points, axis=0), axis=1)
    return [rows[part] for part in _parts(np.union1d(_changes(rows), np.flatnonzero(step > split) + 1))]


def _straight_on(parts: Mapping[int, _FileRows], split: float, spec: WaypointsSpec) -> Iterator[str]:
    """A note on gaps left because waypoints are more than `split` [m] apart though one path leads straight to the next.

    In a file with dense points only in bends, that may be most of the drawing. No note if file or problem say where
    paths end, or if the gaps are shorter than may be left out.
    """
    count, length = 0, 0.0
    for i, b in parts.items():
        a = parts.get(i - 1)
        if a is None or spec.split is not None or b.bead is not None:
            continue
        if a.layer is not None and b.layer is not None and a.layer[-1] != b.layer[0]:
            continue
        ways = np.diff(np.vstack([a.points[-2:], b.points[:2]]), axis=0)
        if angles_between(ways[[0, 2]], ways[[1, 1]]).max() <= _STRAIGHT_ON:
            count, length = count + 1, length + float(np.linalg.norm(ways[1]))
    if length > spec.crumbs * sum(float(arc_lengths(part.points)[-1]) for part in parts.values()):
        places = "place" if count == 1 else "places"
        yield (
            f"paths go straight on at {count} {places} where nothing is laid, since waypoints are farther apart than "
            f"{split * 1e3:.3g} mm there, {SPLIT:g} times the usual step: {length * 1e3:,.0f} mm in all; if material belongs "
            "there, give layers.source.split_mm or a column bead"
        )


def _check_alone(part: _FileRows, split: float, spec: WaypointsSpec) -> None:
    """Raise InputError for a bead of a single waypoint."""
    if len(part.points) > 1:
        return
    reason, hint = "this waypoint is the only one of its bead", "a bead needs at least two"
    if part.bead is None and part.layer is None:
        reason = f"this waypoint stands alone, more than {split * 1e3:g} mm from those beside it"
        hint = "leave it out, or choose a greater layers.source.split_mm or leave_out_share"
    raise InputError(reason, **spec.place(part.lines[0]), hint=hint)


def _without_crumbs(
    parts: Sequence[_FileRows], spec: WaypointsSpec, width: float
) -> tuple[dict[int, _FileRows], str, float]:
    """Parts of a file by their number from 1 on, without crumbs; a note on changes; and the share that is left out.

    Crumbs are isolated waypoints, and paths shorter than their bead is wide (`width` [m] if the file does not give it):
    they are left out. A normal opposite to those around it is reversed. If all this makes up more than a share of the
    length, nothing is changed: the file may mean something else. A single such normal loses nothing, and is reversed
    however short the file is, unless the share is zero.
    """
    share = spec.crumbs
    everything = dict(enumerate(parts, 1))
    steps = np.concatenate([np.linalg.norm(np.diff(part.points, axis=0), axis=1) for part in parts])
    if not len(steps):
        return everything, "", 0.0
    usual, total = float(np.median(steps)), float(steps.sum())
    alone, short, stray, lost = [], [], [], 0.0
    kept: dict[int, _FileRows] = {}
    for i, part in everything.items():
        length = float(arc_lengths(part.points)[-1])
        if len(part.points) < 2:
            alone.append(int(part.lines[0]))
            lost += usual
        elif length < (width if part.width is None else float(part.width.min())):
            short.append(int(part.lines[0]))
            lost += length
        else:
            turned = _other_way(part.normals)
            stray += part.lines[turned].tolist()
            lost += usual * int(turned.sum())
            kept[i] = replace(part, normals=np.where(turned[:, None], -part.normals, part.normals))
    spared = usual if len(stray) == 1 and share > 0.0 else 0.0
    if not kept or lost - spared > share * total:
        return everything, "", 0.0
    told = [
        f"{what} {len(lines)} {one if len(lines) == 1 else many} ({spec.rows(lines, _NAMED_LINES)})"
        for lines, what, one, many in (
            (alone, "left out", "waypoint that stands alone", "waypoints that stand alone"),
            (short, "left out", "path shorter than its bead is wide", "paths shorter than their beads are wide"),
            (stray, "turned round", "normal that points the other way", "normals that point the other way"),
        )
        if lines
    ]
    if not told:
        return kept, "", 0.0
    return kept, f"{'; '.join(told)}: {lost / total:.2%} of the length", (lost - usual * len(stray)) / total


def _other_way(normals: Array) -> NDArray[np.bool_]:
    """Which normals (n, 3) are opposite to those around them, where these agree."""
    n = len(normals)
    ends = np.concatenate([np.zeros((1, 3)), np.cumsum(normals, axis=0)])
    first, last = np.maximum(np.arange(n) - _AROUND, 0), np.minimum(np.arange(n) + _AROUND + 1, n)
    others = ends[last] - ends[first] - normals
    size = np.linalg.norm(others, axis=1)
    agree = (last - first > _FEWEST) & (size > _AGREE * (last - first - 1))
    return np.asarray(agree & ((normals * others).sum(axis=1) < -_OPPOSITE * size))


def distinct(points: Array) -> NDArray[np.bool_]:
    """Which points (n) do not repeat the last one kept before them."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moving = step[step > SAME_PLACE]  # creeping points say nothing about the density of the path
    same = max(SAME_POINT * float(np.median(moving)), SAME_PLACE) if len(moving) else SAME_PLACE
    keep = np.concatenate([[True], step > same])
    before, last = 0, -1
    for i in np.flatnonzero(~keep).tolist():  # a few creeping points may add up to a step
        before = before if last == i - 1 and not keep[last] else i - 1
        keep[i] = math.dist(points[i], points[before]) > same
        last = i
    return keep
