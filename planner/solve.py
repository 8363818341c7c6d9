"""Solve a problem: from its file to a verified plan, and the command line for it.

python -m planner.solve cylinder_logo.yaml
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from planner.background import in_background, in_halves, spare_core
from planner.cell import Cell, build_cell
from planner.command import DEFAULT_DT, exit_code, options_of
from planner.dips import find_dips
from planner.errors import (
    EXIT_NOT_VERIFIED,
    EXIT_VERIFIED,
    InputError,
    Refusal,
)
from planner.export import program_notes, write_part, write_plan, write_refusal, write_robot_code, write_trajectory
from planner.export.languages import check_languages, chosen
from planner.headroom import headroom
from planner.motion import join
from planner.obstacles import NOTHING, Obstacles, obstacles_of
from planner.output import results_folder
from planner.plan import Plan, Trajectory, resumed_name
from planner.print_body import PrintBody, print_body, standing
from planner.problem import Problem, load_problem, shipped_problems
from planner.progress import Stages
from planner.report.failure import write_failure_report
from planner.report.html import write_report
from planner.report.summary import print_summary
from planner.resolve import STRATEGIES, UNAWARE
from planner.resolve.jointpath import JointPath
from planner.task import NozzleTask, tasks_of
from planner.timing import TimedPath, bound_time, time_path
from planner.tolerance import Headroom, Tolerance
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.travel import Travel, carried_travels, plan_travels
from planner.verify import Report, verify
from planner.verify_clear import check_start
from planner.versions import versions

Array = NDArray[np.float64]

BASELINE = "as_published"
WORTH_A_FORK = 5_000  # waypoints above which sharing the work takes less time than copying the process for it


def solve(
    problem: Problem,
    strategy: str | None = None,
    dt: float = DEFAULT_DT,
    stages: Stages | None = None,
    second_process: bool = False,
    tolerance: Tolerance | None = None,
    first_bead: int = 0,
) -> Plan:
    """Plan a problem with a strategy (the problem's own, if none is given), sampled every dt [s], and verify it.

    With a tolerance, for parts too that stand elsewhere by as much. From a first bead on that is not 0 the rest of an
    interrupted print is planned: the same joint paths as of the whole one, what lies before is there already.

    The plan that comes back may have failed checks: see `Plan.verified`. The baseline strategy is planned as
    well; its metrics are in `Plan.baseline`. With a `second_process` the same comes sooner, where the print is large.
    Raises InputError for wrong input, Refusal where there is no plan at all.
    """
    stages = stages or Stages()
    strategy = strategy or problem.strategy
    with stages.stage("load"):
        cell = build_cell(problem)
        check_languages(problem, cell)
        check_start(problem, cell)
    with stages.stage("toolpath"):
        toolpath = build_toolpath(problem)
    with stages.stage("obstacles"):
        given = _given(problem, cell, toolpath, _within(first_bead, toolpath))
    with _baseline_beside(strategy, given, dt, second_process) as baseline_metrics:
        trajectory, report, paths, travels = _plan_with(strategy, given, dt, stages, second_process)
        with stages.stage("dips"):
            dips = find_dips(problem, cell, toolpath, paths, trajectory)
        with stages.stage("baseline"):
            baseline = baseline_metrics()
    judged = None
    if tolerance is not None:
        with stages.stage("tolerance"):
            rest = paths[first_bead:]
            judged = _headroom(tolerance, problem, cell, toolpath, rest, travels, report, dt, second_process)
    return Plan(
        problem=problem,
        cell=cell,
        toolpath=toolpath,
        strategy=strategy,
        trajectory=trajectory,
        checks=report.checks,
        metrics=report.metrics,
        series=report.series,
        timing_s=dict(stages.seconds),
        versions=versions(),
        baseline=baseline,
        settings={"dt": dt},
        dips=dips,
        approaches=report.approaches,
        view=report.view,
        headroom=judged,
    )


def try_out(problem: Problem, toolpath: Toolpath, strategy: str, second_process: bool = False) -> Report:
    """What verification says of the plan that `solve` would make, without dips and baseline.

    toolpath: the problem's own, which does not depend on its cell. Raises Refusal where there is no plan at all.
    """
    given = _given(problem, build_cell(problem), toolpath)
    _, report, *_ = _plan_with(strategy, given, DEFAULT_DT, Stages(), second_process)
    return report


@dataclass(frozen=True)
class _Given:
    """What every strategy plans with, and is verified with; of the tasks only those from `first_bead` on are printed."""

    problem: Problem
    cell: Cell
    toolpath: Toolpath
    tasks: tuple[NozzleTask, ...]
    body: PrintBody
    obstacles: Obstacles
    first_bead: int


def _given(problem: Problem, cell: Cell, toolpath: Toolpath, first_bead: int = 0) -> _Given:
    """Raises InputError for a bead that is too short for the problem's fibre."""
    body = print_body(toolpath, standing(cell))
    tasks, obstacles = tasks_of(problem, toolpath), obstacles_of(problem, cell, toolpath, body)
    return _Given(problem, cell, toolpath, tasks, body, obstacles, first_bead)


def _within(first_bead: int, toolpath: Toolpath) -> int:
    """The index of the first bead to print. Raises InputError where there is no such bead."""
    last = len(toolpath.beads) - 1
    if not 0 <= first_bead <= last:
        raise InputError(f"there is no bead {first_bead} to begin with", hint=f"a number from 0 to {last}")
    return first_bead


def _plan_with(
    strategy: str, given: _Given, dt: float, stages: Stages, second_process: bool = False
) -> tuple[Trajectory, Report, Sequence[JointPath], Sequence[Travel]]:
    """Resolve, time, join and verify with one strategy; the bound on the deposition time joins the metrics.

    Paths are those of all beads, travels only those around what is printed.
    """
    problem, cell, toolpath = given.problem, given.cell, given.toolpath
    obstacles = NOTHING if strategy in UNAWARE else given.obstacles
    beside = second_process and _waypoints(toolpath) >= WORTH_A_FORK
    with stages.stage("resolve"):
        paths = STRATEGIES[strategy](cell, given.tasks, problem.resolve, obstacles)
    with stages.stage("timing"):
        rest = paths[given.first_bead :]
        trajectory, travels = _trajectory(problem, cell, toolpath, rest, obstacles, dt, beside)
    with stages.stage("verify"):
        report = verify(problem, cell, toolpath, trajectory, beside, given.body)
    with stages.stage("dips"):
        bound = {"bound_deposition_time_s": sum(bound_time(cell, path) for path in rest)}
    return trajectory, replace(report, metrics=report.metrics | bound), paths, travels


def _trajectory(
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    paths: Sequence[JointPath],
    obstacles: Obstacles,
    dt: float,
    second_process: bool,
) -> tuple[Trajectory, Sequence[Travel]]:
    """Time the beads' paths and plan the travel between them, half of both in a second process if that is wanted.

    The travels in the trajectory come back with it.
    """
    n, moving = len(paths), problem.process.hand_over == "motion"

    def part(first: int, last: int) -> list[TimedPath]:
        return [time_path(cell, path, (moving, moving)) for path in paths[first:last]]

    def ways(first: int, last: int) -> list[Travel]:
        which = range(first, last + (last == n))  # the way home comes after the last bead
        return plan_travels(cell, timed, toolpath, problem.process, which, obstacles)

    done = np.cumsum([len(path.q) for path in paths])
    middle = 1 + int(np.searchsorted(done, 0.5 * done[-1]))
    timed = [each for half in in_halves(part, n, second_process, middle) for each in half]
    travels = [each for half in in_halves(ways, n, second_process) for each in half]
    return join(cell, toolpath, problem.process, timed, travels, dt), travels


def _elsewhere(
    problem: Problem, cell: Cell, toolpath: Toolpath, paths: Sequence[JointPath], travels: Sequence[Travel], dt: float
) -> Trajectory:
    """The trajectory in a cell whose part stands elsewhere: paths that were followed there, travel carried along."""
    process, moving = problem.process, problem.process.hand_over == "motion"
    timed = [time_path(cell, path, (moving, moving)) for path in paths]
    carried = [
        plan_travels(cell, timed, toolpath, process, range(i, i + 1))[0] if way is None else way
        for i, way in enumerate(carried_travels(cell, travels, timed, process.travel_speed))
    ]
    return join(cell, toolpath, process, timed, carried, dt)


def _waypoints(toolpath: Toolpath) -> int:
    return sum(len(bead.s) for bead in toolpath.beads)


def _headroom(
    tolerance: Tolerance,
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    paths: Sequence[JointPath],
    travels: Sequence[Travel],
    planned: Report,
    dt: float,
    second_process: bool,
) -> Headroom:
    """Judge the plan over a tolerance: the same choices along the beads, the same travel between them."""

    def again(elsewhere: Cell, followed: Sequence[JointPath]) -> Report:
        return verify(problem, elsewhere, toolpath, _elsewhere(problem, elsewhere, toolpath, followed, travels, dt))

    return headroom(tolerance, problem, cell, toolpath, paths, planned, again, second_process)


@contextmanager
def _baseline_beside(
    strategy: str, given: _Given, dt: float, second_process: bool
) -> Iterator[Callable[[], dict[str, dict[str, float]]]]:
    """What gives the baseline's metrics by strategy, planned beside the block where that is worth a process."""
    if strategy == BASELINE:
        yield dict
    elif second_process and _waypoints(given.toolpath) >= WORTH_A_FORK and spare_core():
        with in_background(_baseline, given, dt) as wait:
            yield wait
    else:
        yield lambda: _baseline(given, dt)


def _baseline(given: _Given, dt: float) -> dict[str, dict[str, float]]:
    """Metrics of the published way of moving; empty ones if it cannot be planned here."""
    try:
        _, report, *_ = _plan_with(BASELINE, given, dt, Stages())
    except Refusal:
        return {BASELINE: {}}
    return {BASELINE: report.metrics}


def write(plan: Plan, folder: Path, stages: Stages | None = None, second_process: bool = False) -> Plan:
    """Write a plan's files into a folder, robot code only if the plan is verified; returns it with all timings.

    Robot code, which is read back and compared, takes as long as all else: a second process may write it meanwhile.
    """
    stages = stages or Stages()
    with stages.stage("export"):
        if not plan.verified:
            _write_tables(plan, folder)
        elif second_process and _waypoints(plan.toolpath) >= WORTH_A_FORK and spare_core():
            with in_background(write_robot_code, plan, folder) as wait:
                _write_tables(plan, folder)
                wait()
        else:
            write_robot_code(plan, folder)
            _write_tables(plan, folder)
    seconds = {**plan.timing_s, **stages.seconds}
    plan = replace(plan, timing_s={**seconds, "total": sum(seconds.values())})
    write_plan(plan, folder)
    return plan


def _write_tables(plan: Plan, folder: Path) -> None:
    write_report(plan, folder / "report.html")
    write_trajectory(plan, folder)
    write_part(plan, folder)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = options_of(arguments)
    errors = Console(stderr=True, highlight=False)
    if options.list:
        print("\n".join(shipped_problems()))
        return EXIT_VERIFIED
    return exit_code(lambda: _run(options, errors), partial(errors.print, markup=False, soft_wrap=True))


def _run(options: argparse.Namespace, errors: Console) -> int:
    with Stages(None if options.quiet else errors) as stages:
        with stages.stage("load"):
            problem = load_problem(options.problem, options.set)
        strategy = options.strategy or problem.strategy
        folder = options.out or Path("out") / resumed_name(problem.name, options.from_bead)
        with results_folder(folder) as fresh:  # first of all: a folder that cannot be written is told at once
            try:
                plan = solve(problem, strategy, options.dt, stages, True, options.tolerance, options.from_bead)
            except Refusal as refusal:
                write_refusal(problem, strategy, refusal, fresh)
                _report_refusal(problem, strategy, refusal, fresh / "report.html")
                reason: Refusal | None = refusal
            else:
                plan = replace(plan, settings={**plan.settings, "overrides": list(options.set)})
                plan = write(plan, fresh, stages, second_process=True)
                reason = None
    if reason is not None:
        errors.print(f"no plan: {reason}", markup=False, soft_wrap=True)
        for hint in reason.hints:
            errors.print(f"try: {hint}", markup=False, soft_wrap=True)
        errors.print(f"see {folder / 'report.html'}", markup=False, soft_wrap=True)
        return EXIT_NOT_VERIFIED
    print_summary(plan, folder, chosen(plan).words, program_notes(plan, folder))
    return EXIT_VERIFIED if plan.verified else EXIT_NOT_VERIFIED


def _report_refusal(problem: Problem, strategy: str, refusal: Refusal, path: Path) -> None:
    """The report of a refusal shows the beads again, and the place among them."""
    write_failure_report(
        path,
        problem=problem,
        strategy=strategy,
        message=str(refusal),
        toolpath=build_toolpath(problem),
        bead=refusal.bead,
        point_mm=refusal.point_mm,
        facts={},
        hints=refusal.hints,
    )


if __name__ == "__main__":
    sys.exit(main())
