"""Postures drawn at random at one place of a path: the cheapest check of whether anything could pass there at all.

A search tries a grid all along a path; one place at which no drawn posture is clear ends every search, whatever its
grid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.base.geometry import TURN
from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.resolve.joint_path import flange_poses, turned_to_middle, upright
from planner.resolve.reach import looked_at
from planner.toolpath.task import NozzleTask

PLACES = 48  # places spread over a print that are checked besides the one where a search ended
FEW, DRAWN = 150, 4_000  # draws of roll and one joint's angle at a place, first and then, each with all branches
_EACH, _MOST_DRAWN = 4, 64_000  # DRAWN is multiplied by _EACH for each further freedom, up to _MOST_DRAWN
_BEYOND = 1.5  # × the cone: it is about the true normal, but frames are on smoothed ones
SLIGHT = 1e-4  # m of clearance that a path between rungs may lack
_SAME = 1e-6  # m: the sample that a refusal names is no farther than this from the point that it gives


def repeated(task: NozzleTask, i: int, n: int) -> NozzleTask:
    """A task that repeats sample i of another n times."""
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
        material=task.material,
    )


def passable(cell: Cell, tasks: Sequence[NozzleTask], refusal: Refusal, obstacles: Obstacles) -> bool:
    """Whether there may be a way past the place that a refusal names, and past others spread along all beads.

    At each of them, some drawn posture is clear of obstacles. A print that is refused on one grid may pass that place
    on another one, and still have no way elsewhere.
    """
    around = {
        material: (own := cell.at(material), obstacles.for_nozzle(cell, own))
        for material in {task.material for task in tasks}
    }

    def passed(task: NozzleTask, i: int) -> bool:
        own, there = around[task.material]
        return _passed(own, task, i, there)

    return all(passed(tasks[k], i) for k, i in (*_named(tasks, refusal), *_spread(tasks)))


def _passed(cell: Cell, task: NozzleTask, i: int, obstacles: Obstacles) -> bool:
    """Whether some posture drawn at sample i of a task is clear: a few are tried first, then many."""
    freedoms = 1 + len(cell.chosen) + (2 if task.cones.tilt > 0.0 else 0)
    for n in (FEW, min(DRAWN * _EACH ** max(freedoms - 2, 0), _MOST_DRAWN)):
        q = postures_drawn(cell, task, i, n)
        margin, _ = obstacles.margins(q, np.full(len(q), float(task.moments[i])), 0.0)
        if (margin >= -SLIGHT).any():
            return True
    return False


def _named(tasks: Sequence[NozzleTask], refusal: Refusal) -> tuple[tuple[int, int], ...]:
    """The task and the sample that a refusal names, if it names any."""
    k = next((k for k, task in enumerate(tasks) if task.bead == refusal.bead), None)
    if k is None or refusal.point_mm is None or refusal.waypoint is None:
        return ()
    there = np.flatnonzero(np.linalg.norm(tasks[k].tip - 1e-3 * np.array(refusal.point_mm), axis=1) < _SAME)
    if not len(there):
        return ()
    return ((k, int(there[np.argmin(np.abs(there - (tasks[k].first + refusal.waypoint)))])),)


def _spread(tasks: Sequence[NozzleTask]) -> tuple[tuple[int, int], ...]:
    """Tasks and samples spread evenly over all of a print, its first and last among them."""
    ends = np.cumsum([len(task) for task in tasks])
    places = np.unique(np.linspace(0, ends[-1] - 1, min(PLACES, int(ends[-1]))).round().astype(np.int64))
    of = np.searchsorted(ends, places, side="right")
    return tuple((int(k), int(at - (ends[k] - len(tasks[k])))) for k, at in zip(of, places, strict=True))


def postures_drawn(cell: Cell, task: NozzleTask, i: int, n: int) -> Array:
    """Postures (m, nj) at sample i of a task within the joints' ranges: n rolls, tilts and angles of the chosen joints,
    on all branches. Tilts go a little beyond the cone about the normal; other cones are ignored."""
    na, nh, limits = len(cell.arm), len(cell.holder), cell.limits
    draw = np.random.default_rng(0)
    roll = draw.uniform(0.0, TURN, n)
    chosen = draw.uniform(*looked_at(cell), (n, len(cell.chosen)))
    spot, lean = repeated(task, i, n), upright(task)[[i] * n]
    if task.cones.tilt > 0.0:
        most = min(_BEYOND * task.cones.tilt, np.pi)
        size, azimuth = most * np.sqrt(draw.uniform(0.0, 1.0, n)), draw.uniform(0.0, TURN, n)
        lean = size[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    redundant = chosen[:, nh:] if cell.given else None
    q, ok = cell.inverse.solve(flange_poses(cell, spot, roll, lean, chosen[:, :nh]), redundant)
    q = turned_to_middle(limits, q)
    k, branch = np.nonzero(ok & ((q >= limits.q_min[:na]) & (q <= limits.q_max[:na])).all(axis=2))
    return np.hstack([q[k, branch], chosen[k, :nh]])
