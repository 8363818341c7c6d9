"""Benchmark problems by name: shipped ones, files, and the peer cases with any number of waypoints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.peer_cases import CASES, write_case
from planner.base.errors import InputError, nearest_name
from planner.problem import Problem, load_problem, shipped_problems

AT = "@"  # peer_cap@10000: that case in so many waypoints
FEWEST, MOST = 50, 10_000_000
LARGE = tuple(f"{case}{AT}10000" for case in CASES)  # as the peers were measured
# A quick look: what the search tries is few and far between.
COARSE = (
    "resolve.rung_mm=10",
    "resolve.roll_step_deg=30",
    "resolve.table_step_deg=30",
    "resolve.knot_mm=5",
)


def all_problems() -> list[str]:
    """Names of the problems that ship, and of the peers' cases in full."""
    return [*shipped_problems(), *LARGE]


def load_named(name: str, settings: Sequence[str], folder: Path) -> Problem:
    """The problem of a name; files of its own are written into `folder`. Raises InputError with the nearest name."""
    case, at, count = name.partition(AT)
    if not at or Path(name).exists():
        return load_problem(name, settings)
    if case not in CASES:
        near = nearest_name(case, CASES)
        hint = f"did you mean {near}{AT}{count}?" if near else f"cases: {', '.join(CASES)}"
        raise InputError(f"there is no case {case!r}", field="--problems", hint=hint)
    if not count.isdecimal() or not FEWEST <= int(count) <= MOST:
        hint = f"a number of waypoints from {FEWEST} to {MOST}, such as {case}{AT}10000"
        raise InputError(f"{name!r} has no number of waypoints", field="--problems", hint=hint)
    return load_problem(write_case(case, int(count), folder), settings)


def coarse(problem: Problem) -> tuple[str, ...]:
    """Settings for a quick look at a problem: a coarse search, and one layer where the file counts layers."""
    return COARSE + (("layers.count=1",) if hasattr(problem.layers, "count") else ())
