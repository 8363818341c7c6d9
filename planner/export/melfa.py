"""MELFA-BASIC V for Mitsubishi's controllers (CR750 and later): writer, reader, and check against the plan."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
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
    matrix_of,
    percent,
    pose_of,
    read_arm,
    signed,
)
from planner.export.euler import fixed_xyz, from_fixed_xyz, read_pose, written
from planner.export.fit import to_matrix
from planner.export.grammar import NUMBER, SIX_NUMBERS, Grammar, Statement, inlined
from planner.export.moves import Moves, MoveSection, move_radii, moves_with_arcs, sections
from planner.export.parts import in_files, numbered, part_about
from planner.export.program import RobotProgram, about
from planner.export.rapid.text import module_name
from planner.export.speeds import stepped_speeds
from planner.export.support import by_bead, output_numbers, outputs_about
from planner.export.text import ascii_comment, number

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# Mitsubishi's axes and frames (its own URDF files, melfa_ros2_driver): the axes have the same sense as ours, but at
# zero the arm is straight up, and the flange's frame is parallel to the base's, which is at the foot. A B C are turns
# about fixed x, y and z.

MITSUBISHI = Convention(
    axes=signed(1.0, 1.0, 1.0, 1.0, 1.0, 1.0), offset=np.array([0.0, 0.0, 0.5 * np.pi, 0.0, 0.0, 0.0])
)
RIGHT, ABOVE, NO_FLIP = 4, 2, 1  # bits of the first structure flag


def flags(plan: Plan, moves: Moves) -> list[str]:
    """Structure flags of each move's target: the posture, and the turns of the axes in four bits each.

    7 (right, above, no flip) is the usual posture with the tool down, in which J5 is positive. Where the wrist centre
    is behind axis 1, an elbow that would count as above when reaching forwards is below.
    """
    branch = plan.trajectory.branch[moves.sample].astype(np.intp)
    flip, below, back = (branch & bit > 0 for bit in (AXIS_5_NEGATIVE, BEHIND_LOWER_ARM, BEHIND_AXIS_1))
    first = ~back * RIGHT + (below == back) * ABOVE + ~flip * NO_FLIP
    turns = np.floor((MITSUBISHI.counted(moves.q[1:, plan.cell.own]) + np.pi) / (2.0 * np.pi)).astype(np.int64)
    second = ((turns & 15) << (4 * np.arange(6))).sum(axis=1)
    return [f"{a},{b}" for a, b in zip(first.tolist(), second.tolist(), strict=True)]


def branch_of(flag: int) -> int:
    """Branch for a first structure flag."""
    back, above = not flag & RIGHT, bool(flag & ABOVE)
    return (not flag & NO_FLIP) * AXIS_5_NEGATIVE + (above == back) * BEHIND_LOWER_ARM + back * BEHIND_AXIS_1


# ----------------------------------------------------------------------------------------------------
# Writer: a program with its positions, or one that calls others.
#
# Positions are those of the nozzle in the base frame, as the direction in which `Base` shifts them is easily got wrong.
# Moves between Cnt 1 and Cnt 0 are one motion. The neighbourhood in millimetres precedes a move; it is the smaller of
# those allowed at its two ends, so it does not matter which end a controller applies it to. Outputs are switched by
# Wth, as the next move begins.

LONGEST_NAME = 12
MOST_MOVES = 2000  # of a program
MOST_POSITIONS, MOST_LINES = 39_000, 78_000  # that a CR750 reportedly holds in total
MARK = "'"
MM, DEGREES = 3, 4  # decimals
SPEED = 2  # decimals of mm/s
STEPS = 100.0  # of neighbourhoods, per mm
SIX = ",".join([f"%.{MM}f"] * 3 + [f"%.{DEGREES}f"] * 3)
JOINTS = ",".join([f"%.{DEGREES}f"] * 6)


def melfa_name(name: str) -> str:
    """A problem's name in capitals and digits, at most 12 of them."""
    return module_name(name, LONGEST_NAME).upper()


