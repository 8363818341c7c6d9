"""The procedures of a program: the start, one for each bead with the way to it, and the way home."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.moves import Moves, deposits
from planner.export.rapid.lines import HEATS, WAITS, Line
from planner.export.rapid.server import LATEST, LINE, SETTLE
from planner.export.rapid.targets import targets
from planner.export.rapid.text import ZONES, comment
from planner.export.rests import Wait

if TYPE_CHECKING:
    from planner.plan import Plan


@dataclass(frozen=True)
class Procedure:
    """A procedure without parameters.

    about  comments before all else
    steps  statements of each move: what it is, and what is done when it has ended
    rests  the robot is at rest when it ends
    """

    name: str
    about: tuple[str, ...]
    steps: tuple[tuple[str, ...], ...]
    rests: bool

    @property
    def text(self) -> list[str]:
        """Its lines, and an empty one."""
        inner = [statement for step in self.steps for statement in step]
        return [f"    PROC {self.name}()", *self.about, *inner, "    ENDPROC", ""]

    def resting(self) -> Procedure:
        """The same, with the robot at rest when it ends."""
        if self.rests:
            return self
        move, *rest = self.steps[-1]
        for zone in (",z0,", ",z1,"):
            move = move.replace(zone, ",fine,")
        return replace(self, steps=(*self.steps[:-1], (move, *rest)), rests=True)

    def parts(self, most: int) -> list[Procedure]:
        """The same motion in procedures of at most so many moves, to be called one after the other without a stop."""
        count = -(-len(self.steps) // most)
        if count <= 1:
            return [self]
        bounds = np.linspace(0, len(self.steps), count + 1).astype(int).tolist()
        return [
            replace(
                self,
                name=f"{self.name}Part{k + 1}",
                about=self.about if k == 0 else (comment(f"{self.name}, part {k + 1} of {count}", 8),),
                steps=self.steps[a:b],
                rests=self.rests and k == count - 1,
            )
            for k, (a, b) in enumerate(zip(bounds[:-1], bounds[1:], strict=True))
        ]


def procedures_of(
    plan: Plan, moves: Moves, speeds: list[str], triggers: dict[int, tuple[str, ...]], lines: tuple[Line, ...]
) -> list[Procedure]:
    """All procedures with moves, in the order of calling; speeds: names, of the way to the start and of every move."""
    names, places = plan.problem.program, targets(plan, moves)
    frames = f"{names.tool}\\WObj:={names.work_object};"
    first, last = deposits(plan.trajectory)
    sent = _numbered(lines)
    about = "The planned start as a target: the robot must not move here, if tool and work object are right."
    start = f"        MoveJ {places[0]},{speeds[0]},fine,{frames}"
    there = _resting(moves.waits.get(-1, ()), sent.get(-1, ()))
    found = [Procedure("Start", (comment(about, 8),), ((start, *there),), True)]
    linear, fine, wide = moves.linear.tolist(), moves.fine.tolist(), (~moves.linear & _roomy(plan, moves)).tolist()

    def step(i: int) -> tuple[str, ...]:
        own = triggers.get(i, ())
        zone = "fine" if fine[i] else "z1" if wide[i] else "z0"
        word = "TriggL" if own else "MoveL" if linear[i] else "MoveJ"
        what = "".join(f"\\T{k}:={name}" if k > 1 else f",{name}" for k, name in enumerate(own, 1))
        move = f"        {word} {places[i + 1]},{speeds[i + 1]}{what},{zone},{frames}"
        return (move, *_resting(moves.waits.get(i, ()), sent.get(i, ())))

    bounds = np.searchsorted(moves.after, np.arange(len(first) + 2)).tolist()
    for k, (a, b) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
        if a < b:
            name = f"Bead{plan.first_bead + k + 1:04d}" if k < len(first) else "Finish"
            words = (_about(plan, int(first[k]), int(last[k])),) if k < len(first) else ()
            found.append(Procedure(name, words, tuple(map(step, range(a, b))), fine[b - 1]))
    return found


def _roomy(plan: Plan, moves: Moves) -> NDArray[np.bool_]:
    """Whether the wider zone takes no more than half of a move (m) and of the next."""
    roomy = moves.length >= 2.0 * ZONES["z1"]
    out: NDArray[np.bool_] = roomy & np.append(roomy[1:], True)
    return out


def _numbered(lines: Sequence[Line]) -> dict[int, list[tuple[int, Line]]]:
    """Move → the lines that are sent behind it, with their numbers."""
    out: dict[int, list[tuple[int, Line]]] = {}
    for n, line in enumerate(lines, 1):
        out.setdefault(line.move, []).append((n, line))
    return out


def _resting(waits: Sequence[Wait], sent: Sequence[tuple[int, Line]]) -> list[str]:
    """Statements behind a move: what the robot stands still for, each with a comment that says why, and what is sent."""
    steps: list[tuple[float, int, list[str]]] = []
    clock = 0.0
    for wait in waits:
        steps.append((clock, 0, [comment(wait.why, 8)] if wait.why else []))
        clock += round(wait.time, 3)
        steps.append((clock, -1, []))
    settle = f"        {SETTLE} {LATEST};"
    heats = False
    for n, line in sent:
        before = [settle] if heats and not line.text.startswith(HEATS) else []
        heats = line.text.startswith(HEATS)
        steps.append((min(line.after, clock), 1, [*before, f'        {LINE} {n},"{line.text}";']))
    if any(line.text.startswith(WAITS) for _, line in sent):
        steps.append((clock, 2, [settle]))
    out: list[str] = []
    now = 0.0
    for at, _, statements in sorted(steps, key=lambda step: step[:2]):
        pause = round(at - now, 3)
        out += [f"        WaitTime {pause:.3f};"] if pause > 0.0 else []
        out += statements
        now += pause
    return out


def _about(plan: Plan, first: int, last: int) -> str:
    """Comment on what a procedure prints between two samples."""
    t = plan.trajectory
    bead = t.bead[first]
    of = plan.toolpath.beads[bead].material
    length = f"{1e3 * (t.s[last] - t.s[first]):.1f} mm" + (f" of {of}" if of else "")
    return comment(f"Bead {bead}, layer {t.layer[first]}: {length}", 8)
