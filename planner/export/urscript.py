"""URScript for Universal Robots' controllers (CB3 and e-Series): writer, reader, and check against the plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.rapid_names import LONGEST_NAME
from planner.export.arms import switch_triggers
from planner.export.fit import angle, from_matrix, to_matrix
from planner.export.grammar import NUMBER, Grammar, Statement, inlined
from planner.export.moves import (
    STEP,
    Moves,
    MoveSection,
    blend_differences,
    greatest_until_stop,
    move_radii,
    moves_with_arcs,
    rounded_up,
    sections,
    tip_acceleration,
)
from planner.export.parts import numbered, packed, part_about
from planner.export.program import UNSPECIFIED, RobotProgram, about, named
from planner.export.rapid.text import module_name
from planner.export.readback import filled, played_differences
from planner.export.speeds import stepped_speeds
from planner.export.support import by_bead, off_differences, output_numbers, outputs_about
from planner.export.text import ascii_comment, number, resting

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.export.program import RobotProgram
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# The controller's base frame, and rotation vectors.


MEASURED = 0.02  # [rad] by which axes of a calibrated arm may be off


def world_controller(cell: Cell) -> Array:
    """T_world_controller (4, 4): z along joint 1, y against joint 2's axis at zero, as in the maker's DH table.

    URDF files differ: ROS's base_link is turned by half a turn from the controller's base. The origin is that of the
    link in which joint 1 turns, whatever that link stands on in the URDF. As the axes of a calibrated arm are slightly
    off, a frame close to that link's own, turned by quarter turns, is taken to be exactly that.
    """
    stand = cell.T_world_base @ cell.arm_robot.T_base_stand
    first, second = cell.arm.placements[0], cell.arm.placements[0] @ cell.arm.placements[1]
    z = first[:3, :3] @ cell.arm.axes[0, :3]
    y = -second[:3, :3] @ cell.arm.axes[1, :3]
    y = y - (y @ z) * z
    y = y / np.linalg.norm(y)
    turn = stand[:3, :3].T @ np.column_stack([np.cross(y, z), y, z])
    quarters = np.round(turn)
    T = np.eye(4)
    T[:3, :3] = stand[:3, :3] @ (quarters if np.abs(turn - quarters).max() < MEASURED else turn)
    T[:3, 3] = stand[:3, 3]
    return T


def rotation_vectors(quat: Array) -> Array:
    """Axis times angle (m, 3) [rad], at most half a turn, of unit quaternions (m, 4) x y z w."""
    quat = np.where(quat[:, 3:] < 0.0, -quat, quat)
    sine = np.linalg.norm(quat[:, :3], axis=1, keepdims=True)
    # angle / sine tends to 2 for small angles
    scale = np.where(sine > 1e-12, 2.0 * np.arctan2(sine, quat[:, 3:]) / np.maximum(sine, 1e-12), 2.0)
    out: Array = scale * quat[:, :3]
    return out


def quaternions(vectors: Array) -> Array:
    """Unit quaternions (m, 4) x y z w of rotation vectors (m, 3) [rad]."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    out: Array = np.column_stack([0.5 * np.sinc(0.5 * angle / np.pi) * vectors, np.cos(0.5 * angle)])
    return out


# ----------------------------------------------------------------------------------------------------
# Writer: one program with a function for each bead, or several for a long print, to be run one after the other.
#
# Material is laid by movep, which keeps the tip's speed through circular blends (movel was seen to speed up there), and
# by movec along arcs, which turns the tool evenly between their ends (mode 0). The maker describes no blend of movep
# with other moves, so run-in and run-out are movep too, and the arm stops where movep meets the movej of travel. Poses
# are those of the nozzle in the part frame `part`, given in the controller's base frame: if the part has moved, only
# that line needs changing.

