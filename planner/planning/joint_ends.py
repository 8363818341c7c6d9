"""Search again with a smaller margin to the joint limits if no path keeps the usual one.

The result is refined, timed and verified with the joints' true ranges, like any other.
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
    """The same print, searched closer to the joint limits, if a search finds a way there.

    With short runs if it needs them. None if the refusal is not due to the margin kept from the limits. Raises the
    Refusal that says why there is no way with a smaller margin either.
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
    """The same print with a note of how close its paths come to which limits; refusal: that with the usual margin."""
    usual = f"{np.degrees(LIMIT_ROOM):.0f} deg" + (f" or {LIMIT_ROOM * 1e3:g} mm" if given.cell.limits.sliding else "")
    note = (
        f"no plan keeps joints {usual} from the ends of their ranges: {refusal}; {', '.join(_nearest(given.cell, paths))}; "
        "verified against the ranges themselves"
    )
    toolpath = given.toolpath
    return replace(given, toolpath=replace(toolpath, notes=(*toolpath.notes, note)))


def _nearest(cell: Cell, paths: Sequence[JointPath]) -> list[str]:
    """In words, where each joint closer to its limits than usual comes closest; always of the closest joint, too."""
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
