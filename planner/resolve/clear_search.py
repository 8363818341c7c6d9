"""The best clear route, for which clearance is only looked at where a route leads.

Whether a posture is clear costs several times what all else about a node costs, and most routes lead past everything.
So routes are searched as if nothing were in the way; around what blocks them nodes are looked at, and the search is
done again. A route that is found clear so is the one that a search among clear nodes alone would find.
"""

from __future__ import annotations

import numpy as np

from planner.cell import Cell
from planner.obstacles import NOTHING, Obstacles
from planner.readonly import Array, Flags, Ints
from planner.resolve.demand import Demand
from planner.resolve.node_kernel import CLEAR_ROOM
from planner.resolve.nodes import Grid, Nodes, nodes_to_fill
from planner.resolve.search import Route, best_route

_REACH = 4  # rungs to each side of a blocked one that are looked at first; four times as many each time after
_WIDER = 4


class ClearSearch:
    """Searches on one grid. `nodes` are those of `evaluate` as far as a search has looked at their clearance."""

    def __init__(
        self, cell: Cell, demand: Demand, grid: Grid, min_sigma: float, obstacles: Obstacles = NOTHING
    ) -> None:
        self._cell, self._demand = cell, demand
        self._obstacles = obstacles.but_head_on_part if demand.cones.tilt > 0.0 else obstacles
        self.nodes, self._fill = nodes_to_fill(cell, demand, grid, min_sigma)
        r = len(demand.rung)
        self._fill(np.arange(r), NOTHING)
        self._looked: Flags = np.full(r, not obstacles.any)

    def best(self, demand: Demand, home: tuple[Array, Array] | None = None) -> tuple[Route | None, int]:
        """As `best_route` for this demand, or one that differs from the search's in time only, on clear nodes."""
        reach = _REACH
        while True:
            route, stuck = best_route(self.nodes, demand, self._cell.limits, home)
            if route is None and self._looked.all():
                return None, stuck
            if route is None:
                self.look(np.arange(len(self._looked)))
                continue
            blocked = self._blocked(route)
            if not len(blocked):
                return route, stuck
            around = (blocked[:, None] + np.arange(-reach, reach + 1)).ravel()
            self.look(np.unique(around[(around >= 0) & (around < len(self._looked))]))
            reach *= _WIDER

    def look(self, rungs: Ints) -> Nodes:
        """Take what is not clear at some rungs out of the nodes, which come back."""
        rungs = rungs[~self._looked[rungs]]
        self._fill(rungs, self._obstacles)
        self._looked[rungs] = True
        return self.nodes

    def _blocked(self, route: Route) -> Ints:
        """Rungs not looked at yet where a route's node, or the one that keeps to the angles before, is not clear."""
        grid, demand = self.nodes.grid, self._demand
        at = np.flatnonzero(~self._looked)
        before = np.where(np.isin(at, demand.task_rungs), at, np.maximum(at - 1, 0))
        column = np.argmax(grid.branch[at] == route.branch[at, None], axis=1)
        blocked = np.zeros(len(at), dtype=np.bool_)
        for angles_of in (at, before):
            roll, holder = route.roll[angles_of] - grid.roll_from[at], route.holder[angles_of] - grid.holder_from[at]
            if grid.periodic:
                roll, holder = roll % grid.rolls, holder % grid.holders
            q = self.nodes.q[at, roll, holder, column].astype(float)
            chosen = grid.chosen(len(demand.rung), len(self._cell.chosen))[at]
            if self._cell.chosen and grid.swept is not None:
                chosen[:, grid.swept] = route.holder[angles_of] * grid.holder_step
            now = demand.now[demand.rung[at]]
            whole = np.hstack([q, chosen[:, : len(self._cell.holder)]])
            blocked |= self._obstacles.margins(whole, now, 0.0, CLEAR_ROOM)[0] < 0.0
        return at[blocked]
