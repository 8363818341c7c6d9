"""The optimiser's figures in one run: strategies on the logo, the peers' cases, rates of search and refinement, scaling.

python -m benchmarks.optimiser [--logo OTHER.svg]

The whole run takes about as long as the largest size of the last part.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import peer_cases, scaling, strategies
from benchmarks.command import told
from benchmarks.run import whole_number
from benchmarks.usage import footer
from planner.base.errors import EXIT_VERIFIED
from planner.cell.cell import build_cell
from planner.problem import Problem, load_problem
from planner.resolve.ladder import coarse_nodes, ladder
from planner.resolve.search import best_route
from planner.resolve.sqp import refine_paths
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of

LAYER = ["layers.count=1"]
COMPARED = ("as_published", "fixed", "ladder", "sqp")
ROLLS = 36
CASES = 10_000  # waypoints of the peers' cases


def searched(waypoints: int) -> list[str]:
    """CPU time of the ladder's whole grid on the cap: all rolls and branches at each rung, then the search."""
    with tempfile.TemporaryDirectory() as folder:
        problem = load_problem(peer_cases.write_case("peer_cap", waypoints, Path(folder)))
        cell = build_cell(problem)
        tasks = tasks_of(problem, build_toolpath(problem))
    settings = problem.resolve.model_copy(update={"roll_step": 2.0 * math.pi / ROLLS})
    for _ in range(2):  # the first compiles
        start = time.process_time()
        demand, nodes = coarse_nodes(cell, tasks, settings)
        best_route(nodes, demand, cell.limits)
        seconds = time.process_time() - start
    rate = f"{waypoints / seconds:.0f} waypoints/s, {nodes.price.size / seconds / 1e6:.1f} million nodes/s"
    return [f"ladder, {waypoints} waypoints, {len(demand.rung)} rungs x {ROLLS} rolls x 8", rate]


def refined(problem: Problem) -> list[str]:
    """CPU time of refining the ladder's paths."""
    cell = build_cell(problem)
    tasks = tasks_of(problem, build_toolpath(problem))
    paths = ladder(cell, tasks, problem.resolve)
    refine_paths(cell, paths[:1], problem.resolve)
    start = time.process_time()
    refine_paths(cell, paths, problem.resolve)
    seconds = time.process_time() - start
    n = sum(len(task) for task in tasks)
    length = sum(float(task.s[-1] - task.s[0]) for task in tasks)
    rate = f"{n / seconds:.0f} samples/s, {length * 1e3 / seconds:.0f} mm/s"
    return [f"refinement of {problem.name}, {n} samples, {1e3 * length / n:.2f} mm apart", rate]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.optimiser", description=__doc__)
    parser.add_argument("--logo", type=Path, metavar="SVG", help="a drawing in place of the project's own, as well")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the logos' problem")
    parser.add_argument("--cases", type=whole_number, default=CASES, metavar="N", help="waypoints of the peers' cases")
    parser.add_argument(
        "--sizes", nargs="+", type=whole_number, default=list(scaling.SIZES), metavar="N", help="of scaling"
    )
    options = parser.parse_args(arguments)
    console = Console(width=150)
    chosen = [*LAYER, *options.set]
    logos = [load_problem("cylinder_logo", chosen)]
    if options.logo is not None:
        other = load_problem("cylinder_logo", [*chosen, f"layers.source.svg={options.logo.resolve()}"])
        logos.append(other.model_copy(update={"name": options.logo.stem}))
    for problem in logos:
        table = Table(*strategies.COLUMNS, title=f"{problem.name}, one layer", title_justify="left")
        for strategy in COMPARED:
            table.add_row(*strategies.row(strategy, problem, strategy))
        console.print(table)
    rates = Table("CPU time, all cores together", "rate")
    rates.add_row(*searched(options.cases))
    for problem in logos:
        rates.add_row(*refined(problem))
    console.print(rates)
    peer_cases.main(["--waypoints", f"{options.cases}", "--strategy", "sqp"])
    scaling.main(["--waypoints", *map(str, options.sizes)])
    print(footer())
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
