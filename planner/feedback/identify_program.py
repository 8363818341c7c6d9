"""Test programs in the languages of controllers, and beside them a file that says what was asked, for the reader."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.cell.kinematics.inverse import OnRail
from planner.cell.kinematics.placed_wrist import PlacedWrist
from planner.export.external import external_written
from planner.export.joint_trajectory import SplineKnots, message
from planner.export.krl import OFFSETS as KUKA_OFFSETS
from planner.export.krl import SIGNS as KUKA_SIGNS
from planner.export.krl import axes, krl_name
from planner.export.languages import LANGUAGES
from planner.export.program import ProblemSetup
from planner.export.rapid.text import comment, module_name
from planner.export.rapid.writer import TOOL_LOAD, external_text, pose_text
from planner.export.text import ascii_comment, number
from planner.feedback.identify_moves import AskedMove, AskedMoves
from planner.feedback.identify_profile import MotionLimits, move_profile
from planner.problem import Problem

TEST_LANGUAGES = ("rapid", "urscript", "krl", "joint_trajectory")
FORMAT = "beadwise identify 1"
LARGEST_FILE = 5_000_000  # bytes: some 50,000 moves
TO_START = 0.1  # of the joints' speed, on the way to the start
UNLIMITED = 9999  # mm/s and deg/s: RAPID takes what the joints can do


# ----------------------------------------------------------------------------------------------------
# The controller's joints, as it counts them.


def language_of(problem: Problem, cell: Cell, asked: str | None) -> str:
    """The language of a test program: as asked, or the arm's own. Raises InputError for one that does not do."""
    language = asked or cell.arm_robot.language
    if language not in TEST_LANGUAGES:
        reason = f"test programs are written in {', '.join(TEST_LANGUAGES)}, and {cell.arm_robot.name} takes {language}"
        raise InputError(reason, field="--language", hint="move it by a program of your own that asks the same moves")
    if (reason_not := LANGUAGES[language].unsupported(ProblemSetup(problem, cell))) is not None:
        raise InputError(f"{language} cannot say this: {reason_not}", field="--language")
    return language


def counting(cell: Cell, language: str) -> tuple[str, Array, Array]:
    """The language, with signs and offsets (n each) [rad, m] of its controller's joints: signs * q + offsets."""
    signs, offsets = np.ones(len(cell.joint_names)), np.zeros(len(cell.joint_names))
    inverse = cell.inverse.arm if isinstance(cell.inverse, OnRail) else cell.inverse
    if LANGUAGES[language].counted and isinstance(inverse, PlacedWrist):
        signs[cell.own], offsets[cell.own] = inverse.signs, inverse.offsets
    if language == "krl":
        signs[cell.own] *= KUKA_SIGNS
        offsets[cell.own] = KUKA_SIGNS * offsets[cell.own] + KUKA_OFFSETS
    return language, signs, offsets


# ----------------------------------------------------------------------------------------------------
# Programs.


def program_files(cell: Cell, asked: AskedMoves, station: str) -> dict[str, str]:
    """File name → text of the test program; station: the name of the mechanical unit that holds the part, for RAPID."""
    writers: dict[str, Callable[[Cell, AskedMoves, str], dict[str, str]]] = {
        "rapid": _rapid,
        "urscript": _urscript,
        "krl": _krl,
        "joint_trajectory": _joint_trajectory,
    }
    return writers[asked.language](cell, asked, station)


def _about(asked: AskedMoves) -> list[str]:
    joints = len({move.joint for move in asked.moves})
    return [
        f"Problem {asked.problem}: {len(asked.moves)} moves of {joints} joints, one after the other, that show their limits",
        "Written by beadwise identify; record all joints from before the first move until after the last one.",
        "Bring the robot near the first posture by hand: the way there is not checked. Then clear its space.",
    ]


def _steps(asked: AskedMoves) -> list[tuple[AskedMove | None, float]]:
    """Each move with the rest behind it, the first without a move."""
    return list(zip((None, *asked.moves), asked.rests.tolist(), strict=True))


