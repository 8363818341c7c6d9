"""When the extruders' outputs go on and off, counted from the start of the motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from planner.export.moves import deposits
from planner.plan.materials import materials_of

if TYPE_CHECKING:
    from planner.plan import Plan


@dataclass(frozen=True)
class Switch:
    """An output goes on or off for a bead, at a time [s] from the start."""

    time: float
    output: str
    value: bool
    bead: int


def planned_switches(plan: Plan) -> tuple[Switch, ...]:
    """On at the first and off at the last sample of each stretch with material, in order of time."""
    t = plan.trajectory
    outputs = {each.name: each.signal for each in materials_of(plan.problem)}
    found = []
    for a, b in zip(*(ends.tolist() for ends in deposits(t)), strict=True):
        bead = int(t.bead[a])
        signal = outputs.get(plan.toolpath.beads[bead].material, plan.problem.program.extruder_signal)
        found += [Switch(float(t.t[k] - t.t[0]), signal, value, bead) for k, value in ((a, True), (b, False))]
    return tuple(found)
