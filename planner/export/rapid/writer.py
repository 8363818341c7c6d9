"""RAPID for ABB controllers (IRC5 and OmniCore): modules with their targets written in the moves.

Targets stand inline in the moves, in one procedure per bead, because that is what an IRC5 takes without trouble: every
line is one statement, so a load error names its line, the operator can put the pointer on any target, and look-ahead
runs through procedure calls without a stop. Arrays of targets would be one statement of thousands of lines each, which
the loader must hold at once, and a loop over them puts logic between fly-by points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from planner.export.moves import Moves, plan_moves
from planner.export.rapid.able import unsaid_in_rapid
from planner.export.rapid.declarations import extruders, frames, header, speeds
from planner.export.rapid.demand import demand_of
from planner.export.rapid.fed import event_samples, laid_filament
from planner.export.rapid.lines import lines_of, table
from planner.export.rapid.modules import NOT_LOADED, batches_of, running, unloading
from planner.export.rapid.notes import note_lines, notes_of
from planner.export.rapid.procedures import procedures_of
from planner.export.rapid.reader import read_rapid_files
from planner.export.rapid.server import END, OPEN, server, server_declarations
from planner.export.rapid.targets import external_degrees, external_text
from planner.export.rapid.text import LONGEST_STRING, comment, module_name, number
from planner.export.rapid.triggers import triggers_of

if TYPE_CHECKING:
    from planner.plan import Plan


def pgf(plan: Plan) -> str:
    """Program file that names the module; load this one on the controller."""
    module = f"\t<Module>{module_name(plan.name)}.mod</Module>\n"
    return f'<?xml version="1.0" encoding="ISO-8859-1" ?>\n<Program>\n{module}</Program>\n'


def rapid(plan: Plan) -> str:
    """Main module of a verified plan, as `rapid_files` has it."""
    return rapid_files(plan)[f"{module_name(plan.name)}.mod"]


def rapid_files(plan: Plan) -> dict[str, str]:
    """All files of the program of a verified plan, by name: ASCII, mm, degrees, targets in the part frame.

    They are the main module, the program file, the modules that a long program loads, and the lines of style `socket`.
    Raises ValueError if the plan is not verified or has no form in RAPID, which is a mistake of the caller's, and
    InputError where the problem asks for a flow, or a line, that cannot be said.
    """
    if not plan.verified:
        raise ValueError("robot code is written for verified plans only")
    if (reason := unsaid_in_rapid(plan)) is not None:
        raise ValueError(reason)
    name, t, spec = module_name(plan.name), plan.trajectory, plan.problem.program
    sends = spec.style == "socket"
    moves = plan_moves(plan, event_samples(t) if sends else None, laid_filament(t) if spec.style != "output" else None)
    lines = lines_of(plan, moves) if sends else ()
    triggers = triggers_of(plan, moves, demand_of(plan, moves) if spec.style == "demand" else None)
    declared, speed_names = speeds(plan, moves)
    start, *others = procedures_of(plan, moves, speed_names, triggers.of, lines)
    batches = batches_of(name, others, spec.module_moves) if len(moves) > spec.module_moves else ()
    here = [start, *(others if not batches else [])]
    calls = [f"        {procedure.name};" for procedure in here] + [s for batch in batches for s in running(batch)]
    top = [f"MODULE {name}", *header(plan), *_sizes(plan, moves)]
    rest = [
        "",
        *frames(plan),
        "",
        *declared,
        "",
        *(f"    VAR triggdata {trigger};" for trigger in triggers.names),
        *(server_declarations() if sends else []),
        "",
        *_main(plan, unloading(batches), calls, speed_names[0], triggers.settings),
        *(NOT_LOADED if batches else []),
        "    ENDPROC",
        "",
        *(line for procedure in here for line in procedure.text),
        *(server(name, len(lines), spec.socket.address, spec.socket.port, extruders(plan).values()) if sends else []),
        "ENDMODULE",
        "",
    ]
    modules = {f"{name}.mod": "\n".join(top + rest)}
    modules |= {f"{module.name}.mod": module.text for batch in batches for module in batch}
    if notes := notes_of(plan, moves, read_rapid_files(modules)):
        modules[f"{name}.mod"] = "\n".join(top + note_lines(notes, plan, moves, modules) + rest)
    return {**modules, f"{name}.pgf": pgf(plan)} | ({f"{name}_lines.csv": table(lines)} if lines else {})


def _sizes(plan: Plan, moves: Moves) -> list[str]:
    """How many moves there are, beside the waypoints that they stand for."""
    waypoints = sum(len(bead.points) for bead in plan.beads)
    laid = int(np.count_nonzero(moves.laid))
    return [comment(f"{len(moves) + 1} moves, {laid} of them along beads, whose toolpath has {waypoints} waypoints")]


def _main(plan: Plan, cleared: list[str], calls: list[str], speed: str, triggers: Sequence[str]) -> list[str]:
    """The procedure main, without its end."""
    names, cell, start = plan.problem.program, plan.cell, plan.trajectory.q[:1]
    na = len(cell.arm)
    joints = ",".join(number(v, 5) for v in np.degrees(start[0, :na]))
    external = external_text(external_degrees(cell, start[:, na:]))[0]
    station = [] if cell.holder_robot is None else [names.station]
    sends = names.style == "socket"
    said = f"{module_name(plan.name)}: {len(plan.beads)} beads"[:LONGEST_STRING]
    off = [f"        SetDO {signal},0;" for signal in extruders(plan).values()]
    off += [f"        SetAO {names.demand_signal},0;"] if names.style == "demand" else []
    return [
        "    PROC main()",
        f'        TPWrite "{said}";',
        *cleared,
        *(f"        ActUnit {name};" for name in station),
        "        SingArea\\Off;",
        "        ConfJ\\On;",
        "        ConfL\\Off;",
        *off,
        *(f"        {setting}" for setting in triggers),
        f"        MoveAbsJ [[{joints}],[{external}]],{speed},fine,{names.tool}\\WObj:={names.work_object};",
        *([f"        {OPEN};"] if sends else []),
        *calls,
        *([f"        {END};"] if sends else []),
        *off,
        *(f"        DeactUnit {name};" for name in station),
        '        TPWrite "Finished";',
    ]
