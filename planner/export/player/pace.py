"""Pace of a program: the slowest of tip, reorientation, axes and joints, with a controller's ramps and corners."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from planner.base.arrays import Array, Flags, Indices
from planner.export.fit import angle, from_matrix
from planner.export.player.controller import PostureKnots
from planner.export.player.model import MotionModel
from planner.export.player.played import PHASES, TIMES
from planner.export.program import RobotProgram

if TYPE_CHECKING:
    from planner.cell.cell import Cell

# Metres of path for each second that a joint would take at its own speed limit: where the tip hardly moves, or stands
# still, joints measure the path. A printing tip moves faster than this.
METRES_PER_SECOND = 0.02
NO_WAY = 1e-9  # [m] of path between knots; less counts as none
TIP, TURNING, AXIS = 0, 1, 2  # what limits a speed; the joints come next, then the planning of moves


@dataclass(frozen=True)
class PlayedPace:
    """`leave`, `length`, `phases`, `limit` and `arrive` of `Played`, and the names of the limits."""

    leave: Array
    length: Array
    phases: Array
    limit: Indices
    limits: tuple[str, ...]
    arrive: Array


def pace(program: RobotProgram, cell: Cell, knots: PostureKnots, model: MotionModel) -> PlayedPace:
    """When the robot passes each knot.

    On each way between knots, the top speed is that of the slowest of these: the programmed speeds of the tip in the
    work object, of reorientation there, and of the station's axes or a second arm; the speed limits of the joints; and
    the time that the controller needs to plan a move. Speed changes with the greatest acceleration along the path that
    the limits of all joints and the model's jerk allow, from one programmed speed to the next within the zone of the
    target between them. At `fine` targets the robot comes to rest. At others it turns within the zone, limited to half
    of the adjacent lines, at a speed at which the joints can change from one line to the next. It is never faster than
    it can brake from within the moves that the controller knows.
    """
    change = np.abs(np.diff(knots.q, axis=0))
    external, turns = change[:, cell.besides], cell.limits.turns[list(cell.besides)]
    tip = np.linalg.norm(np.diff(knots.position, axis=0), axis=1)
    programmed = program.speed[knots.move]
    axes = np.maximum(
        external[:, turns].max(axis=1, initial=0.0) / programmed[:, 3],
        external[:, ~turns].max(axis=1, initial=0.0) / programmed[:, 2],
    )
    times = np.column_stack(
        [
            tip / programmed[:, 0],
            angle(knots.quat[1:], knots.quat[:-1]) / programmed[:, 1],
            axes if program.second is None else _second_arm(program.second[1:][knots.move], cell, knots),
            change / cell.limits.velocity,
        ]
    )
    limit, least = np.argmax(times, axis=1), times.max(axis=1)
    stretch = _planned(_summed(knots.move, least, len(program.linear)), model)[knots.move]
    limit, least = np.where(stretch > 1.0, times.shape[1], limit), least * stretch
    hard_times = times[:, AXIS + 1 :].max(axis=1)
    length = np.maximum(tip, METRES_PER_SECOND * hard_times)
    length[length < NO_WAY] = 0.0
    phases = np.zeros((len(length), len(PHASES)))
    goes = np.flatnonzero(length > 0.0)
    if len(goes):
        way, rate = length[goes], np.diff(knots.q, axis=0)[goes] / length[goes, None]
        with np.errstate(divide="ignore"):
            steepest = (cell.limits.acceleration / np.abs(rate)).min(axis=1)
            hard = (way / hard_times[goes]) ** 2
        top = (way / least[goes]) ** 2
        phases[goes] = _phases(program, cell, knots, _Ways(goes, way, rate, steepest, top, hard), model)
    took = phases[:, TIMES].sum(axis=1)
    waits = np.zeros(len(knots.q))
    waits[knots.target] += program.wait  # targets are at different knots, even where they are at the same place
    leave = np.concatenate([[0.0], np.cumsum(took + waits[1:])])
    joints = (f"the speed limit of {name}" for name in cell.joint_names)
    station = "an axis of the station" if program.second is None else "the arm that moves the part"
    names = ("the tip", "reorientation", station, *joints, "the planning of moves")
    return PlayedPace(leave, length, phases, limit, names, leave[knots.target] - program.wait)


def _second_arm(speed: Array, cell: Cell, knots: PostureKnots) -> Array:
    """Times (k - 1) [s] that the arm that moves the part takes at its flange's speeds (k - 1, 4) in the world.

    The slower of two synchronised arms sets the pace of both (ABB, MultiMove: robot speeds).
    """
    flange = cell.flange_of_second_arm(np.ascontiguousarray(knots.q[:, len(cell.arm) :]))
    way = np.linalg.norm(np.diff(flange[:, :3, 3], axis=0), axis=1)
    quat = from_matrix(flange[:, :3, :3])
    out: Array = np.maximum(way / speed[:, 0], angle(quat[1:], quat[:-1]) / speed[:, 1])
    return out


def _planned(took: Array, model: MotionModel) -> Array:
    """Factors (m) that stretch moves, given their times (m) [s], so that the controller can plan them in time."""
    count, m = min(model.ahead_moves, len(took)), len(took)
    out = np.ones(m)
    if model.move_time <= 0.0:
        return out
    since = np.concatenate([[0.0], np.cumsum(took)])
    together = since[count:] - since[:-count]
    needed = np.where(together > 0.0, count * model.move_time / np.where(together > 0.0, together, 1.0), 1.0)
    for k in range(count):
        np.maximum(out[k : k + len(needed)], needed, out=out[k : k + len(needed)])
    return out


def _summed(move: Indices, values: Array, count: int) -> Array:
    """Sums (count) of values (w) over each move, given their moves (w)."""
    out: Array = np.bincount(move, values, minlength=count).astype(np.float64)
    return out


# ----------------------------------------------------------------------------------------------------
# Ramps: from one speed to the next, as steep as joints and jerk allow.

ROUNDS = 4  # iterations on the height of each ramp, and with it its steepness; each cuts the error to a quarter
SPAN = 0.15  # [s] to either side within which speeds belong to the same ramp: the longest S from 0 to 0.4 m/s
TICK = 0.01  # [s] between instants at which that is evaluated
SMALLEST = 1e-3  # [m/s]; least change of speed of a ramp
MOST_TICKS = 2_000_000  # of a program; longer ones are evaluated more coarsely


@dataclass(frozen=True)
class _Ways:
    """The ways with a length (w), and what bounds the speed on them.

    index, length  their indices; metres of path
    rate           (w, n) of the joints, per metre of path
    steepest       acceleration along the path that the joints allow [m/s^2]
    top, hard      squares of the speeds that program and joints, and joints alone, allow [m^2/s^2]
    """

    index: Indices
    length: Array
    rate: Array
    steepest: Array
    top: Array
    hard: Array


def _phases(program: RobotProgram, cell: Cell, knots: PostureKnots, ways: _Ways, model: MotionModel) -> Array:
    """`Played.phases` (w, 6) of ways."""
    over, joints, known = np.sqrt(ways.top), ways.steepest, np.full(len(ways.index), np.inf)
    if model.ahead_moves < len(knots.target):
        steepest = ramp(over, joints, model) if model.ramp > 0.0 else joints
        known = _brakable(knots, ways, steepest, model.ahead_moves)
    for _ in range(ROUNDS if model.ramp > 0.0 else 1):
        if model.ramp > 0.0:
            ways = replace(ways, steepest=ramp(over, joints, model))
        phases = _trapezoids(ways, np.minimum(_between(program, cell, knots, ways, model), known[1:]))
        over = _led_over(phases)
    return phases


def _brakable(knots: PostureKnots, ways: _Ways, steepest: Array, moves: int) -> Array:
    """Square of the speed (w) [m^2/s^2] from which the robot can stop within the moves known when each way begins."""
    move = knots.move[ways.index]
    last = np.searchsorted(move, move + moves, side="right")
    gain = np.concatenate([[0.0], np.cumsum(2.0 * steepest * ways.length)])
    out: Array = np.where(last < len(move), gain[last] - gain[:-1], np.inf)
    return out


def ramp(over: Array, steepest: Array, model: MotionModel) -> Array:
    """Constant acceleration [m/s^2] that takes as long as the model's S-shaped ramp over a change of speed (k) [m/s].

    steepest   acceleration [m/s^2] that the joints allow in the middle of the S (k), which is `peak` times its mean
    """
    over = np.maximum(over, SMALLEST)
    out: Array = np.minimum(over ** (2.0 / 3.0) / model.ramp, steepest / model.peak)
    return out


def _led_over(phases: Array) -> Array:
    """Difference between the greatest and the least speed (w) [m/s] around each way: the height of its ramps."""
    v0, a, begin, even, b, end = phases.T
    middle = v0 + a * begin
    v1 = middle + b * end
    low, high = np.minimum(np.minimum(v0, v1), middle), np.maximum(np.maximum(v0, v1), middle)
    after = np.cumsum(begin + even + end)
    tick = max(TICK, float(after[-1]) / MOST_TICKS)
    first = ((after - (begin + even + end)) / tick).astype(np.intp)
    count = int(after[-1] / tick) + 1
    least, most = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(least, first, low)
    np.maximum.at(most, first, high)
    span = 2 * int(np.ceil(SPAN / tick)) + 1
    least = minimum_filter1d(least, span, mode="nearest")
    most = maximum_filter1d(most, span, mode="nearest")
    out: Array = np.maximum(high, most[first]) - np.minimum(low, least[first])
    return out


def _trapezoids(ways: _Ways, between: Array) -> Array:
    """`Played.phases` (w, 6) of ways with constant accelerations; `between` (w - 1) bounds squared speeds [m^2/s^2]."""
    square = np.zeros(len(ways.index) + 1)  # of the speed at the ends of ways; at rest at the first and the last
    square[1:-1] = between
    # the least of all earlier bounds, each raised by what can be gained since: a running minimum, in both directions
    gain = np.concatenate([[0.0], np.cumsum(2.0 * ways.steepest * ways.length)])
    square = np.minimum(square, gain + np.minimum.accumulate(square - gain))
    square = np.minimum(square, np.minimum.accumulate((square + gain)[::-1])[::-1] - gain)
    square = np.maximum(square, 0.0)
    v0, v1 = np.sqrt(square[:-1]), np.sqrt(square[1:])
    middle = np.sqrt(np.minimum(ways.top, 0.5 * (square[:-1] + square[1:]) + ways.steepest * ways.length))
    begin, end = np.abs(middle - v0) / ways.steepest, np.abs(middle - v1) / ways.steepest
    even = ways.length - 0.5 * (v0 + middle) * begin - 0.5 * (v1 + middle) * end
    rise, fall = np.copysign(ways.steepest, middle - v0), np.copysign(ways.steepest, v1 - middle)
    return np.column_stack([v0, rise, begin, np.maximum(even, 0.0) / middle, fall, end])


# ----------------------------------------------------------------------------------------------------
# Corners.


def _between(program: RobotProgram, cell: Cell, knots: PostureKnots, ways: _Ways, model: MotionModel) -> Array:
    """Square of the speed (w - 1) [m^2/s^2] at which the robot may go from one way to the next; 0 where it rests."""
    k = len(knots.q)
    zone, fine = np.full(k, np.inf), np.zeros(k, dtype=bool)
    zone[knots.target] = program.zone
    fine[knots.target] = program.fine
    # knots at the same place, between the end of a way and the beginning of the next, count as one
    first, after = ways.index[:-1] + 1, ways.index[1:] + 1
    stops = np.concatenate([[0], np.cumsum(fine)])
    rests = stops[after] > stops[first]
    zone = np.minimum.reduceat(np.append(zone, np.inf), np.column_stack([first, after]).ravel())[::2]
    is_target = np.isfinite(zone)
    half = 0.5 * np.minimum(ways.length[1:], ways.length[:-1])
    # within a target's zone the speed changes from one programmed speed to the next, half of it by the target
    low, high = np.minimum(ways.top[1:], ways.top[:-1]), np.maximum(ways.top[1:], ways.top[:-1])
    gain = 2.0 * np.minimum(ways.steepest[1:], ways.steepest[:-1]) * np.minimum(zone, half)
    change = np.where(is_target, np.minimum(0.5 * (low + high), low + gain), low)
    # and the joints turn from one way to the next: a zone may take half of a whole line; other knots have no zone
    move = knots.move[ways.index]
    lines = np.bincount(move, ways.length)[move]
    whole = 0.5 * np.minimum(lines[1:], lines[:-1])
    with np.errstate(divide="ignore"):
        share = (cell.limits.acceleration / np.abs(np.diff(ways.rate, axis=0))).min(axis=1)
    turning = turned_at(share, np.where(is_target, np.minimum(zone, whole), half), is_target, model)
    allowed = np.minimum(_shared(change, turning, is_target, model), 2.0 * np.where(is_target, whole, half) * share)
    allowed = np.minimum(allowed, np.minimum(ways.hard[1:], ways.hard[:-1]))
    out: Array = np.where(rests, 0.0, allowed)
    return out


def turned_at(share: Array, reach: Array, is_target: Flags, model: MotionModel) -> Array:
    """Square of the speed (k) [m^2/s^2] at which joints can turn from one way to the next.

    share   joint acceleration over the change in joint rate per metre, the least of all joints [m^2/s^2 per m]
    reach   of the zone, to either side [m]: a turn takes a time of 2 reach / v + settling, and the joints' speeds
            change in it by v / share times their accelerations
    """
    if model.settling <= 0.0:
        out: Array = 2.0 * reach * np.where(is_target, model.corner, 1.0) * share
        return out
    a = np.where(is_target, model.corner, 1.0) * share
    with np.errstate(invalid="ignore", over="ignore"):  # where joints do not turn at all, a is infinite
        linear = 0.5 * a * np.where(is_target, model.settling, 0.0)
        square = (linear + np.sqrt(linear**2 + 2.0 * reach * a)) ** 2
    return np.where(np.isfinite(a), square, np.inf)


def _shared(change: Array, turning: Array, is_target: Flags, model: MotionModel) -> Array:
    """Both bounds on squared speeds combined: the lesser or, with a model's `sharing`, less where they are close."""
    if not np.isfinite(model.sharing):
        return np.minimum(change, turning)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(is_target, change / turning, 0.0)
        less = change * (1.0 + ratio ** (0.5 * model.sharing)) ** (-2.0 / model.sharing)
    return np.where(is_target & np.isfinite(less), less, np.minimum(change, turning))
