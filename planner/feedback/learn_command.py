"""Corrects a program by the recording of its run: the next program compensates what the robot left out.

python -m planner.feedback.learn cylinder_logo run.csv
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.spatial import cKDTree

from planner.base.arrays import Ints
from planner.base.command_line import Command, exit_code, number_within
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError
from planner.base.progress import Stages
from planner.base.results import results_folder
from planner.base.signals import no_more_interruptions
from planner.export.controllers import CONTROLLERS, ControllerLimits
from planner.export.forecast import close_moves
from planner.export.languages import LANGUAGES, chosen
from planner.export.player.executed import executed_run
from planner.export.player.play import play
from planner.export.write import forecast_words, program_notes
from planner.feedback.learn_fit import (
    Lessons,
    RunErrors,
    errors_of,
    evened,
    evened_around,
    less_around,
    most_bent,
    next_lessons,
)
from planner.feedback.learn_telling import (
    CORRECTIONS,
    PICTURE,
    next_lines,
    next_name,
    off_words,
    read_lessons,
    run_lines,
    run_of,
    write_lessons,
    write_picture,
    write_problem,
)
from planner.feedback.learn_track import recorded_way, way_along
from planner.feedback.planned import check_as_planned, planned_problem, planned_with
from planner.feedback.recordings import add_recording, read_log
from planner.motion.as_run import Corrections, asked_of, asked_trajectory, corrections_of
from planner.plan import Check, Plan
from planner.plan.seal import sealed
from planner.planning.clearance import as_near
from planner.planning.context import check_unchanged
from planner.planning.files import REPEATED, as_it_is, write_files
from planner.planning.files import RESULTS_BY as PLANNED_BY
from planner.planning.options import add_set, add_strategy
from planner.planning.pipeline import solve, with_asked
from planner.problem import load_problem
from planner.problem.as_run import AsRunSpec
from planner.problem.rewrite import absolute_overrides
from planner.problem.yaml_file import Override
from planner.report.summary import print_summary

RESULTS_BY = "learn"  # the command that owns the files, in manifests
WRITTEN = ("as_run", "name")  # keys for which the new problem file counts, not earlier overrides
MOST = 1e-3  # m: default for how far off the plan a program's positions may be
TRIES = 12  # attempts with smoother corrections, and as many with smaller ones, until they hold
SMOOTHER = 0.6  # factor on the permitted bend of a bead's corrections from try to try
FORETOLD = 3  # forecast runs
TOO_NOISY = 0.5e-3  # m, standard deviation of a recorded tip: with more, corrections would be noise
LEAST_KNOWN = 10  # samples on beads that a recording must show
EVENED = 3e-3  # m of bead to either side of a line that would be too quick: corrections are smoothed there
AROUND = 10e-3  # m of bead to either side of an unsafe place: corrections are reduced there


@dataclass(frozen=True)
class Learned:
    """A plan whose program is corrected, unless its checks failed; the lessons of the runs, with the corrections it
    uses, and how often these were smoothed."""

    plan: Plan
    lessons: Lessons
    smoothed: int
    failed: tuple[Check, ...]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = learn_command().parse_args(arguments)
    return exit_code(partial(_run, options), partial(print, file=sys.stderr), "no program was written")


def _run(options: argparse.Namespace) -> int:
    with Stages(None if options.quiet else Console(stderr=True, highlight=False)) as stages:
        plan = ran_plan(options.plan, options.set, options.strategy, stages)
        problem = plan.problem
        most = options.most or (MOST if problem.as_run is None else problem.as_run.most)
        if options.forecast:
            learned, errors = foretold(plan, most, stages)
            name, run = next_name(problem, 1), 0
        else:
            learned, errors = _recorded(plan, options, most, stages)
            name, run = next_name(problem), run_of(problem)
        if learned.failed:
            print(f"no safe program: {in_words(learned.failed)}", file=sys.stderr)
            return EXIT_NOT_VERIFIED
        folder = options.out or Path("out") / name
        target = folder / f"{name}.yaml"
        with results_folder(folder, RESULTS_BY) as fresh:
            write_lessons(learned.lessons, plan, errors, fresh / CORRECTIONS)
            write_picture(plan, errors, learned.lessons.corrections, run, fresh / PICTURE)
            text = write_problem(problem, name, most, folder)
            check_unchanged(problem, as_near(problem.changed(()), plan.nearer))
            (fresh / target.name).write_text(text, encoding="utf-8")
        problem = load_problem(target, [each for each in absolute_overrides(problem) if each.path[0] not in WRITTEN])
        settings = learned.plan.settings | {"overrides": list(problem.overrides)}
        done = sealed(replace(learned.plan, problem=problem, settings=settings))
        with ExitStack() as unless_done:
            told = f"{target} and its {CORRECTIONS} are there, their program is not"
            unless_done.callback(print, told, file=sys.stderr)
            with results_folder(folder, PLANNED_BY) as fresh:
                done = write_files(done, fresh, stages)
            unless_done.pop_all()
    no_more_interruptions()  # an interruption would now report that no program was written
    print_summary(done, folder, chosen(done).words, program_notes(done, folder), forecast_words(folder))
    return EXIT_VERIFIED if done.verified else EXIT_NOT_VERIFIED


def _recorded(plan: Plan, options: argparse.Namespace, most: float, stages: Stages) -> tuple[Learned, RunErrors]:
    """Learn from a recording, and report it."""
    problem, language = plan.problem, language_of(plan)
    way = recorded_way(plan, read_log(options.log, plan.cell, options.columns, options.topic), language)
    errors = errors_of(plan.trajectory, way)
    if np.count_nonzero(errors.known) < LEAST_KNOWN:
        raise InputError("gaps leave nothing of any bead", file=options.log, hint="record all joints all the time")
    if errors.noise > TOO_NOISY:
        reason = f"too noisy: the recorded tip scatters by {1e3 * errors.noise:.2f} mm"
        raise InputError(
            reason,
            file=options.log,
            hint=f"{1e3 * TOO_NOISY:g} mm at most; record all joints at the same instant, with more digits",
        )
    print("\n".join(run_lines(plan, way, errors, run_of(problem))), flush=True)
    corrections = corrections_of(problem, plan.toolpath)
    before = None if corrections is None else read_lessons(problem, corrections)
    wanted = next_lessons(plan.trajectory, errors, before, most)
    learned = learned_plan(plan, wanted, errors, most, language, stages)
    shown = np.unique(plan.trajectory.bead[errors.known]).astype(np.int64)
    print("\n".join(next_lines(learned.lessons, before, shown, learned.smoothed)), flush=True)
    return learned, errors


def foretold(plan: Plan, most: float, stages: Stages) -> tuple[Learned, RunErrors]:
    """Learn from forecast runs by the model of the controller, and report it; returns the errors of the first run too.

    Real runs start afresh from the resulting corrections, as if nothing had been learnt yet. Raises InputError for a
    plan whose program is already corrected.
    """
    if plan.problem.as_run is not None:
        reason = f"{plan.name} is corrected by as_run already"
        raise InputError(reason, field="--forecast", hint="the recording of its run, or the problem without as_run")
    language = language_of(plan)
    controller = controller_of(plan, language)
    assumed = ", an assumed one" if len(controller.motion.assumed) > 1 else ""
    print(f"by the model of {controller.title}{assumed}, without a recording:")
    learned, lessons, first = None, None, None
    for run in range(FORETOLD + 1):
        now = plan if learned is None else learned.plan
        with stages.stage("forecast"):
            program = LANGUAGES[language].program(now, LANGUAGES[language].write(now))
            cell = LANGUAGES[language].plan(now).cell
            done = executed_run(program, play(program, cell, controller.motion), controller.motion)
            way = way_along(plan, cell, done.t, done.q)
        errors = errors_of(plan.trajectory, way)
        first = first or errors
        what = f"taught by {run} of {FORETOLD} such runs" if run else "as it is planned"
        print(f"{what}: {off_words(errors)}", flush=True)
        if run == FORETOLD:
            break
        lessons = next_lessons(plan.trajectory, errors, lessons, most)
        tried = learned_plan(plan, lessons, errors, most, language, stages)
        if tried.failed and learned is not None:
            print(f"what that would teach next is not safe, and is left out: {in_words(tried.failed)}", flush=True)
            break
        learned = tried
        if learned.failed:
            break
        lessons = learned.lessons
    if learned is None or first is None:
        raise RuntimeError("no run was foretold")
    own = learned.lessons
    untaught = Lessons(own.corrections, np.zeros_like(own.best), np.zeros_like(own.left), np.zeros_like(own.gain))
    return replace(learned, lessons=untaught), first


def ran_plan(given: str, overrides: Sequence[str | Override], strategy: str | None, stages: Stages) -> Plan:
    """The plan whose program was run: as saved, or planned again as before, except for overrides and strategy.

    Raises InputError if the plan is not verified, if a saved plan's problem or robots have changed since, or the
    problem of results has; and Refusal if there is no plan.
    """
    problem, plan = planned_problem(given)
    check_as_planned(given, problem)
    if plan is None or overrides or strategy:
        made, changed = planned_with(given, plan), problem.changed(overrides)
        own = made.strategy if changed.strategy == problem.strategy else None
        plan = solve(
            changed,
            strategy or own,
            made.dt,
            stages,
            second_process=True,
            first_bead=made.first_bead,
            baseline=False,
        )
    else:
        plan = as_it_is(replace(plan, problem=as_near(problem, plan.nearer)), stages)
    if not plan.verified:
        reason = f"the plan is not verified, so that no program of it was written: {in_words(plan.checks)}"
        raise InputError(reason, file=given)
    return plan


def language_of(plan: Plan) -> str:
    """The language of the arm's program. Raises InputError for one whose controller does not plan lines itself, and for
    a print with several nozzles."""
    if plan.cell.nozzles:
        raise plan.problem.error("cell.nozzles", "only runs of prints with one nozzle can be learnt from")
    found = [name for name in chosen(plan).names if name in CONTROLLERS]
    if not found:
        reason = f"no program of lines is written for {plan.cell.arm_robot.name}: {chosen(plan).words}"
        raise InputError(reason, hint=f"program.languages: one of {', '.join(CONTROLLERS)}")
    return found[0]


def controller_of(plan: Plan, language: str) -> ControllerLimits:
    """The controller of a plan's arm, with the values measured in its robot's file, if any."""
    return CONTROLLERS[language].measured(plan.cell.arm_robot.controller)


def learned_plan(
    plan: Plan, lessons: Lessons, errors: RunErrors, most: float, language: str, stages: Stages
) -> Learned:
    """The plan with a corrected program: with as much of the corrections as is safe, and as lines can follow, with no
    more of them too quick than in the uncorrected program."""
    failed: tuple[Check, ...] = ()
    corrections = lessons.corrections
    smoothed, smaller, bend = 0, 0, most_bent(corrections, len(plan.toolpath.beads))
    usual = len(_hasty(replace(plan, asked=None), language))
    laid = np.unique(plan.trajectory.bead[plan.trajectory.deposit]).astype(np.int64)
    with tempfile.TemporaryDirectory() as folder:
        spec = AsRunSpec.model_construct(corrections=Path(folder) / CORRECTIONS, most=most)
        plan = replace(plan, problem=plan.problem.model_copy(update={"as_run": spec}))
        while max(smoothed, smaller) < TRIES:
            write_lessons(replace(lessons, corrections=corrections), plan, errors, spec.corrections)
            with stages.stage("export"):
                asked = replace(plan, asked=asked_of(plan.problem, plan.cell, plan.toolpath, plan.trajectory))
                differences = _differences(asked, language)
                beads = _not_followed(plan, corrections, laid, language) if differences else None
            if beads is not None:
                failed = (Check(REPEATED, 1.0, 0.0, "programs that do not", False, "; ".join(differences)),)
                bend[beads] *= SMOOTHER
                own = np.isin(corrections.bead, beads)
                corrections = evened(corrections, np.where(own, bend[corrections.bead], np.inf))
                smoothed += 1
                continue
            hasty = _hasty(asked, language)
            if len(hasty) > usual and smoothed < TRIES - 1:
                for sample in hasty:
                    corrections = evened_around(corrections, *_place(plan, sample), EVENED)
                smoothed += 1
                continue
            asked = with_asked(plan, stages)
            failed = tuple(check for check in asked.checks if not check.ok)
            if not failed:
                return Learned(asked, replace(lessons, corrections=corrections), smoothed, ())
            for check in failed:
                corrections = less_around(corrections, *_place(plan, check.sample), AROUND)
            smaller += 1
    return Learned(plan, replace(lessons, corrections=corrections), smoothed, failed)


def _differences(plan: Plan, language: str) -> list[str]:
    """How a plan's program differs from the plan, if it does."""
    return LANGUAGES[language].differences(plan, LANGUAGES[language].write(plan))


