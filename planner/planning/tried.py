"""A refusal's hints, tried: each change is planned to the end, and suggested only if that gives a verified plan.

A search that finds a way with a change has not yet timed, refined or verified anything. Large prints take too long to
be planned for every hint: their hints say that only the search has been tried.
"""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable
from pathlib import Path

from planner.base.errors import Change, Hints, InputError, MovedBy, Refusal
from planner.base.shipped import PROBLEMS
from planner.plan import Plan
from planner.problem import Problem
from planner.problem.layers import WaypointLayersSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.task import noise_of
from planner.toolpath.waypoints.beads import NOTED
from planner.toolpath.waypoints.surfels import other_height

MOST_WAYPOINTS = 20_000  # planned at most, for all hints of a refusal together,
MOST_PLANS = 6  # in at most so many plans,
MOST_SECONDS = 120.0  # s after which no further plan is begun
_UNTRIED = "not planned to the end"
_HEIGHT = "process.bead.height_mm"
_SMOOTHING = "layers.source.smooth_normals_deg"
_SMOOTHINGS = ("1", "3")  # deg
_ORIGIN, _BASE = "cell.positioner.origin_mm", "cell.positioner.base_mm"

PlanOf = Callable[[Problem], Plan]  # raises Refusal or InputError


def hints_that_hold(
    problem: Problem,
    toolpath: Toolpath,
    hints: Hints,
    plan: PlanOf,
    best: PlanOf | None = None,
    otherwise: Hints = (),
) -> Hints:
    """Hints whose changes give a verified plan, with how it prints; hints that are no changes; and hints marked as
    untried, if the print is too large to try them.

    best: plans by the default strategy, if another one's plan was refused
    otherwise: hints to give if no change gives a verified plan
    """
    own = (_by_base(hint) if _has_base(problem) else hint for hint in hints)
    hints = (*_other_side(problem, toolpath), *_other_height(problem, toolpath), *own, *_smoothing(problem, toolpath))
    waypoints = toolpath.waypoints
    left, told, holds = min(MOST_PLANS, MOST_WAYPOINTS // waypoints), [], False
    end = time.monotonic() + MOST_SECONDS
    if best is not None and left:
        left -= 1
        found = _verified(problem, (), best)
        if found is not None:
            told.append(_told(f"strategy: {found.strategy}", found))
            holds = True
    for hint in hints:
        if not isinstance(hint, Change):
            told.append(hint)
            continue
        for what, fields in hint.tries:
            if not left or time.monotonic() > end:
                told.append(f"{hint} ({_UNTRIED})")
                break
            left -= 1
            found = _verified(problem, fields, plan)
            if found is not None:
                told.append(_told(what, found))
                holds = True
                break
    return tuple(told) if holds else (*told, *otherwise)


def other_places(problem: Problem) -> Hints:
    """A hint to the command that finds another place for the part; none for arrays, which it cannot take."""
    layers = problem.layers
    if isinstance(layers, WaypointLayersSpec) and not isinstance(layers.source.waypoints, Path):
        return ()
    name = problem.file.stem if problem.file.parent == PROBLEMS else str(problem.file)
    sets = [word for text in problem.overrides for word in ("--set", text)]
    command = shlex.join(["python", "-m", "planner.place", name, *sets])
    return (f"{command} looks for a place from which the whole part can be printed",)


def _told(what: str, found: Plan) -> str:
    return f"{what} gives a verified plan, at speed on {found.metrics['at_speed_fraction']:.1%} of the length"


def _verified(problem: Problem, fields: tuple[tuple[str, object], ...], plan: PlanOf) -> Plan | None:
    """A verified plan of the problem with fields changed; None if there is none."""
    try:
        found = plan(problem.changed([_setting(problem, *each) for each in fields]))
    except (Refusal, InputError):
        return None
    return found if found.verified else None


def _setting(problem: Problem, field: str, value: object) -> str:
    """A field's new value in the form that `--set` takes."""
    if not isinstance(value, MovedBy):
        return f"{field}={value}"
    carrier = problem.cell.positioner
    now = problem.cell.bed if carrier is None else carrier.base if field == _BASE else carrier.origin
    there = [round(1e3 * a + by, 6) for a, by in zip(now or (0.0, 0.0, 0.0), value.vector, strict=True)]
    return f"{field}={there}"


def _has_base(problem: Problem) -> bool:
    """Whether the file gives the place of the positioner's base, and not of the plate's centre."""
    return problem.cell.positioner is not None and problem.cell.positioner.base is not None


def _by_base(hint: str) -> str:
    """A hint with the key of the positioner's base instead of that of its plate's centre."""
    if not isinstance(hint, Change):
        return hint
    tries = tuple(
        (what.replace(_ORIGIN, _BASE), tuple((_BASE if field == _ORIGIN else field, value) for field, value in fields))
        for what, fields in hint.tries
    )
    return Change(hint.replace(_ORIGIN, _BASE), tries)


def _other_side(problem: Problem, toolpath: Toolpath) -> Hints:
    """A hint to reverse a file's normals, if they point down on the whole."""
    layers = problem.layers
    if not isinstance(layers, WaypointLayersSpec) or sum(bead.normals[:, 2].mean() for bead in toolpath.beads) >= 0.0:
        return ()
    other = "outward" if layers.source.normals == "inward" else "inward"
    what = f"layers.source.normals: {other} (they mostly point down)"
    return (Change(what, ((what, (("layers.source.normals", other),)),)),)


def _other_height(problem: Problem, toolpath: Toolpath) -> Hints:
    """A hint with the bead height of a file's layers, if the problem has another one."""
    layers, height = problem.layers, problem.process.bead.height
    if not isinstance(layers, WaypointLayersSpec):
        return ()
    told = any((bead.height != height).any() for bead in toolpath.beads) and not toolpath.beads[0].round
    apart = None if told else other_height(toolpath.beads, height)
    if apart is None:
        return ()
    what = f"{_HEIGHT}: {apart * 1e3:.2g} (the spacing of the file's layers)"
    return (Change(what, ((what, ((_HEIGHT, f"{apart * 1e3:.2g}"),)),)),)


def _smoothing(problem: Problem, toolpath: Toolpath) -> Hints:
    """A hint to smooth noisy normals, if the problem forbids it."""
    layers = problem.layers
    if (
        not isinstance(layers, WaypointLayersSpec)
        or layers.source.smoothing != 0.0
        or noise_of(toolpath.beads)[0] <= NOTED
    ):
        return ()
    tries = tuple((f"{_SMOOTHING}: {deg}", ((_SMOOTHING, deg),)) for deg in _SMOOTHINGS)
    return (Change(f"{_SMOOTHING}: {_SMOOTHINGS[-1]} smooths noisy normals", tries),)
