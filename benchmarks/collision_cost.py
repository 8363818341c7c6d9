"""What clearance costs in planning: CPU time of each stage with all collision bodies, and with none.

python -m benchmarks.collision_cost [PROBLEM ...] [--set layers.count=1]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from planner.base.errors import EXIT_VERIFIED
from planner.cell.cell import build_cell
from planner.collision.scene import NOTHING, Obstacles, obstacles_of
from planner.motion.timing.timed_path import time_path
from planner.motion.travel.plan import plan_travels
from planner.problem import Problem, load_problem
from planner.resolve.by_nozzle import nozzles_of
from planner.resolve.ladder import ladder
from planner.resolve.sqp import refine_paths
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of

PROBLEMS = ("cylinder_logo", "naca0015_wing", "fibre_bowl", "curved_plate")
COLUMNS = ("problem", "obstacles", "ladder", "refinement", "timing", "travel", "together", "times", "least margin")
Value = TypeVar("Value")


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """What a piece of work returns, and the CPU time that it takes [s]."""
    start = time.process_time()
    out = work()
    return out, time.process_time() - start


def seconds(problem: Problem, aware: bool) -> tuple[list[float], float]:
    """CPU time [s] of obstacles, ladder, refinement, timing, travel; and the least margin of clearance in beads [mm]."""
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    tasks = tasks_of(problem, toolpath)
    everything, building = timed(lambda: obstacles_of(problem, cell, toolpath))
    obstacles: Obstacles = everything if aware else NOTHING
    given, searching = timed(lambda: ladder(cell, tasks, problem.resolve, obstacles))
    paths, refining = timed(lambda: refine_paths(cell, given, problem.resolve, obstacles))
    moving = problem.process.hand_over == "motion"
    motions, timing = timed(lambda: [time_path(cell, path, (moving, moving)) for path in paths])
    _, travelling = timed(lambda: plan_travels(cell, motions, toolpath, problem.process, None, obstacles))
    least = min(
        float(everything.for_nozzle(cell, own).margins(paths[i].q, paths[i].task.moments, 0.05)[0].min())
        for own, which in nozzles_of(cell, paths)
        for i in which
    )
    return [building if aware else 0.0, searching, refining, timing, travelling], 1e3 * least


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.collision_cost", description=__doc__)
    parser.add_argument("problems", nargs="*", default=PROBLEMS, metavar="PROBLEM")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS, title="CPU time in s: with obstacles / without", title_justify="left")
    for name in options.problems:
        problem = load_problem(name, options.set)
        seconds(problem, True)  # compiles
        (own, least), (bare, _) = seconds(problem, True), seconds(problem, False)
        cells = [f"{a:.2f} / {b:.2f}" for a, b in zip(own, bare, strict=True)]
        together = f"{sum(own):.2f} / {sum(bare):.2f}"
        table.add_row(name, *cells, together, f"{sum(own) / sum(bare):.2f}", f"{least:.2f} mm")
    Console(width=170).print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
