"""The moves of a test program, chosen so that a recording shows what each joint can do, in controllers' languages.

One joint moves after another, within the free space around a posture. Short moves end before the acceleration is
reached and show the jerk, longer ones the acceleration, the longest the speed. Each joint starts at one end of its free
space and moves out and back over doubling distances at full speed, then over part of the way at reduced speed. Rests
separate the moves in a recording. A file next to the program states what was requested, for reading the recording.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell, Limits
from planner.collision.scene import Obstacles
from planner.export.external import external_written
from planner.export.joint_trajectory import SplineKnots, message
from planner.export.krl import axes, krl_name
from planner.export.languages import LANGUAGES
from planner.export.program import ProblemSetup
from planner.export.rapid.declarations import TOOL_LOAD, external_text, pose_text
from planner.export.rapid.text import comment, module_name
from planner.export.text import ascii_comment, number
from planner.feedback.identify_profile import MotionLimits, move_profile
from planner.feedback.readings import JointCounting, counting
from planner.motion.travel.clearance import SWEPT
from planner.problem import Problem

# Least and greatest length of moves, of revolute joints [rad] and of prismatic ones [m]. At 0.5 degrees an arm with
# 15 rad/s² and 750 rad/s³ is limited by its jerk alone. In longer moves, the jerk only rounds the profile by less than
# a noise of 0.01 degrees; in shorter ones, noise weighs more. Hence several short moves, each repeated.
SHORTEST = (np.radians(0.25), 1e-3)
LEAST_MOVE = 0.49  # × the shortest: the move to an end of the space may be this short
SLIDING_UNIT = 1e-3  # m: unit of prismatic joints in the file
SHORT = 5.0  # × the shortest: moves up to this length are repeated
REPEATS = 3
USUAL_MOST = (np.radians(180.0), 1.0)
END_ROOM = (np.radians(2.0), 10e-3)  # rad, m kept free at the ends of the joints' ranges
LEAST_SPACE = 8.0  # × the shortest move: a joint with less space shows nothing, and is left out
SLOW_SHARES = (0.5, 0.25)  # of the joint's speed; these moves cover the same share of the whole space
REST = 0.5  # s between moves: servos settle, and a recording shows that all joints stand
JOINT_REST = 1.0  # s before another joint's moves
END = "the end of its range"
CLEAR = 2e-3  # m beyond the required clearance: pairs farther apart are not examined


@dataclass(frozen=True)
class FreeSpace:
    """How far a joint may move alone while all others stand at the start posture.

    low, high  ends, as joint positions [rad, m]
    bounds     what limits it, in words, at low and at high
    """

    low: float
    high: float
    bounds: tuple[str, str]


@dataclass(frozen=True)
class AskedMove:
    """A joint (its index) moves from one position to another [rad, m] at a share of its speed; the others stand."""

    joint: int
    start: float
    end: float
    share: float


@dataclass(frozen=True)
class AskedMoves:
    """The moves of a test program for a cell's joints (n): from a start posture (n), one after another, and back there.

    asked   limits of speed, acceleration, jerk (n each) that the program itself sets [rad, m]; None if the controller
            uses its own
    counted how the controller counts the joints
    """

    problem: str
    language: str
    joint_names: tuple[str, ...]
    sliding: tuple[int, ...]
    start: Array
    moves: tuple[AskedMove, ...]
    asked: tuple[Array | None, Array | None, Array | None]
    counted: JointCounting

    @property
    def postures(self) -> Array:
        """Where the joints rest (m + 1, n): at the start, and after each of m moves."""
        out = np.tile(self.start, (len(self.moves) + 1, 1))
        for k, move in enumerate(self.moves, 1):
            out[k:, move.joint] = move.end
        return out

    @property
    def rests(self) -> Array:
        """How long the joints rest (m + 1) [s] there."""
        joints = np.array([move.joint for move in self.moves])
        changes = np.concatenate([np.ones(1, bool), np.diff(joints) != 0, np.ones(1, bool)])
        return np.where(changes, JOINT_REST, REST)


def start_posture(cell: Cell, given: Sequence[float] | None) -> Array:
    """The posture (n) [rad, m] from values in degrees, or mm for joints that slide; home if none are given.

    Raises InputError for a wrong number of values, and for one outside its joint's range.
    """
    if given is None:
        return cell.home.copy()
    names = cell.joint_names
    if len(given) != len(names):
        raise InputError(f"{len(given)} values for {len(names)} joints", field="--start", hint=", ".join(names))
    q = np.asarray(given, dtype=np.float64) * _units(cell)
    outside = (q < cell.limits.q_min) | (q > cell.limits.q_max)
    if outside.any():
        j = int(np.argmax(outside))
        low, high = np.array([cell.limits.q_min[j], cell.limits.q_max[j]]) / _units(cell)[j]
        raise InputError(f"{names[j]} is outside its range", field="--start", hint=f"{low:.0f} to {high:.0f}")
    return q


def greatest_lengths(cell: Cell, given: Sequence[float] | None) -> Array:
    """Greatest length of each joint's space (n) [rad, m], from one value for all in degrees, or one for each joint, in
    mm if it slides. Raises InputError for a wrong number of values."""
    n = len(cell.joint_names)
    usual = np.where(cell.limits.turns, *USUAL_MOST)
    if given is None:
        return usual
    if len(given) == 1:
        return np.where(cell.limits.turns, np.radians(given[0]), usual)
    if len(given) != n:
        raise InputError(f"{len(given)} values for {n} joints", field="--most", hint=", ".join(cell.joint_names))
    return np.asarray(given, dtype=np.float64) * _units(cell)


def free_spaces(cell: Cell, obstacles: Obstacles, start: Array, most: Array) -> tuple[FreeSpace, ...]:
    """The free space of each joint around a start posture (n): clear of the cell, and of the finished print.

    most (n)  greatest length of each space [rad, m]
    Raises InputError if the start posture itself is not clear.
    """
    _check_start(obstacles, start)
    return tuple(_space(cell, obstacles, start, j, float(most[j])) for j in range(len(start)))


def common_space(spaces: Sequence[FreeSpace]) -> FreeSpace:
    """The space of a joint that is free in all of several cells."""
    low, high = max(spaces, key=lambda each: each.low), min(spaces, key=lambda each: each.high)
    return FreeSpace(low.low, high.high, (low.bounds[0], high.bounds[1]))


def asked_moves(problem: Problem, cell: Cell, start: Array, spaces: Sequence[FreeSpace], language: str) -> AskedMoves:
    """The moves of a test program in a language; joints without enough space are left out.

    Raises InputError if no joint has enough space.
    """
    moves: list[AskedMove] = []
    for j, space in enumerate(spaces):
        if moves_enough(cell, j, space):
            moves += _joint_moves(j, float(start[j]), space, SHORTEST[int(not cell.limits.turns[j])])
    if not moves:
        raise InputError("no joint has space to move: choose another posture", field="--start")
    limits = cell.limits
    own = {"urscript": (True, True, False), "joint_trajectory": (True, True, True)}.get(language, (False, False, False))
    values = (limits.velocity, limits.acceleration, limits.jerk)
    speed, acceleration, jerk = (value if is_asked else None for value, is_asked in zip(values, own, strict=True))
    return AskedMoves(
        problem=problem.name,
        language=language,
        joint_names=cell.joint_names,
        sliding=limits.sliding,
        start=start,
        moves=tuple(moves),
        asked=(speed, acceleration, jerk),
        counted=counting(cell, language),
    )


def moves_enough(cell: Cell, j: int, space: FreeSpace) -> bool:
    """Whether a joint has enough space to show anything."""
    return space.high - space.low >= LEAST_SPACE * SHORTEST[int(not cell.limits.turns[j])]


def _joint_moves(j: int, home: float, space: FreeSpace, shortest: float) -> list[AskedMove]:
    whole = space.high - space.low
    # distances double up to the whole space, without one that is hardly less than it
    count = int(np.log2(whole / shortest) - 0.5)
    distances = [*(shortest * 2.0**k for k in range(count + 1)), whole]
    distances = [each for each in distances for _ in range(REPEATS if each <= SHORT * shortest else 1)]
    out = [AskedMove(j, home, space.low, 1.0)] if home - space.low > 0.5 * shortest else []
    base = out[-1].end if out else home
    for distance, share in [*((each, 1.0) for each in distances), *((share * whole, share) for share in SLOW_SHARES)]:
        there = min(base + distance, space.high)
        out += [AskedMove(j, base, there, share), AskedMove(j, there, base, share)]
    return [*out, AskedMove(j, base, home, 1.0)] if base != home else out


def _check_start(obstacles: Obstacles, start: Array) -> None:
    margin, which = obstacles.margins(start[None], np.array([np.inf]), CLEAR)
    if margin[0] < 0.0:
        one, other = obstacles.names(int(which[0]))
        raise InputError(
            f"{one} and {other} are {-1e3 * margin[0]:.1f} mm too close at the start posture",
            field="--start",
            hint="choose another posture",
        )


def _space(cell: Cell, obstacles: Obstacles, start: Array, j: int, most: float) -> FreeSpace:
    slides = int(not cell.limits.turns[j])
    low, high = cell.limits.q_min[j] + END_ROOM[slides], cell.limits.q_max[j] - END_ROOM[slides]
    ways = [
        _way(obstacles, start, j, min(most, float(room)), sign)
        for room, sign in ((start[j] - low, -1.0), (high - start[j], 1.0))
    ]
    # split evenly between both sides; what one side lacks is added to the other
    below = min(ways[0][0], max(0.5 * most, most - ways[1][0]))
    above = min(ways[1][0], most - below)
    bounds = [
        "as far as asked" if length < way or way == most else words
        for (way, words), length in zip(ways, (below, above), strict=True)
    ]
    return FreeSpace(float(start[j]) - below, float(start[j]) + above, (bounds[0], bounds[1]))


def _way(obstacles: Obstacles, start: Array, j: int, room: float, sign: float) -> tuple[float, str]:
    """How far a joint may move to one side, up to `room` [rad, m], and what limits it there."""
    if room <= 0.0:
        return 0.0, END
    if not obstacles.any:
        return room, END
    # no point of the cell moves more than SWEPT between postures, so keep half of that as additional clearance
    offsets = np.linspace(0.0, room, max(int(np.ceil(room * float(obstacles.swing[j]) / SWEPT)), 1) + 1)
    q = np.tile(start, (len(offsets), 1))
    q[:, j] += sign * offsets
    margin, which = obstacles.margins(q, np.full(len(q), np.inf), CLEAR)
    blocked = np.flatnonzero(margin < 0.5 * SWEPT)
    if not len(blocked):
        return room, END
    first = int(blocked[0])
    return float(offsets[max(first - 1, 0)]), " near ".join(obstacles.names(int(which[first])))


def _units(cell: Cell) -> Array:
    """Factors (n) from degrees to rad, or from mm to m for joints that slide."""
    return np.where(cell.limits.turns, np.pi / 180.0, 1e-3)


TEST_LANGUAGES = ("rapid", "urscript", "krl", "joint_trajectory")
FORMAT = "beadwise identify 1"
LARGEST_FILE = 5_000_000  # bytes: some 50,000 moves
TO_START = 0.1  # × the joints' speed, on the way to the start
UNLIMITED = 9999  # mm/s and deg/s: RAPID reduces this to what the joints can do


def language_of(problem: Problem, cell: Cell, asked: str | None) -> str:
    """The language of a test program: as requested, or the arm's own. Raises InputError for an unsuitable one.

    A test program only moves joints, so the number of nozzles and corrections learnt from runs do not matter.
    """
    language = asked or cell.arm_robot.language
    if language not in TEST_LANGUAGES:
        reason = f"test programs are written in {', '.join(TEST_LANGUAGES)}, but {cell.arm_robot.name} takes {language}"
        raise InputError(reason, field="--language", hint="write a program of your own that asks for the same moves")
    joints_alone = ProblemSetup(problem.model_copy(update={"as_run": None}), replace(cell, nozzles=()))
    if (reason_not := LANGUAGES[language].unsupported(joints_alone)) is not None:
        raise InputError(f"{language} cannot say this: {reason_not}", field="--language")
    if language == "rapid" and cell.second_arm is not None:
        reason = f"{cell.second_arm.name} moves in a task of its own, but a test program has only one task"
        raise InputError(
            reason,
            field="cell.positioner.free",
            hint="[] keeps it still; for its own limits, use a problem in which it is the arm",
        )
    return language


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
    """Each move with the rest after it; the first entry is a rest without a move."""
    return list(zip((None, *asked.moves), asked.rests.tolist(), strict=True))


def _rapid(cell: Cell, asked: AskedMoves, station: str) -> dict[str, str]:
    name = module_name(f"identify_{asked.problem}")
    q, limits = asked.postures, cell.limits
    own = np.degrees(q * asked.counted.signs + asked.counted.offsets)[:, cell.own]
    external = external_text(external_written(cell, q[:, cell.besides]))
    unit = [] if cell.station is None else [station]
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
        turning, sliding = _axis_speeds(limits, range(len(q[0])) if move is None else (move.joint,), share)
        tip = UNLIMITED if move is not None else 100
        speed = f"[{tip},{turning:g},{sliding:g},{turning:g}]"
        text = ",".join(number(value, 5) for value in joints)
        lines += [
            f"        MoveAbsJ [[{text}],[{others}]]\\NoEOffs,{speed},fine,tIdentify;",
            f"        WaitTime \\InPos,{rest:g};",
        ]
    lines += [*(f"        DeactUnit {each};" for each in unit), "    ENDPROC", "ENDMODULE", ""]
    return {f"{name}.mod": "\n".join(lines)}


def _axis_speeds(limits: Limits, joints: Iterable[int], share: float) -> tuple[float, float]:
    """Speeds of a speeddata at a share of the least speed of some joints: of those that turn [deg/s], also used for the
    tool's reorientation, and of those that slide [mm/s]."""
    speeds = np.where(limits.turns, np.degrees(limits.velocity), 1e3 * limits.velocity)
    own = [[float(speeds[j]) for j in joints if limits.turns[j] == turns] for turns in (True, False)]
    turning, sliding = (round(share * min(each), 3) if each and share < 1.0 else UNLIMITED for each in own)
    return turning, sliding


