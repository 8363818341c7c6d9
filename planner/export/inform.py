"""INFORM jobs (.JBI) for Yaskawa's controllers (DX200, YRC1000): writer, reader, and check against the plan."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.arms import (
    AXIS_5_NEGATIVE,
    BEHIND_AXIS_1,
    BEHIND_LOWER_ARM,
    ArmProgram,
    Convention,
    ProgramStep,
    ProgramSteps,
    arm_differences,
    arm_program,
    forward_of,
    percent,
    read_arm,
    signed,
)
from planner.export.euler import fixed_xyz, from_fixed_xyz, read_pose, written
from planner.export.fit import to_matrix
from planner.export.grammar import NUMBER, SIX_NUMBERS, Grammar, Statement, inlined
from planner.export.moves import Moves, MoveSection, move_radii, moves_of_lines, sections
from planner.export.parts import in_files, numbered, part_about
from planner.export.program import RobotProgram, about
from planner.export.rapid.text import module_name
from planner.export.speeds import stepped_speeds
from planner.export.support import by_bead, output_numbers, outputs_about
from planner.export.text import in_waits, number

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# Yaskawa's axes and frames (ROS-Industrial, motoman: URDF files): S and L have the same sense as ours, U, R, B and T
# the opposite; the flange's x points up where ours points down; the robot's origin is level with L. Rx Ry Rz are turns
# about fixed x, y and z.

YASKAWA = Convention(axes=signed(1.0, 1.0, -1.0, -1.0, -1.0, -1.0), offset=np.zeros(6), flange=np.pi, shoulder=True)


def configs(plan: Plan, moves: Moves) -> list[str]:
    """RCONF of each move's target: 1 for no flip, a lower elbow, back, and R, T or S beyond half a turn.

    No flip means that B is negative. Where the wrist centre is behind S, an elbow that would count as up when reaching
    forwards is a lower one.
    """
    branch = plan.trajectory.branch[moves.sample].astype(np.intp)
    flip, below, back = (branch & bit > 0 for bit in (AXIS_5_NEGATIVE, BEHIND_LOWER_ARM, BEHIND_AXIS_1))
    beyond = np.abs(YASKAWA.counted(moves.q[1:, plan.cell.own])[:, [3, 5, 0]]) >= np.pi
    rows = np.column_stack([~flip, below != back, back, beyond]).astype(int).tolist()
    return [",".join(map(str, [*row, 0, 0])) for row in rows]


def branch_of(config: str) -> int:
    """Branch for an RCONF."""
    no_flip, lower, back = (value == "1" for value in config.split(",")[:3])
    return (not no_flip) * AXIS_5_NEGATIVE + (lower != back) * BEHIND_LOWER_ARM + back * BEHIND_AXIS_1


# ----------------------------------------------------------------------------------------------------
# Writer: a relative job with its positions, or one that calls others.
#
# Travel goes to angles (POSTYPE ANGLE), which define the posture without the robot's pulses; lines go to poses in the
# user frame. A job cannot set frames without an option, so tool and user frame are given in its comments, which are
# read back as well. There are no arcs: MOVC passes through three or more points, and how consecutive arcs are separated
# is not public. A move without PL continues at once, and corners are rounded by the servos' lag; PL=0 stops.

LONGEST_NAME = 24  # of 32 characters
LONGEST_COMMENT = 31
MOST_MOVES = 2000  # of a job; an editor has to show them, and jobs are reportedly limited to 10,000 lines
TOOL, USER = 1, 1
FRAME = ("X", "Y", "Z", "RX", "RY", "RZ")
MM, DEGREES = 3, 4  # decimals
SPEED = 1  # decimals of mm/s
TICK = 0.01  # [s] to which waits are written
LONGEST_WAIT = 600.0  # [s]; 655.35 is reportedly the most: sixteen bits of ticks


def write(plan: Plan) -> dict[str, str]:
    """Jobs of a verified plan (ASCII, mm, degrees)."""
    name, moves = job_name(plan.name), moves_of_lines(plan)
    own = in_files(sections(plan, moves), MOST_MOVES)
    off = [f"DOUT OT#({k}) OFF" for k in output_numbers(plan.problem).values()]
    start = (False, "", _joints(YASKAWA.counted(plan.trajectory.q[:1, plan.cell.own]))[0])
    targets, statements = _targets(plan, moves), _statements(plan, moves)
    begin = [*_header(plan), *off, f"MOVJ C00000 VJ={percent(plan, moves)[0]}.00 PL=0", *_rests(moves, -1)]
    if len(own) == 1:
        body, positions = _body(moves, own[0], statements, targets, 1)
        return {f"{name}.JBI": _job(name, [*begin, *body, *off], [start, *positions])}
    names = [numbered(name, k, LONGEST_NAME) for k in range(1, len(own) + 1)]
    files = {f"{name}.JBI": _job(name, [*begin, *(f"CALL JOB:{each}" for each in names), *off], [start])}
    for k, (title, group) in enumerate(zip(names, own, strict=True), 1):
        body, positions = _body(moves, group, statements, targets, 0)
        remarks = [line for text in part_about(about(plan), k, len(own)) for line in _comments(text)]
        files[f"{title}.JBI"] = _job(title, [*remarks, *body], positions)
    return files


def job_name(name: str) -> str:
    """A problem's name in capitals and digits."""
    return module_name(name, LONGEST_NAME).upper()


