"""RAPID for ABB controllers (IRC5 and OmniCore): one module with its targets written in the moves.

Targets stand inline in the moves, in one procedure per bead, because that is what an IRC5 takes without trouble: every
line is one statement, so a load error names its line, the operator can put the pointer on any target, and look-ahead
runs through procedure calls without a stop. Arrays of targets would be one statement of thousands of lines each, which
the loader must hold at once, and a loop over them puts logic between fly-by points.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.moves import Moves, deposits, plan_moves
from planner.export.rapid.able import unsaid_in_rapid
from planner.export.rests import Wait
from planner.export.rotations import continuous, from_matrix
from planner.materials import materials_of
from planner.plan import RAPID_EXTERNAL_AXES

if TYPE_CHECKING:
    from planner.cell import Cell
    from planner.plan import Plan

Array = NDArray[np.float64]

# ABB, RAPID kernel reference, reserved words; and the names of our own procedures
RESERVED = """ALIAS AND BACKWARD CASE CONNECT CONST DEFAULT DIV DO ELSE ELSEIF ENDFOR ENDFUNC ENDIF ENDMODULE ENDPROC ENDRECORD
    ENDTEST ENDTRAP ENDWHILE ERROR EXIT FALSE FOR FROM FUNC GOTO IF INOUT LOCAL MOD MODULE NOSTEPIN NOT NOVIEW OR PERS
    PROC RAISE READONLY RECORD RETRY RETURN STEP SYSMODULE TASK TEST THEN TO TRAP TRUE TRYNEXT UNDO VAR VIEWONLY WHILE
    WITH XOR BASE USER MAIN START FINISH"""
LONGEST_STRING = 80
LONGEST_NAME = 32
LONGEST_COMMENT = 100
UNUSED = "9E9"
HEAD_ROOM = 1.5  # of reorientation and axis speeds over what the plan needs, so that the tip's speed alone governs
SECOND_ARM = (
    "NOTE: what holds the part is an arm. A controller runs two arms as two tasks (MultiMove), not as external axes:",
    "this program says what both arms do, but runs only where the second one is set up as a mechanical unit of this",
    "task, as in a simulation. On two real arms, start from trajectory.csv.",
)
TOOL_LOAD = "[1,[0,0,50],[1,0,0,0],0,0,0]"


def module_name(name: str) -> str:
    """CamelCase module name, at most 32 letters and digits, of a problem's name."""
    words = re.findall(r"[A-Za-z0-9]+", name)
    joined = "".join(word[0].upper() + word[1:] for word in words)
    # capitals and small letters are one to RAPID: a problem named "test" would open a TEST statement
    taken = joined.upper() in RESERVED.split() or re.fullmatch(r"(?i)(bead|vel|trg)\w*", joined)
    whole = "Print" + joined if taken or not joined[:1].isalpha() else joined
    resumed = re.search(r"From\d+$", whole)  # which tells programs of one problem apart
    tail = resumed[0] if resumed else ""
    return whole[: LONGEST_NAME - len(tail)] + tail if len(whole) > LONGEST_NAME else whole


def pgf(plan: Plan) -> str:
    """Program file that names the module; load this one on the controller."""
    module = f"\t<Module>{module_name(plan.name)}.mod</Module>\n"
    return f'<?xml version="1.0" encoding="ISO-8859-1" ?>\n<Program>\n{module}</Program>\n'


def rapid(plan: Plan) -> str:
    """RAPID module of a verified plan (ASCII, mm, degrees, targets in the part frame).

    Raises ValueError if the plan is not verified or has no form in RAPID: that is a mistake of the caller's.
    """
    if not plan.verified:
        raise ValueError("robot code is written for verified plans only")
    if (reason := unsaid_in_rapid(plan)) is not None:
        raise ValueError(reason)
    moves = plan_moves(plan)
    speeds, speed_names = _speeds(plan, moves)
    procedures, calls = _procedures(plan, moves, speed_names)
    lines = [
        f"MODULE {module_name(plan.name)}",
        *_header(plan),
        "",
        *_frames(plan),
        "",
        *speeds,
        "",
        *(f"    VAR triggdata {name}{k};" for k in _extruders(plan) for name in ("trgOn", "trgOff", "trgOnStart")),
        "",
        *_main(plan, calls, speed_names[0]),
        *procedures,
        "ENDMODULE",
        "",
    ]
    return "\n".join(lines)