def write(plan: Plan) -> dict[str, str]:
    """Files of a verified plan (ASCII, mm, degrees)."""
    name, moves = melfa_name(plan.name), moves_with_arcs(plan)
    own = in_files(sections(plan, moves), MOST_MOVES)
    names = [numbered(name, k, LONGEST_NAME) for k in range(1, len(own) + 1)]
    off = [f"M_Out({k})=0" for k in output_numbers(plan.problem).values()]
    start = MITSUBISHI.counted(plan.trajectory.q[:1, plan.cell.own])
    tool, targets = MITSUBISHI.tool(plan.cell), _Targets(plan, moves)
    files: dict[str, str] = {}
    lines = places = 0
    for k, (title, group) in enumerate(zip(names, own, strict=True), 1):
        remarks = [ascii_comment(MARK, text) for text in part_about(about(plan), k, len(own))]
        body, positions = _part(plan, moves, group, targets)
        files[f"{title}.prg"] = _text([*remarks, *body], positions)
        lines, places = lines + len(remarks) + len(body) + 1, places + len(positions)
    size = [f"Calls {len(own)} programs with {places} positions and {lines} lines in all: import all of them"]
    if places > MOST_POSITIONS or lines > MOST_LINES:
        most = f"{MOST_POSITIONS} positions and {MOST_LINES} lines"
        size.append(f"Note: a CR750 is said to hold {most} in all; see docs/languages.md")
    main = [
        *_header(plan),
        *(ascii_comment(MARK, text) for text in size),
        f"Tool ({_poses(tool[None, :3, 3], tool[None, :3, :3])[0]})",
        "Base P_NBase",
        "Ovrd 100",
        *off,
        f"JOvrd {percent(plan, moves)[0]}",
        "Cnt 0",
        "Mov J1",
        *_rests(moves, -1),
        *(f'CallP "{each}"' for each in names),
        *off,
    ]
    return {f"{name}.prg": _text(main, [f"J1=({_joints(start)[0]})"]), **files}


def planned_speeds(moves: Moves) -> Array:
    """Speed (m) [m/s] written for each line."""
    return stepped_speeds(moves, 1e-3 * 10.0**-SPEED)


def neighbourhoods(plan: Plan, moves: Moves) -> Array:
    """Neighbourhood written before each move (m) [m]; 0 if it neither begins nor ends in a blend."""
    radii = move_radii(plan, moves)
    before = np.concatenate([[0.0], radii[:-1]])
    nearest = np.where((radii > 0.0) & (before > 0.0), np.minimum(radii, before), np.maximum(radii, before))
    out: Array = np.where(
        nearest > 0.0, np.maximum(np.floor(nearest * 1e3 * STEPS * (1.0 + 1e-9)), 1.0) / STEPS * 1e-3, 0.0
    )
    return out


def planned_zones(plan: Plan, moves: Moves) -> Array:
    """Blend (m) [m] at the end of each move: the smaller of the neighbourhoods before it and before the next one."""
    near = neighbourhoods(plan, moves)
    out: Array = np.where(move_radii(plan, moves) > 0.0, np.minimum(near, np.append(near[1:], np.inf)), 0.0)
    return out


def _text(lines: list[str], positions: list[str]) -> str:
    return "\n".join([*(f"{k} {line}" for k, line in enumerate([*lines, "End"], 1)), *positions, ""])


def _header(plan: Plan) -> list[str]:
    texts = [
        *about(plan),
        *outputs_about(plan.problem),
        f"J1 to J6, as Mitsubishi counts: {', '.join(plan.cell.arm.names)}",
        "Load: set it by Loadset before the first run",
    ]
    return [ascii_comment(MARK, text) for text in texts]


def _rests(moves: Moves, i: int) -> list[str]:
    waits = moves.waits.get(i, ())
    total = sum(wait.time for wait in waits)
    why = [ascii_comment(MARK, wait.why) for wait in waits if wait.why]
    return [*why, *([f"Dly {total:.3f}"] if total > 0.0 else [])]


