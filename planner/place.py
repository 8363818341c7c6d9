"""Where should the part stand? A map of how well it can be printed from each place, and the best places, verified.

python -m planner.place hemisphere_honeycomb.yaml
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.cell import Cell, build_cell
from planner.command import Command, add_problem, add_set, add_strategy, exit_code
from planner.errors import EXIT_VERIFIED, OutputError, Refusal
from planner.obstacles import NOTHING, obstacles_of
from planner.output import results_folder
from planner.placement.chart import draw_map, number, words, write_table
from planner.placement.freedom import FREEDOMS, Place, changed_fields, place_of
from planner.placement.ranges import axes_of
from planner.placement.rating import COMFORT
from planner.placement.study import Study, Surroundings, study
from planner.planning import try_out
from planner.problem import Problem, load_problem
from planner.problem.rewrite import write_changed
from planner.progress import Stages
from planner.resolve import UNAWARE
from planner.task import tasks_of
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath

MOST_SOLVED = 10
TABLE, PICTURE = "placement.csv", "placement.png"
METRICS = (  # of a verified plan, with their headings, factors and decimals
    ("sigma_min", "sigma", 1.0, 3),
    ("joint_limit_margin_deg", "limits deg", 1.0, 1),
    ("wrist_margin_deg", "wrist deg", 1.0, 1),
    ("at_speed_fraction", "at speed %", 100.0, 1),
    ("deposition_time_s", "deposition s", 1.0, 1),
)


@dataclass(frozen=True)
class Outcome:
    """What solving at a place came to: the plan's metrics, and why it is no plan to print, if it is none."""

    place: Place
    predicted: float
    metrics: dict[str, float]
    failure: str | None

    @property
    def score(self) -> float:
        """The placement's score as `rating` counts it, from the verified plan; 0 without one."""
        if self.failure is not None:
            return 0.0
        m = self.metrics
        limits, wrist = np.radians(m["joint_limit_margin_deg"]), np.radians(m.get("wrist_margin_deg", 180.0))
        least = float((np.array([m["sigma_min"], limits, wrist]) / COMFORT).min())
        return least * m["ideal_deposition_time_s"] / m["deposition_time_s"]


def surroundings(strategy: str, problem: Problem, cell: Cell, toolpath: Toolpath) -> Surroundings:
    """What a strategy keeps clear of while it prints a toolpath.

    On a bed, fixtures are points of the part's frame; where the part moves between them, these are found anew.
    """
    among = len(cell.holder) == 0 and len(cell.fixtures) > 0
    if strategy in UNAWARE:
        return Surroundings(NOTHING, lambda _: NOTHING)
    nearly = obstacles_of(problem, replace(cell, fixtures=()) if among else cell, toolpath)
    if among:
        return Surroundings(nearly, lambda moved: obstacles_of(problem, moved, toolpath))
    return Surroundings(nearly, nearly.of)


def outcomes(
    problem: Problem, overrides: Sequence[str], toolpath: Toolpath, found: Study, strategy: str, stages: Stages
) -> list[Outcome]:
    """Solve and verify the problem where its part stands, and at the best places of a study, in that order."""
    out = []
    places = [(found.now, found.now_rating.score), *((place, rating.score) for place, rating in found.best)]
    for i, (place, predicted) in enumerate(places):
        with stages.stage("present" if i == 0 else f"best {i}"):
            moved = load_problem(problem.file, [*overrides, *_settings(problem, place)])
            try:
                report = try_out(moved, toolpath, strategy, True)
            except Refusal as refusal:
                out.append(Outcome(place, predicted, {}, f"no plan: {refusal}"))
                continue
            failed = [check.name for check in report.checks if not check.ok]
            out.append(Outcome(place, predicted, report.metrics, f"not verified: {failed[0]}" if failed else None))
    return out


def _settings(problem: Problem, place: Place) -> list[str]:
    return [f"{field}={value}" for field, value in changed_fields(problem, place).items()]


def best_of(solved: Sequence[Outcome]) -> Outcome | None:
    """The best verified place, if it is better than the first, where the part stands."""
    best = max(solved, key=lambda outcome: outcome.score)
    return best if best.score > solved[0].score else None


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = place_command().parse_args(arguments)
    errors = Console(stderr=True, highlight=False)
    return exit_code(lambda: _run(options, errors), partial(errors.print, markup=False, soft_wrap=True))


