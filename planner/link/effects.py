"""What the relay wants done: values that whoever runs it carries out in order."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from planner.link.program_lines import Position


class Side(Enum):
    """The two ends of the relay."""

    __hash__ = object.__hash__  # an enumeration's own is slow, and sides are looked up for every line

    CONTROLLER = "controller"
    BOARD = "board"


@dataclass(frozen=True)
class Write:
    """Bytes to send to a side."""

    side: Side
    data: bytes


@dataclass(frozen=True)
class Note:
    """A record for the log: what happened, to which line (0: to none), and the words."""

    what: str
    n: int
    text: str


@dataclass(frozen=True)
class StopRobot:
    """The robot is to be stopped by every other way there is, at once."""

    reason: str


@dataclass(frozen=True)
class Outcome:
    """How a run ended: with all lines done (no reason), or stopped, and where the print stands.

    sent  lines that went to the board; it may have carried out the last one without having said so
    safe  the board answered all that makes it safe, or had no reason to
    """

    reason: str | None
    position: Position
    sent: int
    safe: bool


Effect = Write | Note | StopRobot | Outcome
