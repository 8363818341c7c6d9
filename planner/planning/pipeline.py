"""From a problem to a verified plan, and its files: the table of contents of the whole process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arguments import as_index, as_list, as_number, as_one_of, as_path, check_callable
from planner.base.arrays import Array
from planner.base.compiled import was_compiled
from planner.base.distribution import Spread
from planner.base.errors import Blocked, InputError, Refusal, nearest_name
from planner.base.freed import give_back, given_back
from planner.base.processes import beside, in_halves, of_each, spare_core
from planner.base.progress import Stages
from planner.base.versions import versions
from planner.cell.cell import Cell, build_cell
from planner.collision.print_body import PrintBody, print_body, standing
from planner.collision.scene import NOTHING, Obstacles, obstacles_of
from planner.export.languages import check_languages
from planner.motion.as_run import asked_of, corrections_of
from planner.motion.dips import find_dips
from planner.motion.interlayer import contacts_within, with_rests
from planner.motion.timing.kernels import fastest
from planner.motion.timing.timed_path import TimedPath, bound_time, time_path
from planner.motion.trajectory import join
from planner.motion.travel.plan import Travel, carried_travels, plan_travels
from planner.plan import Nearer, Plan, Trajectory
from planner.plan.robustness import Robustness, Tolerance, parse_tolerance
from planner.plan.seal import sealed
from planner.planning.advice import advise
from planner.planning.candidates import DEFAULT, PlannedPaths, best_of_all
from planner.planning.clearance import coming_nearer, lacks_clearance_only, leads_on, may_come_nearer
from planner.planning.context import PlanningContext, context_of, with_way
from planner.planning.distributed import sqp_over
from planner.planning.estimate import TOLD_FROM, WORTH_A_FORK, WORTH_HALVES, check_memory, estimate
from planner.planning.finer import ROUNDS, with_finer_samples, worst_off
from planner.planning.joint_ends import nearer_to_ends, noted
from planner.planning.leaning import leaning, with_leans
from planner.planning.options import DEFAULT_DT, MAX_DT, MIN_DT
from planner.planning.pieces import MORE_ROOM, in_pieces
from planner.planning.robustness import assess_robustness
from planner.planning.short_runs import all_short, dips_in_a_run, may_be_short, with_short_runs
from planner.planning.tried import hints_that_hold, other_places
from planner.planning.upright import check_upright
from planner.problem import Problem, load_problem
from planner.problem.overrides import overrides_of, printed
from planner.problem.waypoint_arrays import WaypointArrays
from planner.resolve.bound import MOST_CHOSEN, MOST_WAYPOINTS, bound_any_path
from planner.resolve.joint_path import JointPath
from planner.resolve.least_lean import check_cones
from planner.resolve.own_terms import Own, OwnTerm, own_terms
from planner.resolve.roll_map import RollMap, roll_maps
from planner.resolve.sqp import refine_paths
from planner.resolve.strategies import STRATEGIES, UNAWARE
from planner.toolpath.as_printed import printed_beads
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.speeds import mean_speed, resting_time
from planner.toolpath.workload import Workload
from planner.verify.as_run import ASKED, as_run
from planner.verify.collision import check_start
from planner.verify.drawing import cell_view
from planner.verify.reread.faces import faces_ahead
from planner.verify.verdict import Report, verify

BASELINE = "as_published"
# No second plan is made for comparison beyond so many beads, each of which takes some 10 ms for timing and travel, or
# so many waypoints, where the second plan takes as much memory as the first: gigabytes.
MOST_COMPARED_BEADS, MOST_COMPARED = 5_000, 800_000


def load(
    problem: Problem | str | Path,
    *overrides: str | Mapping[str, Any],
    toolpath: WaypointArrays | None = None,
    **keywords: Any,
) -> Problem:
    """Read a problem file, or a shipped problem by its name, such as `load("cylinder_logo", {"layers.count": 1})`.

    All changes are applied before anything is checked. Files that the problem names (a drawing, a mesh) are not opened
    yet.

    Args:
        problem: A problem file, the name of a shipped problem, or a problem that was read, to be read again with
            further overrides.
        *overrides: `dotted.key=value` as after `--set`, or dictionaries of dotted keys, in the file's units; they
            replace what the file has there. A path given as text is relative to the problem's folder, a `Path` to the
            current one.
        toolpath: Waypoints of `Toolpath.from_arrays`, in place of the file's layers and part; keys of `layers.source`
            that apply to waypoints of a file may be set in addition.
        **keywords: Overrides with `__` for a dot, such as `load("cylinder_logo", layers__count=1)`.

    Returns:
        The problem, checked.

    Raises:
        InputError: For whatever is wrong, with its file, line and field, or the argument that it came from.
    """
    changes = overrides_of(overrides, keywords)
    if toolpath is not None:
        changes = (printed(toolpath), *changes)
    if isinstance(problem, Problem):
        return problem.changed(changes)
    return load_problem(as_path(problem, "problem"), changes)


def solve(
    problem: Problem | str | Path,
    strategy: str | None = None,
    dt: float = DEFAULT_DT,
    stages: Stages | None = None,
    second_process: bool = False,
    tolerance: Tolerance | str | None = None,
    first_bead: int = 0,
    baseline: bool = True,
    draft: bool = False,
    over: Spread | None = None,
    terms: Sequence[OwnTerm] = (),
) -> Plan:
    """Plan a problem, or what `load` takes, and verify the plan.

    Nothing is written: see `write`.

    Args:
        problem: A `Problem`, a problem file, or the name of a shipped problem.
        strategy: One of `STRATEGIES`; by default, the problem's own.
        dt: Time between samples [s], 0.0005 to 0.02.
        stages: Shows and times the stages.
        second_process: Whether to use a second process, which gives the same result sooner for large prints.
        tolerance: Such as "2mm,1deg": the plan is also judged for parts displaced by up to that much.
        first_bead: If not 0, the rest of an interrupted print is planned from this bead on, along the same joint paths
            as the whole print; the beads before it are already there.
        baseline: Whether the baseline strategy is planned as well; its metrics are in `Plan.baseline`.
        draft: For interactive use: the first verified plan is taken as it is, without a baseline and advice.
        over: Spreads the beads that strategy `sqp` refines over processes or machines, see
            `planner.base.distribution.crew`.
        terms: Terms of your own that the refinement of strategy `sqp` weighs against the others, see `OwnTerm`.

    Returns:
        The plan, which may have failed checks; see `Plan.verified`.

    Raises:
        InputError: If the input is wrong, or if there is not enough memory.
        Refusal: If there is no plan at all.
    """
    problem = problem if isinstance(problem, Problem) else load(problem)
    tolerance = None if tolerance is None else _tolerance(tolerance)
    strategy = _known(problem.strategy if strategy is None else strategy)
    first_bead = as_index(first_bead, "first_bead")
    dt = as_number(dt, "dt")
    if not MIN_DT <= dt <= MAX_DT:
        raise InputError(f"{dt!r} is not a time between {MIN_DT} and {MAX_DT} s", field="dt")
    if problem.from_arrays and over is not None:
        raise InputError("other processes cannot see waypoints from arrays", field="over", hint="leave it out")
    terms = as_list(terms, "terms", "terms")
    own = _own(terms, strategy, over)
    stages = stages or Stages()
    with faces_ahead(problem) if second_process and spare_core() else nullcontext():
        with stages.stage("load"):
            cell = build_cell(problem)
            check_languages(problem, cell)
            check_start(problem, cell)
        with stages.stage("toolpath"):
            toolpath = build_toolpath(problem)
            if not problem.process.split_beads:
                corrections_of(problem, toolpath)
        work = Workload.of(toolpath)
        resting = resting_time(problem.process, toolpath)
        expected = estimate(work, mean_speed(problem.process, toolpath), dt, resting)
        check_memory(problem, work, expected)
        if expected.seconds >= TOLD_FROM:
            stages.tell(f"{work.waypoints:,} waypoints in {work.beads:,} beads: {expected.words}")
        with stages.stage("obstacles"):
            pieces = problem.process.split_beads  # counted only once it is known whether there are any
            begin = 0 if pieces else _within(_above_what_is_printed(problem, toolpath, first_bead), toolpath)
            given = context_of(problem, cell, toolpath, begin, own)
            given = replace(given, draft=draft)
            check_cones(problem, cell, given.tasks)
        compared = baseline and not draft and strategy != BASELINE
        for count, most, what in (
            (work.beads, MOST_COMPARED_BEADS, "beads"),
            (work.waypoints, MOST_COMPARED, "waypoints"),
        ):
            if compared and count > most:
                compared = False
                stages.tell(f"more than {most:,} {what}: not compared with {BASELINE}")
        late = pieces and first_bead > 0  # the baseline is that of the rest, which is known only once pieces are
        with _baseline_beside(compared and not late, given, dt, second_process) as baseline_metrics:
            found, nearer = _found(strategy, given, first_bead, dt, stages, second_process, over)
            given, planned, maps = found
            problem, toolpath = given.problem, given.toolpath
            if nearer is not None:
                toolpath = replace(toolpath, notes=(*toolpath.notes, nearer.words))
            trajectory, report, rest = planned.trajectory, planned.report, planned.paths[given.laid]
            with stages.stage("dips"):
                dips = find_dips(problem, cell, toolpath, planned.paths, trajectory)
                metrics = report.metrics | _distance(given, report)
                whole = given.first_bead == 0 and strategy == DEFAULT and baseline and not draft
                advice = advise(given, planned.paths, trajectory, dips) if whole else ()
            with stages.stage("baseline"):
                of_baseline = _baseline(given, dt) if compared and late else baseline_metrics()
        judged = None
        if tolerance is not None:
            with stages.stage("tolerance"):
                judged = _robustness(
                    tolerance, strategy, problem, cell, toolpath, rest, planned.travels, report, dt, second_process
                )
        plan = Plan(
            problem=problem,
            cell=cell,
            toolpath=toolpath,
            strategy=strategy,
            resolved_by=planned.by,
            trajectory=trajectory,
            checks=report.checks,
            metrics=metrics,
            series=report.series,
            timing_s=dict(stages.seconds),
            versions=versions(),
            baseline=of_baseline,
            settings={"dt": dt, "overrides": list(problem.overrides)} | _names_of(terms),
            dips=dips,
            advice=advice,
            approaches=report.approaches,
            view=cell_view(cell),
            headroom=judged,
            paths=tuple(rest),
            roll_maps=maps,
            nearer=nearer,
        )
        return sealed(with_asked(plan, stages, given.body))


def _found(
    strategy: str,
    given: PlanningContext,
    first_bead: int,
    dt: float,
    stages: Stages,
    second_process: bool,
    over: Spread | None,
) -> tuple[Planned, Nearer | None]:
    """The whole print planned as well as possible, keeping only what follows from `first_bead` on.

    Raises Refusal, with hints that were tried.
    """
    problem, toolpath, pieces = given.problem, given.toolpath, given.problem.process.split_beads
    shared = second_process and toolpath.waypoints >= WORTH_HALVES

    def print_of(given: PlanningContext, over: Spread | None = None) -> Planned:
        if pieces:
            return _planned_in_pieces(strategy, given, dt, stages, shared)
        return _planned(strategy, given, dt, stages, shared, over)

    try:
        if toolpath.beads[0].round:
            check_upright(given)
        whole_print = replace(given, first_bead=given.printed)
        found, nearer = _as_can_be(strategy, whole_print, print_of, stages, over)
        begin = _within(_above_what_is_printed(problem, found[0].toolpath, first_bead), found[0].toolpath)
        if begin != found[0].first_bead:
            found = _rest_of(strategy, found, begin, dt, stages, shared)
    except Refusal as refused:
        refusal = _by_what_stands_there(given, refused)
        again = partial(solve, strategy=strategy, dt=dt, first_bead=first_bead, baseline=False)
        best = None if strategy == DEFAULT else partial(again, strategy=DEFAULT)
        elsewhere = other_places(problem) if refusal.posture or refusal.missing_mm else ()
        refusal.trying(partial(hints_that_hold, problem, toolpath, plan=again, best=best, otherwise=elsewhere))
        raise refusal from None
    return found, nearer


def _by_what_stands_there(given: PlanningContext, refusal: Refusal) -> Refusal:
    """The refusal; if everything is blocked, rather one that names what an upright nozzle collides with."""
    if isinstance(refusal, Blocked) and not given.toolpath.beads[0].round:
        try:
            check_upright(given)
        except Blocked as blocked:
            return blocked
    return refusal


def with_asked(plan: Plan, stages: Stages, body: PrintBody | None = None) -> Plan:
    """The plan with the motion that its program commands, as learnt from runs, and the checks of it.

    Without corrections it has neither. body: part and print as obstacles, see `verify`. Raises InputError for
    corrections that do not belong to this print.
    """
    asked = asked_of(plan.problem, plan.cell, plan.toolpath, plan.trajectory)
    own = tuple(check for check in plan.checks if not check.name.startswith(ASKED))
    if asked is None:
        return replace(plan, asked=None, checks=own)
    with stages.stage("verify"):
        found = as_run(plan.problem, plan.cell, plan.toolpath, plan.trajectory, asked, body)
    return replace(plan, asked=asked, checks=(*own, *found.checks), metrics=plan.metrics | dict(found.metrics))


def try_out(problem: Problem, toolpath: Toolpath, strategy: str, second_process: bool = False) -> Report:
    """The verification report of the plan that `solve` would make, without dips and baseline, at full clearance.

    toolpath: the problem's own, which does not depend on its cell. Raises Refusal if there is no plan at all.
    """
    given = context_of(problem, build_cell(problem), toolpath)
    shared = second_process and toolpath.waypoints >= WORTH_HALVES
    if problem.process.split_beads:
        return _planned_in_pieces(strategy, given, DEFAULT_DT, Stages(), shared)[1].report
    return _planned(strategy, given, DEFAULT_DT, Stages(), shared)[1].report


def _known(strategy: str) -> str:
    """The strategy's name. Raises InputError if there is no such strategy."""
    as_one_of(strategy, str, "strategy", "its name; register_strategy gives one to a function of your own")
    if strategy in STRATEGIES:
        return strategy
    near = nearest_name(strategy, STRATEGIES)
    hint = f"did you mean {near}?" if near else f"strategies: {', '.join(STRATEGIES)}"
    raise InputError(f"there is no strategy {strategy!r}", hint=hint)


