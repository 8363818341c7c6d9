"""FANUC's TP programs as ASCII (.ls, for R-30iA and later): writer, reader, and check against the plan."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
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
)
from planner.export.euler import fixed_xyz, from_fixed_xyz, read_pose, written
from planner.export.fit import to_matrix
from planner.export.grammar import NUMBER, Grammar, Statement, inlined
from planner.export.moves import Moves, MoveSection, move_radii, moves_with_arcs, sections
from planner.export.parts import in_files, numbered, part_about
from planner.export.program import RobotProgram, about
from planner.export.rapid.text import module_name
from planner.export.speeds import stepped_speeds
from planner.export.support import by_bead, output_numbers, outputs_about
from planner.export.text import in_waits, number

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# FANUC's axes and frames (ROS-Industrial, fanuc: URDF files and its coupling of J2 and J3): J3 is the forearm's angle
# to the floor, whatever J2 is; J4 to J6 have the opposite sense to ours; the flange's x points up where ours points
# down; the world's origin is level with J2. W P R are turns about fixed x, y and z.

FANUC = Convention(
    axes=np.array(
        [
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, -1.0, -1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
        ]
    ),
    offset=np.zeros(6),
    flange=np.pi,
    shoulder=True,
)


LETTERS = {"F": AXIS_5_NEGATIVE, "D": BEHIND_LOWER_ARM, "B": BEHIND_AXIS_1}


def configs(plan: Plan, moves: Moves) -> list[str]:
    """CONFIG of each move's target: flip, elbow, front or back, and the turns of J1, J4 and J6.

    As in post-processors (RoboDK's; visose's Robots): N if J5 is negative; B if the wrist centre is behind axis 1,
    where an elbow that would count as up when reaching forwards is called down.
    """
    branch = plan.trajectory.branch[moves.sample].astype(np.intp)
    axes = FANUC.counted(moves.q[1:, plan.cell.own])[:, [0, 3, 5]]
    turns = (np.sign(axes) * np.floor((np.abs(axes) + np.pi) / (2.0 * np.pi))).astype(np.intp)
    flips, downs, backs = ((branch & bit > 0).tolist() for bit in LETTERS.values())
    return [
        f"{'NF'[flip]} {'UD'[down != back]} {'TB'[back]}, {j1}, {j4}, {j6}"
        for flip, down, back, (j1, j4, j6) in zip(flips, downs, backs, turns.tolist(), strict=True)
    ]


def branch_of(letters: str) -> int:
    """Branch for the letters of a CONFIG."""
    flip, elbow, base = letters.split(" ")
    behind = (elbow == "D") != (base == "B")
    return (flip == "F") * AXIS_5_NEGATIVE + behind * BEHIND_LOWER_ARM + (base == "B") * BEHIND_AXIS_1


# ----------------------------------------------------------------------------------------------------
# Writer: a program with its positions, or one that calls others.
#
# Material is laid by L with CNT100: the next motion begins as this one slows down, and speed is kept. No number then
# says how far corners are rounded; CR, which takes one, is an option. Outputs are switched by DB, on the path. Speeds
# can only be given in whole cm/min.

LONGEST_NAME = 32  # R-30iB accepts 36
LONGEST_REMARK = 32
MOST_MOVES = 4000  # of a program; reportedly limited to some 32,000 lines, and an editor has to show them
REGISTER = 9  # number of the frame, the tool, and the position register that sets them
CM_MIN = 6000.0  # cm/min per m/s
FINE, FLY = "FINE", "CNT100"
DIGITS = 3  # decimals of mm and degrees
TICK = 0.01  # [s] to which waits are written
LONGEST_WAIT = 300.0  # [s]; 327.67 is reportedly the most: sixteen bits of ticks, one of them for the sign


def write(plan: Plan) -> dict[str, str]:
    """Files of a verified plan (ASCII, mm, degrees)."""
    name, moves = fanuc_name(plan.name), moves_with_arcs(plan)
    own = in_files(sections(plan, moves), MOST_MOVES)
    off = [f"DO[{k}]=OFF" for k in output_numbers(plan.problem).values()]
    start = _joint_target(FANUC.counted(plan.trajectory.q[:1, plan.cell.own])[0])
    header = _header(plan)
    begin = [*_frames(plan), *off, f"J P[1] {percent(plan, moves)[0]}% {FINE}", *_rests(moves, -1)]
    statements, targets = _statements(plan, moves), _targets(plan, moves)
    if len(own) == 1:
        body, positions = _body(moves, own[0], statements, targets, 1)
        return {f"{name}.ls": _text(name, [*header, *begin, *body, *off], [start, *positions])}
    names = [numbered(name, k, LONGEST_NAME) for k in range(1, len(own) + 1)]
    files = {f"{name}.ls": _text(name, [*header, *begin, *(f"CALL {each}" for each in names), *off], [start])}
    for k, (title, group) in enumerate(zip(names, own, strict=True), 1):
        body, positions = _body(moves, group, statements, targets, 0)
        remarks = [remark for text in part_about(about(plan), k, len(own)) for remark in _remarks(text)]
        files[f"{title}.ls"] = _text(title, [*remarks, *body], positions)
    return files


def fanuc_name(name: str) -> str:
    """A problem's name in capitals and digits, at most 32 of them."""
    return module_name(name, LONGEST_NAME).upper()


