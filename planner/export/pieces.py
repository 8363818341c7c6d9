"""A program that was read back, cut where the extruder is switched, and its path between."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.export.program import Program
from planner.export.rotations import continuous, slerp
from planner.readonly import Array, Indices


@dataclass(frozen=True)
class Replay:
    """One stretch between extruder on and off: tip (k, 3) [m], orientation (k, 4), part's axes (k, 6) [rad]."""

    position: Array
    quat: Array
    external: Array


@dataclass(frozen=True)
class Piece:
    """Targets between two extruder events, both included; `linear`, `speed` (m - 1,) are those of the move to the next."""

    position: Array
    quat: Array
    external: Array
    conf: Indices
    linear: NDArray[np.bool_]
    speed: Array
    known: NDArray[np.bool_]  # a target of the program, not a point where a trigger cuts a move


def replay(program: Program, step: float = 0.5e-3) -> tuple[Replay, ...]:
    """Dense path of every stretch with the extruder on, at most `step` [m] between its points."""
    out = []
    for piece in [piece for on, piece in pieces_of(program) if on]:
        parts = np.maximum(1, np.ceil(np.linalg.norm(np.diff(piece.position, axis=0), axis=1) / step)).astype(np.intp)
        a = np.append(np.repeat(np.arange(len(parts)), parts), len(parts) - 1)
        u = np.append((np.arange(len(a) - 1) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[a[:-1]], 1.0)
        between = u[:, None]
        out.append(
            Replay(
                position=piece.position[a] + between * (piece.position[a + 1] - piece.position[a]),
                quat=slerp(piece.quat[a], piece.quat[a + 1], u),
                external=piece.external[a] + between * (piece.external[a + 1] - piece.external[a]),
            )
        )
    return tuple(out)


def pieces_of(program: Program) -> Iterator[tuple[bool, Piece]]:
    """The program's targets, cut at the points where the extruder is switched: (extruder on, piece)."""
    rows = np.column_stack([program.position, program.quat, program.external, program.conf])
    m = len(rows)
    begun: list[Array] = [rows[:1]]
    by: list[Indices] = []  # the move that goes from each target to the next
    known: list[NDArray[np.bool_]] = [np.array([True])]
    on, done = False, 1  # rows before `done` have been dealt with

    def take(last: int) -> None:
        begun.append(rows[done:last])
        by.append(np.arange(done, last))
        known.append(np.ones(last - done, dtype=bool))

    def piece() -> Piece:
        table = np.concatenate(begun)
        moves = np.concatenate([np.empty(0, dtype=np.intp), *by])
        return Piece(
            position=table[:, :3],
            quat=continuous(table[:, 3:7]),
            external=table[:, 7:13],
            conf=table[:, 13:].astype(np.intp),
            linear=program.linear[moves],
            speed=program.speed[moves, 0],
            known=np.concatenate(known),
        )

    for i in sorted(move for move in program.triggers if 0 < move < m):
        take(i)
        length = float(np.linalg.norm(program.position[i] - program.position[i - 1]))
        events = []
        for trigger in program.triggers[i]:
            at = trigger.distance if trigger.from_start else length - trigger.distance
            events.append((min(max(at / length, 0.0), 1.0) if length else float(not trigger.from_start), trigger.value))
        for u, value in sorted(events, key=lambda event: event[0]):
            cut = rows[i - 1] + u * (rows[i] - rows[i - 1])
            cut[3:7] = slerp(rows[i - 1 : i, 3:7], rows[i : i + 1, 3:7], np.array([u]))[0]
            if u > 0.0:
                begun.append((rows[i] if u == 1.0 else cut)[None])
                by.append(np.array([i]))
                known.append(np.array([u == 1.0]))
            if sum(len(part) for part in begun) > 1 or on != value:
                yield on, piece()
            begun, by, known, on = [begun[-1][-1:]], [], [known[-1][-1:]], value
        done = i
        if not events or events[-1][0] < 1.0:
            take(i + 1)
        done = i + 1
    take(m)
    yield on, piece()
