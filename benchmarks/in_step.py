"""How far the extruder's board and the robot are out of step at both ends of each bead, in simulation.

python -m benchmarks.in_step [PROBLEM ...] [--set layers.count=1]

The board reads the file written for it (planner/simulate/board_file.py); the robot switches its outputs when the plan
does, or 5 % slower. A board at rest moves filament from rest to rest at 1,500 mm/s2.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.base.arrays import Array
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, PlannerError
from planner.export.extruder import gcode
from planner.export.in_step import stretches
from planner.export.moves import deposits
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.problem.settings import BoardSpec
from planner.simulate.board_file import FileBoard, Output, Printed, print_file

SLOWER = 1.05  # times as long as planned
ACCELERATION = 1500.0  # mm/s^2
JOINS, RESTS = FileBoard(), FileBoard("reprap", ACCELERATION)
_BEAD = re.compile(r"; bead ([0-9]+), layer [0-9]+")


@dataclass(frozen=True)
class Case:
    """A file, the board that prints it, and how many times as long as planned the robot takes."""

    words: str
    spec: Mapping[str, object]
    board: FileBoard = JOINS
    slower: float = 1.0


_FREE, _TOLD = {"sync": "free"}, {"rests": True, "acceleration_mm_s2": ACCELERATION}
CASES = (
    Case("free", _FREE),
    Case("free, robot 5 % slower", _FREE, slower=SLOWER),
    Case("free, board rests", _FREE, RESTS),
    Case("in step", {}),
    Case("in step, robot 5 % slower", {}, slower=SLOWER),
    Case("in step, board rests", _TOLD, RESTS),
    Case("in step, board rests, robot 5 % slower", _TOLD, RESTS, SLOWER),
    Case("in step, board rests, file not told so", {}, RESTS),
    Case("in step, Marlin", {"firmware": "marlin"}, FileBoard("marlin")),
    Case("in step, Marlin, robot 5 % slower", {"firmware": "marlin"}, FileBoard("marlin"), SLOWER),
)


@dataclass(frozen=True)
class Apart:
    """By how much (k beads) [s] the board is behind the robot where a bead begins and ends; filament that the board moved
    beyond the plan's, as a share; and what the board did."""

    begin: Array
    end: Array
    extra: float
    printed: Printed


def apart(plan: Plan, case: Case) -> Apart:
    """Run the file of a plan beside the robot."""
    its = for_board(plan, BoardSpec.model_validate(case.spec))
    text, t = gcode(its), plan.trajectory
    edges: dict[int, list[list[float]]] = {}
    for each in stretches(its):
        ons, offs = edges.setdefault(each.number, [[], []])
        ons.append(case.slower * each.on)
        offs.append(case.slower * each.off)
    inputs = {number: Output(np.array(ons), np.array(offs)) for number, (ons, offs) in edges.items()}
    printed = print_file(text, case.board, inputs)
    own: dict[int, list[float]] = {}
    bead, of_line = -1, []
    for line in text.splitlines():
        if line.startswith(";"):
            match = _BEAD.fullmatch(line)
            bead = int(match[1]) if match else -1
        of_line.append(bead)
    for move in printed.moves:
        if (k := of_line[move.line - 1]) >= 0:
            own.setdefault(k, [move.start, move.end])[1] = move.end
    first, last = deposits(t)
    times: dict[int, list[float]] = {}
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        times.setdefault(int(t.bead[a]), [float(t.t[a] - t.t[0]), 0.0])[1] = float(t.t[b] - t.t[0])
    missing = [float("inf"), float("inf")]
    found = np.array([own.get(k, missing) for k in times]) - case.slower * np.array(list(times.values()))
    planned = float(t.feed[-1] - t.feed[0]) * 1e3
    return Apart(found[:, 0], found[:, 1], sum(move.amount for move in printed.moves) / planned - 1.0, printed)


def for_board(plan: Plan, board: BoardSpec) -> Plan:
    """The same plan for another board."""
    program = plan.problem.program.model_copy(update={"board": board})
    if isinstance(plan.problem, SimpleNamespace):
        return replace(plan, problem=cast("Any", SimpleNamespace(**vars(plan.problem) | {"program": program})))
    return replace(plan, problem=plan.problem.model_copy(update={"program": program}))


def table(plan: Plan) -> Table:
    """A row for each case."""
    found = Table(title=f"{plan.name}: {len(plan.beads)} beads, {plan.t[-1] - plan.t[0]:.1f} s; the board is behind by")
    columns = ("begin, mean, ms", "worst, ms", "end, mean, ms", "worst, ms", "filament", "all over at, s")
    found.add_column("file, board, robot")
    for column in columns:
        found.add_column(column, justify="right")
    for case in CASES:
        each = apart(plan, case)
        cells = [f"{1e3 * value:+.1f}" for ends in (each.begin, each.end) for value in (ends.mean(), worst(ends))]
        found.add_row(case.words, *cells, f"{100 * each.extra:+.2f} %", f"{each.printed.end:.2f}")
    return found


def worst(ends: Array) -> float:
    """The one of the greatest size."""
    return float(ends[np.argmax(np.abs(ends))])


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table for each problem; 1 if one cannot be planned."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.in_step", description=__doc__)
    parser.add_argument("problems", nargs="*", default=["cylinder_logo"])
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(arguments)
    code = EXIT_VERIFIED
    for name in options.problems:
        try:
            plan = solve(load_problem(name, options.set), baseline=False)
        except PlannerError as error:
            print(error, file=sys.stderr)
            code = EXIT_NOT_VERIFIED
            continue
        Console(width=140).print(table(plan))
    return code


if __name__ == "__main__":
    sys.exit(main())
