"""Writer of RAPID for ABB controllers (IRC5 and OmniCore): modules with targets inline in the moves."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices
from planner.base.gcode_lines import time_of
from planner.base.kept import kept
from planner.export.controllers import CONTROLLERS
from planner.export.external import external_written, moving_unit, task_axes
from planner.export.fit import continuous
from planner.export.forecast import judged
from planner.export.in_step import laid_filament
from planner.export.moves import Moves, Wait, corner_tolerance, corners, fit_of, plan_moves, sections
from planner.export.player.play import limited, play
from planner.export.primitives import Poses
from planner.export.program import RobotProgram
from planner.export.rapid.declarations import (
    external_text,
    extruders,
    frames,
    header,
    joints_text,
    speed_numbers,
    speeds,
    tool_of,
    zone_declarations,
)
from planner.export.rapid.extruder import (
    END,
    HEATS,
    LATEST,
    LINE,
    OPEN,
    SETTLE,
    FlowDemand,
    SocketLine,
    demand_of,
    event_samples,
    lines_of,
    server,
    server_declarations,
    table,
)
from planner.export.rapid.multimove import (
    DECLARED,
    OFF,
    ON,
    UNDO,
    WAIT,
    identity,
    second_module,
    second_modules,
    together,
)
from planner.export.rapid.reader import read_rapid_stretches
from planner.export.rapid.text import (
    LONGEST_STRING,
    NOT_LOADED,
    NOTE,
    ZONES,
    Procedure,
    batches_of,
    comment,
    module_name,
    running,
    unloading,
)
from planner.export.support import by_bead
from planner.export.text import number
from planner.plan import TRAVEL

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# Robtargets: poses, configurations and external axes.


def quadrants(q: Array) -> NDArray[np.intp]:
    """cf1, cf4, cf6 (m, 3): quarter turns of joints 1, 4 and 6 in postures of the arm's own joints (m, >= 6) [rad]."""
    return np.floor(np.round(np.degrees(q[:, [0, 3, 5]]) / 90.0, 9)).astype(np.intp)


def targets(plan: Plan, moves: Moves) -> list[str]:
    """Robtargets of the first sample and of each move."""
    return _robtargets(plan, moves.targets, moves.q, np.concatenate([[0], moves.sample]))


def via_targets(plan: Plan, moves: Moves) -> list[str]:
    """Robtargets of the via points of arcs; those of other moves are unused."""
    return _robtargets(plan, moves.via, moves.q[1:], moves.sample)


def _robtargets(plan: Plan, poses: Poses, q: Array, sample: Indices) -> list[str]:
    """Robtargets of poses (k), with the configurations of postures q (k, n) and samples (k)."""
    quat = continuous(poses.quat)[:, [3, 0, 1, 2]]
    numbers = np.column_stack(
        [
            np.round(poses.position * 1e3, 3) + 0.0,
            np.round(quat, 7) + 0.0,
            quadrants(q[:, plan.cell.own]),
            plan.trajectory.branch[sample],
        ]
    )
    external = external_text(_own_axes(plan, poses.station))
    pattern = "[[%.3f,%.3f,%.3f],[%.7f,%.7f,%.7f,%.7f],[%d,%d,%d,%d],[%s]]"
    return [pattern % (*row, ext) for row, ext in zip(numbers.tolist(), external, strict=True)]


def _own_axes(plan: Plan, station: Array) -> Array:
    """The external axes (m, k) [deg, mm] of this task, from all moving axes (m, f) other than the arm's."""
    return external_written(plan.cell, station)[:, : len(task_axes(plan.cell))]


# ----------------------------------------------------------------------------------------------------
# Triggers: outputs that are switched during motion.


@dataclass(frozen=True)
class Triggers:
    """Triggers of a program: their names, the statements that set them, and move → names of its triggers, in order."""

    names: tuple[str, ...]
    settings: tuple[str, ...]
    of: dict[int, tuple[str, ...]]


def triggers_of(plan: Plan, moves: Moves, demand: FlowDemand | None) -> Triggers:
    """Triggers of a plan: digital outputs on and off at the ends of beads and, with a demand, the next move's flow."""
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
    own = by_bead(plan, list(extruders(plan)))
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


