"""Orders that a run takes from its user or this program, and observations of its robot."""

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
# Orders, and observations of the robot.


@dataclass(frozen=True)
class StopOrder:
    """End the run."""

    reason: str


@dataclass(frozen=True)
class PauseOrder:
    """Stop the robot where it is, and send the board no more lines."""

    reason: str


@dataclass(frozen=True)
class ReprimeOrder:
    """Feed a length [m] at a speed [m/s] while the robot stands."""

    length: float
    speed: float


@dataclass(frozen=True)
class ContinueOrder:
    """Let the robot continue from where it stands, and send the board its next lines."""


@dataclass(frozen=True)
class RobotStands:
    """The robot was observed to stand, after it was told to pause."""


@dataclass(frozen=True)
class RobotMoves:
    """The robot was observed to move on, after it was told to continue."""


Order = StopOrder | PauseOrder | ReprimeOrder | ContinueOrder | RobotStands | RobotMoves

# ----------------------------------------------------------------------------------------------------
# How users give orders: in words at the terminal, in JSON on the page.

PAUSE, JAM, REPRIME, CONTINUE, STOP = WORDS = ("pause", "jam", "reprime", "continue", "stop")
JAMMED = "the user reports a jam"
PRIME_MM, PRIME_MM_S = 10.0, 5.0  # length and speed of feeding by default
LENGTHS_MM = (0.1, 500.0)
SPEEDS_MM_S = (0.1, 50.0)


def asked(word: str, mm: float, mm_s: float, where: str) -> Order:
    """The order that a word stands for; where: the place it was given. Raises ValueError for invalid ones."""
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
    raise ValueError(f"{word!r} is not one of {', '.join(WORDS)}" + (f": did you mean {near}?" if near else ""))


def order_in_words(text: str) -> tuple[str, Order]:
    """The word and order of a line typed at the terminal, such as `p`, `pause` or `reprime 20 5` (mm, mm/s).

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
    """The word and order of a request from the page; None if it is invalid."""
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
    """Pass on orders typed at the terminal, from a separate thread, for as long as this program runs.

    may: returns the words of orders that have an effect now
    """
    threading.Thread(target=_read, args=(may, ask, say), name="terminal", daemon=True).start()


def _read(may: Callable[[], frozenset[str]], ask: Callable[[Order], None], say: Callable[[str], None]) -> None:
    # not from sys.stdin, whose lock would still be held when this program ends
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
                say(f"{word}: not possible now; possible are: {', '.join(sorted(may())) or 'nothing'}")
