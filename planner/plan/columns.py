"""Columns of a trajectory, named and in the units of trajectory.csv: defined once for the file and for `Plan.table`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.plan.trajectory import Trajectory

EVERY_ROW = slice(None)


def columns_of(trajectory: Trajectory, rows: slice = EVERY_ROW) -> dict[str, NDArray[Any]]:
    """All columns (n) by name, but for the joints, of some rows: mm, mm/s, mm^3/s; `e_mm` is filament."""
    t = trajectory
    return {
        "t_s": t.t[rows],
        "bead": t.bead[rows],
        "layer": t.layer[rows],
        "deposit": t.deposit[rows],
        "s_mm": t.s[rows] * 1e3,
        **dict(zip(("x_mm", "y_mm", "z_mm"), t.tip[rows].T * 1e3, strict=True)),
        **dict(zip(("ax", "ay", "az"), t.axis[rows].T, strict=True)),
        "speed_mm_s": t.speed[rows] * 1e3,
        "flow_mm3_s": t.flow[rows] * 1e9,
        "e_mm": t.feed[rows] * 1e3,
    }


def table_of(trajectory: Trajectory, joint_names: Sequence[str]) -> NDArray[np.void]:
    """A structured array (n) of all columns and then the joints [rad]."""
    columns = columns_of(trajectory) | dict(zip(joint_names, trajectory.q.T, strict=True))
    table = np.empty(len(trajectory), dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table
