"""Off the part along its normal, and down to it again: how cut fibre asks a bead to be left and reached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.cell import Cell
from planner.cubics import Cubics, State, rest
from planner.travel.arc import along_tips
from planner.travel.clearance import Room
from planner.travel.ways import Ends, at_rest, reaching

_PLACES = 31  # along the normal, that the tip keeps to
_LEAST = 1e-6  # m: a lower lift is none


def above(cell: Cell, ends: Ends, room: Room, raised: float) -> tuple[State, State]:
    """At rest `raised` [m] above both ends, along the part's normal; an end that is so high itself, as home, stays."""
    near = room.gaps[:, 0] < room.gaps[:, 0].min() + raised
    tips = room.tips + np.where(near, raised, 0.0)[:, None] * room.surface.normals(room.tips)
    q = np.stack([ends.start.q, ends.end.q])
    q[near, : len(cell.arm)] = reaching(cell, q[near], tips[near])
    return at_rest(q[0]), at_rest(q[1])


def along_normal(cell: Cell, ends: Ends, speed: float) -> Cubics | None:
    """From one end to the other, both at rest, the tip on the straight line between them, no faster than `speed` [m/s]."""
    tips = cell.T_part_nozzle(np.stack([ends.start.q, ends.end.q]))[:, :3, 3]
    if np.linalg.norm(tips[1] - tips[0]) < _LEAST:
        return rest(ends.start.q, 0.0)
    built = along_tips(cell, replace(ends, least=0.0), np.linspace(tips[0], tips[1], _PLACES), speed)
    return None if built is None else built.motion
