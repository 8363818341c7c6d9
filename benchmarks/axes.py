"""What free axes cost and buy: one part on a two-axis table, with one to four axes for the planner to choose.

python -m benchmarks.axes --waypoints 1000

The part is the cap of `benchmarks.peer_cases` on a tilting turntable. Roll about the nozzle is always free; axes that are
not free are held, the two of the tilt cone at zero.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.command import parser_of, told
from benchmarks.memory import Peak
from benchmarks.peer_cases import cap, waypoint_text
from benchmarks.rows import Row, Run, append_row, check_columns, row_of_plan, row_without_plan
from benchmarks.single import beadwise
from benchmarks.usage import Usage, cpu_seconds
from planner.base.errors import EXIT_VERIFIED, Refusal
from planner.base.progress import Stages
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.problem.settings import STRATEGY_NAMES

WAYPOINTS = 1000
TILT = 10  # degrees from the normal that the nozzle may lean, where it may
PROBLEM = """\
name: cap_on_table
cell:
  arm: irb140
  nozzle: {{tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}}
  home_deg: [0, 0, 0, 0, 45, 0]
  positioner:
    robot: irbp_a250
    origin_mm: [450, 0, 150]
    free: [{table}]
  limits: {{joint_5: {{range_deg: [-120, 120]}}}}
layers:
  source: {{waypoints: cap.txt}}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
  cones: {{nozzle_normal_deg: {tilt}}}
"""


@dataclass(frozen=True)
class Axes:
    """Which axes are free: the table's by name, and whether the nozzle may lean (two more)."""

    words: str
    table: tuple[str, ...] = ()
    leans: bool = False

    @property
    def count(self) -> int:
        """How many, roll among them."""
        return 1 + len(self.table) + 2 * self.leans


CASES = (
    Axes("roll"),
    Axes("roll, table's rotation", ("rotation",)),
    Axes("roll, table's rotation and tilt", ("tilt", "rotation")),
    Axes("roll, nozzle's lean", leans=True),
    Axes("roll, table's rotation, nozzle's lean", ("rotation",), leans=True),
)
FIGURES = (
    ("seconds_total", 2), ("cpu_s", 2), ("peak_mb", 0), ("waypoints_per_s", 0), ("at_speed_fraction", 4),
    ("deposition_time_s", 2), ("sigma_min", 3), ("joint_step_max_rad", 4), ("limit_margin_rad", 3),
)  # fmt: skip


def problem_text(axes: Axes) -> str:
    """The problem file of a case."""
    return PROBLEM.format(table=", ".join(axes.table), tilt=TILT if axes.leans else 0)


def measure(axes: Axes, waypoints: int, strategy: str) -> Row:
    """The row of a case."""
    run = Run(f"cap_on_table@{waypoints}", strategy, (f"free: {axes.words}",), planner=beadwise())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cap_on_table.yaml"
        file.write_text(problem_text(axes), encoding="utf-8")
        for n in (200, waypoints):  # the first compiles
            (Path(folder) / "cap.txt").write_text(waypoint_text(cap(n)), encoding="utf-8")
            stages, before = Stages(), cpu_seconds()
            try:
                with Peak() as peak:
                    plan = solve(load_problem(file), strategy, stages=stages, second_process=True, baseline=False)
            except Refusal as refusal:
                return row_without_plan(run, f"no plan: {refusal}", {})
    return row_of_plan(run, plan, stages.seconds, Usage(cpu_seconds() - before, peak.mb))


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("axes", __doc__)
    parser.add_argument("--waypoints", type=int, default=WAYPOINTS)
    parser.add_argument("--strategy", choices=STRATEGY_NAMES, default="sqp")
    parser.add_argument("--out", type=Path, metavar="CSV", help="append a row of each to this file")
    options = parser.parse_args(arguments)
    table = Table("free", "axes", "verified", *(name for name, _ in FIGURES), title=f"{options.waypoints} waypoints")
    n = len(CASES)
    if options.out is not None:
        check_columns(options.out)
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        rows = pool.map(measure, CASES, [options.waypoints] * n, [options.strategy] * n)
        for axes, row in zip(CASES, rows, strict=True):
            if options.out is not None:
                append_row(options.out, row)
            figures = [f"{row[name]:.{digits}f}" if row["found"] else "" for name, digits in FIGURES]
            table.add_row(f"{axes.count}", axes.words, "yes" if row["verified"] else f"no: {row['reason']}", *figures)
    Console(width=200).print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