def _not_followed(plan: Plan, corrections: Corrections, beads: Ints, language: str) -> Ints:
    """The beads whose corrections alone make the program differ from its plan; all of the given ones if none does."""
    if len(beads) < 2:
        return beads
    found = []
    for half in np.array_split(beads, 2):
        own = np.isin(corrections.bead, half)[:, None] * corrections.shift
        asked = asked_trajectory(plan.cell, plan.trajectory, Corrections(corrections.bead, corrections.s, own))
        if _differences(replace(plan, asked=asked), language):
            found.append(_not_followed(plan, corrections, half, language))
    return np.concatenate(found) if found else beads


def _hasty(plan: Plan, language: str) -> list[int]:
    """Samples at the ends of moves on beads that take less time than the controller is known to need."""
    own = LANGUAGES[language].write(plan)
    program, cell = LANGUAGES[language].program(plan, own), LANGUAGES[language].plan(plan).cell
    controller = controller_of(plan, language)
    close = close_moves(play(program, cell, controller.motion), controller)
    tip = (plan.asked or plan.trajectory).tip
    return np.unique(cKDTree(tip).query(program.position[close])[1]).tolist()


def _place(plan: Plan, sample: int) -> tuple[int, float]:
    """Bead and arc length [m] of a sample of the plan; in travel, of the sample nearest in time that lays material."""
    t = plan.trajectory
    laid = np.flatnonzero(t.deposit)
    k = laid[int(np.argmin(np.abs(laid - sample)))]
    return int(t.bead[k]), float(t.s[k])


