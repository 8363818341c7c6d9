"""The case of Chen et al., IEEE T-ASE 22:12102, 2025 (arXiv 2409.13448): IRB 2600, both axes of an IRBP A250 free.

python -m benchmarks.chen freeform_25.txt [--out published.csv]

The file is one of their published tool paths (x y z nx ny nz, y up, normals along the nozzle); cell, ranges and cones are
those of their public code. Their objective is the sum of (0.1 |v|^2 + 0.5 |a|^2 + 1.0 |j|^2) ds over the waypoints, at the
commanded speed, with v, a and j as differences from waypoint to waypoint. It is given for the start (the ladder) and for
the result of each strategy.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.interpolate import make_interp_spline

from benchmarks.command import parser_of, told
from benchmarks.rows import Run, append_row
from benchmarks.single import beadwise, measured
from benchmarks.summary import FILES_ON
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED, Refusal
from planner.cell.cell import build_cell
from planner.collision.scene import NOTHING
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.settings import STRATEGY_NAMES
from planner.resolve.joint_path import JointPath
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of

SPACING = 0.8e-3  # m between waypoints: the median of their file
WEIGHTS = (0.1, 0.5, 1.0)  # of speed, acceleration and jerk
START = "ladder"
SPEEDS = (10.0, 40.0)  # mm/s: theirs, and ours
THEIR_LIMITS = "speed_deg_s: 34.4, acceleration_rad_s2: 5, jerk_rad_s3: 50"  # at some 10 mm/s

# Their cell as published. The plate of the A250 lies 120 mm below its tilt axis, their part's origin 107.21 mm.
PROBLEM = """\
name: chen
cell:
  arm: irb2600
  nozzle: {{tip_mm: [151.585, -88.7572, 189.022], axis: [0.603793, -0.374009, 0.703954], diameter_mm: 0.8}}
  home_deg: [0, 0, 0, 0, 60, 0]
  positioner: {{robot: irbp_a250, origin_mm: [1101.77, -8.99, 605.88], free: [tilt, rotation]}}
  limits:
    joint_1: {{range_deg: [-180, 180]{limits}}}
    joint_2: {{range_deg: [-90, 150]{limits}}}
    joint_3: {{range_deg: [-180, 75]{limits}}}
    joint_4: {{range_deg: [-400, 400]{limits}}}
    joint_5: {{range_deg: [-90, 90]{limits}}}
    joint_6: {{range_deg: [-400, 400]{limits}}}
    tilt: {{range_deg: [-180, 180]{limits}}}
    rotation: {{range_deg: [-3600, 3600]{limits}}}
layers:
  source: {{waypoints: {file}, up: y, normals: inward, origin_mm: [0, 0, 12.79], split_mm: 3}}
process:
  speed_mm_s: {speed}
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.8, height_mm: 0.8}}
  cones: {{nozzle_normal_deg: 12, nozzle_gravity_deg: 8, layer_gravity_deg: 20}}
"""


def objective(paths: Sequence[JointPath]) -> tuple[float, Array]:
    """Chen's objective over the deposition of all beads, and the largest speed, acceleration and jerk (3) of any
    joint [rad, s]."""
    total, largest = 0.0, np.zeros(3)
    for path in paths:
        task = path.task
        inside = slice(task.first, task.last + 1)
        q = make_interp_spline(task.s[inside], path.q[inside], k=5)
        n = max(round(task.s[task.last] / SPACING), 4)
        at, ds = np.linspace(0.0, task.s[task.last], n + 1, retstep=True)
        rows = q(at)
        for order, weight in enumerate(WEIGHTS, 1):
            values = np.diff(rows, n=order, axis=0) / (ds / task.speed) ** order
            total += weight * float((values**2).sum()) * float(ds)
            largest[order - 1] = max(largest[order - 1], float(np.abs(values).max()))
    return total, largest


COLUMNS = ("mm/s", "strategy", "objective", "of start", "v", "a", "j max", "resolve s", "verified", "at speed",
           "deposition / ideal", "σ min")  # fmt: skip


def row(problem: Problem, strategy: str, start: float | None) -> tuple[list[str], float]:
    """One line of the table, and the objective."""
    cell = build_cell(problem)
    tasks = tasks_of(problem, build_toolpath(problem))
    STRATEGIES[strategy](cell, tasks, problem.resolve, NOTHING)  # the first time compiles
    began = time.perf_counter()
    paths = STRATEGIES[strategy](cell, tasks, problem.resolve, NOTHING)
    seconds = time.perf_counter() - began
    value, largest = objective(paths)
    plan = solve(problem, strategy)
    m = plan.metrics
    cells = [
        f"{problem.process.speed * 1e3:g}",
        strategy,
        f"{value:.4g}",
        "" if start is None else f"{100 * (value / start - 1):+.1f} %",
        *(f"{x:.2f}" for x in largest),
        f"{seconds:.2f}",
        "yes" if plan.verified else "no: " + ", ".join(check.name for check in plan.checks if not check.ok),
        f"{100 * m['at_speed_fraction']:.2f} %",
        f"{m['deposition_time_s'] / m['ideal_deposition_time_s']:.4f}",
        f"{m['sigma_min']:.3f}",
    ]
    return cells, value


def _conditions(speed: float, settings: Sequence[str]) -> str:
    """What the column `set` has of a plan: as for other files, the cell and what is special to it."""
    limits = "their limits" if speed == SPEEDS[0] else "the robots' limits"
    return " ".join([f"{FILES_ON}chen {speed:g} mm/s, {limits}, cones as published", *settings])


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("chen", __doc__)
    parser.add_argument("file", type=Path, help="one of their tool paths")
    parser.add_argument("--strategy", nargs="+", choices=STRATEGY_NAMES, default=["sqp"])
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, metavar="FILE.csv", help="append a row of each plan to this file")
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS, title="limits at 10 mm/s: theirs; at 40 mm/s: the robots' own", title_justify="left")
    for speed in SPEEDS:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "chen.yaml"
            limits = f", {THEIR_LIMITS}" if speed == SPEEDS[0] else ""
            text = PROBLEM.format(file=options.file.resolve(), limits=limits, speed=speed)
            path.write_text(text, encoding="utf-8")
            problem = load_problem(path, options.set)
            if options.out is not None:
                for strategy in options.strategy:
                    one = measured(Run(str(path), strategy, tuple(options.set), 0, beadwise()))
                    append_row(
                        options.out, one | {"problem": options.file.name, "set": _conditions(speed, options.set)}
                    )
        start = None
        for strategy in (START, *(name for name in options.strategy if name != START)):
            try:
                cells, value = row(problem, strategy, start)
            except Refusal as refusal:
                table.add_row(f"{speed:g}", strategy, f"no plan: {refusal}")
                continue
            start = value if strategy == START else start
            table.add_row(*cells)
    Console(width=160).print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
