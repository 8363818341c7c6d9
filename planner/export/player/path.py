"""Where a controller's arm leaves the programmed lines: zones cut corners, and the arm follows its commands late."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from planner.base.arrays import Array
from planner.export.player.model import MotionModel
from planner.export.player.played import Played
from planner.export.program import RobotProgram

TICK = 4e-3  # s between instants at which the path is looked at: those of a controller
MOST_TICKS = 1_000_000  # of a program; longer ones are looked at more coarsely


@dataclass(frozen=True)
class Deviation:
    """Distance of the played tip from the programmed path.

    at       (m) at the target of each move [m]; 0 where the robot rests
    t, off   (k) instants [s], and how far the arm lags aside there, zones left out [m]
    """

    at: Array
    t: Array
    off: Array


def deviation(program: RobotProgram, played: Played, model: MotionModel) -> Deviation:
    """How far the tip leaves the programmed path, to the side: in its own frame, as the model is held against recordings
    (`benchmarks.controller`). Forecasts follow the joints instead, see `executed_run`.

    Within a zone the path is that of `corner_depth`. The arm follows with a lag, as through a filter that weighs what was
    commanded dt before and after by exp(-|dt| / lag): a corner is rounded by speed, lag and half of the change of
    direction; a curve is cut by the square of the lag times its acceleration across.
    """
    depth = model.depth * corner_depth(program, played)
    tick = max(TICK, played.duration / MOST_TICKS)
    t = np.arange(0.0, played.duration + tick, tick)
    position = played.at(t).position
    off = np.zeros(len(t))
    if model.lag > 0.0 and len(t) > 2:
        keep = np.exp(-tick / model.lag)
        way = position - position[0]
        late, _ = lfilter([1.0 - keep], [1.0, -keep], way, axis=0, zi=keep * way[:1])
        back = late[::-1] - late[-1]
        early, _ = lfilter([1.0 - keep], [1.0, -keep], back, axis=0, zi=keep * back[:1])
        moved = early[::-1] + late[-1] - way
        along = np.gradient(position, tick, axis=0)
        size = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.where(size > 0.0, size, 1.0)
        off = np.linalg.norm(moved - (moved * along).sum(axis=1, keepdims=True) * along, axis=1)
    lagging = np.interp(played.arrive, t, off)
    return Deviation(np.where(program.fine, 0.0, np.hypot(depth, lagging)), t, off)


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
