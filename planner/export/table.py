"""trajectory.csv: every sample, as anyone's spreadsheet or checker reads it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TextIO

import numpy as np

if TYPE_CHECKING:
    from planner.plan import Plan

CHUNK = 4096  # rows formatted at once: bounds the memory, not the speed
# name → format and decimals to round to; a joint keeps 12 significant digits, so that third differences mean something
FIXED = {
    "t_s": 6,
    "bead": 0,
    "layer": 0,
    "deposit": 0,
    "s_mm": 5,
    "x_mm": 6,
    "y_mm": 6,
    "z_mm": 6,
    "ax": 9,
    "ay": 9,
    "az": 9,
    "speed_mm_s": 5,
    "flow_mm3_s": 6,
    "e_mm": 6,
}


def filament_area(plan: Plan) -> float:
    """Cross-section of the filament [m^2]."""
    return math.pi * plan.problem.process.filament_diameter**2 / 4.0


def write_table(plan: Plan, stream: TextIO) -> None:
    """Write one row per sample to a text stream: mm, mm/s, mm^3/s, joints in rad; e_mm is filament [mm]."""
    t = plan.trajectory
    stream.write(",".join([*FIXED, *plan.cell.joint_names]) + "\n")
    values = np.column_stack(
        [
            t.t,
            t.bead,
            t.layer,
            t.deposit,
            t.s * 1e3,
            t.tip * 1e3,
            t.axis,
            t.speed * 1e3,
            t.flow * 1e9,
            t.extruded / filament_area(plan) * 1e3,
            t.q,
        ]
    )
    for column, decimals in enumerate(FIXED.values()):
        values[:, column] = np.round(values[:, column], decimals)
    values += 0.0  # turns minus nought into nought
    row = ",".join([f"%.{d}f" if d else "%d" for d in FIXED.values()] + ["%.12g"] * t.q.shape[1]) + "\n"
    for start in range(0, len(values), CHUNK):
        block = values[start : start + CHUNK]
        stream.write((row * len(block)) % tuple(block.ravel().tolist()))
