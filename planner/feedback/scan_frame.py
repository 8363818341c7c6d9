"""Clouds of points of a print, brought into the part frame."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell

FRAMES = ("part", "plate", "world")


def in_part_frame(points: Array, frame: str, cell: Cell) -> Array:
    """Points (n, 3) [m] of a frame of FRAMES in the part frame: its own (the work object of programs), that of the plate
    which carries it, or the world of a part on a fixed bed. Raises InputError for the world of a part that a positioner
    turns."""
    if frame == "part":
        return points
    if frame == "world" and cell.holder_robot is not None:
        hint = "scan it in the frame of its plate (--frame plate), or of the part"
        raise InputError("the world does not tell where a part is that a positioner turns", field="--frame", hint=hint)
    T = cell.T_plate_part if frame == "plate" and cell.holder_robot is not None else cell.T_world_holder
    return np.asarray((points - T[:3, 3]) @ T[:3, :3])
