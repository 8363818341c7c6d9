"""Strategies side by side on one problem: the verified result of each, and its planning time.

python -m benchmarks.strategies cylinder_logo --set layers.count=1
python -m benchmarks.strategies --all

The default is also run with the reference solver for its quadratic programs (OSQP), and with the reference timing (toppra,
which does not limit jerk and so is not verified).

With --all, a quick look at every shipped problem, with a coarse search and one layer where the file sets a layer count: the
share of the length at speed for each strategy except nlp, in Markdown.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from benchmarks.named import coarse
from benchmarks.usage import footer
from planner.base.errors import EXIT_VERIFIED, Refusal
from planner.base.progress import Stages
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem, shipped_problems
from planner.problem.settings import STRATEGY_NAMES

COLUMNS = (
    "strategy",
    "verified",
    "at speed",
    "deposition / ideal",
    "print s",
    "σ min",
    "limit margin °",
    "resolve s",
    "timing s",
)

REFERENCES = ("resolve.qp=osqp", "resolve.timing=toppra")


def row(label: str, problem: Problem, strategy: str) -> list[str]:
    """Plan once to compile, once to measure; one line of the table."""
    try:
        solve(problem, strategy)
        stages = Stages()
        plan = solve(problem, strategy, stages=stages)
    except Refusal as refusal:
        return [label, f"no plan: {refusal}", *[""] * (len(COLUMNS) - 2)]
    m = plan.metrics
    return [
        label,
        "yes" if plan.verified else "no",
        f"{100 * m['at_speed_fraction']:.1f} %",
        f"{m['deposition_time_s'] / m['ideal_deposition_time_s']:.3f}",
        f"{m['print_time_s']:.1f}",
        f"{m['sigma_min']:.3f}",
        f"{m['joint_limit_margin_deg']:.1f}",
        f"{stages.seconds['resolve']:.2f}",
        f"{stages.seconds['timing']:.2f}",
    ]


def overview(strategies: Sequence[str], settings: Sequence[str]) -> Iterator[str]:
    """Lines of a table of all problems that ship: the way that as_published follows, and the share at speed by each strategy."""
    yield f"| problem | published way | {' | '.join(f'`{name}`' for name in strategies)} |"
    yield "|---|---|" + "---|" * len(strategies)
    for name in shipped_problems():
        problem = load_problem(name, (*coarse(load_problem(name)), *settings))
        cells = [at_speed(problem, strategy) for strategy in strategies]
        yield f"| {name} | `{problem.resolve.published}` | {' | '.join(cells)} |"


def at_speed(problem: Problem, strategy: str) -> str:
    """The share of the length at speed, and whether the plan is verified, if there is one."""
    try:
        plan = solve(problem, strategy, baseline=False)
    except Refusal:
        return "no plan"
    return f"{100 * plan.metrics['at_speed_fraction']:.1f} %" + ("" if plan.verified else ", not verified")


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strategies", description=__doc__)
    parser.add_argument("problem", nargs="?", default="cylinder_logo")
    parser.add_argument("--all", action="store_true", help="a quick look at every problem that ships")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument(
        "--without", nargs="+", default=[], choices=STRATEGY_NAMES, metavar="STRATEGY",
        help="such as nlp, which takes minutes for a thousand samples",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    if options.all:
        compared = [name for name in STRATEGY_NAMES if name not in ("nlp", *options.without)]
        for line in overview(compared, options.set):
            print(line, flush=True)
        print(f"\n{footer()}")
        return EXIT_VERIFIED
    problem = load_problem(options.problem, options.set)
    table = Table(*COLUMNS, title=f"{problem.name} {' '.join(options.set)}".strip(), title_justify="left")
    for strategy in STRATEGY_NAMES:
        if strategy not in options.without:
            table.add_row(*row(strategy, problem, strategy))
    for reference in REFERENCES:
        variant = load_problem(options.problem, [*options.set, reference])
        table.add_row(*row(f"sqp, {reference.rpartition('=')[2]}", variant, "sqp"))
    Console(width=120).print(table)
    print(footer())
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
