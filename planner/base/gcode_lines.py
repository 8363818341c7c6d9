"""Lines of G-code for a board: the commands that share one, and how long its pauses take."""

from __future__ import annotations

import re
from collections.abc import Iterable

PAUSE = "G4 P"  # and milliseconds
_NEXT = re.compile(r" (?=[GM])")  # before a command that shares a line with the one before


def commands_in(line: str) -> list[str]:
    """The commands of a line of G-code."""
    return _NEXT.split(line)


def time_of(code: Iterable[str]) -> float:
    """How long the pauses of some lines take together [s]."""
    commands = (command for line in code for command in commands_in(line))
    return sum(int(command[len(PAUSE) :]) for command in commands if command.startswith(PAUSE)) * 1e-3