def _run(options: argparse.Namespace, errors: Console) -> int:
    with Stages(None if options.quiet else errors) as stages:
        with stages.stage("load"):
            problem = load_problem(options.problem, options.set)
            cell = build_cell(problem)
        folder = options.out or Path("out") / f"{problem.name}_placement"
        target = folder / f"{problem.file.stem}_placed.yaml"
        if target.exists():  # before anything is computed
            raise OutputError(f"{target} is there already, and stays as it is: remove it, or choose another --out")
        now = place_of(problem)
        axes = axes_of(problem, cell, now, options.free, options.range)
        with results_folder(folder, lambda _: ()) as fresh:  # one that cannot be written is told at once
            with stages.stage("toolpath"):
                toolpath = build_toolpath(problem)
            strategy, tasks = options.strategy or problem.strategy, tasks_of(problem, toolpath)
            around = surroundings(strategy, problem, cell, toolpath)
            found = study(problem, cell, tasks, now, around, axes, strategy, max(options.best, 1), stages.counted)
            write_table(found, fresh / TABLE)
            draw_map(found, f"{problem.name}: where it can be printed, and how well", fresh / PICTURE)
            solved = outcomes(problem, options.set, toolpath, found, strategy, stages) if options.best else []
    names = [axis.name for axis in found.axes]
    out = Console(highlight=False, width=None if sys.stdout.isatty() else 160)
    out.print(table_of(problem, found, solved, names))
    print_words(out, options, found, solved)
    best = best_of(solved) if solved else None
    if best is not None:
        write_changed(problem, changed_fields(problem, best.place), target)
        out.print(f"best verified: {words(best.place, names)}; written as {target}", markup=False, soft_wrap=True)
    out.print(f"map: {folder / PICTURE}, {folder / TABLE}", markup=False, soft_wrap=True)
    return EXIT_VERIFIED


def print_words(out: Console, options: argparse.Namespace, found: Study, solved: Sequence[Outcome]) -> None:
    """Say what the table does not: failures, and what the written file does not have."""
    for i, outcome in enumerate(solved):
        if outcome.failure is not None:
            out.print(f"{'as it stands' if i == 0 else i}: {outcome.failure}", markup=False, soft_wrap=True)
    if solved and best_of(solved) is None:
        text = (
            "it stands well: no place that was tried is verified and better" if solved[0].score else "nothing written"
        )
        out.print(text, markup=False)
    if options.set and solved and best_of(solved) is not None:
        out.print("what --set changed was used here, but is not written into the file", markup=False)


def table_of(problem: Problem, found: Study, solved: Sequence[Outcome], names: Sequence[str]) -> Table:
    """The present place and the best ones: scores predicted and verified, and the metrics of each plan."""
    table = Table(title=f"{problem.name}: where the part stands", title_justify="left")
    table.add_column("")
    table.add_column(", ".join(names))
    for heading in ("possible", "score", *(heading for _, heading, _, _ in METRICS)):
        table.add_column(heading, justify="right")
    rows = [(found.now, found.now_rating.score), *((place, rating.score) for place, rating in found.best)]
    for i, (place, predicted) in enumerate(rows):
        cells = [
            "as it stands" if i == 0 else f"{i}",
            ", ".join(number(place, name) for name in names),
            f"{predicted:.2f}",
        ]
        if solved:
            outcome = solved[i]
            good = outcome.failure is None
            cells.append(f"{outcome.score:.2f}" if good else "none")
            cells += [
                f"{outcome.metrics[key] * factor:.{digits}f}" if key in outcome.metrics else ""
                for key, _, factor, digits in METRICS
            ]
        table.add_row(*cells)
    return table


def place_command() -> Command:
    """The parser of `python -m planner.place`."""
    parser = Command(
        "place",
        "Search for the place from which the part is printed best; solve and verify the best few.",
        {
            "hemisphere_honeycomb": "search x, y, z and turn of its bed; results in out/<problem>_placement",
            "my_part.yaml --best 0": "only the map: nothing is solved",
            "my_part.yaml --free x,y --range x=300:700": "only along the floor, x between 300 and 700 mm",
        },
        {
            0: "done; the best place, if it is better than the present one, is written as a problem file",
            2: "wrong input; nothing written",
            3: "no place reaches the whole part",
            130: "interrupted; nothing written",
        },
    )
    add_problem(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="where the results go (default out/<problem>_placement)"
    )
    parser.add_argument(
        "--best",
        type=_count,
        default=3,
        metavar="N",
        help="places that are solved and verified (default 3; 0: only the map)",
    )
    parser.add_argument(
        "--free",
        metavar="NAMES",
        help=f"what may change, of {','.join(FREEDOMS)}: x, y, z and turn of bed or table, part_x and part_y on a table "
        "(default x,y,z,turn on a bed, x,y,z of a table)",
    )
    parser.add_argument(
        "--range",
        action="append",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="between what, in mm or deg, e.g. x=300:700; repeatable (default: half the arm's reach to each side)",
    )
    add_strategy(parser)
    add_set(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) > MOST_SOLVED:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to {MOST_SOLVED}")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
