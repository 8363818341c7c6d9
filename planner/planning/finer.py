"""Whether a plan that leaves its path between samples is worth planning again with more of them, and where."""

from __future__ import annotations

import numpy as np

from planner.plan import Trajectory
from planner.planning.context import PlanningContext, context_of
from planner.toolpath.finer import sampled_finer
from planner.verify.verdict import ON_PATH, Report

ROUNDS = 3  # of sampling finer and planning again
_NEAR = 0.7  # share of a tolerance from which on a place is sampled finer, in the beads that exceed it
_MOST = 400.0  # tolerances: what is off by more is off at the samples, too; 90 were, where normals turn by 17 deg between two
_BETTER = 0.7  # times as far off a plan must be as the one on fewer samples, for still more of them


def worst_off(report: Report) -> float:
    """How far a plan is off its path or the normal, in tolerances."""
    return float(report.series["off_the_path"].max(initial=0.0))


def with_finer_samples(
    given: PlanningContext, trajectory: Trajectory, report: Report, before: float = np.inf
) -> PlanningContext | None:
    """The same print with more samples where a plan of it is off the path or the normal.

    None if any other check fails too, or if more samples would not help: the plan is far off, or hardly less so than the
    one on fewer samples (`before`, in tolerances).
    """
    failed = {check.name for check in report.checks if not check.ok}
    off = report.series["off_the_path"]
    if not failed or not failed <= ON_PATH or worst_off(report) > min(_MOST, _BETTER * before):
        return None
    places = {}
    for bead in np.unique(trajectory.bead[off > 1.0]):
        at = np.flatnonzero((trajectory.bead == bead) & (off > _NEAR))
        places[int(bead)] = trajectory.s[at]
    if not places:
        return None
    toolpath = sampled_finer(given.toolpath, places)
    return context_of(given.problem, given.cell, toolpath, given.first_bead, given.terms)
