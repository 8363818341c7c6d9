"""RAPID for ABB controllers (IRC5 and OmniCore): one module with its targets written in the moves.

Targets stand inline in the moves, in one procedure per bead, because that is what an IRC5 takes without trouble: every
line is one statement, so a load error names its line, the operator can put the pointer on any target, and look-ahead
runs through procedure calls without a stop. Arrays of targets would be one statement of thousands of lines each, which
the loader must hold at once, and a loop over them puts logic between fly-by points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from planner.export.moves import Moves, deposits, plan_moves
from planner.export.rapid.able import unsaid_in_rapid
from planner.export.rapid.declarations import extruders, frames, header, speeds
from planner.export.rapid.lines import HEATS, WAITS, Line, event_samples, lines_of, table
from planner.export.rapid.server import END, LATEST, LINE, OPEN, SETTLE, server, server_declarations
from planner.export.rapid.targets import external_degrees, external_text, targets
from planner.export.rapid.text import LONGEST_STRING, comment, module_name, number
from planner.export.rests import Wait
from planner.materials import materials_of

if TYPE_CHECKING:
    from planner.plan import Plan


def pgf(plan: Plan) -> str:
    """Program file that names the module; load this one on the controller."""
    module = f"\t<Module>{module_name(plan.name)}.mod</Module>\n"
    return f'<?xml version="1.0" encoding="ISO-8859-1" ?>\n<Program>\n{module}</Program>\n'


def rapid_files(plan: Plan) -> dict[str, str]:
    """All files of the program of a verified plan, by name: module, program file, and the lines of style `socket`.

    Raises ValueError if the plan is not verified or has no form in RAPID: that is a mistake of the caller's.
    """
    module, lines = _module(plan)
    name = module_name(plan.name)
    files = {f"{name}.mod": module, f"{name}.pgf": pgf(plan)}
    return files | ({f"{name}_lines.csv": table(lines)} if lines else {})


def rapid(plan: Plan) -> str:
    """RAPID module of a verified plan (ASCII, mm, degrees, targets in the part frame), as `rapid_files` has it."""
    return _module(plan)[0]


def _module(plan: Plan) -> tuple[str, tuple[Line, ...]]:
    """The module, and the lines that it sends."""
    if not plan.verified:
        raise ValueError("robot code is written for verified plans only")
    if (reason := unsaid_in_rapid(plan)) is not None:
        raise ValueError(reason)
    names = plan.problem.program
    sends = names.style == "socket"
    moves = plan_moves(plan, event_samples(plan.trajectory) if sends else None)
    lines = lines_of(plan, moves) if sends else ()
    declared, speed_names = speeds(plan, moves)
    procedures, calls = _procedures(plan, moves, speed_names, lines)
    name, outputs = module_name(plan.name), extruders(plan)
    text = [
        f"MODULE {name}",
        *header(plan),
        "",
        *frames(plan),
        "",
        *declared,
        "",
        *(f"    VAR triggdata {trigger}{k};" for k in outputs for trigger in ("trgOn", "trgOff", "trgOnStart")),
        *(server_declarations() if sends else []),
        "",
        *_main(plan, calls, speed_names[0], sends),
        *procedures,
        *(server(name, len(lines), names.socket.address, names.socket.port, outputs.values()) if sends else []),
        "ENDMODULE",
        "",
    ]
    return "\n".join(text), lines


def _main(plan: Plan, calls: list[str], speed: str, sends: bool) -> list[str]:
    names, cell, start = plan.problem.program, plan.cell, plan.trajectory.q[:1]
    na = len(cell.arm)
    joints = ",".join(number(v, 5) for v in np.degrees(start[0, :na]))
    external = external_text(external_degrees(cell, start[:, na:]))[0]
    station = [] if cell.holder_robot is None else [names.station]
    outputs = extruders(plan)
    said = f"{module_name(plan.name)}: {len(plan.beads)} beads"[:LONGEST_STRING]
    return [
        "    PROC main()",
        f'        TPWrite "{said}";',
        *(f"        ActUnit {name};" for name in station),
        "        SingArea\\Off;",
        "        ConfJ\\On;",
        "        ConfL\\Off;",
        *(f"        SetDO {signal},0;" for signal in outputs.values()),
        *(
            f"        TriggIO {name}{k},0{where}\\DOp:={signal},{value};"
            for k, signal in outputs.items()
            for name, where, value in (("trgOn", "", 1), ("trgOff", "", 0), ("trgOnStart", "\\Start", 1))
        ),
        f"        MoveAbsJ [[{joints}],[{external}]],{speed},fine,{names.tool}\\WObj:={names.work_object};",
        *([f"        {OPEN};"] if sends else []),
        *(f"        {call};" for call in calls),
        *([f"        {END};"] if sends else []),
        *(f"        SetDO {signal},0;" for signal in outputs.values()),
        *(f"        DeactUnit {name};" for name in station),
        '        TPWrite "Finished";',
        "    ENDPROC",
        "",
    ]


def _endings(plan: Plan) -> list[str]:
    """What the triggers of each bead end with."""
    names = [each.name for each in materials_of(plan.problem)]
    endings = list(extruders(plan))
    return [endings[names.index(bead.material)] if names else endings[0] for bead in plan.toolpath.beads]


def _procedures(plan: Plan, moves: Moves, speeds: list[str], lines: tuple[Line, ...]) -> tuple[list[str], list[str]]:
    """All procedures with moves, and their names in the order of calling."""
    names, places = plan.problem.program, targets(plan, moves)
    frames = f"{names.tool}\\WObj:={names.work_object};"
    first, last = deposits(plan.trajectory)
    sent = _numbered(lines)
    out = [
        "    PROC Start()",
        comment("The planned start as a target: the robot must not move here, if tool and work object are right.", 8),
        f"        MoveJ {places[0]},{speeds[0]},fine,{frames}",
        *_resting(moves.waits.get(-1, ()), sent.get(-1, ())),
        "    ENDPROC",
        "",
    ]
    calls = ["Start"]
    linear, fine = moves.linear.tolist(), moves.fine.tolist()
    on_end, on_start, off_end = moves.on_end.tolist(), moves.on_start.tolist(), moves.off_end.tolist()
    endings, own = _endings(plan), plan.trajectory.bead.tolist()
    ends = moves.sample.tolist()
    bounds = np.searchsorted(moves.after, np.arange(len(first) + 2))
    for k, (a, b) in enumerate(zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)):
        if a == b:
            continue
        calls.append(f"Bead{plan.first_bead + k + 1:04d}" if k < len(first) else "Finish")
        out.append(f"    PROC {calls[-1]}()")
        if k < len(first):
            out.append(_about(plan, int(first[k]), int(last[k])))
        for i in range(a, b):
            triggers = [
                name + endings[own[at]]
                for name, used, at in (
                    ("trgOnStart", on_start[i], ends[i - 1] if i else 0),
                    ("trgOn", on_end[i], ends[i]),
                    ("trgOff", off_end[i], ends[i]),
                )
                if used
            ]
            zone = "fine" if fine[i] else "z0" if linear[i] else "z1"
            word = "TriggL" if triggers else "MoveL" if linear[i] else "MoveJ"
            what = "," + "\\T2:=".join(triggers) if triggers else ""
            out.append(f"        {word} {places[i + 1]},{speeds[i + 1]}{what},{zone},{frames}")
            out += _resting(moves.waits.get(i, ()), sent.get(i, ()))
        out += ["    ENDPROC", ""]
    return out, calls


def _numbered(lines: Sequence[Line]) -> dict[int, list[tuple[int, Line]]]:
    """Move → the lines that are sent behind it, with their numbers."""
    out: dict[int, list[tuple[int, Line]]] = {}
    for n, line in enumerate(lines, 1):
        out.setdefault(line.move, []).append((n, line))
    return out


def _resting(waits: Sequence[Wait], sent: Sequence[tuple[int, Line]]) -> list[str]:
    """Statements behind a move: what the robot stands still for, each with a comment that says why, and what is sent."""
    steps: list[tuple[float, int, list[str]]] = []
    clock = 0.0
    for wait in waits:
        steps.append((clock, 0, [comment(wait.why, 8)] if wait.why else []))
        clock += round(wait.time, 3)
        steps.append((clock, -1, []))
    settle = f"        {SETTLE} {LATEST};"
    heats = False
    for n, line in sent:
        before = [settle] if heats and not line.text.startswith(HEATS) else []
        heats = line.text.startswith(HEATS)
        steps.append((min(line.after, clock), 1, [*before, f'        {LINE} {n},"{line.text}";']))
    if any(line.text.startswith(WAITS) for _, line in sent):
        steps.append((clock, 2, [settle]))
    out: list[str] = []
    now = 0.0
    for at, _, statements in sorted(steps, key=lambda step: step[:2]):
        pause = round(at - now, 3)
        out += [f"        WaitTime {pause:.3f};"] if pause > 0.0 else []
        out += statements
        now += pause
    return out


def _about(plan: Plan, first: int, last: int) -> str:
    """Comment on what a procedure prints between two samples."""
    t = plan.trajectory
    bead = t.bead[first]
    of = plan.toolpath.beads[bead].material
    length = f"{1e3 * (t.s[last] - t.s[first]):.1f} mm" + (f" of {of}" if of else "")
    return comment(f"Bead {bead}, layer {t.layer[first]}: {length}", 8)
