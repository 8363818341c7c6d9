"""The optimiser's ideas, one by one, and how each is switched off to see what it buys.

Most are settings of a problem, or strategies. The others are constants and functions of a module, replaced for the
duration of a run in its own process; compiled loops that contain them are compiled again there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
from numba import njit

from planner.cell.cell import build_cell
from planner.problem import Problem
from planner.resolve import ladder, price_kernels, prices, refine, search, sqp, terms
from planner.resolve.nodes import full_grid
from planner.resolve.quadratic import QuadraticProgram

_ENDLESS = 10**9  # control values: more than any bead has
# A squared penalty costs as much as the exact one where a tenth of the time is lost; between these slacks it is linear.
_AS_DEAR_AT = 0.1
_KNOTS = np.array([0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0])
_BENDS = np.diff((_KNOTS[1:] + _KNOTS[:-1]) / _AS_DEAR_AT, prepend=0.0)  # of the slope, at each knot but the last
_HARD_SHARE = 0.1  # of HARD_PRICE: what is dearer is a bound, not lost time


def _put(stack: ExitStack, module: ModuleType, name: str, value: Any) -> None:
    """Put a value in the place of a module's own, which must be there, until the stack is left."""
    stack.enter_context(patch.object(module, name, value))


def _compile_anew(stack: ExitStack, module: ModuleType, names: Sequence[str], users: Sequence[ModuleType]) -> None:
    """Compile functions of a module anew, those that are called first, also where other modules have them by name."""
    for name in names:
        fresh = njit(nogil=True, error_model="numpy")(getattr(module, name).py_func)
        for each in (module, *(user for user in users if hasattr(user, name))):
            _put(stack, each, name, fresh)


@contextmanager
def _one_window(problem: Problem) -> Iterator[None]:
    with ExitStack() as stack:
        _put(stack, sqp, "WINDOW", _ENDLESS)
        yield


@contextmanager
def _windows_apart(problem: Problem) -> Iterator[None]:
    with ExitStack() as stack:
        _put(stack, sqp, "OVERLAP", 0)
        yield


@contextmanager
def _cold_layers(problem: Problem) -> Iterator[None]:
    known = sqp.start_track

    def alone(model: Any, knot: float, floor: float, path: Any, below: Any) -> Any:
        return known(model, knot, floor, path, None)

    with ExitStack() as stack:
        _put(stack, sqp, "start_track", alone)
        yield


@contextmanager
def _loose_ends(problem: Problem) -> Iterator[None]:
    with ExitStack() as stack:
        _put(stack, terms, "ANCHOR", 0.0)
        yield


@contextmanager
def _free_peaks(problem: Problem) -> Iterator[None]:
    with ExitStack() as stack:
        _put(stack, refine, "PEAK", math.inf)
        yield


@contextmanager
def _free_travel(problem: Problem) -> Iterator[None]:
    with ExitStack() as stack:
        _put(stack, search, "TRAVEL_PRICE", 0.0)
        _compile_anew(stack, search, ("travel_price", "_from_travel", "search_best"), ())
        yield


@contextmanager
def _home_branch(problem: Problem) -> Iterator[None]:
    cell = build_cell(problem)
    branch = int(cell.inverse.branches(cell.home[None, : len(cell.arm)])[0])

    def of_one_branch(*given: Any) -> Any:
        grid = full_grid(*given)
        return replace(grid, branch=np.full((len(grid.branch), 1), branch))

    with ExitStack() as stack:
        _put(stack, ladder, "full_grid", of_one_branch)
        yield


@njit
def _flat(slack: float) -> float:
    return slack


@njit
def _slope_of_flat(slack: float) -> float:
    return 1.0


@njit
def _squared(slack: float) -> float:
    total = 0.0
    for k in range(_BENDS.size):
        total += _BENDS[k] * max(0.0, slack - _KNOTS[k])
    return total


def _penalty(stack: ExitStack, lost: Any) -> None:
    """Another price of lost time, in the price of a path and in the program around it."""
    _put(stack, price_kernels, "lost", lost)
    _put(stack, price_kernels, "lost_slope", _slope_of_flat)
    _compile_anew(stack, price_kernels, ("price_time_lost", "rows_of_rates"), (terms,))


@contextmanager
def _flat_penalty(problem: Problem) -> Iterator[None]:
    with ExitStack() as stack:
        _penalty(stack, _flat)
        yield


@contextmanager
def _squared_penalty(problem: Problem) -> Iterator[None]:
    known = refine.program_around

    def bent(*given: Any) -> QuadraticProgram:
        return with_bends(known(*given), _HARD_SHARE * prices.HARD_PRICE)

    with ExitStack() as stack:
        _penalty(stack, _squared)
        _put(stack, refine, "program_around", bent)
        yield


