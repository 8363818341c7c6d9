"""How close bodies come in shipped problems, and the cost of checking it: CPU seconds of one process.

python -m benchmarks.collision                 all of them
python -m benchmarks.collision peer_cap        some of them
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from planner.base.errors import PlannerError
from planner.collision.print_body import print_body, standing
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem, shipped_problems
from planner.verify.checks import Judged
from planner.verify.collision import keep_apart, sweep_cell
from planner.verify.executed import executed_motion
from planner.verify.nozzle import beyond, by_the_tip

COLUMNS = (
    "problem",
    "samples",
    "least mm",
    "nozzle mm",
    "arm mm",
    "robots mm",
    "nearest",
    "plan s",
    "print s",
    "check s",
)


def row(plan: Plan, seconds: float) -> tuple[str, ...]:
    """A plan's least distances and what they take."""
    motion = executed_motion(plan.cell, plan.trajectory)
    started = time.process_time()
    body = print_body(plan.toolpath, standing(plan.cell))
    building = time.process_time() - started
    started = time.process_time()
    given = (plan.problem, plan.cell, plan.toolpath, plan.trajectory)
    judged = Judged(*given, motion, body)
    keep_apart(judged, (by_the_tip(judged), beyond(judged)), sweep_cell(*given, body))
    check = time.process_time() - started
    names = ("clearance_min_mm", "nozzle_clearance_min_mm", "arm_clearance_min_mm", "robot_clearance_min_mm")
    nearest = f"{plan.approaches[0].a}, {plan.approaches[0].b}" if plan.approaches else "-"
    figures = [f"{plan.metrics[name]:.1f}" for name in names]
    return (
        plan.problem.name,
        str(len(plan.trajectory)),
        *figures,
        nearest,
        *(f"{s:.1f}" for s in (seconds, building, check)),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve the problems named, or all that ship, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.collision", description=__doc__)
    parser.add_argument("problem", nargs="*", default=shipped_problems(), help="default: all that ship")
    names = parser.parse_args(arguments).problem
    table = Table(*COLUMNS)
    console = Console(width=150)
    for name in names:
        started = time.process_time()
        try:
            plan = solve(load_problem(name))
        except PlannerError as error:
            console.print(f"{name}: {error}", markup=False)
            continue
        table.add_row(*row(plan, time.process_time() - started))
    console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