def in_words(checks: Sequence[Check]) -> str:
    """The failed checks, each with its worst value and place."""
    failed = [check for check in checks if not check.ok]
    return "; ".join(f"{check.name}: {check.worst:.4g} {check.worst_unit}, {check.where}" for check in failed)


def learn_command() -> Command:
    """The parser of `python -m planner.feedback.learn`."""
    parser = Command(
        "feedback.learn",
        "Make the robot keep to its plan: find where a run of a program departed from it, in a recording of the joints, and write the "
        "program that asks for what was left out.",
        {
            "cylinder_logo run.csv": "the program of the second run in out/cylinder_logo_run_2",
            "out/cylinder_logo_run_2 run2.csv": "that of the third",
            "my_part.yaml run.csv --most-mm 0.5": "ask for no place farther from the plan than that",
            "my_part.yaml --forecast": "a program for the first run, from what the controller's model predicts",
        },
        {
            0: "verified plan and corrected program written",
            2: "wrong input, or a recording of something else; nothing written",
            3: "no plan, or no corrected program that is safe; nothing written",
            130: "interrupted",
        },
    )
    parser.add_argument(
        "plan",
        metavar="PLAN",
        help="what was run: a plan that was saved, a folder of results, a problem file or a shipped one's name",
    )
    given = parser.add_mutually_exclusive_group(required=True)
    given.add_argument(
        "log",
        type=Path,
        nargs="?",
        metavar="LOG",
        help="the recording: CSV with time and joints, or a ROS bag (see the documentation)",
    )
    given.add_argument(
        "--forecast", action="store_true", help="without a recording, from what the controller's model predicts"
    )
    add_recording(parser)
    parser.add_argument(
        "--most-mm",
        dest="most",
        type=_millimetres,
        metavar="MM",
        help="how far from the plan a program may ask for places (default: 1, or as in earlier runs)",
    )
    add_set(parser)
    add_strategy(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: out/<problem>_run_<number>")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


def _millimetres(text: str) -> float:
    return number_within(text, 0.01, 5.0, "a length in mm") * 1e-3
