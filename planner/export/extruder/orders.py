"""What an extruder's board is told besides moving filament: heating, tools, fan and cutter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.plan.materials import SELECTS, materials_of

if TYPE_CHECKING:
    from planner.plan import Event, Plan, Trajectory
    from planner.problem.board import FanSpec

PAUSE = "G4 P"  # and milliseconds
FULL = 255  # of S in M106
AHEAD = 3.0  # samples by which the fan is switched before filament moves: never behind a command that has begun


@dataclass(frozen=True)
class Order:
    """Lines of G-code that are due `start` [s] after the trajectory's, and take `time` [s]; why, in words."""

    start: float
    words: str
    lines: tuple[str, ...]
    time: float = 0.0

    @property
    def due(self) -> tuple[tuple[float, str], ...]:
        """Its lines but for pauses and comments, each with its own instant [s]."""
        found, now = [], self.start
        for line in self.lines:
            if line.startswith(PAUSE):
                now += int(line[len(PAUSE) :]) * 1e-3
            elif not line.startswith(";"):
                found.append((now, line))
        return tuple(found)


def orders(plan: Plan) -> tuple[Order, ...]:
    """All that the board is told besides moving filament, in order of time; lines are empty where it need do nothing.

    Temperatures are set and not waited for, but with `heat: wait` before any time has passed: only what takes a known
    time keeps pace with the robot.
    """
    t = plan.trajectory
    found = [_of_event(plan, event) for event in t.events if event.amount == 0.0]
    if plan.problem.process.fan is not None:
        found += _of_fan(plan.problem.process.fan, t, plan.problem.process.extruder.lag)
    return tuple(sorted(found, key=lambda order: order.start))


def _of_event(plan: Plan, event: Event) -> Order:
    process = plan.problem.process
    if event.kind == "heat":
        return Order(event.start, event.words, _heating(plan))
    if event.kind == "cut" and process.fibre is not None:
        return Order(event.start, event.words, process.fibre.code, process.fibre.code_time)
    named = materials_of(plan.problem)
    tools = tuple(f"T{each.tool}" for each in named if event.kind in SELECTS and each.name == event.material)
    return Order(event.start, event.words, tools)


def _heating(plan: Plan) -> tuple[str, ...]:
    start = plan.problem.process.start
    named = materials_of(plan.problem)
    nozzles = [(f" T{each.tool}", each.nozzle_c) for each in named] or [("", start.nozzle_c)]
    lines = [] if start.bed_c is None else [f"M140 S{start.bed_c:g}"]
    lines += [f"M104{tool} S{celsius:g}" for tool, celsius in nozzles if celsius is not None]
    if start.heat == "wait":
        if start.bed_c is not None:
            lines.append(f"M190 S{start.bed_c:g}")
        if named:
            lines.append("M116")  # M109 of several tools would select them, one after the other
        elif start.nozzle_c is not None:
            lines.append(f"M109 S{start.nozzle_c:g}")
        lines.append("; all is hot: the robot's program starts now")
    return tuple(lines)


def _of_fan(fan: FanSpec, t: Trajectory, lag: float) -> list[Order]:
    """On or off before beads whose layer is, or is not, cooled, before filament moves for them; off at the end."""
    first = np.flatnonzero((t.bead >= 0) & (np.diff(t.bead, prepend=-1) != 0))
    wanted = t.layer[first] + 1 >= fan.from_layer
    on, off = f"M106 P{fan.number} S{max(1, round(FULL * fan.speed))}", f"M106 P{fan.number} S0"
    primes = {event.bead: event.start for event in t.events if event.kind == "prime"}
    found = []
    for k in np.flatnonzero(np.diff(wanted.astype(np.int8), prepend=0)).tolist():
        moves = float(t.t[first[k]]) - lag
        start = min(moves, primes.get(int(t.bead[first[k]]), moves)) - AHEAD * t.dt - float(t.t[0])
        found.append(Order(max(0.0, start), f"fan {'on' if wanted[k] else 'off'}", (on if wanted[k] else off,)))
    if len(first) and wanted[-1]:
        found.append(Order(float(t.t[-1] - t.t[0]), "fan off", (off,)))
    return found
