"""Whether a KRL program that was read back does what its plan does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planner.export.blends import blend_complaints
from planner.export.krl.axes import from_kuka, to_kuka, turn
from planner.export.krl.reader import Source, read_krl
from planner.export.krl.text import krl_name
from planner.export.krl.writer import LEAST_SPEED, SPEED, percent, radii_of, settings
from planner.export.moves import Moves, plan_moves
from planner.export.outputs import named, output_numbers
from planner.export.playable import played_complaints
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


ROUNDING = np.radians(1.01e-4)  # of axes


def krl_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """What source and data file say otherwise than the plan, beyond rounding and thinning, in words."""
    name, cell = krl_name(plan.name), plan.cell
    na, station = len(cell.arm), cell.holder_robot
    free = [] if station is None else [station.joint_names.index(joint) for joint in cell.holder.names]

    def forward(axes: Array) -> Array:
        return cell.T_part_nozzle(np.column_stack([from_kuka(axes[:, :na]), axes[:, na:][:, free]]))

    source = read_krl(files[f"{name}.src"], files[f"{name}.dat"], forward)
    program = named(source.program, output_numbers(plan.problem))
    start = program.start.copy()
    start[:na] = from_kuka(start[None, :na])[0]
    moves = plan_moves(plan)
    program = replace(program, start=start, joints=from_kuka(source.axes))
    return [*played_complaints(plan, moves, program), *blend_complaints(plan, program), *_moves(plan, moves, source)]


def _moves(plan: Plan, moves: Moves, source: Source) -> list[str]:
    """Postures, Turn, speeds of axes and settings, one by one against those that the plan's moves have."""
    na = len(plan.cell.arm)
    linear = np.concatenate([[False], moves.linear])
    if not np.array_equal(linear, source.program.linear):
        return ["moves are not of the planned kinds"]
    q, found = moves.q[:, :na], []
    off = np.abs(source.axes - to_kuka(q))[~linear].max()
    if off > ROUNDING:
        found.append(f"axes differ by {off:.3g} rad")
    wrong = np.count_nonzero(source.turn[linear] != turn(q[linear]))
    if wrong:
        found.append(f"Turn differs at {wrong} targets")
    shares = np.array(percent(plan, moves))
    if not np.array_equal(source.share[~linear], np.concatenate([shares[:1], shares[~moves.linear]])):
        found.append("speeds of axes are not the planned ones")
    lines = np.maximum(np.round(moves.speed[moves.linear], SPEED), LEAST_SPEED)
    if np.abs(source.program.speed[linear, 0] - lines).max() > 0.5 * LEAST_SPEED:
        found.append("speeds of lines are not the planned ones")
    if not np.array_equal(source.program.fine[1:], radii_of(plan, moves) == 0.0):
        found.append("it stops elsewhere than planned")
    expected = settings(plan, moves)
    found += [f"{key} is not {value}" for key, value in expected.items() if source.settings.get(key) != value]
    found += [f"{key} is set as well" for key in source.settings if key not in expected]
    return found
