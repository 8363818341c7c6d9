"""Interlayer times of prints in several layers: as they are, with waits alone, and in an order that suits a window.

python -m benchmarks.thermal [PROBLEM …]

Each print is first planned without a window. Its window follows from the median interlayer time of its places: 0.7 to 1.7
of it, or to 2.5 where layers cross each other, because each line then lies on old and on fresh ones. The order that travels
least breaks the window, since ages range from zero to twice the median where it reverses from layer to layer. Then the same
joint paths get the waits that the least age requires, and nothing else; and the print is planned again with the window.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from planner.base.command_line import one_of
from planner.base.errors import Refusal
from planner.collision.print_body import print_body, standing
from planner.collision.scene import obstacles_of
from planner.plan import Plan
from planner.planning.pipeline import solve, trajectory_of
from planner.problem import Problem, load_problem
from planner.verify.verdict import verify

LEAST, MOST, CROSSING = 0.7, 1.7, 2.5  # of the median age


@dataclass(frozen=True)
class StackedPrint:
    """A shipped problem in several layers: its changes, and the window's end as a share of its median age."""

    changes: tuple[str, ...] = ()
    most: float = MOST


CASES = {
    "cylinder_logo": StackedPrint(("layers.count=4",)),
    "hemisphere_honeycomb": StackedPrint(("layers.count=6",)),
    "aerofoil_core": StackedPrint(("layers.source.size_mm=[30, 99]",)),
    "aerofoil_core_tapered": StackedPrint(("layers.source.size_mm=[40, 85]",)),
    "fibre_plane": StackedPrint(("layers.count=3",)),
    "curved_plate": StackedPrint(("layers.count=3",)),
    "saddle_ring": StackedPrint(most=CROSSING),
    "planar_gcode": StackedPrint(most=CROSSING),
    "naca0015_wing": StackedPrint(most=CROSSING),
}
HEAD = (
    "print",
    "layers",
    "window, s",
    "as it is: print, s",
    "ages, s",
    "waits alone: print, s",
    "ages, s",
    "verified",
    "with its order: print, s",
    "ages, s",
    "verified",
)


@dataclass(frozen=True)
class Outcome:
    """A print in time: all of it, and the least, the median and the greatest age [s]; what does not hold."""

    time: float
    ages: tuple[float, float, float]
    failed: tuple[str, ...]

    @staticmethod
    def of(metrics: Mapping[str, float], failed: Sequence[str]) -> Outcome:
        """From what the verifier says."""
        ages = tuple(metrics[f"interlayer_time_{which}_s"] for which in ("min", "median", "max"))
        return Outcome(metrics["print_time_s"], (ages[0], ages[1], ages[2]), tuple(failed))

    @property
    def ages_words(self) -> str:
        """The three ages."""
        return " / ".join(f"{age:.1f}" for age in self.ages)

    @property
    def verdict(self) -> str:
        """Yes, or which checks do not hold."""
        return "yes" if not self.failed else "no: " + ", ".join(self.failed)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "problems", nargs="*", type=one_of(list(CASES)), metavar="PROBLEM", help=f"of {', '.join(CASES)} (default all)"
    )
    args = parser.parse_args(argv)
    print("| " + " | ".join(HEAD) + " |")
    print("|" + "---|" * len(HEAD), flush=True)
    for name in args.problems or list(CASES):
        begin = time.perf_counter()
        print("| " + " | ".join(row(name)) + " |", flush=True)
        print(f"{name}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)
    return 0


def row(name: str) -> list[str]:
    """A line of the table: a shipped problem as it is, and with its window."""
    case = CASES[name]
    plain = solve(load_problem(name, case.changes), baseline=False)
    as_it_is = outcome(plain)
    window = [round(share * as_it_is.ages[1], 1) for share in (LEAST, case.most)]
    key = f"process.interlayer_time={{least_s: {window[0]}, most_s: {window[1]}}}"
    problem = load_problem(name, (*case.changes, key))
    cells = [name, str(plain.layers), f"{window[0]} to {window[1]}", f"{as_it_is.time:.0f}", as_it_is.ages_words]
    for made in (lambda: with_waits(plain, problem), lambda: outcome(solve(problem, baseline=False))):
        try:
            each = made()
        except Refusal as refusal:
            cells += ["–", "–", f"no plan: {refusal}"]
            continue
        cells += [f"{each.time:.0f} (+{each.time - as_it_is.time:.0f})", each.ages_words, each.verdict]
    return cells


def outcome(plan: Plan) -> Outcome:
    """What became of a plan."""
    return Outcome.of(plan.metrics, [check.name for check in plan.checks if not check.ok])


def with_waits(plain: Plan, problem: Problem) -> Outcome:
    """The plan's beads, in its order, with the waits that the problem's window asks for."""
    body = print_body(plain.toolpath, standing(plain.cell))
    obstacles = obstacles_of(problem, plain.cell, plain.toolpath, body)
    dt = plain.trajectory.dt
    trajectory, _ = trajectory_of(problem, plain.cell, plain.toolpath, plain.paths, obstacles, dt, second_process=False)
    report = verify(problem, plain.cell, plain.toolpath, trajectory, body)
    return Outcome.of(report.metrics, [check.name for check in report.checks if not check.ok])


if __name__ == "__main__":
    sys.exit(main())
