"""How many targets programs need for their waypoints, and how long it takes to write and read a long program.

python -m benchmarks.targets [PROBLEM ...] [--set program.chord_mm=0.02] [--long 180000]
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from benchmarks.repeated import repeated
from benchmarks.usage import peak_mb
from planner.base.errors import EXIT_VERIFIED
from planner.export.languages import LANGUAGES
from planner.export.moves import Moves, deposits, plan_moves, rests_of, way_of
from planner.export.primitives import TERMS, misfits
from planner.export.rapid.reader import read_rapid_files
from planner.export.rapid.writer import rapid_files
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem

USUAL = ("peer_cap", "fibre_plane", "hemisphere_honeycomb")  # solved in seconds
COLUMNS = ("problem", "waypoints", "moves", "along beads", "waypoints each", "below 0.6 mm", "limited by", "time")
USED = 0.7  # of a tolerance: a move that uses less of all of them ends where it must
NARROW = 0.6e-3  # m: twice the smallest zone


def row(plan: Plan) -> list[str]:
    """Cells of one plan: its waypoints, and what stands for them."""
    start = time.process_time()
    moves = plan_moves(plan, arcs=True)
    took = time.process_time() - start
    length = moves.length[moves.laid]
    waypoints = sum(len(bead.points) for bead in plan.beads)
    narrow = f"{np.count_nonzero(length < NARROW):,}"
    each = f"{waypoints / len(length):.2f}"
    by = ", ".join(f"{name} {count:,}" for name, count in limits(plan, moves).items() if count)
    return [f"{waypoints:,}", f"{len(moves):,}", f"{len(length):,}", each, narrow, by, f"{took:.2f} s"]


def limits(plan: Plan, moves: Moves) -> dict[str, int]:
    """How many moves along beads each tolerance keeps from being longer: the one that a move uses up most."""
    t = plan.trajectory
    way = way_of(plan, rests_of(t, *deposits(t)))
    aim = way.pose.copy()
    aim[moves.start], aim[moves.sample] = moves.targets.table[:-1], moves.targets.table[1:]
    own = np.flatnonzero(moves.laid)
    used = misfits(
        way._replace(aim=aim), moves.start[own], moves.sample[own], moves.circular[own], moves.via.position[own]
    )
    most = np.where(used.max(axis=1) >= USED, used.argmax(axis=1), len(TERMS))
    counts = np.bincount(most, minlength=len(TERMS) + 1).tolist()
    return dict(zip((*TERMS, "ends"), counts, strict=True))


def long_program(plan: Plan, targets: int) -> str:
    """How long a program takes to write, to read and to be held against the plan [s of CPU], and how much memory."""
    plan = repeated(plan, math.ceil(targets / len(plan_moves(plan, arcs=True))))
    before, start = peak_mb(), time.process_time()
    files = rapid_files(plan)
    writing = time.process_time() - start
    start = time.process_time()
    count = len(read_rapid_files(files).linear)
    reading = time.process_time() - start
    start = time.process_time()
    differences = LANGUAGES["rapid"].differences(plan, files)
    judging = time.process_time() - start
    size = sum(map(len, files.values())) / 1e6
    modules = sum(name.endswith(".mod") for name in files)
    return (
        f"{count:,} targets of {len(plan.trajectory):,} samples in {modules} modules, {size:.0f} MB: written in "
        f"{writing:.1f} s, read in {reading:.1f} s, held against the plan in {judging:.1f} s of CPU "
        f"({len(differences)} differences); {peak_mb() - before:.0f} MB more than the plan at most"
    )


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.targets", description=__doc__)
    parser.add_argument(
        "problems", nargs="*", default=USUAL, help="problems; default: three that are solved in seconds"
    )
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of all problems")
    parser.add_argument("--long", type=int, default=0, metavar="TARGETS", help="and a program of so many targets")
    options = parser.parse_args(arguments)
    out = Console(width=140, highlight=False)
    table = Table()
    for k, column in enumerate(COLUMNS):
        table.add_column(column, justify="right" if k else "left")
    for name in options.problems:
        plan = solve(load_problem(name, options.set))
        table.add_row(name, *row(plan))
    out.print(table)
    if options.long:
        out.print(long_program(plan, options.long))
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
