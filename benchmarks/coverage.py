"""Paths over the shipped problems' faces compared: the sample orders of Onstein et al., and our rows.

python -m benchmarks.coverage [curved_plate propeller_blade shoehorn] [--set layers.source.spacing_mm=8] [--plan]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED, Refusal
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.layers import FaceLayersSpec
from planner.problem.part import StepSpec
from planner.toolpath.coverage import measures
from planner.toolpath.coverage.measures import SurfaceLine
from planner.toolpath.coverage.rows import REACH, cover
from planner.toolpath.coverage.sheet import sheet_of
from planner.toolpath.coverage.tours import ORDERS
from planner.toolpath.step.body import FaceBody
from planner.toolpath.step.cover import smooth_regions, visits
from planner.toolpath.step.files import Face, choose_faces, read_step

PROBLEMS = ("curved_plate", "propeller_blade", "shoehorn")
ROWS = "rows"
COLUMNS = (
    "problem", "path", "samples", "once", "crosses itself", "strokes", "length m", "turns", "turned °", "time s", "far",
    "CPU s", "planned s",
)  # fmt: skip
EDGES = 0.25  # of the spacing: so far apart are points of the faces' edges
LOOKS = 0.2  # of the spacing: so far apart are the points to which the distance is measured


def faces_of(problem: Problem, spec: FaceLayersSpec, step: StepSpec) -> list[Face]:
    """The faces that a problem covers."""
    faces = read_step(step, EDGES * spec.source.spacing, partial(problem.error, "part.step.file"))
    numbers = choose_faces(spec.source.faces, [(face.number, face.name) for face in faces], "part.step")
    return [face for face in faces if face.number in numbers]


def paths(
    region: Sequence[Face], spec: FaceLayersSpec, speed: float
) -> list[tuple[str, str, str, list[SurfaceLine], float]]:
    """Every path over a region: its name, how many samples, whether each is visited once, its lines, CPU time [s]."""
    out = []
    body = FaceBody.of(region)
    for name in ORDERS:
        start = time.process_time()
        samples, pieces = visits(body, spec.source.model_copy(update={"path": name}))
        seconds = time.process_time() - start
        once = "yes" if measures.visits_each_once(np.concatenate(pieces), len(samples.points)) else "NO"
        lines = [measures.laid(samples, piece) for piece in pieces if len(piece) > 1]
        out.append((name, str(len(samples.points)), once, lines, seconds))
    start = time.process_time()
    strokes = cover(region, spec.source.spacing, speed)
    seconds = time.process_time() - start
    out.append((ROWS, "", "", [SurfaceLine(s.points, s.normals, s.closed) for s in strokes], seconds))
    return out


def planned(name: str, path: str, overrides: Sequence[str]) -> str:
    """Deposition time of the whole problem with this path, planned for its own arm [s]."""
    try:
        plan = solve(load_problem(name, [*overrides, f"layers.source.path={path}"]))
    except Refusal as refusal:
        return f"refused: {refusal}"
    return f"{plan.metrics['deposition_time_s']:.1f}" + ("" if plan.verified else ", not verified")


def rows_of(name: str, overrides: Sequence[str], plan: bool) -> list[list[str]]:
    """Lines of the table for one problem, one a path."""
    problem = load_problem(name, overrides)
    spec, part = problem.layers, problem.part
    if not isinstance(spec, FaceLayersSpec) or part is None or part.step is None:
        raise problem.error("layers.source", "covers no faces", f"problems that do: {', '.join(PROBLEMS)}")
    spacing, process = spec.source.spacing, problem.process
    out = []
    for region in smooth_regions(faces_of(problem, spec, part.step)):
        sheet = sheet_of(region, LOOKS * spacing)
        triangles = sheet.triangles[sheet.material]
        looks = np.vstack([sheet.points[np.unique(triangles)], sheet.points[triangles].mean(axis=1)])
        for path, samples, once, lines, seconds in paths(region, spec, process.speed):
            figures = measured(lines, looks, spacing, process.speed, process.corner_tolerance)
            real = planned(name, path, overrides) if plan else ""
            out.append([name, path, samples, once, *figures, f"{seconds:.2f}", real])
    return out


def measured(lines: Sequence[SurfaceLine], looks: Array, spacing: float, speed: float, tolerance: float) -> list[str]:
    """What is said of every path, from whether it crosses itself to how far it stays away."""
    turns, turned = measures.turns(lines, spacing)
    crossings = len(measures.crossings(lines))
    return [
        f"{crossings} times" if crossings else "no",
        str(len(lines)),
        f"{measures.length(lines):.2f}",
        str(turns),
        f"{np.degrees(turned):.0f}",
        f"{measures.seconds(lines, speed, tolerance):.1f}",
        f"{measures.farthest(lines, looks) / spacing:.3f}",
    ]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage", description=__doc__.split("\n")[0])
    parser.add_argument("problems", nargs="*", help=f"default: {', '.join(PROBLEMS)}")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument(
        "--plan", action="store_true", help="plan every path for the problem's arm, which takes minutes"
    )
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS)
    for name in options.problems or PROBLEMS:
        for row in rows_of(name, options.set, options.plan):
            table.add_row(*row)
    console = Console(width=160)
    console.print(table)
    console.print(
        f"far: the greatest distance of a place of the faces from the path, in spacings; rows promise {REACH}. "
        "time: estimated from length and corners. CPU of a first call holds compilation."
    )
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
