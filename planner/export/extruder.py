"""G-code of the extruder's own board, in time with the robot: writer, reader, and check against the plan."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices
from planner.base.errors import InputError
from planner.base.gcode_lines import PAUSE, commands_in, time_of
from planner.export.board import DONE, FIRMWARES, GRACE, SELECTS, lasts, least_time, rate_for, repeat, select, wait_for
from planner.export.grammar import Grammar, Statement
from planner.export.in_step import NEAR, Stretch, busy_ends, early, fed_within, laid_filament, stretches, without_lag
from planner.plan.plan import SELECTS as SELECTING
from planner.plan.plan import materials_of, used

if TYPE_CHECKING:
    from planner.plan import Event, Plan, Trajectory
    from planner.problem.process import FanSpec, FibreSpec
    from planner.problem.settings import BoardSpec

# ----------------------------------------------------------------------------------------------------
# Orders to the board besides moving filament: heating, tools, fan and cutter.

FULL = 255  # of S in M106
AHEAD = 3.0  # samples: the fan is switched this long before filament moves, so never behind a command that has begun


@dataclass(frozen=True)
class Order:
    """Lines of G-code due `start` [s] after the trajectory's start, which take `time` [s]; `words` says why."""

    start: float
    words: str
    lines: tuple[str, ...]
    time: float = 0.0

    @property
    def due(self) -> tuple[tuple[float, str], ...]:
        """Its commands without pauses and comments, each with its own time [s]."""
        found, now = [], self.start
        for command in (each for line in self.lines if not line.startswith(";") for each in commands_in(line)):
            if not command.startswith(PAUSE):
                found.append((now, command))
            now += time_of([command])
        return tuple(found)


def orders(plan: Plan, firmware: str = "") -> tuple[Order, ...]:
    """All orders by time, for a firmware (default: the board's); an order has no lines where the board need do nothing.

    Temperatures are set but not waited for, except with `heat: wait`, before any time has passed: only commands that
    take a known time stay in step with the robot.
    """
    t = plan.trajectory
    firmware = firmware or plan.problem.program.board.firmware
    found = [_of_event(plan, event, firmware) for event in t.events if event.amount == 0.0]
    if plan.problem.process.fan is not None:
        found += _of_fan(plan.problem.process.fan, t, plan.problem.process.extruder.lag)
    return tuple(sorted(found, key=lambda order: order.start))


def _of_event(plan: Plan, event: Event, firmware: str) -> Order:
    process = plan.problem.process
    if event.kind == "heat":
        return Order(event.start, event.words, _heating(plan, firmware))
    if event.kind == "cut" and process.fibre is not None:
        return Order(cutter_starts(event, process.fibre), event.words, process.fibre.code, process.fibre.code_time)
    named = materials_of(plan.problem)
    now = [each.tool for each in named if event.kind in SELECTING and each.name == event.material]
    tools = tuple(select(firmware, tool) for tool in now)
    return Order(event.start, event.words, tools)


def cutter_starts(cut: Event, fibre: FibreSpec) -> float:
    """When [s] the cutter moves within a rest: in the middle of it, as published."""
    return cut.start + 0.5 * (cut.duration - fibre.code_time)


def _heating(plan: Plan, firmware: str) -> tuple[str, ...]:
    start = plan.problem.process.start
    named = materials_of(plan.problem)
    nozzles = [(f" T{each.tool}", each.nozzle_c) for each in named] or [("", start.nozzle_c)]
    lines = [] if start.bed_c is None else [f"M140 S{start.bed_c:g}"]
    lines += [f"M104{tool} S{celsius:g}" for tool, celsius in nozzles if celsius is not None]
    if start.heat == "wait":
        if start.bed_c is not None:
            lines.append(f"M190 S{start.bed_c:g}")
        if named and firmware == "reprap":
            lines.append("M116")  # M109 for several tools would select each of them
        elif named:
            lines += [f"M109{tool} S{celsius:g}" for tool, celsius in nozzles if celsius is not None]
        elif start.nozzle_c is not None:
            lines.append(f"M109 S{start.nozzle_c:g}")
        lines.append("; all is hot: the robot's program starts now")
    return tuple(lines)


def _is_fan(plan: Plan, line: str) -> bool:
    """Whether a line switches the fan rather than a cutter."""
    fan = plan.problem.process.fan
    return fan is not None and line.startswith(f"M106 P{fan.number} ")


