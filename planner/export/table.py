"""trajectory.csv: every sample, as anyone's spreadsheet or checker reads it."""

from __future__ import annotations

from typing import TYPE_CHECKING, TextIO

import numpy as np

from planner.export.digits import rows_text
from planner.plan.columns import columns_of

if TYPE_CHECKING:
    from planner.plan import Plan

CHUNK = 4096  # rows formatted at once: bounds the memory
# column → decimals to round to; a joint keeps 12 significant digits, so that third differences mean something
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


def write_table(plan: Plan, stream: TextIO) -> None:
    """Write one row per sample to a text stream: mm, mm/s, mm^3/s, joints in rad; e_mm is filament [mm]."""
    t = plan.trajectory
    stream.write(",".join([*FIXED, *plan.cell.joint_names]) + "\n")
    decimals = np.array(list(FIXED.values()), dtype=np.int64)
    for start in range(0, len(t), CHUNK):
        rows = slice(start, start + CHUNK)
        columns = columns_of(t, rows)
        fixed = np.column_stack([columns[name] for name in FIXED])
        stream.write(rows_text(fixed, decimals, t.q[rows]))
