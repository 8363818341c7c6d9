"""Files that give the print point by point, read again: waypoints, and the extruding moves of planar G-code.

Both are read in a few lines, independent of the planner's readers: as numbers in a table, and by a machine with a
position, an extruder and their modes. Lengths are in metres, in the part frame.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.problem.layers import GcodeSpec, WaypointsSpec
from planner.verify.reread.plane_curves import NotRead, gone

_LONG = 10.0  # × the median step: a longer step between waypoints need not be printed
_STILL = 1e-7  # m: a waypoint no farther from the one before repeats it
_BEND = 0.2  # × a step: an arc that turns by 90 degrees between waypoints leaves its chord by this much
_ARC, _OFF = 64, 5e-3  # least number of chords of an arc, and mm that they may lie off it
_LEVEL = 5e-3  # mm: rounding of heights
_SEMICOLONS = 5  # in a line: with at least this many, they separate values
_UNIT = r"(?:[ _]*[(\[]?\s*m{1,2}\s*[)\]]?)?"
_COLUMN = re.compile(rf"([xyz]){_UNIT}", re.IGNORECASE)
_EXPORTED = re.compile(rf"(?:p|pos|position|points?|tcp)[ _:.-]?([xyz012]){_UNIT}", re.IGNORECASE)  # pos_x, Points:0
_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_USUAL = re.compile(r"^;\s*(?:Layer height:|layer_height =)\s*(\d*\.?\d+)", re.MULTILINE)
_HEIGHT = re.compile(r";\s*(?:HEIGHT:|LAYER_HEIGHT:|tool H|BEGIN_LAYER_\w+ z=\S+ z_thickness=)\s*(\d*\.?\d+)")
_FEATURE = re.compile(r";\s*(?:TYPE|FEATURE)\s*:\s*(.+)", re.IGNORECASE)
_CLEANING = re.compile(r";\s*(CP [A-Z ]+?|FLUSH|WIPE_TOWER)[ _](START|END)\b")  # where a tool is changed or cleaned
# Words in slicers' names of features, by what may be left out; start code and purge lines always may.
_LEFT_OUT = {
    "purge": ("purge", "prime", "wipe", "ooze", "flush", "custom"),
    "skirt": ("skirt", "brim"),
    "brim": ("skirt", "brim"),
    "support": ("support",),
    "ironing": ("ironing",),
}


class Segments(NamedTuple):
    """Straight pieces from `start` (n, 3) to `end` (n, 3) [m].

    needed  whether each (n) must be printed; None where no names of features decide that
    bend    × a piece's length: a smooth curve through its ends may leave it by this much
    """

    start: Array
    end: Array
    needed: Flags | None
    bend: float = 0.0


def segments_of(source: WaypointsSpec | GcodeSpec) -> Segments | NotRead:
    """The pieces of a file's paths in the part frame."""
    try:
        return _moves(source) if isinstance(source, GcodeSpec) else _waypoints(source)
    except OSError as error:
        return gone(error)
    except (ValueError, zipfile.BadZipFile) as error:
        return NotRead(f"the file holds no points: {error}")


def _moves(source: GcodeSpec) -> Segments | NotRead:
    """The extruding moves of a file."""
    stamp = source.gcode.stat()
    found = _gcode(source.gcode, stamp.st_mtime_ns, stamp.st_size)
    if isinstance(found, NotRead):
        return found
    start, end, names = found
    shift = np.asarray(source.origin)
    left = [word for share in ("purge", *source.leave_out) for word in _LEFT_OUT[share]]
    needed = None
    if any(names):
        needed = np.array([bool(name) and not any(word in name for word in left) for name in names])
    return Segments(start + shift, end + shift, needed)


def _waypoints(source: WaypointsSpec) -> Segments | NotRead:
    """The steps from waypoint to waypoint, without waypoints that repeat the one before."""
    given = source.waypoints
    if isinstance(given, Path):
        stamp = given.stat()
        points = _table(given, stamp.st_mtime_ns, stamp.st_size)
    else:
        points = given.points
    if isinstance(points, NotRead):
        return points
    x = points * (1e-3 if source.unit == "mm" else 1.0)
    if source.up == "y":
        x = np.column_stack([x[:, 0], -x[:, 2], x[:, 1]])
    elif source.up == "x":
        x = np.column_stack([x[:, 1], x[:, 2], x[:, 0]])
    x = x + np.asarray(source.origin)
    x = x[np.append(True, np.linalg.norm(np.diff(x, axis=0), axis=1) > _STILL)]
    if len(x) < 2:
        return NotRead("all waypoints of the file are one")
    step = np.linalg.norm(np.diff(x, axis=0), axis=1)
    return Segments(x[:-1], x[1:], step <= _LONG * float(np.median(step)), _BEND)


