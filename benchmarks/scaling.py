"""How time and memory grow with the print: a sheet, gently curved, in as many layers as it takes.

python -m benchmarks.scaling --waypoints 18000 180000
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.peer_cases import waypoint_text
from planner.errors import EXIT_VERIFIED, PlannerError
from planner.planning import solve, write_files
from planner.problem import load_problem
from planner.problem.settings import STRATEGY_NAMES
from planner.progress import Stages

Array = NDArray[np.float64]

PASS, PASSES, PITCH, SPACING = 150.0, 15, 1.0, 1.0  # mm: a strip of passes to and fro is a bead
STRIPS, GAP = 4, 4.0  # strips of a layer, and the way from one to the next
LAYER = 0.5  # mm
BOW = 300.0  # mm, radius along the passes; across them, twice as much
STAGES = ("load", "toolpath", "resolve", "timing", "verify", "baseline", "export")

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


def measure(waypoints: int, strategy: str) -> tuple[dict[str, float], float, bool]:
    """Seconds by stage, peak memory [MB] of this process and the largest it forked, and whether the plan is verified."""
    with tempfile.TemporaryDirectory() as folder:
        problem = Path(folder) / "sheet.yaml"
        problem.write_text(PROBLEM, encoding="utf-8")
        stages = Stages()
        for n in (600, waypoints):  # the first compiles
            stages = Stages()
            (Path(folder) / "sheet.txt").write_text(waypoint_text(sheet(n)), encoding="utf-8")
            plan = solve(load_problem(problem), strategy, stages=stages, second_process=True)
            plan = write_files(plan, Path(folder), stages, True)
    peak = sum(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1024
    return dict(stages.seconds), peak, plan.verified


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description=__doc__)
    parser.add_argument("--waypoints", nargs="+", type=int, default=[18_000, 180_000])
    parser.add_argument("--strategy", choices=STRATEGY_NAMES, default="sqp")
    options = parser.parse_args(arguments)
    table = Table("waypoints", *STAGES, "all", "of the first", "MB", "verified", title=options.strategy)
    first: tuple[int, float] | None = None
    try:
        with ProcessPoolExecutor(
            1, get_context("spawn"), max_tasks_per_child=1
        ) as pool:  # each has a peak memory of its own
            jobs = [(n, options.strategy) for n in options.waypoints]
            for n, (seconds, peak, verified) in zip(
                options.waypoints, pool.map(measure, *zip(*jobs, strict=True)), strict=True
            ):
                total = sum(seconds.values())
                first = first or (n, total)
                table.add_row(
                    f"{n}",
                    *(f"{seconds.get(stage, 0.0):.1f}" for stage in STAGES),
                    f"{total:.1f}",
                    f"{total / first[1]:.1f} times for {n / first[0]:.0f}",
                    f"{peak:.0f}",
                    "yes" if verified else "no",
                )
    except PlannerError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    Console(width=140).print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