MARK = "#"  # begins a comment
SLEEP = "sleep({:.3f})"
LENGTH, ANGLE = 6, 6  # decimals of metres and radians
SPEED = 5  # decimals of m/s and rad/s
# Radius of a blend at which an output is switched: a program continues when a blend begins, so that much too early.
# Small enough not to matter, and on a straight run-in, where a blend needs no room, large enough to be one.
SWITCH_BLEND = 0.04e-3  # [m]
MOST_MOVES = 1000  # of a program, if it can be cut between beads: users report that 1,000 to 2,500 do not load
STEADY_BLEND = 1e-3  # [m] of radius; below, movep was seen not to keep its speed


@dataclass(frozen=True)
class MoveAccelerations:
    """Acceleration of the tip [m/s^2] and of the leading joint [rad/s^2], the plan's greatest, rounded up; and the
    leading joint's speed (m) [rad/s] in each move, the greatest between the stops around it.
    """

    tip: float
    joint: float
    speed: Array


def script_names(plan: Plan, count: int) -> list[str]:
    """Names of the programs, which are the stems of their files, in the order in which they are run."""
    name = module_name(plan.name)
    return [name] if count == 1 else [numbered(name, k, LONGEST_NAME) for k in range(1, count + 1)]


def write(plan: Plan) -> dict[str, str]:
    """File name → program of a verified plan (ASCII, m, rad)."""
    moves = moves_with_arcs(plan)
    programs = _programs(plan, moves)
    names = script_names(plan, len(programs))
    return {f"{name}.script": _program(plan, moves, k, names, programs[k]) for k, name in enumerate(names)}


def _programs(plan: Plan, moves: Moves) -> list[list[MoveSection]]:
    """Sections of each program: cut only where the arm stops, and never within a bead."""
    rests = radii_of(plan, moves) == 0.0
    runs: list[list[MoveSection]] = []
    for section in sections(plan, moves):
        first = section.moves.start
        if runs and not rests[first - 1]:
            runs[-1].append(section)
        else:
            runs.append([section])
    sizes = [sum(len(section.moves) for section in run) for run in runs]
    return [[section for run in group for section in run] for group in packed(runs, sizes, MOST_MOVES, len(runs))]


def _program(plan: Plan, moves: Moves, k: int, names: list[str], own: list[MoveSection]) -> str:
    """Text of the k-th program, with its sections."""
    T_controller_part = np.linalg.inv(world_controller(plan.cell)) @ plan.cell.T_world_holder
    functions, calls = _functions(plan, moves, own)
    off = [f"  set_standard_digital_out({number}, False)" for number in output_numbers(plan.problem).values()]
    start = _joint_text(moves.q[own[0].moves.start, :6])
    pace = pace_of(plan, moves)
    lines = [
        *_header(plan, moves, k, names, own),
        f"def {names[k]}():",
        f"  set_tcp({_pose(plan.cell.T_flange_nozzle)})",
        f"  global part = {_pose(T_controller_part)}",
        *functions,
        *off,
        f"  movej({start}, a={number(pace.joint, 1)}, v={number(pace.speed[0], SPEED)}, r=0)",
        *resting(moves.waits.get(-1, ()) if k == 0 else (), MARK, SLEEP, 2),
        *(f"  {name}()" for name in calls),
        *off,
        "end",
        "",
    ]
    return "\n".join(lines)


def pace_of(plan: Plan, moves: Moves) -> MoveAccelerations:
    """Accelerations, and speeds of joint moves: the plan's greatest, as it gives no speed for single moves."""
    t = plan.trajectory
    rate = np.abs(np.diff(t.q[:, :6], axis=0)).max(axis=1) / t.dt
    turning = float(np.abs(np.diff(t.q[:, :6], 2, axis=0)).max(initial=0.0)) / t.dt**2
    speed = np.maximum(np.ceil(greatest_until_stop(moves, rate) * 10**SPEED), 1.0) / 10**SPEED
    return MoveAccelerations(tip_acceleration(t), rounded_up(turning), speed)


def radii_of(plan: Plan, moves: Moves) -> Array:
    """Blend radius (m) [m] at the end of each move."""
    radius = move_radii(plan, moves)
    switches = moves.on_end | moves.off_end | np.append(moves.on_start[1:], False)
    out: Array = np.where(switches, np.minimum(radius, SWITCH_BLEND), radius)
    return out


