"""How fast a controller follows knots: the slowest of tip, reorientation, axes and joints, with ramps and corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.export.player.played import PHASES, TIMES
from planner.export.player.postures import Knots
from planner.export.program import Program
from planner.export.rotations import angle
from planner.readonly import Array, Indices

if TYPE_CHECKING:
    from planner.cell import Cell


# Metres of path that a joint's way counts as, by the second that it would take at its own speed limit: where the tip
# hardly moves, or stands, joints measure the path. A printing tip moves faster than this.
METRES_PER_SECOND = 0.02
NO_WAY = 1e-9  # m of path between knots: less is none
TIP, TURNING, AXIS = 0, 1, 2  # what a speed follows from; joints follow


@dataclass(frozen=True)
class Pace:
    """`leave`, `length`, `phases`, `limit` and `arrive` of `Played`, and the names of the limits."""

    leave: Array
    length: Array
    phases: Array
    limit: Indices
    limits: tuple[str, ...]
    arrive: Array


def pace(program: Program, cell: Cell, knots: Knots) -> Pace:
    """When the robot passes every knot.

    On each way between knots the top speed is what the slowest of five allows: the programmed speed of the tip in the
    work object, of reorientation there, of the station's axes, and the speed limits of the joints. Speed changes with
    the greatest acceleration along the path that the limits of all joints allow on that way, from one programmed speed
    to the next within the zone of the target between. At `fine` targets the robot comes to rest. At others it turns
    along a parabola within the zone, cut to half of the lines beside it, at a speed at which the joints can change from
    one line to the next within it.
    """
    external = knots.q[:, len(cell.arm) :]
    change = np.abs(np.diff(knots.q, axis=0))
    tip = np.linalg.norm(np.diff(knots.position, axis=0), axis=1)
    programmed = program.speed[knots.move]
    times = np.column_stack(
        [
            tip / programmed[:, 0],
            angle(knots.quat[1:], knots.quat[:-1]) / programmed[:, 1],
            np.abs(np.diff(external, axis=0)).max(axis=1, initial=0.0) / programmed[:, 3],
            change / cell.limits.velocity,
        ]
    )
    limit = np.argmax(times, axis=1)
    length = np.maximum(tip, METRES_PER_SECOND * times[:, AXIS + 1 :].max(axis=1))
    length[length < NO_WAY] = 0.0
    phases = np.zeros((len(length), len(PHASES)))
    goes = np.flatnonzero(length > 0.0)
    if len(goes):
        way, rate = length[goes], np.diff(knots.q, axis=0)[goes] / length[goes, None]
        with np.errstate(divide="ignore"):
            steepest = (cell.limits.acceleration / np.abs(rate)).min(axis=1)
            hard = (way / times[goes, AXIS + 1 :].max(axis=1)) ** 2
        top = (way / times[goes].max(axis=1)) ** 2
        phases[goes] = _phases(program, cell, knots, _Ways(goes, way, rate, steepest, top, hard))
    took = phases[:, TIMES].sum(axis=1)
    waits = np.zeros(len(knots.q))
    waits[knots.target] += program.wait  # targets are at different knots, even where they are at the same place
    leave = np.concatenate([[0.0], np.cumsum(took + waits[1:])])
    joints = (f"the speed limit of {name}" for name in cell.joint_names)
    names = ("the tip", "reorientation", "an axis of the station", *joints)
    return Pace(leave, length, phases, limit, names, leave[knots.target] - program.wait)


@dataclass(frozen=True)
class _Ways:
    """The ways that are longer than none (w) and what bounds the speed on them.

    index, length  which they are; metres of path
    rate           (w, n) of the joints, by metre of path
    steepest       acceleration along the path that the joints allow [m/s^2]
    top, hard      squares of the speeds that program and joints allow, and joints alone [m^2/s^2]
    """

    index: Indices
    length: Array
    rate: Array
    steepest: Array
    top: Array
    hard: Array


def _phases(program: Program, cell: Cell, knots: Knots, ways: _Ways) -> Array:
    """`Played.phases` (w, 6) of ways."""
    square = np.zeros(len(ways.index) + 1)  # of the speed at the ends of ways; at rest at the first and the last
    square[1:-1] = _between(program, cell, knots, ways)
    # the least of all earlier bounds, each raised by what can be gained since: a running minimum, both ways
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


def _between(program: Program, cell: Cell, knots: Knots, ways: _Ways) -> Array:
    """Square of the speed (w - 1) [m^2/s^2] at which the robot may go from one way to the next: 0 where it rests."""
    k = len(knots.q)
    zone, fine = np.full(k, np.inf), np.zeros(k, dtype=bool)
    zone[knots.target] = program.zone
    fine[knots.target] = program.fine
    # all knots that stand at one place, between the end of a way and the beginning of the next, count together
    first, after = ways.index[:-1] + 1, ways.index[1:] + 1
    stops = np.concatenate([[0], np.cumsum(fine)])
    rests = stops[after] > stops[first]
    zone = np.minimum.reduceat(np.append(zone, np.inf), np.column_stack([first, after]).ravel())[::2]
    is_target = np.isfinite(zone)
    half = 0.5 * np.minimum(ways.length[1:], ways.length[:-1])
    # within the zone of a target the speed goes over from one that is programmed to the next, half of it at the target
    low, high = np.minimum(ways.top[1:], ways.top[:-1]), np.maximum(ways.top[1:], ways.top[:-1])
    gain = 2.0 * np.minimum(ways.steepest[1:], ways.steepest[:-1]) * np.minimum(zone, half)
    change = np.where(is_target, np.minimum(0.5 * (low + high), low + gain), low)
    # and joints from one direction to the next: there the zone may take half of the whole line, elsewhere there is none
    move = knots.move[ways.index]
    lines = np.bincount(move, ways.length)[move]
    reach = np.where(is_target, np.minimum(zone, 0.5 * np.minimum(lines[1:], lines[:-1])), half)
    with np.errstate(divide="ignore"):
        turn = 2.0 * reach * (cell.limits.acceleration / np.abs(np.diff(ways.rate, axis=0))).min(axis=1)
    allowed = np.minimum(np.minimum(change, turn), np.minimum(ways.hard[1:], ways.hard[:-1]))
    out: Array = np.where(rests, 0.0, allowed)
    return out
