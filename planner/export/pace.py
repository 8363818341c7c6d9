"""How fast a controller may go where a plan does not say it move by move: as fast as the plan ever does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.readonly import Array

if TYPE_CHECKING:
    from planner.export.moves import Moves
    from planner.plan import Trajectory


def tip_acceleration(trajectory: Trajectory) -> float:
    """Greatest acceleration of the tip along its path [m/s^2], rounded up to a tenth."""
    return rounded_up(float(np.abs(np.diff(trajectory.speed)).max(initial=0.0)) / trajectory.dt)


def rounded_up(value: float) -> float:
    """The next tenth, at least one."""
    return max(1.0, float(np.ceil(10.0 * value))) / 10.0


def greatest_until_stop(moves: Moves, rates: Array) -> Array:
    """Greatest of the rates (n - 1), one for each step between samples, between the stops around each move (m).

    One speed for moves that are blended into each other: a blend between different ones leaves its lines. Joint and
    linear moves are not blended.
    """
    first = np.concatenate([[0], moves.sample[:-1]])
    peaks = np.maximum.reduceat(np.append(rates, 0.0), first)
    run = np.concatenate([[0], np.cumsum(moves.fine[:-1] | (moves.linear[1:] != moves.linear[:-1]))])
    highest = np.zeros(run[-1] + 1)
    np.maximum.at(highest, run, peaks)
    out: Array = highest[run]
    return out
