"""Planar G-code as slicers write it: what is extruded where.

Nothing is kept of the printer that the file was made for. Arcs become polylines.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.errors import Complaint, InputError
from planner.base.files import read_text

_OFF = 0.01, 5e-5  # share of the radius, and m, by which an arc's ends may differ in it: files are rounded
_MOST_CHORDS = 10_000

LARGEST_FILE = 200_000_000  # bytes: some six million moves
FARTHEST = 100.0  # m: a hall
_LEVEL = 1e-6  # m by which z may change in a move that extrudes
_INCH = 25.4e-3
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_LINE = re.compile(r"(?:N\d+\s*)?([GMT])\s*(\d+(?:\.\d+)?)(.*?)(?:\*\s*\d+)?\s*", re.IGNORECASE)
# a small e behind a digit is an exponent, which G-code does not have: read as E it would be another extrusion
_WORDS = re.compile(rf"\s*([A-Za-z])\s*({_NUMBER})(?=\s|[A-Za-df-z]|$)\s*")
_MACRO = re.compile(r"[A-Za-z_]{3}\w*|[@%].*", re.DOTALL)  # a macro's name of a printer's own firmware, and marks
_BRACKETS = re.compile(r"\([^)]*\)")
# homing aside, what moves nothing of the print: dwell, retraction by the firmware, planes and levelling
_HARMLESS = {f"G{n}" for n in (4, 12, 17, 26, 27, 29, 30, 31, 32, 33, 34, 40, 49, 53, 54, 60, 80, 94)}
_HOMING = {"G28", "G161", "G162"}
# Marks that slicers leave in comments: Cura; PrusaSlicer, SuperSlicer, OrcaSlicer; Bambu Studio; Simplify3D.
_LAYER = re.compile(r"LAYER:\s*-?\d+|LAYER_CHANGE|CHANGE_LAYER|layer \d+, Z\b.*")
_KIND = re.compile(r"(?:TYPE:|FEATURE:|feature )\s*(.+)")
_HEIGHT = re.compile(rf"(?:HEIGHT:|LAYER_HEIGHT:)\s*({_NUMBER})|tool H({_NUMBER}) W.*")


class NoArc(ValueError):
    """There is no such arc; the message says why."""


def arc_by_centre(start: Array, end: Array, centre: Array, clockwise: bool, chord_tolerance: float) -> Array:
    """Points (n, 2) of an arc from start (2, exclusive) to end (2, inclusive) [m]; a whole circle where these are one.

    Chords leave the arc by at most `chord_tolerance` [m]. Raises NoArc.
    """
    a, b = start - centre, end - centre
    r, last = float(np.hypot(*a)), float(np.hypot(*b))
    if r == 0.0:
        raise NoArc("the arc's centre is where it starts")
    if abs(last - r) > max(_OFF[0] * r, _OFF[1]):
        raise NoArc(f"the arc starts {r * 1e3:.3f} mm from its centre and ends {last * 1e3:.3f} mm from it")
    first = float(np.arctan2(a[1], a[0]))
    sweep = float(np.arctan2(b[1], b[0])) - first
    sweep = -((-sweep) % (2.0 * np.pi)) if clockwise else sweep % (2.0 * np.pi)
    if sweep == 0.0 or np.array_equal(start, end):
        sweep = -2.0 * np.pi if clockwise else 2.0 * np.pi
    step = 2.0 * np.arccos(max(1.0 - chord_tolerance / r, 0.0))
    n = int(min(max(np.ceil(abs(sweep) / step), 1), _MOST_CHORDS))
    u = np.arange(1, n + 1) / n
    radius = r + (last - r) * u
    angle = first + sweep * u
    points = centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    points[-1] = end
    return np.asarray(points)


def centre_by_radius(start: Array, end: Array, radius: float, clockwise: bool) -> Array:
    """Centre (2) of the arc of a radius [m] from start to end; a negative radius is that of the longer arc. Raises NoArc."""
    way = end - start
    half = 0.5 * float(np.hypot(*way))
    if half == 0.0:
        raise NoArc("an arc by its radius ends where it starts")
    if half > abs(radius) + _OFF[1]:
        raise NoArc(f"an arc of radius {abs(radius) * 1e3:.3f} mm cannot join points {half * 2e3:.3f} mm apart")
    away = float(np.sqrt(max(radius**2 - half**2, 0.0)))
    left = np.array([-way[1], way[0]]) / (2.0 * half)
    # of a counter-clockwise arc of less than half a turn the centre lies to the left
    side = -1.0 if clockwise == (radius > 0.0) else 1.0
    return np.asarray(0.5 * (start + end) + side * away * left)


@dataclass(frozen=True)
class Thread(ReadOnlyArrays):
    """What is extruded without interruption, in one layer.

    points (n, 2) [m], n at least 2; filament (n - 1) [m] pushed and lines (n - 1) of the file, of each step
    z, and height where a comment says it [m]; kind as a comment says it, or nothing
    """

    points: Array
    filament: Array
    lines: NDArray[np.int64]
    z: float
    height: float | None
    kind: str


@dataclass(frozen=True)
class GcodeFile:
    """What a file extrudes, in its order.

    before  moves that extrude before the first layer, which are left out
    speeds  least and greatest speed of extruding moves [m/s]; empty where the file gives none
    """

    threads: tuple[Thread, ...]
    before: int
    speeds: tuple[float, ...]


def read_gcode(path: Path, chord_tolerance: float, where: Complaint | None = None) -> GcodeFile:
    """Read a file of G-code; arcs become chords that leave them by at most `chord_tolerance` [m].

    Read are moves (G0 to G3), units (G20, G21), absolute and relative coordinates (G90, G91, M82, M83), and G92.
    Where slicers mark layers in comments, the printer's own lines before the first layer are left out. What moves no
    axis is passed over. `where(reason, hint=...)` makes the InputError for what is wrong with the file as a whole.
    Raises InputError with file and line for a line that cannot be read, or that a level print has no place for.
    """
    complain = partial(InputError, file=path) if where is None else where
    lines = read_text(path, LARGEST_FILE, complain)
    marked = any(_LAYER.fullmatch(_comment(line)) for line in lines if ";" in line)
    machine = _Machine(path, chord_tolerance, printing=not marked)
    for number, line in enumerate(lines, 1):
        machine.read(number, line)
    machine.close()
    if not machine.threads:
        raise complain(f"{path.name} extrudes nothing", hint="G-code of a slicer, with E")
    speeds = (min(machine.speeds), max(machine.speeds)) if machine.speeds else ()
    return GcodeFile(tuple(machine.threads), machine.before, speeds)


def _comment(line: str) -> str:
    """What stands behind the semicolon."""
    return line.partition(";")[2].strip()


class _Machine:
    """A printer that follows the lines: where it is, and what it has extruded."""

    def __init__(self, path: Path, chord_tolerance: float, printing: bool) -> None:
        self.wrong: Complaint = partial(InputError, file=path)
        self.chord_tolerance = chord_tolerance
        self.printing = printing
        self.threads: list[Thread] = []
        self.before = 0
        self.speeds: set[float] = set()
        self.place = np.full(3, math.nan)  # nobody knows before it is said
        self.filament = 0.0
        self.unit = 1e-3
        self.relative = False
        self.filament_relative: bool | None = None  # None: as the other axes
        self.speed = math.nan
        self.tool: int | None = None
        self.height: float | None = None
        self.kind = ""
        self.number = 0
        self._z, self._kind = math.nan, ""
        self._points: list[Array] = []
        self._pushed: list[float] = []
        self._lines: list[int] = []
        self.commands: dict[str, Callable[[dict[str, float]], None]] = {
            "G0": self._straight,
            "G1": self._straight,
            "G2": partial(self._arc, True),
            "G3": partial(self._arc, False),
            "G92": self._set,
        }

    def read(self, number: int, line: str) -> None:
        """Follow a line."""
        self.number = number
        if ";" in line:
            self._remark(_comment(line))
        code = _BRACKETS.sub(" ", line.partition(";")[0]).strip()
        if not code:
            return
        match = _LINE.fullmatch(code)
        if match is None:
            if _MACRO.match(code) and not re.match(rf"[A-Z]\s*{_NUMBER}", code, re.IGNORECASE):
                return
            raise self._wrong(f"{code[:40]!r} is no command", "G or M and its number first")
        letter, name, rest = match[1].upper(), match[2].lstrip("0") or "0", match[3]
        self._follow(f"{letter}{name}", rest)

    def _follow(self, command: str, rest: str) -> None:
        if command in self.commands:
            self.commands[command](self._words(rest))
        elif command in ("G20", "G21"):
            self.unit = _INCH if command == "G20" else 1e-3
        elif command in ("G90", "G91"):
            self.relative = command == "G91"
        elif command in ("M82", "M83"):
            self.filament_relative = command == "M83"
        elif command in ("G10", "G11"):
            self.close()
        elif command in _HOMING:
            axes = [i for i, axis in enumerate("XYZ") if axis in rest.upper()] or [0, 1, 2]
            self.close()
            self.place[axes] = math.nan
        elif command == "M200" and self._words(rest).get("D", 0.0) > 0.0:
            raise self._wrong("E is a volume here", "turn volumetric extrusion off in the slicer")
        elif command.startswith("T"):
            self._take(int(float(command[1:])))
        elif command.startswith("G") and command not in _HARMLESS:
            raise self._wrong(f"{command} is not known", "moves are G0, G1, G2 and G3")

    def _wrong(self, reason: str, hint: str | None = None) -> InputError:
        return self.wrong(reason, line=self.number, hint=hint)

    def _remark(self, text: str) -> None:
        """What a comment says of what follows."""
        if _LAYER.fullmatch(text):
            self.printing = True
        elif match := _KIND.fullmatch(text):
            self.kind = match[1].strip()
        elif match := _HEIGHT.fullmatch(text):
            height = 1e-3 * float(match[1] or match[2])
            if height != self.height:
                self.close()
            self.height = height

    def _words(self, rest: str) -> dict[str, float]:
        """Letters and their numbers."""
        found: dict[str, float] = {}
        at, rest = 0, rest.strip()
        while at < len(rest):
            match = _WORDS.match(rest, at)
            if match is None:
                raise self._wrong(f"cannot read {rest[at : at + 20]!r}", "letters, each with a number")
            letter = match[1].upper()
            if letter in found:
                raise self._wrong(f"{letter} stands in this line twice")
            found[letter] = float(match[2])
            at = match.end()
        return found

    def _take(self, tool: int) -> None:
        """Another tool: only before anything is printed."""
        if self.tool is not None and tool != self.tool and (self.threads or self._pushed):
            raise self._wrong(f"takes tool {tool} after tool {self.tool}", "print with one tool: one material is laid")
        self.tool = tool

    def _set(self, words: dict[str, float]) -> None:
        """G92: here is what is said; all axes at 0 if nothing is."""
        words = words or dict.fromkeys("XYZE", 0.0)
        for i, axis in enumerate("XYZ"):
            if axis in words:
                self.close()
                self.place[i] = self.unit * words[axis]
        self.filament = self.unit * words.get("E", self.filament / self.unit)

    def _goal(self, words: dict[str, float]) -> tuple[Array, float]:
        """Where a move ends (3) [m], and the filament [m] that it pushes."""
        goal = self.place.copy()
        for i, axis in enumerate("XYZ"):
            if axis in words:
                goal[i] = self.unit * words[axis] + (goal[i] if self.relative else 0.0)
                if abs(goal[i]) > FARTHEST:
                    raise self._wrong(f"{axis} is farther than {FARTHEST:g} m from the origin")
        pushed = 0.0
        if "E" in words:
            relative = self.relative if self.filament_relative is None else self.filament_relative
            end = self.unit * words["E"] + (self.filament if relative else 0.0)
            pushed, self.filament = end - self.filament, end
        if "F" in words:
            if words["F"] <= 0.0:
                raise self._wrong(f"F is {words['F']:g}", "a speed is greater than 0")
            self.speed = self.unit * words["F"] / 60.0
        return goal, pushed

    def _straight(self, words: dict[str, float]) -> None:
        goal, pushed = self._goal(words)
        self._move(goal, goal[None, :2], pushed)

    def _arc(self, clockwise: bool, words: dict[str, float]) -> None:
        start = self.place[:2].copy()
        goal, pushed = self._goal(words)
        end = goal[:2]
        if np.isnan([*start, *end]).any():
            raise self._wrong("an arc starts here, and nothing says where the nozzle is", "X and Y before it")
        by_centre, by_radius = "I" in words or "J" in words, "R" in words
        if by_centre == by_radius or "P" in words:
            raise self._wrong("an arc needs its centre (I, J) or its radius (R)", "one of them, and no P")
        try:
            if by_centre:
                centre = start + self.unit * np.array([words.get("I", 0.0), words.get("J", 0.0)])
            else:
                centre = centre_by_radius(start, end, self.unit * words["R"], clockwise)
            points = arc_by_centre(start, end, centre, clockwise, self.chord_tolerance)
        except NoArc as error:
            raise self._wrong(str(error)) from None
        self._move(goal, points, pushed)

    def _move(self, goal: Array, way: Array, pushed: float) -> None:
        """Move to the goal (3) by way of points (n, 2), the goal's last, pushing filament [m]."""
        start, self.place = self.place, goal
        steps = np.hypot(*np.diff(np.vstack([start[:2], way]), axis=0).T)
        length = float(steps.sum())  # NaN where the start is not known
        if length == 0.0 and pushed == 0.0 and goal[2] == start[2]:
            return
        if pushed <= 0.0 or length == 0.0:
            self.close()
            return
        if not self.printing:
            self.before += 1
            return
        if not (math.isfinite(length) and np.isfinite([start[2], goal[2]]).all()):
            raise self._wrong("extrudes, and nothing says where the nozzle is", "X, Y and Z before it")
        if abs(goal[2] - start[2]) > _LEVEL:
            raise self._wrong("z changes while material flows", "level layers only: no spiral vase")
        if math.isfinite(self.speed):
            self.speeds.add(self.speed)
        if not self._points:
            self._points, self._z, self._kind = [start[:2].copy()], float(goal[2]), self.kind
        self._points += list(way)
        self._pushed += (pushed * steps / length).tolist()
        self._lines += [self.number] * len(way)

    def close(self) -> None:
        """End what is being extruded."""
        if self._pushed:
            moved = np.hypot(*np.diff(self._points, axis=0).T) > 0.0
            points = np.array(self._points)[np.append(True, moved)]
            pushed, lines = np.array(self._pushed)[moved], np.array(self._lines, dtype=np.int64)[moved]
            self.threads.append(Thread(points, pushed, lines, self._z, self.height, self._kind))
        self._points, self._pushed, self._lines = [], [], []
