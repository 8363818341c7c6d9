"""Whether a plan that leaves its path between samples is worth planning again with more samples, and where."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array
from planner.plan import Trajectory
from planner.planning.context import PlanningContext
from planner.toolpath.finer import sampled_finer
from planner.verify.verdict import ON_PATH, Report

ROUNDS = 3  # of sampling finer and planning again
_NEAR = 0.7  # share of a tolerance above which a place is sampled more finely, in the beads that exceed the tolerance
_MOST = 400.0  # tolerances: anything farther off is off at samples, too; 90 occurred with 17 deg between two normals
_BETTER = 0.7  # × the worst error, or the number of beads off, on fewer samples: either must fall to this to go on


def worst_off(trajectory: Trajectory, report: Report) -> Array:
    """How far a plan is off its path or the normal in each bead (n), in tolerances; n: up to the last bead laid."""
    off = np.zeros(int(trajectory.bead.max(initial=-1)) + 1)
    printed = trajectory.bead >= 0
    np.maximum.at(off, trajectory.bead[printed], report.series["off_the_path"][printed])
    return off


def with_finer_samples(
    given: PlanningContext, trajectory: Trajectory, report: Report, before: Array | None = None
) -> PlanningContext | None:
    """The same print with more samples where a plan of it is off the path or the normal.

    None if any other check fails too, or if more samples would not help: if a bead is far off, or if hardly fewer beads
    are off, and by hardly less, than on fewer samples (`before` (beads), in tolerances).
    """
    failed = {check.name for check in report.checks if not check.ok}
    if not failed or not failed <= ON_PATH:
        return None
    off = worst_off(trajectory, report)
    beyond = np.flatnonzero(off > 1.0)
    if not len(beyond) or off.max() > _MOST:
        return None
    if before is not None and len(beyond) > _BETTER * (before > 1.0).sum() and off.max() > _BETTER * before.max():
        return None
    places = {}
    for bead in beyond.tolist():
        at = np.flatnonzero((trajectory.bead == bead) & (report.series["off_the_path"] > _NEAR))
        places[bead] = trajectory.s[at]
    return given.along(sampled_finer(given.toolpath, places))