def _poses(position: Array, R: Array) -> list[str]:
    rows = np.column_stack([np.round(position * 1e3, MM) + 0.0, written(fixed_xyz(R), DEGREES)])
    return [SIX % tuple(row) for row in rows.tolist()]


def _joints(axes: Array) -> list[str]:
    return [JOINTS % tuple(row) for row in (np.round(np.degrees(axes), DEGREES) + 0.0).tolist()]


class _Targets:
    """Positions of all moves in the base frame, as written."""

    def __init__(self, plan: Plan, moves: Moves) -> None:
        T = MITSUBISHI.part(plan.cell)
        R_base_part, t = T[:3, :3], T[:3, 3]
        said = flags(plan, moves)
        ends, vias = (
            _poses(poses.position @ R_base_part.T + t, R_base_part @ to_matrix(poses.quat))
            for poses in (moves.targets, moves.via)
        )
        self.start = [f"({pose})({flag})" for pose, flag in zip(ends[:-1], said, strict=True)]
        self.via = [f"({pose})({flag})" for pose, flag in zip(vias, said, strict=True)]
        self.end = [f"({pose})({flag})" for pose, flag in zip(ends[1:], said, strict=True)]
        joints = _joints(MITSUBISHI.counted(plan.trajectory.q[moves.sample][:, plan.cell.own]))
        self.joints = [f"({values})" for values in joints]


def _part(plan: Plan, moves: Moves, own: list[MoveSection], targets: _Targets) -> tuple[list[str], list[str]]:
    """Statements of sections, and their positions."""
    bead = plan.trajectory.bead
    outputs = by_bead(plan, list(output_numbers(plan.problem).values()))
    speeds, shares = (planned_speeds(moves) * 1e3).tolist(), percent(plan, moves)
    near, radii = neighbourhoods(plan, moves).tolist(), move_radii(plan, moves).tolist()
    lines: list[str] = []
    positions: list[str] = []
    counts = {"P": 0, "J": 0}
    said: dict[str, str] = {}  # latest values of Spd, JOvrd and Cnt

    def say(word: str, value: str) -> None:
        if said.get(word) != value:
            said[word] = value
            lines.append(f"{word} {value}")

    def place(kind: str, values: str) -> str:
        counts[kind] += 1
        positions.append(f"{kind}{counts[kind]}={values}")
        return f"{kind}{counts[kind]}"

    waiting: list[str] = []  # outputs to switch as the next move begins
    for section in own:
        lines += [ascii_comment(MARK, section.about)] if section.about else []
        for i in section.moves:
            begins, ends = (outputs[bead[at]] for at in (moves.sample[i - 1] if i else 0, moves.sample[i]))
            waiting += [f"M_Out({begins})=1"] if moves.on_start[i] else []
            if moves.linear[i]:
                say("Spd", number(speeds[i], SPEED))
            else:
                say("JOvrd", f"{shares[i]}")
            say("Cnt", f"1,{number(near[i] * 1e3, 2)},{number(near[i] * 1e3, 2)}" if near[i] > 0.0 else "0")
            *plain, last = waiting or [""]
            lines += plain
            if moves.circular[i]:
                shared = counts["P"] > 0 and moves.linear[i - 1]  # its start is the end of the move before it here
                begin = f"P{counts['P']}" if shared else place("P", targets.start[i])
                move = f"Mvr {begin},{place('P', targets.via[i])},{place('P', targets.end[i])}"
            elif moves.linear[i]:
                move = f"Mvs {place('P', targets.end[i])}"
            else:
                move = f"Mov {place('J', targets.joints[i])}"
            lines.append(f"{move} Wth {last}" if last else move)
            waiting = [f"M_Out({ends})=1"] if moves.on_end[i] else []
            waiting += [f"M_Out({ends})=0"] if moves.off_end[i] else []
            if radii[i] == 0.0:
                say("Cnt", "0")
                rests = _rests(moves, i)
                lines += [*waiting, *rests] if rests else []
                waiting = [] if rests else waiting
    return [*lines, *waiting], positions


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

