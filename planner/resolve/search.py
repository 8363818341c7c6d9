"""The search through the ladder graph: dynamic programming over rungs and over all beads.

Within a bead a path may keep its roll and holder index from rung to rung or change either by one step; the
branch stays. Between beads any end may be followed by any start, at the price of the travel between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cell import Limits
from planner.readonly import Array
from planner.resolve.demand import Demand
from planner.resolve.nodes import Nodes
from planner.resolve.search_kernel import search_best, search_greedy

ROUND = np.radians(600.0)  # range of a joint that is as good as unbounded along one bead


@dataclass(frozen=True)
class Route:
    """A way through the ladder: at each rung (r) the absolute grid index of roll and holder, and the branch;
    price in seconds, as the search counts it."""

    roll: NDArray[np.int64]
    holder: NDArray[np.int64]
    branch: NDArray[np.int64]
    price: float


def best_route(
    nodes: Nodes, demand: Demand, limits: Limits, home: tuple[Array, Array] | None = None
) -> tuple[Route | None, int]:
    """The cheapest route over all beads, and -1; or None and the rung at which the last way ended.

    home: prices [s] (rolls, holders, c) of the ways to the first rung's nodes and from the last one's, if they count
    """
    grid = nodes.grid
    free = np.zeros(nodes.price.shape[1:])
    picked, price, stuck = search_best(
        nodes.q, nodes.price, grid.roll_from, grid.holder_from, grid.periodic, grid.holder_step,
        demand.task_rungs, demand.time, *joint_limits(nodes, limits), *(home or (free, free)),
    )  # fmt: skip
    return _route(nodes, picked, price) if stuck < 0 else None, int(stuck)


def greedy_route(nodes: Nodes, demand: Demand, limits: Limits) -> tuple[Route | None, int]:
    """Always the next best candidate, never looking further; the next best start where that leads into a dead end.

    Same returns as `best_route`; the rung is the furthest that any start led to.
    """
    grid = nodes.grid
    picked, price, stuck = search_greedy(
        nodes.q, nodes.price, grid.roll_from, grid.holder_from, grid.periodic, grid.holder_step,
        demand.task_rungs, demand.time, *joint_limits(nodes, limits),
    )  # fmt: skip
    return _route(nodes, picked, price) if stuck < 0 else None, int(stuck)


def joint_limits(nodes: Nodes, limits: Limits) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Speed and acceleration limits (na + 1), the arm's and then the swept joint's (any, where there is none), and
    which arm joints (na) can turn so far that their angles count round the circle."""
    na = nodes.q.shape[-1]
    arm = np.arange(na)
    v, a = np.ones(na + 1), np.ones(na + 1)
    v[:na], a[:na] = limits.velocity[arm], limits.acceleration[arm]
    if nodes.joint < len(limits.velocity):
        v[na], a[na] = limits.velocity[nodes.joint], limits.acceleration[nodes.joint]
    return v, a, (limits.q_max - limits.q_min)[arm] >= ROUND


def _route(nodes: Nodes, picked: NDArray[np.int64], price: float) -> Route:
    grid = nodes.grid
    r = np.arange(len(picked))
    return Route(grid.roll_from + picked[:, 0], grid.holder_from + picked[:, 1], grid.branch[r, picked[:, 2]], price)
