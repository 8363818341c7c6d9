"""How time and memory grow with the print: a gently curved sheet, in as many layers as it takes.

python -m benchmarks.scaling --waypoints 1000 10000 100000 1000000 --out scaling.csv

Each size is planned, verified and written to files in its own process, as the command does it: with a second process
where that helps, and with the baseline. The exponent is that of the power law fitted to the times, in logarithms;
memory is that of all processes together.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.command import parser_of, told
from benchmarks.memory import Peak
from benchmarks.peer_cases import waypoint_text
from benchmarks.rows import Row, Run, append_row, check_columns, row_of_plan
from benchmarks.single import beadwise
from benchmarks.usage import Usage, cpu_seconds
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED
from planner.base.progress import STAGES, Stages
from planner.planning.files import write_files
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.problem.settings import STRATEGY_NAMES

PASS, PASSES, PITCH, SPACING = 150.0, 15, 1.0, 1.0  # mm: a strip of passes to and fro is a bead
STRIPS, GAP = 4, 4.0  # strips of a layer, and the way from one to the next
LAYER = 0.5  # mm
BOW = 300.0  # mm, radius along the passes; across them, twice as much
SHOWN = (*STAGES, "baseline", "export")
FIGURES = (("seconds_total", 1), ("cpu_s", 1), ("peak_mb", 0))  # and their digits
SIZES = (1000, 10_000, 100_000, 1_000_000)

PROBLEM = """\
name: sheet
cell:
  arm: irb140
  nozzle: {tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}
  home_deg: [0, 0, 0, 0, 45, 0]
  bed_mm: [480, 0, 150]
layers:
  source: {waypoints: sheet.txt}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {width_mm: 1, height_mm: 0.5}
"""


def sheet(waypoints: int) -> Array:
    """Strips of passes on a saddle-free bowl turned over, layer upon layer; rows x y z nx ny nz [mm]."""
    along = np.arange(0.0, PASS + 0.5 * SPACING, SPACING) - 0.5 * PASS
    rows = []
    for k in range(PASSES):
        rows.append(np.column_stack([along if k % 2 == 0 else along[::-1], np.full(len(along), k * PITCH)]))
    strip = np.vstack(rows)
    wide = (PASSES - 1) * PITCH + GAP
    middle = 0.5 * (STRIPS * wide - GAP)
    layer = np.vstack([strip + [0.0, k * wide - middle] for k in range(STRIPS)])
    count = -(-waypoints // len(layer))
    x, y = np.tile(layer, (count, 1))[:waypoints].T
    normals = np.column_stack([x / BOW, y / (2.0 * BOW), np.ones(waypoints)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    z = -(x**2) / (2.0 * BOW) - y**2 / (4.0 * BOW)
    height = LAYER * (1 + np.arange(waypoints) // len(layer))
    return np.hstack([np.column_stack([x, y, z]) + height[:, None] * normals, normals])


def measure(waypoints: int, strategy: str) -> tuple[Row, dict[str, float]]:
    """The row of a sheet, and its seconds by stage, export too."""
    with tempfile.TemporaryDirectory() as folder:
        problem = Path(folder) / "sheet.yaml"
        problem.write_text(PROBLEM, encoding="utf-8")
        for n in (600, waypoints):  # the first compiles
            (Path(folder) / "sheet.txt").write_text(waypoint_text(sheet(n)), encoding="utf-8")
            stages, before = Stages(), cpu_seconds()
            with Peak() as peak:
                plan = solve(load_problem(problem), strategy, stages=stages, second_process=True)
                plan = write_files(plan, Path(folder), stages, second_process=True)
    run = Run(f"sheet@{waypoints}", strategy, planner=beadwise())
    used = Usage(cpu_seconds() - before, peak.mb)
    seconds = dict(stages.seconds)
    row = row_of_plan(run, plan, seconds, used)
    return row | {"seconds_total": sum(seconds.values())}, seconds


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """The power of the size with which values grow: the slope of the straight line nearest to them, in logarithms.

    Raises ValueError for fewer than two different sizes.
    """
    if len(set(sizes)) < 2:
        raise ValueError("an exponent needs two different sizes")
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("scaling", __doc__)
    parser.add_argument("--waypoints", nargs="+", type=int, default=list(SIZES))
    parser.add_argument("--strategy", choices=STRATEGY_NAMES, default="sqp")
    parser.add_argument("--out", type=Path, metavar="CSV", help="append a row of each to this file")
    options = parser.parse_args(arguments)
    table = Table("waypoints", *SHOWN, "all [s]", "CPU s", "MB", "verified", title=options.strategy)
    done: list[Row] = []
    if options.out is not None:
        check_columns(options.out)
    with ProcessPoolExecutor(
        1, get_context("spawn"), max_tasks_per_child=1
    ) as pool:  # each has a peak memory of its own
        strategies = [options.strategy] * len(options.waypoints)
        for row, seconds in pool.map(measure, options.waypoints, strategies):
            done.append(row)
            if options.out is not None:
                append_row(options.out, row)
            table.add_row(
                f"{row['waypoints']}",
                *(f"{seconds.get(stage, 0.0):.1f}" for stage in SHOWN),
                *(f"{float(row[name]):.{digits}f}" for name, digits in FIGURES),
                "yes" if row["verified"] else "no",
            )
    console = Console(width=170)
    console.print(table)
    sizes = [float(row["waypoints"]) for row in done]
    if len(set(sizes)) > 1:
        powers = (f"{name} {exponent(sizes, [float(row[name]) for row in done]):.3f}" for name, _ in FIGURES)
        console.print(f"exponents from {min(sizes):.0f} to {max(sizes):.0f} waypoints: {', '.join(powers)}")
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
