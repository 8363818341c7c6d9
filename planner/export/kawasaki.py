"""AS language for Kawasaki's controllers (D to F series): writer, reader, and check against the plan."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.arms import (
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
from planner.export.euler import from_turning_zyz, read_pose, turning_zyz, written
from planner.export.fit import to_matrix
from planner.export.grammar import NUMBER, SIX_NUMBERS, Grammar, Statement, inlined
from planner.export.moves import Moves, MoveSection, move_radii, moves_with_arcs, sections
from planner.export.parts import in_files, numbered
from planner.export.program import RobotProgram, about
from planner.export.rapid.text import module_name
from planner.export.speeds import stepped_speeds
from planner.export.support import by_bead, output_numbers, outputs_about
from planner.export.text import ascii_comment, number, resting

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# Kawasaki's axes and frames (its own URDF files, khi_robot): at zero the arm is straight up and faces +y of the base
# frame, whose origin is at the foot, and the flange's frame is parallel to the base's. JT1, JT3 and JT5 have the
# opposite sense to ours. O A T are turns about z, the new y and the new z.

KAWASAKI = Convention(
    axes=signed(-1.0, 1.0, -1.0, 1.0, -1.0, 1.0),
    offset=np.array([0.0, 0.0, -0.5 * np.pi, 0.0, 0.0, 0.0]),
    flange=-0.5 * np.pi,
    base=-0.5 * np.pi,
)

# ----------------------------------------------------------------------------------------------------
# Writer: one file with a main program, and one program for each stretch of beads.
#
# Targets are inline. Speed and accuracy, the distance at which the next motion begins, hold until they are set again.
# BREAK marks where the arm comes to rest. With PREFETCH.SIGINS off, a signal is switched when its pose is reached. BASE
# is the part's frame while the program runs.

LONGEST_NAME = 15
MOST_MOVES = 2000  # of a program
MARK = ";"
WAIT = "TWAIT {:.3f}"
MM, DEGREES = 3, 4  # decimals
SPEED = 2  # decimals of mm/s
STEPS = 100.0  # of accuracy, per mm
BEGIN = ("CP ON", "PREFETCH.SIGINS OFF", "ABS.SPEED ON")


def as_name(name: str) -> str:
    """A problem's name in lower-case letters and digits, at most 15 of them."""
    return module_name(name, LONGEST_NAME).lower()


def write(plan: Plan) -> dict[str, str]:
    """The file of a verified plan (ASCII, mm, degrees)."""
    name, moves = as_name(plan.name), moves_with_arcs(plan)
    own = in_files(sections(plan, moves), MOST_MOVES)
    names = [numbered(name, k, LONGEST_NAME) for k in range(1, len(own) + 1)]
    off = [f"SIGNAL -{k}" for k in output_numbers(plan.problem).values()]
    start = _joints(KAWASAKI.counted(plan.trajectory.q[:1, plan.cell.own]))[0]
    lines = [
        f".PROGRAM {name}()",
        *_header(plan),
        *(f"  {text}" for text in BEGIN),
        f"  TOOL {_pose(KAWASAKI.tool(plan.cell))}",
        f"  BASE {_pose(KAWASAKI.part(plan.cell))}",
        *(f"  {text}" for text in off),
        f"  SPEED {percent(plan, moves)[0]} ALWAYS",
        f"  JMOVE {start}",
        "  BREAK",
        *resting(moves.waits.get(-1, ()), MARK, WAIT, 2),
        *(f"  CALL {each}" for each in names),
        *(f"  {text}" for text in off),
        "  BASE NULL",
        ".END",
    ]
    targets = _targets(plan, moves)
    for each, group in zip(names, own, strict=True):
        lines += [f".PROGRAM {each}()", *_part(plan, moves, group, targets), ".END"]
    return {f"{name}.as": "\n".join([*lines, ""])}


def planned_speeds(moves: Moves) -> Array:
    """Speed (m) [m/s] written for each line."""
    return stepped_speeds(moves, 1e-3 * 10.0**-SPEED)


