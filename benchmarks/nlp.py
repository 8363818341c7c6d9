"""Strategy `sqp` compared with `nlp`, its slow reference, on single beads: the price that both minimise, and the time.

python -m benchmarks.nlp
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.usage import footer
from planner.cell.cell import Cell, build_cell
from planner.problem import load_problem
from planner.problem.settings import ResolveSpec
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.reference.nlp import NlpSolution, solve_nlp
from planner.resolve.refine import evaluate, refine_stretch
from planner.resolve.segment import Model, PathSegment, PathState
from planner.resolve.sqp import SplinePath, given_prices, sigma_floor, start_track, whole
from planner.resolve.terms import model_of
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of

STEPS = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="12mm" height="6mm" viewBox="0 0 12 6">'
    '<path id="steps" d="M0,0 L4,0 L4,3 L8,3 L8,6 L12,6"/></svg>'
)
COLUMNS = ("bead", "samples", "price: ladder", "sqp", "nlp", "sqp / nlp", "s: sqp", "nlp", "nlp / sqp", "IPOPT")
REPEATS = 20


@dataclass(frozen=True)
class Case:
    """A bead of a problem, by its name; drawing: in place of the logo."""

    label: str
    bead: str
    overrides: tuple[str, ...] = ()
    drawing: str | None = None


CASES = (
    Case("letter B, one of its holes", "B.2"),
    Case("five square corners", "steps", ("layers.source.width_mm=12",), STEPS),
    Case("pin, tilt up to 15°", "wrist_pin", ("process.cones.nozzle_normal_deg=15",)),
    Case("pin", "wrist_pin"),
    Case("pin of the elbow", "elbow_pin"),
)


def ladders_path(case: Case, folder: Path) -> tuple[Cell, JointPath, ResolveSpec]:
    """What the ladder makes of a case's bead on its own."""
    overrides = ["layers.count=1", *case.overrides]
    if case.drawing is not None:
        (folder / "drawing.svg").write_text(case.drawing, encoding="utf-8")
        overrides.append(f"layers.source.svg={folder / 'drawing.svg'}")
    problem = load_problem("cylinder_logo", overrides)
    cell = build_cell(problem)
    tasks = tasks_of(problem, build_toolpath(problem))
    (task,) = (task for task in tasks if task.name == case.bead)
    return cell, ladder(cell, [task], problem.resolve)[0], problem.resolve


def start(cell: Cell, track: SplinePath, floor: float) -> tuple[Model, PathSegment, PathState]:
    """What a track's refinement begins with, in one window."""
    model = model_of(cell)
    stretch = whole(track.task, track.clock, track.basis, track.anchor)
    state = evaluate(model, stretch, track.c, track.q, floor)
    if state is None:
        raise RuntimeError("a ladder's path that its kernels cannot follow")
    return model, stretch, state


def compare(case: Case, folder: Path) -> tuple[float, float, float, float, float, NlpSolution, int]:
    """Price of the ladder, of sqp and its seconds, of nlp and its seconds; what IPOPT says; samples."""
    cell, path, settings = ladders_path(case, folder)
    given = given_prices(model_of(cell), [path], settings)
    floor = sigma_floor(given, settings)
    track = start_track(model_of(cell), settings.knot, floor, path, None)
    begin = start(cell, track, floor)
    sqp = refine_stretch(*begin).price  # compiles
    seconds = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        refine_stretch(*start(cell, track, floor))
        seconds.append(time.perf_counter() - started)
    started = time.perf_counter()
    solution = solve_nlp(cell, *begin)
    slow = time.perf_counter() - started
    return given[0][0], sqp, float(np.median(seconds)), solution.state.price, slow, solution, len(path.task)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    argparse.ArgumentParser(prog="python -m benchmarks.nlp", description=__doc__).parse_args(arguments)
    table = Table(*COLUMNS, title="one bead, from the ladder's path; prices in ms", title_justify="left")
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            ladder_price, sqp, fast, nlp, slow, solution, n = compare(case, Path(folder))
        prices = [f"{1e3 * price:.3f}" for price in (ladder_price, sqp, nlp)]
        times = [f"{fast:.3f}", f"{slow:.1f}", f"{slow / fast:.0f}"]
        table.add_row(case.label, str(n), *prices, f"{sqp / nlp:.4f}", *times, f"{solution.status} ({solution.steps})")
    Console(width=150).print(table)
    print(footer("casadi"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
