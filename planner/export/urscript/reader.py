"""Reads the URScript that `urscript` writes back into numbers: a strict subset, where anything unknown is an error."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner.errors import InputError
from planner.export.program import UNSAID, Program, Trigger
from planner.export.rotations import from_matrix
from planner.export.urscript.frames import quaternions
from planner.readonly import Array

Forward = Callable[[Array], Array]

NUMBER = r"-?[0-9]+(?:\.[0-9]+)?"
NAME = r"[A-Za-z][A-Za-z0-9_]{0,63}"
SIX = rf"({NUMBER}(?:, {NUMBER}){{5}})"
HOW = rf"a=({NUMBER}), v=({NUMBER}), r=({NUMBER})"
PATTERNS = {
    word: re.compile(pattern)
    for word, pattern in {
        "movep": rf"movep\(pose_trans\(part, p\[{SIX}\]\), {HOW}\)",
        "movej": rf"movej\(\[{SIX}\], {HOW}\)",
        "output": r"set_standard_digital_out\(([0-7]), (True|False)\)",
        "wait": rf"sleep\(({NUMBER})\)",
        "call": rf"({NAME})\(\)",
        "define": rf"def ({NAME})\(\):",
        "end": r"end",
        "tool": rf"set_tcp\(p\[{SIX}\]\)",
        "part": rf"global part = p\[{SIX}\]",
    }.items()
}
MOVES = ("movep", "movej")
Statement = tuple[str, int, tuple[str, ...]]


@dataclass(frozen=True)
class Script:
    """A program (m moves) that was read.

    program     its work object is the part in the controller's base frame; triggers name outputs by their numbers
    joints      (m, 6) targets of joint moves [rad]; NaN for others
    pace        (m, 2) acceleration [m/s^2 or rad/s^2] and speed [m/s or rad/s] of each move
    """

    program: Program
    joints: Array
    pace: Array


def read_urscript(text: str, forward: Forward) -> Script:
    """Program of URScript text as `urscript.urscript` writes it; forward: joints (k, 6) → T_part_nozzle (k, 4, 4).

    Raises InputError with the line for a statement or name that is not known, or that stands where it must not.
    """
    reader = _Reader()
    for line, raw in enumerate(text.split("\n"), start=1):
        statement = raw.strip()
        if statement and not statement.startswith("#"):
            reader.take(statement, line)
    return reader.script(forward)


def _error(line: int | None, reason: str) -> InputError:
    return InputError(reason, line=line, file="URScript")


def _six(text: str) -> list[float]:
    return [float(value) for value in text.split(", ")]


class _Reader:
    def __init__(self) -> None:
        self.open: list[str] = []  # functions that have begun and not ended, the program first
        self.title = ""
        self.bodies: dict[str, list[Statement]] = {}
        self.frames: dict[str, Array] = {}

    def take(self, statement: str, line: int) -> None:
        known = ((word, pattern.fullmatch(statement)) for word, pattern in PATTERNS.items())
        word, match = next((pair for pair in known if pair[1]), ("", None))
        if match is None:
            raise _error(line, f"unknown statement {statement[:60]!r}")
        if not self.open and (self.title or word != "define"):
            raise _error(line, f"{statement[:60]!r} stands outside the program")
        if word == "define":
            if len(self.open) > 1 or match[1] in self.bodies:
                raise _error(line, f"function {match[1]} stands there twice, or in another one")
            self.title = self.title or match[1]
            self.open.append(match[1])
            self.bodies[match[1]] = []
        elif word == "end":
            self.open.pop()
        elif word in ("tool", "part"):
            if word in self.frames or len(self.open) > 1:
                raise _error(line, f"the {word} stands there twice, or in a function")
            self.frames[word] = np.array(_six(match[1]))
        else:
            self.bodies[self.open[-1]].append((word, line, match.groups()))

    def script(self, forward: Forward) -> Script:
        if self.open or not self.title or len(self.frames) != 2:
            raise _error(None, "no complete program with tool and part")
        moves: list[Statement] = []
        waits: dict[int, float] = {}
        switched: list[tuple[int, str, bool]] = []
        for word, line, parts in self._run(self.title, 0):
            at = len(moves) - 1
            if word in MOVES:
                moves.append((word, line, parts))
            elif word == "output":
                if at < 0 and parts[1] == "True":
                    raise _error(line, "an output goes on before the first target")
                switched.append((at, parts[0], parts[1] == "True"))
            elif at < 0:
                raise _error(line, "a wait before the first target")
            else:
                waits[at] = waits.get(at, 0.0) + float(parts[0])
        if len(moves) < 2 or moves[0][0] != "movej":
            raise _error(None, "it does not begin with a movej, and go on")
        return self._arrays(moves, waits, switched, forward)

    def _run(self, name: str, depth: int) -> list[Statement]:
        out: list[Statement] = []
        for word, line, parts in self.bodies[name]:
            if word != "call":
                out.append((word, line, parts))
            elif depth or parts[0] not in self.bodies or parts[0] == self.title:
                raise _error(line, f"{parts[0]} is no function that the program may call here")
            else:
                out += self._run(parts[0], depth + 1)
        return out

    def _arrays(
        self,
        moves: list[Statement],
        waits: dict[int, float],
        switched: list[tuple[int, str, bool]],
        forward: Forward,
    ) -> Script:
        m = len(moves)
        rows = np.array([_six(parts[0]) for _, _, parts in moves])
        how = np.array([[float(value) for value in parts[1:]] for _, _, parts in moves])
        for (_, line, _), (a, v, r) in zip(moves, how.tolist(), strict=True):
            if a <= 0.0 or v <= 0.0 or r < 0.0:
                raise _error(line, "acceleration and speed must be positive, the blend not negative")
        linear = np.array([word == "movep" for word, _, _ in moves])
        poses = forward(rows[~linear])
        position, quat = np.empty((m, 3)), np.empty((m, 4))
        position[linear], quat[linear] = rows[linear, :3], quaternions(rows[linear, 3:])
        position[~linear], quat[~linear] = poses[:, :3, 3], from_matrix(poses[:, :3, :3])
        program = Program(
            module=self.title,
            tool=_frame(self.frames["tool"]),
            uframe=_frame(self.frames["part"]),
            oframe=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            station="",
            start=np.concatenate([rows[0], np.full(6, np.nan)]),
            linear=linear,
            fine=how[:, 2] == 0.0,
            position=position,
            quat=quat,
            conf=np.full((m, 4), UNSAID, dtype=np.intp),
            external=np.full((m, 6), np.nan),
            zone=how[:, 2],
            speed=np.column_stack([np.where(linear, how[:, 1], np.nan), np.full((m, 3), np.nan)]),
            wait=np.array([waits.get(i, 0.0) for i in range(m)]),
            triggers=_triggers(switched, m),
            sends={},
        )
        return Script(program, np.where(linear[:, None], np.nan, rows), how[:, :2])


def _frame(pose: Array) -> Array:
    return np.concatenate([pose[:3], quaternions(pose[None, 3:])[0]])


def _triggers(switched: list[tuple[int, str, bool]], m: int) -> dict[int, tuple[Trigger, ...]]:
    """Outputs that are switched after one of m moves, as if at its end: its blend says how much before that it is.

    Before the first move they are set to where they should be; after the last one they are switched off once more.
    """
    found: dict[int, tuple[Trigger, ...]] = {}
    for at, output, value in switched:
        if at == 0 and value:
            found[1] = (*found.get(1, ()), Trigger(0.0, True, value, output))
        elif 0 < at < m - 1 or (at == m - 1 and value):
            found[at] = (*found.get(at, ()), Trigger(0.0, False, value, output))
    return found
