"""Whether an upright nozzle would be in the struts that waypoint files have it lay: counted without planner or robot.

python -m benchmarks.nozzle_count FOLDER --cell my_cell.yaml --pattern 'npp/*' --set 'cell.nozzle.profile_mm=[[0, 0.25], [150, 0.5]]'

A nozzle is a body of revolution. Where its axis is given, no rotation about it, no table and no posture changes which parts
of the print it touches. For every quarter of a millimetre of a path, everything earlier on the path is checked, each pair
by itself: no trees, no bounds, no code of the planner except what reads files and cells. The required clearance is the
planner's own if the problem does not set one: none beyond the tip's zone; within it, a place at distance r from the tip must
be r / 4 away from the nozzle, less a quarter of the nozzle's face and two diameters. If a file lacks clearance here, no arm
can print it with this nozzle and without a lean; if it does not, this says nothing about arms.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.command import parser_of
from benchmarks.waypoint_files import Meaning, files_in, look_at, place
from planner.base.arrays import Array, Ints
from planner.base.command_line import exit_code
from planner.base.compiled import njit
from planner.base.errors import EXIT_VERIFIED, PlannerError
from planner.cell.bodies import nozzle_profile
from planner.planning.context import found_anywhere
from planner.planning.options import add_set
from planner.problem import Problem, load_problem
from planner.problem.layers import WaypointLayersSpec, WaypointsSpec
from planner.toolpath.waypoints.reader import read_waypoints

STEP = 0.25e-3  # m along paths
SLOPE = 0.25  # of the distance from the tip, that is kept
MOST = 8_000  # places of the tip at which is looked


@njit
def _from_edge(h: float, r: float, h0: float, r0: float, h1: float, r1: float) -> float:
    """Distance of (h, r) from the line between two points of an outline."""
    dh, dr = h1 - h0, r1 - r0
    share = min(max(((h - h0) * dh + (r - r0) * dr) / (dh * dh + dr * dr), 0.0), 1.0)
    return math.sqrt((h - h0 - share * dh) ** 2 + (r - r0 - share * dr) ** 2)


@njit
def _from_nozzle(h: float, r: float, outline: Array) -> float:
    """Signed distance of a place at height h above the tip and r beside the axis from the nozzle, negative inside."""
    least, inside = math.sqrt(h * h + max(r - outline[0, 1], 0.0) ** 2), False
    top, wide = outline[-1, 0], outline[-1, 1]
    least = min(least, math.sqrt((h - top) ** 2 + max(r - wide, 0.0) ** 2))
    for k in range(len(outline) - 1):
        h0, r0, h1, r1 = outline[k, 0], outline[k, 1], outline[k + 1, 0], outline[k + 1, 1]
        least = min(least, _from_edge(h, r, h0, r0, h1, r1))
        inside |= h0 < h < h1 and r < r0 + (r1 - r0) * (h - h0) / max(h1 - h0, 1e-12)
    return -least if inside else least


@njit
def _lacking(
    tips: Array, axes: Array, before: Array, middles: Array, along: Array, radius: float, outline: Array, slack: float
) -> tuple[Array, Ints]:
    """For each tip (n) the least that is to spare [m] of what lies before it, and the index of the worst place."""
    spare, worst = np.full(len(tips), np.inf), np.full(len(tips), -1)
    reach = outline[:, 1].max() + 10.0 * radius
    for i in range(len(tips)):
        for j in range(len(middles)):
            if along[j] >= before[i]:
                break
            x, y, z = middles[j, 0] - tips[i, 0], middles[j, 1] - tips[i, 1], middles[j, 2] - tips[i, 2]
            h = x * axes[i, 0] + y * axes[i, 1] + z * axes[i, 2]
            away = x * x + y * y + z * z
            r = math.sqrt(max(away - h * h, 0.0))
            if h < -10.0 * radius or r > reach or h > outline[-1, 0] + radius:
                continue
            value = _from_nozzle(h, r, outline) - radius - min(0.0, SLOPE * math.sqrt(away) - slack)
            if value < spare[i]:
                spare[i], worst[i] = value, j
    return spare, worst


def counted(problem: Problem, source: WaypointsSpec) -> str:
    """What is to be said of one file."""
    bead, outline = problem.process.bead, np.array(nozzle_profile(problem.cell.nozzle))
    radius = float(np.sqrt(bead.width * bead.height / np.pi))
    tips, axes, along = (np.concatenate(part) for part in zip(*_dense(source, bead.width), strict=True))
    steps = np.concatenate([[0.0], np.cumsum(along)])[:-1]
    some = slice(None, None, max(1, len(tips) // MOST))
    slack = SLOPE * (outline[0, 1] + 4.0 * radius)
    middles = tips - radius * axes
    spare, worst = _lacking(
        np.ascontiguousarray(tips[some]),
        np.ascontiguousarray(axes[some]),
        steps[some],
        middles,
        steps,
        radius,
        outline,
        slack,
    )
    i = int(np.argmin(spare))
    if spare[i] >= 0.0:
        return "clear everywhere"
    above = float((middles[worst[i]] - tips[some][i]) @ axes[some][i])
    x, y, z = tips[some][i] * 1e3
    share = float((spare < 0.0).mean())
    return (
        f"lacks {-spare[i] * 1e3:.2f} mm at {x:.1f} {y:.1f} {z:.1f} mm, of what lies {above * 1e3:.1f} mm above the tip, laid "
        f"{(steps[some][i] - steps[worst[i]]) * 1e3:.1f} mm before; somewhere on {share:.1%} of the length"
    )


def _dense(source: WaypointsSpec, width: float) -> Iterator[tuple[Array, Array, Array]]:
    """Tips and unit vectors against the axis (n, 3), and the way (n) [m] from each to the next, of every path."""
    for path in read_waypoints(source, width=width).beads:
        step = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
        s = np.concatenate([[0.0], np.cumsum(step)])
        at = np.union1d(s, np.arange(0.0, s[-1], STEP))
        tips, axes = (
            np.column_stack([np.interp(at, s, column) for column in values.T]) for values in (path.points, path.normals)
        )
        yield tips, axes / np.linalg.norm(axes, axis=1)[:, None], np.append(np.diff(at), 1e-6)


def run(options: argparse.Namespace) -> int:
    """A line for each file."""
    problem = load_problem(options.cell, options.set)
    bead = (problem.process.bead.width, problem.process.bead.height)
    for file in files_in(options.folder, options.pattern):
        try:
            placed = place(look_at(file), Meaning(), bead, np.inf, False)
            layers = json.dumps({"source": placed.source(file.resolve())})  # JSON is YAML
            own = load_problem(found_anywhere(problem), [f"layers={layers}", "part=null", *options.set])
            said = counted(own, own.layers.source) if isinstance(own.layers, WaypointLayersSpec) else "no waypoints"
        except PlannerError as error:
            said = f"refused: {error}"
        print(f"{file.relative_to(options.folder).as_posix()}: {said}", flush=True)
    return EXIT_VERIFIED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    command = parser_of("nozzle_count", __doc__)
    command.add_argument("folder", type=Path, metavar="FOLDER", help="where the files are, at any depth")
    command.add_argument(
        "--cell", required=True, metavar="PROBLEM", help="whose nozzle and bead are used: file or name"
    )
    command.add_argument("--pattern", action="append", default=[], metavar="GLOB", help="only these files; repeatable")
    add_set(command)
    options = command.parse_args(arguments)
    return exit_code(lambda: run(options), lambda text: print(text, file=sys.stderr), "")


if __name__ == "__main__":
    sys.exit(main())