def _asking(moves: Moves, demand: FlowDemand) -> dict[int, list[tuple[int, bool]]]:
    """Move → (percent of the largest flow, whether at its start) that it sets; at its end, for the next move."""
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


# ----------------------------------------------------------------------------------------------------
# Procedures: the start, one for each bead with the approach to it, and the way home.


def procedures_of(
    plan: Plan,
    moves: Moves,
    speeds: list[str],
    triggers: dict[int, tuple[str, ...]],
    lines: tuple[SocketLine, ...] = (),
    change: int = 0,
    last: bool = True,
) -> list[Procedure]:
    """All procedures with moves, in calling order; speeds: names for the way to the start and for each move.

    change: number of tool changes before; last: no tool change follows
    """
    places, frames = targets(plan, moves), f"{tool_of(plan)}\\WObj:={plan.problem.program.work_object};"
    sent, alone = _numbered(lines), plan.cell.second_arm is None
    about = "The planned start as a target: the robot must not move here, if tool and work object are right."
    start = f"        MoveJ {places[0]}{'' if alone else identity(-1)},{speeds[0]},fine,{frames}"
    there = _resting(moves.waits.get(-1, ()), sent.get(-1, ()))
    found = [Procedure("Start", (comment(about, 8),), ((start, *there),), True)]
    if change:
        again = (comment(f"From here on with {tool_of(plan)}.", 8), comment(about, 8), _absolute(plan, speeds[0]))
        found = [Procedure(f"Change{change}", again, ((start, *there),), True)]
    linear, circular, fine = moves.linear.tolist(), moves.circular.tolist(), moves.fine.tolist()
    zones, vias = zones_of(plan, moves), via_targets(plan, moves)

    def step(i: int) -> tuple[str, ...]:
        own = triggers.get(i, ())
        word = ("Trigg" if own else "Move") + ("C" if circular[i] else "L" if linear[i] or own else "J")
        via = f"{vias[i]}," if circular[i] else ""
        what = "".join(f"\\T{k}:={name}" if k > 1 else f",{name}" for k, name in enumerate(own, 1))
        place = places[i + 1] + ("" if alone else identity(i))
        move = f"        {word} {via}{place},{speeds[i + 1]}{what},{zones[i]},{frames}"
        return (move, *_resting(moves.waits.get(i, ()), sent.get(i, ())))

    for section in sections(plan, moves):
        home = "Finish" if last else f"Home{change + 1}"
        name = f"Bead{section.number:04d}" if section.number else home
        words = (comment(section.about, 8),) if section.about else ()
        found.append(Procedure(name, words, tuple(map(step, section.moves)), fine[section.moves[-1]]))
    return found


def _absolute(plan: Plan, speed: str) -> str:
    """The move to the joints of the start."""
    cell, start = plan.cell, plan.trajectory.q[:1]
    joints = joints_text(np.degrees(start[:, cell.own]))[0]
    external = external_text(_own_axes(plan, start[:, cell.besides]))[0]
    # a work object that another task moves is only for synchronised moves
    frames = tool_of(plan) + ("" if cell.second_arm is not None else f"\\WObj:={plan.problem.program.work_object}")
    return f"        MoveAbsJ [[{joints}],[{external}]],{speed},fine,{frames};"


def zones_of(plan: Plan, moves: Moves) -> list[str]:
    """Zone of each move: the smallest that covers half of its line and of the next one, if that cuts the corner within
    its tolerance; otherwise the largest that does.

    Zones that meet leave no trace of the corner in the speed, and a controller limits those that reach further to half
    of a move (measured on an IRB 6640: z1 among lines of 11 mm costs a third of the speed). Between a joint move and a
    line the zone is at most z0: a joint move does not end in the direction of its chord, and a bead may begin or end
    there. No zone is larger than the problem allows. The smallest is zon0_1, or zon0_02 where that would exceed the
    widest tolerance.
    """
    reach, bend = corners(moves.segments)
    half, bend = 0.5 * reach[1:], bend[1:]
    tolerance, program = corner_tolerance(plan, moves), plan.problem.program
    most = tolerance / np.maximum(np.tan(0.25 * bend), 1e-9)
    sizes, names = zip(*sorted((radius, name) for name, radius in ZONES.items() if radius), strict=True)
    least = names.index("zon0_1")
    covering = np.clip(np.searchsorted(sizes, half * (1.0 - 1e-9)), least, len(sizes) - 1)
    within = np.maximum(np.searchsorted(sizes, most, side="right") - 1, least)
    usual = np.where(half <= most, covering, np.minimum(within, covering))
    usual = np.where((names.index("z0") > usual) & (most >= np.minimum(half, ZONES["z0"])), names.index("z0"), usual)
    mixed = np.append(moves.linear[1:], moves.linear[-1]) != moves.linear
    usual = np.where(mixed, np.minimum(usual, names.index("z0")), usual)
    usual = np.minimum(usual, names.index(program.largest_zone))
    cut = 0.5 * np.minimum(half, ZONES["zon0_1"]) * np.sin(0.5 * bend)  # by a parabola, as in the read-back
    deep = (usual == least) & (cut > program.widening * tolerance)
    usual = np.where(deep, names.index("zon0_02"), usual)
    return ["fine" if fine else names[k] for fine, k in zip(moves.fine.tolist(), usual.tolist(), strict=True)]


