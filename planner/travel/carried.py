"""Travel that is carried along: the same ways between beads whose ends stand a little elsewhere.

A controller goes through the targets of its program wherever the work object stands, and joins them as it did before.
So the joints of a travel change from what they change by at its one end to what they change by at the other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.cell import Cell
from planner.cubics import Cubics, State, add, extremes
from planner.readonly import Array
from planner.timing import HEADROOM, TimedPath
from planner.travel.clearance import track
from planner.travel.plan import Travel, ViaHome, within_limits

_FAST = 0.995  # of the tip's greatest speed: what is slow enough between instants
# Position, velocity and acceleration at the end of three equal spells of jerk, for each jerk in turn (cf. h^3, h^2, h).
_REACHED = np.array([[19.0 / 6.0, 7.0 / 6.0, 1.0 / 6.0], [2.5, 1.5, 0.5], [1.0, 1.0, 1.0]])
_LONGER = 1.0 + 1e-9  # of what it takes to keep a limit, for rounding


def carried_travels(
    cell: Cell, travels: Sequence[Travel], timed: Sequence[TimedPath], speed: float
) -> list[Travel | None]:
    """Travel as planned, but between the ends of these beads, the tip no faster than speed [m/s]; home stays at home.

    Where it would be too fast for a joint or for the tip it takes longer; None if it cannot, for a bead's end moves.
    """
    out: list[Travel | None] = []
    for i, travel in enumerate(travels):
        start = None if i == 0 else timed[i - 1].end
        end = None if i == len(timed) else timed[i].start
        if not isinstance(travel, ViaHome):
            out.append(_carried(cell, travel, start, end, speed))
            continue
        away, back = _carried(cell, travel.out, start, None, speed), _carried(cell, travel.back, None, end, speed)
        out.append(None if away is None or back is None else ViaHome(away, back))
    return out


def _carried(cell: Cell, way: Cubics, start: State | None, end: State | None, speed: float) -> Cubics | None:
    """One way between other ends, its own where they are None; None where it would have to be slower, but cannot."""
    start, end = start or _resting(way.start.q), end or _resting(way.end.q)
    moved = between_ends(way, start, end)
    found, limits = extremes(moved), cell.limits
    times = max(
        1.0,
        float((found.velocity / limits.velocity).max()) / HEADROOM,
        float(np.sqrt((found.acceleration / limits.acceleration).max() / HEADROOM)),
        float(np.cbrt((found.jerk / limits.jerk).max() / HEADROOM)),
        track(cell, moved).tip_speed / (_FAST * speed),
    )
    if start.resting and end.resting:
        return moved if times <= _LONGER else slower(moved, times * _LONGER)
    return moved if within_limits(cell, moved) and track(cell, moved).tip_speed <= speed else None


def _resting(q: Array) -> State:
    return State(q, np.zeros_like(q), np.zeros_like(q))


def between_ends(way: Cubics, start: State, end: State) -> Cubics:
    """A motion changed so that it leads from one state to another, in the same time, as smoothly as it did.

    The change has constant jerk in each third of the time: six conditions at the ends determine it. A motion that
    takes no time stays as it is.
    """
    if way.duration == 0.0:
        return way
    T = way.duration
    h = T / 3.0
    q0, v0, a0 = (ours - theirs for ours, theirs in zip(start, way.start, strict=True))
    q1, v1, a1 = (ours - theirs for ours, theirs in zip(end, way.end, strict=True))
    left = np.stack([(q1 - q0 - T * (v0 + 0.5 * T * a0)) / h**3, (v1 - v0 - T * a0) / h**2, (a1 - a0) / h])
    jerks = np.linalg.solve(_REACHED, left)
    coefficients = np.empty((4, 3, len(q0)))
    for k, jerk in enumerate(jerks):
        coefficients[:, k] = jerk / 6.0, a0 / 2.0, v0, q0
        q0 = q0 + h * (v0 + h * (a0 / 2.0 + h * jerk / 6.0))
        v0 = v0 + h * (a0 + h * jerk / 2.0)
        a0 = a0 + h * jerk
    return add(way, Cubics(np.array([0.0, h, 2.0 * h, T]), coefficients))


def slower(motion: Cubics, times: float) -> Cubics:
    """The same motion, taking so many times as long."""
    powers = times ** np.arange(3.0, -1.0, -1.0)
    return Cubics(motion.times * times, motion.coefficients / powers[:, None, None])