def _krl(cell: Cell, asked: AskedMoves, station: str) -> dict[str, str]:
    name = krl_name(f"identify_{asked.problem}")
    q = asked.postures
    own = np.degrees(q * asked.counted.signs + asked.counted.offsets)[:, cell.own]
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
    """A ROS message with the move profiles, whose cubics of constant jerk meet at the points."""
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
# The file of the requested moves.


def asked_name(problem: str) -> str:
    """Name of the file of a test program's moves."""
    return f"{problem}_asked.json"


def asked_text(asked: AskedMoves) -> str:
    """JSON of a test program's moves: degrees, or mm for joints that slide."""
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
                "controller_sign": int(asked.counted.signs[j]),
                "controller_offset": round(float(asked.counted.offsets[j] / units[j]), 6),
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
    """Read a test program's moves for this cell. Raises InputError for another kind of file, or another cell's."""
    wrong = "does not say what a test program asked"
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
        for_problem, language = str(data["problem"]), str(data["language"])
    except FileNotFoundError:
        raise InputError("there is no such file", file=path, hint=f"{hint}; --asked names it") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise InputError(f"{wrong}: {error}", file=path, hint=hint) from error
    proper = all(np.isfinite(column).all() for column in columns.values())
    if not found or not proper or (np.abs(columns["controller_sign"]) != 1.0).any():
        raise InputError(f"{wrong}: it has no moves, or values that are not numbers", file=path, hint=hint)
    if any(each is not None and not (np.isfinite(each) & (each > 0.0)).all() for each in asked):
        raise InputError(f"{wrong}: one of its limits is not above 0", file=path, hint=hint)
    return AskedMoves(
        problem=for_problem,
        language=language,
        joint_names=names,
        sliding=cell.limits.sliding,
        start=columns["start"] * units,
        moves=found,
        asked=(asked[0], asked[1], asked[2]),
        counted=JointCounting(columns["controller_sign"], columns["controller_offset"] * units),
    )


