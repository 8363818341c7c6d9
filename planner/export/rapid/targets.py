"""Targets of RAPID: poses, configurations and external axes of a plan's samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.moves import Moves
from planner.export.rotations import continuous
from planner.plan import RAPID_EXTERNAL_AXES
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.cell import Cell
    from planner.plan import Plan

UNUSED = "9E9"


def external_degrees(cell: Cell, external: Array) -> Array:
    """The station's axes (m, k) [deg] in the robot's own order: free ones from (m, f) [rad], held ones as held."""
    if cell.holder_robot is None:
        return np.empty((len(external), 0))
    free = list(cell.holder.names)
    columns = [
        external[:, free.index(name)] if name in free else np.full(len(external), cell.held[name])
        for name in list(cell.holder_robot.model.names)[1:]
    ]
    out: Array = np.degrees(np.column_stack(columns))
    return out


def quadrants(q: Array) -> NDArray[np.intp]:
    """cf1, cf4, cf6 (m, 3): the quarter turns of joints 1, 4 and 6 of postures (m, >= 6) [rad]."""
    return np.floor(np.round(np.degrees(q[:, [0, 3, 5]]) / 90.0, 9)).astype(np.intp)


def external_text(degrees: Array) -> list[str]:
    """`eax_a,..,eax_f` of each row."""
    unused = ",".join([UNUSED] * (RAPID_EXTERNAL_AXES - degrees.shape[1]))
    if not degrees.shape[1]:
        return [unused] * len(degrees)
    degrees = np.round(degrees, 4) + 0.0  # turns minus nought into nought
    pattern = ",".join(["%.4f"] * degrees.shape[1]) + ("," + unused if unused else "")
    return [pattern % tuple(row) for row in degrees.tolist()]


def targets(plan: Plan, moves: Moves) -> list[str]:
    """Robtargets of the first sample and of every move."""
    trajectory = plan.trajectory
    k = np.concatenate([[0], moves.sample])
    quat = continuous(moves.targets.quat)[:, [3, 0, 1, 2]]
    numbers = np.column_stack(
        [
            np.round(moves.targets.position * 1e3, 3) + 0.0,
            np.round(quat, 7) + 0.0,
            quadrants(moves.q),
            trajectory.branch[k],
        ]
    )
    external = external_text(external_degrees(plan.cell, moves.targets.station))
    pattern = "[[%.3f,%.3f,%.3f],[%.7f,%.7f,%.7f,%.7f],[%d,%d,%d,%d],[%s]]"
    return [pattern % (*row, ext) for row, ext in zip(numbers.tolist(), external, strict=True)]
