"""Programs read back and played: how near they are to their plans, and how long writing, reading and playing takes.

python -m benchmarks.programs [PROBLEM ...] [--set layers.count=1]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, PlannerError
from planner.export.player.play import limited, play
from planner.export.rapid.reader import read_rapid_files
from planner.export.rapid.writer import rapid_files
from planner.export.readback import judge
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem, shipped_problems

COLUMNS = ("problem", "waypoints", "targets", "path", "corner", "angle", "events", "time laid", "worst bead")
COLUMNS += ("slow moves", "write", "read", "play", "judge")
Value = TypeVar("Value")


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """What a piece of work returns, and the time that it takes [s]."""
    start = time.perf_counter()
    out = work()
    return out, time.perf_counter() - start


def row(plan: Plan) -> tuple[list[str], list[str]]:
    """Cells of one plan's program, and what it does otherwise than the plan."""
    files, writing = timed(lambda: rapid_files(plan))
    program, reading = timed(lambda: read_rapid_files(files))
    played, playing = timed(lambda: play(program, plan.cell))
    found, judging = timed(lambda: judge(plan, program, played))
    agreement = found.agreement
    cells = [
        f"{sum(len(bead.s) for bead in plan.toolpath.beads):,}",
        f"{len(program.linear):,}",
        f"{1e3 * agreement.path:.3f} mm",
        f"{1e3 * found.corner:.3f} mm",
        f"{np.degrees(agreement.angle):.3f}°",
        f"{1e3 * agreement.event:.4f} mm",
        f"{100 * (found.laid - 1):+.2f} %",
        f"{100 * (found.worst - 1):+.1f} %",
        str(sum(each.moves for each in limited(program, played))),
        *(f"{seconds:.2f} s" for seconds in (writing, reading, playing, judging)),
    ]
    return cells, found.differences()


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.programs", description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", help="default: all that ship")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS, title="Programs against their plans", title_justify="left")
    code = EXIT_VERIFIED
    try:
        for name in options.problems or shipped_problems():
            cells, differences = row(solve(load_problem(name, options.set)))
            table.add_row(name, *cells)
            for difference in differences:
                Console(stderr=True).print(f"{name}: {difference}", markup=False)
                code = EXIT_NOT_VERIFIED
    except PlannerError as error:
        Console(stderr=True).print(f"error: {error}", markup=False)
        return error.exit_code
    Console(width=180).print(table)
    return code


if __name__ == "__main__":
    sys.exit(main())
