"""Postures of targets beside the path: near those of the samples, but at the border of a configuration perhaps beyond."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.export.fit import Poses
from planner.export.rotations import to_matrix
from planner.export.thinning import Indices
from planner.readonly import Array, Flags

if TYPE_CHECKING:
    from planner.plan import Plan


BLOCK = 20_000  # poses whose postures are sought at once: bounds the memory
REVOLUTION = 2.0 * np.pi


def reached(plan: Plan, sample: Indices, targets: Poses, moved: Flags) -> Array:
    """Joints (m, n) [rad] that hold the nozzle at targets (m): the samples' own, but where the target was moved (m).

    There they are of the same branch, in the nearest turn. Arms whose poses do not say a posture keep the samples'.
    """
    cell, t = plan.cell, plan.trajectory
    na = len(cell.arm)
    out: Array = t.q[sample]
    if cell.inverse.redundant_joint is not None:
        return out
    T_world_base, T_nozzle_flange = np.linalg.inv(cell.T_world_base), np.linalg.inv(cell.T_flange_nozzle)
    which = np.flatnonzero(moved)
    for rows in np.array_split(which, 1 + len(which) // BLOCK):
        T = np.tile(np.eye(4), (len(rows), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = to_matrix(targets.quat[rows]), targets.position[rows]
        station = np.ascontiguousarray(targets.station[rows])
        postures, exist = cell.inverse.solve(T_world_base @ cell.holder.poses(station) @ T @ T_nozzle_flange)
        each, branch = np.arange(len(rows)), t.branch[sample[rows]].astype(np.intp)
        off = postures[each, branch] - out[rows, :na]
        off -= REVOLUTION * np.round(off / REVOLUTION)
        out[rows, :na] += np.where(exist[each, branch, None], off, 0.0)
        out[rows, na:] = station
    return out
