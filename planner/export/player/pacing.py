"""How fast a controller follows knots: the slowest of tip, reorientation, axes and joints, with ramps and corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.player.postures import Knots
from planner.export.program import Program
from planner.export.rotations import angle

if TYPE_CHECKING:
    from planner.cell import Cell

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

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
    the greatest acceleration along the path that the limits of all joints allow on that way. At `fine` targets the
    robot comes to rest. At others it turns along a parabola within the zone, cut to half of the ways beside it, at a
    speed at which the joints can change from one way to the next within it.
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
    phases = np.zeros((len(length), 5))
    goes = np.flatnonzero(length > 0.0)
    if len(goes):
        phases[goes] = _phases(program, cell, knots, goes, length[goes], times[goes].max(axis=1))
    took = phases[:, 2:].sum(axis=1)
    waits = np.zeros(len(knots.q))
    waits[knots.target] += program.wait  # targets are at different knots, even where they are at the same place
    leave = np.concatenate([[0.0], np.cumsum(took + waits[1:])])
    names = ("the tip", "reorientation", "an axis of the station", *cell.joint_names)
    return Pace(leave, length, phases, limit, names, leave[knots.target] - program.wait)


def _phases(program: Program, cell: Cell, knots: Knots, goes: Indices, length: Array, least: Array) -> Array:
    """`Played.phases` (w, 5) of the ways `goes` (w), which are no shorter than they are long (w) and quick at best (w)."""
    rate = np.diff(knots.q, axis=0)[goes] / length[:, None]  # of the joints, by metre of path
    with np.errstate(divide="ignore"):
        steepest = (cell.limits.acceleration / np.abs(rate)).min(axis=1)
    top = (length / least) ** 2
    square = np.zeros(len(goes) + 1)  # of the speed at the ends of ways; at rest at the first and the last
    square[1:-1] = np.minimum(np.minimum(top[1:], top[:-1]), _corners(program, cell, knots, goes, length, rate))
    gain = 2.0 * steepest * length
    # the least of all earlier bounds, each raised by what can be gained since: a running minimum, both ways
    sum_ = np.concatenate([[0.0], np.cumsum(gain)])
    square = np.minimum(square, sum_ + np.minimum.accumulate(square - sum_))
    square = np.minimum(square, np.minimum.accumulate((square + sum_)[::-1])[::-1] - sum_)
    speed = np.sqrt(np.maximum(square, 0.0))
    v0, v1 = speed[:-1], speed[1:]
    peak = np.sqrt(np.minimum(top, 0.5 * (v0**2 + v1**2) + steepest * length))
    peak = np.maximum(peak, np.maximum(v0, v1))
    up, down = (peak - v0) / steepest, (peak - v1) / steepest
    even = np.maximum(length - 0.5 * (v0 + peak) * up - 0.5 * (v1 + peak) * down, 0.0) / peak
    return np.column_stack([v0, steepest, up, even, down])


def _corners(program: Program, cell: Cell, knots: Knots, goes: Indices, length: Array, rate: Array) -> Array:
    """Square of the speed (w - 1) [m^2/s^2] between ways: 0 where the robot comes to rest."""
    k = len(knots.q)
    zone, fine = np.full(k, np.inf), np.zeros(k, dtype=bool)
    zone[knots.target] = program.zone
    fine[knots.target] = program.fine
    # all knots that stand at one place, between the end of a way and the beginning of the next, count together
    first, after = goes[:-1] + 1, goes[1:] + 1
    stops = np.concatenate([[0], np.cumsum(fine)])
    rests = stops[after] > stops[first]
    zone = np.minimum.reduceat(np.append(zone, np.inf), np.column_stack([first, after]).ravel())[::2]
    reach = np.minimum(zone, 0.5 * np.minimum(length[1:], length[:-1]))
    with np.errstate(divide="ignore"):
        square = 2.0 * reach * (cell.limits.acceleration / np.abs(np.diff(rate, axis=0))).min(axis=1)
    out: Array = np.where(rests, 0.0, square)
    return out