def number(value: float, decimals: int) -> str:
    """Fixed-point number as RAPID reads it; never minus nought."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def external_degrees(cell: Cell, external: Array) -> Array:
    """The station's axes (m, k) [deg] in the robot's own order: free ones from (m, f) [rad], held ones as held."""
    if cell.holder_robot is None:
        return np.empty((len(external), 0))
    free = list(cell.holder.names)
    columns = [
        external[:, free.index(name)] if name in free else np.full(len(external), cell.held[name])
        for name in list(cell.holder_robot.model.names)[1:]
    ]
    out: Array = np.degrees(np.column_stack(columns))
    return out


def quadrants(q: Array) -> NDArray[np.intp]:
    """cf1, cf4, cf6 (m, 3): the quarter turns of joints 1, 4 and 6 of postures (m, >= 6) [rad]."""
    return np.floor(np.round(np.degrees(q[:, [0, 3, 5]]) / 90.0, 9)).astype(np.intp)


def _header(plan: Plan) -> list[str]:
    m = plan.metrics
    size = f"{len(plan.beads)} beads in {plan.layers} layers"
    texts = [
        f"Problem {plan.problem.name}, strategy {plan.strategy}",
        ", ".join(f"{name} {version}" for name, version in sorted(plan.versions.items())),
        f"{size}, {m['deposited_length_mm']:.1f} mm deposited, {m['print_time_s']:.1f} s",
        *([f"Resumes at bead {plan.first_bead}: those before it must be there"] if plan.first_bead else []),
        "Verified before it was written:",
        *(f"  {c.name}: {c.worst:.6g} {c.unit} (limit {c.limit:.6g})" for c in plan.checks),
    ]
    for each in materials_of(plan.problem):
        texts.append(f"Material {each.name}: tool T{each.tool} of the extruder's board, output {each.signal}")
    return [comment(text) for text in texts]


def comment(text: str, indent: int = 4) -> str:
    """One comment line, ASCII, of bounded length."""
    text = re.sub(r"[^\x20-\x7e]", "?", text)
    return f"{'':{indent}}! {text[:LONGEST_COMMENT].rstrip()}"


def _pose(T: Array) -> str:
    p = ",".join(number(v, 3) for v in T[:3, 3] * 1e3)
    x, y, z, w = from_matrix(T[None, :3, :3])[0]
    return f"[[{p}],[{','.join(number(v, 7) for v in (w, x, y, z))}]]"


def _frames(plan: Plan) -> list[str]:
    """Tool and work object, and what the controller's own configuration must say for them to be right."""
    names, cell = plan.problem.program, plan.cell
    lines = [
        comment("The load below is a placeholder: identify it on the robot before the first run."),
        f"    PERS tooldata {names.tool}:=[TRUE,{_pose(cell.T_flange_nozzle)},{TOOL_LOAD}];",
        comment("Poses in the world that the controller's configuration must have. The robot's base:"),
        comment("  " + _pose(cell.T_world_base)),
    ]
    identity, on_plate = _pose(np.eye(4)), _pose(cell.T_plate_part)
    if cell.holder_robot is None:
        frames = f'TRUE,"",{_pose(cell.T_world_holder)},{identity}'
    else:
        axes = [
            f"eax_{letter} {name}" + (" (held)" if name in cell.held else "")
            for letter, name in zip("abcdef", cell.holder_robot.joint_names, strict=False)
        ]
        lines += [
            comment(f"The base of station {names.station}:"),
            comment("  " + _pose(cell.T_world_holder_base)),
            comment(f"Its axes: {', '.join(axes[:3])}."),
            *([comment(f"  {', '.join(axes[3:])}.")] if len(axes) > 3 else []),
            comment("Its user frame comes from the system parameters; the part frame stands in it, on the plate."),
        ]
        if cell.holder_robot.inverse is not None:
            lines += [comment(text) for text in SECOND_ARM]
        # ABB, RAPID reference, wobjdata: with ufprog FALSE the system parameters define the user frame
        frames = f'FALSE,"{names.station}",{identity},{on_plate}'
    return [*lines, f"    PERS wobjdata {names.work_object}:=[FALSE,{frames}];"]


