"""How far the ladder's route can be from the best one on its fine grid: route price, lower bound, gap.

python -m benchmarks.bound cylinder_logo --set layers.count=1
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

from benchmarks.command import told
from planner.base.errors import EXIT_VERIFIED
from planner.cell.cell import build_cell
from planner.problem import load_problem
from planner.resolve.ladder import PIECE, ladder_route, lower_bound
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bound", description=__doc__)
    parser.add_argument("problem", nargs="?", default="cylinder_logo")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--piece", type=int, default=PIECE, help="rungs searched at once: more is tighter and larger")
    options = parser.parse_args(arguments)
    problem = load_problem(options.problem, options.set)
    cell = build_cell(problem)
    tasks = tasks_of(problem, build_toolpath(problem))
    ladder_route(cell, tasks, problem.resolve)  # compiles
    started = time.perf_counter()
    found = ladder_route(cell, tasks, problem.resolve)
    searched = time.perf_counter()
    bound = lower_bound(cell, found, problem.resolve.min_sigma, options.piece)
    ended = time.perf_counter()
    price = found.route.price
    ideal = float(found.demand.weight.sum())
    print(f"{problem.name} {' '.join(options.set)}".strip())
    print(f"route price   {price:10.3f} s, found in {searched - started:.2f} s")
    print(f"lower bound   {bound:10.3f} s, found in {ended - searched:.2f} s")
    print(
        f"gap           {price - bound:10.3f} s, {100 * (price - bound) / ideal:.2f} % of the time at commanded speed"
    )
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
