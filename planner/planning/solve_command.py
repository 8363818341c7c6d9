"""Solve a problem: from its file to a verified plan in a folder, on the command line.

python -m planner.solve cylinder_logo.yaml
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from planner.base.command_line import exit_code
from planner.base.distribution import crew
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, Hints, Refusal
from planner.base.progress import Stages
from planner.base.results import results_folder
from planner.base.signals import no_more_interruptions
from planner.cell.cell import build_cell
from planner.export.languages import chosen
from planner.export.plan_json import file_as_given
from planner.export.write import PLAN, forecast_words, program_notes, write_refusal
from planner.plan import resumed_name
from planner.planning.files import RESULTS_BY, write_files
from planner.planning.options import options_of
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.describe import print_shipped
from planner.report import page as libraries
from planner.report.failure import write_failure_report
from planner.report.summary import print_summary
from planner.toolpath.build import build_toolpath
from planner.verify.drawing import cell_view

HEAD = 4096  # characters of plan.json, whose first keys name the problem and its file
_FILE = re.compile(r'^ "problem_file": (".*"),$', re.MULTILINE)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = options_of(arguments)
    errors = Console(stderr=True, highlight=False)
    if options.list:
        print_shipped()
        return EXIT_VERIFIED
    return exit_code(lambda: _run(options, errors), partial(errors.print, markup=False, soft_wrap=True), at_once=True)


def _run(options: argparse.Namespace, errors: Console) -> int:
    told: list[str] = []
    with Stages(None if options.quiet else errors) as stages:
        with stages.stage("load"):
            problem = load_problem(options.problem, options.set)
        strategy = options.strategy or problem.strategy
        folder = options.out or Path("out") / resumed_name(problem.name, options.from_bead)
        if options.out is None and (other := plan_of_another(folder, problem)):
            words = f"note: {folder} holds the plan of {other}; the results of this run will replace it: --out names another folder"
            errors.print(words, markup=False, soft_wrap=True)
        # first of all, so that a folder that cannot be written or a scheduler that does not answer is reported at once
        with results_folder(folder, RESULTS_BY, told.append) as fresh, crew(options.jobs, options.scheduler) as over:
            libraries.begin()  # one core is idle before the search
            hints: Hints | None = None
            shared = over if options.jobs > 1 or options.scheduler is not None else None
            try:
                plan = solve(
                    problem, strategy, options.dt, stages, True, options.tolerance, options.from_bead, over=shared
                )
            except Refusal as refusal:
                errors.print(f"no plan: {refusal}", markup=False, soft_wrap=True)
                with stages.stage("hints"):  # computed on first access, which may take longer than everything else
                    hints = refusal.hints
                write_refusal(problem, strategy, refusal, fresh)
                report_refusal(problem, strategy, refusal, fresh / "report.html")
            else:
                plan = write_files(plan, fresh, stages, second_process=True)
    no_more_interruptions()  # an interruption would report that nothing was written
    for sentence in told:
        errors.print(f"note: {sentence}", markup=False, soft_wrap=True)
    if hints is not None:
        for hint in hints:
            errors.print(f"try: {hint}", markup=False, soft_wrap=True)
        errors.print(f"see {folder / 'report.html'}", markup=False, soft_wrap=True)
        return EXIT_NOT_VERIFIED
    print_summary(plan, folder, chosen(plan).words, program_notes(plan, folder), forecast_words(folder))
    return EXIT_VERIFIED if plan.verified else EXIT_NOT_VERIFIED


def plan_of_another(folder: Path, problem: Problem) -> str:
    """The problem file whose plan is in a folder, as a path from here; empty if it is this one's, or none."""
    try:
        with (folder / PLAN).open(encoding="utf-8", errors="replace") as stream:
            found = _FILE.search(stream.read(HEAD))
        other = "" if found is None else str(json.loads(found[1]))
        same = other == file_as_given(problem) or Path(other).resolve() == problem.file.resolve()
    except (OSError, ValueError):  # not one of our files
        return ""
    return "" if same else other


def report_refusal(problem: Problem, strategy: str, refusal: Refusal, path: Path) -> None:
    """Write the report of a refusal: it shows the beads, and the place of the refusal among them."""
    cell = build_cell(problem)
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
        cell=cell,
        view=cell_view(cell),
        posture=refusal.posture,
    )