def _numbered(lines: Sequence[SocketLine]) -> dict[int, list[tuple[int, SocketLine]]]:
    """Move → the lines sent after it, with their numbers."""
    out: dict[int, list[tuple[int, SocketLine]]] = {}
    for n, line in enumerate(lines, 1):
        out.setdefault(line.move, []).append((n, line))
    return out


def _resting(waits: Sequence[Wait], sent: Sequence[tuple[int, SocketLine]]) -> list[str]:
    """Statements after a move: waits, each with a comment that says why, and lines sent meanwhile."""
    steps: list[tuple[float, int, list[str]]] = []
    clock = 0.0
    for wait in waits:
        steps.append((clock, 0, [comment(wait.why, 8)] if wait.why else []))
        clock += round(wait.time, 3)
        steps.append((clock, -1, []))
    settle = f"        {SETTLE} {LATEST};"
    heats = False
    over: float | None = None  # when the board has finished the lines that it acknowledges when done
    for n, line in sent:
        before = [settle] if heats and not line.text.startswith(HEATS) else []
        heats = line.text.startswith(HEATS)
        at, pauses = min(line.after, clock), time_of([line.text])
        steps.append((at, 1, [*before, f'        {LINE} {n},"{line.text}";']))
        if pauses:
            over = min(max(at, over or 0.0) + pauses, clock)
        elif heats:
            over = clock
    if over is not None:
        steps.append((over, 2, [settle]))
    out: list[str] = []
    now = 0.0
    for at, _, statements in sorted(steps, key=lambda step: step[:2]):
        pause = round(at - now, 3)
        out += [f"        WaitTime {pause:.3f};"] if pause > 0.0 else []
        out += statements
        now += pause
    return out


# ----------------------------------------------------------------------------------------------------
# Notes in the header: what users should know before running a program, each with the first place it applies to.

_MOVE = re.compile(r" {8}(?:MoveJ|MoveL|MoveC|TriggL|TriggC) ")


@dataclass(frozen=True)
class ProgramNote:
    """A note, the first move of the program that it applies to, from 0, and that move's bead, or TRAVEL."""

    words: str
    move: int
    bead: int = TRAVEL


def all_notes(
    parts: Sequence[Plan], all_moves: Sequence[Moves], programs: Sequence[RobotProgram]
) -> tuple[ProgramNote, ...]:
    """Notes on a program that was read back, stretch by stretch; moves count from its beginning."""
    out, before = [], 0
    for plan, moves, program in zip(parts, all_moves, programs, strict=True):
        for note in notes_of(plan, moves, program):
            bead = int(plan.trajectory.bead[moves.sample[max(note.move - 1, 0)]])
            out.append(replace(note, move=before + note.move, bead=bead))
        before += len(moves) + 1
    return tuple(out)


def notes_of(plan: Plan, moves: Moves, program: RobotProgram) -> tuple[ProgramNote, ...]:
    """All notes on a stretch of a program that was read back."""
    return tuple(note for note in (*_fit(plan, moves), _sends(program), *_paces(plan, program)) if note is not None)


