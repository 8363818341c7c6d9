"""Found: a route through the ladder's graph with what it was found on, and its angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.readonly import Array
from planner.resolve.demand import Demand
from planner.resolve.nodes import Grid, Nodes
from planner.resolve.search import Route


@dataclass(frozen=True)
class Found:
    """A route over some tasks' rungs, with what it was found on."""

    demand: Demand
    nodes: Nodes
    route: Route

    def chosen(self, k: int) -> Array:
        """Angles (r, k) of the cell's chosen joints along the route, continuous along each task."""
        grid = self.nodes.grid
        angles = grid.chosen(len(self.demand.rung), k).copy()
        if k and grid.swept is not None:
            for i in range(len(self.demand.task_rungs) - 1):
                rungs = self.demand.rungs_of(i)
                angles[rungs, grid.swept] = angles_along(grid, self.route.holder[rungs], grid.holders, grid.holder_step)
        return angles


def angles_along(grid: Grid, index: NDArray[np.int64], period: int, step: float) -> Array:
    """Angles [rad] of grid indices along a task, continuous round the circle where the grid is the whole of it."""
    along = index.astype(float)
    return (np.unwrap(along, period=period) if grid.periodic and period > 1 else along) * step