def _own(terms: Sequence[OwnTerm], strategy: str, over: Spread | None) -> tuple[Own, ...]:
    """A user's terms. Raises InputError for anything that is no term, and if nothing would use them."""
    if terms and strategy != DEFAULT:
        raise InputError(f"strategy {strategy} refines nothing", field="terms", hint=f"strategy {DEFAULT} does")
    if over is not None:
        check_callable(over, "over")
    if terms and over is not None:
        raise InputError("cannot be evaluated in other processes", field="terms", hint="leave out over")
    return own_terms(terms)


def _names_of(terms: Sequence[OwnTerm]) -> dict[str, object]:
    """The entry of plan.json for a user's terms, if there are any."""
    return {"terms": [term.name for term in terms]} if terms else {}


def _tolerance(text: Tolerance | str) -> Tolerance:
    """The tolerance that a text gives. Raises InputError if it gives none."""
    if isinstance(text, Tolerance):
        return text
    as_one_of(text, str, "tolerance", "such as 2mm,1deg")
    try:
        return parse_tolerance(text)
    except ValueError as error:
        raise InputError(str(error), field="tolerance") from error


def _within(first_bead: int, toolpath: Toolpath) -> int:
    """The index of the first bead to print. Raises InputError if there is no such bead."""
    last = len(toolpath.beads) - 1
    if not 0 <= first_bead <= last:
        raise InputError(f"there is no bead {first_bead} to begin with", hint=f"a number from 0 to {last}")
    return first_bead


