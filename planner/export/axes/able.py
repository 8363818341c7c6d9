"""Which cells a machine's G-code can speak of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner.export.axes.flavours import FLAVOURS
from planner.plan.materials import materials_of

if TYPE_CHECKING:
    from planner.export.setup import Setup
    from planner.problem.machine import MachineSpec

STATION = ("U", "V")  # letters of what moves a robot's part: genserkins hands them on to further joints


def unsaid_in_axes(setup: Setup) -> str | None:
    """Why there is no such program of what a cell does; None if there is one."""
    spec: MachineSpec | None = setup.problem.program.machine
    if spec is None:
        return "program.machine describes no machine"
    carrying = len(setup.cell.holder) if spec.type == "robot" else 0
    if carrying > len(STATION):
        return f"what moves the part has {carrying} axes, and {len(STATION)} letters are left for them"
    if spec.filament in STATION[:carrying]:
        return f"{spec.filament} pushes filament, and moves the part"
    fibre = setup.problem.process.fibre
    orders = [f"T{each.tool}" for each in materials_of(setup.problem)]
    orders += [line for line in fibre.code if line.startswith("M")] if fibre is not None else []
    for line in orders:
        if FLAVOURS[spec.flavour].order(line) is None:
            return (
                f"{line} cannot be said to {spec.flavour}, which numbers tools from 1 and has M100 to M199 with P and S"
            )
    return None
