"""G-code of the extruder's own board, in time with the robot: writer, reader, and check against the plan."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Indices
from planner.export.grammar import Grammar
from planner.plan.plan import SELECTS, materials_of, used

if TYPE_CHECKING:
    from planner.plan import Event, Plan, Trajectory
    from planner.problem.process import FanSpec

# ----------------------------------------------------------------------------------------------------
# Orders to the board besides moving filament: heating, tools, fan and cutter.

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
    """All orders by time; their lines are empty where the board need do nothing.

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


# ----------------------------------------------------------------------------------------------------
# Writer: extrusion.gcode for RepRapFirmware, the extruder alone.

Labels = NDArray[np.int64]

FILE = "extrusion.gcode"
BLOCK_S = 0.02  # shortest command [s]: a board that is fed faster than 50 lines/s may stutter
FLOW_STEP = 0.01  # blocks whose flow is equal to this share of the largest flow become one command
NOTHING = -1  # label of what belongs neither to a bead nor to an event
FIRST_EVENT = -2  # label of the first event; those of later ones count down


def write(plan: Plan) -> dict[str, str]:
    """The extruder's G-code, by the name of its file."""
    return {FILE: gcode(plan)}


def gcode(plan: Plan) -> str:
    """G-code of the extruder: G1 E F while filament moves, G4 P in between; E is relative, mm of filament.

    Heating, tools, fan and cutter come from `orders`. The robot waits at home for as long as its problem says.
    """
    t = plan.trajectory
    cuts, label = _chunks(t)
    fed = t.feed * 1e3
    # differences of rounded totals: rounding never adds up, neither in filament nor in time
    amount = np.diff(np.round(fed[cuts] - fed[0], 5))
    clock = t.t[cuts] - t.t[0]
    # a G1 lasts E / F, which a rounded E sets only nearly: what is lost or gained goes into the pauses
    rate = np.round(np.abs(amount) / np.diff(clock) * 60.0, 3)
    lasts = np.where(rate > 0.0, np.abs(amount) / np.where(rate > 0.0, rate, 1.0) * 60.0, 0.0)
    what = [(order.start, order.time, [f"; {order.words}", *order.lines]) for order in orders(plan)]
    last = NOTHING
    for e, f, took, end, who, layer in zip(
        amount.tolist(),
        rate.tolist(),
        lasts.tolist(),
        clock[1:].tolist(),
        label.tolist(),
        t.layer[(cuts[:-1] + cuts[1:] + 1) // 2].tolist(),
        strict=True,
    ):
        if f <= 0.0:
            continue
        about = [f"; {t.events[FIRST_EVENT - who].words}"] if who <= FIRST_EVENT else [f"; bead {who}, layer {layer}"]
        what.append((end - took, took, [*(about if who not in (last, NOTHING) else []), f"G1 E{e:.5f} F{f:.3f}"]))
        last = last if who == NOTHING else who

    name = re.sub(r"[^\x20-\x7e]", "?", plan.name)
    size = f"{len(plan.beads)} beads in {plan.layers} layers"
    total, seconds = fed[-1] - fed[0], t.t[-1] - t.t[0]
    lines = [
        f"; {name}: extrusion in time with the robot, strategy {plan.strategy}",
        f"; {size}, {total:.3f} mm of filament, {seconds:.3f} s from the robot's first motion",
        "M83",
    ]
    now = 0.0
    for start, took, own in sorted(what, key=lambda each: each[0]):
        lines += _pause(start - now)
        now += _pause_length(start - now) + took
        lines += own
    lines += _pause(float(clock[-1]) - now)
    return "\n".join(lines) + "\n"


def _pause_length(seconds: float) -> float:
    """Whole milliseconds, which is what G4 P takes; below one there is no pause."""
    return max(0, round(seconds * 1e3)) * 1e-3


def _pause(seconds: float) -> list[str]:
    ms = round(_pause_length(seconds) * 1e3)
    return [f"G4 P{ms}"] if ms else []


def _chunks(t: Trajectory) -> tuple[Indices, Labels]:
    """Samples (m + 1) between which filament moves at a constant rate, and what each chunk (m) belongs to.

    That is the index of a bead, FIRST_EVENT less the index of an event, or NOTHING.
    """
    moved = np.diff(t.feed)
    # a bead's first or last part sample belongs to the bead beside it
    label = np.where(np.diff(t.extruded) > 0.0, np.maximum(t.bead[:-1], t.bead[1:]), NOTHING)
    for k, event in enumerate(t.events):
        if event.amount != 0.0:  # which moves more filament than the part of a bead in the same sample
            since = int(np.searchsorted(t.t, event.start, side="right")) - 1
            label[since : np.searchsorted(t.t, event.start + event.duration)] = FIRST_EVENT - k
    edge = np.flatnonzero(np.diff(label)) + 1
    starts = np.concatenate([[0], edge])
    ends = np.concatenate([edge, [len(moved)]])
    block = max(1, round(BLOCK_S / t.dt))
    # blocks count from each run's own start, so that no block spans two runs; an event is one block
    first = np.repeat(starts, ends - starts)
    at = np.arange(len(moved))
    heads = np.flatnonzero((at == first) | (((at - first) % block == 0) & (label > FIRST_EVENT)))
    mean = np.add.reduceat(moved, heads) / np.diff(np.append(heads, len(moved)))
    level = np.round(mean / max(float(np.abs(mean[label[heads] >= 0]).max(initial=0.0)), 1e-300) / FLOW_STEP)
    changes = np.concatenate([[True], (np.diff(level) != 0) | (np.diff(label[heads]) != 0)])
    cuts = heads[changes]
    return np.append(cuts, len(moved)), label[cuts]


# ----------------------------------------------------------------------------------------------------
# Reader and check: each tool gets the filament that the plan has for it, and in time.

AMOUNT = 1e-5  # m of filament that a tool may get too much or too little, in all
LATE = 2e-3  # s, and a sample: by which an order may stand behind or before its instant
GRAMMAR = Grammar.of(
    "G-code",
    ";",
    {
        "feed": r"G1 E(-?\d+\.\d+) F(\d+\.\d+)",
        "pause": r"G4 P(\d+)",
        "tool": r"T(\d+)",
        "wait": r"M116|M1(?:09|90) S[\d.]+",
        "order": r"M(?:42|104|106|107|140|280)(?: [A-Z]-?[\d.]+)*",
        "mode": r"M83",
    },
    called="line",
)


@dataclass(frozen=True)
class Extrusion:
    """What the program does: filament in all [m] by tool (None before any is selected), when tools are selected [s],
    the other lines for the board with their times [s], and how long it lasts [s]."""

    filament: dict[int | None, float]
    selections: tuple[tuple[float, int], ...]
    orders: tuple[tuple[float, str], ...]
    duration: float


def read_gcode(text: str) -> Extrusion:
    """Extrusion of a program as `writer.gcode` writes it. Raises InputError with the line of anything else.

    Relative filament is asked for before all else, and temperatures are waited for only before time has passed.
    """
    filament: dict[int | None, float] = {}
    selections: list[tuple[float, int]] = []
    ordered: list[tuple[float, str]] = []
    now, tool, relative = 0.0, None, False
    for statement in GRAMMAR.statements(text.splitlines()):
        word, parts = statement.word, statement.parts
        if word == "mode":
            relative = True
        elif not relative:
            raise statement.misplaced("before M83")
        elif word == "wait" and now > 0.0:
            raise statement.error(f"{statement.text!r} would lose the robot, which waits by time")
        elif word in ("wait", "order"):
            ordered.append((now, statement.text))
        elif word == "tool":
            tool = int(parts[0])
            selections.append((now, tool))
        elif word == "pause":
            now += int(parts[0]) * 1e-3
        else:
            amount = float(parts[0]) * 1e-3
            filament[tool] = filament.get(tool, 0.0) + amount
            now += abs(amount) / (float(parts[1]) * 1e-3 / 60.0)
    return Extrusion(filament, tuple(selections), tuple(ordered), now)


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the program from the plan, beyond rounding, in words. InputError for an unknown line."""
    t, written = plan.trajectory, read_gcode(files[FILE])
    found = filament_differences(plan, written.filament)
    tools = {each.name: each.tool for each in materials_of(plan.problem)}
    planned = [(event.start, tools[event.material]) for event in t.events if event.kind in SELECTS]
    if [tool for _, tool in planned] != [tool for _, tool in written.selections]:
        found.append("other tools are selected than the plan's")
    else:
        late = [abs(at - start) for (at, _), (start, _) in zip(written.selections, planned, strict=True)]
        if not max(late, default=0.0) <= LATE + t.dt:
            found.append(f"a tool is selected {max(late):.3g} s off its time")
    planned_orders = [(due, line) for order in orders(plan) for due, line in order.due if line.startswith("M")]
    found += order_differences(planned_orders, written.orders, LATE + t.dt, "the board is told other things")
    if not abs(written.duration - float(t.t[-1] - t.t[0])) <= LATE + t.dt:
        found.append(f"it lasts {written.duration:.3f} s")
    return found


def filament_differences(plan: Plan, filament: Mapping[int | None, float]) -> list[str]:
    """Tools that get more or less filament [m] in all than planned; the tool is None where a plan has but one."""
    t = plan.trajectory
    planned: dict[int | None, float] = {each.material.tool: each.filament for each in used(plan) if each.beads}
    planned = planned or {None: float(t.feed[-1] - t.feed[0])}
    off = {tool: filament.get(tool, 0.0) - planned.get(tool, 0.0) for tool in {*planned, *filament}}
    return [
        f"{'the extruder' if tool is None else f'tool T{tool}'} gets {amount * 1e3:+.3g} mm of filament"
        for tool, amount in sorted(off.items(), key=str)
        if not abs(amount) <= AMOUNT
    ]


def order_differences(
    planned: Sequence[tuple[float, str | None]], found: Sequence[tuple[float, str]], tolerance: float, others: str
) -> list[str]:
    """Whether a program tells the board the planned lines (time [s], text), within a tolerance [s] of their times.

    others: how to begin where it tells others.
    """
    if [line for _, line in planned] != [line for _, line in found]:
        return [f"{others} than the plan's, or in another order"]
    late = [(abs(at - due), line) for (at, line), (due, _) in zip(found, planned, strict=True)]
    worst, line = max(late, default=(0.0, ""))
    return [] if worst <= tolerance else [f"{line} is said {worst:.3g} s off its time"]
