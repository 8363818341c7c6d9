"""Reads planar G-code as slicers write it: what is extruded, and where.

Nothing specific to the printer that the file was made for is kept. Arcs become polylines.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.budgets import GCODE_BYTES, GCODE_MOVES
from planner.base.errors import Complaint, InputError
from planner.base.files import read_bytes
from planner.toolpath.gcode import marks
from planner.toolpath.gcode.arcs import NoArc, arc_by_centre, centre_by_radius
from planner.toolpath.gcode.marks import NUMBER, OWN, PURGE

LARGEST_FILE = GCODE_BYTES.most
FARTHEST = 100.0  # m: the size of a hall
_MORE = 1.25  # × the longest print that can be planned: beyond this, the rest of a file is not read
_LEVEL = 1e-6  # m by which z may change in a level move
_INCH = 25.4e-3
_FAST = re.compile(rf"G[01]((?: [XYZEF]{NUMBER})+) *(?=;|$)")  # matches nearly all lines
_LINE = re.compile(r"(?:N\d+\s*)?([GMTP])\s*(\d+(?:\.\d+)?)(.*?)(?:\*\s*\d+)?\s*", re.IGNORECASE)
# a lower-case e after a digit is an exponent, which G-code does not have; read as E, it would be another extrusion
_WORDS = re.compile(rf"\s*([A-Za-z])\s*({NUMBER})(?=\s|[A-Za-df-z]|$)\s*")
_MACRO = re.compile(r"[A-Za-z_]{3}\w*|[@%].*", re.DOTALL)  # macro names of printers' firmware, and lines with @ or %
_OTHER_TOOLS = re.compile(rf":({NUMBER})")  # their diameters follow the first one's, as in M200 D1.75:2.85
_ROTARY = "ABC"  # axes that turn the part or the nozzle
_FURTHER = "UVW"  # further axes that machines may have
_AS_WAYPOINTS = "write its points and normals as waypoints: x y z nx ny nz a line, layers.source.waypoints"
_BRACKETS = re.compile(r"\([^()]*\)")
_HOMING = {"G28", "G161", "G162"}
_AXES = re.compile(r"[XYZ]\s*[-+.\d]")
_TOOLS = 100  # tool numbers are below this: T255 and T1000 mean other things to Bambu's printers
_BINARY = b"GCDE"  # how PrusaSlicer's binary files begin
_PLATE = re.compile(r"Metadata/plate_\d+\.gcode")


@dataclass(frozen=True)
class Thread(ReadOnlyArrays):
    """An uninterrupted extrusion, level or rising.

    points (n, 3) [m], n at least 2; for each step, the filament (n - 1) [m] pushed and the line (n - 1) of the file
    height [m] if a comment gives it; kind as a comment gives it, or empty; share: see `marks.share_of`; tool
    """

    points: Array
    filament: Array
    lines: NDArray[np.int64]
    height: float | None
    kind: str
    share: str
    tool: int

    @property
    def z(self) -> float:
        """Its greatest height above z = 0 [m]: that of its layer."""
        return float(self.points[-1, 2])

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


@dataclass(frozen=True)
class GcodeFile:
    """What a file extrudes, in its order.

    before, after, between  numbers of extruding moves in the printer's own code, which are left out
    passed   commands skipped from the first layer on, and how often
    speeds   least and greatest speed of extruding moves [m/s]; empty if the file gives none
    slicer   the program that wrote the file, if stated; marked: whether comments say where layers begin
    height   of most layers [m], if stated
    volume   whether E is a volume in mm^3, not a length: as for a filament of 1 mm^2
    guessed  whether E is relative by the look of its numbers, without a command
    flow     set by M221 for the printer; 1 is full flow
    filament diameters [m] that E refers to, tool 0 first; empty if not stated
    counted  values of M221 by which E is multiplied, each once, if the slicer uses M221 for its own compensation
    """

    threads: tuple[Thread, ...]
    before: int
    after: int
    between: int
    passed: tuple[tuple[str, int], ...]
    speeds: tuple[float, ...]
    slicer: str
    marked: bool
    height: float | None
    volume: bool
    guessed: bool
    flow: float
    filament: tuple[float, ...] = ()
    counted: tuple[float, ...] = ()


def read_gcode(
    path: Path, chord_tolerance: float, where: Complaint | None = None, longest: float = math.inf
) -> GcodeFile:
    """Read a file of G-code; arcs become chords that leave them by at most `chord_tolerance` [m].

    It follows moves (G0 to G3), units (G20, G21), absolute and relative coordinates (G90, G91, M82, M83), G92, tools
    and M200. Where slicers mark layers in comments, the printer's own lines before the first and after the last layer
    are left out, whatever they are. Other commands are skipped and counted. A packed file of Bambu Studio (3MF) is
    unpacked.
    `where(reason, hint=...)` makes the InputError for a fault of the file as a whole.
    Raises InputError with file and line for a line that cannot be read or does not fit a level print, and for the line
    at which the extruded length exceeds `longest` [m], the most that can be planned, by a quarter: the margin is for
    parts that may be left out.
    """
    complain = partial(InputError, file=path) if where is None else where
    text = text_of(path, complain)
    first = 0 if marks.marked(text) else marks.start_ends(text)
    machine = _Machine(path, chord_tolerance, text, first, longest)
    for number, line in enumerate(_lines(text), 1):
        machine.read(number, line)
    machine.close()
    if not machine.threads:
        if machine.lost is not None:
            raise machine.lost
        if any(machine.others.values()):
            moved = ", ".join(axis for axis, value in machine.others.items() if value)
            raise complain(f"{path.name} extrudes nothing by E, but moves {moved}", hint=_AS_WAYPOINTS)
        raise complain(f"{path.name} extrudes nothing", hint="G-code of a slicer, with E")
    slow, fast = machine.speeds
    return GcodeFile(
        threads=tuple(machine.threads),
        before=machine.before,
        after=machine.after,
        between=machine.between,
        passed=tuple(machine.passed.most_common()),
        speeds=(slow, fast) if fast > 0.0 else (),
        slicer=marks.slicer_of(text),
        marked=machine.marked,
        height=marks.usual_height(text),
        volume=machine.volume,
        guessed=machine.guessed,
        flow=machine.flow,
        filament=marks.diameters(text),
        counted=tuple(sorted(machine.counted)),
    )


def text_of(path: Path, complain: Complaint) -> str:
    """The text of a G-code file, unpacked; comments may hold bytes that are not UTF-8. Raises InputError."""
    data = read_bytes(path, LARGEST_FILE, complain)
    if data.startswith(b"PK\x03\x04"):
        data = _unpacked(path, data, complain)
    if data.startswith(_BINARY):
        raise complain(
            f"{path.name} is binary G-code",
            hint="export it as text: in PrusaSlicer, binary G-code is a printer setting",
        )
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        pass
    for number, line in enumerate(data.split(b"\n"), 1):
        try:
            line.partition(b";")[0].decode("utf-8")
        except UnicodeDecodeError:
            raise InputError("is not UTF-8 text", file=path, line=number, hint="save it as plain text") from None
    return data.decode("utf-8", "replace")


def _unpacked(path: Path, data: bytes, complain: Complaint) -> bytes:
    """The G-code of the only plate in a packed file."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            plates = [info for info in packed.infolist() if _PLATE.fullmatch(info.filename)]
            if len(plates) == 1 and plates[0].file_size <= LARGEST_FILE:
                return packed.read(plates[0])
    except (zipfile.BadZipFile, OSError, EOFError, RuntimeError, NotImplementedError, ValueError):
        raise complain(f"{path.name} is a damaged archive") from None
    hint = "unpack the one you want" if plates else "slice it first: a model is not G-code"
    raise complain(f"{path.name} is an archive with G-code of {len(plates)} plates", hint=hint)