def _rapid(cell: Cell, asked: AskedMoves, station: str) -> dict[str, str]:
    name = module_name(f"identify_{asked.problem}")
    q, limits = asked.postures, cell.limits
    own = np.degrees(q * asked.signs + asked.offsets)[:, cell.own]
    external = external_text(external_written(cell, q[:, cell.besides]))
    unit = [] if cell.holder_robot is None else [station]
    lines = [
        f"MODULE {name}",
        *(comment(text) for text in _about(asked)),
        f"    TASK PERS tooldata tIdentify:=[TRUE,{pose_text(cell.T_flange_nozzle)},{TOOL_LOAD}];",
        comment("The load above is assumed: set your own, it decides what accelerations the controller allows"),
        "",
        "    PROC main()",
        *(f"        ActUnit {each};" for each in unit),
        "        AccSet 100,100;",
        "        VelSet 100,9999;",
    ]
    for (move, rest), joints, others in zip(_steps(asked), own, external, strict=True):
        share = TO_START if move is None else move.share
        j = None if move is None else move.joint
        # of one joint that turns, the tool's turning speed is the joint's own
        degrees = np.degrees(limits.velocity) if j is None else np.degrees(limits.velocity[[j]])
        turning = UNLIMITED if share == 1.0 else round(share * float(degrees.min()), 3)
        sliding = UNLIMITED if share == 1.0 or j is None else round(share * float(limits.velocity[j]) * 1e3, 3)
        tip = UNLIMITED if move is not None else 100
        speed = f"[{tip},{turning:g},{sliding:g},{turning:g}]"
        text = ",".join(number(value, 5) for value in joints)
        lines += [
            f"        MoveAbsJ [[{text}],[{others}]]\\NoEOffs,{speed},fine,tIdentify;",
            f"        WaitTime \\InPos,{rest:g};",
        ]
    lines += [*(f"        DeactUnit {each};" for each in unit), "    ENDPROC", "ENDMODULE", ""]
    return {f"{name}.mod": "\n".join(lines)}


def _krl(cell: Cell, asked: AskedMoves, station: str) -> dict[str, str]:
    name = krl_name(f"identify_{asked.problem}")
    q = asked.postures
    own = np.degrees(q * asked.signs + asked.offsets)[:, cell.own]
    external = external_written(cell, q[:, cell.besides])
    lines = [
        "&ACCESS RVP",
        "&REL 1",
        f"DEF {name}()",
        *(ascii_comment(";", text, 2) for text in _about(asked)),
        "  BAS(#INITMOV,0)",
        "  BAS(#ACC_PTP,100)",
    ]
    percent = 0
    for (move, rest), joints, others in zip(_steps(asked), own, external, strict=True):
        wanted = round(100.0 * (TO_START if move is None else move.share))
        lines += [f"  BAS(#VEL_PTP,{wanted})"] if wanted != percent else []
        lines += [f"  PTP {{E6AXIS: {axes(joints, others)}}}", f"  WAIT SEC {rest:.3f}"]
        percent = wanted
    return {f"{name}.src": "\n".join([*lines, "END", ""])}


def _urscript(cell: Cell, asked: AskedMoves, station: str) -> dict[str, str]:
    name = module_name(f"identify_{asked.problem}")
    limits = cell.limits
    lines = [
        *(ascii_comment("#", text) for text in _about(asked)),
        ascii_comment("#", "a= and v= are those of the robot's file: it shows whether the robot keeps to them"),
        f"def {name}():",
    ]
    for (move, rest), q in zip(_steps(asked), asked.postures, strict=True):
        speed, turn = limits.velocity.min() * TO_START, limits.acceleration.min() * TO_START
        if move is not None:
            speed, turn = move.share * limits.velocity[move.joint], limits.acceleration[move.joint]
        text = ", ".join(number(value, 6) for value in q)
        lines += [
            f"  movej([{text}], a={number(turn, 4)}, v={number(speed, 4)}, r=0)",
            f"  sleep({rest:.3f})",
        ]
    return {f"{name}.script": "\n".join([*lines, "end", ""])}


def _joint_trajectory(cell: Cell, asked: AskedMoves, station: str) -> dict[str, str]:
    """ROS's message: the trajectory's own profiles, in which cubics of constant jerk meet at the points."""
    n, q, rests = len(asked.start), asked.postures, asked.rests
    time, points = [0.0], [np.stack([asked.start, np.zeros(n), np.zeros(n)])]
    now = float(rests[0])
    for move, before, rest in zip(asked.moves, q, rests[1:].tolist(), strict=False):
        profile = move_profile(abs(move.end - move.start), asked_limits(asked, cell, move))
        knots = np.unique(np.round(np.append(profile.start, profile.total), 9))
        side, states = float(np.sign(move.end - move.start)), profile.states_at(knots)
        for t, state in zip(knots.tolist(), side * states, strict=True):
            point = np.stack([before, np.zeros(n), np.zeros(n)])
            point[:, move.joint] += state
            time.append(now + t)
            points.append(point)
        now += profile.total + rest
    time.append(now)
    points.append(np.stack([asked.start, np.zeros(n), np.zeros(n)]))
    table = np.array(points)
    return {
        f"{asked.problem}_identify_joint_trajectory.json": message(
            asked.joint_names, SplineKnots(np.array(time), table[:, 0], table[:, 1], table[:, 2])
        )
    }


def asked_limits(asked: AskedMoves, cell: Cell, move: AskedMove) -> MotionLimits:
    """The limits of a move's joint in the cell, at the move's share of the speed."""
    limits, j = cell.limits, move.joint
    acceleration, jerk = float(limits.acceleration[j]), float(limits.jerk[j])
    return MotionLimits(move.share * float(limits.velocity[j]), acceleration, jerk, acceleration, jerk)


