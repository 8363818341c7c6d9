"""Whether a plan that leaves its path between samples is worth planning again with more of them, and where."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array
from planner.plan import Trajectory
from planner.planning.context import PlanningContext
from planner.toolpath.finer import sampled_finer
from planner.verify.verdict import ON_PATH, Report

ROUNDS = 3  # of sampling finer and planning again
_NEAR = 0.7  # share of a tolerance from which on a place is sampled finer, in the beads that exceed it
_MOST = 400.0  # tolerances: what is off by more is off at the samples, too; 90 were, where normals turn by 17 deg between two
_BETTER = 0.7  # times as far off the worst bead must be, or as many be off, as on fewer samples, for still more of them


def worst_off(trajectory: Trajectory, report: Report) -> Array:
    """How far a plan is off its path or the normal in each bead (n), in tolerances; n: up to the last bead that is."""
    off = np.zeros(int(trajectory.bead.max(initial=-1)) + 1)
    printed = trajectory.bead >= 0
    np.maximum.at(off, trajectory.bead[printed], report.series["off_the_path"][printed])
    return off


def with_finer_samples(
    given: PlanningContext, trajectory: Trajectory, report: Report, before: Array | None = None
) -> PlanningContext | None:
    """The same print with more samples where a plan of it is off the path or the normal.

    None if any other check fails too, or if more samples would not help: a bead is far off, or hardly fewer beads are, and
    hardly less so, than on fewer samples (`before` (beads), in tolerances).
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
