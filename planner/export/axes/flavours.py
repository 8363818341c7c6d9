"""Dialects of G-code: pauses, feed rates, first and last lines, and orders to the extruder's board."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.problem.settings import MachineSpec

#
# LinuxCNC knows no heaters or fans. Its M100 to M199 run user programs with two numbers, P and Q, so printers' codes in
# that range keep their number there: S becomes Q, and the number of a device (P, T) becomes P.

USERS_OWN = range(100, 200)  # M-codes of LinuxCNC that run a user's program


@dataclass(frozen=True)
class Flavour:
    """The dialect of a controller.

    suffix     of the file's name
    relative   filament is counted from line to line, not from the start
    unit       of a pause's P [s]
    pause      format of a pause
    begin, end first and last lines of the program
    order      RepRapFirmware line → the controller's own line for it; None if it has none
    """

    suffix: str
    relative: bool
    unit: float
    pause: str
    begin: tuple[str, ...]
    end: tuple[str, ...]
    order: Callable[[str], str | None]


def _linuxcnc_order(line: str) -> str | None:
    """The line for LinuxCNC, where tool 0 means no tool."""
    words = line.split(" ")
    if re.fullmatch(r"T\d+", words[0]):
        return f"{words[0]} M6" if words[0] != "T0" else None
    letters = ["Q" if word[0] == "S" else "P" for word in words[1:] if word[0] in "PST"]
    if int(words[0][1:]) not in USERS_OWN or len(set(letters)) < len(words) - 1:
        return None
    return " ".join([words[0], *(letter + word[1:] for letter, word in zip(letters, words[1:], strict=True))])


FLAVOURS = {
    "linuxcnc": Flavour(
        suffix="ngc",
        relative=False,
        unit=1.0,
        pause="G4 P{:.3f}",
        begin=("G17 G21 G40 G49 G80 G90",),
        end=("M2",),
        order=_linuxcnc_order,
    ),
    "reprap": Flavour(
        suffix="gcode",
        relative=True,
        unit=1e-3,
        pause="G4 P{:.0f}",
        # M203 I: the least speed, also under G93, is 0.5 mm/s (30 mm/min) unless set; 0.01 mm/s is the lowest
        begin=("G21", "G90", "M203 I0.6", "M83"),
        end=("M400",),
        order=lambda line: line,
    ),
}


def feed_length(flavour: str, moved: Mapping[str, float]) -> float:
    """The length that F refers to, per minute, on a line that moves axes by given amounts [mm, deg], by letter.

    This is the controllers' own rule: if X, Y or Z moves, both count these alone. Otherwise LinuxCNC counts U, V, W,
    and only then A, B, C; RepRapFirmware counts all rotary axes, and only then filament.
    """
    groups = ("XYZ", "UVW", "ABC") if flavour == "linuxcnc" else ("XYZ", "ABCUVW", "E")
    lengths = (math.hypot(*(moved.get(letter, 0.0) for letter in group)) for group in groups)
    return next((length for length in lengths if length > 0.0), 0.0)


def arcs_said(spec: MachineSpec) -> bool:
    """Whether arcs can be given with their time.

    RepRapFirmware cuts them into lines itself; how it treats a whole arc's inverse time is not documented.
    """
    return spec.flavour == "linuxcnc" or spec.feed == "per_minute"