# ----------------------------------------------------------------------------------------------------
# What was asked, as a file.


def asked_name(problem: str) -> str:
    """File of what a test program asks."""
    return f"{problem}_asked.json"


def asked_text(asked: AskedMoves) -> str:
    """JSON of what a test program asks: degrees, and mm of joints that slide."""
    units = _file_units(asked.sliding, len(asked.start))
    names = asked.joint_names
    data = {
        "format": FORMAT,
        "problem": asked.problem,
        "language": asked.language,
        "joints": [
            {
                "name": name,
                "unit": "mm" if j in asked.sliding else "deg",
                "start": round(float(asked.start[j] / units[j]), 6),
                "controller_sign": int(asked.signs[j]),
                "controller_offset": round(float(asked.offsets[j] / units[j]), 6),
                **{
                    f"asked_{what}": None if value is None else float(value[j])
                    for what, value in zip(("speed", "acceleration", "jerk"), asked.asked, strict=True)
                },
            }
            for j, name in enumerate(names)
        ],
        "moves": [
            {
                "joint": names[move.joint],
                "from": round(move.start / float(units[move.joint]), 6),
                "to": round(move.end / float(units[move.joint]), 6),
                "share_of_speed": move.share,
            }
            for move in asked.moves
        ],
    }
    return json.dumps(data, indent=1) + "\n"


def read_asked(path: Path, problem: Problem, cell: Cell) -> AskedMoves:
    """What a test program asked of this cell. Raises InputError for a file that is none, or of another cell."""
    wrong = "is not what a test program asked"
    hint = f"the file {asked_name(problem.name)} that `identify write` made beside its program"
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"larger than {LARGEST_FILE // 10**6} MB", file=path)
        data = json.loads(path.read_text("utf-8"))
        if data["format"] != FORMAT:
            raise InputError(f"{wrong}: its format is {str(data['format'])[:40]!r}", file=path, hint=hint)
        joints, moves = data["joints"], data["moves"]
        names = tuple(str(joint["name"]) for joint in joints)
        _check_cell(path, names, joints, cell)
        units = _file_units(cell.limits.sliding, len(names))
        columns = {key: _numbers(joints, key) for key in ("start", "controller_sign", "controller_offset")}
        asked = [_optional(joints, f"asked_{what}") for what in ("speed", "acceleration", "jerk")]
        found = tuple(_move(move, names, units) for move in moves)
    except FileNotFoundError:
        raise InputError("there is no such file", file=path, hint=f"{hint}; --asked names it") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{wrong}: {error}", file=path, hint=hint) from error
    proper = all(np.isfinite(column).all() for column in columns.values())
    if not found or not proper or (np.abs(columns["controller_sign"]) != 1.0).any():
        raise InputError(f"{wrong}: it has no moves, or places that are no numbers", file=path, hint=hint)
    return AskedMoves(
        problem=str(data["problem"]),
        language=str(data["language"]),
        joint_names=names,
        sliding=cell.limits.sliding,
        start=columns["start"] * units,
        moves=found,
        asked=(asked[0], asked[1], asked[2]),
        signs=columns["controller_sign"],
        offsets=columns["controller_offset"] * units,
    )


def _check_cell(path: Path, names: tuple[str, ...], joints: list[Any], cell: Cell) -> None:
    if names != cell.joint_names:
        reason = f"was asked of {', '.join(names)[:200]}, and this cell has {', '.join(cell.joint_names)}"
        raise InputError(reason, file=path, hint="name the problem for which the program was written")
    units = ["mm" if j in cell.limits.sliding else "deg" for j in range(len(names))]
    if [joint["unit"] for joint in joints] != units:
        raise InputError("joints turn here that slide in this cell, or the other way round", file=path)


def _move(data: dict[str, Any], names: tuple[str, ...], units: Array) -> AskedMove:
    j = names.index(str(data["joint"]))
    start, end, share = float(data["from"]), float(data["to"]), float(data["share_of_speed"])
    if not (0.0 < share <= 1.0 and start != end and np.isfinite([start, end]).all()):
        raise ValueError("a move that goes nowhere")
    return AskedMove(j, start * float(units[j]), end * float(units[j]), share)


def _numbers(rows: list[Any], key: str) -> Array:
    return np.array([float(row[key]) for row in rows])


def _optional(rows: list[Any], key: str) -> Array | None:
    values = [row[key] for row in rows]
    return None if any(value is None for value in values) else np.array([float(value) for value in values])


def _file_units(sliding: tuple[int, ...], n: int) -> Array:
    """What the file's numbers are in rad and m (n)."""
    units = np.full(n, np.pi / 180.0)
    units[list(sliding)] = 1e-3
    return units
