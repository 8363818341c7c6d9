"""The roll × path maps that a plan carries: of the whole print, and of the beads where it is tightest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.cell import Cell
from planner.least_singular import least_singular_values
from planner.obstacles import Obstacles
from planner.resolve.jointpath import JointPath
from planner.resolve.roll_map import COLUMNS, RollMap, roll_map

BEAD_COLUMNS = 150  # of the map of a bead
FINEST = 1e-3  # m: what a column stands for, at least
_FEW = 50  # places of a path that are looked at to compare it with others


def roll_maps(cell: Cell, paths: Sequence[JointPath], obstacles: Obstacles, min_sigma: float) -> tuple[RollMap, ...]:
    """The map of all paths; then those of the beads that come nearest to a singularity and to an end stop.

    Of the whole alone, if it has few beads, and so shows them well.
    """
    whole = roll_map(cell, paths, obstacles, min_sigma, _columns(paths, COLUMNS))
    if len(paths) * BEAD_COLUMNS <= len(whole.s):
        return (whole,)
    single = ([paths[i]] for i in _tightest(cell, paths))
    return (whole, *(roll_map(cell, one, obstacles, min_sigma, _columns(one, BEAD_COLUMNS)) for one in single))


def _columns(paths: Sequence[JointPath], most: int) -> int:
    length = sum(float(path.task.s[path.task.last] - path.task.s[path.task.first]) for path in paths)
    return min(max(round(length / FINEST), 2), most)


def _tightest(cell: Cell, paths: Sequence[JointPath]) -> tuple[int, ...]:
    """Indices of the paths that come nearest to a singularity and to the end of an arm joint's range, in this order."""
    na = len(cell.arm)
    sigma, limit = [], []
    for path in paths:
        arm = path.q[path.task.first : path.task.last + 1, :na]
        jacobians = cell.arm.jacobians(arm[:: max(len(arm) // _FEW, 1)])[:, :, list(cell.solved)]
        sigma.append(least_singular_values(jacobians).min())
        limit.append(np.minimum(arm - cell.limits.q_min[:na], cell.limits.q_max[:na] - arm).min())
    return tuple(dict.fromkeys((int(np.argmin(sigma)), int(np.argmin(limit)))))