def _header(plan: Plan, moves: Moves, k: int, names: list[str], own: list[MoveSection]) -> list[str]:
    t = plan.trajectory
    fastest = float(t.speed[t.deposit].max())
    texts = [
        *about(plan),
        "Payload and centre of gravity are those of the installation: set them there.",
        f"Outputs are switched where a blend begins, {SWITCH_BLEND * 1e3:.2f} mm early, and within a cycle of the",
        f"controller: {fastest * 8.0:.2f} mm of way in the 8 ms of a CB3, {fastest * 2.0:.2f} mm in an e-Series' 2 ms.",
        *outputs_about(plan.problem),
    ]
    if k:
        texts = part_about(texts, k + 1, len(names))
    elif len(names) > 1:
        texts.append(f"Part 1 of {len(names)}, {names[0]} to {names[-1]}: run each when the one before it has ended")
    count = sum(len(section.moves) for section in own)
    if count > MOST_MOVES:
        texts.append(f"Note: {count} moves without a place to stop; programs of 1,000 to 2,500 were seen not to load")
    laid = np.zeros(len(moves), dtype=bool)
    laid[own[0].moves.start : own[-1].moves.stop] = True
    blends = radii_of(plan, moves)[laid & moves.laid]
    blends = blends[blends > SWITCH_BLEND]
    if len(small := blends[blends < STEADY_BLEND]):
        texts.append(
            f"Note: {len(small)} of {len(blends)} blends in beads are smaller than {STEADY_BLEND * 1e3:.0f} mm, the "
            f"smallest {1e3 * small.min():.3f} mm:"
        )
        texts.append(
            "  movep was seen not to keep its speed there; targets further apart need a larger program.chord_mm"
        )
    return [ascii_comment(MARK, text) for text in texts]


def _pose(T: Array) -> str:
    values = np.concatenate([T[:3, 3], rotation_vectors(from_matrix(T[None, :3, :3]))[0]])
    return "p[" + ", ".join(number(v, LENGTH) for v in values) + "]"


def _joint_text(q: Array) -> str:
    return "[" + ", ".join(number(v, ANGLE) for v in q) + "]"


def _functions(plan: Plan, moves: Moves, own: list[MoveSection]) -> tuple[list[str], list[str]]:
    """Functions of sections, and their names in calling order."""
    bead = plan.trajectory.bead
    outputs = by_bead(plan, list(output_numbers(plan.problem).values()))
    texts = _moves(plan, moves, pace_of(plan, moves))
    lines, calls = [], []
    for section in own:
        calls.append(f"bead_{section.number:04d}" if section.number else "finish")
        lines.append(f"  def {calls[-1]}():")
        lines += [ascii_comment(MARK, section.about, 4)] if section.about else []
        for i in section.moves:
            ends = outputs[bead[moves.sample[i]]]
            if moves.on_start[i]:
                begins = outputs[bead[moves.sample[i - 1] if i else 0]]
                lines.append(f"    set_standard_digital_out({begins}, True)")
            lines.append(texts[i])
            if moves.on_end[i]:
                lines.append(f"    set_standard_digital_out({ends}, True)")
            if moves.off_end[i]:
                lines.append(f"    set_standard_digital_out({ends}, False)")
            lines += resting(moves.waits.get(i, ()), MARK, SLEEP, 4)
        lines.append("  end")
    return lines, calls


