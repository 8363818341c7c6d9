"""Columns of numbers from a file of waypoints: text with or without a header that names them, or arrays by name."""

from __future__ import annotations

import io
import re
import warnings
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.errors import Complaint, InputError, nearest_name
from planner.input_file import read_bytes, read_text
from planner.readonly import Array

NEEDED = ("x", "y", "z", "nx", "ny", "nz")
OPTIONAL = ("layer", "bead", "width", "height")
LENGTHS = ("x", "y", "z", "width", "height")
LARGEST_FILE = 500_000_000  # bytes: some five million waypoints
COMMENTS = ("#", "//", "%", ";")
_NAMING = 3  # of the needed names that a line of words must hold to be a header that names columns
_UNIT = re.compile(r"\s*[\[(]\s*(mm|m)\s*[\])]")
# what numpy and zipfile raise at files that are cut off, damaged, encrypted, or lie about their size
_UNREADABLE = (zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, RuntimeError, MemoryError, OverflowError)
_NAME = re.compile(r"(.+)_(mm|m)")


@dataclass(frozen=True)
class Columns:
    """Columns (n) of numbers by name, as they stand in the file; all of NEEDED, some of OPTIONAL; n is at least 1.

    lines (n): where in the file they stand, from 1: of an NPZ file, their places in the arrays.
    unused: names of columns that mean nothing here.
    """

    values: dict[str, Array]
    lines: NDArray[np.int64]
    unused: tuple[str, ...]


@dataclass(frozen=True)
class _Layout:
    """Where the columns stand in a line, by name; what separates them (None: blanks or commas); how many there are."""

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
    """Read a file's columns; lengths in it should be in `unit`, mm or m: a header that says another one is refused.

    Text: comments (#, //, %, ;) and empty lines are passed over. A header names the columns, in a line of words or in
    the comment above the first waypoint; without one they are x y z nx ny nz, and what follows is passed over.
    NPZ: one array for each column. `complain(reason, hint=...)` makes the InputError for what is wrong with the file
    as a whole. Raises InputError with file and line for a line that holds no such numbers.
    """
    data = read_bytes(path, LARGEST_FILE, complain)
    if path.suffix.lower() == ".npz" or data.startswith(b"PK\x03\x04"):
        return _arrays(path, data, unit, complain)
    return _text(path, unit, complain)


def number(word: str) -> float | None:
    """The number that a word is, infinite or not; None for none."""
    try:
        return float(word) if "_" not in word else None
    except ValueError:
        return None


# Names


def _named(names: Sequence[str], unit: str, wrong: Complaint) -> tuple[dict[str, int], tuple[str, ...]]:
    """Where the columns of these names stand, and the names that are not used."""
    places: dict[str, int] = {}
    unused: list[str] = []
    for i, word in enumerate(names):
        name, stated = _name(word)
        if name not in (*NEEDED, *OPTIONAL):
            near = nearest_name(name, OPTIONAL)
            if near is not None and near not in places:
                raise wrong(f"unknown column {word[:40]!r}", hint=f"did you mean {near}? {_known()}")
            unused.append(word)
            continue
        if name in places:
            raise wrong(f"column {name} is there twice")
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


def _name(word: str) -> tuple[str, str | None]:
    """The name of a column, and its unit where it says one: x_mm, X [mm]."""
    plain = _UNIT.sub(r"_\1", word.strip().strip("\"'").lower())
    match = _NAME.fullmatch(plain)
    return (plain, None) if match is None else (match[1], match[2])


# Text


def _text(path: Path, unit: str, complain: Complaint) -> Columns:
    lines = read_text(path, LARGEST_FILE, complain)
    layout, numbers = _layout(path, lines, unit)
    if not numbers:
        raise complain(f"{path.name} holds no waypoints", hint="lines x y z nx ny nz, in mm")
    rows = [lines[i - 1] for i in numbers]
    if layout.separator is None:
        rows = [row.replace(",", " ") for row in rows]
    use = list(layout.places.values())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            table = np.loadtxt(rows, dtype=float, comments=None, delimiter=layout.separator, usecols=use, ndmin=2)
    except (ValueError, UserWarning):
        table = np.array([_row(path, layout, row, i) for row, i in zip(rows, numbers, strict=True)])
    values = {name: table[:, k] for k, name in enumerate(layout.places)}
    return Columns(values, np.array(numbers, dtype=np.int64), layout.unused)


def _layout(path: Path, lines: list[str], unit: str) -> tuple[_Layout, list[int]]:
    """How the columns stand, and the numbers from 1 of the lines that hold a waypoint, or should."""
    full = [i for i, line in enumerate(lines, 1) if line.strip()]
    content = [i for i in full if not lines[i - 1].lstrip().startswith(COMMENTS)]
    if not content:
        return _PLAIN, []
    first = content[0]
    head = lines[first - 1]
    if not any(number(word) is not None for word in _words(head)):
        content = content[1:]
    else:
        above = [i for i in full if i < first]
        first = above[-1] if above else first
        head = lines[first - 1].lstrip().lstrip("#/%; ") if above else ""
        if not set(NEEDED) <= {_name(word)[0] for word in _words(head)}:
            return _PLAIN, content  # a remark
    words = _words(head)
    if len({_name(word)[0] for word in words} & set(NEEDED)) < _NAMING:
        return _PLAIN, content
    places, unused = _named(words, unit, partial(InputError, file=path, line=first))
    return _Layout(places, "," if "," in head else None, len(words), unused), content


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
        raise complain(f"{path.name} is no NPZ file of numbers: {why}", hint=hint) from error
    sizes = {name: len(column) for name, column in values.items()}
    for name, size in sizes.items():
        if size != sizes["x"]:
            raise complain(f"array {name} has {size} numbers, x has {sizes['x']}", hint="one for each waypoint")
    if sizes["x"] == 0:
        raise complain(f"{path.name} holds no waypoints", hint=hint)
    return Columns(values, np.arange(1, sizes["x"] + 1, dtype=np.int64), unused)


def _numbers(array: NDArray[np.generic], name: str, complain: Complaint) -> Array:
    if array.ndim != 1 or array.dtype.kind not in "fiu":
        shape = " x ".join(map(str, array.shape)) or "a single value"
        raise complain(f"array {name} is {shape} of {array.dtype}", hint="one row of numbers each")
    return array.astype(float)