def _above_what_is_printed(problem: Problem, toolpath: Toolpath, first_bead: int) -> int:
    """The first bead to print, above what a scan found printed. Raises InputError if it is printed already."""
    printed = printed_beads(problem, toolpath)
    if first_bead == 0:
        return printed
    if 0 < first_bead < printed:
        reason = f"bead {first_bead} is printed already, according to as_printed"
        raise InputError(reason, hint=f"{printed} is the first above")
    return first_bead


Planned = tuple[PlanningContext, PlannedPaths, tuple[RollMap, ...]]  # what was planned, the plan, and its maps of roll


def _as_can_be(
    strategy: str,
    given: PlanningContext,
    print_of: Callable[..., Planned],
    stages: Stages,
    over: Spread | None,
) -> tuple[Planned, Nearer | None]:
    """The whole print, planned by `_as_clear_as_can_be`.

    If an upright nozzle has no way, one that leans within its cone is tried; if there is no way at the usual margin
    from the joint limits, one closer to them. Either is taken if that gives a verified plan. Raises Refusal.
    """
    try:
        return _as_clear_as_can_be(strategy, given, print_of, stages, over)
    except Refusal as refusal:
        leans = leaning(given, refusal, stages) if strategy == DEFAULT else None
        if leans is not None:
            with suppress(Refusal):  # other processes have the original tasks
                leant = print_of(leans)
                if leant[1].verified:
                    return leant, None
        nearer = nearer_to_ends(given, refusal, stages)
        if nearer is None:
            raise
        own, planned, maps = print_of(nearer)  # other processes have the usual margin
        if not planned.verified:
            raise
        return (noted(own, planned.paths[own.laid], refusal), planned, maps), None


