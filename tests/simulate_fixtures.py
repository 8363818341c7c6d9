"""Small programs that a simulated controller runs, made by hand, and a client of its socket."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.export.fit import from_matrix
from planner.export.program import RobotProgram, Trigger

MODULE = "MODULE Made\n    PROC main()\n    ENDPROC\nENDMODULE\n"


def program(lines: Sequence[str] = (), moves: int = 11, step: float = 0.01, speed: float = 0.1) -> RobotProgram:
    """A straight way of moves at a speed [m, m/s]; lines are sent one after each move, the extruder runs throughout."""
    x = step * np.arange(moves)
    fine = np.arange(moves) % (moves - 1) == 0
    identity = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    unused = np.full((moves, 6), np.nan)
    sends = {k: (text,) for k, text in enumerate(lines[: moves - 1])}
    sends[moves - 1] = tuple(lines[moves - 1 :])
    return RobotProgram(
        module="Made",
        tool=identity,
        uframe=identity,
        oframe=identity,
        station="",
        start=np.zeros(12),
        linear=np.ones(moves, bool),
        fine=fine,
        position=np.column_stack([x, 0 * x, 0 * x]),
        quat=np.tile([0.0, 0.0, 0.0, 1.0], (moves, 1)),
        conf=np.zeros((moves, 4), np.intp),
        external=unused,
        zone=np.where(fine, 0.0, 0.3e-3),
        speed=np.tile([speed, 1.0, 1.0, 1.0], (moves, 1)),
        wait=np.zeros(moves),
        triggers={1: (Trigger(0.0, True, True, "doExtrude"),), moves - 1: (Trigger(0.0, False, False, "doExtrude"),)},
        sends={move: texts for move, texts in sends.items() if texts},
    )


def program_at(cell: Cell, q: Array) -> RobotProgram:
    """A way of 10 mm that begins in a posture (n,), over a fixed bed: tool and joints are those of the arm's controller."""
    own, T = cell.as_counted, cell.T_part_nozzle(q[None])[0]
    unused = np.full(6, np.nan)
    made = program(moves=2)
    return replace(
        made,
        tool=_pose(own.T_flange_nozzle),
        uframe=_pose(own.T_world_holder),
        start=np.append(cell.counted(q[None])[0], unused),
        position=made.position + T[:3, 3],
        quat=np.tile(_pose(T)[3:], (2, 1)),
        conf=np.tile([0, 0, 0, int(cell.inverse.branches(q[None])[0])], (2, 1)),
    )


def _pose(T: Array) -> Array:
    return np.append(T[:3, 3], from_matrix(T[None, :3, :3])[0])


def reader(made: RobotProgram) -> Callable[[Mapping[str, str]], tuple[RobotProgram, ...]]:
    """What reads any modules as the program that was made."""
    return lambda modules: (made,)


class Client:
    """The PC's end of the program's socket, as simple as can be."""

    def __init__(self, address: tuple[str, int]) -> None:
        for _ in range(100):
            try:
                self.socket = socket.create_connection(address, timeout=5.0)
                break
            except ConnectionRefusedError:
                time.sleep(0.02)
        self.file = self.socket.makefile("rb")

    def read(self) -> str:
        """The next line; empty where the connection has ended."""
        try:
            return self.file.readline().decode("latin-1").rstrip("\n")
        except ConnectionError:
            return ""

    def say(self, text: str) -> None:
        self.socket.sendall(text.encode() + b"\n")

    def close(self) -> None:
        self.file.close()
        self.socket.close()
