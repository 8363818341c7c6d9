"""URScript for Universal Robots' controllers (CB3 and e-Series): one program with a function for each bead.

Material is laid by movep, which keeps the tip's speed through circular blends, where movel was seen to speed up. The
maker describes no blend of movep with other moves, so run-in and run-out are movep too, and where it meets the movej of
travel the arm stops. Poses are those of the nozzle in the part frame, `part`, which stands in the controller's base frame: a
part that was moved needs that one line changed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.export.about import about
from planner.export.blends import move_radii
from planner.export.moves import Moves, deposits, plan_moves
from planner.export.outputs import output_numbers
from planner.export.pace import greatest_until_stop, rounded_up, tip_acceleration
from planner.export.rapid.text import module_name, number
from planner.export.rests import Wait
from planner.export.rotations import from_matrix
from planner.export.urscript.able import unsaid_in_urscript
from planner.export.urscript.frames import rotation_vectors, world_controller
from planner.plan.materials import materials_of
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


LONGEST_COMMENT = 100
LENGTH, ANGLE = 6, 6  # decimals of metres and radians
SPEED = 4  # decimals of m/s and rad/s
# A program goes on when a blend begins, so an output is switched that much before its place. Small enough to be no
# error, and on a straight run-in, where it needs no room, large enough to be a blend.
SWITCH_BLEND = 0.04e-3  # m


@dataclass(frozen=True)
class Pace:
    """Acceleration of the tip [m/s^2] and of the leading joint [rad/s^2], the plan's greatest, rounded up; and the
    leading joint's speed (m) [rad/s] of each move, the greatest until the next stop.
    """

    tip: float
    joint: float
    speed: Array


def script_name(plan: Plan) -> str:
    """File of the program."""
    return f"{module_name(plan.name)}.script"


def urscript(plan: Plan) -> str:
    """Program of a verified plan (ASCII, m, rad). ValueError if it is not verified, or has no form in URScript."""
    if not plan.verified:
        raise ValueError("robot code is written for verified plans only")
    if (reason := unsaid_in_urscript(plan)) is not None:
        raise ValueError(reason)
    moves = plan_moves(plan)
    T_controller_part = np.linalg.inv(world_controller(plan.cell)) @ plan.cell.T_world_holder
    functions, calls = _functions(plan, moves)
    off = [f"  set_standard_digital_out({k}, False)" for k in output_numbers(plan.problem).values()]
    start = _joints(plan.trajectory.q[0])
    pace = pace_of(plan, moves)
    lines = [
        *_header(plan),
        f"def {module_name(plan.name)}():",
        f"  set_tcp({_pose(plan.cell.T_flange_nozzle)})",
        f"  global part = {_pose(T_controller_part)}",
        *functions,
        *off,
        f"  movej({start}, a={number(pace.joint, 1)}, v={number(pace.speed[0], SPEED)}, r=0)",
        *_waiting(moves.waits.get(-1, ()), 2),
        *(f"  {name}()" for name in calls),
        *off,
        "end",
        "",
    ]
    return "\n".join(lines)


def pace_of(plan: Plan, moves: Moves) -> Pace:
    """How fast the controller may go where the plan does not say it move by move."""
    t = plan.trajectory
    rate = np.abs(np.diff(t.q[:, :6], axis=0)).max(axis=1) / t.dt
    turning = float(np.abs(np.diff(t.q[:, :6], 2, axis=0)).max(initial=0.0)) / t.dt**2
    speed = np.maximum(np.ceil(greatest_until_stop(moves, rate) * 10**SPEED), 1.0) / 10**SPEED
    return Pace(tip_acceleration(t), rounded_up(turning), speed)


def radii_of(plan: Plan, moves: Moves) -> Array:
    """Blend radius (m) [m] at the end of each move."""
    radius = move_radii(plan, moves)
    switches = moves.on_end | moves.off_end | np.append(moves.on_start[1:], False)
    out: Array = np.where(switches, np.minimum(radius, SWITCH_BLEND), radius)
    return out


def _header(plan: Plan) -> list[str]:
    t = plan.trajectory
    fastest = float(t.speed[t.deposit].max())
    texts = [
        *about(plan),
        "Payload and centre of gravity are those of the installation: set them there.",
        f"Outputs are switched where a blend begins, {SWITCH_BLEND * 1e3:.2f} mm early, and within a cycle of the",
        f"controller: {fastest * 8.0:.2f} mm of way in the 8 ms of a CB3, {fastest * 2.0:.2f} mm in an e-Series' 2 ms.",
        *(f"Output {k}: {signal}" for signal, k in output_numbers(plan.problem).items()),
        *(f"Material {each.name}: tool T{each.tool}, {each.signal}" for each in materials_of(plan.problem)),
    ]
    return [comment(text, 0) for text in texts]


def comment(text: str, indent: int) -> str:
    """One comment line, ASCII, of bounded length."""
    text = re.sub(r"[^\x20-\x7e]", "?", text)
    return f"{'':{indent}}# {text[:LONGEST_COMMENT].rstrip()}"


def _pose(T: Array) -> str:
    values = np.concatenate([T[:3, 3], rotation_vectors(from_matrix(T[None, :3, :3]))[0]])
    return "p[" + ", ".join(number(v, LENGTH) for v in values) + "]"


def _joints(q: Array) -> str:
    return "[" + ", ".join(number(v, ANGLE) for v in q) + "]"


def _functions(plan: Plan, moves: Moves) -> tuple[list[str], list[str]]:
    """All functions with moves, and their names in the order of calling."""
    t, pace = plan.trajectory, pace_of(plan, moves)
    first, last = deposits(t)
    numbers = list(output_numbers(plan.problem).values())
    names = [each.name for each in materials_of(plan.problem)]
    own = [numbers[names.index(bead.material)] if names else numbers[0] for bead in plan.toolpath.beads]
    texts = _moves(plan, moves, pace)
    bounds = np.searchsorted(moves.after, np.arange(len(first) + 2)).tolist()
    lines, calls = [], []
    for k, (a, b) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
        if a == b:
            continue
        calls.append(f"bead_{plan.first_bead + k + 1:04d}" if k < len(first) else "finish")
        lines.append(f"  def {calls[-1]}():")
        if k < len(first):
            bead = int(t.bead[first[k]])
            of = plan.toolpath.beads[bead].material
            length = f"{1e3 * (t.s[last[k]] - t.s[first[k]]):.1f} mm" + (f" of {of}" if of else "")
            lines.append(comment(f"Bead {bead}, layer {t.layer[first[k]]}: {length}", 4))
        for i in range(a, b):
            ends = own[int(t.bead[moves.sample[i]])]
            if moves.on_start[i]:
                begins = own[int(t.bead[moves.sample[i - 1] if i else 0])]
                lines.append(f"    set_standard_digital_out({begins}, True)")
            lines.append(texts[i])
            if moves.on_end[i]:
                lines.append(f"    set_standard_digital_out({ends}, True)")
            if moves.off_end[i]:
                lines.append(f"    set_standard_digital_out({ends}, False)")
            lines += _waiting(moves.waits.get(i, ()), 4)
        lines.append("  end")
    return lines, calls


def _moves(plan: Plan, moves: Moves, pace: Pace) -> list[str]:
    """One statement for each move."""
    t = plan.trajectory
    k = moves.sample
    targets = np.column_stack([moves.targets.position[1:], rotation_vectors(moves.targets.quat[1:])])
    rows = np.where(moves.linear[:, None], np.round(targets, LENGTH), np.round(t.q[k, :6], ANGLE)) + 0.0
    six = ", ".join([f"%.{LENGTH}f"] * 6)
    speeds = np.where(moves.linear, np.maximum(np.round(moves.speed, SPEED), 10.0**-SPEED), pace.speed).tolist()
    radii = radii_of(plan, moves).tolist()
    out = []
    for row, linear, v, r in zip(rows.tolist(), moves.linear.tolist(), speeds, radii, strict=True):
        what = f"movep(pose_trans(part, p[{six}])" if linear else f"movej([{six}]"
        a = pace.tip if linear else pace.joint
        out.append(f"    {what % tuple(row)}, a={a:.1f}, v={v:.{SPEED}f}, r={number(r, LENGTH) if r else 0})")
    return out


def _waiting(waits: tuple[Wait, ...], indent: int) -> list[str]:
    lines = []
    for wait in waits:
        lines += [comment(wait.why, indent)] if wait.why else []
        lines += [f"{'':{indent}}sleep({wait.time:.3f})"] if wait.time > 0.0 else []
    return lines
