"""What a run can be asked for, by its user or by this program itself, and what it is told of its robot."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from planner.base.errors import nearest_name

# ----------------------------------------------------------------------------------------------------
# Orders, and what is seen of the robot.


@dataclass(frozen=True)
class StopOrder:
    """The run is to end."""

    reason: str


@dataclass(frozen=True)
class PauseOrder:
    """The robot is to stand still where it is, and the board to get no more lines."""

    reason: str


@dataclass(frozen=True)
class ReprimeOrder:
    """The extruder is to feed a length [m] at a speed [m/s] while the robot stands."""

    length: float
    speed: float


@dataclass(frozen=True)
class ContinueOrder:
    """The robot is to go on where it stands, and the board to get its next lines."""


@dataclass(frozen=True)
class RobotStands:
    """The robot was seen to stand, after it was told to pause."""


@dataclass(frozen=True)
class RobotMoves:
    """The robot was seen to go on, after it was told to."""


Order = StopOrder | PauseOrder | ReprimeOrder | ContinueOrder | RobotStands | RobotMoves

# ----------------------------------------------------------------------------------------------------
# How users ask: in words at the terminal, in JSON on the page.

PAUSE, JAM, REPRIME, CONTINUE, STOP = WORDS = ("pause", "jam", "reprime", "continue", "stop")
JAMMED = "the user tells of a jam"
PRIME_MM, PRIME_MM_S = 10.0, 5.0  # what is fed unless the user says otherwise
LENGTHS_MM = (0.1, 500.0)
SPEEDS_MM_S = (0.1, 50.0)


def asked(word: str, mm: float, mm_s: float, where: str) -> Order:
    """The order that a word stands for; where: it was given. Raises ValueError where nothing can be asked for so."""
    if word == REPRIME:
        for value, (low, high), unit in ((mm, LENGTHS_MM, "mm"), (mm_s, SPEEDS_MM_S, "mm/s")):
            if not low <= value <= high:
                raise ValueError(f"{REPRIME}: {value:g} {unit} is not {low:g} to {high:g} {unit}")
        return ReprimeOrder(mm * 1e-3, mm_s * 1e-3)
    if word in (PAUSE, JAM):
        return PauseOrder(JAMMED if word == JAM else f"paused {where}")
    if word == CONTINUE:
        return ContinueOrder()
    if word == STOP:
        return StopOrder(f"stopped {where}")
    near = nearest_name(word, WORDS)
    raise ValueError(f"{word!r} is none of {', '.join(WORDS)}" + (f": did you mean {near}?" if near else ""))


def order_in_words(text: str) -> tuple[str, Order]:
    """What a line typed at the terminal asks for, such as `p`, `pause` or `reprime 20 5` (mm, mm/s): its word and order.

    Raises ValueError with what is wrong.
    """
    first, *rest = text.split() or [""]
    word = next((each for each in WORDS if first and each.startswith(first.lower())), first)
    try:
        numbers = [float(each) for each in rest]
    except ValueError:
        numbers = [float("nan")]
    if len(numbers) > (2 if word == REPRIME else 0) or any(number != number for number in numbers):
        raise ValueError(f"{text!r}: only {REPRIME} takes numbers, a length in mm and a speed in mm/s")
    mm, mm_s = (*numbers, *(PRIME_MM, PRIME_MM_S)[len(numbers) :])
    return word, asked(word, mm, mm_s, "at the terminal")


def order_in_json(body: bytes) -> tuple[str, Order] | None:
    """What the page asks for: its word and order; None where it is nothing that can be asked for."""
    try:
        match json.loads(body):
            case {"do": "reprime", "mm": int() | float() as mm, "mm_s": int() | float() as mm_s, **rest} if not rest:
                return REPRIME, asked(REPRIME, mm, mm_s, "on the page")
            case {"do": str(word), **rest} if not rest and word != REPRIME:
                return word, asked(word, PRIME_MM, PRIME_MM_S, "on the page")
    except (ValueError, RecursionError):
        return None
    return None


def listen_at_terminal(
    may: Callable[[], frozenset[str]], ask: Callable[[Order], None], say: Callable[[str], None]
) -> None:
    """Ask for what is typed at the terminal, from a thread of its own, as long as this program runs.

    may: words of orders that have an effect now
    """
    threading.Thread(target=_read, args=(may, ask, say), name="terminal", daemon=True).start()


def _read(may: Callable[[], frozenset[str]], ask: Callable[[Order], None], say: Callable[[str], None]) -> None:
    # not from sys.stdin, whose lock would be held when this program ends
    with suppress(OSError), open(os.dup(sys.stdin.fileno()), encoding="utf-8", errors="replace") as typed:
        for line in typed:
            try:
                word, order = order_in_words(line)
            except ValueError as error:
                say(str(error))
                continue
            if word in may():
                ask(order)
            else:
                say(f"{word}: not now; what can be asked for: {', '.join(sorted(may())) or 'nothing'}")