def planned_speeds(moves: Moves) -> Array:
    """Speed (m) [m/s] written for each line."""
    return stepped_speeds(moves, 1e-3 * 10.0**-SPEED)


Target = tuple[bool, str, str]  # whether it is a pose; its RCONF; its numbers


def _job(name: str, lines: list[str], targets: list[Target]) -> str:
    positions: list[str] = []
    last: tuple[bool, str] | None = None
    for k, (linear, said, values) in enumerate(targets):
        if last is None or last[0] != linear:
            kind = [f"///USER {USER}", f"///TOOL {TOOL}", "///POSTYPE USER", "///RECTAN"]
            positions += kind if linear else [f"///TOOL {TOOL}", "///POSTYPE ANGLE", "///ANGLE"]
        if linear and (last is None or last != (True, said)):
            positions.append(f"///RCONF {said}")
        last = linear, said
        positions.append(f"C{k:05d}={values}")
    return "\n".join(
        [
            "/JOB",
            f"//NAME {name}",
            "//POS",
            f"///NPOS {len(targets)},0,0,0,0,0",
            *positions,
            "//INST",
            "///DATE 2000/01/01 00:00",
            "///COMM beadwise print",
            "///ATTR SC,RW,RJ",
            f"////FRAME USER {USER}",
            "///GROUP1 RB1",
            "NOP",
            *lines,
            "END",
            "",
        ]
    )


def _comments(text: str) -> list[str]:
    return [f"' {line}" for line in textwrap.wrap(re.sub(r"[^\x20-\x7e]", "?", text), LONGEST_COMMENT)]


def _header(plan: Plan) -> list[str]:
    texts = [
        *about(plan),
        *outputs_about(plan.problem),
        f"S L U R B T, as Yaskawa counts: {', '.join(plan.cell.arm.names)}",
        "V is in mm/s",
        f"Set before: load, TOOL {TOOL} and USER {USER} as follows",
    ]
    frames = [
        *frame_comments(f"TOOL{TOOL}", YASKAWA.tool(plan.cell)),
        *frame_comments(f"USER{USER}", YASKAWA.part(plan.cell)),
    ]
    return [*(line for text in texts for line in _comments(text)), *frames]


def frame_comments(what: str, T: Array) -> list[str]:
    """A frame (4, 4) as entered at the controller, one number per line: a comment is too short for three."""
    values = [*(T[:3, 3] * 1e3), *written(fixed_xyz(T[None, :3, :3])[0], DEGREES)]
    decimals = [MM] * 3 + [DEGREES] * 3
    return [f"'{what} {axis} {number(value, d)}" for axis, value, d in zip(FRAME, values, decimals, strict=True)]


def _rests(moves: Moves, i: int) -> list[str]:
    waits = moves.waits.get(i, ())
    total = sum(wait.time for wait in waits)
    why = [line for wait in waits if wait.why for line in _comments(wait.why)]
    return [*why, *(f"TIMER T={wait:.2f}" for wait in in_waits(total, LONGEST_WAIT, TICK))]


def _joints(axes: Array) -> list[str]:
    form = ",".join([f"%.{DEGREES}f"] * 6)
    return [form % tuple(row) for row in (np.round(np.degrees(axes), DEGREES) + 0.0).tolist()]


