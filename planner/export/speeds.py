"""Programmed speeds: one for as many moves as keep the plan's clock, none so quick that a controller cannot follow."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from planner.base.arrays import Array, Indices
from planner.base.compiled import inner_njit, njit

if TYPE_CHECKING:
    from planner.export.moves import Moves

TIME_TOLERANCE = (
    8e-3  # [s] by which a target may be passed too early or too late; keeps dips of the speed in the program
)
STEPS = ((0.01, 1e-4), (0.001, 1e-5), (0.0, 1e-6))  # from a speed [m/s] on, speeds are multiples of the second [m/s]
ON_STEP = 1e-9  # of a speed, by which rounding may leave its step
BRIEF = 6.0  # of that tolerance: what a shorter bead may be late by would be too large a share of it
CATCHING_UP = 1.01  # times the plan's greatest speed, with which a program that is late may go on: hardly faster


def even_speeds(length: Array, took: Array, group: Indices, usual: Array, least: float) -> Array:
    """Programmed speeds (m) [m/s] with which moves of given lengths [m] pass their targets when planned, to TIME_TOLERANCE.

    took   (m) time of each move [s]
    group  (m) moves of one number share a clock, which begins with the first; 0: the mean speed of the move itself
    usual  (m) speed that is taken wherever it keeps the clock, the same in a group [m/s]
    least  time that each move is given, even if it took less, as far as the clock can be kept [s]; but in beads that take
           less than BRIEF tolerances, whose moves are as quick as planned
    """
    own = group > 0
    brief = np.bincount(group, weights=took)[group] < BRIEF * TIME_TOLERANCE
    quicker = max(1.0, float((length[own] / took[own] / usual[own]).max(initial=0.0)))
    kept = np.where(own & brief, -1, group)
    return _even_speeds(
        length, np.ascontiguousarray(took), kept, usual, SpeedRules(least, TIME_TOLERANCE, CATCHING_UP * quicker)
    )


class SpeedRules(NamedTuple):
    """What programmed speeds keep to.

    least    time of a move [s]
    most     time by which a target may be passed too early or too late [s]
    fastest  speed of a move, over the usual one
    """

    least: float
    most: float
    fastest: float


@inner_njit
def _stepped(slowness: float, floor: float) -> float:
    """The nearest slowness [s/m] whose speed programs have; where it may not be below `floor`, the next above."""
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
    """`even_speeds`: each speed holds for as many moves as it can; what the clock is late by goes on to the next."""
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
        # bounds of slowness: of the clock, and of the least time and greatest speed, which give way where both cannot be had
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
# In the steps of a language.


def stepped_speeds(moves: Moves, step: float) -> Array:
    """Speed (m) [m/s] of each move in whole steps [m/s], at least one.

    Of moves that lay material each is rounded such that the sum of their times stays nearest to what was planned, so that
    no bead runs late however long it is; of others, to the nearest.
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