@lru_cache(maxsize=2)
def _table(path: Path, changed: int, size: int) -> Array | NotRead:
    """The points (n, 3) of a file of waypoints, in its own unit and axes; `changed` and `size` identify the file."""
    if zipfile.is_zipfile(path):
        with np.load(path, allow_pickle=False) as arrays:
            places = _places(arrays.files)
            if places is None:
                return NotRead("no arrays are called x, y and z")
            return np.column_stack([np.asarray(arrays[arrays.files[i]], dtype=float) for i in places])
    rows: list[list[float]] = []
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    vertices = [line.split()[1:4] for line in lines if line.startswith(("v ", "v\t"))]
    if vertices:
        return np.array(vertices, dtype=float)
    columns, commas = [0, 1, 2], False
    for line in filter(str.strip, lines):
        remark = line.lstrip()[0] in "#/%;"
        if not remark and line.count(";") >= _SEMICOLONS:  # used where the comma is the decimal separator
            line = line.replace(",", ".").replace(";", ",")
        head = re.sub(r"\s+(?=[(\[])", "", line.strip(" \t#/%;"))  # units in brackets belong to the preceding word
        named = None if rows else _places(head.split(",") if "," in head else head.split())
        if named is not None:
            columns, commas = named, "," in head
        elif not remark:
            cells = line.split(",") if commas and "," in line else line.replace(",", " ").split()
            try:
                rows.append([float(cells[i]) for i in columns])
            except (ValueError, IndexError):
                continue  # a title
    return np.array(rows) if len(rows) > 1 else NotRead("no table of numbers is found in the file")


def _places(names: Sequence[str]) -> list[int] | None:
    """Indices of x, y and z among names of columns; these very names take precedence over longer ones."""
    for pattern in (_COLUMN, _EXPORTED):
        found = {}
        for i, name in enumerate(names):
            if match := pattern.fullmatch(name.strip(" \t\"'")):
                axis = match[1].lower()
                found["xyz"[int(axis)] if axis.isdecimal() else axis] = i
        if len(found) == 3:
            return [found[axis] for axis in "xyz"]
    return None


@lru_cache(maxsize=1)
def _gcode(path: Path, changed: int, size: int) -> tuple[Array, Array, tuple[str, ...]] | NotRead:
    """Extruding moves: their starts and ends (n, 3) [m], and the feature that each is part of, in lower case."""
    text = path.read_text(encoding="utf-8", errors="replace")
    if not re.search(r"^\s*M8[23]\b", text, re.MULTILINE):
        return NotRead("the file does not say whether E is relative")
    at, e, unit = np.zeros(3), 0.0, 1.0
    zero = np.zeros(3)  # origin of absolute moves
    homed = np.zeros(3, dtype=bool)  # axes homed, whose position is unknown since
    absolute, name = True, ""
    said: bool | None = None  # whether E is absolute, by M82 or M83; before either it follows the axes
    starts: list[Array] = []
    ends: list[Array] = []
    names: list[str] = []
    runs: list[tuple[int, float]] = []  # uninterrupted run that each move belongs to, and the height of its layer
    usual = float(match[1]) if (match := _USUAL.search(text)) else 0.0
    run, foot, height = 0, 0.0, usual
    cleaning: set[str] = set()
    for line in text.splitlines():
        if match := _FEATURE.match(line):
            name = match[1].strip().lower()
        elif match := _CLEANING.match(line):
            (cleaning.add if match[2] == "START" else cleaning.discard)(match[1])
        elif match := _HEIGHT.match(line):
            height = float(match[1]) or usual
        code, words = _words(line)
        given = np.array([axis in words for axis in "XYZ"])
        target = np.array([words.get(axis, 0.0) * unit for axis in "XYZ"])
        if code in ("G20", "G21"):
            unit = 25.4 if code == "G20" else 1.0
        elif code in ("G90", "G91"):
            absolute = code == "G90"
        elif code in ("M82", "M83"):
            said = code == "M82"
        elif code in ("G28", "G161", "G162"):
            named = np.array([axis in line.partition(";")[0].upper() for axis in "XYZ"])
            homed |= named | ~named.any()
            zero[homed] = 0.0
        elif code == "G92":
            given = given | (len(words) == 1)  # the code alone means all axes
            stays = given & ~homed & bool(starts)  # keeps the print so far where it is
            zero = np.where(stays, at - target, zero)
            at = np.where(given & ~stays, target + zero, at)
            e = words.get("E", 0.0 if len(words) == 1 else e)
            homed &= ~given
        elif code in ("G0", "G1", "G2", "G3"):
            there = np.where(given, target + (zero if absolute else at), at)
            homed &= ~given
            from_zero = absolute if said is None else said
            fed = words.get("E", e if from_zero else 0.0) - (e if from_zero else 0.0)
            e = e + fed
            if (fed > 0.0 and np.abs(there - at)[:2].max() > 0.0) or (fed > 0.0 and code in ("G2", "G3")):
                way = [at, there] if code in ("G0", "G1") else _arc(at, there, words, unit, code == "G2")
                starts += way[:-1]
                ends += way[1:]
                names += ["purge" if cleaning else name] * (len(way) - 1)
                begun = bool(runs) and runs[-1][0] == run
                if begun and there[2] > at[2] == foot:  # the level moves so far belong to the layer below
                    run, begun = run + 1, False
                foot = foot if begun else at[2]
                runs += [(run, height)] * (len(way) - 1)
            elif fed or (there != at).any():
                run += 1
            at = there
    if not starts:
        return NotRead("no move of the file extrudes")
    start, end = _levelled(np.array(starts), np.array(ends), *np.array(runs).T)
    return start * 1e-3, end * 1e-3, tuple(names)