def planned_speeds(moves: Moves) -> Array:
    """Speed (m) [m/s] written for each line."""
    return stepped_speeds(moves, 1.0 / CM_MIN)


def _text(name: str, lines: list[str], positions: list[str]) -> str:
    """The file of a program, from statements without line numbers."""
    numbered_lines = [
        f"{i:4d}:{line if line[:2] in ('J ', 'L ', 'C ') else '  ' + line} ;" for i, line in enumerate(lines, 1)
    ]
    cells = [
        f"P[{k}]{{\n   GP1:\n\tUF : {REGISTER}, UT : {REGISTER},{each}\n}};" for k, each in enumerate(positions, 1)
    ]
    return "\n".join(
        [
            f"/PROG  {name}",
            "/ATTR",
            'COMMENT\t\t= "beadwise print";',
            f"LINE_COUNT\t= {len(lines)};",
            "DEFAULT_GROUP\t= 1,*,*,*,*;",
            "/MN",
            *numbered_lines,
            "/POS",
            *cells,
            "/END",
            "",
        ]
    )


def _remarks(text: str) -> list[str]:
    """A text as ASCII remarks, each no longer than a remark may be."""
    return [f"!{line}" for line in textwrap.wrap(re.sub(r"[^\x20-\x7e]|;", "?", text), LONGEST_REMARK)]


def _header(plan: Plan) -> list[str]:
    texts = [
        *about(plan),
        *outputs_about(plan.problem),
        f"J1 to J6, as FANUC counts: {', '.join(plan.cell.arm.names)}",
        f"Sets UFRAME, UTOOL and PR {REGISTER}",
        "Payload: set it before",
    ]
    return [remark for text in texts for remark in _remarks(text)]


def _rests(moves: Moves, i: int) -> list[str]:
    waits = moves.waits.get(i, ())
    total = sum(wait.time for wait in waits)
    why = [remark for wait in waits if wait.why for remark in _remarks(wait.why)]
    return [*why, *(f"WAIT   {wait:.2f}(sec)" for wait in in_waits(total, LONGEST_WAIT, TICK))]


def _frames(plan: Plan) -> list[str]:
    """Statements that set tool and frame; negative numbers are in brackets."""
    lines = []
    for register, T in (("UTOOL", FANUC.tool(plan.cell)), ("UFRAME", FANUC.part(plan.cell))):
        values = [*(T[:3, 3] * 1e3), *written(fixed_xyz(T[None, :3, :3])[0], DIGITS)]
        for i, value in enumerate(values, 1):
            text = number(value, DIGITS)
            lines.append(f"PR[{REGISTER},{i}]={f'({text})' if text.startswith('-') else text}")
        lines += [f"{register}[{REGISTER}]=PR[{REGISTER}]", f"{register}_NUM={REGISTER}"]
    return lines


