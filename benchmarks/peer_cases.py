"""The two cases on which installable peers are measured: a spiral on a cap, and a zig-zag around a cylinder.

python -m benchmarks.peer_cases --waypoints 10000 --strategy sqp      solves them, one table row each
python -m benchmarks.peer_cases --write problems                     writes their problem files into a folder
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.interpolate import CubicSpline

from benchmarks.command import told
from benchmarks.usage import peak_mb
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED, Refusal
from planner.base.progress import Stages
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.problem.settings import STRATEGY_NAMES

SPACING = 1.0  # mm between waypoints
SHIPPED = 1000  # waypoints of the problems in problems/
CAP_RADIUS, CAP_ANGLE = 120.0, np.radians(45.0)
CYLINDER_RADIUS, CYLINDER_ANGLE, CYLINDER_FOOT = 50.0, np.radians(353.0), 20.0
CYLINDER_OFF_AXIS = 15.0

HEAD = """\
# yaml-language-server: $schema=../docs/problem.schema.json
# {title}
# {waypoints} waypoints; written by: python -m benchmarks.peer_cases --write problems
# Lengths are millimetres, angles degrees, as the names of the keys say.

name: {name}

# The world is the arm's base frame. The nozzle's tip stands 0.1 m along the flange's axis; its own axis is the
# flange's, turned by 45 degrees about y.
cell:
  arm: irb140
  nozzle: {{tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}}
  home_deg: {home}
{holder}
# A file of waypoints carries its own surface: lines x y z nx ny nz in the part frame, normals out of the part.
layers:
  source: {{waypoints: {name}.txt}}

process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
"""
BED = """\
  bed_mm: [450, 0, 150]                   # the part frame: centre of the sphere
  fixtures:                               # a plate under the part; its size is assumed
    bed: {box_mm: [400, 400, 20], centre_mm: [450, 0, 140]}
  limits: {joint_5: {range_deg: [-120, 120]}}
"""
TABLE = """\
  positioner:
    robot: irbp_a250
    origin_mm: [450, 0, 140]              # the cylinder's axis stands 15 mm beside the table's
    part_mm: [0, 0, 60]                   # so high above it, on a mandrel, that the nozzle may lie level at its foot
    free: [rotation]
  fixtures:
    mandrel: {cylinder: {radius_mm: 30, height_mm: 80}, centre_mm: [15, 0, -20], on: part}
  limits:
    joint_5: {range_deg: [-120, 120]}
    rotation: {range_deg: [-360, 360]}
"""


def cap(waypoints: int) -> Array:
    """A spiral of constant pitch from the top of a spherical cap to its rim; rows x y z nx ny nz [mm].

    Its pitch is what makes it `waypoints` times the spacing long.
    """
    length = (waypoints - 1) * SPACING
    low, high = 1e-3 * CAP_RADIUS, 1e3 * CAP_RADIUS
    for _ in range(60):  # a narrower pitch makes it longer
        pitch = np.sqrt(low * high)
        if _spiral(pitch)[1][-1] > length:
            low = pitch
        else:
            high = pitch
    azimuth, arc = _spiral(pitch)
    at = CubicSpline(arc, azimuth)(np.linspace(0.0, arc[-1], waypoints))
    polar = at * pitch / (2.0 * np.pi * CAP_RADIUS)
    normals = np.column_stack([np.sin(polar) * np.cos(at), np.sin(polar) * np.sin(at), np.cos(polar)])
    return np.hstack([CAP_RADIUS * normals, normals])


def _spiral(pitch: float) -> tuple[Array, Array]:
    """Azimuth (n) along a spiral on the cap, and arc length (n) up to there [mm]."""
    turns = CAP_ANGLE * CAP_RADIUS / pitch
    azimuth = np.linspace(0.0, 2.0 * np.pi * turns, int(2000 + 200 * turns))
    per_turn = pitch / (2.0 * np.pi)
    speed = np.hypot(per_turn, CAP_RADIUS * np.sin(azimuth * per_turn / CAP_RADIUS))
    return azimuth, np.asarray(CubicSpline(azimuth, speed).antiderivative()(azimuth))


def cylinder(waypoints: int) -> Array:
    """Rows to and fro around a cylinder, one spacing above each other; rows x y z nx ny nz [mm]."""
    row = round(CYLINDER_RADIUS * CYLINDER_ANGLE / SPACING) + 1
    number, place = np.divmod(np.arange(waypoints), row)
    share = np.where(number % 2 == 0, place, row - 1 - place) / (row - 1)
    angle = np.pi + (share - 0.5) * CYLINDER_ANGLE  # the gap faces away from the arm
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(waypoints)
    x = CYLINDER_OFF_AXIS + CYLINDER_RADIUS * c
    return np.column_stack([x, CYLINDER_RADIUS * s, CYLINDER_FOOT + SPACING * number, c, s, zero])


@dataclass(frozen=True)
class Case:
    """A case: its waypoints by their number, and what its problem file says."""

    path: Callable[[int], Array]
    title: str
    home: str
    holder: str


CASES = {
    "peer_cap": Case(cap, "A spiral on a convex cap of a sphere, on a fixed bed.", "[0, 0, 0, 0, 45, 0]", BED),
    "peer_cylinder": Case(
        cylinder, "A zig-zag around a cylinder that stands off the axis of a turntable.", "[0, 0, 0, 0, -45, 0]", TABLE
    ),
}


def waypoint_text(rows: Array) -> str:
    """The text of a file of waypoints: rows (n, 6) to a tenth of a micrometre."""
    lines = (f"{x:.4f} {y:.4f} {z:.4f} {a:.7f} {b:.7f} {c:.7f}" for x, y, z, a, b, c in (rows + 0.0).tolist())
    return "# x y z nx ny nz\n" + "\n".join(lines).replace("-0.0000 ", "0.0000 ") + "\n"


def write_case(name: str, waypoints: int, folder: Path) -> Path:
    """Write a case's waypoints and problem file into a folder; returns the problem file."""
    case = CASES[name]
    (folder / f"{name}.txt").write_text(waypoint_text(case.path(waypoints)), encoding="utf-8")
    path = folder / f"{name}.yaml"
    text = HEAD.format(name=name, title=case.title, waypoints=waypoints, home=case.home, holder=case.holder)
    path.write_text(text, encoding="utf-8")
    return path


