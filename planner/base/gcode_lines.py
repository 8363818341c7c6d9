"""Lines of G-code for a board: commands that share a line, and the duration of pauses."""

from __future__ import annotations

import re
from collections.abc import Iterable

PAUSE = "G4 P"  # followed by milliseconds
_NEXT = re.compile(r" (?=[GM])")  # between commands that share a line


def commands_in(line: str) -> list[str]:
    """The commands of a line of G-code."""
    return _NEXT.split(line)


def time_of(code: Iterable[str]) -> float:
    """Total duration of the pauses in some lines [s]."""
    commands = (command for line in code for command in commands_in(line))
    return sum(int(command[len(PAUSE) :]) for command in commands if command.startswith(PAUSE)) * 1e-3
