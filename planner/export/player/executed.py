"""How a controller's arm executes a played program: zones round its corners, and it lags behind its commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.export.fit import lerp
from planner.export.player.model import MotionModel
from planner.export.player.path import TICK, lagging_both_ways
from planner.export.player.played import Played
from planner.export.program import RobotProgram


@dataclass(frozen=True)
class ExecutedRun:
    """Joints q (k, n) [rad, m] of a whole run, at times t (k) [s]."""

    t: Array
    q: Array


def executed_run(program: RobotProgram, played: Played, model: MotionModel, tick: float = TICK) -> ExecutedRun:
    """The joints of a run, `tick` seconds apart, as a controller's model has them.

    Within a zone, the path leaves the corner by `model.depth` of what the parabola between the zone's ends does. The
    arm then follows as through a filter that weights commands dt before and after by exp(-|dt| / lag).
    """
    t = np.arange(0.0, played.duration + 0.5 * tick, tick)
    q = _rounded(program, played, model.depth, t)
    return ExecutedRun(t, followed(q, model.lag, tick))


def _rounded(program: RobotProgram, played: Played, depth: float, t: Array) -> Array:
    """Joints (k, n) at times t (k), with the corners at targets cut within their zones."""
    knot = np.clip(np.searchsorted(played.leave, t, side="right") - 1, 0, len(played.move) - 1)
    length = played.length
    share = np.clip(
        played.gone(knot, t - played.leave[knot]) / np.where(length[knot] > 0.0, length[knot], 1.0), 0.0, 1.0
    )
    q = lerp(played.q, knot, knot + 1, share)
    steps = np.linalg.norm(np.diff(played.position, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])  # distance travelled by the tip, at knots [m]
    at = way[knot] + share * steps[knot]
    target = played.target[:-1]
    if not len(target):
        return q
    moves = np.diff(way[np.concatenate([[0], played.target])])
    reach = np.where(program.fine[:-1], 0.0, np.minimum(program.zone[:-1], 0.5 * np.minimum(moves[:-1], moves[1:])))
    slope = np.diff(played.q, axis=0) / np.where(steps > 0.0, steps, np.inf)[:, None]  # joints per metre of the tip
    turn = slope[np.minimum(target, len(slope) - 1)] - slope[np.maximum(target - 1, 0)]
    for side in (0, 1):  # the corner behind, and the one ahead
        i = np.searchsorted(way[target], at, side="right") - 1 + side
        there = (i >= 0) & (i < len(target))
        i = np.clip(i, 0, len(target) - 1)
        inside = np.where(there, np.maximum(reach[i] - np.abs(at - way[target[i]]), 0.0), 0.0)
        q += (depth * inside**2 / np.where(reach[i] > 0.0, 4.0 * reach[i], 1.0))[:, None] * turn[i]
    return q


def followed(q: Array, lag: float, tick: float) -> Array:
    """Joints (k, n) smoothed by a lag [s] in both directions of time, which leaves out the delay itself."""
    if lag <= 0.0 or len(q) < 3:
        return q
    keep = np.exp(-tick / lag)
    return lagging_both_ways(q - q[0], float(keep)) + q[0]
