"""Where a part stands, as the few numbers that may be changed: of the bed or table in the world, of the part on the table."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.cell import Cell, rigid_inverse, translation
from planner.kinematics.chain import Chain
from planner.problem import Problem
from planner.readonly import Array

FREEDOMS = ("x", "y", "z", "turn", "part_x", "part_y")
ANGLES = frozenset({"turn"})
ON_A_TABLE = frozenset({"part_x", "part_y"})


@dataclass(frozen=True)
class Place:
    """Where a part stands: x, y, z [m] and turn about the vertical [rad] of the bed or of the table's base in the
    world, part_x, part_y [m] of the part on the table's plate."""

    x: float
    y: float
    z: float
    turn: float
    part_x: float = 0.0
    part_y: float = 0.0


def place_of(problem: Problem) -> Place:
    """Where the problem puts its part."""
    cell = problem.cell
    if cell.positioner is None:
        if cell.bed is None:
            raise problem.error("cell", "neither positioner nor bed_mm is given")
        return Place(*cell.bed, cell.bed_rpy[2])
    spec = cell.positioner
    at = spec.origin if spec.base is None else spec.base
    if at is None:
        raise problem.error("cell.positioner", "neither origin_mm nor base_mm is given")
    return Place(*at, spec.turn, spec.part[0], spec.part[1])


def changed_fields(problem: Problem, place: Place) -> dict[str, float | list[float]]:
    """Fields of the problem file (dotted, in mm and degrees) that put the part at a place, without those that stay."""
    was, cell = place_of(problem), problem.cell
    at = [_mm(place.x), _mm(place.y), _mm(place.z)]
    out: dict[str, float | list[float]] = {}
    moved = (place.x, place.y, place.z) != (was.x, was.y, was.z)
    turned = place.turn != was.turn
    if cell.positioner is None:
        if moved:
            out["cell.bed_mm"] = at
        if turned:
            roll, pitch, _ = cell.bed_rpy
            out["cell.bed_rpy_deg"] = [_deg(roll), _deg(pitch), _deg(place.turn)]
        return out
    if moved:
        out[f"cell.positioner.{'origin_mm' if cell.positioner.base is None else 'base_mm'}"] = at
    if turned:
        out["cell.positioner.turn_deg"] = _deg(place.turn)
    if (place.part_x, place.part_y) != (was.part_x, was.part_y):
        out["cell.positioner.part_mm"] = [_mm(place.part_x), _mm(place.part_y), _mm(cell.positioner.part[2])]
    return out


def moved_cell(cell: Cell, was: Place, place: Place) -> Cell:
    """The cell that was built for one place, with its part at another."""
    T_move = _anchor(place) @ rigid_inverse(_anchor(was))
    T_shift = translation(np.array([place.part_x - was.part_x, place.part_y - was.part_y, 0.0]))
    T_plate_part = T_shift @ cell.T_plate_part
    holder = cell.holder
    T_last = holder.T_last_tip @ rigid_inverse(cell.T_plate_part) @ T_plate_part
    if len(holder):
        placements = np.concatenate([(T_move @ holder.placements[0])[None], holder.placements[1:]])
        holder = Chain(holder.names, placements, holder.axes, T_last)
    else:
        holder = Chain(holder.names, holder.placements, holder.axes, T_move @ T_last)
    return replace(
        cell,
        holder=holder,
        T_world_holder=holder.poses(np.zeros((1, len(holder))))[0],
        T_world_holder_base=T_move @ cell.T_world_holder_base,
        T_plate_part=T_plate_part,
    )


def _anchor(place: Place) -> Array:
    T = translation(np.array([place.x, place.y, place.z]))
    c, s = np.cos(place.turn), np.sin(place.turn)
    T[:2, :2] = [[c, -s], [s, c]]
    return T


def _mm(length: float) -> float:
    return round(length * 1e3, 6) + 0.0


def _deg(angle: float) -> float:
    return round(float(np.degrees(angle)), 6) + 0.0