def _targets(plan: Plan, moves: Moves) -> list[Target]:
    """The position of each move."""
    joints = _joints(YASKAWA.counted(plan.trajectory.q[moves.sample][:, plan.cell.own]))
    r = written(fixed_xyz(to_matrix(moves.targets.quat[1:])), DEGREES)
    rows = np.column_stack([np.round(moves.targets.position[1:] * 1e3, MM) + 0.0, r]).tolist()
    form = ",".join([f"%.{MM}f"] * 3 + [f"%.{DEGREES}f"] * 3)
    return [
        (True, said, form % tuple(row)) if linear else (False, "", axes)
        for linear, said, row, axes in zip(moves.linear.tolist(), configs(plan, moves), rows, joints, strict=True)
    ]


def _statements(plan: Plan, moves: Moves) -> list[tuple[list[str], str, list[str]]]:
    """For each move: statements before it, the rest of its own after the position, and statements after it."""
    bead = plan.trajectory.bead
    outputs = by_bead(plan, list(output_numbers(plan.problem).values()))
    speeds, shares = (planned_speeds(moves) * 1e3).tolist(), percent(plan, moves)
    radii = move_radii(plan, moves).tolist()
    out = []
    for i, linear in enumerate(moves.linear.tolist()):
        begins, ends = (outputs[bead[at]] for at in (moves.sample[i - 1] if i else 0, moves.sample[i]))
        before = [f"DOUT OT#({begins}) ON"] if moves.on_start[i] else []
        after = [f"DOUT OT#({ends}) ON"] if moves.on_end[i] else []
        after += [f"DOUT OT#({ends}) OFF"] if moves.off_end[i] else []
        how = f"V={number(speeds[i], SPEED)}" if linear else f"VJ={shares[i]}.00"
        out.append((before, how + (" PL=0" if radii[i] == 0.0 else ""), after))
    return out


def _body(
    moves: Moves,
    own: list[MoveSection],
    statements: list[tuple[list[str], str, list[str]]],
    targets: list[Target],
    taken: int,
) -> tuple[list[str], list[Target]]:
    """Statements of sections, and their positions, numbered after those that are `taken`."""
    lines: list[str] = []
    positions: list[Target] = []
    for section in own:
        lines += _comments(section.about)
        for i in section.moves:
            before, how, after = statements[i]
            lines += before
            lines.append(f"{'MOVL' if moves.linear[i] else 'MOVJ'} C{taken + len(positions):05d} {how}")
            positions.append(targets[i])
            lines += [*after, *_rests(moves, i)]
    return lines, positions


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

NAME = r"[A-Z][A-Z0-9_]{0,31}"
POSITIONS = Grammar.of(
    "INFORM positions",
    "'",
    {
        "value": rf"C([0-9]{{5}})={SIX_NUMBERS}",
        "config": r"///RCONF ([01](?:,[01]){5},0,0)",
        "kind": r"///(RECTAN|ANGLE)",
        "type": r"///POSTYPE (USER|ANGLE)",
        "user": rf"///USER {USER}",
        "tool": rf"///TOOL {TOOL}",
        "count": r"///NPOS ([0-9]{1,5}),0,0,0,0,0",
    },
)
JOB = Grammar.of(
    "INFORM",
    "' ",
    {
        "line": rf"MOVL C([0-9]{{5}}) V=({NUMBER})( PL=0)?",
        "point": rf"MOVJ C([0-9]{{5}}) VJ=({NUMBER})( PL=0)?",
        "output": r"DOUT OT#\(([0-9]{1,4})\) (ON|OFF)",
        "wait": rf"TIMER T=({NUMBER})",
        "call": rf"CALL JOB:({NAME})",
        "frame": rf"'(TOOL|USER){TOOL} (R?[XYZ]) ({NUMBER})",
    },
)