def _quantised(speed: Array) -> Array:
    """Speeds to 1 mm/s, below 10 mm/s to 0.1 mm/s, never 0 [mm/s]."""
    return np.where(speed >= 9.95, np.round(speed), np.maximum(np.round(speed, 1), 0.1))


def _speeds(plan: Plan, moves: Moves) -> tuple[list[str], list[str]]:
    """Declarations of all speeds, and the name of each move's speed; the first one is for the way to the start."""
    top = plan.problem.process.travel_speed * 1e3
    tip = _quantised(np.where(moves.laid, moves.speed * 1e3, np.minimum(np.ceil(moves.speed * 1e3), top)))
    turn, axis = np.degrees(moves.turn), np.degrees(moves.axis)
    turn_max = _rounded_up(HEAD_ROOM * float(turn.max()), 10.0)
    axis_max = _rounded_up(HEAD_ROOM * float(axis.max(initial=0.0)), 10.0)
    # where the tip hardly moves it cannot set the pace: there the turning does, at its real rate
    slow = (moves.speed < 1e-3) & (np.maximum(turn, axis) > 1.0)
    own_turn = np.where(slow, np.maximum(1.0, np.ceil(turn)), turn_max)
    own_axis = np.where(slow, np.maximum(1.0, np.ceil(axis)), axis_max)
    keys = [(top, turn_max, axis_max), *zip(tip.tolist(), own_turn.tolist(), own_axis.tolist(), strict=True)]
    table = {}
    for key in sorted(set(keys)):
        own = "" if key[1:] == (turn_max, axis_max) else f"o{key[1]:.0f}a{key[2]:.0f}"
        table[key] = f"vel{key[0]:g}".replace(".", "_") + own
    lines = [f"    CONST speeddata {name}:=[{v:g},{o:g},1000,{a:g}];" for (v, o, a), name in table.items()]
    return lines, [table[key] for key in keys]


def _rounded_up(value: float, step: float) -> float:
    return max(100.0, step * float(np.ceil(value / step)))


def _main(plan: Plan, calls: list[str], speed: str) -> list[str]:
    names, cell, start = plan.problem.program, plan.cell, plan.trajectory.q[:1]
    na = len(cell.arm)
    joints = ",".join(number(v, 5) for v in np.degrees(start[0, :na]))
    external = _external_text(external_degrees(cell, start[:, na:]))[0]
    station = [] if cell.holder_robot is None else [names.station]
    extruders = _extruders(plan)
    said = f"{module_name(plan.name)}: {len(plan.beads)} beads"[:LONGEST_STRING]
    return [
        "    PROC main()",
        f'        TPWrite "{said}";',
        *(f"        ActUnit {name};" for name in station),
        "        SingArea\\Off;",
        "        ConfJ\\On;",
        "        ConfL\\Off;",
        *(f"        SetDO {signal},0;" for signal in extruders.values()),
        *(
            f"        TriggIO {name}{k},0{where}\\DOp:={signal},{value};"
            for k, signal in extruders.items()
            for name, where, value in (("trgOn", "", 1), ("trgOff", "", 0), ("trgOnStart", "\\Start", 1))
        ),
        f"        MoveAbsJ [[{joints}],[{external}]],{speed},fine,{names.tool}\\WObj:={names.work_object};",
        *(f"        {call};" for call in calls),
        *(f"        SetDO {signal},0;" for signal in extruders.values()),
        *(f"        DeactUnit {name};" for name in station),
        '        TPWrite "Finished";',
        "    ENDPROC",
        "",
    ]


