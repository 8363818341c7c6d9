"""What users of a program should know before it runs: notes in its header, each with the first place that it is about."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.export.moves import Moves
from planner.export.player import play
from planner.export.player.limited import limited
from planner.export.program import Program
from planner.export.rapid.text import NOTE, ZONES, comment

if TYPE_CHECKING:
    from planner.plan import Plan

_MOVE = re.compile(r" {8}(?:MoveJ|MoveL|TriggL) ")


@dataclass(frozen=True)
class Note:
    """What is to be known, and the first move of the program that it is about, from 0."""

    words: str
    move: int


def notes_of(plan: Plan, moves: Moves, program: Program) -> tuple[Note, ...]:
    """All notes on a program that was read back."""
    return tuple(note for note in (_zones(plan, moves), _sends(program), *_paces(plan, program)) if note is not None)


def _zones(plan: Plan, moves: Moves) -> Note | None:
    length = moves.length
    flown = moves.linear & ~moves.fine
    narrow = np.flatnonzero(flown & (np.minimum(length, np.append(length[1:], np.inf)) < 2.0 * ZONES["z0"]))
    if not len(narrow):
        return None
    words = f"{len(narrow)} zones of 0.3 mm are cut by the controller to half of a move, the shortest is"
    return Note(f"{words} {length[moves.linear].min() * 1e3:.2f} mm", int(narrow[0]) + 1)


def _sends(program: Program) -> Note | None:
    flown = [move for move in sorted(program.sends) if not program.fine[move]]
    if not flown:
        return None
    count = sum(len(program.sends[move]) for move in flown)
    return Note(f"{count} lines are sent at fly-by points, as early as the controller reads ahead", flown[0])


def _paces(plan: Plan, program: Program) -> list[Note]:
    return [Note(each.words, each.first) for each in limited(program, play(program, plan.cell))]


def note_lines(notes: tuple[Note, ...], plan: Plan, moves: Moves, files: Mapping[str, str]) -> list[str]:
    """Two comments for each note, to stand in the header of the first of the files, which have none so far."""
    main, places, wanted = next(iter(files)), {}, {note.move for note in notes}
    k = 0
    for name, text in files.items():
        for line, statement in enumerate(text.split("\n"), 1):
            if _MOVE.match(statement):
                if k in wanted:
                    places[k] = f"line {line + 2 * len(notes) * (name == main)} of {name}"
                k += 1
    bead = plan.trajectory.bead
    out = []
    for note in notes:
        at = int(bead[moves.sample[max(note.move - 1, 0)]])
        where = f"bead {at}" if at >= 0 else "between beads"
        out += [comment(NOTE + note.words), comment(f"  first {where}, {places[note.move]}")]
    return out
