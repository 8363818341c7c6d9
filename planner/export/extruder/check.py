"""The extruder's G-code, read back: does each tool get the filament that the plan has for it, and in time?"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from planner.errors import InputError
from planner.export.extruder.orders import orders
from planner.plan.materials import SELECTS, materials_of, used

if TYPE_CHECKING:
    from planner.plan import Plan

AMOUNT = 1e-5  # m of filament that a tool may get too much or too little, in all
LATE = 2e-3  # s, and a sample: by which what is said may stand behind or before its instant
_LINE = re.compile(
    r"(?P<comment>;.*)|(?P<mode>M83)|(?P<wait>M116|M1(?:09|90) S[\d.]+)|(?P<order>M(?:42|104|106|107|140|280)(?: [A-Z]-?[\d.]+)*)"
    r"|T(?P<tool>\d+)|G4 P(?P<pause>\d+)|G1 E(?P<amount>-?\d+\.\d+) F(?P<rate>\d+\.\d+)"
)


@dataclass(frozen=True)
class Extrusion:
    """What the program does: filament in all [m] by tool (None before any is selected), when tools are selected [s],
    when other lines are said to the board, and how long it lasts [s]."""

    filament: dict[int | None, float]
    selections: tuple[tuple[float, int], ...]
    told: tuple[tuple[float, str], ...]
    duration: float


def read_gcode(text: str) -> Extrusion:
    """Extrusion of a program as `writer.gcode` writes it. Raises InputError with the line of anything else.

    Relative filament is asked for before all else, and temperatures are waited for only before time has passed.
    """
    filament: dict[int | None, float] = {}
    selections: list[tuple[float, int]] = []
    told: list[tuple[float, str]] = []
    now, tool, relative = 0.0, None, False
    for number, line in enumerate(text.splitlines(), 1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise InputError(f"unknown line {line[:60]!r}", file="G-code", line=number)
        if match["comment"] is None and not relative and not match["mode"]:
            raise InputError(f"{line[:60]!r} stands before M83", file="G-code", line=number)
        if match["mode"]:
            relative = True
        elif match["wait"] and now > 0.0:
            raise InputError(f"{line!r} would lose the robot, which waits by time", file="G-code", line=number)
        elif match["wait"] or match["order"]:
            told.append((now, line))
        elif match["tool"]:
            tool = int(match["tool"])
            selections.append((now, tool))
        elif match["pause"]:
            now += int(match["pause"]) * 1e-3
        elif match["amount"]:
            amount = float(match["amount"]) * 1e-3
            filament[tool] = filament.get(tool, 0.0) + amount
            now += abs(amount) / (float(match["rate"]) * 1e-3 / 60.0)
    return Extrusion(filament, tuple(selections), tuple(told), now)


def gcode_complaints(plan: Plan, text: str) -> list[str]:
    """Every difference between a program and its plan beyond rounding, in words."""
    t, written = plan.trajectory, read_gcode(text)
    takes: dict[int | None, float] = {each.material.tool: each.filament for each in used(plan) if each.beads}
    takes = takes or {None: float(t.feed[-1] - t.feed[0])}
    found = []
    for tool in sorted({*takes, *written.filament}, key=str):
        off = written.filament.get(tool, 0.0) - takes.get(tool, 0.0)
        if not abs(off) <= AMOUNT:
            found.append(f"{'the extruder' if tool is None else f'tool T{tool}'} gets {off * 1e3:+.3g} mm of filament")
    tools = {each.name: each.tool for each in materials_of(plan.problem)}
    planned = [(event.start, tools[event.material]) for event in t.events if event.kind in SELECTS]
    if [tool for _, tool in planned] != [tool for _, tool in written.selections]:
        found.append("other tools are selected than the plan's")
    else:
        late = [abs(at - start) for (at, _), (start, _) in zip(written.selections, planned, strict=True)]
        if not max(late, default=0.0) <= LATE + t.dt:
            found.append(f"a tool is selected {max(late):.3g} s off its time")
    found += _told_otherwise(plan, written)
    if not abs(written.duration - float(t.t[-1] - t.t[0])) <= LATE + t.dt:
        found.append(f"it lasts {written.duration:.3f} s")
    return found


def _told_otherwise(plan: Plan, written: Extrusion) -> list[str]:
    """What the board is told of heating, fan and cutter otherwise than planned, or at another time."""
    planned = [(due, line) for order in orders(plan) for due, line in order.due if line.startswith("M")]
    if [line for _, line in planned] != [line for _, line in written.told]:
        return ["the board is told other things than the plan's, or in another order"]
    late = [(abs(at - due), line) for (at, line), (due, _) in zip(written.told, planned, strict=True)]
    worst, line = max(late, default=(0.0, ""))
    return [] if worst <= LATE + plan.trajectory.dt else [f"{line} is said {worst:.3g} s off its time"]