def _of_fan(fan: FanSpec, t: Trajectory, lag: float) -> list[Order]:
    """Fan on or off, according to each bead's layer, before filament moves for the bead; off at the end.

    Never before the previous bead has ended. A prime, retract or purge is a single line: an order that would fall
    within one comes before that line.
    """
    laid, begin = t.bead >= 0, float(t.t[0])
    first = np.flatnonzero(laid & (np.diff(t.bead, prepend=-1) != 0))
    last = np.flatnonzero(laid & (np.diff(t.bead, append=-1) != 0))
    over = np.append(begin, t.t[np.minimum(last[:-1] + 1, first[1:] - 1)])
    wanted = t.layer[first] + 1 >= fan.from_layer
    on, off = f"M106 P{fan.number} S{max(1, round(FULL * fan.speed))}", f"M106 P{fan.number} S0"
    primes = {event.bead: event.start for event in t.events if event.kind == "prime"}
    pushing = [t.t[_samples_of(t, event)].tolist() for event in t.events if event.amount != 0.0]
    found = []
    for k in np.flatnonzero(np.diff(wanted.astype(np.int8), prepend=0)).tolist():
        moves = float(t.t[first[k]]) - min(lag, NEAR)
        start = min(moves, primes.get(int(t.bead[first[k]]), moves)) - AHEAD * t.dt
        start = max(start, float(over[k]))
        start = next((since for since, until in pushing if since < start < until), start)
        found.append(Order(start - begin, f"fan {'on' if wanted[k] else 'off'}", (on if wanted[k] else off,)))
    if len(first) and wanted[-1]:
        found.append(Order(float(t.t[-1]) - begin, "fan off", (off,)))
    return found


def _samples_of(t: Trajectory, event: Event) -> list[int]:
    """The samples between which an event's filament moves as one line."""
    first = int(np.searchsorted(t.t, event.start, side="right")) - 1
    return [first, min(int(np.searchsorted(t.t, event.start + event.duration)), len(t) - 1)]


# ----------------------------------------------------------------------------------------------------
# Writer: extrusion.gcode, the extruder alone.
#
# By default the file waits for the robot's output at both ends of each bead; moves within a bead, and between two, are
# timed from that wait. At a bead's end, RepRapFirmware keeps extruding until the output goes off.

Labels = NDArray[np.int64]

FILE = "extrusion.gcode"
BLOCK_S = 0.02  # shortest command [s]: a board that is fed faster than 50 lines/s may stutter
FLOW_STEP = 0.01  # share of the largest flow laid: blocks whose flows round to the same multiple become one command
LONGEST_S = 10.0  # longest command along a bead [s]: flow differences within it add up, and boards pause between them
NOTHING = -1  # label of samples that belong neither to a bead nor to an event
FIRST_EVENT = -2  # label of the first event; later ones count down from it
TAIL_S = 0.01  # [s]; block repeated while the robot is late: a bead may end this much, and a few lines, after it
SLOWER = 0.1  # share of a bead's time by which it may last longer than planned; beyond it the robot may have stopped
LONGER = 0.1  # [s] by which even a short bead may last longer
ENOUGH = 2.0  # × least time of a line on a board that moves from rest to rest: its peak is then below twice the mean
AMOUNT_DIGITS, RATE_DIGITS = 5, 3  # decimals of E [mm] and F [mm/min]
ORDER = "order"


class Part(NamedTuple):
    """What the board does from `start` to `end` [s]: filament [mm] at a constant rate, or lines of its own.

    kind   an event's kind, ORDER, or empty for a bead
    about  comment above it; empty if it continues the part above
    """

    start: float
    end: float
    filament: float
    kind: str
    about: str
    lines: tuple[str, ...] = ()


def write(plan: Plan) -> dict[str, str]:
    """The extruder's G-code, by the name of its file."""
    return {FILE: gcode(plan)}


def gcode(plan: Plan) -> str:
    """G-code of the extruder: G1 E F while filament moves, G4 P in between; E is relative, in mm of filament.

    Heating, tools, fan and cutter come from `orders`. The robot waits at home for as long as the problem says.
    """
    t, board = plan.trajectory, plan.problem.program.board
    duration = float(t.t[-1] - t.t[0])
    parts = parts_of(plan)
    if board.sync == "free":
        parts = tuple(_reached(board, parts))
        body, now = _said(board, parts, 0.0)
        notes = [f"; it runs by time alone: {own_time(board, parts, duration)}"]
    else:
        found = stretches(plan)
        body, now = _in_step(plan, parts, found)
        inputs = dict.fromkeys((each.signal, each.number) for each in found)
        wired = ", ".join(f"{signal} to input {number}" for signal, number in inputs)
        notes = [f"; it waits for the robot at both ends of each bead: {wired} ({FIRMWARES[board.firmware].wired})"]
        notes.append("; start it first, then the robot's program")
        if plan.problem.process.fibre is not None:
            notes.append("; the output goes off where fibre is cut: the robot rests there, and draws the rest")
    name = re.sub(r"[^\x20-\x7e]", "?", plan.name)
    size = f"{len(plan.beads)} beads in {plan.layers} layers"
    total = (t.feed[-1] - t.feed[0]) * 1e3
    lines = [
        f"; {name}: extrusion in time with the robot, strategy {plan.strategy}",
        f"; {size}, {total:.3f} mm of filament, {duration:.3f} s from the robot's first motion",
        *notes,
        *FIRMWARES[board.firmware].begin,
        "M83",
        *(() if materials_of(plan.problem) else (select(board.firmware, board.first_tool),)),
        *body,
        *_pause(duration - now),
    ]
    return "\n".join(lines) + "\n"