def _joint_target(axes: Array) -> str:
    values = [f"J{i}=%10.{DIGITS}f deg" % value for i, value in enumerate(np.round(np.degrees(axes), DIGITS) + 0.0, 1)]
    return "\t\n\t" + ",\t".join(values[:3]) + ",\n\t" + ",\t".join(values[3:])


def _targets(plan: Plan, moves: Moves) -> list[list[str]]:
    """The positions of each move, as they follow frame and tool; two for an arc."""
    joints = FANUC.counted(plan.trajectory.q[moves.sample][:, plan.cell.own])
    rows, vias = _rows(moves.targets.position[1:], moves.targets.quat[1:]), _rows(moves.via.position, moves.via.quat)
    length, angle = f"%10.{DIGITS}f  mm", f"%10.{DIGITS}f deg"
    line = (
        ",\t".join(f"{axis} ={length}" for axis in "XYZ") + ",\n\t" + ",\t".join(f"{axis} ={angle}" for axis in "WPR")
    )
    out = []
    for linear, circular, via, row, axes, said in zip(
        moves.linear.tolist(), moves.circular.tolist(), vias, rows, joints, configs(plan, moves), strict=True
    ):
        places = [via, row] if circular else [row]
        poses = [f"\t\tCONFIG : '{said}',\n\t{line % tuple(place)}" for place in places]
        out.append(poses if linear else [_joint_target(axes)])
    return out


def _rows(position: Array, quat: Array) -> list[list[float]]:
    """X Y Z W P R as written [mm, deg]."""
    wpr = written(fixed_xyz(to_matrix(quat)), DIGITS)
    out: list[list[float]] = np.column_stack([np.round(position * 1e3, DIGITS) + 0.0, wpr]).tolist()
    return out


def _statements(plan: Plan, moves: Moves) -> list[tuple[list[str], str, list[str]]]:
    """For each move: statements before it, the rest of its own after the position, and statements after it."""
    bead = plan.trajectory.bead
    outputs = by_bead(plan, list(output_numbers(plan.problem).values()))
    speeds = np.round(planned_speeds(moves) * CM_MIN).astype(int).tolist()
    shares, radii = percent(plan, moves), move_radii(plan, moves).tolist()
    out = []
    for i, linear in enumerate(moves.linear.tolist()):
        begins, ends = (outputs[bead[at]] for at in (moves.sample[i - 1] if i else 0, moves.sample[i]))
        before = [f"DO[{begins}]=ON"] if moves.on_start[i] else []
        switched = [
            f"DO[{ends}]={value}" for flag, value in ((moves.on_end[i], "ON"), (moves.off_end[i], "OFF")) if flag
        ]
        speed = f"{speeds[i]}cm/min" if linear else f"{shares[i]}%"
        how = f"{speed} {FLY if radii[i] > 0.0 else FINE}"
        on_path = [f"DB    0.0mm,{switched[0]}"] if switched and linear else []
        out.append((before, " ".join([how, *on_path]), switched[len(on_path) :]))
    return out


def _body(
    moves: Moves,
    own: list[MoveSection],
    statements: list[tuple[list[str], str, list[str]]],
    targets: list[list[str]],
    taken: int,
) -> tuple[list[str], list[str]]:
    """Statements of sections, and their positions, numbered after those that are `taken`."""
    lines: list[str] = []
    positions: list[str] = []
    for section in own:
        lines += _remarks(section.about)
        for i in section.moves:
            before, how, after = statements[i]
            numbers = [taken + len(positions) + k for k in range(1, len(targets[i]) + 1)]
            positions += targets[i]
            lines += before
            word = "C" if moves.circular[i] else "L" if moves.linear[i] else "J"
            on_way = f"P[{numbers[0]}]    \n    :  " if moves.circular[i] else ""
            lines.append(f"{word} {on_way}P[{numbers[-1]}] {how}")
            lines += [*after, *_rests(moves, i)]
    return lines, positions


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

