"""The materials of a plan: who feeds them, and how much each of them takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.plan.plan import Plan
from planner.plan.trajectory import Event
from planner.problem import Problem
from planner.problem.materials import signals
from planner.readonly import Array

SELECTS = ("select", "change")  # kinds of events after which another tool feeds
NONE = -1  # in place of a material before the first one is selected


@dataclass(frozen=True)
class Material:
    """A material: name, number of its tool in G-code, digital output of its extruder in RAPID, temperature [°C]."""

    name: str
    tool: int
    signal: str
    nozzle_c: float | None


@dataclass(frozen=True)
class Used:
    """What a print takes of a material: beads and their length [m], volume laid down [m^3], filament fed [m]."""

    material: Material
    beads: int
    length: float
    volume: float
    filament: float


def materials_of(problem: Problem) -> tuple[Material, ...]:
    """All materials that have names, in the problem's order."""
    process = problem.process
    return tuple(
        Material(name, process.tool(name), signal, process.nozzle_c(name)) for name, signal in signals(problem).items()
    )


def selected(materials: Sequence[str], events: Sequence[Event], t: Array) -> NDArray[np.intp]:
    """Index of the material whose tool is selected at instants t (n), as the events say; NONE before the first."""
    chosen = sorted((event for event in events if event.kind in SELECTS), key=lambda event: event.start)
    which = [materials.index(event.material) if event.material in materials else NONE for event in chosen]
    return np.array([NONE, *which])[np.searchsorted([event.start for event in chosen], t, side="right")]


def filament_areas(problem: Problem, events: Sequence[Event], t: Array) -> Array | float:
    """Cross-section [m^2] of the filament that is fed: one, or (n) of the tool that is selected at instants t (n)."""
    process = problem.process
    if not process.materials:
        return float(np.pi * (0.5 * process.filament_diameter) ** 2)
    names = list(process.materials)
    areas = [np.pi * (0.5 * process.of(name).filament_diameter) ** 2 for name in names]
    return np.array([*areas, 0.0])[selected(names, events, t)]  # the last one where none is selected: nothing comes out


def used(plan: Plan) -> tuple[Used, ...]:
    """What the print takes of each material that has a name; what is laid counts to the tool that is selected."""
    t, process, found = plan.trajectory, plan.problem.process, []
    materials = materials_of(plan.problem)
    own = selected([material.name for material in materials], t.events, t.t)
    laid = np.diff(t.extruded, prepend=0.0)
    for k, material in enumerate(materials):
        beads = [bead for bead in plan.beads if bead.material == material.name]
        volume = float(laid[own == k].sum())
        moved = sum(event.amount for event in t.events if event.material == material.name)
        filament = volume / (0.25 * np.pi * process.of(material.name).filament_diameter ** 2) + moved
        found.append(Used(material, len(beads), sum(bead.length for bead in beads), volume, filament))
    return tuple(found)
