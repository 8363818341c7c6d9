"""Waypoints from Python arrays: checks shapes, units and numbers, and names errors by argument and index."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner.base.arrays import Array, Ints
from planner.base.budgets import WAYPOINTS
from planner.base.errors import InputError
from planner.problem.waypoint_arrays import WaypointArrays
from planner.toolpath.waypoints.reader import FARTHEST, MOST_LAYERS, SIZES, TO_SI, have_length

# m: few prints are larger, and few are smaller than 5 mm. Millimetres mistaken for metres make kilometres of path, all
# processed before anything checks the arm's reach.
LARGEST_UNSAID = 5.0
_ONE_BY_ONE = "(n, 3), or a list of such arrays, one for each bead"


def waypoints_of(
    points: ArrayLike | Sequence[ArrayLike],
    normals: ArrayLike | Sequence[ArrayLike],
    *,
    bead: ArrayLike | None = None,
    layer: ArrayLike | Sequence[ArrayLike] | None = None,
    width: ArrayLike | Sequence[ArrayLike] | None = None,
    height: ArrayLike | Sequence[ArrayLike] | None = None,
    unit: Literal["m", "mm"] | None = None,
) -> WaypointArrays:
    """See `Toolpath.from_arrays`."""
    unsaid = unit is None
    if unit is None:
        unit = "m"
    if not isinstance(unit, str) or unit not in TO_SI:
        raise InputError(f"must be 'm' or 'mm', not {unit!r}", field="unit")
    x, firsts = _points(points)
    counts = None if firsts is None else np.diff(np.append(firsts, len(x)))
    at = WaypointArrays(x, x, firsts=firsts).index
    if counts is not None:
        if bead is not None:
            raise InputError("is not needed where points are given bead by bead", field="bead", hint="leave it out")
        bead = np.repeat(np.arange(len(counts)), counts)
    n = _normals(normals, len(x), counts)
    x = x * TO_SI[unit]
    _check("points", x, at, np.isfinite(x).all(axis=1), "{} is not a point")
    far = "{} " + f"{unit} is farther than {FARTHEST / 1e3:g} m from the origin"
    hint = "points are in metres unless unit='mm' is given" if unit == "m" else None
    _check("points", x / TO_SI[unit], at, np.abs(x).max(axis=1) <= 1e-3 * FARTHEST, far, hint)
    size = np.ptp(x, axis=0)
    if unsaid and float(size.max()) > LARGEST_UNSAID:
        large = " x ".join(f"{each:.3g}" for each in size)
        hint = "unit='mm' if they are millimetres, unit='m' if it is that large"
        raise InputError(f"are taken as metres, which makes the print {large} m in size", field="points", hint=hint)
    _check("normals", n, at, np.isfinite(n).all(axis=1), "{} is not a direction")
    _check("normals", n, at, have_length(n), "{} has no length", "a direction, of any length")
    sizes: dict[str, Array | None] = {}
    for name, value in (("width", width), ("height", height)):
        column = sizes[name] = None if value is None else _column(name, value, len(x), counts) * TO_SI[unit]
        if column is not None:
            valid = f"{SIZES[0] / TO_SI[unit]:g} to {SIZES[1] / TO_SI[unit]:g} {unit}"
            fits = (column >= SIZES[0]) & (column <= SIZES[1])
            _check(
                name,
                column / TO_SI[unit],
                at,
                fits,
                "{} " + f"{unit} is not a valid {name} for a bead",
                f"valid: {valid}",
            )
    numbers: dict[str, Array | None] = {}
    for name, value in (("layer", layer), ("bead", bead)):
        column = numbers[name] = None if value is None else _column(name, value, len(x), counts)
        if column is not None:
            whole = (column == np.round(column)) & (np.abs(column) <= MOST_LAYERS)
            _check(
                name,
                column,
                at,
                whole,
                "{} is not a valid number for a " + name,
                f"a whole number, {MOST_LAYERS:g} at most",
            )
    return WaypointArrays(x, n, **sizes, **numbers, firsts=firsts)


def _points(points: Any) -> tuple[Array, Ints | None]:
    """Points (n, 3) as given, and the first of each bead if they are given bead by bead."""
    if not _one_by_one(points):
        x, firsts = _numbers("points", points), None
        if x.ndim != 2 or x.shape[1] != 3:
            raise InputError(f"has shape {x.shape}", field="points", hint=_ONE_BY_ONE)
    else:
        beads = [_numbers(f"points[{i}]", each) for i, each in enumerate(points)]
        for i, each in enumerate(beads):
            if each.ndim != 2 or each.shape[1] != 3 or len(each) < 2:
                raise InputError(f"has shape {each.shape}", field=f"points[{i}]", hint="(n, 3), with n at least 2")
        x = np.concatenate(beads)
        firsts = np.cumsum([0, *(len(each) for each in beads[:-1])]).astype(np.int64)
    if len(x) < 2:
        raise InputError(f"has shape {x.shape}", field="points", hint="at least two points")
    WAYPOINTS.check(
        len(x), "points has", lambda reason, hint=None: InputError(reason, field="points", hint=hint), "thin them out"
    )
    return x, firsts


def _one_by_one(points: Any) -> bool:
    """Whether points are a sequence of arrays (n, 3), that is, rows of rows."""
    if isinstance(points, np.ndarray):
        return points.ndim == 3
    if not isinstance(points, (list, tuple)) or not len(points):
        return False
    first = points[0]
    return getattr(first, "ndim", 0) == 2 or (isinstance(first, (list, tuple)) and _has_rows(first))


def _in_beads(normals: Any) -> bool:
    """Whether normals are given bead by bead, as arrays or as one (3) per bead."""
    return _one_by_one(normals) or (isinstance(normals, (list, tuple)) and _has_rows(normals))


def _has_rows(value: Sequence[Any]) -> bool:
    """Whether the first item is itself a row: a list, or an object with dimensions, such as a column of a table."""
    return len(value) > 0 and (isinstance(value[0], (list, tuple)) or getattr(value[0], "ndim", 0) > 0)


def _normals(normals: Any, count: int, counts: Ints | None) -> Array:
    """Normals (n, 3), one for each waypoint or one for all."""
    if counts is not None and _in_beads(normals):
        each = [_numbers(f"normals[{i}]", one) for i, one in enumerate(normals)]
        if len(each) != len(counts):
            raise InputError(f"has {len(each)} beads, but points has {len(counts)}", field="normals")
        for i, (one, n) in enumerate(zip(each, counts, strict=True)):
            if one.shape not in ((n, 3), (3,)):
                raise InputError(f"has shape {one.shape}, points[{i}] {(int(n), 3)}", field=f"normals[{i}]")
        return np.concatenate([np.broadcast_to(one, (n, 3)) for one, n in zip(each, counts, strict=True)])
    found = _numbers("normals", normals)
    if found.shape not in ((count, 3), (3,)):
        what = f"{(count, 3)}" if counts is None else f"{len(counts)} beads of {count} waypoints"
        raise InputError(
            f"has shape {found.shape}, points {what}", field="normals", hint="one for each point, or one (3) for all"
        )
    return np.broadcast_to(found, (count, 3)).copy()


def _column(name: str, value: Any, count: int, counts: Ints | None) -> Array:
    """A number for each waypoint (n), given once for all, one for each, or bead by bead like the points."""
    given = value if isinstance(value, (list, tuple)) else np.atleast_1d(_numbers(name, value))
    if counts is not None and len(given) == len(counts):
        parts = [_numbers(f"{name}[{i}]", each) for i, each in enumerate(given)]
        for i, (part, n) in enumerate(zip(parts, counts, strict=True)):
            if part.shape not in ((), (n,)):
                raise InputError(f"has shape {part.shape}, points[{i}] {(int(n), 3)}", field=f"{name}[{i}]")
        return np.concatenate([np.broadcast_to(part, (n,)) for part, n in zip(parts, counts, strict=True)])
    found = _numbers(name, value)
    if found.shape not in ((), (count,)):
        hint = "one for each point, or one for all" if counts is None else "one for each bead or point, or one for all"
        raise InputError(f"has shape {found.shape}, but there are {count} points", field=name, hint=hint)
    return np.broadcast_to(found, (count,)).copy()


def _numbers(name: str, value: Any) -> Array:
    """An array of real numbers, none of them masked."""
    if np.ma.is_masked(value):
        raise InputError("has masked values", field=name, hint="leave these waypoints out")
    try:
        found = np.asarray(value)
    except ValueError:  # rows of different lengths
        raise InputError("is not an array: its rows differ in length", field=name) from None
    if found.dtype.kind not in "fiu":
        what = "nothing" if value is None else f"an array of {found.dtype}"
        raise InputError(f"must be numbers, not {what}", field=name)
    return found.astype(float)


def _check(name: str, values: Array, at: Callable[[int], str], fine: Any, text: str, hint: str | None = None) -> None:
    """Raise InputError for the first waypoint that fails a check; {} in the text is its value."""
    if fine.all():
        return
    i = int(np.argmin(fine))
    value = ", ".join(f"{each:g}" for each in np.atleast_1d(values[i]))
    raise InputError(text.format(f"({value})" if values.ndim > 1 else value), field=f"{name}{at(i)}", hint=hint)
