"""What a program's motion looks like over time, as a controller's simulator needs it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planner.export.program import Program
from planner.readonly import Array

ORDER = OUTPUT, SEND, SETTLE = "output", "send", "settle"
# lines that the board acknowledges only when they are over
SLOW = ("G4", "M109", "M116", "M190")


@dataclass(frozen=True)
class Happening:
    """Something that a program does at a time [s], with a move.

    Sets an output (`signal=0`, `signal=1`); sends a line; or waits, at the end of a rest, until all lines are taken.
    """

    time: float
    move: int
    kind: str
    text: str = ""


class Motion(Protocol):
    """A program's motion. Times [s] count from its first move."""

    @property
    def duration(self) -> float: ...

    @property
    def happenings(self) -> tuple[Happening, ...]:
        """In order of time."""

    def at(self, time: float) -> tuple[int, Array]:
        """The move that runs at a time, and the tip in the part frame (3,) [m]."""


@dataclass(frozen=True)
class OwnClock:
    """Motion at the programmed speeds, without acceleration: each move takes as long as its slowest part.

    ends (m,) when each move ends, its wait not counted; starts (m,); position (m, 3) of the targets
    """

    starts: Array
    ends: Array
    position: Array
    duration: float
    happenings: tuple[Happening, ...]

    def at(self, time: float) -> tuple[int, Array]:
        """The move that runs at a time, and the tip in the part frame (3,) [m]."""
        i = min(int(np.searchsorted(self.ends, time)), len(self.ends) - 1)
        lasts = self.ends[i] - self.starts[i]
        share = 1.0 if lasts <= 0.0 else float(np.clip((time - self.starts[i]) / lasts, 0.0, 1.0))
        before = self.position[max(0, i - 1)]
        return i, before + share * (self.position[i] - before)


def own_clock(program: Program) -> OwnClock:
    """The motion of a program by its own speeds and lengths."""
    step = np.linalg.norm(np.diff(program.position, axis=0), axis=1)
    same = np.abs(np.einsum("ij,ij->i", program.quat[1:], program.quat[:-1])).clip(0.0, 1.0)
    turn = 2.0 * np.arccos(same)
    axes = np.nan_to_num(np.abs(np.diff(program.external, axis=0))).max(axis=1, initial=0.0)
    tip, reorient, _, rotate = program.speed[1:].T
    # the first move goes to where the robot stands already
    lasts = np.concatenate([[0.0], np.maximum(np.maximum(step / tip, turn / reorient), axes / rotate)])
    after = np.cumsum(lasts + program.wait)
    starts = np.concatenate([[0.0], after[:-1]])
    ends = starts + lasts
    length = np.concatenate([[0.0], step])
    happenings = (*_outputs(program, starts, lasts, length), *lines(program, ends, after))
    return OwnClock(starts, ends, program.position, float(after[-1]), in_order(happenings))


def in_order(happenings: Iterable[Happening]) -> tuple[Happening, ...]:
    """By time and move; with the same move outputs come before lines, and these before what waits for them."""
    return tuple(sorted(happenings, key=lambda each: (each.time, each.move, ORDER.index(each.kind))))


def lines(program: Program, ends: Array, after: Array) -> Iterator[Happening]:
    """The lines that a program sends, and its waits for the board; ends, after (m) of each move, and of its rest [s]."""
    for move in sorted(program.sends):
        texts = program.sends[move]
        arrive, leave = (0.0, 0.0) if move < 0 else (float(ends[move]), float(after[move]))
        rests = program.send_rests.get(move, (0.0,) * len(texts))
        for text, rest in zip(texts, rests, strict=True):
            yield Happening(min(arrive + rest, leave), move, SEND, text)
        if any(text.split(" ")[0] in SLOW for text in texts):
            yield Happening(leave, move, SETTLE)


def _outputs(program: Program, starts: Array, lasts: Array, length: Array) -> Iterator[Happening]:
    for i in range(len(starts)):
        for trigger in program.triggers.get(i, ()):
            share = min(1.0, trigger.distance / length[i]) if length[i] > 0.0 else 0.0
            when = starts[i] + lasts[i] * (share if trigger.from_start else 1.0 - share)
            yield Happening(float(when), i, OUTPUT, f"{trigger.signal}={int(trigger.value)}")
