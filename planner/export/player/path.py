"""Where a controller's arm leaves the programmed lines: zones that cut corners, and lag."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import njit
from planner.export.player.played import Played
from planner.export.program import RobotProgram

TICK = 4e-3  # [s] between instants at which the path is sampled, as in a controller
MOST_TICKS = 1_000_000  # of a program; longer ones are sampled more coarsely


def lagging_both_ways(way: Array, keep: float, moving: bool = False) -> Array:
    """A way (k, n) through a filter that weights what was commanded j ticks before and after by `keep` to the power j.

    moving: beyond its ends the way continues along its first and last line; otherwise it rests there
    """
    late = _late(way, keep, moving)
    return _late(late[::-1] - late[-1], keep, moving)[::-1] + late[-1]


def _late(way: Array, keep: float, moving: bool) -> Array:
    """A way (k, n) followed with a lag, from rest or, if moving, from steady motion along its first line."""
    slope, out = way[1] - way[0] if moving else 0.0, np.empty(way.shape)
    _lagging(np.ascontiguousarray(way), keep, way[0] - slope / (1.0 - keep), out)
    return out


@njit
def _lagging(way: Array, keep: float, start: Array, out: Array) -> None:
    """Fill `out` (k, n) with a way (k, n) through a first-order lag: each tick closes a share 1 - keep of the distance.

    start (n): where `out` is a tick before the way begins. Same digits as scipy's `lfilter`, whose package takes half a
    second to import.
    """
    for j in range(way.shape[1]):
        before = keep * start[j]
        for i in range(len(way)):
            out[i, j] = (1.0 - keep) * way[i, j] + before
            before = keep * out[i, j]


def corner_depth(program: RobotProgram, played: Played) -> Array:
    """How far the parabola within a target's zone passes inside of the target (m) [m]; 0 where the robot rests."""
    steps = np.diff(played.position, axis=0)
    size = np.linalg.norm(steps, axis=1)
    unit = steps / np.where(size > 0.0, size, 1.0)[:, None]
    moves = np.bincount(played.move, size, minlength=len(program.zone))
    knot = played.target[:-1]  # the last one is an end
    comes, goes = unit[knot - 1], unit[knot]
    # an arc's direction at its end is turned beyond its last chord by half of the turn per chord
    arc, first, move = program.circular[played.move], np.maximum(knot - 2, 0), played.move
    turns = arc[knot - 1] & (move[first] == move[knot - 1])
    comes = np.where(turns[:, None], comes + 0.5 * (comes - unit[first]), comes)
    after = np.minimum(knot + 1, len(unit) - 1)
    turns = arc[knot] & (move[after] == move[knot])
    goes = np.where(turns[:, None], goes - 0.5 * (unit[after] - goes), goes)
    reach = np.minimum(program.zone[:-1], 0.5 * np.minimum(moves[:-1], moves[1:]))
    # the middle of a parabola whose tangents have length `reach` on both sides
    cut = 0.25 * reach * np.linalg.norm(goes - comes, axis=1)
    return np.append(np.where(program.fine[:-1], 0.0, cut), 0.0)
