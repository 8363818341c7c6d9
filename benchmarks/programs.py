"""RAPID programs: what they demand of a controller, how close they stay to their plans when played, and how long writing,
reading and playing take.

python -m benchmarks.programs [PROBLEM ...] [--set layers.count=1] [--out programs.csv]

With --out both tables are written as one, with a row for each program, for `benchmarks.report --programs`.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from benchmarks.rows import BETWEEN, line_of
from benchmarks.usage import commit, machine
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError
from planner.export.in_step import laid_filament
from planner.export.moves import FitFigures, Moves, deposits, fit_of, plan_moves, rests_of
from planner.export.player.play import limited, play
from planner.export.rapid.extruder import event_samples
from planner.export.rapid.reader import read_rapid_stretches
from planner.export.rapid.writer import rapid_files
from planner.export.readback import judge
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem, shipped_problems

HARD = 16e-3  # s, of a move that is shorter than any controller's usual cycle of interpolation and look-ahead
ASKED: tuple[str, ...] = (
    "problem",
    "waypoints",
    "lines",
    "arcs",
    "joint moves",
    "targets/s on beads",
    "most in 1 s",
    "shortest",
)
ASKED += ("under least time", f"under {1e3 * HARD:g} ms", "wider", "off by", "turned by", "changes of speed")
PLAYED: tuple[str, ...] = (
    "problem",
    "path",
    "axis",
    "corner",
    "events",
    "late",
    "time laid",
    "worst bead",
    "slow moves",
)
PLAYED += ("write", "read", "play", "judge")
DIFFERENCES = "differences"
COLUMNS = (*ASKED, *PLAYED[1:], DIFFERENCES, "commit", "date", "machine")
WINDOW = 1.0  # s
Value = TypeVar("Value")


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """What a piece of work returns, and the time that it takes [s]."""
    start = time.perf_counter()
    out = work()
    return out, time.perf_counter() - start


def moves_of(plan: Plan) -> tuple[Moves, FitFigures]:
    """The moves that the plan's program in RAPID has, and how they fit."""
    style = plan.problem.program.style
    also = event_samples(plan.trajectory) if style == "socket" else None
    fed = laid_filament(plan.trajectory) if style != "output" else None
    moves = plan_moves(plan, also, fed, arcs=True)
    return moves, fit_of(plan, moves, fed)


def asked(plan: Plan) -> list[str]:
    """What a plan's program asks of a controller: as many cells as ASKED has, but for the problem's name."""
    moves, found = moves_of(plan)
    t, laid = plan.trajectory, moves.laid
    clock = rests_of(t, *deposits(t)).clock
    took = (moves.length / moves.speed)[laid]
    ends = clock[moves.sample[laid]]
    most = int((np.searchsorted(ends, ends + WINDOW - 1e-9) - np.arange(len(ends))).max(initial=0))
    changes = np.count_nonzero(np.diff(moves.speed[laid]))
    return [
        f"{sum(len(plan.toolpath.beads[k].s) for k in np.unique(t.bead[t.deposit])):,}",
        f"{np.count_nonzero(moves.linear & ~moves.circular):,}",
        f"{np.count_nonzero(moves.circular):,}",
        f"{np.count_nonzero(~moves.linear):,}",
        f"{len(took) / took.sum():.1f}",
        str(most),
        f"{1e3 * found.shortest:.1f} ms",
        f"{len(found.short):,}",
        f"{np.count_nonzero(took < HARD - 1e-9):,}",
        f"{len(found.wide):,}",
        f"{1e3 * found.off:.3f} mm",
        f"{np.degrees(found.turned):.3f}°",
        f"{changes:,}",
    ]


def rows(plan: Plan) -> Iterator[tuple[Plan, list[str], list[str]]]:
    """The plan of each nozzle while it is in use; how near its program is to it, as PLAYED has it, and what that does otherwise.

    Files are written and read for all of them at once.
    """
    files, writing = timed(lambda: rapid_files(plan))
    programs, reading = timed(lambda: read_rapid_stretches(files))
    for part, program in zip(plan.stretches, programs, strict=True):
        played, playing = timed(partial(play, program, part.cell))
        found, judging = timed(partial(judge, part, program, played))
        agreement = found.agreement
        cells = [
            f"{1e3 * agreement.path:.3f} mm",
            f"{np.degrees(agreement.axis):.3f}°",
            f"{1e3 * found.corner:.3f} mm",
            f"{1e3 * agreement.event:.4f} mm",
            f"{1e3 * agreement.late:.1f} ms",
            f"{100 * (found.laid - 1):+.2f} %",
            f"{100 * (found.worst - 1):+.1f} %",
            str(sum(each.moves for each in limited(program, played))),
            *(f"{seconds:.2f} s" for seconds in (writing, reading, playing, judging)),
        ]
        yield part, cells, found.differences()


def append_program(file: Path, cells: Sequence[str], differences: Sequence[str]) -> None:
    """Append a program's row to a table of COLUMNS, which begins with its header; cells: of ASKED and PLAYED.

    Raises InputError where the table has other columns.
    """
    if file.exists():
        read_programs(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as stream:
        if not stream.tell():
            stream.write(line_of(COLUMNS))
        now = time.strftime("%Y-%m-%dT%H:%M:%S")
        stream.write(line_of([*cells, BETWEEN.join(differences), commit(), now, machine()]))


def read_programs(file: Path) -> list[dict[str, str]]:
    """The rows of a table that `append_program` wrote. Raises InputError for anything else."""
    if not file.exists():
        raise InputError("there is no such file", file=file, hint="python -m benchmarks.programs --out writes one")
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for line, row in enumerate(rows, 2):
        if tuple(row) != COLUMNS or None in row.values():
            raise InputError("is no row of programs", file=file, line=line)
    return rows


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.programs", description=__doc__)
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", help="default: all that ship")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, metavar="FILE.csv", help="append a row of each program to this file")
    options = parser.parse_args(arguments)
    first = Table(*ASKED, title="What programs ask of a controller", title_justify="left")
    second = Table(*PLAYED, title="Programs as they are played, against their plans", title_justify="left")
    code = EXIT_VERIFIED
    for name in options.problems or shipped_problems():
        plan = solve(load_problem(name, options.set))
        for part, cells, differences in rows(plan):
            label = f"{name}, {part.cell.nozzle_name}" if len(plan.stretches) > 1 else name
            asks = asked(part)
            first.add_row(label, *asks)
            second.add_row(label, *cells)
            if options.out is not None:
                append_program(options.out, [label, *asks, *cells], differences)
            for difference in differences:
                Console(stderr=True).print(f"{label}: {difference}", markup=False)
                code = EXIT_NOT_VERIFIED
    for table in (first, second):
        Console(width=180).print(table)
    return code


if __name__ == "__main__":
    sys.exit(main())
