"""Sampling that a plan's own tolerances ask for: where it leaves the path between samples, there are to be more of them."""

from __future__ import annotations

import numpy as np

from planner.plan import Trajectory
from planner.planning.context import PlanningContext, context_of
from planner.toolpath.finer import sampled_finer
from planner.verify.verdict import ON_PATH, Report

ROUNDS = 3  # of sampling finer and planning again
_NEAR = 0.7  # share of a tolerance from which on a place is sampled finer, in the beads that exceed it


def with_finer_samples(given: PlanningContext, trajectory: Trajectory, report: Report) -> PlanningContext | None:
    """The same print with more samples where a plan of it is off the path or the normal; None where that is not all that
    it fails by."""
    failed = {check.name for check in report.checks if not check.ok}
    if not failed or not failed <= ON_PATH:
        return None
    off = report.series["off_the_path"]
    places = {}
    for bead in np.unique(trajectory.bead[off > 1.0]):
        at = np.flatnonzero((trajectory.bead == bead) & (off > _NEAR))
        places[int(bead)] = trajectory.s[at]
    if not places:
        return None
    toolpath = sampled_finer(given.toolpath, places)
    return context_of(given.problem, given.cell, toolpath, given.first_bead, given.terms)
