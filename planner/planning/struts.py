"""Struts that no posture can lay: where the nozzle's axis is given, what it meets of its own print is known before any search.

A search looks at some places of a path, and sees struts that are as steep as the nozzle just clears pass at these and fail at
others. Here each bead is followed as verification follows it.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from planner.base.arrays import Array
from planner.base.errors import Blocked, Change, Hints
from planner.cell.solids import packed
from planner.collision.print_body import tip_slack
from planner.planning.clearance import may_come_nearer
from planner.planning.context import PlanningContext
from planner.resolve.infeasible import TILTS, descent, into_itself
from planner.resolve.joint_path import refuse_at
from planner.toolpath.bead import Bead
from planner.verify.checks import DIGITS
from planner.verify.executed import UNKNOWN, ExecutedMotion
from planner.verify.nozzle import nozzle_nearness

_STEP = 0.2e-3  # m between places along a strut; between these it is looked at as closely as it takes
_SLENDERER = "a slenderer nozzle (cell.nozzle.profile_mm) may pass: not planned"
_LEAN = "process.cones.nozzle_normal_deg"


def check_struts(given: PlanningContext) -> None:
    """Raise Blocked, by place, where an upright nozzle would be in the struts that are laid, in whatever posture.

    Beads on a surface, and nozzles that may lean, are the search's.
    """
    problem, beads = given.problem, given.toolpath.beads
    if not beads[0].round or problem.process.cones.tilt > 0.0:
        return
    heads = {name: given.cell.at(name).head for name in {bead.material for bead in beads}}
    solids, tree = {name: packed(head) for name, head in heads.items()}, given.body.tree
    clearance = 0.0 if may_come_nearer(problem) else problem.collision.nozzle
    slack = tip_slack(problem, given.toolpath)
    for k in range(given.first_bead, len(beads)):
        bead, task = beads[k], given.tasks[k - given.printed]
        s, motion = _along(bead)
        now = np.minimum(k + s / bead.length, np.nextafter(k + 1.0, 0.0))
        found = nozzle_nearness(
            tree, solids[bead.material], motion, now, np.full(len(s), slack[k]), clearance, look=0.0
        )
        if found.point < 0 or found.least >= -DIGITS:
            continue
        at = s[found.at]
        i = task.first + int(np.argmin(np.abs(bead.s - at)))
        name, near = heads[bead.material][found.body].name, given.body.name_of(found.point)
        down = descent(task, i)
        reason = f"collision of {name} with {near}: with the axis that is given every posture lacks {-found.least * 1e3:.2f} mm"
        if near == f"bead {k}" and down > 0.0:
            reason += into_itself(down)
        refuse_at(task, i, reason, hints=_hints, kind=Blocked)


def _hints() -> Hints:
    """What may help: a nozzle that leans, which can be planned, or one of another shape, which is the user's to have."""
    tries = tuple((f"{_LEAN}: {deg:g}", ((_LEAN, f"{deg:g}"),)) for deg in TILTS)
    return Change(f"{_LEAN}: {TILTS[-1]:g} may let the nozzle lean clear", tries), _SLENDERER


def _along(bead: Bead) -> tuple[Array, ExecutedMotion]:
    """Arc lengths (n) along a bead [m], and the nozzle's motion there as far as the print is concerned."""
    n = max(int(np.ceil(bead.length / _STEP)), 1) + 1
    s = np.union1d(bead.s, np.linspace(0.0, bead.length, n))
    tip = np.asarray(CubicSpline(bead.s, bead.points)(s))
    z, x = (
        np.column_stack([np.interp(s, bead.s, column) for column in each.T]) for each in (-bead.normals, bead.roll_zero)
    )
    z = z / np.linalg.norm(z, axis=1)[:, None]
    x = x - (x * z).sum(axis=1)[:, None] * z
    x = x / np.linalg.norm(x, axis=1)[:, None]
    rotation = np.stack([x, np.cross(z, x), z], axis=-1)
    none = np.full(len(s), np.nan)
    return s, ExecutedMotion(tip, z, rotation, np.zeros_like(tip), none, none, np.full(len(s), UNKNOWN, dtype=np.int8))
