"""A nozzle that leans where an upright one has no way: the search's own reference leaned, place by place, within its cone.

A search keeps the nozzle on the surface, and the refinement leans it where that costs less. Where no upright nozzle has a
way there is nothing to refine. Here leans are searched first, for each branch of the arm, as if every roll led to every
other; the path is then searched about the best of them. What is found so is refined, timed and verified with the surface's
true normals, as everything is.
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

MOST_WAYPOINTS = 10_000  # of a print, all of whose leans are searched in some ten seconds
SHARE = 0.9  # of the cone that leans use: the rest is the refinement's room
_LEAST = np.radians(0.5)  # of a lean that is worth a search
_RINGS, _AZIMUTHS = (0.5, 1.0), 8  # leans that are tried, in shares of the greatest, and directions of each
# In the unit of a node's price, the share of time lost: a lean from none to the greatest between two rungs, squared, and as
# much as keeps the nozzle upright where that serves as well.
_CHANGE, _LEANING = 0.5, 0.02


def leaning(given: PlanningContext, refusal: Refusal, stages: Stages) -> PlanningContext | None:
    """The same print, searched about a nozzle that leans within its cone, if a search finds a way then; a note tells.

    None where the nozzle may not lean, where cones about the vertical say how it does, and where the print is large.
    refusal: of the print with the nozzle on the surface
    """
    toolpath, cones = given.toolpath, given.tasks[0].cones
    large = toolpath.waypoints > MOST_WAYPOINTS
    if cones.tilt == 0.0 or cones.nozzle_gravity < np.pi or binds_table(given.cell, cones) or large:
        return None
    note = f"the nozzle leans within its cone, as an upright one has no way: {refusal}"
    return with_leans(replace(given, toolpath=replace(toolpath, notes=(*toolpath.notes, note))), stages)


def with_leans(given: PlanningContext, stages: Stages) -> PlanningContext | None:
    """The same print searched about a nozzle that leans within its cone; None if no search finds a way."""
    with stages.stage("resolve"):
        tilts = best_leans(given)
        if tilts is None:
            return None
    try:
        return with_way(replace(given, tasks=leaned_tasks(given.tasks, tilts), leans=True), stages)
    except Refusal:
        return None


def best_leans(given: PlanningContext) -> list[Array] | None:
    """For each task tilts (n, 2) in its frames [rad] with which one branch at least has a posture at every rung, of those the
    least dear, smooth along the task. None where there are none, or noise of the normals takes up the cone."""
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
    """For each task of one nozzle its tilts, see `best_leans`, or None; of some (k, 2) up to the greatest [rad]."""
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
    """Which of some tilts (k, 2), in shares of the greatest, a bead has at each rung (n): of all branches the cheapest way.

    price (n, k, b) of a tilt at a rung on a branch, infinite where it has no posture. None where no branch has a way.
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
    """Tasks whose frames lean by tilts (n, 2) [rad]; the true normals, on which cones are judged, stay."""
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
