"""Programmed speeds: one for as many moves as keeps to the plan's clock, none too fast for a controller to follow."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from planner.base.arrays import Array, Indices
from planner.base.compiled import inner_njit, njit

if TYPE_CHECKING:
    from planner.export.moves import Moves

TIME_TOLERANCE = (
    8e-3  # [s] by which a target may be passed too early or too late; small enough to keep dips in speed in the program
)
STEPS = ((0.01, 1e-4), (0.001, 1e-5), (0.0, 1e-6))  # (from this speed up [m/s], speeds are multiples of this [m/s])
ON_STEP = 1e-9  # share of a speed by which rounding may leave its step
BRIEF = 6.0  # × TIME_TOLERANCE: in a shorter bead that tolerance would be too large a share of its time
CATCHING_UP = 1.01  # × the plan's greatest speed: the fastest that a late program may go on


def even_speeds(length: Array, took: Array, group: Indices, usual: Array, least: float) -> Array:
    """Programmed speeds (m) [m/s] with which moves of given lengths [m] pass targets on time, within TIME_TOLERANCE.

    took   (m) time of each move [s]
    group  (m) moves with the same number share a clock, which starts with the first; 0: the move's own mean speed
    usual  (m) speed used wherever it keeps to the clock, the same throughout a group [m/s]
    least  time given to each move, even if it took less, as far as the clock allows [s]; except in beads that take less
           than BRIEF tolerances, whose moves are as fast as planned
    """
    own = group > 0
    brief = np.bincount(group, weights=took)[group] < BRIEF * TIME_TOLERANCE
    quicker = max(1.0, float((length[own] / took[own] / usual[own]).max(initial=0.0)))
    kept = np.where(own & brief, -1, group)
    return _even_speeds(
        length, np.ascontiguousarray(took), kept, usual, SpeedRules(least, TIME_TOLERANCE, CATCHING_UP * quicker)
    )


class SpeedRules(NamedTuple):
    """Limits on programmed speeds.

    least    least time of a move [s]
    most     time by which a target may be passed too early or too late [s]
    fastest  greatest speed of a move, as a multiple of the usual one
    """

    least: float
    most: float
    fastest: float


@inner_njit
def _stepped(slowness: float, floor: float) -> float:
    """The nearest slowness [s/m] whose speed is on a step; if that is below `floor`, the next one above."""
    speed = 1.0 / slowness
    step = STEPS[2][1]
    for k in range(len(STEPS)):
        if speed >= STEPS[k][0]:
            step = STEPS[k][1]
            break
    steps = max(np.rint(speed / step), 1.0)
    if steps > 1.0 and steps * step * floor > 1.0 + ON_STEP:
        steps -= 1.0
    return 1.0 / (steps * step)


@njit
def _even_speeds(length: Array, took: Array, group: Indices, usual: Array, rules: SpeedRules) -> Array:
    """`even_speeds`: each speed holds for as many moves as it can; the remaining delay is passed on to the next."""
    out = np.empty(len(length))
    i, late = 0, 0.0
    while i < len(length):
        if group[i] <= 0:
            out[i] = max(length[i] / took[i], STEPS[2][1])
            if group[i] < 0:
                out[i] = 1.0 / _stepped(1.0 / out[i], 0.0)
            i += 1
            continue
        if i == 0 or group[i - 1] != group[i]:
            late = 0.0
        # bounds of slowness: from the clock; floor: from least time and greatest speed, which yield to the clock
        low, high, floor, way, time = 0.0, np.inf, 0.0, 0.0, 0.0
        slowness, end, after = 0.0, i, late
        k = i
        while k < len(length) and group[k] == group[i]:
            way, time = way + length[k], time + took[k]
            low, high = max(low, (time - late - rules.most) / way), min(high, (time - late + rules.most) / way)
            floor = max(floor, rules.least / length[k], 1.0 / (rules.fastest * usual[i]))
            if k == i:
                floor = min(floor, high)
            if max(low, floor) > high and k > i:
                break
            ideal = min(max((time - late) / way, low, floor), high)
            if ideal <= 0.0:
                break
            if max(low, floor) <= 1.0 / usual[i] <= high and late <= 0.5 * rules.most:
                chosen = 1.0 / usual[i]
            else:
                chosen = _stepped(ideal, floor)
            if k == i or max(low, floor * (1.0 - ON_STEP)) <= chosen <= high:
                slowness, end, after = chosen, k, late + way * chosen - time
            k += 1
        out[i : end + 1] = 1.0 / slowness
        late, i = after, end + 1
    return out


# ----------------------------------------------------------------------------------------------------
# Speeds in the steps of a language.


def stepped_speeds(moves: Moves, step: float) -> Array:
    """Speed (m) [m/s] of each move in whole steps [m/s], at least one.

    Speeds of moves that lay material are rounded so that the sum of their times stays closest to the plan, and no bead
    runs late however long it is; other speeds are rounded to the nearest step.
    """
    low = np.maximum(np.floor(moves.speed / step + 1e-9), 1.0)
    length, nearest = moves.length, np.maximum(np.round(moves.speed / step), 1.0)
    planned, slow, fast = (length / speed for speed in (moves.speed, low * step, (low + 1.0) * step))
    steps, late = nearest.tolist(), 0.0
    for i, (laid, least, meant, longer, shorter) in enumerate(
        zip(moves.laid.tolist(), low.tolist(), planned.tolist(), slow.tolist(), fast.tolist(), strict=True)
    ):
        if not laid:
            late = 0.0
            continue
        up = abs(late + shorter - meant) < abs(late + longer - meant)
        steps[i] = least + up
        late += (shorter if up else longer) - meant
    out: Array = np.array(steps) * step
    return out