def _as_clear_as_can_be(
    strategy: str,
    given: PlanningContext,
    print_of: Callable[..., Planned],
    stages: Stages,
    over: Spread | None,
) -> tuple[Planned, Nearer | None]:
    """The print planned with the usual clearance of nozzle and head, or the greatest one that gives a verified plan.

    It is reduced only if the usual one cannot be kept and the problem does not ask for it. Runs are shortened first if
    that helps. Raises Refusal.
    """
    refusal, found = None, None
    try:
        found = print_of(given, over)
    except Refusal as none:
        refusal = none
    if refusal is not None and strategy == DEFAULT and refusal.run is not None:
        short = with_short_runs(given, refusal, stages)
        if short is not None:
            with suppress(Refusal):  # other processes have the original runs
                found, given = print_of(short), short
    dips = "" if found is None else dips_in_a_run(found[1].trajectory, found[1].report)
    if dips and strategy == DEFAULT and may_be_short(given.problem):
        with suppress(Refusal):
            again = print_of(all_short(given, dips))
            found = again if again[1].verified else found
    stuck = found is None or lacks_clearance_only(found[1].report)
    if stuck and strategy not in UNAWARE and may_come_nearer(given.problem):
        because = "a plan with that comes too near" if refusal is None else str(refusal)
        ways = coming_nearer(given, because, stages, refusal)
        if refusal is not None and refusal.run is not None and strategy == DEFAULT and may_be_short(given.problem):
            ways = chain(ways, coming_nearer(all_short(given, refusal.reason), because, stages, refusal))
        for told, nearer in ways:
            try:  # other processes read the original problem
                again = print_of(nearer)
            except Refusal:
                continue
            if again[1].verified:
                return again, told
    if found is None:
        raise refusal or RuntimeError("no plan and no refusal")
    return found, None