def planned_zones(plan: Plan, moves: Moves) -> Array:
    """Accuracy (m) [m] of each move, as rounded in the file; 0 where it stops."""
    radii = move_radii(plan, moves)
    out: Array = np.where(
        radii > 0.0, np.maximum(np.floor(radii * 1e3 * STEPS * (1.0 + 1e-9)), 1.0) / STEPS * 1e-3, 0.0
    )
    return out


def _header(plan: Plan) -> list[str]:
    texts = [
        *about(plan),
        *outputs_about(plan.problem),
        f"JT1 to JT6, as Kawasaki counts: {', '.join(plan.cell.arm.names)}",
        "Load: set it by WEIGHT before the first run",
    ]
    return [ascii_comment(MARK, text, 2) for text in texts]


def _pose(T: Array) -> str:
    return _poses(T[None, :3, 3], T[None, :3, :3])[0]


def _poses(position: Array, R: Array) -> list[str]:
    rows = np.column_stack([np.round(position * 1e3, MM) + 0.0, written(turning_zyz(R), DEGREES)])
    form = "TRANS(" + ",".join([f"%.{MM}f"] * 3 + [f"%.{DEGREES}f"] * 3) + ")"
    return [form % tuple(row) for row in rows.tolist()]


def _joints(axes: Array) -> list[str]:
    form = "#PPOINT(" + ",".join([f"%.{DEGREES}f"] * 6) + ")"
    return [form % tuple(row) for row in (np.round(np.degrees(axes), DEGREES) + 0.0).tolist()]


def _targets(plan: Plan, moves: Moves) -> list[list[str]]:
    """The statements of each move; two for an arc."""
    joints = _joints(KAWASAKI.counted(plan.trajectory.q[moves.sample][:, plan.cell.own]))
    lines = _poses(moves.targets.position[1:], to_matrix(moves.targets.quat[1:]))
    vias = _poses(moves.via.position, to_matrix(moves.via.quat))
    return [
        [f"  C1MOVE {via}", f"  C2MOVE {line}"] if circular else [f"  LMOVE {line}" if linear else f"  JMOVE {axes}"]
        for linear, circular, via, line, axes in zip(
            moves.linear.tolist(), moves.circular.tolist(), vias, lines, joints, strict=True
        )
    ]


def _part(plan: Plan, moves: Moves, own: list[MoveSection], targets: list[list[str]]) -> list[str]:
    """Statements of sections."""
    bead = plan.trajectory.bead
    outputs = by_bead(plan, list(output_numbers(plan.problem).values()))
    speeds, shares = (planned_speeds(moves) * 1e3).tolist(), percent(plan, moves)
    radii = planned_zones(plan, moves).tolist()
    speed, accuracy, lines = "", "", []
    for section in own:
        lines += [ascii_comment(MARK, section.about, 2)] if section.about else []
        for i in section.moves:
            begins, ends = (outputs[bead[at]] for at in (moves.sample[i - 1] if i else 0, moves.sample[i]))
            lines += [f"  SIGNAL {begins}"] if moves.on_start[i] else []
            wanted = f"{number(speeds[i], SPEED)} MM/S" if moves.linear[i] else f"{shares[i]}"
            if wanted != speed:
                speed = wanted
                lines.append(f"  SPEED {speed} ALWAYS")
            near = number(radii[i] * 1e3, 2)
            if radii[i] > 0.0 and near != accuracy:
                accuracy = near
                lines.append(f"  ACCURACY {accuracy} ALWAYS")
            lines += targets[i]
            lines += ["  BREAK"] if radii[i] == 0.0 else []
            lines += [f"  SIGNAL {ends}"] if moves.on_end[i] else []
            lines += [f"  SIGNAL -{ends}"] if moves.off_end[i] else []
            lines += resting(moves.waits.get(i, ()), MARK, WAIT, 2)
    return lines


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