def _levelled(start: Array, end: Array, run: Array, height: Array) -> tuple[Array, Array]:
    """Moves (n, 3) [mm]; runs that rise by no more than their layer's height (scarf seams) are levelled at their final
    height, as they lie next to lines of that height and are laid level."""
    first = np.flatnonzero(np.diff(run, prepend=-1.0))
    last = np.append(first[1:], len(run)) - 1
    rise = end[last, 2] - start[first, 2]
    level = np.repeat((rise > 0.0) & (rise <= height[last] + _LEVEL), last - first + 1)
    top = np.repeat(end[last, 2], last - first + 1)
    for points in (start, end):
        points[level, 2] = top[level]
    return start, end


def _words(line: str) -> tuple[str, dict[str, float]]:
    """The code of a line, such as G1, and its words by letter."""
    plain = re.sub(r"\(.*?\)", "", line.partition(";")[0]).upper()
    words = {letter: float(value) for letter, value in _WORD.findall(plain) if letter != "N"}
    first = next((letter for letter in ("G", "M") if letter in words), "")
    return (f"{first}{words[first]:g}" if first else ""), words


def _arc(at: Array, there: Array, words: dict[str, float], unit: float, clockwise: bool) -> list[Array]:
    """Places along an arc of G2 or G3, with its centre given by I and J or its radius by R."""
    if "R" in words:
        half, r = 0.5 * (there - at)[:2], words["R"] * unit
        up = np.sqrt(max(r * r - float(half @ half), 0.0)) * np.array([-half[1], half[0]]) / max(np.hypot(*half), 1e-12)
        centre = at[:2] + half + (up if (r > 0.0) != clockwise else -up)
    else:
        centre = at[:2] + unit * np.array([words.get("I", 0.0), words.get("J", 0.0)])
    begin, end = (np.arctan2(*(p[:2] - centre)[::-1]) for p in (at, there))
    turn = (end - begin) % (2.0 * np.pi) or 2.0 * np.pi
    turn = turn - 2.0 * np.pi if clockwise and turn < 2.0 * np.pi else (-turn if clockwise else turn)
    size = float(np.hypot(*(at[:2] - centre)))
    chords = max(_ARC, int(np.ceil(abs(turn) * np.sqrt(size / (8.0 * _OFF)))))
    share = np.linspace(0.0, 1.0, chords + 1)
    radius = size + share * (np.hypot(*(there[:2] - centre)) - size)
    angle = begin + share * turn
    places = np.column_stack(
        [centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle), at[2] + share * (there - at)[2]]
    )
    return list(places)


def dots_along(segments: Segments, apart: float) -> tuple[Array, Ints]:
    """Places (m, 3) along segments, at most `apart` [m] from each other, and the segment (m) that each is on."""
    length = np.linalg.norm(segments.end - segments.start, axis=1)
    count = np.maximum(np.ceil(length / apart), 1.0).astype(np.int64)
    which = np.repeat(np.arange(len(length), dtype=np.int64), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[which]
    return segments.start[which] + share[:, None] * (segments.end - segments.start)[which], which


def distances_from(segments: Segments, points: Array, near: Sequence[Ints]) -> Array:
    """Distances (n) of points (n, 3) from the nearest of their candidate segments `near`, less what these may bend."""
    out = np.full(len(points), np.inf)
    for k in near:
        start, way = segments.start[k], segments.end[k] - segments.start[k]
        share = ((points - start) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-30)
        foot = start + np.clip(share, 0.0, 1.0)[:, None] * way
        away = np.linalg.norm(points - foot, axis=1) - segments.bend * np.linalg.norm(way, axis=1)
        out = np.minimum(out, np.maximum(away, 0.0))
    return out