def _check_cell(path: Path, names: tuple[str, ...], joints: list[Any], cell: Cell) -> None:
    if names != cell.joint_names:
        reason = f"is for joints {', '.join(names)[:200]}, but this cell has {', '.join(cell.joint_names)}"
        raise InputError(reason, file=path, hint="name the problem for which the program was written")
    units = ["mm" if j in cell.limits.sliding else "deg" for j in range(len(names))]
    if [joint["unit"] for joint in joints] != units:
        raise InputError("joints turn here that slide in this cell, or the other way round", file=path)


def _move(data: dict[str, Any], names: tuple[str, ...], units: Array) -> AskedMove:
    j = names.index(str(data["joint"]))
    start, end, share = float(data["from"]), float(data["to"]), float(data["share_of_speed"])
    shortest = SHORTEST[int(units[j] == SLIDING_UNIT)]
    length = abs(end - start) * float(units[j])
    if not (0.0 < share <= 1.0 and LEAST_MOVE * shortest <= length < np.inf):
        raise ValueError("a move that goes nowhere, or endlessly far")
    return AskedMove(j, start * float(units[j]), end * float(units[j]), share)


def _numbers(rows: list[Any], key: str) -> Array:
    return np.array([float(row[key]) for row in rows])


def _optional(rows: list[Any], key: str) -> Array | None:
    values = [row[key] for row in rows]
    return None if any(value is None for value in values) else np.array([float(value) for value in values])


def _file_units(sliding: tuple[int, ...], n: int) -> Array:
    """Units (n) of the file's numbers in rad and m."""
    units = np.full(n, np.pi / 180.0)
    units[list(sliding)] = SLIDING_UNIT
    return units
