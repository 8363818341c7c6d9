"""A nozzle that leans where an upright one has no way: the search's reference leans, place by place, within its cone.

A search keeps the nozzle on the surface normal, and the refinement leans it where that costs less. If an upright nozzle
has no way, there is nothing to refine. Here leans are searched first, for each branch of the arm, as if every roll led
to every other; the path is then searched around the best of them. The result is refined, timed and verified with the
surface's true normals, like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Ints
from planner.base.errors import Refusal
from planner.base.geometry import angles_between
from planner.base.progress import Stages
from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.planning.context import PlanningContext, with_way
from planner.problem.settings import ResolveSpec
from planner.resolve.by_nozzle import nozzles_of
from planner.resolve.joint_path import spread
from planner.resolve.ladder import MOST_NODES, binds_table, coarse_grid
from planner.resolve.nodes import evaluate
from planner.toolpath.task import NozzleTask, roll_zeros

MOST_WAYPOINTS = 10_000  # of a print: all of its leans are searched in some ten seconds
SHARE = 0.9  # share of the cone that leans use: the rest is left to the refinement
_LEAST = np.radians(0.5)  # least lean that is worth a search
_RINGS, _AZIMUTHS = (0.5, 1.0), 8  # leans that are tried, in shares of the greatest, and directions of each
# In the unit of a node's price, the share of time lost: price of a change from no lean to the greatest between two
# rungs (it grows with the square), and of the greatest lean itself, enough to keep the nozzle upright where that serves
# as well.
_CHANGE, _LEANING = 0.5, 0.02


def leaning(given: PlanningContext, refusal: Refusal, stages: Stages) -> PlanningContext | None:
    """The same print, searched around a nozzle that leans within its cone, if that finds a way; a note says so.

    None if the nozzle may not lean, if cones about the vertical determine how it does, or if the print is large.
    refusal: that of the print with the nozzle on the surface normal
    """
    toolpath, cones = given.toolpath, given.tasks[0].cones
    large = toolpath.waypoints > MOST_WAYPOINTS
    if cones.tilt == 0.0 or cones.nozzle_gravity < np.pi or binds_table(given.cell, cones) or large:
        return None
    note = f"the nozzle leans within its cone, as there is no plan with it upright: {refusal}"
    return with_leans(replace(given, toolpath=replace(toolpath, notes=(*toolpath.notes, note))), stages)


def with_leans(given: PlanningContext, stages: Stages) -> PlanningContext | None:
    """The same print, searched around a nozzle that leans within its cone; None if no search finds a way."""
    with stages.stage("resolve"):
        tilts = best_leans(given)
        if tilts is None:
            return None
    try:
        return with_way(replace(given, tasks=leaned_tasks(given.tasks, tilts), leans=True), stages)
    except Refusal:
        return None


def best_leans(given: PlanningContext) -> list[Array] | None:
    """For each task the cheapest tilts (n, 2) in its frames [rad] with which some branch has a posture at every rung.

    They are smooth along the task. None if there are none, or if noise of the normals uses up the cone.
    """
    cell, tasks, settings = given.cell, given.tasks, given.problem.resolve
    off = max(float(angles_between(-task.frames[:, :, 2], task.normals).max()) for task in tasks)
    most = SHARE * tasks[0].cones.tilt - off
    if most < _LEAST:
        return None
    tilts = np.concatenate([np.zeros((1, 2)), *(most * share * _circle(_AZIMUTHS) for share in _RINGS)])
    found: dict[int, Array | None] = {}
    for own, which in nozzles_of(cell, tasks):
        obstacles = given.obstacles.for_nozzle(cell, own)
        found |= zip(which, _least_dear(own, [tasks[i] for i in which], settings, obstacles, tilts, most), strict=True)
    leans = [lean for _, lean in sorted(found.items()) if lean is not None]
    return leans if len(leans) == len(tasks) else None


def _least_dear(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles, tilts: Array, most: float
) -> list[Array | None]:
    """Tilts of each task of one nozzle, see `best_leans`, or None; chosen from tilts (k, 2), at most `most` [rad]."""
    demand, grid = coarse_grid(cell, tasks, settings, MOST_NODES)
    prices = []
    for tilt in tilts:
        turn = Rotation.from_rotvec([*tilt, 0.0]).as_matrix()
        nodes = evaluate(cell, replace(demand, frames=demand.frames @ turn), grid, settings.min_sigma, obstacles)
        prices.append(nodes.price.min(axis=(1, 2)))
    price = np.stack(prices, axis=1)  # (rungs, tilts, branches)
    found: list[Array | None] = []
    for k, task in enumerate(tasks):
        rungs = demand.rungs_of(k)
        chosen = cheapest_leans(price[rungs], tilts / most)
        found.append(None if chosen is None else spread(tilts[chosen], len(task), demand.place[rungs]))
    return found


def cheapest_leans(price: Array, tilts: Array) -> Ints | None:
    """The cheapest way of any branch: indices (n) of a bead's tilts at each rung.

    tilts (k, 2): in shares of the greatest; price (n, k, b): of a tilt at a rung on a branch, infinite without a
    posture. None if no branch has a way.
    """
    change = _CHANGE * ((tilts[:, None] - tilts[None]) ** 2).sum(axis=2)
    own = price + _LEANING * np.linalg.norm(tilts, axis=1)[:, None]
    cost, back = own[0], np.zeros(own.shape, dtype=np.int64)
    for i in range(1, len(own)):
        step = change[:, :, None] + cost[:, None, :]  # from, to, branch
        back[i] = step.argmin(axis=0)
        cost = own[i] + step.min(axis=0)
    if not np.isfinite(cost).any():
        return None
    at, branch = np.unravel_index(int(cost.argmin()), cost.shape)
    chosen = np.zeros(len(own), dtype=np.int64)
    for i in range(len(own) - 1, -1, -1):
        chosen[i] = at
        at = back[i, at, branch]
    return chosen


def leaned_tasks(tasks: Sequence[NozzleTask], tilts: Sequence[Array]) -> tuple[NozzleTask, ...]:
    """Tasks whose frames lean by tilts (n, 2) [rad]; the true normals, by which cones are judged, stay the same."""
    axes = []
    for task, tilt in zip(tasks, tilts, strict=True):
        turn = Rotation.from_rotvec(np.column_stack([tilt, np.zeros(len(tilt))])).as_matrix()
        axes.append((task.frames @ turn)[:, :, 2])
    zeros = roll_zeros([-z for z in axes])
    return tuple(
        replace(task, frames=np.stack([x, np.cross(z, x), z], axis=-1), true_normals=task.normals)
        for task, z, x in zip(tasks, axes, zeros, strict=True)
    )


def _circle(count: int) -> Array:
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)
