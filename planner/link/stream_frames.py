"""A program's moves as the frames that go to a controller while it runs them (see BeadwiseStream.mod).

A frame is 96 bytes, little-endian: number, kind, flags of the triggers, tool, place [mm], orientation w x y z,
configuration, external axes [deg], speeds [mm/s, deg/s], wait [s], zone [mm], how many frames there are up to and with
the next rest, and two sums over all that.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.export.program import Program, Trigger
from planner.readonly import Array

BODY = struct.Struct("<IBBBx3f4f4b6f4fffHxx")
SUMS = struct.Struct("<HH")
LENGTH = BODY.size + SUMS.size
LINEAR, JOINT, ABSOLUTE, END, STOP, ALIVE = range(1, 7)
ON_AT_START, ON_AT_END, OFF_AT_END = 1, 2, 4
COMBINED = {0, ON_AT_START, ON_AT_END, OFF_AT_END, ON_AT_START | OFF_AT_END}
MOST_LEFT = 65535
MOST_TOOLS = 8
UNUSED = 9e9  # of external axes, as in RAPID
_WORDS = struct.Struct(f"<{BODY.size // 2}H")


@dataclass(frozen=True)
class Stream:
    """What is sent of a program: frames 1 … total, the last one the end.

    signals   outputs of the extruders, by the frames' tool
    longest   time of the longest single move or wait [s], at the programmed speeds
    """

    total: int
    signals: tuple[str, ...]
    longest: float
    _values: Array
    _codes: NDArray[np.int64]

    def frames(self) -> Iterator[bytes]:
        """All frames in order."""
        for n in range(1, self.total):
            kind, flags, tool, *conf, left = self._codes[n - 1].tolist()
            yield packed(n, kind, flags, tool, self._values[n - 1].tolist(), conf, left)
        yield packed(self.total, END, left=1)


def packed(
    number: int,
    kind: int,
    flags: int = 0,
    tool: int = 0,
    values: list[float] | None = None,
    conf: list[int] | None = None,
    left: int = 0,
) -> bytes:
    """One frame; values: place, orientation, external axes, speeds, wait and zone (19)."""
    v = values or [0.0] * 19
    body = BODY.pack(number, kind, flags, tool, *v[:7], *(conf or [0] * 4), *v[7:], left)
    first = second = 0
    for word in _WORDS.unpack(body):
        first = (first + word) % 65535
        second = (second + first) % 65535
    return body + SUMS.pack(first, second)


def stream_of(program: Program) -> Stream:
    """The frames of a program. Raises InputError for what only the program itself can do."""
    if program.sends or program.demands:
        raise InputError("only programs of style output are streamed", field="program.style")
    m = len(program.position)
    signals: list[str] = []
    codes = np.zeros((m + 1, 8), np.int64)
    codes[1:, 0] = np.where(program.linear, LINEAR, JOINT)
    codes[0, 0] = ABSOLUTE
    for move, triggers in program.triggers.items():
        codes[move + 1, 1:3] = _flags(triggers, signals)
    codes[1:, 3:7] = program.conf
    rests = np.append(True, program.zone == 0.0)
    ahead = np.append(np.flatnonzero(rests), m + 1)  # the end stops whatever still moves
    index = np.arange(m + 1)
    codes[:, 7] = np.minimum(ahead[np.searchsorted(ahead, index)] - index + 1, MOST_LEFT)
    values = np.zeros((m + 1, 19))
    values[0, :6] = _degrees(program.start[:6])
    values[0, 7:13] = _degrees(program.start[6:])
    values[1:, :3] = program.position * 1e3
    values[1:, 3:7] = program.quat[:, [3, 0, 1, 2]]
    values[1:, 7:13] = _degrees(program.external)
    speed = np.vstack([program.speed[:1], program.speed])
    values[:, 13:17] = speed * [1e3, 180.0 / np.pi, 1e3, 180.0 / np.pi]
    values[1:, 17] = program.wait
    values[1:, 18] = program.zone * 1e3
    return Stream(m + 2, tuple(signals), _longest(program), values, codes)


def _degrees(radians: Array) -> Array:
    return np.where(np.isnan(radians), UNUSED, np.degrees(radians))


def _flags(triggers: tuple[Trigger, ...], signals: list[str]) -> tuple[int, int]:
    """Flags and tool of a move's triggers; a signal that is new joins the signals."""
    flags, names = 0, {trigger.signal for trigger in triggers}
    for trigger in triggers:
        if trigger.distance != 0.0 or (trigger.from_start and not trigger.value):
            raise InputError("only switching at the ends of moves is streamed", field="program.style")
        flags |= ON_AT_START if trigger.from_start else ON_AT_END if trigger.value else OFF_AT_END
    if flags not in COMBINED or len(names) != 1:
        raise InputError("a move switches in a way that is not streamed", field="program.style")
    name = names.pop()
    if name not in signals:
        signals.append(name)
    if len(signals) > MOST_TOOLS:
        raise InputError(f"more than {MOST_TOOLS} extruders are not streamed", field="process.materials")
    return flags, signals.index(name)


def _longest(program: Program) -> float:
    """Time of the longest single move or wait [s]."""
    step = np.linalg.norm(np.diff(program.position, axis=0), axis=1) / program.speed[1:, 0]
    same = np.abs(np.einsum("ij,ij->i", program.quat[1:], program.quat[:-1])).clip(0.0, 1.0)
    turn = 2.0 * np.arccos(same) / program.speed[1:, 1]
    axes = np.nan_to_num(np.abs(np.diff(program.external, axis=0))).max(axis=1, initial=0.0) / program.speed[1:, 3]
    return float(max(np.max([step, turn, axes], initial=0.0), program.wait.max(initial=0.0)))
