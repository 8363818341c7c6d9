"""Where a bead has to pause: the fewest places at which the arm leaves it, for another branch or to unwind a joint.

The ladder's graph once more, one bead at a time, with two things added. At a rung the nozzle may leave the bead and come back
in any posture, at a price above all others. And joints that turn further than once round carry their whole turns along, so
that their ranges count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.compiled import njit
from planner.base.geometry import TURN
from planner.cell.cell import Cell
from planner.resolve.joint_path import SampledTasks
from planner.resolve.nodes import Nodes
from planner.resolve.prices import PAUSE_PRICE
from planner.resolve.reach import LIMIT_ROOM
from planner.resolve.search import edge_price, joint_limits, ladder_numbers, travel_price
from planner.toolpath.task import NozzleTask

_MOST_TURNING = 3  # joints whose whole turns are carried along at once
_MOST_TURNS = 16  # of such a joint: one of more is as good as free
_FARTHEST = 1.0  # rad that a joint may turn from rung to rung: what turns further has mostly no path between them
_PAUSED, _NONE = 9, 255  # in place of one of the nine neighbours that a node is reached from


@dataclass(frozen=True)
class Pause:
    """A place of a bead at which the nozzle leaves it: arc length s [m], and the joint that would turn further than its
    range, empty where no branch leads on."""

    s: float
    joint: str


class Turning(NamedTuple):
    """The joints (k) whose whole turns are carried along: of the arm, or the swept one, which counts behind these; their
    ranges low, high (k) [rad], the fewest whole turns `least` (k) to be added, and how many different ones, `turns` (k)."""

    joint: Ints
    low: Array
    high: Array
    least: Ints
    turns: Ints


@dataclass(frozen=True)
class _Way:
    """A bead's way with the fewest pauses: states (r, 4) that arrive at its rungs and leave them, and what winds on it."""

    before: Ints
    after: Ints
    turning: Turning

    @property
    def pauses(self) -> Ints:
        """The rungs at which it pauses."""
        return np.flatnonzero((self.before != self.after).any(axis=1))


def pauses_of(
    cell: Cell,
    task: NozzleTask,
    demand: SampledTasks,
    nodes: Nodes,
    least_piece: float = 0.0,
    room: float = LIMIT_ROOM,
) -> tuple[Pause, ...] | None:
    """The fewest pauses with which a bead can be followed on its whole grid, in order; none if it can be in one go.

    None where pauses do not help. The first and the last piece are no shorter than `least_piece` [m]; what winds
    keeps `room` [rad] from the ends of its range.
    """
    s = task.s[demand.rung]
    begin, end = task.s[[task.first, task.last]]
    may = (s >= begin + least_piece) & (s <= end - least_piece)
    way = _fewest(cell, demand, nodes, may, room)
    if way is None:
        return None
    return tuple(Pause(float(s[r]), _unwound(cell, nodes, way, r)) for r in way.pauses)


def _fewest(cell: Cell, demand: SampledTasks, nodes: Nodes, may: Flags, room: float) -> _Way | None:
    """The way with the fewest pauses, which may be made at some rungs (r); of those the cheapest, about.

    Whole turns are carried along only of joints that turned further than their ranges without that.
    """
    may[[0, -1]] = False
    winding: list[int] = []
    while True:
        turning = _turning(cell, nodes, winding, room)
        if turning is None:
            return None
        numbers = ladder_numbers(nodes, demand)
        back, cheapest, last = fewest_pauses(numbers, joint_limits(nodes, cell.limits), may, turning)
        if last < 0:
            return None
        before, after = traced(numbers, turning, back, cheapest, last)
        way = _Way(before, after, turning)
        over = _overwound(cell, nodes, way, room) - set(winding)
        if not over:
            return way
        winding += sorted(over)


def _turning(cell: Cell, nodes: Nodes, winding: Sequence[int], room: float) -> Turning | None:
    """What the search carries along of the joints that wind; None where that is too much."""
    if len(winding) > _MOST_TURNING:
        return None
    joints = [_index(cell, nodes, k) for k in winding]
    low, high = cell.limits.q_min[joints] + room, cell.limits.q_max[joints] - room
    middle = 0.5 * (cell.limits.q_min[joints] + cell.limits.q_max[joints])
    least = np.ceil((low - middle - np.pi) / TURN).astype(np.int64)
    count = np.floor((high - middle + np.pi) / TURN).astype(np.int64) - least + 1
    if (count > _MOST_TURNS).any():
        return None
    return Turning(np.array(winding, dtype=np.int64), low, high, least, count)


def _index(cell: Cell, nodes: Nodes, k: int) -> int:
    """Index among all joints of the search's joint k: the arm's, then the swept one."""
    return nodes.joint if k == len(cell.arm) else k