def _planned(
    strategy: str,
    given: PlanningContext,
    dt: float,
    stages: Stages,
    shared: bool,
    over: Spread | None = None,
    rounds: int = ROUNDS,
    off: Array | None = None,
) -> Planned:
    """The plan of a strategy, for the default one the best of all strategies'. Raises Refusal.

    If a plan leaves its path between samples, it is sampled more finely and planned again, in so many rounds at most.

    off (beads): how far the previous round's plan is off, in tolerances
    """
    others, min_sigma = strategy == DEFAULT, given.problem.resolve.min_sigma

    def along(by: str, paths: Sequence[JointPath], stages: Stages) -> PlannedPaths:
        return PlannedPaths(by, paths, *_plan_along(paths, strategy, given, dt, stages, shared))

    def maps_of(planned: PlannedPaths) -> tuple[RollMap, ...]:
        return roll_maps(given.cell, planned.paths[given.laid], given.obstacles, min_sigma)

    own, refusal, mapped = None, None, None
    try:
        if others:
            given = with_way(given, stages)
        paths = _paths_of(strategy, given, stages, over)
        rest = paths[given.laid]
        with beside(shared, roll_maps, given.cell, rest, given.obstacles, min_sigma) as maps:
            own = along(strategy, paths, stages)
            with stages.stage("map"):
                mapped = maps()
    except Refusal as none:
        if not others or not leads_on(given, none):
            raise
        refusal = none
    if own is not None and rounds:
        finer = with_finer_samples(given, own.trajectory, own.report, off)
        if finer is not None and given.leans:
            finer = with_leans(finer, stages)
        if finer is not None:
            try:  # other processes have the original samples, so nothing is spread over them
                before = worst_off(own.trajectory, own.report)
                again = _planned(strategy, finer, dt, stages, shared, rounds=rounds - 1, off=before)
            except Refusal:
                again = None
            if again is not None and again[1].verified:
                return again
    best = own
    with stages.stage("compare"):
        if others:
            best = best_of_all(given, own, given.toolpath.waypoints, partial(along, stages=Stages()))
    if best is None:
        raise refusal or RuntimeError("no plan and no refusal")
    if best is not own or mapped is None:
        with stages.stage("map"):
            mapped = maps_of(best)
    return given, best, mapped