NAME = r"[A-Z][A-Z0-9_]{0,31}"
TERM = rf"({FINE}|{FLY})"
PLACE = rf"P\[([0-9]{{1,5}})\] ([0-9]{{1,5}})cm/min {TERM}(?: DB 0\.0mm,DO\[([0-9]{{1,4}})\]=(ON|OFF))?"
GRAMMAR = Grammar.of(
    "TP program",
    "!",
    {
        "arc": rf"C P\[([0-9]{{1,5}})\] {PLACE}",
        "line": rf"L {PLACE}",
        "point": rf"J P\[([0-9]{{1,5}})\] ([0-9]{{1,3}})% {TERM}",
        "output": r"DO\[([0-9]{1,4})\]=(ON|OFF)",
        "wait": rf"WAIT ({NUMBER})\(sec\)",
        "register": rf"PR\[{REGISTER},([1-6])\]=\(?({NUMBER})\)?",
        "frame": rf"(UTOOL|UFRAME)\[{REGISTER}\]=PR\[{REGISTER}\]",
        "chosen": rf"(UTOOL|UFRAME)_NUM={REGISTER}",
        "call": rf"CALL ({NAME})",
    },
)
INSIDE = rf"P\[([0-9]{{1,5}})\]\{{ GP1: UF : {REGISTER}, UT : {REGISTER}, "
JOINTS = re.compile(INSIDE + ", ".join(rf"J{i}= ({NUMBER}) deg" for i in range(1, 7)))
POSE = re.compile(
    INSIDE
    + r"CONFIG : '([NF] [UD] [TB]), (-?[0-9]), (-?[0-9]), (-?[0-9])', "
    + ", ".join(rf"{axis} = ({NUMBER}) mm" for axis in "XYZ")
    + ", "
    + ", ".join(rf"{axis} = ({NUMBER}) deg" for axis in "WPR")
)
Position = tuple[str, ...]  # for a pose: CONFIG's letters, its turns, and six numbers; for joints: six numbers
_pose = partial(read_pose, of_angles=from_fixed_xyz)


def read_fanuc(files: Mapping[str, str], main: str, plan: Plan) -> tuple[ArmProgram, list[str]]:
    """Program from texts by program name, and the CONFIG of its lines, and of both points of its arcs, in order.

    Raises InputError, with the line, for an unknown or misplaced statement or position.
    """
    bodies: dict[str, list[Statement]] = {}
    places: dict[str, dict[str, Position]] = {}
    for name, text in files.items():
        bodies[name], places[name] = _program(text, name)
    if main not in bodies:
        raise InputError(f"there is no program {main}", file=GRAMMAR.file)
    steps, frames, said = ProgramSteps(), {}, []
    values: dict[str, float] = {}
    for statement in inlined(bodies, main, "program"):
        word, parts = statement.word, statement.parts
        if word in ("line", "arc", "point"):
            keys = parts[:2] if word == "arc" else parts[:1]
            there = [places[statement.file].get(key, ()) for key in keys]
            if any(len(place) != (6 if word == "point" else 10) for place in there):
                raise statement.error(f"P[{'] or P['.join(keys)}] is missing, or of the wrong kind")
            how = parts[len(keys) :]
            steps.moves.append(_step(word, how, there))
            said += [] if word == "point" else [_config(place) for place in there]
            if word != "point" and how[2]:
                steps.trigger(0.0, how[3] == "ON", how[2])
        elif word == "output":
            steps.switch(parts[0], parts[1] == "ON")
        elif word == "wait":
            steps.wait(float(parts[0]))
        elif word == "register":
            values[parts[0]] = float(parts[1])
        elif steps.moves:
            raise statement.misplaced("after the first move")
        elif word == "frame":
            if len(values) != 6:
                raise statement.error("a frame from a register that has not been set")
            frames[parts[0]] = _pose(values[str(i)] for i in range(1, 7))
        elif parts[0] not in frames:
            raise statement.error(f"{parts[0]} is selected but not set")
    if len(frames) != 2:
        raise InputError("no tool or frame is set", file=GRAMMAR.file)
    program = read_arm(main, steps, frames["UTOOL"], frames["UFRAME"], forward_of(plan.cell, FANUC), GRAMMAR.file)
    return program, said


