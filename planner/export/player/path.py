"""Where a controller's arm leaves the programmed lines: zones cut corners."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import njit
from planner.export.player.played import Played
from planner.export.program import RobotProgram

TICK = 4e-3  # s between instants at which the path is looked at: those of a controller
MOST_TICKS = 1_000_000  # of a program; longer ones are looked at more coarsely


def lagging_both_ways(way: Array, keep: float, moving: bool = False) -> Array:
    """A way (k, n) through the filter that weighs what was commanded before and after by `keep` to the power of the ticks
    between.

    moving: beyond its ends it goes on along its first and last line, where it else rests
    """
    late = _late(way, keep, moving)
    return _late(late[::-1] - late[-1], keep, moving)[::-1] + late[-1]


def _late(way: Array, keep: float, moving: bool) -> Array:
    """What follows a way (k, n) late, from rest, or as it has along its first line for long."""
    slope, out = way[1] - way[0] if moving else 0.0, np.empty(way.shape)
    _lagging(np.ascontiguousarray(way), keep, way[0] - slope / (1.0 - keep), out)
    return out


@njit
def _lagging(way: Array, keep: float, start: Array, out: Array) -> None:
    """Fill `out` (k, n) with what follows a way (k, n) late, a tick before it at a start (n): of each tick a share of 1 - keep.

    As scipy's `lfilter`, digit by digit, whose package takes half a second to import.
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
    # an arc's direction at its end: half a chord's turn beyond that of its last chord
    arc, first, move = program.circular[played.move], np.maximum(knot - 2, 0), played.move
    turns = arc[knot - 1] & (move[first] == move[knot - 1])
    comes = np.where(turns[:, None], comes + 0.5 * (comes - unit[first]), comes)
    after = np.minimum(knot + 1, len(unit) - 1)
    turns = arc[knot] & (move[after] == move[knot])
    goes = np.where(turns[:, None], goes - 0.5 * (unit[after] - goes), goes)
    reach = np.minimum(program.zone[:-1], 0.5 * np.minimum(moves[:-1], moves[1:]))
    # the middle of a parabola whose tangents reach so far to both sides
    cut = 0.25 * reach * np.linalg.norm(goes - comes, axis=1)
    return np.append(np.where(program.fine[:-1], 0.0, cut), 0.0)