def _moves(plan: Plan, moves: Moves, pace: MoveAccelerations) -> list[str]:
    """One statement for each move."""
    t = plan.trajectory
    k = moves.sample
    targets = np.column_stack([moves.targets.position[1:], rotation_vectors(moves.targets.quat[1:])])
    vias = np.round(np.column_stack([moves.via.position, rotation_vectors(moves.via.quat)]), LENGTH) + 0.0
    rows = np.where(moves.linear[:, None], np.round(targets, LENGTH), np.round(t.q[k, :6], ANGLE)) + 0.0
    six = ", ".join([f"%.{LENGTH}f"] * 6)
    speeds = np.where(moves.linear, stepped_speeds(moves, 10.0**-SPEED), pace.speed).tolist()
    radii = radii_of(plan, moves).tolist()
    out = []
    for row, via, linear, circular, v, r in zip(
        rows.tolist(), vias.tolist(), moves.linear.tolist(), moves.circular.tolist(), speeds, radii, strict=True
    ):
        target = (f"pose_trans(part, p[{six}])" if linear else f"[{six}]") % tuple(row)
        middle = f"pose_trans(part, p[{six}]), " % tuple(via) if circular else ""
        word = "movec" if circular else "movep" if linear else "movej"
        how = f"a={pace.tip if linear else pace.joint:.1f}, v={v:.{SPEED}f}, r={number(r, LENGTH) if r else 0}"
        out.append(f"    {word}({middle}{target}, {how}{', mode=0' if circular else ''})")
    return out


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

Forward = Callable[[Array], Array]

JOINT = 1e-5  # [m, rad] between the end of a program and the start of the next; rounding gives a fifth of it
NAME = r"[A-Za-z][A-Za-z0-9_]{0,63}"
SIX = rf"({NUMBER}(?:, {NUMBER}){{5}})"
HOW = rf"a=({NUMBER}), v=({NUMBER}), r=({NUMBER})"
GRAMMAR = Grammar.of(
    "URScript",
    MARK,
    {
        "movep": rf"movep\(pose_trans\(part, p\[{SIX}\]\), {HOW}\)",
        "movec": rf"movec\(pose_trans\(part, p\[{SIX}\]\), pose_trans\(part, p\[{SIX}\]\), {HOW}, mode=0\)",
        "movej": rf"movej\(\[{SIX}\], {HOW}\)",
        "output": r"set_standard_digital_out\(([0-7]), (True|False)\)",
        "wait": rf"sleep\(({NUMBER})\)",
        "call": rf"({NAME})\(\)",
        "define": rf"def ({NAME})\(\):",
        "end": r"end",
        "tool": rf"set_tcp\(p\[{SIX}\]\)",
        "part": rf"global part = p\[{SIX}\]",
    },
)


@dataclass(frozen=True)
class Script:
    """A program (m moves) that was read.

    program     its work object is the part in the controller's base frame; triggers name outputs by number
    joints      (m, 6) targets of joint moves [rad]; NaN for others
    pace        (m, 2) acceleration [m/s^2 or rad/s^2] and speed [m/s or rad/s] of each move
    off         outputs switched off before the first move and after the last one, of each script
    """

    program: RobotProgram
    joints: Array
    pace: Array
    off: tuple[frozenset[str], ...]


