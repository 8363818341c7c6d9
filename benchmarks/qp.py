"""Our own quadratic-program solver compared with OSQP and Clarabel, on the programs of the logo's hardest beads.

python -m benchmarks.qp
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import clarabel
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import sparse

from benchmarks.usage import footer
from planner.cell.cell import build_cell
from planner.problem import load_problem
from planner.resolve.ladder import ladder
from planner.resolve.quadratic import QuadraticProgram, Solution, solve_qp
from planner.resolve.reference.osqp import solve_with_osqp, standard_form
from planner.resolve.refine import QPSolver, evaluate, refine_stretch
from planner.resolve.sqp import given_prices, sigma_floor, start_track, whole
from planner.resolve.terms import model_of
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of

BEADS = 4  # the costliest ones
MOST_CONTROLS = 200  # in one program, as in the refinement
COLUMNS = ("bead", "variables", "rows", "programs", "solver", "s a program", "iterations", "worse than the best")


def solve_with_clarabel(qp: QuadraticProgram) -> Solution:
    """As `solve_qp`, by Clarabel: a general interior-point method for sparse programs."""
    P, c, A, low, high = standard_form(qp)
    above, below = np.isfinite(high), np.isfinite(low)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    rows = sparse.vstack([A[above], -A[below]], format="csc")
    cones = [clarabel.NonnegativeConeT(rows.shape[0])]
    solution = clarabel.DefaultSolver(P, c, rows, np.concatenate([high[above], -low[below]]), cones, settings).solve()
    return Solution(np.clip(np.asarray(solution.x[: len(qp.g)]), -qp.box, qp.box), int(solution.iterations))


SOLVERS: dict[str, QPSolver] = {
    "interior_point": solve_qp,
    "OSQP": solve_with_osqp,
    "Clarabel": solve_with_clarabel,
}


def programs() -> list[tuple[str, list[QuadraticProgram]]]:
    """The programs that the refinement of the costliest beads solves on its way, by bead."""
    problem = load_problem("cylinder_logo", ["layers.count=1"])
    cell = build_cell(problem)
    settings = problem.resolve
    tasks = tasks_of(problem, build_toolpath(problem))
    paths = ladder(cell, tasks, settings)
    model = model_of(cell)
    given = given_prices(model, paths, settings)
    floor = sigma_floor(given, settings)
    out: list[tuple[str, list[QuadraticProgram]]] = []
    for i in sorted(given, key=lambda i: -given[i][0]):
        track = start_track(model, settings.knot, floor, paths[i], None)
        stretch = whole(track.task, track.clock, track.basis, track.anchor)
        state = evaluate(model, stretch, track.c, track.q, floor)
        if state is None or len(track.c) > MOST_CONTROLS:
            continue
        seen: list[QuadraticProgram] = []
        refine_stretch(model, stretch, state, _recording(seen))
        out.append((track.task.name, seen))
        if len(out) == BEADS:
            break
    return out


def _recording(seen: list[QuadraticProgram]) -> QPSolver:
    def solve(qp: QuadraticProgram) -> Solution:
        seen.append(qp)
        return solve_qp(qp)

    return solve


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    argparse.ArgumentParser(prog="python -m benchmarks.qp", description=__doc__).parse_args(arguments)
    table = Table(*COLUMNS, title="programs on the way of the refinement; medians", title_justify="left")
    for name, qps in programs():
        values = {}
        seconds, steps = {}, {}
        for label, solve in SOLVERS.items():
            results, times = [], []
            for qp in qps:
                start = time.perf_counter()
                results.append(solve(qp))
                times.append(time.perf_counter() - start)
            values[label] = np.array([qp.value(found.x) for qp, found in zip(qps, results, strict=True)])
            seconds[label], steps[label] = np.median(times), np.median([found.steps for found in results])
        at_rest = np.array([qp.value(np.zeros(len(qp.g))) for qp in qps])
        best = np.min(list(values.values()), axis=0)
        for label in SOLVERS:
            share = np.max((values[label] - best) / np.maximum(at_rest - best, 1e-12))
            size = (
                (name, str(len(qps[0].g)), str(len(qps[0].b)), str(len(qps))) if label == "interior_point" else [""] * 4
            )
            table.add_row(*size, label, f"{seconds[label]:.4f}", f"{steps[label]:.0f}", f"{100 * share:.3f} %")
    Console(width=130).print(table)
    print("worse than the best: the largest of all programs, as a share of the descent")
    print(footer("osqp", "clarabel"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