def _lines(text: str) -> Iterator[str]:
    """The lines, one by one: a list of millions would need more memory than the text."""
    at = 0
    while (end := text.find("\n", at)) >= 0:
        yield text[at:end]
        at = end + 1
    yield text[at:]


def _without_brackets(code: str) -> str:
    """Code without its comments in brackets, which Skeinforge nests."""
    before = ""
    while code != before:
        before, code = code, _BRACKETS.sub(" ", code)
    return code.strip()


class _Machine:
    """A model of a printer that follows the lines: where it is, and what it has extruded."""

    def __init__(self, path: Path, chord_tolerance: float, text: str, first: int, longest: float) -> None:
        self.wrong: Complaint = partial(InputError, file=path)
        self.chord_tolerance = chord_tolerance
        self.marked = marks.marked(text)
        self.moves, self.length, self.longest = 0, 0.0, longest
        self.first = first  # line at which the print begins in a file without marks
        self.printing = not self.marked and first == 0
        self.ended = False
        self.threads: list[Thread] = []
        self.before = self.after = self.between = 0
        self.passed: Counter[str] = Counter()
        self.lost: InputError | None = None
        self.speeds = (math.inf, 0.0)
        self.x = self.y = self.z = math.nan  # unknown until a line gives them
        self.x_of_0 = self.y_of_0 = self.z_of_0 = 0.0  # origin of the lines' coordinates: G92 moves it, not the nozzle
        self.filament = 0.0
        self.unit = 1e-3
        self.relative = False
        self.guessed = marks.is_relative(text)
        self.filament_relative: bool | None = True if self.guessed else None  # None: like the other axes
        self.volume = marks.is_volume(text)
        self.flow = 1.0
        self.compensated = marks.compensates(text)
        self.flows: dict[int, float] = {}  # factor on E of each tool, if compensated
        self.share_of_e, self.counted = 1.0, set[float]()  # this tool's, and all that were in use while extruding
        self.speed = math.nan
        self.plane = "G17"
        self.others = dict.fromkeys(_ROTARY + _FURTHER, 0.0)  # positions of the other axes
        self.moved, self.turned = "", ""  # those that move in this line, and rotary ones that are not at 0
        self.tool = 0
        self.height: float | None = None
        self.kind, self.share = "", ""
        self.stretches: set[str] = set()
        self.number = 0
        self._kind, self._share = "", ""
        self._x: list[float] = []
        self._y: list[float] = []
        self._z: list[float] = []
        self._pushed: list[float] = []
        self._lines: list[int] = []
        self.commands: dict[str, Callable[[str], None]] = {
            **dict.fromkeys(("G0", "G1"), self._straight),
            "G2": partial(self._arc, True),
            "G3": partial(self._arc, False),
            "G10": self._retract,
            "G11": self._retract,
            "G17": partial(self._take_plane, "G17"),
            "G18": partial(self._take_plane, "G18"),
            "G19": partial(self._take_plane, "G19"),
            "G20": partial(self._take_unit, _INCH),
            "G21": partial(self._take_unit, 1e-3),
            **dict.fromkeys(_HOMING, self._home),
            "G90": partial(self._count, False),
            "G91": partial(self._count, True),
            "G92": self._set,
            "M82": partial(self._count_filament, False),
            "M83": partial(self._count_filament, True),
            "M200": self._take_volume,
            "M221": self._take_flow,
        }

    def read(self, number: int, line: str) -> None:
        """Follow a line."""
        self.number = number
        if number == self.first:
            self.printing = True
        match = _FAST.match(line)
        if match is not None and match.end() == len(line):
            self._plain(match[1])
            return
        if ";" in line:
            self._remark(line.partition(";")[2].strip())
        if match is not None:
            self._plain(match[1])
            return
        code = line.partition(";")[0].strip()
        if "(" in code:
            code = _without_brackets(code)
        if code:
            self._follow(code)

    def _follow(self, code: str) -> None:
        match = _LINE.fullmatch(code)
        if match is None:
            if _MACRO.match(code) and not re.match(rf"[A-Z]\s*{NUMBER}", code, re.IGNORECASE):
                self._pass(code.split()[0])
            elif self.printing:
                raise self._wrong(f"{code[:40]!r} is not a command", "begin with G or M and its number")
            return
        letter, name, rest = match[1].upper(), match[2].lstrip("0") or "0", match[3]
        command = f"{letter}{name}"
        if command in self.commands:
            self.commands[command](rest)
        elif letter == "T":
            self._take(name)
        elif letter == "P":  # Prusa's multi-tool printers park a tool this way
            self.close()
            self._pass(command)
        elif letter == "G" and self.printing and name in ("5", "5.1", "6") and _AXES.search(rest.upper()):
            raise self._wrong(f"{command} is not known", "moves are G0, G1, G2 and G3")
        else:
            self._pass(command)

    def _pass(self, command: str) -> None:
        """Count a skipped command, except in start and end code, whose contents do not matter."""
        if self.printing:
            self.passed[command] += 1

    def _wrong(self, reason: str, hint: str | None = None) -> InputError:
        return self.wrong(reason, line=self.number, hint=hint)

    def _remark(self, text: str) -> None:
        """Interpret a comment on the lines that follow."""
        if marks.LAYER.fullmatch(text):
            self.printing, self.ended = True, False
            self._close_level()
        elif (self.printing or self.ended) and marks.END.fullmatch(text):
            self.close()
            self.printing, self.ended = not self.marked, self.marked
        elif (kind := marks.kind_in(text)) is not None:
            self.kind = kind
            self._share_out()
        elif match := marks.STRETCH.fullmatch(text):
            change = self.stretches.add if match[2] == "START" else self.stretches.discard
            change(match[1])
            self._share_out()
        if match := marks.HEIGHT.fullmatch(text):
            height = 1e-3 * float(match[1] or match[2] or match[3])
            if height != self.height:
                self._close_level()
            self.height = height if height > 0.0 else None

    def _close_level(self) -> None:
        """End the thread at the end of its layer, unless it is a spiral, which runs on through the layers."""
        if self._z and self._z[-1] - self._z[0] <= _LEVEL:
            self.close()

    def _share_out(self) -> None:
        """End the thread if the following lines belong to something else, such as support instead of the part."""
        share = PURGE if self.stretches else marks.share_of(self.kind)
        if share != self.share:
            self.close()
            self.share = share

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
                raise self._twice(letter)
            found[letter] = float(match[2])
            at = match.end()
        return found

    def _twice(self, letter: str) -> InputError:
        return self._wrong(f"{letter} occurs twice in this line")

    # What changes how lines are read
    def _take(self, tool: str) -> None:
        """Change the tool, which begins a new thread."""
        self.close()
        number = int(float(tool))
        if number < _TOOLS:
            self.tool = number
            self.share_of_e = self.flows.get(number, 1.0)

    def _take_plane(self, plane: str, rest: str) -> None:
        self.plane = plane

    def _take_unit(self, unit: float, rest: str) -> None:
        self.unit = unit

    def _take_volume(self, rest: str) -> None:
        """M200: E is a volume if D is a diameter or S is 1, a length if either is 0; D0 overrides S1."""
        words, volume = self._words(_OTHER_TOOLS.sub("", rest)), self.volume
        if "D" in words:
            of_tools = {float(diameter) > 0.0 for diameter in (words["D"], *_OTHER_TOOLS.findall(rest))}
            if len(of_tools) > 1:
                raise self._wrong("E is a volume for some tools only", "one or the other throughout the file")
            volume = of_tools.pop()
        if "S" in words and words.get("D") != 0.0:
            volume = words["S"] > 0.0
        if volume != self.volume and (self.threads or self._pushed):
            raise self._wrong("E changes here between a length and a volume", "one or the other throughout the file")
        self.volume = volume

    def _take_flow(self, rest: str) -> None:
        match = re.search(rf"S\s*({NUMBER})", rest)
        if match is None:
            return
        flow = 0.01 * float(match[1])
        if not self.compensated:
            self.flow = flow
            return
        tool = re.search(r"T\s*(\d+)", rest)
        self.flows[int(tool[1]) if tool else self.tool] = flow
        self.share_of_e = self.flows.get(self.tool, 1.0)

    def _count(self, relative: bool, rest: str) -> None:
        self.relative = relative

    def _count_filament(self, relative: bool, rest: str) -> None:
        self.filament_relative = relative

    def _retract(self, rest: str) -> None:
        if not rest.strip():  # with words, it sets a temperature or an offset of a tool
            self.close()

    def _home(self, rest: str) -> None:
        axes = [axis for axis in "XYZ" if axis in rest.upper()] or ["X", "Y", "Z"]
        self.close()
        for axis in axes:
            setattr(self, axis.lower(), math.nan)
            setattr(self, f"{axis.lower()}_of_0", 0.0)

    def _set(self, rest: str) -> None:
        """G92: set the current position, or all axes to 0 if none is given; printed lines stay where they are."""
        words = self._words(rest) or dict.fromkeys("XYZE", 0.0)
        self.others.update({axis: words[axis] for axis in self.others if axis in words})
        for axis in "XYZ":
            if axis in words:
                name, said = axis.lower(), self.unit * words[axis]
                at = getattr(self, name)
                if (self.threads or self._pushed) and not math.isnan(at):
                    setattr(self, f"{name}_of_0", at - said)
                else:
                    setattr(self, name, said + getattr(self, f"{name}_of_0"))
        self.filament = self.unit * words.get("E", self.filament / self.unit)

    # Moves
    def _plain(self, text: str) -> None:
        """A straight move whose words are known to be well formed."""
        self.moved = ""
        tokens = text.split()
        words = {token[0]: float(token[1:]) for token in tokens}
        if len(words) != len(tokens):
            letters = [token[0] for token in tokens]
            raise self._twice(next(letter for letter in letters if letters.count(letter) > 1))
        self._line(words)

    def _straight(self, rest: str) -> None:
        words = self._move_words(rest)
        if words is not None:
            self._take_others(words)
            self._line(words)

    def _take_others(self, words: dict[str, float]) -> None:
        """Track the axes that a level print does not use."""
        self.moved = ""
        for axis, before in self.others.items():
            if axis in words:
                self.others[axis] = words[axis] + (before if self.relative else 0.0)
                self.moved += axis if self.others[axis] != before else ""
        self.turned = "".join(axis for axis in _ROTARY if self.others[axis])

    def _check_others(self) -> None:
        """Raise where material flows while another axis moves, or with the part or the nozzle turned."""
        if self.printing and self.moved:
            raise self._wrong(f"{self.moved[0]} moves while material flows", _AS_WAYPOINTS)
        if self.printing and self.turned:
            axis = self.turned[0]
            raise self._wrong(f"material flows with {axis} at {self.others[axis]:g}", _AS_WAYPOINTS)

    def _move_words(self, rest: str) -> dict[str, float] | None:
        """Words of a move; None in start code with placeholders that the printer fills in."""
        try:
            return self._words(rest)
        except InputError:
            if self.printing:
                raise
            return None

    def _goal(self, words: dict[str, float]) -> tuple[float, float, float, float]:
        """Where a move ends, and the filament it pushes [m]."""
        unit, x, y, z, pushed = self.unit, self.x, self.y, self.z, 0.0
        if "X" in words:
            x = unit * words["X"] + (x if self.relative else self.x_of_0)
        if "Y" in words:
            y = unit * words["Y"] + (y if self.relative else self.y_of_0)
        if "Z" in words:
            z = unit * words["Z"] + (z if self.relative else self.z_of_0)
        if abs(x) > FARTHEST or abs(y) > FARTHEST or abs(z) > FARTHEST:
            axis = "XYZ"[[abs(x) > FARTHEST, abs(y) > FARTHEST, True].index(True)]
            raise self._wrong(f"{axis} is farther than {FARTHEST:g} m from the origin")
        if "E" in words:
            relative = self.relative if self.filament_relative is None else self.filament_relative
            end = unit * words["E"] + (self.filament if relative else 0.0)
            pushed, self.filament = (end - self.filament) * self.share_of_e, end
        if pushed > 0.0 and (self.moved or self.turned):
            self._check_others()
        if "F" in words:
            if words["F"] <= 0.0 and self.printing:
                raise self._wrong(f"F is {words['F']:g}", "a speed is greater than 0")
            self.speed = unit * words["F"] / 60.0
        return x, y, z, pushed

    def _line(self, words: dict[str, float]) -> None:
        x, y, z, pushed = self._goal(words)
        if pushed > 0.0 and self.printing and "K" in words and (words.get("I") or words.get("J")):
            axis = " ".join(f"{words.get(name, 0.0):g}" for name in "IJK")
            raise self._wrong(f"material flows along a line with the tool's axis (I, J, K) at {axis}", _AS_WAYPOINTS)
        x0, y0, z0 = self.x, self.y, self.z
        self.x, self.y, self.z = x, y, z
        if pushed > 0.0 and (x != x0 or y != y0):
            if self._starts(x0, y0, z0, x, y, z):
                self._x.append(x)
                self._y.append(y)
                self._z.append(z)
                self._pushed.append(pushed)
                self._lines.append(self.number)
        elif x != x0 or y != y0 or z != z0 or pushed != 0.0:
            self.close()

    def _arc(self, clockwise: bool, rest: str) -> None:
        words = self._move_words(rest)
        if words is None:
            return
        self._take_others(words)
        x, y, z, pushed = self._goal(words)
        x0, y0, z0 = self.x, self.y, self.z
        self.x, self.y, self.z = x, y, z
        if pushed <= 0.0:  # a spiral lift, or other travel
            self.close()
            return
        if not self._starts(x0, y0, z0, x, y, z):
            return
        start, end = np.array([x0, y0]), np.array([x, y])
        points = self._chords(start, end, words, clockwise)
        steps = np.hypot(*np.diff(np.vstack([start, points]), axis=0).T)
        length = float(steps.sum())
        self._x += points[:, 0].tolist()
        self._y += points[:, 1].tolist()
        self._z += (z0 + (z - z0) * np.cumsum(steps) / length).tolist()
        self._pushed += (pushed * steps / length).tolist()
        self._lines += [self.number] * len(points)

    def _chords(self, start: Array, end: Array, words: dict[str, float], clockwise: bool) -> Array:
        """Points (n, 2) of an arc, without its start."""
        by_centre, by_radius = "I" in words or "J" in words, "R" in words
        if by_centre == by_radius:
            raise self._wrong("an arc needs its centre (I, J) or its radius (R)", "one of them")
        if words.get("P", 1.0) > 1.0:
            raise self._wrong("an arc of several turns extrudes", "no P, or P1")
        if self.plane != "G17":
            raise self._wrong(f"an arc extrudes in the plane of {self.plane}", "G17: level arcs only")
        try:
            if by_centre:
                centre = start + self.unit * np.array([words.get("I", 0.0), words.get("J", 0.0)])
            else:
                centre = centre_by_radius(start, end, self.unit * words["R"], clockwise)
            points = arc_by_centre(start, end, centre, clockwise, self.chord_tolerance)
        except NoArc as error:
            raise self._wrong(str(error)) from None
        if not (np.abs(points) <= FARTHEST).all():  # even if its ends are near
            raise self._wrong(f"the arc comes farther than {FARTHEST:g} m from the origin")
        return points

    def _starts(self, x0: float, y0: float, z0: float, x: float, y: float, z: float) -> bool:
        """Whether an extruding move belongs to the print, as the next step of a thread or the first of a new one."""
        if not self.printing or self.share == OWN:
            self.close()
            if self.printing:
                self.between += 1
            elif self.ended:
                self.after += 1
            else:
                self.before += 1
            return False
        if math.isnan(x0 + y0 + z0 + x + y + z):
            lost = self._wrong("extrudes before anything says where the nozzle is", "give X, Y and Z before it")
            if self.threads or self._pushed:
                raise lost
            self.lost = self.lost or lost
            self.before += 1
            return False
        if z - z0 < -_LEVEL:
            reason, hint = (
                "z goes down while material flows",
                "lines must be level or rise, as in a spiral: curved layers cannot be read",
            )
            raise self._wrong(reason, hint)
        if self.speed == self.speed:
            slow, fast = self.speeds
            if self.speed < slow or self.speed > fast:
                self.speeds = min(slow, self.speed), max(fast, self.speed)
        if self.share_of_e != 1.0:
            self.counted.add(self.share_of_e)
        self.moves += 1
        self.length += math.hypot(x - x0, y - y0)
        if self.moves > GCODE_MOVES.most or self.length > _MORE * self.longest:
            raise self._too_much()
        if not self.marked and z - z0 > _LEVEL:
            self._close_level()
        if not self._x:
            self._x, self._y, self._z = [x0], [y0], [z0]
            self._kind, self._share = self.kind, self.share
        return True

    def _too_much(self) -> InputError:
        """The error for a print longer than can be planned; its hint says how many layers would fit."""
        if self.moves > GCODE_MOVES.most:
            return GCODE_MOVES.refusal(self.moves, "up to here there are", self._wrong, "print it in several files")
        self.close()
        lengths: dict[int, float] = {}
        for thread in self.threads:
            level = round(thread.z / _LEVEL)
            lengths[level] = lengths.get(level, 0.0) + thread.length
        fits = int(np.searchsorted(np.cumsum([lengths[z] for z in sorted(lengths)]), self.longest, side="right"))
        return self._wrong(
            f"up to here {self.length:.3g} m are extruded in {len(lengths):,} layers; {self.longest:.3g} m can be planned",
            f"what would fit: {f'layers.count: {fits}' if fits else 'a smaller part'}, or a greater process.corner_tolerance_mm",
        )

    def close(self) -> None:
        """End the current thread."""
        if self._pushed:
            points = np.column_stack([self._x, self._y, self._z])
            moved = np.abs(np.diff(points[:, :2], axis=0)).max(axis=1) > 0.0
            pushed, lines = np.array(self._pushed)[moved], np.array(self._lines, dtype=np.int64)[moved]
            thread = Thread(
                points[np.append(True, moved)], pushed, lines, self.height, self._kind, self._share, self.tool
            )
            self.threads.append(thread)
        self._x, self._y, self._z, self._pushed, self._lines = [], [], [], [], []
