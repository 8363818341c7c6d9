"""The extruder's board by its firmware: selecting tools, waiting for inputs, and how long filament takes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array

if TYPE_CHECKING:
    from planner.problem.settings import BoardSpec

# How late an idle board starts to move.
#
# RepRapFirmware waits for further lines (M595 R, 10 ms unless set); so does Marlin unless it has three (its planner's
# BLOCK_DELAY_FOR_1ST_MOVE). Klipper plans a quarter of a second ahead of its clock (BUFFER_TIME_START), once.
GRACE = 10e-3  # [s]
AT_ONCE = 3  # queued moves with which Marlin starts without waiting


@dataclass(frozen=True)
class Firmware:
    """The commands of a board's firmware.

    title     its name in words
    begin     first lines, before anything moves
    wait      format of the line that waits until an input (first) has a level (second); empty if it cannot wait
    wired     where its input numbers come from, in words
    loops     whether a file can repeat lines while an input has a level
    least     consecutive moves with which it starts without waiting for more
    """

    title: str
    begin: tuple[str, ...] = ()
    wait: str = ""
    wired: str = ""
    loops: bool = False
    least: int = 1


FIRMWARES = {
    # M203 I: the least speed [mm/min]. Its default of 0.5 mm/s is too fast for thin beads; 0.01 mm/s is the lowest it
    # accepts. M595 R: see above
    "reprap": Firmware(
        "RepRapFirmware",
        begin=("M203 I0.6", "M595 R0"),
        wait="M577 P{} S{}",
        wired="J of M950",
        loops=True,
    ),
    "marlin": Firmware("Marlin", wait="M226 P{} S{}", wired="pin", least=AT_ONCE),
    "klipper": Firmware("Klipper"),
}


def select(firmware: str, tool: int) -> str:
    """The line that selects a tool; a Duet without one refuses to extrude."""
    if firmware == "klipper":  # T0 is a macro there, which not every printer has
        return f"ACTIVATE_EXTRUDER EXTRUDER=extruder{tool or ''}"
    return f"T{tool}"


def selected_tool(line: str) -> int | None:
    """Number of the tool that a line selects; None for any other line."""
    if match := _SELECTS.fullmatch(line):
        return int(match[1] or match[2] or 0)
    return None


def wait_for(firmware: str, number: int, on: bool) -> str:
    """The line that waits until an input is on, or off."""
    return FIRMWARES[firmware].wait.format(number, int(on))


def repeat(number: int, most: int) -> str:
    """The line of RepRapFirmware (3.01 and later) that repeats the indented lines after it while an input is on."""
    return f"while sensors.gpIn[{number}].value == 1 && iterations < {most}"


SELECTS = r"T(\d+)|ACTIVATE_EXTRUDER EXTRUDER=extruder(\d*)"
_SELECTS = re.compile(SELECTS, re.ASCII)
DONE = "M400"  # waits until all moves are done


def least_time(board: BoardSpec, rate: float) -> float:
    """How long [s] a line that moves filament at a mean rate [mm/s] must last to leave time for its ramps."""
    return 4.0 * rate / (board.acceleration * 1e3) if board.from_rest else 0.0


def rate_for(board: BoardSpec, amount: Array, seconds: Array) -> Array:
    """Rate (n) [mm/s] at which filament (n) [mm] moves in a time (n) [s]: evenly, or with ramps from rest to rest.

    If the ramps alone would take longer, it is the peak rate reached.
    """
    way = np.abs(amount)
    if not board.from_rest:
        even: Array = way / seconds
        return even
    a = board.acceleration * 1e3
    rate: Array = 0.5 * a * (seconds - np.sqrt(np.maximum(seconds**2 - 4.0 * way / a, 0.0)))
    return np.minimum(rate, np.sqrt(way * a))


def lasts(board: BoardSpec, amount: Array, rate: Array) -> Array:
    """Time (n) [s] that filament (n) [mm] takes at a rate (n) [mm/s]; 0 where none moves."""
    way = np.abs(amount)
    rate = np.where(way > 0.0, rate, 1.0)
    if not board.from_rest:
        even: Array = way / rate
        return even
    a = board.acceleration * 1e3
    top = np.minimum(rate, np.sqrt(way * a))
    return np.where(way > 0.0, way / np.where(way > 0.0, top, 1.0) + top / a, 0.0)
