"""Joints as reports show them: in degrees, or in millimetres if they slide."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array

if TYPE_CHECKING:
    from planner.cell.cell import Cell


def shown_units(cell: Cell) -> tuple[Array, tuple[str, ...]]:
    """Factors (nj) from rad and m to the displayed units, and these units: deg or mm."""
    sliding = cell.limits.sliding
    units = tuple("mm" if j in sliding else "deg" for j in range(len(cell.joint_names)))
    return np.array([1e3 if unit == "mm" else np.degrees(1.0) for unit in units]), units
