"""The lines that a program will send, and what each belongs to: the table that is written beside the program."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

from planner.errors import InputError
from planner.input_file import read_text
from planner.link.messages import LONGEST_GCODE, MOST_LINES

COLUMNS = ("n", "bead", "layer", "t_s", "text")
LARGEST = 100_000_000  # bytes; some two million lines
NO_BEAD = -1


@dataclass(frozen=True)
class ProgramLine:
    """A line for the board: number from 1, bead and layer of the whole print (-1: none), time in the program [s]."""

    n: int
    bead: int
    layer: int
    t: float
    text: str


@dataclass(frozen=True)
class Position:
    """How far a print has come.

    n               the last line that the board acknowledged; 0: none
    bead, layer     of that line; -1 where it belongs to none
    resume          the bead to go on from, printed anew from its start; None: all beads were printed
    """

    n: int
    bead: int
    layer: int
    resume: int | None


@dataclass(frozen=True)
class ProgramLines:
    """All lines of a program, in order."""

    module: str
    lines: tuple[ProgramLine, ...]

    def __len__(self) -> int:
        return len(self.lines)

    def __getitem__(self, n: int) -> ProgramLine:
        """Line n, from 1."""
        return self.lines[n - 1]

    def position(self, acknowledged: int, asked: int) -> Position:
        """Where a print stands whose lines the board acknowledged up to one, and the controller sent up to `asked`.

        A line is sent where its stretch begins, so a bead is done once its last line was acknowledged and a further
        one was sent.
        """
        last = self[acknowledged] if acknowledged else None
        left = last is not None and asked > acknowledged
        resume: int | None = None
        if last is not None and not left and last.bead != NO_BEAD:
            resume = last.bead
        else:
            resume = next((line.bead for line in self.lines[acknowledged:] if line.bead != NO_BEAD), None)
        return Position(acknowledged, last.bead if last else NO_BEAD, last.layer if last else NO_BEAD, resume)


def lines_file(program: Path) -> Path:
    """The table that belongs to a program's module."""
    return program.with_name(f"{program.stem}_lines.csv")


def read_program_lines(program: Path) -> ProgramLines:
    """The table beside a program, checked line by line; InputError names file, line and column of what is wrong."""
    path = lines_file(program)

    def complain(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, hint=hint or "the link runs programs of `program: style: socket`", file=path)

    rows = csv.reader(read_text(path, LARGEST, complain), strict=True)
    lines: list[ProgramLine] = []
    try:
        if tuple(next(rows, ())) != COLUMNS:
            raise InputError(f"the first line is not {','.join(COLUMNS)}", file=path, line=1)
        for row in rows:
            if row:
                lines.append(_line(row, len(lines) + 1, lines[-1].t if lines else 0.0, path, rows.line_num))
    except csv.Error as error:
        raise InputError(str(error), file=path, line=rows.line_num) from None
    if not 1 <= len(lines) <= MOST_LINES:
        raise InputError(f"holds {len(lines)} lines for the board, not 1 to {MOST_LINES}", file=path)
    return ProgramLines(program.stem, tuple(lines))


def _line(row: list[str], n: int, since: float, path: Path, at: int) -> ProgramLine:
    def wrong(field: str, reason: str) -> InputError:
        return InputError(reason, file=path, line=at, field=field)

    if len(row) != len(COLUMNS):
        raise InputError(f"{len(row)} columns, not {len(COLUMNS)}", file=path, line=at)
    numbers = []
    for field, text in zip(COLUMNS[:3], row[:3], strict=True):
        if not text.removeprefix("-").isascii() or not text.removeprefix("-").isdigit() or len(text) > 9:
            raise wrong(field, f"{text!r} is not a whole number")
        numbers.append(int(text))
    if numbers[0] != n:
        raise wrong("n", f"{numbers[0]} where {n} is due")
    if min(numbers[1:]) < NO_BEAD:
        raise wrong("bead", "less than -1")
    try:
        t = float(row[3])
    except ValueError:
        t = math.nan
    if not since <= t < math.inf:
        raise wrong("t_s", f"{row[3]!r} is not a time from {since:g} s on")
    text = row[4]
    if not text.isascii() or not text.isprintable() or not 1 <= len(text) <= LONGEST_GCODE:
        raise wrong("text", f"not a line of 1 to {LONGEST_GCODE} plain characters")
    return ProgramLine(n, numbers[1], numbers[2], t, text)