def _values(cell: Cell, nodes: Nodes, states: Ints) -> Array:
    """Joints (r, na + 1) of states (r, 4) at rungs 0 .. r - 1, the swept one's place last (0 where it cannot wind)."""
    q = nodes.q[np.arange(len(states)), states[:, 0], states[:, 1], states[:, 2]].astype(float)
    swept = states[:, 1] * nodes.grid.holder_step if _sweeps_round(cell, nodes) else np.zeros(len(states))
    return np.hstack([q, swept[:, None]])


def _sweeps_round(cell: Cell, nodes: Nodes) -> bool:
    """Whether the swept joint is one of the holder that turns: those of the arm count as the arm's."""
    return len(cell.arm) <= nodes.joint < len(cell.joint_names) and nodes.joint not in cell.limits.sliding


def _overwound(cell: Cell, nodes: Nodes, way: _Way, room: float) -> set[int]:
    """Joints (the search's) that turn further than their ranges along a piece of a bead, however they are turned."""
    na = len(cell.arm)
    joints = [*range(na)] + ([na] if _sweeps_round(cell, nodes) else [])
    every = [_index(cell, nodes, k) for k in joints]
    turns = cell.limits.turns[every]
    low, high = cell.limits.q_min[every] + room, cell.limits.q_max[every] - room
    arrived, left = _values(cell, nodes, way.before)[:, joints], _values(cell, nodes, way.after)[:, joints]
    edges = [0, *way.pauses.tolist(), len(left) - 1]
    over: set[int] = set()
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        q = np.vstack([left[first:last], arrived[last : last + 1]])
        q = np.where(turns, np.unwrap(q, axis=0), q)
        add = np.where(turns, np.ceil((low - q.min(axis=0)) / TURN) * TURN, 0.0)
        over |= {joints[j] for j in np.flatnonzero(turns & (q.max(axis=0) + add > high))}
    return over


def _unwound(cell: Cell, nodes: Nodes, way: _Way, rung: int) -> str:
    """Name of the joint that has other whole turns behind a pause than before; empty if it is none."""
    states = [int(each[rung, 3]) for each in (way.before, way.after)]
    if states[0] == states[1]:
        return ""
    turns = np.array(np.unravel_index(states, tuple(way.turning.turns.tolist())))
    k = int(way.turning.joint[np.argmax(np.abs(turns[:, 0] - turns[:, 1]))])
    return cell.joint_names[_index(cell, nodes, k)]


# ----------------------------------------------------------------------------------------------------
# Compiled.


@njit(cache=True)
def _value(ladder, turning, k: int, r: int, i: int, b: int, c: int) -> float:
    """Place of joint k of those that wind, at a node, as it stands there: within half a turn of the middle of its range."""
    j = turning.joint[k]
    if j < ladder.q.shape[4]:
        return float(ladder.q[r, i, b, c, j])
    return b * ladder.holder_step


@njit(cache=True)
def _turned(ladder, turning, k: int, r: int, i: int, b: int, c: int) -> float:
    """The same, with whole turns added so that it is within half a turn of the middle of its range."""
    middle = 0.5 * (turning.low[k] + turning.high[k])
    value = _value(ladder, turning, k, r, i, b, c)
    return value - 2.0 * np.pi * np.rint((value - middle) / (2.0 * np.pi))


@njit(cache=True)
def _inside(ladder, turning, r: int, i: int, b: int, c: int, state: int) -> bool:
    """Whether all joints that wind are in their ranges at a node with these turns."""
    for k in range(turning.turns.size - 1, -1, -1):
        m = turning.least[k] + state % turning.turns[k]
        state //= turning.turns[k]
        q = _turned(ladder, turning, k, r, i, b, c) + 2.0 * np.pi * m
        if q < turning.low[k] or q > turning.high[k]:
            return False
    return True


@njit(cache=True)
def _carried(ladder, turning, r: int, i0: int, b0: int, i: int, b: int, c: int, state: int, sign: int) -> int:
    """Turns at a node of rung r that is reached from one of rung r - 1 with these turns, each joint the short way; with sign
    -1 those there, of these here. -1 where there are none such."""
    out, base = 0, 1
    for k in range(turning.turns.size - 1, -1, -1):
        d = _turned(ladder, turning, k, r, i, b, c) - _turned(ladder, turning, k, r - 1, i0, b0, c)
        m = state % turning.turns[k] - sign * int(np.rint(d / (2.0 * np.pi)))
        state //= turning.turns[k]
        if m < 0 or m >= turning.turns[k]:
            return -1
        out += base * m
        base *= turning.turns[k]
    return out


