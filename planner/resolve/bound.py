"""How far a ladder's route can be from the best one on its whole fine grid: a price that no route can go below."""

from __future__ import annotations

import numpy as np

from planner.cell import Cell
from planner.obstacles import NOTHING, Obstacles
from planner.resolve.found import Found
from planner.resolve.nodes import evaluate, full_grid
from planner.resolve.search import best_route

PIECE = 24  # rungs that are searched at once: what the whole fine grid of so many takes still fits in memory


def lower_bound(
    cell: Cell, found: Found, min_sigma: float, piece: int = PIECE, obstacles: Obstacles = NOTHING
) -> float:
    """A lower bound [s] of the price of any route on the whole grid that has the found route's steps.

    Every task is cut into pieces of at most `piece` rungs. Each is searched exactly over all rolls, all angles of
    the swept joint and all branches; edges between pieces and travel between tasks, whose prices are never
    negative, are left out. Other chosen joints are held as in the found route: the bound is for that choice only.
    """
    demand, grid = found.demand, found.nodes.grid
    swept = grid.swept if cell.chosen else None
    total = 0.0
    for k in range(len(demand.task_rungs) - 1):
        rungs = demand.rungs_of(k)
        count = int(np.ceil((rungs.stop - rungs.start) / piece))
        for part in np.array_split(np.arange(rungs.start, rungs.stop), count):
            few = demand.only(part, [0, len(part)])
            held = None if grid.held is None else grid.held[part]
            whole = full_grid(few, grid.roll_step, grid.holder_step, swept is not None, swept, held)
            route, _ = best_route(evaluate(cell, few, whole, min_sigma, obstacles), few, cell.limits)
            if route is None:  # rounding alone: the found route lies on this grid
                return 0.0
            total += route.price
    return total
