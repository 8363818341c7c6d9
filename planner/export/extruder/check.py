"""The extruder's G-code, read back: does each tool get the filament that the plan has for it, and in time?"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from planner.errors import InputError
from planner.materials import SELECTS, materials_of, used

if TYPE_CHECKING:
    from planner.plan import Plan

AMOUNT = 1e-5  # m of filament that a tool may get too much or too little, in all
LATE = 2e-3  # s, and a sample: by which what is said may stand behind or before its instant
_LINE = re.compile(
    r"(?P<comment>;.*)|(?P<mode>M83)|(?P<heat>M1(?:04|40)(?: T\d+)? S[\d.]+)|T(?P<tool>\d+)|G4 P(?P<pause>\d+)"
    r"|G1 E(?P<amount>-?\d+\.\d+) F(?P<rate>\d+\.\d+)"
)


@dataclass(frozen=True)
class Extrusion:
    """What the program does: filament in all [m] by tool (None before any is selected), when tools are selected [s],
    and how long it lasts [s]."""

    filament: dict[int | None, float]
    selections: tuple[tuple[float, int], ...]
    duration: float


def read_gcode(text: str) -> Extrusion:
    """Extrusion of a program as `gcode.gcode` writes it. Raises InputError with the line of anything else."""
    filament: dict[int | None, float] = {}
    selections: list[tuple[float, int]] = []
    now, tool = 0.0, None
    for number, line in enumerate(text.splitlines(), 1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise InputError(f"unknown line {line[:60]!r}", file="G-code", line=number)
        if match["tool"]:
            tool = int(match["tool"])
            selections.append((now, tool))
        elif match["pause"]:
            now += int(match["pause"]) * 1e-3
        elif match["amount"]:
            amount = float(match["amount"]) * 1e-3
            filament[tool] = filament.get(tool, 0.0) + amount
            now += abs(amount) / (float(match["rate"]) * 1e-3 / 60.0)
    return Extrusion(filament, tuple(selections), now)


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
    if not abs(written.duration - float(t.t[-1] - t.t[0])) <= LATE + t.dt:
        found.append(f"it lasts {written.duration:.3f} s")
    return found
