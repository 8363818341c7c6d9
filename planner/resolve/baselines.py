"""Strategies for comparison: fixed and greedy. What papers did is in `published.py`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.base.geometry import TURN
from planner.cell.cell import Cell, Limits
from planner.problem.settings import ResolveSpec
from planner.resolve.by_nozzle import with_each_nozzle
from planner.resolve.guides import guides_of, runs_backwards, zeros_apart
from planner.resolve.infeasible import refuse_rung
from planner.resolve.joint_path import MARGIN, JointPath, SampledTasks, at_rest, choose_turns, postures, upright
from planner.resolve.ladder import coarse_nodes, paths_of
from planner.resolve.nodes import Nodes
from planner.resolve.prices import DIP_PRICE
from planner.resolve.search import JUMP, SPEED_SHARE, LadderRoute, greedy_route, joint_limits
from planner.toolpath.task import NozzleTask


@with_each_nozzle
def fixed(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """The best constant roll for the whole print and, with it, the best constant table angle and branch for each bead.

    Best by the sum of the ladder's prices; beads that repeat from layer to layer share their choice.
    """
    guides, of = guides_of(tasks)
    demand, nodes = coarse_nodes(cell, guides, settings)
    grid = nodes.grid
    totals = np.stack([_held_price(nodes, demand, cell.limits, i) for i in range(len(guides))])
    best = totals.reshape(len(guides), grid.rolls, -1).min(axis=2)
    whole = best.sum(axis=0)
    if not np.isfinite(whole).any():
        nowhere = ~np.isfinite(nodes.price).reshape(len(nodes.price), -1).any(axis=1)
        if nowhere.any():
            refuse_rung(cell, guides, demand, nodes, int(np.argmax(nowhere)), settings.min_sigma)
        i = int(np.argmin(np.isfinite(best).sum(axis=1)))
        name = guides[i].name
        raise Refusal(f"no constant roll serves the whole of path {name!r} with any table angle", bead=guides[i].bead)
    roll = int(np.argmin(whole))
    choice = []
    for i in range(len(guides)):
        best_pair = np.unravel_index(int(np.argmin(totals[i, roll])), totals.shape[2:])
        choice.append((int(best_pair[0]), int(best_pair[1])))
    paths = []
    for task, g in zip(tasks, of, strict=True):
        holder, branch = choice[g]
        n = len(task)
        apart = zeros_apart(task, guides[g], runs_backwards(task, guides[g]))
        rolls = np.full(n, roll * grid.roll_step + apart)
        chosen = np.tile(at_rest(cell), (n, 1))
        if cell.chosen and grid.swept is not None:
            chosen[:, grid.swept] = nodes.swept_at(holder)
        paths.append(JointPath(task, rolls, upright(task), postures(cell, task, rolls, chosen, branch), branch))
    return choose_turns(cell, paths)


def _held_price(nodes: Nodes, demand: SampledTasks, limits: Limits, task: int) -> Array:
    """Price (rolls, holders, branches) [s] of holding each node all along a task, with the time lost where a joint is
    too slow; infinite where one would have to jump, or to turn further than its range."""
    rungs = demand.rungs_of(task)
    total = nodes.price[rungs].sum(axis=0)
    step = np.diff(nodes.q[rungs], axis=0).astype(float)
    v, _, wraps, *_ = joint_limits(nodes, limits)
    step[..., wraps] -= TURN * np.round(step[..., wraps] / TURN)
    need = (np.abs(step) / (SPEED_SHARE * v[:-1])).max(axis=4)
    total += (1.0 + DIP_PRICE) * np.maximum(need - demand.time[rungs][1:].reshape((-1, 1, 1, 1)), 0.0).sum(axis=0)
    total[(np.abs(step) > JUMP).any(axis=(0, 4))] = np.inf
    along = np.cumsum(np.concatenate([nodes.q[rungs][:1].astype(float), step]), axis=0)[..., wraps]
    least, most = limits.q_min[: len(wraps)][wraps] + MARGIN, limits.q_max[: len(wraps)][wraps] - MARGIN
    turns = TURN * np.ceil((least - along.min(axis=0)) / TURN)  # to bring the lowest angle into the range
    total[(along.max(axis=0) + turns > most).any(axis=3)] = np.inf
    return np.asarray(total)


@with_each_nozzle
def greedy(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """Always the next best candidate on the ladder's coarse grid, never looking ahead."""
    demand, nodes = coarse_nodes(cell, tasks, settings)
    route, stuck = greedy_route(nodes, demand, cell.limits)
    if route is None:
        refuse_rung(cell, tasks, demand, nodes, stuck, settings.min_sigma)
    return paths_of(cell, tasks, LadderRoute(demand, nodes, route))