def _rest_of(strategy: str, whole: Planned, first_bead: int, dt: float, stages: Stages, shared: bool) -> Planned:
    """The rest of a print that was planned whole, along the same paths."""
    given, taken = replace(whole[0], first_bead=first_bead), whole[1]
    planned = PlannedPaths(taken.by, taken.paths, *_plan_along(taken.paths, strategy, given, dt, stages, shared))
    maps = roll_maps(given.cell, taken.paths[given.laid], given.obstacles, given.problem.resolve.min_sigma)
    return given, planned, maps


def _planned_in_pieces(strategy: str, given: PlanningContext, dt: float, stages: Stages, shared: bool) -> Planned:
    """As `_planned`, for the print as drawn, or with beads in pieces if that is refused or not verified."""
    drawn = given
    refusal, whole = None, None
    try:
        whole = _planned(strategy, given, dt, stages, shared)
    except Refusal as none:
        refusal = none
    for more_room in MORE_ROOM:
        if whole is not None and whole[1].verified:
            break
        with stages.stage("pieces"):
            cut = in_pieces(drawn, more_room)
        if cut is None:
            continue
        try:
            again = _planned(strategy, cut, dt, stages, shared)
        except Refusal:  # the refusal of the print as drawn is reported
            continue
        if whole is None or again[1].verified:
            whole = again
    if whole is None:
        raise refusal or RuntimeError("no plan and no refusal")
    return whole


def _paths_of(strategy: str, given: PlanningContext, stages: Stages, over: Spread | None = None) -> Sequence[JointPath]:
    """Paths of all beads by one strategy; the default's are those of the ladder, which are known, after refinement."""
    cell, tasks, settings, obstacles = given.cell, given.tasks, given.problem.resolve, given.obstacles
    with stages.stage("resolve"), given_back(given.toolpath.waypoints >= WORTH_HALVES):
        if strategy == "ladder" and given.start:
            return given.start
        if strategy != DEFAULT:
            return STRATEGIES[strategy](cell, tasks, settings, obstacles)
        if over is not None:
            return sqp_over(over, given)
        return refine_paths(cell, given.start, settings, obstacles, given.terms)


def _plan_along(
    paths: Sequence[JointPath], strategy: str, given: PlanningContext, dt: float, stages: Stages, second_process: bool
) -> tuple[Trajectory, Report, Sequence[Travel]]:
    """Time, join and verify the paths of all beads; the bound on the deposition time is added to the metrics.

    Travels are only those around beads that are laid.
    """
    problem, cell, toolpath = given.problem, given.cell, given.toolpath
    obstacles = NOTHING if strategy in UNAWARE else given.obstacles
    rest = paths[given.laid]
    large = toolpath.waypoints >= WORTH_HALVES
    with given_back(large):
        trajectory, travels = trajectory_of(problem, cell, toolpath, rest, obstacles, dt, second_process, stages)
    with stages.stage("verify"), given_back(large):
        report = verify(problem, cell, toolpath, trajectory, given.body)
    with stages.stage("dips"):
        moving = problem.process.hand_over == "motion"
        bounds = of_each(partial(bound_time, cell, moving=(moving, moving)), rest)
        bound = {"bound_deposition_time_s": sum(bounds)}
    return trajectory, replace(report, metrics=report.metrics | bound), travels


def _distance(given: PlanningContext, report: Report) -> dict[str, float]:
    """The lower bound of the deposition time over all choices, and a plan's gap to it, where the bound is computed."""
    tasks = given.tasks[given.laid]
    too_many = given.toolpath.waypoints > MOST_WAYPOINTS or len(given.cell.chosen) > MOST_CHOSEN
    if too_many or tasks[0].cones.tilt > 0.0:
        return {}
    bound = bound_any_path(given.cell, tasks)
    gap = max(report.metrics["deposition_time_s"] / bound - 1.0, 0.0)  # sampling rounds the time
    return {"bound_any_path_s": bound, "bound_gap_fraction": gap}


def _report_of(strategy: str, given: PlanningContext, dt: float) -> Report:
    """The verification report of a strategy's plan."""
    stages = Stages()
    return _plan_along(_paths_of(strategy, given, stages), strategy, given, dt, stages, False)[1]


