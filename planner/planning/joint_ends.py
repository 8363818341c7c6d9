"""Search again with a smaller margin to the joint limits where no path keeps the usual one.

What is found so is refined, timed and verified with the joints' true ranges, as everything is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.cell.cell import LIMIT_ROOM, Cell, near_ends
from planner.planning.context import PlanningContext, with_way
from planner.planning.short_runs import with_short_runs
from planner.resolve.joint_path import JointPath


def nearer_to_ends(given: PlanningContext, refusal: Refusal, stages: Stages) -> PlanningContext | None:
    """The same print, searched nearer to joints' ends, if a search finds a way there; with short runs where that needs them.
    None where the refusal is not for the room that is kept to them.

    Raises the Refusal that says why there is no way so near either.
    """
    if not refusal.near_ends:
        return None
    nearer = replace(given, cell=near_ends(given.cell))
    if given.problem.process.split_beads:  # a bead need not have a way of its own
        return nearer
    try:
        return with_way(nearer, stages)
    except Refusal as none:
        short = None if none.run is None else with_short_runs(nearer, none, stages)
        if short is None:
            raise none from refusal
        return short


def noted(given: PlanningContext, paths: Sequence[JointPath], refusal: Refusal) -> PlanningContext:
    """The same print with a note of how near its paths come to which ends; refusal: of the print with the usual room."""
    usual = f"{np.degrees(LIMIT_ROOM):.0f} deg" + (f" or {LIMIT_ROOM * 1e3:g} mm" if given.cell.limits.sliding else "")
    note = (
        f"no way keeps {usual} from the ends of joints' ranges: {refusal}; {', '.join(_nearest(given.cell, paths))}; "
        "verified by the ranges themselves"
    )
    toolpath = given.toolpath
    return replace(given, toolpath=replace(toolpath, notes=(*toolpath.notes, note)))


def _nearest(cell: Cell, paths: Sequence[JointPath]) -> list[str]:
    """Of each joint that comes nearer to an end of its range than usual the nearest place; of the nearest joint in any case."""
    limits = cell.limits
    rooms = [np.minimum(path.q - limits.q_min, limits.q_max - path.q) for path in paths]
    least = np.stack([room.min(axis=0) for room in rooms])  # (paths, joints)
    near = np.flatnonzero(least.min(axis=0) < max(LIMIT_ROOM, float(least.min()) + np.spacing(LIMIT_ROOM)))
    told = []
    for j in near:
        k = int(np.argmin(least[:, j]))
        i, task = int(np.argmin(rooms[k][:, j])), paths[k].task
        lower = paths[k].q[i, j] - limits.q_min[j] < limits.q_max[j] - paths[k].q[i, j]
        end = (limits.q_min if lower else limits.q_max)[j]
        scale, unit = (1e3, "mm") if j in limits.sliding else (np.degrees(1.0), "deg")
        along = 1e3 * float(task.s[min(max(i, task.first), task.last)])
        told.append(
            f"{cell.joint_names[j]} comes to {scale * least[k, j]:.1f} {unit} from its end at {scale * end:.1f}, "
            f"{along:.1f} mm along bead {task.bead}"
        )
    return told
