"""Programs of languages that leave postures and speeds open, played with those of the plan in their place."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planner.export.compare import compare
from planner.export.program import UNSAID, Program
from planner.export.rapid.targets import quadrants
from planner.export.readback import readback

if TYPE_CHECKING:
    from planner.export.moves import Moves
    from planner.plan import Plan

FAST = 100.0  # m/s, rad/s: what is not said does not slow the robot down; its joints do


def played_complaints(plan: Plan, moves: Moves, program: Program) -> list[str]:
    """What a program that was read back does otherwise than its plan, in words.

    Configurations that its targets do not name are those of the planned postures, which is what the controller must
    come to by itself: it is told by joints where each line begins, and keeps its configuration along lines.
    """
    at = np.concatenate([[0], moves.sample])
    if len(program.linear) != len(at):
        return [*compare(plan, program).complaints(), f"it has {len(program.linear)} moves, not {len(at)}"]
    planned = np.column_stack([quadrants(moves.q), plan.trajectory.branch[at]])
    filled = replace(
        program,
        conf=np.where(program.conf == UNSAID, planned, program.conf),
        speed=np.where(np.isnan(program.speed), FAST, program.speed),
        zone=np.nan_to_num(program.zone),  # of travel: by how much it is rounded is the controller's to choose
    )
    return readback(plan, filled)
