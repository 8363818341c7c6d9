"""Outputs that are switched in motion: which triggers a program declares, and which of them each move has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from planner.export.moves import Moves
from planner.export.rapid.declarations import extruders
from planner.export.rapid.demand import Demand
from planner.export.rapid.text import number
from planner.plan.materials import materials_of

if TYPE_CHECKING:
    from planner.plan import Plan


@dataclass(frozen=True)
class Triggers:
    """names: all there are; settings: their statements; of: move → names of its triggers, in order."""

    names: tuple[str, ...]
    settings: tuple[str, ...]
    of: dict[int, tuple[str, ...]]


def triggers_of(plan: Plan, moves: Moves, demand: Demand | None) -> Triggers:
    """Triggers of a plan: digital outputs on and off at a bead's ends, and with a demand, the flow of what follows."""
    switches = {
        f"{name}{k}": f"TriggIO {name}{k},0{where}\\DOp:={signal},{value};"
        for k, signal in extruders(plan).items()
        for name, where, value in (("trgOn", "", 1), ("trgOff", "", 0), ("trgOnStart", "\\Start", 1))
    }
    of = _switching(plan, moves)
    flows: dict[str, str] = {}
    if demand is not None:
        signal = plan.problem.program.demand_signal
        for move, levels in _asking(moves, demand).items():
            for percent, at_start in levels:
                name = f"trgFlow{percent:03d}{'Start' if at_start else ''}"
                where = "\\Start" if at_start else ""
                value = number(demand.value(percent), 4)
                flows[name] = f"TriggIO {name},0{where}\\AOp:={signal},{value};"
                of.setdefault(move, []).append(name)
    declared = switches | dict(sorted(flows.items()))
    return Triggers(tuple(declared), tuple(declared.values()), {move: tuple(names) for move, names in of.items()})


def _switching(plan: Plan, moves: Moves) -> dict[int, list[str]]:
    """Move → triggers of the digital outputs."""
    names = [each.name for each in materials_of(plan.problem)]
    endings = list(extruders(plan))
    own = [endings[names.index(bead.material)] if names else endings[0] for bead in plan.toolpath.beads]
    bead = plan.trajectory.bead
    of: dict[int, list[str]] = {}
    for name, flags, at in (
        ("trgOnStart", moves.on_start, moves.start),
        ("trgOn", moves.on_end, moves.sample),
        ("trgOff", moves.off_end, moves.sample),
    ):
        for i in flags.nonzero()[0].tolist():
            of.setdefault(i, []).append(name + own[bead[at[i]]])
    return of


def _asking(moves: Moves, demand: Demand) -> dict[int, list[tuple[int, bool]]]:
    """Move → (percent of the largest flow, at its start) that it sets: at its end, for what follows."""
    of: dict[int, list[tuple[int, bool]]] = {}
    now = 0
    for i in (moves.laid | moves.on_end | moves.on_start | moves.off_end).nonzero()[0].tolist():
        if moves.on_start[i] and demand.percent[i] != now:
            now = int(demand.percent[i])
            of.setdefault(i, []).append((now, True))
        follows = i + 1 < len(moves) and moves.laid[i + 1] and not moves.on_start[i + 1]
        then = int(demand.percent[i + 1]) if follows else 0
        if then != now:
            now = then
            of.setdefault(i, []).append((now, False))
    return of
