"""Strategies side by side on one problem: what each reaches, as verified, and how long it plans.

python -m benchmarks.strategies cylinder_logo --set layers.count=1

The default stands there with the reference solver of its quadratic programs (OSQP), and with the reference timing
(toppra, which limits no jerk and so is not verified), too.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from planner.base.errors import EXIT_VERIFIED, PlannerError, Refusal
from planner.base.progress import Stages
from planner.base.versions import versions
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
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


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strategies", description=__doc__)
    parser.add_argument("problem", nargs="?", default="cylinder_logo")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument(
        "--without", nargs="+", default=[], choices=STRATEGY_NAMES, metavar="STRATEGY",
        help="such as nlp, which takes minutes for a thousand samples",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    try:
        problem = load_problem(options.problem, options.set)
        started = time.strftime("%Y-%m-%d")
        table = Table(*COLUMNS, title=f"{problem.name} {' '.join(options.set)}".strip(), title_justify="left")
        for strategy in STRATEGY_NAMES:
            if strategy not in options.without:
                table.add_row(*row(strategy, problem, strategy))
        for reference in REFERENCES:
            variant = load_problem(options.problem, [*options.set, reference])
            table.add_row(*row(f"sqp, {reference.rpartition('=')[2]}", variant, "sqp"))
    except PlannerError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    Console(width=120).print(table)
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    print(f"{started}, {platform.machine()}, {os.cpu_count()} cores; {used}")
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