def read_inform(files: Mapping[str, str], main: str, plan: Plan) -> tuple[ArmProgram, list[str]]:
    """Program from the texts of jobs by name, and the RCONF of its lines, in order.

    Raises InputError, with the line, for an unknown or misplaced statement or position.
    """
    bodies: dict[str, list[Statement]] = {}
    places: dict[str, list[Target]] = {}
    for name, text in files.items():
        bodies[name], places[name] = _read_job(text, name)
    if main not in bodies:
        raise InputError(f"there is no job {main}", file=JOB.file)
    steps, said = ProgramSteps(), []
    frames: dict[str, float] = {}
    for statement in inlined(bodies, main, "job"):
        word, parts = statement.word, statement.parts
        if word in ("line", "point"):
            there, k = places[statement.file], int(parts[0])
            if not k < len(there) or there[k][0] != (word == "line"):
                raise statement.error(f"C{parts[0]} is missing, or of the wrong kind")
            numbers = [float(value) for value in there[k][2].split(",")]
            if word == "line":
                said.append(there[k][1])
                pose, speed = read_pose(numbers, from_fixed_xyz), 1e-3 * float(parts[1])
                steps.moves.append(ProgramStep(True, bool(parts[2]), pose, speed, branch=branch_of(there[k][1])))
            else:
                steps.moves.append(ProgramStep(False, bool(parts[2]), np.radians(numbers), float(parts[1])))
        elif word == "output":
            steps.switch(parts[0], parts[1] == "ON")
        elif word == "wait":
            steps.wait(float(parts[0]))
        elif steps.moves or parts[0] + parts[1] in frames:
            raise statement.misplaced("after the first move, or twice")
        else:
            frames[parts[0] + parts[1]] = float(parts[2])
    if set(frames) != {what + axis for what in ("TOOL", "USER") for axis in FRAME}:
        raise InputError("no tool or user frame is given", file=JOB.file)
    tool, part = (read_pose([frames[what + axis] for axis in FRAME], from_fixed_xyz) for what in ("TOOL", "USER"))
    return read_arm(main, steps, tool, part, forward_of(plan.cell, YASKAWA), JOB.file), said


def _read_job(text: str, name: str) -> tuple[list[Statement], list[Target]]:
    """Statements and positions of a job."""
    empty = _job(name, [], [])
    head, rest = empty.split("///NPOS 0,0,0,0,0,0\n")
    between, tail = rest.removesuffix("END\n"), "END\n"
    parts = re.fullmatch(f"{re.escape(head)}(.*?){re.escape(between)}(.*?){tail}", text, re.DOTALL)
    if parts is None:
        raise InputError(f"no complete job {name} with //POS, //INST and END", file=name)
    first = text[: parts.start(2)].count("\n") + 1
    statements = list(JOB.statements(parts[2].split("\n"), first, name))
    return statements, list(_read_positions(parts[1], head.count("\n") + 1, name))


def _read_positions(text: str, first: int, name: str) -> Iterator[Target]:
    state: dict[str, str] = {}
    count, k = -1, 0
    for statement in POSITIONS.statements(text.split("\n"), first, name):
        word, parts = statement.word, statement.parts
        if word == "count":
            count = int(parts[0])
        elif word == "type":
            state = {name: value for name, value in state.items() if name in ("tool", "user")} | {"type": parts[0]}
        elif word == "value":
            linear = state.get("kind") == "RECTAN"
            whole = {"tool", "type", "kind"} | ({"user", "config"} if linear else set())
            if not whole <= set(state) or (state["type"] == "USER") != linear or int(parts[0]) != k:
                raise statement.error("a position out of order, or without tool, frame, kind or RCONF")
            k += 1
            yield linear, state["config"] if linear else "", parts[1]
        else:
            state[word] = parts[0] if parts else ""
    if k != count:
        raise InputError(f"{k} positions, and NPOS says {count}", file=name)


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program in the files, with whatever they leave open taken from the plan. InputError for an unknown line."""
    texts = {file.removesuffix(".JBI"): text for file, text in files.items()}
    read, _ = read_inform(texts, job_name(plan.name), plan)
    return arm_program(plan, moves_of_lines(plan), read, YASKAWA, np.radians(0.51 * 10.0**-DEGREES))


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the jobs from the plan beyond rounding and thinning, in words. InputError for an unknown line."""
    texts = {file.removesuffix(".JBI"): text for file, text in files.items()}
    read, said = read_inform(texts, job_name(plan.name), plan)
    moves = moves_of_lines(plan)
    rounding = np.radians(0.51 * 10.0**-DEGREES)
    found = arm_differences(plan, moves, read, YASKAWA, rounding, planned_speeds(moves), TICK)
    planned = [each for each, linear in zip(configs(plan, moves), moves.linear.tolist(), strict=True) if linear]
    wrong = sum(a != b for a, b in zip(said, planned, strict=False))
    return [*found, *([f"RCONF differs at {wrong} targets"] if wrong else [])]
