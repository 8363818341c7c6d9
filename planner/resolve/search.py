"""The search through the ladder graph: dynamic programming over rungs and over all beads.

Within a bead a path may keep its roll and holder index from rung to rung or change either by one step; the
branch stays. Between beads any end may be followed by any start, at the price of the travel between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cell import Limits
from planner.resolve.demand import Demand
from planner.resolve.nodes import Nodes
from planner.resolve.search_kernel import search_best, search_greedy

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Route:
    """A way through the ladder: at each rung (r) the absolute grid index of roll and holder, and the branch;
    price in seconds, as the search counts it."""

    roll: NDArray[np.int64]
    holder: NDArray[np.int64]
    branch: NDArray[np.int64]
    price: float


def best_route(nodes: Nodes, demand: Demand, limits: Limits) -> tuple[Route | None, int]:
    """The cheapest route over all beads, and -1; or None and the rung at which the last way ended."""
    grid = nodes.grid
    picked, price, stuck = search_best(
        nodes.q, nodes.price, grid.roll_from, grid.holder_from, grid.periodic, grid.holder_step,
        demand.task_rungs, demand.time, *_arm_and_holder(limits),
    )  # fmt: skip
    return _route(nodes, picked, price) if stuck < 0 else None, int(stuck)


def greedy_route(nodes: Nodes, demand: Demand, limits: Limits) -> tuple[Route | None, int]:
    """Always the next best candidate, never looking further; the next best start where that leads into a dead end.

    Same returns as `best_route`; the rung is the furthest that any start led to.
    """
    grid = nodes.grid
    picked, price, stuck = search_greedy(
        nodes.q, nodes.price, grid.roll_from, grid.holder_from, grid.periodic, grid.holder_step,
        demand.task_rungs, demand.time, *_arm_and_holder(limits),
    )  # fmt: skip
    return _route(nodes, picked, price) if stuck < 0 else None, int(stuck)


def _arm_and_holder(limits: Limits) -> tuple[Array, Array]:
    """Speed and acceleration limits (7): the arm's, then the holder's (any, where it has no axis)."""
    v, a = np.ones(7), np.ones(7)
    n = len(limits.velocity)
    v[:n], a[:n] = limits.velocity, limits.acceleration
    return v, a


def _route(nodes: Nodes, picked: NDArray[np.int64], price: float) -> Route:
    grid = nodes.grid
    r = np.arange(len(picked))
    return Route(grid.roll_from + picked[:, 0], grid.holder_from + picked[:, 1], grid.branch[r, picked[:, 2]], price)
