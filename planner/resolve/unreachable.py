"""Why there is no path: which rung ran out of candidates, and for what reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NoReturn

import numpy as np

from planner.cell import Cell
from planner.resolve.demand import Demand
from planner.resolve.hints import path_hints, place_hints, speed_hints, stuck_at
from planner.resolve.jointpath import flange_poses, refuse_at, upright
from planner.resolve.node_kernel import LIMIT_ROOM
from planner.resolve.nodes import Nodes
from planner.resolve.search import best_route
from planner.task import NozzleTask

_UNHURRIED = 1e4  # times as long on the way: if this opens one, joint speed was the reason
_TRIED = 72  # rolls and holder angles that the diagnosis looks at


def refuse_rung(
    cell: Cell, tasks: Sequence[NozzleTask], demand: Demand, nodes: Nodes, rung: int, min_sigma: float
) -> NoReturn:
    """Raise the Refusal that says why no way leads to this rung: reach, limits, singularity, or joint speed.

    With it come hints: changes that were tried and would help.
    """
    k = int(np.searchsorted(demand.task_rungs, rung, side="right") - 1)
    task = tasks[k]
    i = int(demand.rung[rung]) - sum(len(t) for t in tasks[:k])
    na, nh = len(cell.arm), len(cell.holder)
    grid = nodes.grid

    stuck = stuck_at(cell, tasks, demand, grid, rung, min_sigma)

    def refuse(reason: str, missing: float | None = None) -> NoReturn:
        refuse_at(task, i, reason, missing, place_hints(stuck, task.tip[i], missing))

    angles = np.linspace(0.0, 2.0 * np.pi, _TRIED, endpoint=False)
    roll, swept = (x.ravel() for x in np.meshgrid(angles, angles if cell.chosen else angles[:1], indexing="ij"))
    chosen = np.tile(grid.chosen(len(demand.rung), len(cell.chosen))[rung], (len(roll), 1))
    if cell.chosen and grid.swept is not None:
        chosen[:, grid.swept] = swept
    spot = _repeat(task, i, len(roll))
    T = flange_poses(cell, spot, roll, upright(spot), chosen[:, :nh])
    redundant = None if cell.inverse.redundant_joint is None else chosen[:, nh]
    q, ok = cell.inverse.solve(T, redundant)
    if not ok.any():
        refuse("out of the arm's reach", float(cell.inverse.out_of_reach(T, redundant).min()))
    middle = 0.5 * (cell.limits.q_min[:na] + cell.limits.q_max[:na])
    q = middle + np.remainder(q - middle + np.pi, 2 * np.pi) - np.pi
    inside = ok & ((q >= cell.limits.q_min[:na]) & (q <= cell.limits.q_max[:na])).all(axis=2)
    if not inside.any():
        over = np.maximum(cell.limits.q_min[:na] - q, q - cell.limits.q_max[:na])
        over[~ok] = np.inf
        worst = over.max(axis=2)
        a, b = np.unravel_index(np.argmin(worst), worst.shape)
        joint = cell.arm.names[int(np.argmax(over[a, b]))]
        reason = f"no posture within the joints' ranges; the nearest one leaves that of {joint}"
        refuse(f"{reason} by {np.degrees(worst[a, b]):.1f} deg")
    if not np.isfinite(nodes.price[rung]).any():
        away = (np.minimum(q - cell.limits.q_min[:na], cell.limits.q_max[:na] - q) >= LIMIT_ROOM).all(axis=2) & ok
        if not away.any():
            near = f"every posture is within {np.degrees(LIMIT_ROOM):.0f} deg of the end of a joint's range"
            refuse(near)
        sigma = np.linalg.svd(cell.arm.jacobians(q[away]), compute_uv=False)[:, -1].max()
        if sigma < min_sigma:
            reason = f"every posture is too close to a singularity: sigma at most {sigma:.4f}"
            refuse(f"{reason}, resolve.min_sigma is {min_sigma:g}")
        reason = "no posture on the search's grid, though there are some between its steps: search finer"
        refuse_at(task, i, reason, hints=path_hints(stuck, task.tip[i]))
    unhurried, _ = best_route(nodes, replace(demand, time=_UNHURRIED * demand.time), cell.limits)
    if unhurried is not None:
        reason = "no branch can follow the path up to here at the commanded speed: a joint would be too slow"
        refuse_at(task, i, reason, hints=speed_hints(cell, nodes, demand, task.speed))
    reason = "no branch leads up to here: each ends at a joint's range, a singularity or the arm's reach"
    refuse_at(task, i, reason, hints=path_hints(stuck, task.tip[i]))


def _repeat(task: NozzleTask, i: int, n: int) -> NozzleTask:
    """A task that stays n times at sample i of another."""
    one = [i] * n
    return NozzleTask(
        task.bead,
        task.name,
        task.layer,
        task.tip[one],
        task.frames[one],
        np.arange(n, dtype=float),
        0,
        n - 1,
        task.speed,
    )
