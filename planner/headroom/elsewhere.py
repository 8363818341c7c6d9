"""The cell whose part stands elsewhere than planned, with what it lies on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.cell import Cell, rigid_inverse
from planner.readonly import Array
from planner.solids import Body, triangles_of
from planner.toolpath.bead import Toolpath
from planner.toolpath.substrate.facet_tree import FacetTree


def displaced(cell: Cell, T_planned_displaced: Array, along: tuple[str, ...] = ()) -> Cell:
    """The cell whose part stands elsewhere on what holds it: its frame (4, 4) given in the planned part frame.

    What is carried with the part stays with it, and so do the fixtures named in `along`, where nothing turns.
    """
    T_world_moved = cell.T_world_holder @ T_planned_displaced @ rigid_inverse(cell.T_world_holder)
    return replace(
        cell,
        holder=replace(cell.holder, T_last_tip=cell.holder.T_last_tip @ T_planned_displaced),
        T_world_holder=cell.T_world_holder @ T_planned_displaced,
        T_plate_part=cell.T_plate_part @ T_planned_displaced,
        fixtures=tuple(
            replace(body, T_frame_solid=T_world_moved @ body.T_frame_solid) if body.name in along else body
            for body in cell.fixtures
        ),
    )


def beneath(cell: Cell, toolpath: Toolpath, near: float) -> tuple[str, ...]:
    """Names of the fixtures that part or print lie on: nearer to them than `near` [m]. None where the part turns.

    A part that is found lower than planned has not sunk into its bed: the bed is lower.
    """
    if len(cell.holder):
        return ()
    points = [bead.points for bead in toolpath.beads]
    if toolpath.shape is not None:
        points.append(np.asarray(toolpath.shape.vertices, dtype=float))
    T = cell.T_world_holder
    in_world = np.concatenate(points) @ T[:3, :3].T + T[:3, 3]
    return tuple(body.name for body in cell.fixtures if _distance(body, in_world) < near)


def _distance(body: Body, points: Array) -> float:
    """Least distance [m] of points (n, 3) from a body's surface, in the frame that carries it."""
    vertices, triangles = triangles_of(body.solid)
    T = body.T_frame_solid
    corners = (vertices @ T[:3, :3].T + T[:3, 3])[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return float(FacetTree.of(corners[area > 0.0]).distance(points).min())