NAME = r"[a-z][a-z0-9_]{0,14}"
GRAMMAR = Grammar.of(
    "AS",
    MARK,
    {
        "line": rf"(?:LMOVE|C2MOVE) TRANS\({SIX_NUMBERS}\)",
        "via": rf"C1MOVE TRANS\({SIX_NUMBERS}\)",
        "point": rf"JMOVE #PPOINT\({SIX_NUMBERS}\)",
        "stop": r"BREAK",
        "speed": rf"SPEED ({NUMBER}) MM/S ALWAYS",
        "share": r"SPEED ([0-9]{1,3}) ALWAYS",
        "accuracy": rf"ACCURACY ({NUMBER}) ALWAYS",
        "output": r"SIGNAL (-?)([0-9]{1,4})",
        "wait": rf"TWAIT ({NUMBER})",
        "call": rf"CALL ({NAME})",
        "frame": rf"(TOOL|BASE) TRANS\({SIX_NUMBERS}\)",
        "reset": r"BASE NULL",
        "switch": r"(CP ON|PREFETCH\.SIGINS OFF|ABS\.SPEED ON)",
        "define": rf"\.PROGRAM ({NAME})\(\)",
        "end": r"\.END",
    },
)
_read_pose = partial(read_pose, of_angles=from_turning_zyz)


def read_kawasaki(text: str, plan: Plan) -> ArmProgram:
    """Program from AS text as `write` writes it.

    Raises InputError, with the line, for an unknown or misplaced statement or name.
    """
    bodies = GRAMMAR.bodies(text, "no complete program")
    main = next(iter(bodies), "")
    steps, frames, switches = ProgramSteps(), {}, []
    speed, share, accuracy = np.nan, np.nan, np.nan
    pending: list[Statement] = []  # a move, until it is known whether it stops; both statements of an arc

    def move(fine: bool) -> None:
        if not pending:
            return
        *first, last = pending
        if bool(first) != last.text.startswith("C2MOVE"):
            raise last.error("C1MOVE and C2MOVE must come in pairs")
        if not (fine or accuracy > 0.0):
            raise last.error("a move that does not stop needs an accuracy")
        numbers = [float(value) for value in last.parts[0].split(",")]
        via = _read_pose(first[0].parts[0].split(",")) if first else None
        if last.word == "line":
            steps.moves.append(ProgramStep(True, fine, _read_pose(numbers), speed, accuracy, via=via))
        else:
            steps.moves.append(ProgramStep(False, fine, np.radians(numbers), share, accuracy))
        pending.clear()

    for statement in inlined(bodies, main, "program"):
        word, parts = statement.word, statement.parts
        if word == "stop":
            if not pending:
                raise statement.misplaced("without a move before it")
            move(True)
            continue
        if not (pending and pending[-1].word == "via" and word == "line"):
            move(False)
        if word in ("line", "via", "point"):
            pending.append(statement)
        elif word == "speed":
            speed, share = 1e-3 * float(parts[0]), np.nan
        elif word == "share":
            speed, share = np.nan, float(parts[0])
        elif word == "accuracy":
            accuracy = 1e-3 * float(parts[0])
        elif word == "output":
            steps.switch(parts[1], not parts[0])
        elif word == "wait":
            steps.wait(float(parts[0]))
        elif word == "reset":
            frames["NULL"] = np.array([])
        elif steps.moves or parts[0] in frames:
            raise statement.misplaced("after the first move, or twice")
        elif word == "frame":
            frames[parts[0]] = _read_pose(parts[1].split(","))
        else:
            switches.append(parts[0])
    if pending or set(frames) != {"TOOL", "BASE", "NULL"} or tuple(switches) != BEGIN:
        raise InputError("no stop at the end, or tool, base and switches are not set and reset", file=GRAMMAR.file)
    return read_arm(main, steps, frames["TOOL"], frames["BASE"], forward_of(plan.cell, KAWASAKI), GRAMMAR.file)


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program in the files, with whatever they leave open taken from the plan. InputError for an unknown line."""
    read = read_kawasaki(files[f"{as_name(plan.name)}.as"], plan)
    return arm_program(plan, moves_with_arcs(plan), read, KAWASAKI, np.radians(0.51 * 10.0**-DEGREES))


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the file from the plan beyond rounding and thinning, in words. InputError for an unknown line."""
    read = read_kawasaki(files[f"{as_name(plan.name)}.as"], plan)
    moves = moves_with_arcs(plan)
    rounding, speeds = np.radians(0.51 * 10.0**-DEGREES), planned_speeds(moves)
    return arm_differences(plan, moves, read, KAWASAKI, rounding, speeds, zones=planned_zones(plan, moves))
