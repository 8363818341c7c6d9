"""Where should the part stand? A map of how well it can be printed from each place, and the best places, verified.

python -m planner.place hemisphere_honeycomb.yaml
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from planner.cell import build_cell
from planner.command import Command, add_problem, add_set, add_spread, add_strategy, exit_code
from planner.errors import EXIT_VERIFIED, OutputError
from planner.given import found_anywhere
from planner.output import results_folder
from planner.placement.chart import draw_map, number, words, write_table
from planner.placement.crew import Crew, Outcome, crew_of
from planner.placement.freedom import FREEDOMS, changed_fields, place_of
from planner.placement.ranges import axes_of
from planner.placement.site import Asked, site_of
from planner.placement.study import Study, study
from planner.problem import Problem, load_problem
from planner.problem.rewrite import write_changed
from planner.progress import Stages
from planner.spread import crew as spread_crew

MOST_SOLVED = 10
TABLE, PICTURE = "placement.csv", "placement.png"
METRICS = (  # of a verified plan, with their headings, factors and decimals
    ("sigma_min", "sigma", 1.0, 3),
    ("joint_limit_margin_deg", "limits deg", 1.0, 1),
    ("wrist_margin_deg", "wrist deg", 1.0, 1),
    ("at_speed_fraction", "at speed %", 100.0, 1),
    ("deposition_time_s", "deposition s", 1.0, 1),
)


def outcomes(found: Study, crew: Crew, tick: Callable[[], None]) -> list[Outcome]:
    """Solve and verify the problem where its part stands, and at the best places of a study, in that order."""
    rated = [(found.now, found.now_rating), *found.best]
    solved: list[Outcome] = crew("solve", [(place, rating.score) for place, rating in rated], tick)
    return solved


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
        asked = Asked(found_anywhere(problem), tuple(options.set), options.strategy, options.free, tuple(options.range))
        axes = axes_of(problem, cell, place_of(problem), options.free, options.range)
        beside = options.jobs > 1 or options.scheduler is not None
        # a folder that cannot be written, and a scheduler that does not answer, are told at once
        with results_folder(folder, lambda _: ()) as fresh, spread_crew(options.jobs, options.scheduler) as over:
            with stages.stage("toolpath"):
                site = site_of(asked, problem, cell, axes)
            crew = crew_of(asked, site, over, beside)
            found = study(site, crew, max(options.best, 1), stages.counted)
            write_table(found, fresh / TABLE)
            draw_map(found, f"{problem.name}: where it can be printed, and how well", fresh / PICTURE)
            solved: list[Outcome] = []
            if options.best:
                with stages.counted("solve", 1 + len(found.best)) as tick:
                    solved = outcomes(found, crew, tick)
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
            "my_part.yaml --jobs 4": "in four processes; the same result, sooner",
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
    add_spread(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) > MOST_SOLVED:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to {MOST_SOLVED}")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
