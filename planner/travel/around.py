"""A way round obstacles where none of the usual ones is clear: a search of joint space from both ends (RRT-connect).

Kuffner and LaValle, RRT-Connect, ICRA 2000. Two trees of postures grow from above the ends towards random postures and
towards each other until they meet; what is found is then made shorter. The same numbers are drawn each time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner.cell import Cell
from planner.obstacles import Obstacles
from planner.readonly import Array
from planner.travel.clearance import SWEPT, Room, nozzle_points
from planner.travel.ways import Ends, lifted

_LIFTS = (1.0, 4.0, 16.0)  # of the least lift, from which it starts, in turn
_DRAWN = 1500  # postures, at most
_STEP = 0.25  # m that anything moves at most along one branch of a tree
_SHORTCUTS = 200
_COARSE = 5.0 * SWEPT  # m of a step at which branches are looked at; the way itself is looked at finely


@dataclass(frozen=True)
class _Space:
    cell: Cell
    room: Room
    obstacles: Obstacles
    now: float
    margin: float
    swing: Array
    low: Array
    high: Array

    def clear(self, a: Array, b: Array) -> bool:
        """Whether the straight move between two postures (nj) is clear of part and obstacles."""
        steps = max(int(np.ceil(float(np.abs(b - a) @ self.swing) / _COARSE)), 1)
        q = a + np.linspace(0.0, 1.0, steps + 1)[:, None] * (b - a)
        if self.room.lacking(nozzle_points(self.cell, q)) > 0.0:
            return False
        return self.obstacles.hit(q, self.now, self.margin) < 0

    def towards(self, a: Array, b: Array) -> Array:
        """The posture a step from a towards b, or b if it is no farther."""
        far = float(np.abs(b - a) @ self.swing)
        return b if far <= _STEP else a + _STEP / far * (b - a)


class _Tree:
    def __init__(self, root: Array) -> None:
        self.q, self.parent = [root], [-1]

    def nearest(self, q: Array, swing: Array) -> int:
        return int(np.argmin(np.abs(np.array(self.q) - q) @ swing))

    def add(self, q: Array, parent: int) -> int:
        self.q.append(q)
        self.parent.append(parent)
        return len(self.q) - 1

    def to_root(self, k: int) -> list[Array]:
        way = []
        while k >= 0:
            way.append(self.q[k])
            k = self.parent[k]
        return way


def around(
    cell: Cell, ends: Ends, room: Room, obstacles: Obstacles, now: float, margin: float
) -> Iterator[list[Array]]:
    """Postures (nj) at which a way round everything rests, from above the start to above the end; none if none is found."""
    limits = cell.limits
    both = np.stack([ends.start.q, ends.end.q])
    low = np.maximum(limits.q_min, both.min(axis=0) - np.pi)
    high = np.minimum(limits.q_max, both.max(axis=0) + np.pi)
    space = _Space(cell, room, obstacles, now, margin, obstacles.swing, low, high)
    for factor in _LIFTS:
        a, b = np.hstack([lifted(cell, both, room, factor * room.lift), both[:, len(cell.arm) :]])
        if space.clear(a, a) and space.clear(b, b):
            way = _connect(space, a, b)
            if way is not None:
                yield _shortened(space, way)
                return


def _connect(space: _Space, a: Array, b: Array) -> list[Array] | None:
    rng = np.random.default_rng(0)
    here, there, turned = _Tree(a), _Tree(b), False
    for k in range(_DRAWN):
        goal = there.q[0] if k == 0 else rng.uniform(space.low, space.high)
        near = here.nearest(goal, space.swing)
        new = space.towards(here.q[near], goal)
        if space.clear(here.q[near], new):
            own = here.add(new, near)
            other = there.nearest(new, space.swing)
            while True:  # the other tree goes on as far as it can
                step = space.towards(there.q[other], new)
                if not space.clear(there.q[other], step):
                    break
                other = there.add(step, other)
                if np.array_equal(step, new):
                    way = here.to_root(own)[::-1] + there.to_root(other)[1:]
                    return way[::-1] if turned else way
        here, there, turned = there, here, not turned
    return None


def _shortened(space: _Space, way: list[Array]) -> list[Array]:
    """The way with straight moves in place of detours, where these are clear."""
    rng = np.random.default_rng(0)
    for _ in range(_SHORTCUTS):
        if len(way) < 3:
            break
        i, j = sorted(int(k) for k in rng.choice(len(way), 2, replace=False))
        if j - i > 1 and space.clear(way[i], way[j]):
            way = [*way[: i + 1], *way[j:]]
    return way