def with_bends(qp: QuadraticProgram, hard: float) -> QuadraticProgram:
    """The program with the price of its slacks bent upwards; groups dearer than `hard` stay as they are."""
    sizes = np.diff(qp.group)
    copies = np.where(qp.price < hard, len(_BENDS), 1)
    whose = np.repeat(np.arange(len(sizes)), copies)  # group of each copy
    bend = np.arange(len(whose)) - np.repeat(np.cumsum(copies) - copies, copies)
    lengths = sizes[whose]
    group = np.concatenate([[0], np.cumsum(lengths)])
    row = np.arange(group[-1]) - np.repeat(group[:-1], lengths) + np.repeat(qp.group[whose], lengths)
    soft = copies[whose] > 1
    shift = np.where(soft, _KNOTS[bend], 0.0)
    price = qp.price[whose] * np.where(soft, _BENDS[bend], 1.0)
    return replace(qp, A=qp.A[row], b=qp.b[row] + np.repeat(shift, lengths), at=qp.at[row], group=group, price=price)


def _always(problem: Problem) -> bool:
    return True


def _has_table(problem: Problem) -> bool:
    return problem.cell.positioner is not None and bool(problem.cell.positioner.free)


def _has_layers(problem: Problem) -> bool:
    return getattr(problem.layers, "count", 1) > 1


@dataclass(frozen=True)
class Idea:
    """A run beside the one with everything on: what is different, in words and in fact, and where that makes sense."""

    name: str
    how: str
    settings: tuple[str, ...] = ()
    strategy: str = "sqp"
    change: Callable[[Problem], Any] | None = None
    where: Callable[[Problem], bool] = _always


def _tilt(degrees: int) -> Idea:
    setting = f"process.cones.nozzle_normal_deg={degrees}"
    return Idea(f"tilt up to {degrees}°", f"`--set {setting}`", (setting,))


FROZEN, NO_TABLE = "table frozen", "cell.positioner.free=[]"
# Where a table is held that would else stand at 0: of every 30 degrees only 150 and 180 let the whole logo be reached.
HELD = {"cylinder_logo": ("cell.positioner.held_deg.rotation=165",)}
IDEAS = (
    Idea("everything on", "as it comes"),
    Idea("no refinement", "`--strategy ladder`", strategy="ladder"),
    Idea("nothing looked ahead", "`--strategy greedy`", strategy="greedy"),
    Idea("one roll, one table angle", "`--strategy fixed`", strategy="fixed"),
    Idea("all to the table", "`--strategy as_published`", strategy="as_published"),
    Idea(FROZEN, f"`--set {NO_TABLE}`, the logo facing the arm", (NO_TABLE,), where=_has_table),
    Idea("home's branch only", "`ladder.full_grid` gives no other branch", change=_home_branch),
    Idea("travel free", "`search.TRAVEL_PRICE` 0", change=_free_travel),
    Idea("ends not held", "`terms.ANCHOR` 0", change=_loose_ends),
    Idea("joints may peak", "`refine.PEAK` without end", change=_free_peaks),
    Idea("one window", "`sqp.WINDOW` without end", change=_one_window),
    Idea("windows side by side", "`sqp.OVERLAP` 0", change=_windows_apart),
    Idea("exact penalty, shallow dips not avoided", "`price_kernels.lost` is the slack itself", change=_flat_penalty),
    Idea(
        "squared penalty",
        f"`price_kernels.lost` is the slack squared over {_AS_DEAR_AT:g}, in {len(_BENDS)} pieces",
        change=_squared_penalty,
    ),
    Idea("layers start cold", "`sqp.start_track` is not given the bead below", change=_cold_layers, where=_has_layers),
    _tilt(5),
    _tilt(10),
    _tilt(15),
)
NAMES = tuple(idea.name for idea in IDEAS)
# Whatever has no switch, and why.
NOT_SWITCHED = (
    "guide and corridor of the ladder: a full dense grid does not fit into memory",
    "exact kinematics of every waypoint: nothing else would be verified",
    "clearance in the search: without it plans fail the verifier on most problems, and say nothing about speed",
    "minimal dips of the timing: all strategies share it",
)


@contextmanager
def changed(name: str, problem: Problem) -> Iterator[None]:
    """Within it the idea of that name is switched off, for that problem."""
    idea = IDEAS[NAMES.index(name)] if name else IDEAS[0]
    if idea.change is None:
        yield
    else:
        with idea.change(problem):
            yield