def read_urscript(text: str, forward: Forward) -> Script:
    """Program from URScript text as `urscript.write` writes it; forward: joints (k, 6) → T_part_nozzle (k, 4, 4).

    Raises InputError, with the line, for an unknown or misplaced statement or name.
    """
    title, bodies, frames = _function_bodies(text)
    moves: list[Statement] = []
    waits: dict[int, float] = {}
    switched: list[tuple[int, str, bool]] = []
    for statement in inlined(bodies, title, "function"):
        at, first = len(moves) - 1, statement.parts[0]
        if statement.word in ("movep", "movec", "movej"):
            moves.append(statement)
        elif statement.word == "output":
            value = statement.parts[1] == "True"
            if at < 0 and value:
                raise statement.error("an output goes on before the first target")
            switched.append((at, first, value))
        elif at < 0:
            raise statement.error("a wait before the first target")
        else:
            waits[at] = waits.get(at, 0.0) + float(first)
    if len(moves) < 2 or moves[0].word != "movej":
        raise InputError("it does not begin with a movej and a further move", file=GRAMMAR.file)
    m = len(moves)
    rows = np.array([_six(move.parts[-4]) for move in moves])
    arcs = np.array([_six(move.parts[0])[:3] if move.word == "movec" else [np.nan] * 3 for move in moves])
    how = np.array([[float(value) for value in move.parts[-3:]] for move in moves])
    for move, (a, v, r) in zip(moves, how.tolist(), strict=True):
        if a <= 0.0 or v <= 0.0 or r < 0.0:
            raise move.error("acceleration and speed must be positive, the blend not negative")
    linear = np.array([move.word != "movej" for move in moves])
    poses = forward(rows[~linear])
    position, quat = np.empty((m, 3)), np.empty((m, 4))
    position[linear], quat[linear] = rows[linear, :3], quaternions(rows[linear, 3:])
    position[~linear], quat[~linear] = poses[:, :3, 3], from_matrix(poses[:, :3, :3])
    program = RobotProgram(
        module=title,
        tool=_frame(frames["tool"]),
        uframe=_frame(frames["part"]),
        oframe=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        station="",
        start=np.concatenate([rows[0], np.full(6, np.nan)]),
        linear=linear,
        fine=how[:, 2] == 0.0,
        position=position,
        quat=quat,
        conf=np.full((m, 4), UNSPECIFIED, dtype=np.intp),
        external=np.full((m, 6), np.nan),
        zone=how[:, 2],
        speed=np.column_stack([np.where(linear, how[:, 1], np.nan), np.full((m, 3), np.nan)]),
        wait=np.array([waits.get(i, 0.0) for i in range(m)]),
        triggers=switch_triggers(switched, m),
        arcs=arcs,
    )
    off = tuple(frozenset(output for at, output, value in switched if at == k and not value) for k in (-1, m - 1))
    return Script(program, np.where(linear[:, None], np.nan, rows), how[:, :2], off)


def joined(first: Script, then: Script) -> Script:
    """Two programs, run one after the other, as one. InputError if the second does not begin where the first ends."""
    a, b = first.program, then.program
    off = np.linalg.norm(a.position[-1] - b.position[0])
    turned = angle(a.quat[-1:], b.quat[:1])[0]
    if off > JOINT or turned > JOINT or not a.fine[-1]:
        raise InputError(f"{b.module} does not begin where {a.module} comes to rest", file=GRAMMAR.file)
    if not (np.array_equal(a.tool, b.tool) and np.array_equal(a.uframe, b.uframe)):
        raise InputError(f"{b.module} has another tool or part than {a.module}", file=GRAMMAR.file)
    if not np.array_equal(then.pace[0], first.pace[0]):
        raise InputError(f"{b.module} begins at another speed than {a.module}", file=GRAMMAR.file)
    later = len(a.linear) - 1
    wait = a.wait.copy()
    wait[-1] += b.wait[0]
    row_wise = ("linear", "fine", "position", "quat", "conf", "external", "zone", "speed", "arcs")
    rows: dict[str, Any] = {name: np.concatenate([getattr(a, name), getattr(b, name)[1:]]) for name in row_wise}
    triggers = a.triggers | {move + later: group for move, group in b.triggers.items()}
    program = replace(a, **rows, wait=np.concatenate([wait, b.wait[1:]]), triggers=triggers)
    joints, pace = (np.concatenate([getattr(first, name), getattr(then, name)[1:]]) for name in ("joints", "pace"))
    return Script(program, joints, pace, (*first.off, *then.off))


def _six(text: str) -> list[float]:
    return [float(value) for value in text.split(", ")]


def _function_bodies(text: str) -> tuple[str, dict[str, list[Statement]], dict[str, Array]]:
    """Name of the program; its statements and those of each of its functions; its frames `tool` and `part`."""
    open_: list[str] = []  # functions that have begun but not ended, the program first
    bodies: dict[str, list[Statement]] = {}
    frames: dict[str, Array] = {}
    for statement in GRAMMAR.statements(text.split("\n")):
        word = statement.word
        if not open_ and (bodies or word != "define"):
            raise statement.misplaced("outside the program")
        if word == "define":
            name = statement.parts[0]
            if len(open_) > 1 or name in bodies:
                raise statement.error(f"function {name} is defined twice, or inside another function")
            open_.append(name)
            bodies[name] = []
        elif word == "end":
            open_.pop()
        elif word in ("tool", "part"):
            if word in frames or len(open_) > 1:
                raise statement.error(f"the {word} is set twice, or in a function")
            frames[word] = np.array(_six(statement.parts[0]))
        else:
            bodies[open_[-1]].append(statement)
    if open_ or not bodies or len(frames) != 2:
        raise InputError("no complete program with tool and part", file=GRAMMAR.file)
    return next(iter(bodies)), bodies, frames


