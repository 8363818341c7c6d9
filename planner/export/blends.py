"""How far controllers may round the corners between targets: never into each other, never beyond a tolerance.

A blend leaves the line to a target, and joins the next one, at its radius from the target. Whether it is an arc or a
parabola, it passes the target at r tan(a / 4), to first order in the angle a by which the lines turn. With half a
segment of a polygon that was inscribed in a curve, that is as much as the polygon's middles are off on the other side.
Targets beside the path lie on the outer side of its bends, so that what is cut off there leads back towards it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from planner.export.moves import TRAVEL_TOLERANCE, deposits
from planner.export.rests import rests_of
from planner.readonly import Array, Flags

if TYPE_CHECKING:
    from planner.export.moves import Moves
    from planner.export.program import Program
    from planner.plan import Plan


STEP = 1e-6  # [m] to which radii are rounded down
NEAR = 0.05e-3  # [m] between the place of a rest and a target where the program stops


def blend_radii(position: Array, stops: Flags, tolerance: Array) -> Array:
    """Largest radii (m) [m] at targets (m, 3) that share no part of a line and leave each by at most its tolerance (m).

    0 at `stops` (m), and at the first and the last target, where the motion comes to rest.
    """
    reach, bend = _corners(position)
    radius = np.minimum(0.5 * reach, tolerance / np.maximum(np.tan(0.25 * bend), 1e-9))
    out: Array = np.where(stops | (reach == 0.0), 0.0, np.floor(radius / STEP * (1.0 + 1e-9)) * STEP)
    return out


def move_radii(plan: Plan, moves: Moves) -> Array:
    """Radii (m) [m] at the ends of moves: 0 at rests, and where joint and linear moves meet."""
    tip = np.round(moves.targets.position, 6)
    following = np.append(moves.linear[1:], not moves.linear[-1])
    stops = np.concatenate([[True], moves.fine | (following != moves.linear)])
    tolerance = np.concatenate([[0.0], np.where(moves.linear, plan.problem.program.chord, TRAVEL_TOLERANCE)])
    return blend_radii(tip, stops, tolerance)[1:]


def blend_complaints(plan: Plan, program: Program) -> list[str]:
    """What is wrong with a program's blends and stops, in words; targets of joint moves may be left by more."""
    reach, bend = _corners(program.position)
    lines = program.linear & np.append(program.linear[1:], False)
    allowed = np.where(lines, plan.problem.program.chord, TRAVEL_TOLERANCE)
    found = []
    overlap = program.zone - 0.5 * reach
    if (overlap > 2.0 * STEP).any():
        found.append(f"blends reach {overlap.max():.3g} m beyond the middle of a line")
    beyond = program.zone * np.tan(0.25 * bend) - allowed
    if (beyond > 2.0 * STEP).any():
        found.append(f"blends leave their targets by {beyond.max():.3g} m more than the tolerance")
    stops = lines & program.fine
    if stops.any():
        t = plan.trajectory
        rests = t.tip[rests_of(t, *deposits(t)).fine]
        off = cKDTree(rests).query(program.position[stops])[0]
        if off.max() > NEAR:
            found.append(f"it stops {np.count_nonzero(off > NEAR)} times where the plan does not")
    return found


def _corners(position: Array) -> tuple[Array, Array]:
    """Shorter of both lines at each target (m) [m], 0 at both ends, and by how much they turn there (m) [rad]."""
    lines = np.diff(position, axis=0)
    length = np.linalg.norm(lines, axis=1)
    reach, bend = np.zeros(len(position)), np.zeros(len(position))
    if len(position) > 2:
        a, b = lines[:-1], lines[1:]
        reach[1:-1] = np.minimum(length[:-1], length[1:])
        bend[1:-1] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
    return reach, bend