def trajectory_of(
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    paths: Sequence[JointPath],
    obstacles: Obstacles,
    dt: float,
    second_process: bool,
    stages: Stages | None = None,
) -> tuple[Trajectory, Sequence[Travel]]:
    """Time the beads' paths and plan the travel between them, half of both in a second process if requested.

    Returns the trajectory, and the travels in it.
    """
    n, moving = len(paths), problem.process.hand_over == "motion"
    stages = stages or Stages()

    def part(first: int, last: int) -> list[TimedPath]:
        return [time_path(cell, path, (moving, moving), problem.resolve.timing) for path in paths[first:last]]

    def ways(first: int, last: int) -> list[Travel]:
        which = range(first, last + (last == n))  # the way home comes after the last bead
        return plan_travels(cell, timed, toolpath, problem.process, which, obstacles)

    done = np.cumsum([len(path.q) for path in paths])
    middle = 1 + int(np.searchsorted(done, 0.5 * done[-1]))
    with stages.stage("timing"):
        halves = chain.from_iterable(in_halves(part, n, second_process, middle))
        timed = [replace(each, path=path) for each, path in zip(halves, paths, strict=True)]  # no path twice in memory
        if done[-1] >= WORTH_HALVES:
            give_back()
    with stages.stage("travel"):
        travels = [each for half in in_halves(ways, n, second_process) for each in half]
        touching = contacts_within(problem.process, toolpath)
        if touching is not None:
            travels = with_rests(cell, timed, toolpath, problem.process, travels, obstacles, touching)
        trajectory = join(cell, toolpath, problem.process, timed, travels, dt, touching)
    return trajectory, travels


def _elsewhere(
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    paths: Sequence[JointPath],
    travels: Sequence[Travel],
    dt: float,
    body: PrintBody | None = None,
) -> Trajectory:
    """The trajectory in a cell whose part is displaced: paths are followed there, and travel is carried along.

    Travel that cannot be carried along is planned again. body: part and print as obstacles there, if travel planned
    again is to keep clear of them and of all bodies
    """
    process, moving = problem.process, problem.process.hand_over == "motion"
    timed = [time_path(cell, path, (moving, moving), problem.resolve.timing) for path in paths]
    touching = contacts_within(process, toolpath)
    carried = carried_travels(cell, travels, timed, toolpath, process)
    whole = [way for way in carried if way is not None]
    if len(whole) < len(carried):
        anew = [i for i, way in enumerate(carried) if way is None]
        obstacles = NOTHING if body is None else obstacles_of(problem, cell, toolpath, body)
        fresh = iter(plan_travels(cell, timed, toolpath, process, anew, obstacles))
        whole = [next(fresh) if way is None else way for way in carried]
        if touching is not None:
            whole = with_rests(cell, timed, toolpath, process, whole, obstacles, touching)
    return join(cell, toolpath, process, timed, whole, dt, touching)


def _robustness(
    tolerance: Tolerance,
    strategy: str,
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    paths: Sequence[JointPath],
    travels: Sequence[Travel],
    planned: Report,
    dt: float,
    second_process: bool,
) -> Robustness:
    """Judge the plan over a tolerance: the same choices along the beads, the same travel between them."""

    def again(elsewhere: Cell, followed: Sequence[JointPath]) -> Report:
        body = print_body(toolpath, standing(elsewhere))
        known = None if strategy in UNAWARE else body
        trajectory = _elsewhere(problem, elsewhere, toolpath, followed, travels, dt, known)
        return verify(problem, elsewhere, toolpath, trajectory, body)

    return assess_robustness(tolerance, problem, cell, toolpath, paths, planned, again, second_process)


@contextmanager
def _baseline_beside(
    wanted: bool, given: PlanningContext, dt: float, second_process: bool
) -> Iterator[Callable[[], dict[str, dict[str, float]]]]:
    """A function that gives the baseline's metrics by strategy, planned alongside the block if that is worth a process.

    It is for a large print, and on a first run, since the baseline's process then compiles what comes after the search.
    """
    if not wanted:
        yield dict
        return
    worth_it = second_process and (given.toolpath.waypoints >= WORTH_A_FORK or not was_compiled(fastest))
    with beside(worth_it, _baseline, given, dt) as wait:
        yield wait


def _baseline(given: PlanningContext, dt: float) -> dict[str, dict[str, float]]:
    """Metrics of the published way of moving; empty if it cannot be planned here."""
    try:
        return {BASELINE: _report_of(BASELINE, given, dt).metrics}
    except Refusal:
        return {BASELINE: {}}
