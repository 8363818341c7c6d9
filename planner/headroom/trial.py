"""The plan tried where the part stands a little elsewhere than planned, and bounds to first order beside it.

The robot program runs in a work object. A part that stands elsewhere is measured and the work object corrected; the
nozzle then takes the same poses relative to the part, with the same table angles and on the same branch, by other
joint angles. Bounds to first order tell how far every joint moves within the whole tolerance (see `bounds`);
displacements on its edge are followed, timed, joined by the same travel and verified as the plan itself is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from planner.background import in_halves
from planner.cell import Cell
from planner.errors import PlannerError
from planner.headroom.bounds import first_order
from planner.headroom.elsewhere import beneath, displaced
from planner.plan import Check
from planner.plan.tolerance import NONE, Displacement, Headroom, Tolerance, Tried, Vector
from planner.problem import Problem
from planner.readonly import Array
from planner.resolve.jointpath import JointPath, flange_poses, refuse_at
from planner.toolpath.bead import Toolpath

AS_PLANNED = Displacement("as planned")
AXES = "xyz"
_TURN = 2.0 * np.pi


class Verified(Protocol):
    """What the verifier says of a motion."""

    @property
    def checks(self) -> tuple[Check, ...]:
        """All checks, by name."""

    @property
    def metrics(self) -> dict[str, float]:
        """All metrics, by name."""


Again = Callable[
    [Cell, Sequence[JointPath]], Verified
]  # times joint paths in a cell, carries travel along, and verifies


def headroom(
    tolerance: Tolerance,
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    paths: Sequence[JointPath],
    planned: Verified,
    again: Again,
    second_process: bool = False,
) -> Headroom:
    """Judge a plan's joint paths over a tolerance; what fails there is told, not raised.

    planned: what the verifier says of the plan itself; again: does so of its paths in another cell. With a second
    process the same comes sooner.
    """
    middle = middle_of(toolpath)
    bounds = first_order(cell, paths, tolerance, middle, problem.resolve.min_sigma)
    along = beneath(cell, toolpath, problem.collision.nozzle)
    elsewhere = displacements(tolerance)
    if elsewhere:
        elsewhere += tuple(bound.worst for bound in (bounds[0], bounds[-1]) if math.isfinite(bound.factor))

    def some(first: int, last: int) -> list[Tried]:
        cells = [displaced(cell, each.matrix(middle), along) for each in elsewhere[first:last]]
        return [_try(each, there, paths, again) for each, there in zip(elsewhere[first:last], cells, strict=True)]

    tried = [each for half in in_halves(some, len(elsewhere), second_process) for each in half]
    x, y, z = middle.tolist()
    return Headroom(tolerance, (x, y, z), bounds, (Tried(AS_PLANNED, planned.checks, planned.metrics), *tried))


def middle_of(toolpath: Toolpath) -> Array:
    """Middle (3) of the box around all that is printed, part frame [m]."""
    low = np.min([bead.points.min(axis=0) for bead in toolpath.beads], axis=0)
    high = np.max([bead.points.max(axis=0) for bead in toolpath.beads], axis=0)
    return np.asarray(0.5 * (low + high))


def displacements(tolerance: Tolerance) -> tuple[Displacement, ...]:
    """Displacements on the edge of a tolerance, always the same ones; none where it is 0.

    The whole shift along each axis, the whole turn about each, both ways (12); and eight corners, with shift and turn
    whole at once, their signs those of the fractional factorial design 2^(6-3): each two of the six come in all four
    combinations (Box and Hunter 1961). Those that are alike, because shift or turn is 0, are tried once.
    """
    out: dict[tuple[Vector, Vector], Displacement] = {}

    def add(shift: Sequence[float], turn: Sequence[float]) -> None:
        each = Displacement(
            _words(tolerance, shift, turn), _along(tolerance.shift, shift), _along(tolerance.turn, turn)
        )
        if (each.shift, each.turn) != (NONE, NONE):
            out.setdefault((each.shift, each.turn), each)

    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        only = [sign * (k == axis) for k in range(3)]
        add(only, NONE)
        add(NONE, only)
    for a, b, c in itertools.product((1.0, -1.0), repeat=3):
        add((a, b, c), (a * b, a * c, b * c))
    return tuple(out.values())


def _along(size: float, signs: Sequence[float]) -> Vector:
    """A vector of a length in the direction of signs (3), or 0."""
    length = math.hypot(*signs)
    x, y, z = (size * sign / length + 0.0 if length and size else 0.0 for sign in signs)
    return x, y, z


def _words(tolerance: Tolerance, shift: Sequence[float], turn: Sequence[float]) -> str:
    """What a displacement is called: how far along and about which axes."""
    parts = []
    if tolerance.shift and any(shift):
        parts.append(f"{tolerance.shift * 1e3:g} mm along {_axes(shift)}")
    if tolerance.turn and any(turn):
        parts.append(f"{math.degrees(tolerance.turn):g} deg about {_axes(turn)}")
    return ", ".join(parts)


def _axes(signs: Sequence[float]) -> str:
    return "".join(f"{'+' if sign > 0.0 else '-'}{axis}" for sign, axis in zip(signs, AXES, strict=True) if sign)


def _try(displacement: Displacement, elsewhere: Cell, paths: Sequence[JointPath], again: Again) -> Tried:
    try:
        report = again(elsewhere, [followed(elsewhere, path) for path in paths])
    except PlannerError as error:  # whatever the user would be told of a part that stands there
        return Tried(displacement, refusal=str(error))
    return Tried(displacement, report.checks, report.metrics)


def followed(cell: Cell, path: JointPath) -> JointPath:
    """The path with the same roll, tilt, chosen joints, branch and turns, its other joints as this cell asks for.

    Raises Refusal, with the place, where a pose is out of reach or a joint leaves its range.
    """
    na, redundant, solved = len(cell.arm), cell.inverse.redundant_joint, list(cell.solved)
    given = None if redundant is None else path.q[:, redundant]
    T_base_flange = flange_poses(cell, path.task, path.roll, path.tilt, path.q[:, na:])
    solutions, exists = cell.inverse.solve(T_base_flange, given)
    if not exists[:, path.branch].all():
        i = int(np.argmin(exists[:, path.branch]))
        missing = float(
            cell.inverse.out_of_reach(T_base_flange[i : i + 1], None if given is None else given[i : i + 1])[0]
        )
        refuse_at(path.task, i, "out of the arm's reach", missing)
    change = np.unwrap(solutions[:, path.branch][:, solved] - path.q[:, solved], axis=0)
    q = path.q.copy()
    q[:, solved] += change - _TURN * np.round(change[0] / _TURN)
    beyond = np.maximum(cell.limits.q_min - q, q - cell.limits.q_max)
    i, j = divmod(int(np.argmax(beyond)), beyond.shape[1])
    if beyond[i, j] > 0.0:
        refuse_at(path.task, i, f"{cell.joint_names[j]} leaves its range by {np.degrees(beyond[i, j]):.2f} deg")
    return replace(path, q=q)