def _step(word: str, how: Sequence[str], places: Sequence[Position]) -> ProgramStep:
    """A move from its word, its speed and termination, and its positions."""
    place = places[-1]
    numbers, fine = [float(value) for value in place[-6:]], how[1] == FINE
    if word == "point":
        return ProgramStep(False, fine, np.radians(numbers), float(how[0]))
    via = _pose(places[0][-6:]) if word == "arc" else None
    return ProgramStep(True, fine, _pose(numbers), float(how[0]) / CM_MIN, branch=branch_of(place[0]), via=via)


def _config(place: Position) -> str:
    return f"{place[0]}, {', '.join(place[1:4])}"


def _program(text: str, name: str) -> tuple[list[Statement], dict[str, Position]]:
    """Statements and positions of a file."""
    parts = re.fullmatch(
        rf"/PROG +({NAME})\n/ATTR\n(?:[A-Z_]+\t+= [^\n;]*;\n)*/MN\n(.*?)/POS\n(.*?)/END\n", text, re.DOTALL | re.ASCII
    )
    if parts is None or parts[1] != name:
        raise InputError(f"no complete program {name} with /MN, /POS and /END", file=name)
    first = text[: parts.start(2)].count("\n") + 1
    return list(_read_statements(parts[2], name, first)), _read_positions(parts[3], name)


def _read_statements(text: str, name: str, first: int) -> Iterator[Statement]:
    line = first
    for k, raw in enumerate(text.replace("\n    :", "\0").splitlines(), 1):  # an arc continues on a second line
        inner = re.fullmatch(r" *([0-9]+):(.*) ;", raw, re.ASCII)
        if inner is None or int(inner[1]) != k:
            raise InputError(
                "a line without its semicolon, or whose number is missing or out of order", file=name, line=line
            )
        said = re.sub(r"[\s\0]+", " ", inner[2]).strip()
        if not said.startswith("!"):
            yield GRAMMAR.statement(said, line, name)
        line += 1 + raw.count("\0")


def _read_positions(text: str, name: str) -> dict[str, Position]:
    found: dict[str, Position] = {}
    for cell in text.split("};\n")[:-1]:
        said = re.sub(r"\s+", " ", cell).strip()
        match = POSE.fullmatch(said) or JOINTS.fullmatch(said)
        if match is None or match[1] in found:
            raise InputError(f"unknown position {said[:40]!r}, or one that is defined twice", file=name)
        found[match[1]] = match.groups()[1:]
    if text and not text.endswith("};\n"):
        raise InputError("a position that does not end", file=name)
    return found


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program in the files, with whatever they leave open taken from the plan. InputError for an unknown line."""
    texts = {file.removesuffix(".ls"): text for file, text in files.items()}
    read, _ = read_fanuc(texts, fanuc_name(plan.name), plan)
    return arm_program(plan, moves_with_arcs(plan), read, FANUC, np.radians(0.51 * 10.0**-DIGITS))


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the files from the plan beyond rounding and thinning, in words. InputError for an unknown line."""
    texts = {file.removesuffix(".ls"): text for file, text in files.items()}
    read, said = read_fanuc(texts, fanuc_name(plan.name), plan)
    moves = moves_with_arcs(plan)
    found = arm_differences(plan, moves, read, FANUC, np.radians(0.51 * 10.0**-DIGITS), planned_speeds(moves), TICK)
    planned = [
        each
        for each, linear, circular in zip(
            configs(plan, moves), moves.linear.tolist(), moves.circular.tolist(), strict=True
        )
        for _ in range(2 if circular else 1 if linear else 0)
    ]
    wrong = sum(a != b for a, b in zip(said, planned, strict=False)) + abs(len(said) - len(planned))
    return [*found, *([f"CONFIG differs at {wrong} targets"] if wrong else [])]
