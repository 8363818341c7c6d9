"""The planner itself on a case, whole: strategy, timing, travel and verification, with and without bodies around."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.peers.case import Case, given
from benchmarks.peers.judge import finish, path_facts, verdict
from benchmarks.rows import Row, times
from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.cell.cell import build_cell
from planner.collision.print_body import print_body, standing
from planner.collision.scene import NOTHING, obstacles_of
from planner.planning.context import PlanningContext
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath

SMALL = 200  # waypoints of the case that is planned before the clock starts
STRATEGY = "sqp"


def warm(ready: PlanningContext, collision: bool = False) -> None:
    """Plan a small case of the same joints: what is compiled or loaded for the first time is not to be timed."""
    alike = "peer_cylinder" if len(ready.cell.holder) else "peer_cap"
    with tempfile.TemporaryDirectory() as folder:
        planned(given(Case(alike, SMALL), Path(folder)), collision)


def planned(ready: PlanningContext, collision: bool) -> Row:
    """A row's columns of both tables; collision: bodies are kept apart, which peers are not asked for."""
    problem, stages = ready.problem, Stages()
    with stages.stage("load"):
        cell = build_cell(problem)
    with stages.stage("toolpath"):
        build_toolpath(problem)
    with stages.stage("obstacles"):
        body = print_body(ready.toolpath, standing(cell))
        obstacles = obstacles_of(problem, cell, ready.toolpath, body) if collision else NOTHING
    try:
        with stages.stage("resolve"):
            paths = STRATEGIES[STRATEGY](cell, ready.tasks, problem.resolve, obstacles)
        timed = finish(ready, paths, stages, obstacles)
    except Refusal as refusal:
        return {"reason": str(refusal), **times(stages.seconds, None)}
    facts = path_facts(ready, [path.q for path in paths])
    row = {"found": True, **facts, **verdict(ready, timed, told=collision)}
    return row | times(stages.seconds, int(timed.report.metrics["waypoints"]))
