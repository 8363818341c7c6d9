"""KRL for KR C controllers (KSS): a .src with a subprogram for each bead, and a .dat with the frames.

Targets stand inline in the moves, as they do in programs of offline systems: E6AXIS for travel, which leaves no doubt
about the posture, and E6POS in the part's frame for lines. Subprograms are local to the file, so that a bead is one
thing to select and the file still one to copy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.export.about import about
from planner.export.blends import move_radii
from planner.export.krl.able import unsaid_in_krl
from planner.export.krl.axes import angles, status, to_kuka, turn
from planner.export.krl.text import DEGREES, MM, axes, comment, frame, krl_name
from planner.export.moves import Moves, deposits, plan_moves
from planner.export.outputs import output_numbers
from planner.export.pace import greatest_until_stop, tip_acceleration
from planner.export.rapid.targets import external_degrees
from planner.export.rests import Wait
from planner.export.rotations import to_matrix
from planner.plan.materials import materials_of
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


SPEED = 4  # decimals of m/s
LEAST_SPEED = 10.0**-SPEED
STATION = "MACHINE_DEF[2]"  # KUKA's usual place of an external kinematic system; the robot itself is the first one
ADVANCE = 3  # moves that the interpreter is ahead, KUKA's default: what blending needs
HEAD_ROOM = 1.5  # of reorientation over what the plan needs, so that the tip's speed alone governs
LEAST_TURNING = 100.0  # deg/s
# Radii of blends [mm]: few values, so that few lines are taken to set them
LEVELS = np.array([a * 10.0**k for k in range(-3, 2) for a in (1.0, 2.0, 5.0)])


def krl_files(plan: Plan) -> dict[str, str]:
    """Source and data file of a verified plan (ASCII, mm, degrees); ValueError if it is not, or has no form in KRL."""
    if not plan.verified:
        raise ValueError("robot code is written for verified plans only")
    if (reason := unsaid_in_krl(plan)) is not None:
        raise ValueError(reason)
    name, moves = krl_name(plan.name), plan_moves(plan)
    subprograms, calls = _subprograms(plan, moves)
    off = [f"  $OUT[{k}]=FALSE" for k in output_numbers(plan.problem).values()]
    source = [
        "&ACCESS RVP",
        "&REL 1",
        f"DEF {name}()",
        *_header(plan),
        "  BAS(#INITMOV,0)",
        *(f"  {key}={value}" for key, value in settings(plan, moves).items()),
        *off,
        f"  BAS(#VEL_PTP,{percent(plan, moves)[0]})",
        "  PTP XSTART",
        *_waiting(moves.waits.get(-1, ())),
        *(f"  {call}()" for call in calls),
        *off,
        "END",
        *subprograms,
        "",
    ]
    na = len(plan.cell.arm)
    start = plan.trajectory.q[:1]
    degrees, external = np.degrees(to_kuka(start[:, :na]))[0], external_degrees(plan.cell, start[:, na:])[0]
    on = plan.cell.T_world_holder if plan.cell.holder_robot is None else plan.cell.T_plate_part
    data = [
        "&ACCESS RVP",
        "&REL 1",
        f"DEFDAT {name}",
        f"  DECL FRAME FTOOL={{{frame(plan.cell.T_flange_nozzle)}}}",
        f"  DECL FRAME FPART={{{frame(on)}}}",
        f"  DECL E6AXIS XSTART={{{axes(degrees, external)}}}",
        "ENDDAT",
        "",
    ]
    return {f"{name}.src": "\n".join(source), f"{name}.dat": "\n".join(data)}


def settings(plan: Plan, moves: Moves) -> dict[str, str]:
    """System variables that are set once, in their order."""
    turning = max(LEAST_TURNING, 10.0 * float(np.ceil(HEAD_ROOM * np.degrees(moves.turn.max()) / 10.0)))
    station = plan.cell.holder_robot
    base = "FPART" if station is None else f"EK({STATION}.ROOT,{STATION}.MECH_TYPE,FPART)"
    return {
        "$TOOL": "FTOOL",
        "$BASE": base,
        "$IPO_MODE": "#BASE",
        "$ORI_TYPE": "#VAR",
        "$ADVANCE": f"{ADVANCE}",
        "$APO.CPTP": "50",
        "$VEL.ORI1": f"{turning:.1f}",
        "$VEL.ORI2": f"{turning:.1f}",
        "$ACC.CP": f"{tip_acceleration(plan.trajectory):.1f}",
    }


def percent(plan: Plan, moves: Moves) -> list[int]:
    """Speed of axes (m) [percent of their greatest] for each move, the plan's greatest until the next stop."""
    t, na = plan.trajectory, len(plan.cell.arm)
    limits = [plan.cell.arm_robot.model.velocityLimit]
    if (station := plan.cell.holder_robot) is not None:
        free = [station.joint_names.index(name) for name in plan.cell.holder.names]
        limits.append(station.model.velocityLimit[free])
    share = (np.abs(np.diff(t.q, axis=0)) / t.dt / np.concatenate(limits)[: na + len(plan.cell.holder)]).max(axis=1)
    return [int(value) for value in np.clip(np.ceil(100.0 * greatest_until_stop(moves, share)), 1, 100)]


def radii_of(plan: Plan, moves: Moves) -> Array:
    """Approximation distance (m) [m] at the end of each move: the next smaller of LEVELS; 0 where the robot stops."""
    radius = move_radii(plan, moves) * 1e3 * (1.0 + 1e-9)
    below = np.searchsorted(LEVELS, radius, side="right")
    # smaller than the smallest is still no reason to stop
    out: Array = np.where(radius > 0.0, LEVELS[np.maximum(below - 1, 0)], 0.0) * 1e-3
    return out