def _fit(plan: Plan, moves: Moves) -> list[ProgramNote]:
    """Moves on beads that take less than the least time, and those that leave the bead more than usual to meet it."""
    spec, found = plan.problem.program, fit_of(plan, moves)
    notes = []
    least = f"{1e3 * spec.least_time:g} ms"
    if len(found.short):
        words = f"{len(found.short)} of the moves on beads take less than {least}, the shortest"
        notes.append(ProgramNote(f"{words} {1e3 * found.shortest:.1f} ms", int(found.short[0]) + 1))
    if len(found.wide):
        off = f"{1e3 * found.off:.3f} mm and {np.degrees(found.turned):.2f} deg"
        words = f"{len(found.wide)} moves leave their bead by up to {off}, so as to take {least}"
        notes.append(ProgramNote(words, int(found.wide[0]) + 1))
    return notes


def _sends(program: RobotProgram) -> ProgramNote | None:
    flown = [move for move in sorted(program.sends) if not program.fine[move]]
    if not flown:
        return None
    count = sum(len(program.sends[move]) for move in flown)
    return ProgramNote(f"{count} lines are sent at fly-by points, as early as the controller reads ahead", flown[0])


def _paces(plan: Plan, program: RobotProgram) -> list[ProgramNote]:
    controller = CONTROLLERS["rapid"].measured(plan.cell.arm_robot.controller)
    played = play(program, plan.cell, controller.motion)
    told = judged(program, played, controller)
    slow = [ProgramNote(each.words, each.first) for each in limited(program, played)]
    return [*slow, *(ProgramNote(warning, told.nearest) for warning in told.warnings)]


def note_lines(notes: tuple[ProgramNote, ...], files: Mapping[str, str]) -> list[str]:
    """Two comments for each note, for the header of the first of the files, in which they are not yet included."""
    main, places, wanted = next(iter(files)), {}, {note.move for note in notes}
    k = 0
    for name, text in files.items():
        for line, statement in enumerate(text.split("\n"), 1):
            if _MOVE.match(statement):
                if k in wanted:
                    places[k] = f"line {line + 2 * len(notes) * (name == main)} of {name}"
                k += 1
    out = []
    for note in notes:
        where = f"bead {note.bead}" if note.bead >= 0 else "between beads"
        out += [comment(NOTE + note.words), comment(f"  first {where}, {places[note.move]}")]
    return out


# ----------------------------------------------------------------------------------------------------
# The program. Targets are inline in the moves, in one procedure per bead, because an IRC5 handles that without trouble:
# every line is one statement, so a load error names its line, the operator can put the pointer on any target, and
# look-ahead continues through procedure calls without a stop. Each array of targets would be a single statement of
# thousands of lines, which the loader must hold at once, and a loop over it would put logic between fly-by points.


def pgf(module: str) -> str:
    """Program file that names a module; this is the file to load on the controller."""
    return f'<?xml version="1.0" encoding="ISO-8859-1" ?>\n<Program>\n\t<Module>{module}.mod</Module>\n</Program>\n'


def rapid(plan: Plan) -> str:
    """Main module of a verified plan, as in `rapid_files`."""
    return rapid_files(plan)[f"{module_name(plan.name)}.mod"]


@kept
def rapid_moves(plan: Plan) -> Moves:
    """The moves of a plan's RAPID program."""
    t, style = plan.trajectory, plan.problem.program.style
    also, fed = event_samples(t) if style == "socket" else None, laid_filament(t) if style != "output" else None
    return plan_moves(plan, also, fed, arcs=True)


