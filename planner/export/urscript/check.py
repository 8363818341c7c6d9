"""Whether a URScript program that was read back does what its plan does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from planner.export.blends import STEP, blend_complaints
from planner.export.moves import Moves, plan_moves
from planner.export.outputs import named, output_numbers
from planner.export.playable import played_complaints
from planner.export.rotations import from_matrix, to_matrix
from planner.export.urscript.frames import world_controller
from planner.export.urscript.reader import Script, read_urscript
from planner.export.urscript.writer import ANGLE, SPEED, SWITCH_BLEND, pace_of, script_name

if TYPE_CHECKING:
    from planner.export.program import Program
    from planner.plan import Plan


def urscript_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """What the program says otherwise than the plan, beyond rounding and thinning, in words."""
    script = read_urscript(files[script_name(plan)], plan.cell.T_part_nozzle)
    program = named(script.program, output_numbers(plan.problem))
    T_controller_part = np.eye(4)
    T_controller_part[:3, :3], T_controller_part[:3, 3] = to_matrix(program.uframe[None, 3:])[0], program.uframe[:3]
    T_world_part = world_controller(plan.cell) @ T_controller_part
    uframe = np.concatenate([T_world_part[:3, 3], from_matrix(T_world_part[None, :3, :3])[0]])
    program = replace(program, uframe=uframe, joints=script.joints)
    moves = plan_moves(plan)
    return [
        *played_complaints(plan, moves, program),
        *blend_complaints(plan, program),
        *_early(program),
        *_joints(plan, moves, script),
    ]


def _early(program: Program) -> list[str]:
    """Outputs that are switched too far before their place, since the blend there is too large."""
    at = [move for move, group in program.triggers.items() if not all(each.from_start for each in group)]
    early = float(program.zone[at].max(initial=0.0))
    return [f"an output is switched {early:.3g} m early"] if early > SWITCH_BLEND + STEP else []


def _joints(plan: Plan, moves: Moves, script: Script) -> list[str]:
    """Joint targets that no sample of the plan has; moves that are quicker, or reach their speed later, than planned."""
    found = []
    joint = ~script.program.linear
    off = cKDTree(plan.trajectory.q[:, :6]).query(script.joints[joint])[0].max()
    if off > 3.0 * 10.0**-ANGLE:  # rounding, over six joints
        found.append(f"joints differ by {off:.3g} rad")
    pace = pace_of(plan, moves)
    for words, chosen, planned in (("tip", ~joint, pace.tip), ("joint", joint, pace.joint)):
        if np.abs(script.pace[chosen, 0] - planned).max(initial=0.0) > 0.051:
            found.append(f"acceleration of a {words} differs from {planned:.1f}")
    lines = np.maximum(np.round(moves.speed[moves.linear], SPEED), 10.0**-SPEED)
    if len(lines) != np.count_nonzero(~joint) or np.abs(script.pace[~joint, 1] - lines).max() > 0.5 * 10.0**-SPEED:
        found.append("speeds of linear moves are not the planned ones")
    planned_speed = np.concatenate([pace.speed[:1], pace.speed[~moves.linear]])
    if joint.sum() != len(planned_speed) or np.abs(script.pace[joint, 1] - planned_speed).max() > 10.0**-SPEED:
        found.append("speeds of joint moves are not the planned ones")
    return found