def _frame(pose: Array) -> Array:
    return np.concatenate([pose[:3], quaternions(pose[None, 3:])[0]])


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program, with the plan's postures at its targets. InputError for an unknown line."""
    return filled(plan, moves_with_arcs(plan), _read(plan, files)[1])


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the program from the plan beyond rounding and thinning. InputError for an unknown line."""
    script, written = _read(plan, files)
    moves = moves_with_arcs(plan)
    return [
        *played_differences(plan, moves, written, stepped_speeds(moves, 10.0**-SPEED)),
        *blend_differences(plan, written),
        *_early(written),
        *_joint_moves(plan, moves, script),
        *off_differences(plan, script.off),
    ]


def _read(plan: Plan, files: Mapping[str, str]) -> tuple[Script, RobotProgram]:
    """The script as read, and its program in the cell's own frames."""
    scripts = [
        read_urscript(files[f"{name}.script"], plan.cell.T_part_nozzle) for name in script_names(plan, len(files))
    ]
    script = reduce(joined, scripts)
    written = named(script.program, output_numbers(plan.problem))
    T_controller_part = np.eye(4)
    T_controller_part[:3, :3], T_controller_part[:3, 3] = to_matrix(written.uframe[None, 3:])[0], written.uframe[:3]
    T_world_part = world_controller(plan.cell) @ T_controller_part
    uframe = np.concatenate([T_world_part[:3, 3], from_matrix(T_world_part[None, :3, :3])[0]])
    return script, replace(written, uframe=uframe, joints=script.joints)


def _early(program: RobotProgram) -> list[str]:
    """Whether outputs are switched too far before their place, as the blend there is too large."""
    at = [move for move, group in program.triggers.items() if not all(each.from_start for each in group)]
    early = float(program.zone[at].max(initial=0.0))
    return [f"an output is switched {early:.3g} m early"] if early > SWITCH_BLEND + STEP else []


def _joint_moves(plan: Plan, moves: Moves, script: Script) -> list[str]:
    """Joint targets that match no sample of the plan; moves whose speed, acceleration or stops differ from the plan."""
    found = []
    joint = ~script.program.linear
    off = cKDTree(plan.trajectory.q[:, :6]).query(script.joints[joint])[0].max()
    if off > 3.0 * 10.0**-ANGLE:  # rounding, over six joints
        found.append(f"joints differ by {off:.3g} rad")
    pace = pace_of(plan, moves)
    for words, chosen, planned in (("tip", ~joint, pace.tip), ("joint", joint, pace.joint)):
        if np.abs(script.pace[chosen, 0] - planned).max(initial=0.0) > 0.051:
            found.append(f"acceleration of a {words} differs from {planned:.1f}")
    if not np.array_equal(script.program.circular[1:], moves.circular):
        return [*found, "moves are not of the planned kinds"]
    if not np.array_equal(script.program.fine[1:], np.round(radii_of(plan, moves), LENGTH) == 0.0):
        found.append("it stops elsewhere than planned")
    lines = stepped_speeds(moves, 10.0**-SPEED)[moves.linear]
    if len(lines) != np.count_nonzero(~joint) or np.abs(script.pace[~joint, 1] - lines).max() > 0.5 * 10.0**-SPEED:
        found.append("speeds of linear moves are not the planned ones")
    planned_speed = np.concatenate([pace.speed[:1], pace.speed[~moves.linear]])
    if joint.sum() != len(planned_speed) or np.abs(script.pace[joint, 1] - planned_speed).max() > 10.0**-SPEED:
        found.append("speeds of joint moves are not the planned ones")
    return found