def rapid_files(plan: Plan) -> dict[str, str]:
    """All files of the program of a verified plan, by name: ASCII, mm, degrees, targets in the part frame.

    They are the main module, the program file, the modules that a long program loads, and the lines of style `socket`;
    if a second arm moves the part, also its own modules and program file, see multimove.py.
    Raises InputError if the problem requires a flow, or a line, that RAPID cannot express.
    """
    name, spec, parts = module_name(plan.name), plan.problem.program, plan.stretches
    all_moves = [rapid_moves(part) for part in parts]
    moves = all_moves[0]
    sends, both = spec.style == "socket", plan.cell.second_arm is not None
    lines = lines_of(plan, moves) if sends else ()
    demand = demand_of(plan, moves) if spec.style == "demand" else None
    triggers = [triggers_of(part, each, demand) for part, each in zip(parts, all_moves, strict=True)]
    numbers = [speed_numbers(part, each) for part, each in zip(parts, all_moves, strict=True)]
    declared, speed_names = speeds(np.concatenate(numbers))
    of_each = iter(speed_names)
    start, *others = [
        procedure
        for k, (part, each) in enumerate(zip(parts, all_moves, strict=True))
        for procedure in procedures_of(
            part, each, list(islice(of_each, len(numbers[k]))), triggers[k].of, lines, k, part is parts[-1]
        )
    ]
    batches = batches_of(name, others, spec.module_moves) if sum(map(len, all_moves)) > spec.module_moves else ()
    here = [start, *(others if not batches else [])]
    calls = [f"        {procedure.name};" for procedure in here] + [s for batch in batches for s in running(batch)]
    told = [comment(text) for text in together(plan)] if both else []
    top = [f"MODULE {name}", *header(plan), *told, *_sizes(plan, all_moves)]
    rest = [
        "",
        *frames(plan),
        *(DECLARED if both else []),
        "",
        *declared,
        *zone_declarations([start, *others]),
        "",
        *(f"    VAR triggdata {trigger};" for trigger in triggers[0].names),
        *(server_declarations() if sends else []),
        "",
        *_main(plan, unloading(batches), calls, speed_names[0], triggers[0].settings),
        *(NOT_LOADED if batches else []),
        *(UNDO if both else []),
        "    ENDPROC",
        "",
        *(line for procedure in here for line in procedure.text),
        *(served(plan, len(lines)) if sends else []),
        "ENDMODULE",
        "",
    ]
    modules = {f"{name}.mod": "\n".join(top + rest)}
    modules |= {f"{module.name}.mod": module.text for batch in batches for module in batch}
    second = second_modules(plan, moves, [start, *others], zones_of(plan, moves)) if both else {}
    if notes := all_notes(parts, all_moves, read_rapid_stretches({**modules, **second})):
        modules[f"{name}.mod"] = "\n".join(top + note_lines(notes, modules) + rest)
    programs = {f"{each}.pgf": pgf(each) for each in (name, *([second_module(plan)] if both else []))}
    return {**modules, **second, **programs} | ({f"{name}_lines.csv": table(lines)} if lines else {})


def served(plan: Plan, lines: int) -> list[str]:
    """The procedures that serve the socket of a program that sends `lines` lines."""
    socket, outputs = plan.problem.program.socket, extruders(plan).values()
    alone = plan.cell.second_arm is None
    return server(module_name(plan.name), lines, socket.address, socket.port, outputs, alone)


def _sizes(plan: Plan, all_moves: Sequence[Moves]) -> list[str]:
    """A comment with the number of moves, and of the waypoints that they stand for."""
    waypoints = sum(len(bead.points) for bead in plan.beads)
    count, laid = (sum(len(each) + 1 for each in all_moves), sum(int(each.laid.sum()) for each in all_moves))
    return [comment(f"{count} moves, {laid} of them along beads, whose toolpath has {waypoints} waypoints")]


def _main(plan: Plan, cleared: list[str], calls: list[str], speed: str, triggers: Sequence[str]) -> list[str]:
    """The procedure main, without its end."""
    names, cell = plan.problem.program, plan.cell
    both = cell.second_arm is not None
    station = [] if cell.station is None or both else [moving_unit(plan)]
    sends = names.style == "socket"
    title = f"{module_name(plan.name)}: {len(plan.beads)} beads"[:LONGEST_STRING]
    off = [f"        SetDO {signal},0;" for signal in extruders(plan).values()]
    off += [f"        SetAO {names.demand_signal},0;"] if names.style == "demand" else []
    return [
        "    PROC main()",
        f'        TPWrite "{title}";',
        *cleared,
        *(f"        ActUnit {name};" for name in station),
        "        SingArea\\Off;",
        "        ConfJ\\On;",
        "        ConfL\\Off;",
        "        CirPathMode\\ObjectFrame;",
        *off,
        *(f"        {setting}" for setting in triggers),
        *([WAIT] if both else []),
        _absolute(plan.stretches[0], speed),
        *([ON] if both else []),
        *([f"        {OPEN};"] if sends else []),
        *calls,
        *([f"        {END};"] if sends else []),
        *([OFF] if both else []),
        *off,
        *(f"        DeactUnit {name};" for name in station),
        '        TPWrite "Finished";',
    ]