@njit(cache=True)
def fewest_pauses(ladder, limits, may, turning):
    """Dynamic programming over a bead's rungs, on the whole grid: where each state (roll, holder, branch, turns) came from
    (R, A, B, C, M), the cheapest state to arrive at each rung (R), and the one at the end; -1 where there is no way.

    may (R): rungs where the nozzle may leave the bead
    """
    q, price = ladder.q, ladder.price
    v, a, wraps = limits.v, limits.a, limits.wraps
    R, A, B, C = price.shape
    M = 1
    for k in range(turning.turns.size):
        M *= turning.turns[k]
    back = np.full((R, A, B, C, M), _NONE, dtype=np.uint8)
    cheapest = np.full(R, -1, dtype=np.int64)
    cost, arrived = np.full((A, B, C, M), np.inf), np.full((A, B, C, M), np.inf)
    for r in range(R):
        cost, arrived = arrived, cost
        cost[:] = np.inf
        for i in range(A):
            for b in range(B):
                for c in range(C):
                    own = price[r, i, b, c]
                    if own == np.inf:
                        continue
                    if r == 0:
                        for state in range(M):
                            if _inside(ladder, turning, r, i, b, c, state):
                                cost[i, b, c, state] = own
                        continue
                    for which in range(9):
                        m, n = which // 3, which % 3
                        i0, b0 = (i + m - 1) % A, (b + n - 1) % B
                        if (n != 1 and B == 1) or price[r - 1, i0, b0, c] == np.inf or price[r, i0, b0, c] == np.inf:
                            continue
                        if _turns_far(q[r - 1, i0, b0, c], q[r, i, b, c], wraps):
                            continue
                        edge = edge_price(
                            q[r - 1, i0, b0, c], q[r, i, b, c], q[r, i0, b0, c], (n - 1) * ladder.holder_step,
                            ladder.time[r], v, wraps,
                        )  # fmt: skip
                        if edge == np.inf:
                            continue
                        for state in range(M):
                            t = arrived[i0, b0, c, state] + edge + own
                            if t == np.inf:
                                continue
                            to = _carried(ladder, turning, r, i0, b0, i, b, c, state, 1)
                            if to >= 0 and t < cost[i, b, c, to] and _inside(ladder, turning, r, i, b, c, to):
                                cost[i, b, c, to] = t
                                back[r, i, b, c, to] = which
        best = cost.argmin()
        if cost.min() == np.inf:
            return back, cheapest, -1
        cheapest[r] = best
        if may[r]:
            _leave(ladder, turning, r, best, v, a, wraps, cost, back)
    return back, cheapest, cost.argmin()


@njit(cache=True)
def _turns_far(q0, q1, wraps) -> bool:
    """Whether a joint turns further between postures (na) than it may from rung to rung."""
    for j in range(wraps.size):
        d = float(q1[j]) - float(q0[j])
        if wraps[j]:
            d -= 2.0 * np.pi * np.rint(d / (2.0 * np.pi))
        if abs(d) > _FARTHEST:
            return True
    return False


@njit(cache=True)
def _leave(ladder, turning, r: int, best: int, v, a, wraps, cost, back) -> None:
    """Let the nozzle leave the bead at rung r in the cheapest state, and come back in any other."""
    q, price = ladder.q, ladder.price
    _, A, B, C = price.shape
    M = cost.shape[3]
    i0, b0, c0 = best // (M * C * B), best // (M * C) % B, best // M % C
    paused = cost.min() + PAUSE_PRICE
    for i in range(A):
        for b in range(B):
            turn = (b - b0) * ladder.holder_step
            turn -= 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))
            for c in range(C):
                if price[r, i, b, c] == np.inf:
                    continue
                t = paused + travel_price(q[r, i0, b0, c0], q[r, i, b, c], turn, v, a, wraps)
                for state in range(M):
                    if t < cost[i, b, c, state] and _inside(ladder, turning, r, i, b, c, state):
                        cost[i, b, c, state] = t
                        back[r, i, b, c, state] = _PAUSED


@njit(cache=True)
def traced(ladder, turning, back, cheapest, last):
    """States (R, 4) that arrive at each rung, and leave it, on the way to the last one."""
    R, A, B, C, M = back.shape
    before, after = np.empty((R, 4), dtype=np.int64), np.empty((R, 4), dtype=np.int64)
    at = last
    for r in range(R - 1, -1, -1):
        for out in range(2):
            i, b, c, state = at // (M * C * B), at // (M * C) % B, at // M % C, at % M
            if out == 0:
                after[r, 0], after[r, 1], after[r, 2], after[r, 3] = i, b, c, state
                if back[r, i, b, c, state] == _PAUSED:
                    at = cheapest[r]
            else:
                before[r, 0], before[r, 1], before[r, 2], before[r, 3] = i, b, c, state
        if r == 0:
            break
        which = back[r, i, b, c, state]
        i0, b0 = (i + which // 3 - 1) % A, (b + which % 3 - 1) % B
        state0 = _carried(ladder, turning, r, i0, b0, i, b, c, state, -1)
        at = ((i0 * B + b0) * C + c) * M + state0
    return before, after