def parts_of(plan: Plan) -> tuple[Part, ...]:
    """Everything that the board does, by the plan's time [s] from its start."""
    t = plan.trajectory
    cuts, label = _chunks(plan)
    fed = t.feed * 1e3
    # differences of rounded totals: rounding never adds up, neither in filament nor in time
    amount = np.diff(np.round(fed[cuts] - fed[0], AMOUNT_DIGITS))
    clock = t.t[cuts] - t.t[0]
    layer = t.layer[(cuts[:-1] + cuts[1:] + 1) // 2]
    found = [Part(each.start, each.start + each.time, 0.0, ORDER, each.words, each.lines) for each in orders(plan)]
    last = NOTHING
    for k in np.flatnonzero(np.round(np.abs(amount) / np.diff(clock) * 60.0, RATE_DIGITS) > 0.0).tolist():
        who = int(label[k])
        event = t.events[FIRST_EVENT - who] if who <= FIRST_EVENT else None
        about = f"bead {who}, layer {layer[k]}" if event is None else event.words
        new = who not in (last, NOTHING)
        kind = "" if event is None else event.kind
        found.append(Part(float(clock[k]), float(clock[k + 1]), float(amount[k]), kind, about if new else ""))
        last = last if who == NOTHING else who
    return tuple(sorted(found, key=lambda part: part.start))


def _said(board: BoardSpec, parts: Sequence[Part], now: float) -> tuple[list[str], float]:
    """Lines for consecutive parts from time `now` [s] on, and the time at which they end."""
    lines: list[str] = []
    for part in _enough(parts, FIRMWARES[board.firmware].least):
        if part.kind == ORDER:
            text, start, took = list(part.lines), part.start, part.end - part.start
        else:
            line, took = _extruded(board, part)
            text = [line]
            start = part.end - took  # a line lasts E / F, which is inexact once rounded: a pause makes up the rest
        lines += _pause(start - now)
        now += _pause_length(start - now) + took
        lines += [f"; {part.about}"] if part.about else []
        lines += text
    return lines, now


def _reached(board: BoardSpec, parts: Sequence[Part]) -> list[Part]:
    """The parts, with consecutive ones of a bead joined where ramps from and to rest would take up most of a line."""
    found: list[Part] = []
    for part in parts:
        if found and _joined(found[-1], part) and not _is_reached(board, found[-1]):
            part = _both(found.pop(), part)
        found.append(part)
    out: list[Part] = []
    for part in found:  # short remainders at an end
        if out and _joined(out[-1], part) and not _is_reached(board, part):
            part = _both(out.pop(), part)
        out.append(part)
    return out


def _is_reached(board: BoardSpec, part: Part) -> bool:
    """Whether a part takes long enough for a board with ramps."""
    took = part.end - part.start
    return took >= ENOUGH * least_time(board, abs(part.filament) / took)


def _enough(parts: Sequence[Part], least: int) -> list[Part]:
    """The parts; if a run without pauses has fewer than `least`, its first is divided, so that it starts at once."""
    found: list[Part] = []
    run: list[Part] = []
    for part in parts:
        if run and (part.kind == ORDER or part.start - run[-1].end > 0.5e-3):
            found += _divided(run, least)
            run = []
        if part.kind == ORDER:
            found.append(part)
        else:
            run.append(part)
    return found + _divided(run, least)


def _divided(run: Sequence[Part], least: int) -> list[Part]:
    """At least `least` parts, the first one divided if need be; an empty run stays empty."""
    pieces = least - len(run) + 1
    if not run or pieces <= 1:
        return list(run)
    own = [_share(run[0], k / pieces, (k + 1) / pieces) for k in range(pieces)]
    return [own[0], *(piece._replace(about="") for piece in own[1:]), *run[1:]]


def _share(part: Part, since: float, until: float) -> Part:
    """A part between two shares of its time; its filament is rounded as in the file."""
    start, whole = part.start, part.end - part.start
    fed = [round(share * part.filament, AMOUNT_DIGITS) for share in (since, until)]
    return part._replace(start=start + since * whole, end=start + until * whole, filament=fed[1] - fed[0])


def _extruded(board: BoardSpec, part: Part) -> tuple[str, float]:
    """The line that moves a part's filament in its time, and how long it takes [s]."""
    amount, seconds = np.array(round(part.filament, AMOUNT_DIGITS)), np.array(part.end - part.start)
    rate = np.round(rate_for(board, amount, seconds) * 60.0, RATE_DIGITS)
    return f"G1 E{amount:.{AMOUNT_DIGITS}f} F{rate:.{RATE_DIGITS}f}", float(lasts(board, amount, rate / 60.0))


def _pause_length(seconds: float) -> float:
    """The length [s] in whole milliseconds, as G4 P takes it; less than half of one is no pause."""
    return max(0, round(seconds * 1e3)) * 1e-3


def _pause(seconds: float) -> list[str]:
    ms = round(_pause_length(seconds) * 1e3)
    return [f"G4 P{ms}"] if ms else []


def own_time(board: BoardSpec, parts: Sequence[Part], duration: float) -> str:
    """How long a board takes for a file that never waits for the robot, in words."""
    lines, now = _said(board, parts, 0.0)
    firmware = FIRMWARES[board.firmware]
    own = max(now, duration)
    if board.from_rest:
        how = f"{firmware.title} moves filament from rest to rest, at {board.acceleration * 1e3:g} mm/s2"
        return f"{own:.3f} s as {how}"
    if board.firmware == "marlin":
        return f"{own:.3f} s as {firmware.title} joins moves"
    text = ["G4"] + [line[:2] for line in lines if line[:1] == "G"]
    idle = sum(a == "G4" and b == "G1" for a, b in zip(text[:-1], text[1:], strict=True))
    later = own + idle * GRACE
    return f"{own:.3f} s as {firmware.title} joins moves; up to {later:.3f} s before 3.3, which does not know M595 R"


# ----------------------------------------------------------------------------------------------------
# In step with the robot.


def _in_step(plan: Plan, parts: Sequence[Part], found: Sequence[Stretch]) -> tuple[list[str], float]:
    """Lines that wait for the robot at both ends of each stretch, and when they end in the plan's time [s]."""
    board, dt = plan.problem.program.board, plan.trajectory.dt
    waiting: list[Part] = []
    lines: list[str] = []
    ends = busy_ends(plan.trajectory)
    now, taken = 0.0, 0
    for stretch in found:
        while taken < len(parts) and parts[taken].start < stretch.off + NEAR:
            waiting.append(parts[taken])
            taken += 1
        before = [part for part in waiting if _is_before(part, stretch, dt)]
        later = [part for part in waiting if not _is_before(part, stretch, dt)]
        within = [part for part in later if _is_within(part, stretch, dt)]
        waiting = [part for part in later if not _is_within(part, stretch, dt)]
        said, _ = _said(board, [_earlier(plan, part, now, ends) for part in before], now)
        lines += [*said, wait_for(board.firmware, stretch.number, True)]
        said, now = _within(plan, within, stretch)
        lines += [*said, wait_for(board.firmware, stretch.number, False)]
        now = max(now, stretch.off)
    said, now = _said(board, [*waiting, *parts[taken:]], now)
    return lines + said, now


def _is_before(part: Part, stretch: Stretch, dt: float) -> bool:
    # a part that builds up pressure may begin a sample before the pressure does
    return part.start < stretch.on - NEAR - 1.5 * dt if part.kind == "" else part.start < stretch.on + 0.5 * dt


def _is_within(part: Part, stretch: Stretch, dt: float) -> bool:
    return part.start < stretch.off + NEAR if part.kind == "" else part.start < stretch.off - 1.5 * dt


def _earlier(plan: Plan, part: Part, since: float, ends: Sequence[float]) -> Part:
    """A prime, or the fan, moved a little earlier, so that the board is ready when the robot arrives."""
    if part.kind != "prime" and not any(_is_fan(plan, line) for line in part.lines):
        return part
    by = early(ends, part.start, since)
    return part._replace(start=part.start - by, end=part.end - by)


def _within(plan: Plan, parts: Sequence[Part], stretch: Stretch) -> tuple[list[str], float]:
    """Lines of a stretch, from its beginning on, and when they end in the plan's time [s]."""
    board, dt = plan.problem.program.board, plan.trajectory.dt
    firmware, own = FIRMWARES[board.firmware], _reached(board, _clipped(parts, stretch, dt))
    last = own[-1] if own else None
    follows = (
        firmware.loops
        and last is not None
        and plan.problem.process.extruder.lag == 0.0
        and last.kind == ""
        and last.filament > 0.0
        and abs(last.end - stretch.off) <= 1.5 * dt
    )
    if not follows or last is None:
        return _said(board, own, stretch.on)
    own, last = _last_block(board, own)
    said, now = _said(board, own, stretch.on)
    lines = [*said, *_pause(last.start - now), *([f"; {last.about}"] if last.about else []), DONE]
    most = max(1, round(max(LONGER, SLOWER * (stretch.off - stretch.on)) / (last.end - last.start)))
    repeated = (f"  {line}" for line in (_extruded(board, last)[0], DONE))
    return [*lines, repeat(stretch.number, most), *repeated], stretch.off


def _last_block(board: BoardSpec, parts: Sequence[Part]) -> tuple[list[Part], Part]:
    """The parts without a block at their end, and that block: as long as TAIL_S and as ramps to and from rest need."""
    *own, last = parts
    tail = max(TAIL_S, least_time(board, last.filament / (last.end - last.start)))
    while own and last.end - last.start < tail and _joined(own[-1], last):
        last = _both(own.pop(), last)
    if last.end - last.start > 1.2 * tail:
        first = _share(last, 0.0, 1.0 - tail / (last.end - last.start))
        last = last._replace(start=first.end, filament=last.filament - first.filament, about="")
        if own and first.end - first.start < tail and _joined(own[-1], first):
            first = _both(own.pop(), first)
        own.append(first)
    return own, last


def _joined(part: Part, following: Part) -> bool:
    """Whether both belong to a bead and follow each other without a gap."""
    return not part.kind and not following.kind and following.start - part.end < 1e-9


def _both(part: Part, following: Part) -> Part:
    """Two parts as one, at an even rate."""
    return part._replace(end=following.end, filament=part.filament + following.filament)


def _clipped(parts: Sequence[Part], stretch: Stretch, dt: float) -> list[Part]:
    """Parts of a stretch, clipped to begin no earlier than it, and to end with it if they overrun by about a sample."""
    found: list[Part] = []
    pool, about = 0.0, ""
    for part in parts:
        about = about or part.about
        start, end = max(part.start, stretch.on), part.end
        if 0.0 < end - stretch.off <= 1.5 * dt:
            end = stretch.off
        if part.kind:
            found.append(part)
        elif end - start > 0.5 * dt:
            found.append(part._replace(start=start, end=end, filament=part.filament + pool, about=about))
            pool, about = 0.0, ""
        elif found and not found[-1].kind:
            found[-1] = found[-1]._replace(filament=found[-1].filament + part.filament)
        else:
            pool += part.filament
    return found


def _chunks(plan: Plan) -> tuple[Indices, Labels]:
    """Samples (m + 1) between which filament moves at a constant rate, and the label of each chunk (m).

    A label is the index of a bead, FIRST_EVENT minus the index of an event, or NOTHING.
    """
    t = plan.trajectory
    moved = np.diff(t.feed)
    # a bead's first or last partial sample belongs to the adjacent bead
    label = np.where(np.diff(t.extruded) > 0.0, np.maximum(t.bead[:-1], t.bead[1:]), NOTHING)
    for k, event in enumerate(t.events):
        if event.amount != 0.0:  # it moves more filament than the part of a bead in the same sample
            label[slice(*_samples_of(t, event))] = FIRST_EVENT - k
    edge = np.flatnonzero(np.diff(label)) + 1
    starts = np.concatenate([[0], edge])
    ends = np.concatenate([edge, [len(moved)]])
    block = max(1, round(BLOCK_S / t.dt))
    # blocks count from each run's own start, so that no block spans two runs; an event is one block
    first = np.repeat(starts, ends - starts)
    at = np.arange(len(moved))
    heads = np.flatnonzero((at == first) | (((at - first) % block == 0) & (label > FIRST_EVENT)))
    count = np.diff(np.append(heads, len(moved)))
    mean, within = np.add.reduceat(moved, heads) / count, label[heads] >= 0
    most = float(np.abs(mean[within]).max(initial=0.0))
    if plan.problem.process.extruder.lag > 0.0:  # building up pressure feeds many times as fast as laying material
        laid = np.add.reduceat(without_lag(plan), heads) / count
        most = min(most, float(laid[within].max(initial=0.0)))
    level = np.round(mean / max(most, 1e-300) / FLOW_STEP)
    often = max(1, round(LONGEST_S / (block * t.dt)))
    long = within & ((heads - first[heads]) // block % often == 0)
    changes = long | np.concatenate([[True], (np.diff(level) != 0) | (np.diff(label[heads]) != 0)])
    cuts = heads[changes]
    return np.append(cuts, len(moved)), label[cuts]


# ----------------------------------------------------------------------------------------------------
# Reader and check: each tool gets the filament planned for it, on time, and in step with the robot.

AMOUNT = 1e-5  # [m] of filament that a tool may get too much or too little in total
LATE = 2e-3  # [s], plus a sample: how far an order may be from its time
RAMPS = 0.02  # [s] by which a bead may end late on a board whose ramps take longer than a line may
_COMMAND = r"M(?:42|104|106|107|140|280)(?: [A-FH-LO-Z]-?[\d.]+)*"
GRAMMAR = Grammar.of(
    "G-code",
    ";",
    {
        "feed": r"G1 E(-?\d+\.\d+) F(\d+\.\d+)",
        "pause": r"G4 P(\d+)",
        "tool": SELECTS,
        "signal": r"M(577|226) P(\d{1,3}) S([01])",
        "repeat": r"while sensors\.gpIn\[(\d{1,3})\]\.value == 1 && iterations < (\d{1,6})",
        "done": DONE,
        "wait": r"M116|M1(?:09|90)(?: T\d+)? S[\d.]+",
        "order": rf"{_COMMAND}(?: {_COMMAND}| {PAUSE}\d+)*",
        "begin": "|".join(line for firmware in FIRMWARES.values() for line in map(re.escape, firmware.begin)),
        "mode": r"M83",
    },
    called="line",
)


class BoardStep(NamedTuple):
    """A wait for the robot: its command, the input, and whether that must be on; when the board is ready for it [s],
    filament [m] since the previous wait, and how long [s] the last line before it is repeated at most, if it is."""

    code: str
    number: int
    on: bool
    ready: float
    filament: float
    longest: float | None = None


@dataclass(frozen=True)
class Extrusion:
    """What the program does: total filament [m] by tool, when tools are selected [s], other orders to the board with
    their times [s], its duration [s], its waits for the robot, and its opening lines.

    fed (k, 2): total filament [m] at times [s], at the beginning and the end of each line that moves some.
    """

    filament: dict[int | None, float]
    selections: tuple[tuple[float, int], ...]
    orders: tuple[tuple[float, str], ...]
    duration: float
    steps: tuple[BoardStep, ...] = ()
    begin: tuple[str, ...] = ()
    fed: tuple[tuple[float, float], ...] = ()


def read_gcode(text: str, board: BoardSpec | None = None, signals: Sequence[float] = ()) -> Extrusion:
    """Extrusion of a program as `gcode` writes it, by the clock of a board whose waits end at `signals` [s] or later.

    Raises InputError, with the line number, for anything else: relative filament (M83) and a tool must be selected
    before filament moves, temperatures may be waited for only before any time has passed, and only the last block of a
    bead may be repeated.
    """
    state = _Reading(board)
    raw = text.splitlines()
    for statement in GRAMMAR.statements(raw):
        indented = raw[statement.line - 1].startswith(" ")
        if indented != (state.repeated in ("repeat", "feed")):
            raise statement.misplaced("outside a repetition" if indented else "within a repetition")
        state.take(statement, signals)
    if state.repeated:
        raise InputError("it ends within a repetition", file=GRAMMAR.file, line=len(raw))
    return Extrusion(
        state.filament,
        tuple(state.selections),
        tuple(state.ordered),
        state.now,
        tuple(state.steps),
        tuple(state.begin),
        tuple(state.fed),
    )


class _Reading:
    """State of reading; `repeated` is the previous line within a repetition, or empty."""

    def __init__(self, board: BoardSpec | None) -> None:
        self.board = board
        self.filament: dict[int | None, float] = {}
        self.selections: list[tuple[float, int]] = []
        self.ordered: list[tuple[float, str]] = []
        self.steps: list[BoardStep] = []
        self.begin: list[str] = []
        self.fed: list[tuple[float, float]] = []
        self.now, self.repeated = 0.0, ""
        self._loop: tuple[int, int] | None = None  # input, and most repetitions
        self._took = 0.0
        self._tool: int | None = None
        self._relative = self._done = False
        self._fed = 0.0

    def take(self, statement: Statement, signals: Sequence[float]) -> None:
        """Read one more line."""
        word, parts = statement.word, statement.parts
        if word == "begin":
            self.begin.append(statement.text)
        elif word == "mode":
            self._relative = True
        elif not self._relative:
            raise statement.misplaced("before M83")
        elif self.repeated:
            self._repeat(statement)
        elif word == "wait" and self.now > 0.0:
            raise statement.error(f"{statement.text!r} would put it out of step with the robot, which waits by time")
        elif word in ("wait", "order"):
            for command in commands_in(statement.text):
                if not command.startswith(PAUSE):
                    self.ordered.append((self.now, command))
                self.now += time_of([command])
        elif word == "tool":
            self._tool = int(parts[0] or parts[1] or 0)
            self.selections.append((self.now, self._tool))
        elif word == "pause":
            self.now += int(parts[0]) * 1e-3
        elif word == "signal":
            self._wait(parts, signals)
        elif word == "repeat":
            if not self._done:
                raise statement.misplaced(f"without {DONE} before it")
            self.repeated, self._loop = "repeat", (int(parts[0]), int(parts[1]))
        elif word == "feed":
            self._feed(statement)
        self._done = word == "done"

    def _repeat(self, statement: Statement) -> None:
        """A repeated line: filament, or the wait until it has moved; the plan has it once."""
        if statement.word != {"repeat": "feed", "feed": "done"}[self.repeated]:
            raise statement.misplaced("within a repetition")
        if statement.word == "feed":
            self._feed(statement)
        self.repeated = {"feed": "feed", "done": ""}[statement.word]

    def _feed(self, statement: Statement) -> None:
        if self._tool is None:
            raise statement.misplaced("before a tool is selected")
        amount, rate = float(statement.parts[0]), float(statement.parts[1]) / 60.0
        if not rate > 0.0:
            raise statement.error(f"{statement.text!r} would never end")
        self.filament[self._tool] = self.filament.get(self._tool, 0.0) + amount * 1e-3
        self._fed += amount * 1e-3
        took = abs(amount) / rate if self.board is None else lasts(self.board, np.array(amount), np.array(rate))
        self._took = float(took)
        total = self.fed[-1][1] if self.fed else 0.0
        self.fed += [(self.now, total), (self.now + self._took, total + amount * 1e-3)]
        self.now += self._took

    def _wait(self, parts: tuple[str, ...], signals: Sequence[float]) -> None:
        code, number, on = f"M{parts[0]}", int(parts[1]), parts[2] == "1"
        longest = None
        if self._loop is not None:
            longest = self._loop[1] * self._took if self._loop[0] == number else np.inf  # it checks another input
        self.steps.append(BoardStep(code, number, on, self.now, self._fed, longest))
        if len(self.steps) <= len(signals):
            self.now = max(self.now, signals[len(self.steps) - 1])
        self._fed, self._loop = 0.0, None


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the program from the plan beyond rounding, in words. InputError for an unknown line."""
    t, board = plan.trajectory, plan.problem.program.board
    found_stretches = stretches(plan) if board.sync == "signal" else ()
    signals = [at for each in found_stretches for at in (each.on, each.off)]
    written = read_gcode(files[FILE], board, signals)
    found = filament_differences(plan, written.filament)
    tools = {each.name: each.tool for each in materials_of(plan.problem)}
    planned = [(event.start, tools[event.material]) for event in t.events if event.kind in SELECTING and tools]
    planned = planned if tools else [(0.0, board.first_tool)]
    if [tool for _, tool in planned] != [tool for _, tool in written.selections]:
        found.append("it selects tools other than the plan's")
    else:
        late = [abs(at - start) for (at, _), (start, _) in zip(written.selections, planned, strict=True)]
        if not max(late, default=0.0) <= LATE + t.dt:
            found.append(f"a tool is selected {max(late):.3g} s off its time")
    ends = busy_ends(t)
    planned_orders = [(due - _sooner(plan, due, line, signals, ends), line) for due, line in _planned_orders(plan)]
    found += order_differences(planned_orders, written.orders, LATE + t.dt, "the board is sent other orders")
    if written.begin != FIRMWARES[board.firmware].begin:
        found.append("it does not begin as the board's firmware requires")
    found += _out_of_step(plan, found_stretches, written.steps)
    found += _fed_otherwise(plan, found_stretches, written.fed)
    if not abs(written.duration - float(t.t[-1] - t.t[0])) <= LATE + t.dt + (RAMPS if board.from_rest else 0.0):
        found.append(f"it lasts {written.duration:.3f} s")
    return found


def _fed_otherwise(plan: Plan, planned: Sequence[Stretch], fed: Sequence[tuple[float, float]]) -> list[str]:
    """Whether filament moves on time: each total must be within what the plan has fed within `around` of that time.

    A prime may come sooner if the board waits for the robot, see `early`.
    """
    if not fed:
        return []  # `filament_differences` reports too little in total
    t, board = plan.trajectory, plan.problem.program.board
    at, total = np.array(fed).T
    clock, feed = t.t - t.t[0], t.feed - t.feed[0]
    rate = 1e3 * float(np.abs(np.diff(feed)).max(initial=0.0)) / t.dt
    around = LATE + 2.0 * t.dt + (ENOUGH * least_time(board, rate) + RAMPS if board.from_rest else TAIL_S)
    around += NEAR if plan.problem.process.extruder.lag > 0.0 else 0.0
    off = _beyond(clock, feed, at, total, around, around)
    primes = [event for event in t.events if event.kind == "prime"] if planned else []
    offs, ends = [0.0, *(each.off for each in planned)], busy_ends(t)
    for event in primes:
        start = event.start - float(t.t[0])
        sooner = early(ends, start, offs[bisect_right(offs, start, 1) - 1])
        since, until = start - sooner - around, start + event.duration
        near = slice(np.searchsorted(at, since, "left"), np.searchsorted(at, until, "right"))
        off[near] = _beyond(clock, feed, at[near], total[near], around, around + sooner)
    worst = int(np.argmax(off))
    if off[worst] <= AMOUNT:
        return []
    return [f"at {at[worst]:.3f} s {off[worst] * 1e3:.3g} mm more or less filament than planned has moved"]


def _beyond(clock: Array, feed: Array, at: Array, total: Array, before: float, behind: float) -> Array:
    """How far (k) [m] totals at times (k) [s] are outside the feed's range `before` to `behind` [s] around them."""
    first = np.searchsorted(clock, at - before, side="left").clip(0, len(clock) - 1)
    last = np.searchsorted(clock, at + behind, side="right").clip(1, len(clock))
    cuts = np.column_stack([first, np.minimum(last, len(clock) - 1)]).ravel()
    low, high = (ufunc.reduceat(feed, cuts)[::2] for ufunc in (np.minimum, np.maximum))
    return np.maximum(np.maximum(low - total, total - high), 0.0)


def _planned_orders(plan: Plan) -> list[tuple[float, str]]:
    return [(due, line) for order in orders(plan) for due, line in order.due if line.startswith("M")]


def _sooner(plan: Plan, due: float, line: str, signals: Sequence[float], ends: Sequence[float]) -> float:
    """By how much [s] the fan is switched earlier, so that the board is ready when the robot arrives."""
    if not _is_fan(plan, line) or not signals or due > signals[-1]:
        return 0.0
    k = int(np.searchsorted(signals, due, side="right"))
    return early(ends, due, signals[k - 1] if k else 0.0) if k % 2 == 0 else 0.0


def _out_of_step(plan: Plan, planned: Sequence[Stretch], steps: Sequence[BoardStep]) -> list[str]:
    """Whether the board waits for the planned signals, is ready for each, and moves each bead's filament in between."""
    board, t = plan.problem.program.board, plan.trajectory
    code = FIRMWARES[board.firmware].wait.split(" ")[0]
    waits = [(code, each.number, on) for each in planned for on in (True, False)]
    if [(step.code, step.number, step.on) for step in steps] != waits:
        return ["it waits for robot signals other than the plan's, or in another order"]
    found, within = [], fed_within(plan, tuple(planned))
    near = LATE + t.dt + (RAMPS if board.from_rest else 0.0)
    behind = NEAR if plan.problem.process.extruder.lag > 0.0 else 0.0
    # in a sample shared with a bead, a prime or retract also carries the bead's filament
    shared = AMOUNT + 2.0 * float(np.abs(np.diff(laid_filament(t))).max(initial=0.0))
    for k, each in enumerate(planned):
        on, off = steps[2 * k], steps[2 * k + 1]
        if on.ready > each.on + near:
            found.append(f"the board is {on.ready - each.on:.3g} s late for the bead that begins at {each.on:.3f} s")
        if off.ready > each.off + near + behind:
            found.append(f"the bead that ends at {each.off:.3f} s is laid {off.ready - each.off:.3g} s too long")
        if abs(off.filament - within[k]) > shared:
            extra = (off.filament - within[k]) * 1e3
            found.append(f"the bead that begins at {each.on:.3f} s gets {extra:+.3g} mm of filament")
        if off.longest is not None and off.longest > 1.5 * LONGER + 1.1 * SLOWER * (each.off - each.on):
            found.append(f"the bead that ends at {each.off:.3f} s may be laid too long, or depends on another output")
    return found


def filament_differences(plan: Plan, filament: Mapping[int | None, float]) -> list[str]:
    """Tools that get more or less filament [m] in total than planned; tool None: no tool is selected."""
    t = plan.trajectory
    planned: dict[int | None, float] = {each.material.tool: each.filament for each in used(plan) if each.beads}
    planned = planned or {plan.problem.program.board.first_tool: float(t.feed[-1] - t.feed[0])}
    off = {tool: filament.get(tool, 0.0) - planned.get(tool, 0.0) for tool in {*planned, *filament}}
    return [
        f"{'no tool' if tool is None else f'tool T{tool}'} gets {amount * 1e3:+.3g} mm of filament"
        for tool, amount in sorted(off.items(), key=str)
        if not abs(amount) <= AMOUNT
    ]


def order_differences(
    planned: Sequence[tuple[float, str | None]], found: Sequence[tuple[float, str]], tolerance: float, others: str
) -> list[str]:
    """Whether a program sends the board the planned lines (time [s], text), within a tolerance [s] of their times.

    others: beginning of the message if it sends other lines.
    """
    if [line for _, line in planned] != [line for _, line in found]:
        return [f"{others} than the plan's, or in another order"]
    late = [(abs(at - due), line) for (at, line), (due, _) in zip(found, planned, strict=True)]
    worst, line = max(late, default=(0.0, ""))
    return [] if worst <= tolerance else [f"{line} is sent {worst:.3g} s off its time"]
