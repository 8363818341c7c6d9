"""G-code of multi-axis machines, read back: exactly what `writer` writes, and nothing else."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.errors import InputError
from planner.export.axes.flavours import FLAVOURS, feed_length
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.problem.machine import MachineSpec


MOST_CHARACTERS = 256  # of a line; LinuxCNC takes no more
_MOVE = re.compile(r"G([01])((?: [A-Z]-?\d{1,7}\.\d{4,5})+)")
_PAUSE = re.compile(r"G4 P(\d{1,8}(?:\.\d{3})?)")
_ORDER = re.compile(r"M(?:42|104|106|107|109|116|140|190|280)(?: [A-Z]-?\d{1,6}(?:\.\d{1,4})?)*|T\d{1,2}(?: M6)?")
_BLEND = re.compile(r"G64 P\d\.\d{4}")
_MODES = {"inverse_time": "G93", "per_minute": "G94"}


@dataclass(frozen=True)
class AxesProgram:
    """What a program does (m places, the first one where it begins; SI units, radians).

    straight, turning   (m, 3), (m, k + e) X Y Z and all others but the filament's, in the order of the letters
    filament            (m)  pushed so far [m]
    time                (m)  since the first place [s]; two places are the same where the machine pauses
    told                (time, line) of what else is said
    """

    straight: Array
    turning: Array
    filament: Array
    time: Array
    told: tuple[tuple[float, str], ...]


def read_axes(text: str, spec: MachineSpec, letters: Sequence[str]) -> AxesProgram:
    """The program for a machine with these letters (X, Y, Z, then what turns); InputError with the line of all else."""
    lines = text.splitlines()
    mode = _MODES[spec.feed]
    if mode not in lines:
        raise InputError(f"{mode} is missing", file="G-code")
    start = lines.index(mode)
    place = _begin(lines[:start], spec, letters)
    flavour = FLAVOURS[spec.flavour]
    end = [*(["G94"] if spec.feed == "inverse_time" else []), *([spec.tcp_off] if spec.tcp else []), *flavour.end]
    if lines[-len(end) :] != end:
        raise InputError(f"it does not end with {', '.join(end)}", file="G-code", line=len(lines))
    places, filament, time = [list(place.values())], [0.0], [0.0]
    told: list[tuple[float, str]] = []
    now, pushed = 0.0, 0.0
    for number, line in enumerate(lines[start + 1 : -len(end)], start + 2):
        if line.startswith(";") and len(line) <= MOST_CHARACTERS:
            continue
        if pause := _PAUSE.fullmatch(line):
            now += float(pause[1]) * flavour.unit
        elif _ORDER.fullmatch(line):
            told.append((now, line))
            continue
        else:
            words = _words(line, "1", number)
            rate = words.pop("F", 0.0)
            own = words.pop(spec.filament, None)
            if not rate > 0.0 or not words.keys() <= place.keys() or not (words or own is not None):
                raise _unknown(line, number)
            moved = 0.0 if own is None else own if flavour.relative else own - pushed
            steps = {letter: value - place[letter] for letter, value in words.items()} | {spec.filament: moved}
            place |= words
            length = 1.0 if mode == "G93" else feed_length(spec.flavour, steps)
            now += 60.0 * length / rate
            pushed = pushed + moved
        places.append(list(place.values()))
        filament.append(pushed)
        time.append(now)
    table = np.array(places)
    return AxesProgram(
        table[:, :3] * 1e-3, np.radians(table[:, 3:]), np.array(filament) * 1e-3, np.array(time), tuple(told)
    )


def _begin(lines: Sequence[str], spec: MachineSpec, letters: Sequence[str]) -> dict[str, float]:
    """Where the modes and the way to the first place leave the machine, by letter."""
    must = [*FLAVOURS[spec.flavour].begin]
    if spec.flavour == "linuxcnc":
        must.append(f"G92 {spec.filament}0")
    must += [spec.tcp_on] if spec.tcp else []
    place: dict[str, float] = {}
    for number, line in enumerate(lines, 1):
        if line.startswith(";") and len(line) <= MOST_CHARACTERS:
            continue
        if line in must and not place:
            must.remove(line)
        elif not (spec.flavour == "linuxcnc" and _BLEND.fullmatch(line)):
            words = _words(line, "0", number)
            if not words.keys() <= set(letters):
                raise _unknown(line, number)
            place |= words
    if must or set(place) != set(letters):
        missing = ", ".join([*must, *(name for name in letters if name not in place)])
        raise InputError(f"{missing} is missing before the first move", file="G-code", line=len(lines) + 1)
    return {name: place[name] for name in letters}


def _words(line: str, motion: str, number: int) -> dict[str, float]:
    match = _MOVE.fullmatch(line)
    if match is None or match[1] != motion or len(line) > MOST_CHARACTERS:
        raise _unknown(line, number)
    found = [(word[0], float(word[1:])) for word in match[2].split()]
    if len({letter for letter, _ in found}) != len(found):
        raise _unknown(line, number)
    return dict(found)


def _unknown(line: str, number: int) -> InputError:
    return InputError(f"unknown line {line[:60]!r}", file="G-code", line=number)
