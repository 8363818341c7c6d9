"""Run-ins and run-outs as short as possible, where a bead can be laid but its runs do not fit at their usual length.

A wall next to a bead's end, or a lack of postures beyond it, would cause the whole print to be refused; and the nozzle
would press into an adjacent bead. With short runs the nozzle reaches its speed some tenths of a millimetre later. A
user's own `process.run_in_mm` is never shortened.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.plan import Trajectory
from planner.planning.clearance import NOZZLE_CHECK
from planner.planning.context import PlanningContext, with_way
from planner.problem import Problem
from planner.verify.verdict import Report

MOST_ENDS = 3  # shortened one by one, as searches find them, before all are
RUNS = ("run-in", "run-out")
# Checks that a run may fail where it passes over an adjacent bead, with the sign and the words to say by how much.
TIP_CHECK, PRESSED_CHECK = "nozzle tip outside the part", "print pressed by the nozzle"
RUN_CHECKS = {
    TIP_CHECK: (-1.0, "the tip is {:.2g} mm in the part"),
    PRESSED_CHECK: (1.0, "the nozzle presses {:.2g} of a bead's height into the print"),
    NOZZLE_CHECK: (1.0, "the nozzle is {:.2g} mm from part or print"),
}


def with_short_runs(given: PlanningContext, refusal: Refusal, stages: Stages) -> PlanningContext | None:
    """The same print with those runs shortened at which a search fails, if it then finds a way, or else with all of
    them short; None if the problem sets their length.

    refusal: that of the print with its usual runs
    """
    if not may_be_short(given.problem):
        return None
    beads = given.toolpath.beads
    short = {i: bead.short_runs for i, bead in enumerate(beads)}
    now, told = refusal, []
    for _ in range(MOST_ENDS):
        if now.bead is None or now.run not in RUNS or short[now.bead][RUNS.index(now.run)]:
            break
        ends = short[now.bead]
        short[now.bead] = (True, ends[1]) if now.run == "run-in" else (ends[0], True)
        told.append(f"{now.run} of bead {now.bead}")
        shortened = _shortened(given, short, f"{', '.join(told)} shortened: {refusal.reason}")
        try:
            return with_way(shortened, stages)
        except Refusal as stuck:
            now = stuck
    return all_short(given, refusal.reason)


def may_be_short(problem: Problem) -> bool:
    """Whether runs may be shortened, because the problem does not set their length."""
    return "run_in" not in problem.process.model_fields_set


def all_short(given: PlanningContext, because: str) -> PlanningContext:
    """The same print with all of its runs shortened, and a note that says why."""
    short = dict.fromkeys(range(len(given.toolpath.beads)), (True, True))
    return _shortened(given, short, f"run-ins and run-outs shortened: {because}")


def dips_in_a_run(trajectory: Trajectory, report: Report) -> str:
    """A note for a plan whose only fault is that the nozzle or its tip comes too close to part or print where nothing
    is laid, as when a run-in passes over an adjacent bead; empty for others."""
    wrong = [check for check in report.checks if not check.ok]
    if not wrong or any(check.name not in RUN_CHECKS or trajectory.deposit[check.sample] for check in wrong):
        return ""
    sign, words = RUN_CHECKS[wrong[0].name]
    return f"with their usual length {words.format(sign * wrong[0].worst)} ({wrong[0].where})"


def _shortened(given: PlanningContext, short: Mapping[int, tuple[bool, bool]], note: str) -> PlanningContext:
    """The same print with these runs shortened, and a note that says so."""
    toolpath = given.toolpath
    beads = tuple(replace(bead, short_runs=short[i]) for i, bead in enumerate(toolpath.beads))
    toolpath = replace(toolpath, beads=beads, notes=(*toolpath.notes, note))
    return given.along(toolpath)
