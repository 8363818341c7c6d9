"""The lines that a program will send, and the bead each belongs to: the table written next to the program."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from planner.base.errors import InputError
from planner.base.files import read_text
from planner.link.messages import LONGEST_GCODE, MOST_LINES, is_gcode

COLUMNS = "n,bead,layer,t_s,text"
LARGEST = 100_000_000  # bytes; about two million lines
NO_BEAD = -1
_WHOLE = re.compile(r"-?[0-9]{1,8}")


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
    bead, layer     of that line; -1 if it belongs to none
    resume          the bead to resume from, printed again from its start; None: all beads were printed
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
        """The position of a print, from the last line that the board acknowledged and the last that was sent (`asked`).

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
    """Read the table next to a program, checking each line; InputError names file, line and column of any fault."""
    path = lines_file(program)

    def complain(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, hint=hint or "the link runs programs of `program: style: socket`", file=path)

    rows = read_text(path, LARGEST, complain)
    if rows[0] != COLUMNS:
        raise InputError(f"the first line is not {COLUMNS}", file=path, line=1)
    lines: list[ProgramLine] = []
    for at, row in enumerate(rows[1:], 2):
        if row:
            lines.append(_line(row, len(lines) + 1, lines[-1].t if lines else 0.0, path, at))
    if not 1 <= len(lines) <= MOST_LINES:
        raise InputError(f"holds {len(lines)} lines for the board, not 1 to {MOST_LINES}", file=path)
    return ProgramLines(program.stem, tuple(lines))


def _line(text: str, n: int, since: float, path: Path, at: int) -> ProgramLine:
    def wrong(field: str, reason: str) -> InputError:
        return InputError(reason, file=path, line=at, field=field)

    row = text.split(",", 4)  # the text for the board may contain commas
    if len(row) != 5:
        raise InputError(f"{len(row)} columns, not 5", file=path, line=at)
    numbers = []
    for field, word in zip(("n", "bead", "layer"), row[:3], strict=True):
        if _WHOLE.fullmatch(word) is None:
            raise wrong(field, f"{word!r} is not a whole number")
        numbers.append(int(word))
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
    if not is_gcode(row[4]):
        raise wrong(
            "text", f"{row[4]!r} is no line for the board: a G, M or T code of at most {LONGEST_GCODE} characters"
        )
    return ProgramLine(n, numbers[1], numbers[2], t, row[4])
