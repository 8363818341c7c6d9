"""Where a bead has to pause: the fewest places at which the arm leaves it, for another branch or to unwind a joint.

The ladder's search again, one bead at a time. At a rung, the nozzle may leave the bead and come back in any posture, at
a price above all others, and turns are counted for joints that would otherwise turn further than their ranges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.geometry import TURN
from planner.cell.cell import Cell
from planner.resolve.joint_path import SampledTasks
from planner.resolve.nodes import Nodes
from planner.resolve.prices import FAR
from planner.resolve.search import joint_limits, label_turns, ladder_numbers, may_be_counted, search_best, turns_counted
from planner.toolpath.task import NozzleTask

_MOST_COUNTED = 3  # joints whose whole turns are counted at once
_MOST_LABELS = 4096  # combinations of their turns: the search takes that many times as long


@dataclass(frozen=True)
class Pause:
    """A place of a bead at which the nozzle leaves it: arc length s [m], and the joint that would turn further than its
    range, empty where no branch leads on."""

    s: float
    joint: str


@dataclass(frozen=True)
class _Way:
    """A way along a bead with the fewest pauses.

    came, left (r, 4): nodes and labels at which it arrives at its rungs, and from which it goes on
    counted: joints whose turns are counted; turns (labels, m): those that a label stands for
    """

    came: Ints
    left: Ints
    counted: list[int]
    turns: Ints

    @property
    def pauses(self) -> Ints:
        """The rungs at which it pauses."""
        return np.flatnonzero((self.came != self.left).any(axis=1))


def pauses_of(
    cell: Cell,
    task: NozzleTask,
    demand: SampledTasks,
    nodes: Nodes,
    least_piece: float,
    room: float,
) -> tuple[Pause, ...] | None:
    """The fewest pauses with which a bead can be followed on its whole grid, in order; empty if it needs none.

    None if pauses do not help. The first and last pieces are no shorter than `least_piece` [m]; joints that wind keep
    `room` [rad] from the ends of their ranges.
    """
    s = task.s[demand.rung]
    begin, end = task.s[[task.first, task.last]]
    may = (s >= begin + least_piece) & (s <= end - least_piece)
    may[[0, -1]] = False
    way = _fewest(cell, demand, nodes, may, room)
    if way is None:
        return None
    return tuple(Pause(float(s[r]), _unwound(cell, nodes, way, r)) for r in way.pauses)


def _fewest(cell: Cell, demand: SampledTasks, nodes: Nodes, may: Flags, room: float) -> _Way | None:
    """A way with the fewest pauses, roughly the cheapest such one; it pauses only at rungs that `may` (r) marks.

    Turns are counted only for joints that would otherwise turn further than their ranges.
    """
    limits = joint_limits(nodes, cell.limits)._replace(jump=FAR)
    counted: list[int] = []
    while len(counted) <= _MOST_COUNTED:
        turns = turns_counted(nodes, cell.limits, counted, room)
        if turns.number.prod() > _MOST_LABELS or not may_be_counted(nodes, turns):
            return None
        labels = label_turns(turns)
        free = np.zeros((*nodes.price.shape[1:], len(labels)))
        came, left, _, stuck = search_best(ladder_numbers(nodes, demand), limits, turns, may, free, free)
        if stuck >= 0:
            return None
        way = _Way(came, left, counted, labels)
        over = _overwound(cell, nodes, way, room) - set(counted)
        if not over:
            return way
        counted = [*counted, *sorted(over)]
    return None


def _index(cell: Cell, nodes: Nodes, k: int) -> int:
    """Index among all joints of the search's joint k: the arm's, then the swept one."""
    return nodes.joint if k == len(cell.arm) else k


def _values(cell: Cell, nodes: Nodes, at: Ints) -> Array:
    """Joints (r, na + 1) of nodes (r, 4) at rungs 0 .. r - 1, the swept one's place last (0 where it cannot wind)."""
    q = nodes.q[np.arange(len(at)), at[:, 0], at[:, 1], at[:, 2]].astype(float)
    swept = at[:, 1] * nodes.grid.holder_step if _sweeps_round(cell, nodes) else np.zeros(len(at))
    return np.hstack([q, swept[:, None]])


def _sweeps_round(cell: Cell, nodes: Nodes) -> bool:
    """Whether the swept joint is one of the holder that turns: those of the arm count as the arm's."""
    return len(cell.arm) <= nodes.joint < len(cell.joint_names) and nodes.joint not in cell.limits.sliding


def _overwound(cell: Cell, nodes: Nodes, way: _Way, room: float) -> set[int]:
    """Joints (the search's) that turn further than their ranges along a piece of a bead, whatever turns are added."""
    na = len(cell.arm)
    joints = [*range(na)] + ([na] if _sweeps_round(cell, nodes) else [])
    every = [_index(cell, nodes, k) for k in joints]
    turns = cell.limits.turns[every]
    low, high = cell.limits.q_min[every] + room, cell.limits.q_max[every] - room
    arrived, left = _values(cell, nodes, way.came)[:, joints], _values(cell, nodes, way.left)[:, joints]
    edges = [0, *way.pauses.tolist(), len(left) - 1]
    over: set[int] = set()
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        q = np.vstack([left[first:last], arrived[last : last + 1]])
        q = np.where(turns, np.unwrap(q, axis=0), q)
        add = np.where(turns, np.ceil((low - q.min(axis=0)) / TURN) * TURN, 0.0)
        over |= {joints[j] for j in np.flatnonzero(turns & (q.max(axis=0) + add > high))}
    return over


def _unwound(cell: Cell, nodes: Nodes, way: _Way, rung: int) -> str:
    """Name of the joint whose whole turns differ before and after a pause; empty if none do."""
    other = np.abs(way.turns[way.came[rung, 3]] - way.turns[way.left[rung, 3]])
    if not other.any():
        return ""
    return cell.joint_names[_index(cell, nodes, way.counted[int(np.argmax(other))])]
