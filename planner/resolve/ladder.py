"""Strategy `ladder`: dynamic programming over roll, holder angle and branch, coarse guides first, then dense."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.cell import Cell
from planner.problem import ResolveSpec
from planner.resolve.demand import Demand, demand_of
from planner.resolve.jointpath import JointPath, choose_turns, postures, spread, upright
from planner.resolve.nodes import Grid, Nodes, evaluate, full_grid
from planner.resolve.search import Route, best_route
from planner.resolve.unreachable import refuse_rung
from planner.task import NozzleTask

Array = NDArray[np.float64]

# Of the second search: coarse steps are divided by the first number, and the guide may be left by the second one
# of those to each side. A guide that turns by a coarse step a rung is too quick for dense steps: wider, then coarse.
CORRIDORS = ((3, 4), (3, 12), (1, 1))


def ladder(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """The best joint paths on the grid, over all beads together, travel included.

    A first search over the whole coarse grid guides a second one, three times as fine, in a corridor around
    it. Beads that repeat from layer to layer share the guide of the first of them.
    Raises Refusal where a bead cannot be followed.
    """
    guides = first_of_each_name(tasks)
    demand, nodes = coarse_nodes(cell, guides, settings)
    route, stuck = best_route(nodes, demand, cell.limits)
    if route is None:
        refuse_rung(cell, guides, demand, nodes, stuck, settings.min_sigma)
    guide_of = {task.name: i for i, task in enumerate(guides)}
    all_demand = demand_of(tasks, settings.rung)
    for refine, corridor in CORRIDORS:
        grid = _corridor(tasks, all_demand, guides, demand, nodes.grid, route, guide_of, refine, corridor)
        dense = evaluate(cell, all_demand, grid, settings.min_sigma)
        best, stuck = best_route(dense, all_demand, cell.limits)
        if best is not None:
            return paths_of(cell, tasks, all_demand, grid, best)
    refuse_rung(cell, tasks, all_demand, dense, stuck, settings.min_sigma)


def first_of_each_name(tasks: Sequence[NozzleTask]) -> list[NozzleTask]:
    """The first task of every name: those of the layers above repeat it."""
    seen: dict[str, NozzleTask] = {}
    for task in tasks:
        seen.setdefault(task.name, task)
    return list(seen.values())


def coarse_nodes(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[Demand, Nodes]:
    """The whole grid of the settings' steps at the settings' rungs."""
    demand = demand_of(tasks, settings.rung)
    grid = full_grid(demand, settings.roll_step, settings.table_step, len(cell.holder) > 0)
    return demand, evaluate(cell, demand, grid, settings.min_sigma)


def _corridor(
    tasks: Sequence[NozzleTask],
    demand: Demand,
    guides: Sequence[NozzleTask],
    guide_demand: Demand,
    coarse: Grid,
    route: Route,
    guide_of: dict[str, int],
    refine: int,
    corridor: int,
) -> Grid:
    """A fine grid whose windows follow the guide route of the bead of the same name, either way round."""
    r = len(demand.rung)
    roll_from, holder_from = np.zeros(r, dtype=np.int64), np.zeros(r, dtype=np.int64)
    branch = np.zeros((r, 1), dtype=np.int64)
    for i, task in enumerate(tasks):
        g = guide_of[task.name]
        own, theirs = demand.rungs_of(i), guide_demand.rungs_of(g)
        backwards = runs_backwards(task, guides[g])
        for target, index in ((roll_from, route.roll), (holder_from, route.holder)):
            period = coarse.rolls if index is route.roll else coarse.holders
            along = np.unwrap(index[theirs].astype(float), period=period)
            along = along[::-1] if backwards else along
            k = own.stop - own.start
            dense = np.interp(np.linspace(0.0, 1.0, k), np.linspace(0.0, 1.0, len(along)), along)
            target[own] = np.round(refine * dense).astype(np.int64) - corridor
        branch[own] = route.branch[theirs][0]
    if coarse.holders == 1:
        holder_from[:] = 0
    return Grid(
        coarse.roll_step / refine,
        coarse.holder_step / refine,
        roll_from,
        holder_from,
        2 * corridor + 1,
        1 if coarse.holders == 1 else 2 * corridor + 1,
        False,
        branch,
    )


def runs_backwards(task: NozzleTask, guide: NozzleTask) -> bool:
    """Whether a task runs its guide's bead the other way (for a loop: turns the other way)."""
    here, there = task.tip[task.first : task.last], guide.tip[guide.first : guide.last]
    n = 64
    a = here[np.linspace(0, len(here) - 1, n).astype(int)]
    b = there[np.linspace(0, len(there) - 1, n).astype(int)]
    return bool(((a - b[::-1]) ** 2).sum() < ((a - b) ** 2).sum())


def paths_of(
    cell: Cell, tasks: Sequence[NozzleTask], demand: Demand, grid: Grid, route: Route
) -> tuple[JointPath, ...]:
    """Smooth joint paths along a route: its grid values control splines of roll and holder angle."""
    paths = []
    for i, task in enumerate(tasks):
        rungs = demand.rungs_of(i)
        n = len(task)
        period = (grid.rolls, grid.holders) if grid.periodic else (None, None)
        values = []
        for index, step, turn in zip(
            (route.roll, route.holder), (grid.roll_step, grid.holder_step), period, strict=True
        ):
            along = index[rungs].astype(float)
            values.append((along if turn is None or turn == 1 else np.unwrap(along, period=turn)) * step)
        roll = spread(values[0], n)
        holder = spread(values[1], n)[:, None] if len(cell.holder) else np.zeros((n, 0))
        branch = int(route.branch[rungs][0])
        paths.append(JointPath(task, roll, upright(task), postures(cell, task, roll, holder, branch), branch))
    return choose_turns(cell, paths)