NAME = r"[A-Z][A-Z0-9_]{0,11}"
WITH = r"(?: Wth M_Out\(([0-9]{1,5})\)=([01]))?"
GRAMMAR = Grammar.of(
    "MELFA-BASIC",
    MARK,
    {
        "line": rf"Mvs P([0-9]{{1,5}}){WITH}",
        "arc": rf"Mvr P([0-9]{{1,5}}),P([0-9]{{1,5}}),P([0-9]{{1,5}}){WITH}",
        "point": rf"Mov J([0-9]{{1,5}}){WITH}",
        "speed": rf"Spd ({NUMBER})",
        "share": r"JOvrd ([0-9]{1,3})",
        "near": rf"Cnt 1,({NUMBER}),\1",
        "stop": r"Cnt 0",
        "output": r"M_Out\(([0-9]{1,5})\)=([01])",
        "wait": rf"Dly ({NUMBER})",
        "call": rf'CallP "({NAME})"',
        "tool": rf"Tool \({SIX_NUMBERS}\)",
        "setting": r"(Base P_NBase|Ovrd 100)",
        "end": r"End",
    },
)
POSITION = re.compile(
    rf"(?:P([0-9]{{1,5}})=\({SIX_NUMBERS}\)\(([0-7]),([0-9]{{1,8}})\)|J([0-9]{{1,5}})=\({SIX_NUMBERS}\))", re.ASCII
)
Places = dict[str, tuple[list[float], str]]  # name → numbers, and structure flags of a pose


def read_melfa(files: Mapping[str, str], main: str, plan: Plan) -> tuple[ArmProgram, list[str]]:
    """Program from texts by program name, and the structure flags of its lines, in order.

    Raises InputError, with the line, for an unknown or misplaced statement or position.
    """
    bodies: dict[str, list[Statement]] = {}
    places: dict[str, Places] = {}
    for name, text in files.items():
        bodies[name], places[name] = _program(text, name)
    if main not in bodies:
        raise InputError(f"there is no program {main}", file=GRAMMAR.file)
    run = _MelfaRun(np.linalg.inv(MITSUBISHI.part(plan.cell)).astype(np.float64))
    for statement in inlined(bodies, main, "program"):
        run.take(statement, places[statement.file])
    run.near = 0.0
    run.move()
    if run.settings != ["Base P_NBase", "Ovrd 100"] or run.tool is None:
        raise InputError("no tool is set, or base and override are not", file=GRAMMAR.file)
    part = pose_of(MITSUBISHI.part(plan.cell))
    return read_arm(main, run.steps, run.tool, part, forward_of(plan.cell, MITSUBISHI), GRAMMAR.file), run.said


