"""The robot cell: its robots, and what is made for a problem: where they stand, the nozzle and its head, fixtures."""

from planner.cell.cell import Cell, Limits, build_cell, frame_from_z, rigid_inverse, translation

__all__ = ["Cell", "Limits", "build_cell", "frame_from_z", "rigid_inverse", "translation"]