def _extruders(plan: Plan) -> dict[str, str]:
    """The digital output of each extruder, by what its triggers end with: nothing for the first, then 2, 3, …"""
    outputs = [each.signal for each in materials_of(plan.problem)] or [plan.problem.program.extruder_signal]
    return {str(k) if k > 1 else "": signal for k, signal in enumerate(outputs, 1)}


def _endings(plan: Plan) -> list[str]:
    """What the triggers of each bead end with."""
    names = [each.name for each in materials_of(plan.problem)]
    endings = list(_extruders(plan))
    return [endings[names.index(bead.material)] if names else endings[0] for bead in plan.toolpath.beads]


def _external_text(degrees: Array) -> list[str]:
    """`eax_a,..,eax_f` of each row."""
    unused = ",".join([UNUSED] * (RAPID_EXTERNAL_AXES - degrees.shape[1]))
    if not degrees.shape[1]:
        return [unused] * len(degrees)
    degrees = np.round(degrees, 4) + 0.0  # turns minus nought into nought
    pattern = ",".join(["%.4f"] * degrees.shape[1]) + ("," + unused if unused else "")
    return [pattern % tuple(row) for row in degrees.tolist()]


def _targets(plan: Plan, moves: Moves) -> list[str]:
    """Robtargets of the first sample and of every move."""
    trajectory, na = plan.trajectory, len(plan.cell.arm)
    k = np.concatenate([[0], moves.sample])
    quat = continuous(moves.quat[k])[:, [3, 0, 1, 2]]
    numbers = np.column_stack(
        [
            np.round(trajectory.tip[k] * 1e3, 3) + 0.0,
            np.round(quat, 7) + 0.0,
            quadrants(trajectory.q[k]),
            trajectory.branch[k],
        ]
    )
    external = _external_text(external_degrees(plan.cell, trajectory.q[k, na:]))
    pattern = "[[%.3f,%.3f,%.3f],[%.7f,%.7f,%.7f,%.7f],[%d,%d,%d,%d],[%s]]"
    return [pattern % (*row, ext) for row, ext in zip(numbers.tolist(), external, strict=True)]


def _procedures(plan: Plan, moves: Moves, speeds: list[str]) -> tuple[list[str], list[str]]:
    """All procedures with moves, and their names in the order of calling."""
    names, targets = plan.problem.program, _targets(plan, moves)
    frames = f"{names.tool}\\WObj:={names.work_object};"
    first, last = deposits(plan.trajectory)
    lines = [
        "    PROC Start()",
        comment("The planned start as a target: the robot must not move here, if tool and work object are right.", 8),
        f"        MoveJ {targets[0]},{speeds[0]},fine,{frames}",
        *_waiting(moves.waits.get(-1, ())),
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
        lines.append(f"    PROC {calls[-1]}()")
        if k < len(first):
            lines.append(_about(plan, int(first[k]), int(last[k])))
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
            lines.append(f"        {word} {targets[i + 1]},{speeds[i + 1]}{what},{zone},{frames}")
            lines += _waiting(moves.waits.get(i, ()))
        lines += ["    ENDPROC", ""]
    return lines, calls


def _waiting(waits: Sequence[Wait]) -> list[str]:
    """Statements of what the robot stands still for, each with a comment that says why."""
    lines = []
    for wait in waits:
        lines += [comment(wait.why, 8)] if wait.why else []
        lines += [f"        WaitTime {wait.time:.3f};"] if wait.time > 0.0 else []
    return lines


def _about(plan: Plan, first: int, last: int) -> str:
    """Comment on what a procedure prints between two samples."""
    t = plan.trajectory
    bead = t.bead[first]
    of = plan.toolpath.beads[bead].material
    length = f"{1e3 * (t.s[last] - t.s[first]):.1f} mm" + (f" of {of}" if of else "")
    return comment(f"Bead {bead}, layer {t.layer[first]}: {length}", 8)
