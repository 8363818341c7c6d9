"""Which coordinates of a placement are searched, and between what: from the options, or from the arm's reach."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planner.cell import Cell
from planner.errors import InputError, nearest_name
from planner.placement.freedom import ANGLES, FREEDOMS, ON_A_TABLE, Place
from planner.placement.search import Axis
from planner.problem import Problem

_REACH_SHARE = 0.5  # of the reach, to each side of where the part stands
_PLATE_SHARE = 0.1  # of the reach, likewise, for a part on its plate
_FINEST = {False: 10e-3, True: math.radians(5.0)}  # m and rad between lattice points
_GRAIN = {False: 1e-3, True: math.radians(1.0)}  # m and rad, to which placements are rounded
_COUNTS = {"x": 9, "y": 9, "z": 6, "turn": 6, "part_x": 5, "part_y": 5}  # of lattice points, at most
_MOST_ANYWHERE = 100.0  # m: a hall, as problem files have it
_TURN = 2.0 * math.pi


def default_freedoms(problem: Problem) -> tuple[str, ...]:
    """What is searched unless the user says otherwise: the place, and on a bed the turn, which a table makes itself."""
    return ("x", "y", "z", "turn") if problem.cell.positioner is None else ("x", "y", "z")


def reach(cell: Cell) -> float:
    """How far the nozzle can be from the axis of the arm's first joint, stretched out [m]; a bound."""
    links = np.linalg.norm(cell.arm.placements[1:, :3, 3], axis=1).sum()
    return float(links + np.linalg.norm(cell.arm.T_last_tip[:3, 3]))


def axes_of(problem: Problem, cell: Cell, place: Place, free: str | None, ranges: Sequence[str]) -> list[Axis]:
    """The coordinates that are searched, in the order of FREEDOMS.

    free: names with commas between, as in `x,y,turn`; ranges: `name=low:high` in mm or degrees, each. Without names,
    those with a range are searched; without either, `default_freedoms`.
    Raises InputError for what cannot be understood, and for what the problem's part cannot do.
    """
    limits = dict(_limits(problem, text) for text in ranges)
    if free is not None:
        names = tuple(_name(problem, name.strip(), f"--free {free}") for name in free.split(","))
        for name in limits:
            if name not in names:
                raise InputError(f"{name} has a range but is not free", field=f"--free {free}", hint=f"add {name}")
    else:
        names = tuple(limits) or default_freedoms(problem)
    far = reach(cell)
    return [_axis(cell, place, name, limits.get(name), far) for name in FREEDOMS if name in names]


def _axis(cell: Cell, place: Place, name: str, given: tuple[float, float] | None, far: float) -> Axis:
    at, angle = getattr(place, name), name in ANGLES
    if given is not None:
        low, high = given
    elif angle:
        low, high = -math.pi, math.pi
    else:
        side = (_PLATE_SHARE if name in ON_A_TABLE else _REACH_SHARE) * far
        low, high = round(at - side, 3), round(at + side, 3)
        if name == "z":  # not below the arm's foot, unless it stands there
            low = max(low, min(float(cell.T_world_base[2, 3]), at))
    turns = angle and high - low >= _TURN - 1e-9
    count = min(_COUNTS[name], math.ceil((high - low) / _FINEST[angle]) + 1)
    return Axis(name, low, high, count, _GRAIN[angle], turns)


def _limits(problem: Problem, text: str) -> tuple[str, tuple[float, float]]:
    """Name and range [m or rad] of an option `name=low:high`."""
    field = f"--range {text}"
    name, equals, numbers = text.partition("=")
    low, colon, high = numbers.partition(":")
    if not equals or not colon:
        raise InputError("is not of the form name=low:high", field=field, hint="for example x=300:700, in mm")
    name = _name(problem, name.strip(), field)
    angle = name in ANGLES
    try:
        pair = float(low), float(high)
    except ValueError:
        raise InputError(f"{numbers.strip()!r} is not two numbers", field=field, hint="for example x=300:700") from None
    unit, most = ("deg", 360.0) if angle else ("mm", _MOST_ANYWHERE * 1e3)
    if not all(abs(value) <= most for value in pair):  # NaN is none either
        raise InputError("is out of range", field=field, hint=f"valid: {-most:.0f} to {most:.0f} {unit}")
    if not pair[0] < pair[1]:
        raise InputError("the first number must be less than the second", field=field, hint=f"for example {name}=0:90")
    if angle and pair[1] - pair[0] > 360.0:
        raise InputError("is more than a whole turn", field=field, hint="for example turn=-180:180")
    scale = math.radians(1.0) if angle else 1e-3
    return name, (pair[0] * scale, pair[1] * scale)


def _name(problem: Problem, name: str, field: str) -> str:
    bed = problem.cell.positioner is None
    known = [each for each in FREEDOMS if not (bed and each in ON_A_TABLE)]
    if name in known:
        return name
    if name in ON_A_TABLE:
        raise InputError(f"{name} is for parts on a table", field=field, hint=f"on a bed: {', '.join(known)}")
    near = nearest_name(name, known)
    choices = f"choices: {', '.join(known)}"
    raise InputError(
        f"unknown coordinate {name!r}", field=field, hint=f"did you mean {near}? {choices}" if near else choices
    )
