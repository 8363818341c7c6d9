"""Reduced clearance as a last resort: nozzle and head closer to part and print than usual, but never inside them.

A user's own `collision.nozzle_mm` is never lowered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.collision.scene import obstacles_of
from planner.plan import Nearer
from planner.planning.context import PlanningContext, with_way
from planner.problem import Problem
from planner.resolve.drawn import passable
from planner.resolve.infeasible import NEARER
from planner.resolve.ladder import may_be_found
from planner.verify.verdict import Report

NOZZLE_CHECK = "nozzle clear of part and print"


def keeping(problem: Problem, nozzle: float) -> Problem:
    """The problem with nozzle and head keeping this distance [m]."""
    return problem.model_copy(update={"collision": problem.collision.model_copy(update={"nozzle": nozzle})})


def may_come_nearer(problem: Problem) -> bool:
    """Whether nozzle and head keep the usual distance only because the problem does not set one."""
    return "nozzle" not in problem.collision.model_fields_set


def as_near(problem: Problem, nearer: Nearer | None) -> Problem:
    """A problem that is read again, with the distance that its plan keeps if that is less than usual."""
    return keeping(problem, nearer.kept) if nearer is not None and may_come_nearer(problem) else problem


def lacks_clearance_only(report: Report) -> bool:
    """Whether a plan fails only because of the distance of nozzle and head."""
    return {check.name for check in report.checks if not check.ok} == {NOZZLE_CHECK}


def leads_on(given: PlanningContext, refusal: Refusal, kept: float | None = None) -> bool:
    """Whether a print that is refused at a place may have a way there.

    It has none if nothing drawn there is clear of part and print, or of everything else.
    kept: the distance of nozzle and head [m], if it differs from the problem's
    """
    obstacles = given.obstacles
    if kept is not None:
        obstacles = obstacles.with_nozzle_at(given.cell, kept) or obstacles
    return passable(given.cell, given.tasks, refusal, obstacles)


def coming_nearer(
    given: PlanningContext, because: str, stages: Stages, refusal: Refusal | None = None
) -> Iterator[tuple[Nearer, PlanningContext]]:
    """The same print with nozzle and head closer and closer to it, if that can help.

    No search finds a way at some distance if none does at the least one.
    because: why the usual distance cannot be kept, in words; refusal: the one that says so, if there is no plan at all
    """
    usual, last = given.problem.collision.nozzle, NEARER[-1]
    in_one_go = not given.problem.process.split_beads  # else a bead need not have a way of its own
    if refusal is not None:
        with stages.stage("resolve"):
            if not leads_on(given, refusal, last):  # takes a hundredth of a search's time
                return

    if in_one_go and not _may_be_found(_keeping(given, last), stages):
        return
    for kept in (each for each in NEARER if each < usual):
        there = _keeping(given, kept)
        try:
            nearer = with_way(there, stages) if in_one_go else there
        except Refusal:
            continue
        yield Nearer(kept, usual, because), nearer


def _keeping(given: PlanningContext, kept: float) -> PlanningContext:
    """The same print with nozzle and head keeping this distance [m]."""
    problem = keeping(given.problem, kept)
    obstacles = obstacles_of(problem, given.cell, given.toolpath, given.body)
    return replace(given, problem=problem, obstacles=obstacles, start=())


def _may_be_found(given: PlanningContext, stages: Stages) -> bool:
    with stages.stage("resolve"):
        return may_be_found(given.cell, given.tasks, given.problem.resolve, given.obstacles)
