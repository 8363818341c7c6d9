"""Simulator of an extruder's board that prints its own file and reads outputs of the robot: no sockets, no clock.

It parses G-code independently of the code that wrote it.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array
from planner.base.gcode_lines import commands_in

READ = 1e-3  # s to read a line from the card
LOOK = 2e-3  # s of delay after an awaited input has changed, until the next line is read
QUEUE = 40  # moves read ahead, as on a Duet 2
GRACE = 10e-3  # s that RepRapFirmware waits for further moves before it begins, unless M595 R sets another time
FIRST = 0.1  # s that Marlin waits for further moves if there are fewer than three
LEAST_SPEED = 0.5  # mm/s, RepRapFirmware's default unless M203 I sets another
SLOWEST = 0.01  # mm/s: least value that M203 I can set
_WORD = re.compile(r"([A-Z])(-?[0-9]*\.?[0-9]+)")
_WHILE = re.compile(r"while sensors\.gpIn\[([0-9]+)\]\.value == 1 && iterations < ([0-9]+)")
_ACTIVATE = re.compile(r"ACTIVATE_EXTRUDER EXTRUDER=extruder([0-9]*)")


@dataclass(frozen=True)
class FileBoard:
    """A board that prints a file.

    firmware      reprap, marlin or klipper: determines its wait commands and how it begins
    acceleration  of filament moves from rest to rest [mm/s^2]; None: moves are joined without stopping
    """

    firmware: str = "reprap"
    acceleration: float | None = None

    def lasts(self, amount: float, rate: float) -> float:
        """How long filament [mm] takes at a rate [mm/s]."""
        way = abs(amount)
        if self.acceleration is None or way == 0.0:
            return way / rate
        top = min(rate, math.sqrt(way * self.acceleration))
        return way / top + top / self.acceleration


@dataclass(frozen=True)
class Output:
    """An output of the robot: switched on at `ons` and off at `offs` [s] alternately, initially off."""

    ons: Array
    offs: Array

    def at(self, time: float) -> bool:
        """Whether it is on."""
        return bool(np.searchsorted(self.ons, time, side="right") > np.searchsorted(self.offs, time, side="right"))

    def when(self, level: bool, time: float) -> float:
        """When it is first on, or off, from a given time: infinity if never."""
        if self.at(time) == level:
            return time
        edges = self.ons if level else self.offs
        k = int(np.searchsorted(edges, time, side="right"))
        return float(edges[k]) if k < len(edges) else math.inf


class FilamentMove(NamedTuple):
    """Filament [mm] moved from `start` to `end` [s] by a line, counted from 1."""

    line: int
    tool: int
    start: float
    end: float
    amount: float


@dataclass(frozen=True)
class Printed:
    """What a board has done with a file: moves, the time of the end [s], warnings, and the line at which it still waits
    for the robot, if it does."""

    moves: tuple[FilamentMove, ...]
    end: float
    warnings: tuple[str, ...] = ()
    waits: int | None = None


def print_file(text: str, board: FileBoard, inputs: Mapping[int, Output] | None = None) -> Printed:
    """Let a board print a file from 0 s; inputs by number, off unless wired."""
    run = _FileRun(text.splitlines(), board, inputs or {})
    run.all()
    return Printed(tuple(run.moves), max(run.read, run.moved), tuple(run.warnings), run.waits)


class _FileRun:
    """A file while it is printed; read: the time up to which lines were read, moved: the end of the last move [s]."""

    def __init__(self, lines: Sequence[str], board: FileBoard, inputs: Mapping[int, Output]) -> None:
        self.moves: list[FilamentMove] = []
        self.warnings: list[str] = []
        self.read = self.moved = 0.0
        self.waits: int | None = None
        self._lines, self._board, self._inputs = lines, board, inputs
        self._tool: int | None = None if board.firmware == "reprap" else 0
        self._grace = GRACE if board.firmware == "reprap" else 0.0
        self._least = LEAST_SPEED if board.firmware == "reprap" else 0.0
        self._ends: deque[float] = deque(maxlen=QUEUE)

    def all(self) -> None:
        """Process all lines, repeating loops."""
        i = 0
        while i < len(self._lines) and self.waits is None:
            loop = _WHILE.fullmatch(self._lines[i].strip())
            if loop is None:
                self._line(i)
                i += 1
                continue
            body = i + 1
            while body < len(self._lines) and self._lines[body].startswith(" "):
                body += 1
            count = 0
            self.read += READ
            while count < int(loop[2]) and self._input(int(loop[1])).at(self.read):
                for k in range(i + 1, body):
                    self._line(k)
                self.read += READ
                count += 1
            i = body

    def _input(self, number: int) -> Output:
        return self._inputs.get(number, Output(np.empty(0), np.empty(0)))

    def _line(self, i: int) -> None:
        text = self._lines[i].split(";")[0].strip()
        for command in commands_in(text) if text else ():
            self.read += READ
            self._command(i, command)

    def _command(self, i: int, text: str) -> None:
        words = dict(_WORD.findall(text))
        code = text.split(" ")[0]
        if code == "G1" and "E" in words:
            self._move(i, float(words["E"]), float(words["F"]) / 60.0)
        elif code == "G4":
            self.read = max(self.read, self.moved) + float(words["P"]) * 1e-3
        elif code == "M400":
            self.read = max(self.read, self.moved)
        elif code in ("M577", "M226"):
            self._wait(i, code, int(words["P"]), words.get("S", "1") == "1")
        elif "T" in words and code == f"T{words['T']}":
            self._tool = int(words["T"])
        elif match := _ACTIVATE.fullmatch(text):
            self._tool = int(match[1] or 0)
        elif code == "M595" and "R" in words:
            self._grace = float(words["R"]) * 1e-3
        elif code == "M203" and "I" in words:
            self._least = max(float(words["I"]) / 60.0, SLOWEST)

    def _wait(self, i: int, code: str, number: int, level: bool) -> None:
        """Wait until an input has a level; Marlin also waits for all moves."""
        if code != {"reprap": "M577", "marlin": "M226"}.get(self._board.firmware):
            self.warnings.append(f"line {i + 1}: {code} is no command")
            return
        since = max(self.read, self.moved) if code == "M226" else self.read
        then = self._input(number).when(level, since)
        self.read = then + LOOK if math.isfinite(then) else since
        self.waits = None if math.isfinite(then) else i + 1

    def _move(self, i: int, amount: float, rate: float) -> None:
        if self._tool is None:
            self.warnings.append(f"line {i + 1}: Attempting to extrude with no tool selected")
            return
        if len(self._ends) == QUEUE:
            self.read = max(self.read, self._ends[0])
        start = self.moved if self.moved > self.read else self.read + self._idle(i)
        self.moved = start + self._board.lasts(amount, max(rate, self._least))
        self._ends.append(self.moved)
        self.moves.append(FilamentMove(i + 1, self._tool, start, self.moved, amount))

    def _idle(self, i: int) -> float:
        """How long an idle board waits before it begins, depending on the moves that follow [s]."""
        count = 1
        while count < QUEUE and i + count < len(self._lines) and self._lines[i + count].lstrip().startswith("G1 "):
            count += 1
        if self._board.firmware == "marlin":
            return FIRST if count < 3 else 2 * READ
        return self._grace + (count * READ if self._grace > 0.0 else 0.0)
