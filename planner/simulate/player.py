"""A program's motion as the player of programs has it: with accelerations, corners and joint limits of its cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.cell import Cell
from planner.export.player import Played, play
from planner.export.program import Program
from planner.readonly import Array
from planner.simulate.motion import OUTPUT, Happening, in_order, lines


@dataclass(frozen=True)
class PlayedMotion:
    """A program that was played."""

    played: Played
    duration: float
    happenings: tuple[Happening, ...]

    def at(self, time: float) -> tuple[int, Array]:
        """The move that runs at a time, and the tip in the part frame (3,) [m]."""
        moment = self.played.at(time)
        return int(moment.move), np.asarray(moment.position)


def played_motion(program: Program, cell: Cell) -> PlayedMotion:
    """The motion of a program in its cell. Raises InputError for what cannot be reached."""
    played = play(program, cell)
    outputs = [
        Happening(each.t, each.move, OUTPUT, f"{each.text}={int(each.value)}")
        for each in played.events
        if each.kind == "output"
    ]
    leave = played.leave[played.target]
    return PlayedMotion(played, played.duration, in_order([*outputs, *lines(program, played.arrive, leave)]))
