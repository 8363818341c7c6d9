"""Why there is no path: which rung ran out of candidates, and for what reason."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NoReturn

import numpy as np

from planner.background import cores
from planner.cell import Cell
from planner.obstacles import NOTHING, Obstacles
from planner.readonly import Array
from planner.resolve.demand import Demand
from planner.resolve.found import Found
from planner.resolve.hints import path_hints, place_hints, speed_hints, stuck_at
from planner.resolve.jointpath import JointPath, flange_poses, refuse_at, upright
from planner.resolve.node_kernel import CLEAR_ROOM, LIMIT_ROOM
from planner.resolve.nodes import Grid, Nodes, evaluate
from planner.resolve.search import best_route
from planner.task import NozzleTask

_UNHURRIED = 1e4  # times as long on the way: if this opens one, joint speed was the reason
SLIGHT = 1e-4  # m of clearance that a path between rungs may lack
_TRIED = 72  # rolls and holder angles that the diagnosis looks at


def refuse_rung(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    demand: Demand,
    nodes: Nodes,
    rung: int,
    min_sigma: float,
    obstacles: Obstacles = NOTHING,
) -> NoReturn:
    """Raise the Refusal that says why no way leads to this rung: reach, limits, singularity, collision, or joint speed.

    With it come hints: changes that were tried and would help.
    """
    if demand.cones.tilt > 0.0:
        obstacles = obstacles.but_head_on_part
    k = int(np.searchsorted(demand.task_rungs, rung, side="right") - 1)
    task = tasks[k]
    i = int(demand.rung[rung]) - sum(len(t) for t in tasks[:k])
    na, nh = len(cell.arm), len(cell.holder)
    grid = nodes.grid

    stuck = stuck_at(cell, tasks, demand, grid, rung, min_sigma, obstacles)

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
        sigma = np.linalg.svd(cell.arm.jacobians(q[away]), compute_uv=False)[:, -1]
        if sigma.max() < min_sigma:
            reason = f"every posture is too close to a singularity: sigma at most {sigma.max():.4f}"
            refuse(f"{reason}, resolve.min_sigma is {min_sigma:g}")
        tried = _postures_at(cell, demand, grid, rung, min_sigma) if obstacles.any else np.zeros((0, na + nh))
        if len(tried):
            now = np.full(len(tried), demand.now[demand.rung[rung]])
            margin, which = obstacles.margins(tried, now, np.inf, CLEAR_ROOM)
            k = int(np.argmax(margin))
            refuse(_collision(obstacles, int(which[k]), float(margin[k]), "every posture of the search here"))
        reason = "no posture on the search's grid, though there are some between its steps: search finer"
        refuse_at(task, i, reason, hints=path_hints(stuck, task.tip[i]))
    if obstacles.any:
        free = evaluate(cell, demand, grid, min_sigma)
        without, _ = best_route(free, demand, cell.limits)
        if without is not None:
            worst, pair, lacking = _hit(cell, Found(demand, free, without), obstacles)
            k = int(np.searchsorted(demand.task_rungs, worst, side="right") - 1)
            i = int(demand.rung[worst]) - sum(len(t) for t in tasks[:k])
            way = "no way leads past, and the one that would be taken"
            refuse_at(tasks[k], i, _collision(obstacles, pair, lacking, way), hints=path_hints(stuck, task.tip[i]))
    unhurried, _ = best_route(nodes, replace(demand, time=_UNHURRIED * demand.time), cell.limits)
    if unhurried is not None:
        reason = "no branch can follow the path up to here at the commanded speed: a joint would be too slow"
        refuse_at(task, i, reason, hints=speed_hints(cell, nodes, demand, task.speed))
    reason = "no branch leads up to here: each ends at a joint's range, a singularity or the arm's reach"
    refuse_at(task, i, reason, hints=path_hints(stuck, task.tip[i]))


def refuse_collision(cell: Cell, paths: Sequence[JointPath], obstacles: Obstacles) -> None:
    """Raise the Refusal that names what a path comes too near to, and where; the worst place of all.

    Where the nozzle may tilt, its clearance from part and print is not looked at: tilt may still give it.
    """
    if paths[0].task.cones.tilt > 0.0:
        obstacles = obstacles.but_head_on_part
    if not obstacles.any:
        return
    with ThreadPoolExecutor(cores()) as pool:
        margins = list(pool.map(lambda path: obstacles.margins(path.q, path.task.moments, 0.0), paths))
    worst = int(np.argmin([margin.min() for margin, _ in margins]))
    margin, which = margins[worst]
    i = int(np.argmin(margin))
    if margin[i] < -SLIGHT:
        what = _collision(obstacles, int(which[i]), float(margin[i]), "the best way found")
        refuse_at(paths[worst].task, i, what)


def _collision(obstacles: Obstacles, which: int, margin: float, subject: str) -> str:
    one, other = obstacles.names(which)
    return f"collision of {one} with {other}: {subject} lacks {-margin * 1e3:.1f} mm of clearance"


def _postures_at(cell: Cell, demand: Demand, grid: Grid, rung: int, min_sigma: float) -> Array:
    """Postures (m, nj) that a rung's nodes have where nothing is in the way."""
    one = [rung]
    few = demand.only(np.array(one), [0, 1])
    held = grid.chosen(len(demand.rung), len(cell.chosen))[one]
    own = replace(
        grid, roll_from=grid.roll_from[one], holder_from=grid.holder_from[one], branch=grid.branch[one], held=held
    )
    nodes = evaluate(cell, few, own, min_sigma)
    found = np.nonzero(np.isfinite(nodes.price))
    chosen = np.repeat(held, len(found[0]), axis=0)
    if cell.chosen and grid.swept is not None:
        chosen[:, grid.swept] = (own.holder_from[0] + found[2]) * grid.holder_step
    return np.hstack([nodes.q[found].astype(float), chosen[:, : len(cell.holder)]])


def _hit(cell: Cell, found: Found, obstacles: Obstacles) -> tuple[int, int, float]:
    """The rung at which a route comes nearest to obstacles, which pair does, and its margin [m]."""
    nodes, route, demand = found.nodes, found.route, found.demand
    grid = nodes.grid
    r = np.arange(len(route.roll))
    roll, holder = route.roll - grid.roll_from, route.holder - grid.holder_from
    column = np.argmax(grid.branch == route.branch[:, None], axis=1)
    arm = nodes.q[r, roll, holder, column].astype(float)
    q = np.hstack([arm, found.chosen(len(cell.chosen))[:, : len(cell.holder)]])
    margin, which = obstacles.margins(q, demand.now[demand.rung], np.inf, CLEAR_ROOM)
    worst = int(np.argmin(margin))
    return worst, int(which[worst]), float(margin[worst])


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
