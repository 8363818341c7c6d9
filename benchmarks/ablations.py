"""What each idea of the optimiser buys: problems planned with it switched off, compared with everything on.

python -m benchmarks.ablations
python -m benchmarks.ablations --problems peer_cap --only "one window" "squared penalty" --coarse

Prints a Markdown table for each problem, which says how each idea was switched off. The rows go into a table of runs, as
those of benchmarks.run do; runs with a row of this commit are not repeated.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.command import parser_of
from benchmarks.ideas import FROZEN, HELD, IDEAS, NAMES, NOT_SWITCHED, Idea
from benchmarks.named import coarse, load_named
from benchmarks.report import cell, table
from benchmarks.rows import BETWEEN, Run, read_rows
from benchmarks.run import add_options, carry_out, ended
from benchmarks.single import beadwise
from benchmarks.summary import AT_SPEED, MARGIN, OVER_IDEAL, RESOLVE, SIGMA, WHOLE, Result, of_one_commit, results_of
from planner.base.command_line import one_of
from planner.base.errors import EXIT_VERIFIED

OUT = Path("out/benchmarks/ablations.csv")
# Layers that could start from each other, one long bead on a bed, a table that is free, a robot that holds the part.
PROBLEMS = ("cylinder_logo", "peer_cap@10000", "peer_cylinder", "fibre_bowl")
SETTINGS = {"cylinder_logo": ("layers.count=2",)}
MEASURES = (AT_SPEED, OVER_IDEAL, WHOLE, SIGMA, MARGIN, RESOLVE)


def grid(
    problems: Sequence[str], names: Sequence[str], settings: Sequence[str], repeats: int, quick: bool
) -> dict[str, list[tuple[Idea, list[Run]]]]:
    """The runs of each problem, by idea. Raises InputError for whatever is wrong with a problem or its settings."""
    planner = beadwise()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in problems:
            own = (*SETTINGS.get(name, ()), *settings)
            own = (*(coarse(load_named(name, own, Path(folder))) if quick else ()), *own)
            problem = load_named(name, own, Path(folder))
            found[name] = [
                (
                    idea,
                    [
                        Run(name, idea.strategy, _settings(name, own, idea), k, planner, idea.name)
                        for k in range(repeats)
                    ],
                )
                for idea in IDEAS
                if idea.name in names and idea.where(problem)
            ]
    return found


def _settings(name: str, own: Sequence[str], idea: Idea) -> tuple[str, ...]:
    """A problem's own settings and those of an idea there."""
    return (*own, *idea.settings, *(HELD.get(name, ()) if idea.name == FROZEN else ()))


def tables(runs: dict[str, list[tuple[Idea, list[Run]]]], results: Sequence[Result]) -> list[str]:
    """A table for each problem, and what could not be switched off."""
    lines = ["Medians, least and greatest of repeats in brackets; *slanted*: not all checks of the plan hold."]
    by = {(r.problem, r.set, r.strategy): r for r in results}
    for name, ideas in runs.items():
        rows = []
        for idea, own in ideas:
            result = by.get((own[0].problem, BETWEEN.join(own[0].settings), own[0].label))
            if result is None:  # of another commit: the program was changed meanwhile
                continue
            verdict = "yes" if result.verified else "no" if result.found else result.reason.partition(":")[0]
            rows.append([idea.name, idea.how, verdict, *(cell(result, measure) for measure in MEASURES)])
        lines += ["", " ".join([f"**{name}**", *ideas[0][1][0].settings]), ""]  # the first is everything on
        lines += table(("switched off", "how", "verified", *(measure.name for measure in MEASURES)), rows)
    return [*lines, "", "Not switched off:", "", *(f"- {text}" for text in NOT_SWITCHED)]


def _run(options: argparse.Namespace) -> int:
    names = [NAMES[0], *options.only]
    runs = grid(options.problems, names, options.set, options.repeat, options.coarse)
    carry_out([run for ideas in runs.values() for _, own in ideas for run in own], options)
    print("\n".join(tables(runs, results_of(of_one_commit(read_rows(options.out))[0]))))
    return EXIT_VERIFIED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    command = parser_of("ablations", __doc__)
    command.add_argument(
        "--problems", nargs="+", default=PROBLEMS, metavar="NAME", help=f"default: {', '.join(PROBLEMS)}"
    )
    command.add_argument(
        "--only", nargs="+", default=NAMES[1:], type=one_of(NAMES), metavar="IDEA", help=f"of {', '.join(NAMES[1:])}"
    )
    add_options(command, OUT)
    options = command.parse_args(arguments)
    return ended(lambda: _run(options), options.out)


if __name__ == "__main__":
    sys.exit(main())