def joint_steps(plan: Plan, spacing: float) -> Array:
    """Largest change of any joint [rad] from one waypoint to the next, `spacing` [m] apart along each bead."""
    t = plan.trajectory
    steps = [np.zeros(0)]
    for i, bead in enumerate(plan.toolpath.beads):
        here = t.bead == i
        at = np.arange(0.0, bead.length, spacing)
        q = np.column_stack([np.interp(at, t.s[here], t.q[here, j]) for j in range(t.q.shape[1])])
        steps.append(np.abs(np.diff(q, axis=0)).max(axis=1))
    return np.concatenate(steps)


COLUMNS = (
    "case", "strategy", "verified", "waypoints/s", "MB", "σ min", "joint step", "margin", "off mm", "at speed",
    "plan s",
)  # fmt: skip


def row(name: str, strategy: str, waypoints: int) -> list[str]:
    """Plan a small case to compile, then the case; one line of the table."""
    with tempfile.TemporaryDirectory() as folder:
        solve(load_problem(write_case(name, 200, Path(folder))), strategy)
        problem = load_problem(write_case(name, waypoints, Path(folder)))
        stages = Stages()
        try:
            plan = solve(problem, strategy, stages=stages, second_process=True, baseline=False)
        except Refusal as refusal:
            return [name, strategy, f"no plan: {refusal}", *[""] * (len(COLUMNS) - 3)]
    seconds = sum(stages.seconds.values())
    m = plan.metrics
    margin = np.radians(plan.series["limit_margin_deg"][plan.trajectory.deposit].min())
    return [
        name,
        strategy,
        "yes" if plan.verified else "no: " + ", ".join(check.name for check in plan.checks if not check.ok),
        f"{waypoints / seconds:.0f}",
        f"{peak_mb():.0f}",
        f"{m['sigma_min']:.3f}",
        f"{joint_steps(plan, SPACING * 1e-3).max():.3f}",
        f"{margin:.3f}",
        f"{m['position_error_max_mm']:.4f}",
        f"{100 * m['at_speed_fraction']:.1f} %",
        f"{seconds:.2f}",
    ]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peer_cases", description=__doc__)
    parser.add_argument("--waypoints", type=int, default=SHIPPED)
    parser.add_argument("--strategy", nargs="+", choices=STRATEGY_NAMES, default=["ladder", "sqp"])
    parser.add_argument("--case", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--write", type=Path, metavar="DIR", help="write the problem files there, and solve nothing")
    options = parser.parse_args(arguments)
    if options.write is not None:
        for name in options.case:
            print(write_case(name, options.waypoints, options.write))
        return EXIT_VERIFIED
    title = f"{options.waypoints} waypoints, joint step and margin in rad; time without the baseline's plan"
    table = Table(*COLUMNS, title=title, title_justify="left")
    # a process for each row: its peak memory is its own
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        jobs = [(name, strategy, options.waypoints) for name in options.case for strategy in options.strategy]
        for cells in pool.map(row, *zip(*jobs, strict=True)):
            table.add_row(*cells)
    Console(width=150).print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