def _header(plan: Plan) -> list[str]:
    cell = plan.cell
    texts = [
        *about(plan),
        *(f"Output {k}: {signal}" for signal, k in output_numbers(plan.problem).items()),
        *(f"Material {each.name}: tool T{each.tool}, {each.signal}" for each in materials_of(plan.problem)),
        "The tool's load is that of the controller: set it there before the first run.",
        f"$ROBROOT in $WORLD must be {frame(cell.T_world_base)}",
    ]
    if cell.holder_robot is not None:
        held = [
            f"E{i} {name}" + (" (held)" if name in cell.held else "")
            for i, name in enumerate(cell.holder_robot.joint_names, 1)
        ]
        texts += [
            f"External axes of {STATION}, {cell.holder_robot.name}: {', '.join(held)}",
            f"  its root in $WORLD must be {frame(cell.T_world_holder_base)}",
        ]
    return [comment(text) for text in texts]


def _targets(plan: Plan, moves: Moves) -> list[str]:
    """The aggregate of each move's target."""
    t, na, k = plan.trajectory, len(plan.cell.arm), moves.sample
    external = np.round(external_degrees(plan.cell, moves.targets.station[1:]), DEGREES) + 0.0
    joints = np.round(np.degrees(to_kuka(t.q[k, :na])), DEGREES) + 0.0
    abc = np.degrees(angles(to_matrix(moves.targets.quat[1:])))
    lines = np.column_stack([np.round(moves.targets.position[1:] * 1e3, MM) + 0.0, np.round(abc, DEGREES) + 0.0])
    states, turns = status(t.branch[k].astype(np.intp)).tolist(), turn(moves.q[1:, :na]).tolist()
    extra = "".join(f",E{i} %.{DEGREES}f" for i in range(1, external.shape[1] + 1))
    axis = "{E6AXIS: " + ",".join(f"A{i} %.{DEGREES}f" for i in range(1, 7)) + extra + "}"
    line = (
        "{E6POS: " + ",".join(f"{n} %.{MM if n in 'XYZ' else DEGREES}f" for n in "XYZABC") + ",S %d,T %d" + extra + "}"
    )
    return [
        line % (*p, s, w, *e) if linear else axis % (*q, *e)
        for linear, p, q, s, w, e in zip(
            moves.linear.tolist(), lines.tolist(), joints.tolist(), states, turns, external.tolist(), strict=True
        )
    ]


def _subprograms(plan: Plan, moves: Moves) -> tuple[list[str], list[str]]:
    """All subprograms with moves, and their names in the order of calling."""
    t = plan.trajectory
    first, last = deposits(t)
    numbers = list(output_numbers(plan.problem).values())
    names = [each.name for each in materials_of(plan.problem)]
    own = [numbers[names.index(bead.material)] if names else numbers[0] for bead in plan.toolpath.beads]
    targets, shares = _targets(plan, moves), percent(plan, moves)
    speeds = np.maximum(np.round(moves.speed, SPEED), LEAST_SPEED).tolist()
    radii = radii_of(plan, moves).tolist()
    share, speed, radius = shares[0], -1.0, -1.0
    bounds = np.searchsorted(moves.after, np.arange(len(first) + 2)).tolist()
    lines, calls = [], []
    for k, (a, b) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
        if a == b:
            continue
        calls.append(f"Bead{plan.first_bead + k + 1:04d}" if k < len(first) else "Finish")
        lines += ["", f"DEF {calls[-1]}()"]
        if k < len(first):
            bead = int(t.bead[first[k]])
            of = plan.toolpath.beads[bead].material
            length = f"{1e3 * (t.s[last[k]] - t.s[first[k]]):.1f} mm" + (f" of {of}" if of else "")
            lines.append(comment(f"Bead {bead}, layer {t.layer[first[k]]}: {length}"))
        for i in range(a, b):
            if not moves.linear[i]:
                if shares[i] != share:
                    share = shares[i]
                    lines.append(f"  BAS(#VEL_PTP,{share})")
                lines.append(f"  PTP {targets[i]}" + (" C_PTP" if radii[i] > 0.0 else ""))
            else:
                if speeds[i] != speed:
                    speed = speeds[i]
                    lines.append(f"  $VEL.CP={speed:.{SPEED}f}")
                if radii[i] not in (0.0, radius):
                    radius = radii[i]
                    lines.append(f"  $APO.CDIS={radius * 1e3:.3f}")
                begins, ends = (own[int(t.bead[at])] for at in (moves.sample[i - 1] if i else 0, moves.sample[i]))
                for said, where, output, value in (
                    (moves.on_start[i], "DISTANCE", begins, "TRUE"),
                    (moves.on_end[i], "PATH", ends, "TRUE"),
                    (moves.off_end[i], "PATH", ends, "FALSE"),
                ):
                    if said:
                        lines.append(f"  TRIGGER WHEN {where}=0 DELAY=0 DO $OUT[{output}]={value}")
                lines.append(f"  LIN {targets[i]}" + (" C_DIS" if radii[i] > 0.0 else ""))
            lines += _waiting(moves.waits.get(i, ()))
        lines.append("END")
    return lines, calls


def _waiting(waits: tuple[Wait, ...]) -> list[str]:
    lines = []
    for wait in waits:
        lines += [comment(wait.why)] if wait.why else []
        lines += [f"  WAIT SEC {wait.time:.3f}"] if wait.time > 0.0 else []
    return lines