class _MelfaRun:
    """What the statements do, one after the other."""

    def __init__(self, T_part_base: Array) -> None:
        self.T_part_base = T_part_base
        self.steps, self.said = ProgramSteps(), list[str]()
        self.settings: list[str] = []
        self.tool: Array | None = None
        self.speed, self.share, self.near = np.nan, np.nan, 0.0
        self.pending: ProgramStep | None = None  # a move, until it is known how it ends
        self.pending_near = 0.0

    def take(self, statement: Statement, places: Places) -> None:
        word, parts = statement.word, statement.parts
        if word in ("line", "arc", "point"):
            self.move()
            if parts[-2]:
                self.steps.switch(parts[-2], parts[-1] == "1")
            self._begin(statement, places)
        elif word == "speed":
            self.speed = 1e-3 * float(parts[0])
        elif word == "share":
            self.share = float(parts[0])
        elif word == "near":
            self.near = 1e-3 * float(parts[0])
            if not self.near > 0.0:
                raise statement.error("a neighbourhood must be positive")
        elif word == "stop":
            self.near = 0.0
            self.move()
        elif word == "output":
            self.move()
            self.steps.switch(parts[0], parts[1] == "1")
        elif word == "wait":
            if self.pending is not None:
                raise statement.error("a wait before the arm has come to rest")
            self.steps.wait(float(parts[0]))
        elif self.steps.moves or self.pending is not None:
            raise statement.misplaced("after the first move")
        elif word == "tool":
            self.tool = read_pose(parts[0].split(","), from_fixed_xyz)
        else:
            self.settings.append(parts[0])

    def move(self) -> None:
        """End the last move: at rest, or in a blend of the smaller neighbourhood before it and before the next one."""
        if (step := self.pending) is not None:
            zone = min(self.pending_near, self.near)
            at_end = float("nan") if zone == 0.0 else zone
            self.steps.moves.append(replace(step, fine=zone == 0.0, zone=at_end))
        self.pending = None

    def _begin(self, statement: Statement, places: Places) -> None:
        word, kind = statement.word, "J" if statement.word == "point" else "P"
        keys = [f"{kind}{key}" for key in statement.parts[:-2]]
        if missing := next((key for key in keys if key not in places), None):
            raise statement.error(f"there is no position {missing}")
        self.pending_near = self.near
        numbers, flag = places[keys[-1]]
        if word == "point":
            self.pending = ProgramStep(False, False, np.radians(numbers), self.share)
            return
        self.said.append(flag)
        pose = self._pose(numbers)
        via = None
        if word == "arc":
            before = self.steps.moves[-1] if self.steps.moves else None
            begin, via = self._pose(places[keys[0]][0]), self._pose(places[keys[1]][0])
            if before is None or (before.linear and np.abs(before.target - begin).max() > 1e-9):
                raise statement.error("an arc does not begin where the move before it ends")
        self.pending = ProgramStep(True, False, pose, self.speed, branch=branch_of(int(flag.split(",")[0])), via=via)

    def _pose(self, values: list[float]) -> Array:
        """A pose in the part frame."""
        return pose_of(self.T_part_base @ matrix_of(read_pose(values, from_fixed_xyz)))


def _program(text: str, name: str) -> tuple[list[Statement], Places]:
    """Statements and positions of a file."""
    statements: list[Statement] = []
    places: Places = {}
    ended = False
    for line, raw in enumerate(text.split("\n"), 1):
        if ended and raw:
            match = POSITION.fullmatch(raw)
            key = f"P{match[1]}" if match and match[1] else f"J{match[5]}" if match else ""
            if match is None or key in places:
                raise InputError(f"unknown position {raw[:40]!r}, or one that is defined twice", file=name, line=line)
            numbers = [float(value) for value in (match[2] or match[6]).split(",")]
            places[key] = (numbers, f"{match[3]},{match[4]}" if match[1] else "")
        elif not ended:
            inner = re.fullmatch(r"([0-9]+) (.*)", raw, re.ASCII)
            if inner is None or int(inner[1]) != line:
                raise InputError("a line whose number is missing or out of order", file=name, line=line)
            if inner[2].startswith(MARK):
                continue
            statement = GRAMMAR.statement(inner[2], line, name)
            ended = statement.word == "end"
            statements += [] if ended else [statement]
    if not ended:
        raise InputError("no End", file=name)
    return statements, places


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program in the files, with whatever they leave open taken from the plan. InputError for an unknown line."""
    read, _ = read_melfa({file.removesuffix(".prg"): text for file, text in files.items()}, melfa_name(plan.name), plan)
    return arm_program(plan, moves_with_arcs(plan), read, MITSUBISHI, np.radians(0.51 * 10.0**-DEGREES))


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the files from the plan beyond rounding and thinning, in words. InputError for an unknown line."""
    texts = {file.removesuffix(".prg"): text for file, text in files.items()}
    read, said = read_melfa(texts, melfa_name(plan.name), plan)
    moves = moves_with_arcs(plan)
    rounding, speeds = np.radians(0.51 * 10.0**-DEGREES), planned_speeds(moves)
    found = arm_differences(plan, moves, read, MITSUBISHI, rounding, speeds, zones=planned_zones(plan, moves))
    planned = [each for each, linear in zip(flags(plan, moves), moves.linear.tolist(), strict=True) if linear]
    wrong = sum(a != b for a, b in zip(said, planned, strict=False))
    return [*found, *([f"structure flags differ at {wrong} targets"] if wrong else [])]
