"""How good the timing is: every problem's deposition time against two bounds, its limits, flow and cost.

python -m benchmarks.timing cylinder_logo peer_cap --set process.speed_mm_s=30

The bounds on the deposition time are length / commanded speed, and the time-optimal profile of the same joint paths
without jerk limits. Dips and the flow error over a millimetre of a bead are the plan's own.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.command import parser_of, told
from benchmarks.usage import footer
from planner.base.errors import EXIT_VERIFIED, Refusal
from planner.cell.cell import Cell, build_cell
from planner.motion.timing.timed_path import TimedPath, bound_time, time_path
from planner.planning.options import DEFAULT_DT
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem, shipped_problems
from planner.resolve.joint_path import JointPath
from planner.toolpath.task import NozzleTask

LENGTHS = (1_000, 10_000, 100_000)  # trajectory samples of one path, to see whether cost is linear
REPEATS = 3  # of which the least counts: the machine may be shared
# A long path of the arm near its home: each joint a sum of two waves, some of which are too quick for the limits.
WAVES = ((0.11, 0.05), (0.023, 0.004))  # m, rad
SPEED, SPACING, RUN = 0.04, 1e-3, 3e-3  # m/s, m between its samples, m of run-in and run-out
COLUMNS = (
    "problem", "verified", "deposition s", "x length/speed", "x v/a optimum", "at speed", "v", "a", "jerk",
    "print s", "dips", "us/sample", "flow error/mm",
)  # fmt: skip


def measure_timing(cell: Cell, paths: Sequence[JointPath]) -> tuple[list[TimedPath], float]:
    """These paths timed, and how much CPU time that takes for a trajectory sample [s]."""
    least = math.inf
    for _ in range(REPEATS):
        start = time.process_time()
        timed = [time_path(cell, path) for path in paths]
        least = min(least, time.process_time() - start)
    return timed, least * DEFAULT_DT / sum(each.duration for each in timed)


def deposition_time(timed: Sequence[TimedPath]) -> float:
    """From the start to the end of each bead without its rests, to the instant: samples would round it [s]."""
    tasks = [each.path.task for each in timed]
    return sum(
        each.when(float(task.s[task.last]))
        - each.when(float(task.s[task.first]))
        - sum(last - first for first, last in each.rests)
        for each, task in zip(timed, tasks, strict=True)
    )


def row(problem: Problem) -> list[str]:
    """One line of the table."""
    try:
        plan = solve(problem)
    except Refusal as refusal:
        return [problem.name, f"no plan: {refusal}", *[""] * (len(COLUMNS) - 2)]
    m = plan.metrics
    bound = sum(bound_time(plan.cell, path) for path in plan.paths)
    timed, cost = measure_timing(plan.cell, plan.paths)
    deposition = deposition_time(timed)
    return [
        problem.name,
        "yes" if plan.verified else "no: " + ", ".join(check.name for check in plan.checks if not check.ok),
        f"{deposition:.3f}",
        f"{deposition / m['ideal_deposition_time_s']:.4f}",
        f"{deposition / bound:.4f}",
        f"{100.0 * m['at_speed_fraction']:.2f} %",
        *(f"{m[f'{name}_ratio_max']:.3f}" for name in ("velocity", "acceleration", "jerk")),
        f"{m['print_time_s']:.1f}",
        f"{len(plan.dips)}",
        f"{1e6 * cost:.1f}",
        f"{100.0 * m['flow_error_max']:.3f} %",
    ]


def long_path(cell: Cell, samples: int) -> JointPath:
    """A path of the arm that takes about so many trajectory samples at its commanded speed."""
    n = int(samples * DEFAULT_DT * SPEED / SPACING) + 1
    s = np.arange(n, dtype=np.float64) * SPACING - RUN
    joints = np.arange(len(cell.home))
    q = cell.home + sum(
        size * np.sin(2.0 * np.pi * s[:, None] / (length * (1.0 + 0.13 * joints)) + joints) for length, size in WAVES
    )
    frames, runs = np.tile(np.eye(3), (n, 1, 1)), round(RUN / SPACING)
    task = NozzleTask(0, "long", 0, np.zeros((n, 3)), frames, s, runs, n - 1 - runs, SPEED)
    return JointPath(task, np.zeros(n), np.zeros((n, 2)), q, 0)


def linearity(problem: Problem) -> str:
    """Cost of a trajectory sample by the number of them, in one line."""
    cell, costs = build_cell(problem), []
    for samples in LENGTHS:
        (timed,), cost = measure_timing(cell, [long_path(cell, samples)])
        costs.append(f"{1e6 * cost:.1f} us at {timed.duration / DEFAULT_DT:.0f}")
    return f"timing, CPU time of a trajectory sample on a path of one bead: {', '.join(costs)} samples"


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("timing", __doc__)
    parser.add_argument("problem", nargs="*", help="problem files, or names of shipped ones; default: all of these")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS, title=" ".join(options.set) or None, title_justify="left")
    problems = [load_problem(name, options.set) for name in options.problem or shipped_problems()]
    for problem in problems:
        table.add_row(*row(problem))
    line = linearity(problems[0])
    Console(width=170).print(table)
    print(line)
    print(footer())
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
