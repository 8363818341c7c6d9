"""Reads a file of waypoints: points and their surface normals, split into the paths that become beads."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.errors import Complaint, InputError
from planner.problem.waypoints import WaypointsSpec
from planner.readonly import Array, Ints, ReadOnlyArrays
from planner.toolpath.waypoints.columns import Columns, read_columns
from planner.toolpath.waypoints.smoothing import smooth_normals

FARTHEST = 1e5  # mm: a hall of 100 m
SPLIT = 3.0  # median steps: a longer one is no step of the path but a way to the next bead
SAME_POINT = 0.02  # of the median step: points nearer than this to the one before are the same point again
SAME_PLACE = 1e-7  # m: so are points nearer than this, whatever the steps; files are rounded to that
SIZES = (1e-5, 50e-3)  # m: widths and heights of beads, from a fibre to large concrete beads
MOST_LAYERS = 1e6  # and numbers of beads
_SHORTEST_NORMAL = 1e-6
_SIZED, _COUNTED = ("width", "height"), ("layer", "bead")
_TO_SI = {"mm": 1e-3, "m": 1.0}


@dataclass(frozen=True)
class Waypoints(ReadOnlyArrays):
    """The waypoints of one bead: points (n, 3) [m] and outward unit normals (n, 3), part frame; n is at least 2.

    lines (n)         where in the file they stand, from 1
    width, height (n) of the bead [m]; None where the file does not say
    layer             as the file counts; None where it does not
    """

    name: str
    points: Array
    normals: Array
    lines: Ints
    width: Array | None
    height: Array | None
    layer: int | None


@dataclass(frozen=True)
class WaypointFile:
    """The beads of a file in its order, and what was left out or changed, in words for the user."""

    beads: tuple[Waypoints, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Rows:
    """All waypoints of a file (n), in SI units and the part frame; columns that the file does not have are None."""

    points: Array
    normals: Array
    lines: Ints
    width: Array | None
    height: Array | None
    layer: Array | None
    bead: Array | None

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> _Rows:
        def taken(column: Array | None) -> Array | None:
            return None if column is None else column[rows].copy()

        return _Rows(
            self.points[rows].copy(),
            self.normals[rows].copy(),
            self.lines[rows].copy(),
            *map(taken, (self.width, self.height, self.layer, self.bead)),
        )


def read_waypoints(spec: WaypointsSpec, where: Complaint | None = None) -> WaypointFile:
    """Read a file of waypoints (see `read_columns`) and split it, in its order, where a bead ends.

    That is where the columns bead or layer change, and where it jumps; if there is a column bead, only where the
    jump is longer than a `split_mm` that is given. Points that repeat the one before are left out, and normals smoothed
    if that is asked for. `where(reason, hint=...)` makes the InputError for what is wrong with the file as a whole.
    Raises InputError with file and line for a line that is no waypoint.
    """
    path = spec.waypoints
    complain = partial(InputError, file=path) if where is None else where
    columns = read_columns(path, spec.unit, complain)
    _check(columns, path, spec.unit)
    rows = _rows(columns, spec)

    keep = np.concatenate([distinct(rows[part].points) for part in _parts(_changes(rows))])
    repeated = int((~keep).sum())
    rows = rows[keep]
    if len(rows.points) < 2:
        raise complain(f"{path.name} holds no two different waypoints")
    beads, turned = [], np.zeros(0)
    for i, part in enumerate(_split(rows, spec, path), 1):
        cut = rows[part]
        normals = cut.normals
        if spec.smoothing > 0.0:
            normals, angles = smooth_normals(normals, spec.smoothing)
            turned = np.append(turned, angles)
        layer = None if cut.layer is None else int(cut.layer[0])
        beads.append(Waypoints(f"path {i}", cut.points, normals, cut.lines, cut.width, cut.height, layer))
    return WaypointFile(tuple(beads), tuple(_notes(path, columns.unused, repeated, turned)))


def _notes(path: Path, unused: tuple[str, ...], repeated: int, turned: Array) -> Iterator[str]:
    if repeated:
        what = "waypoint that repeats" if repeated == 1 else "waypoints that repeat"
        yield f"{path.name}: {repeated} {what} the one before left out"
    if unused:
        yield f"{path.name}: columns that are not used: {', '.join(name[:40] for name in unused[:8])}"
    if len(turned):
        most, mean = np.degrees([turned.max(), turned.mean()])
        yield f"{path.name}: normals smoothed, by {most:.3f} degrees at most and {mean:.3f} on average"


def _rows(columns: Columns, spec: WaypointsSpec) -> _Rows:
    """The file's columns in SI units, turned and moved into the part frame."""
    scale, values = _TO_SI[spec.unit], columns.values
    points = scale * np.column_stack([values[name] for name in ("x", "y", "z")])
    normals = np.column_stack([values[name] for name in ("nx", "ny", "nz")])
    if spec.up == "y":
        points, normals = (np.column_stack([a[:, 0], -a[:, 2], a[:, 1]]) for a in (points, normals))
    normals = normals / np.linalg.norm(normals, axis=1)[:, None] * (1.0 if spec.normals == "outward" else -1.0)
    width, height = (scale * values[name] if name in values else None for name in ("width", "height"))
    moved = points + np.asarray(spec.origin)
    return _Rows(moved, normals, columns.lines, width, height, values.get("layer"), values.get("bead"))


def _check(columns: Columns, path: Path, unit: str) -> None:
    """Raise InputError for the first row whose numbers are no waypoint's."""
    values, scale = columns.values, _TO_SI[unit]
    table = np.column_stack(list(values.values()))
    bad = ~np.isfinite(table).all(axis=1)
    place = np.column_stack([values[name] for name in ("x", "y", "z")])
    normal = np.column_stack([values[name] for name in ("nx", "ny", "nz")])
    bad |= ~(scale * np.abs(place).max(axis=1) <= 1e-3 * FARTHEST)
    bad |= ~(np.abs(normal).max(axis=1) > _SHORTEST_NORMAL)
    for name in [name for name in _SIZED if name in values]:
        bad |= ~((scale * values[name] >= SIZES[0]) & (scale * values[name] <= SIZES[1]))
    for name in [name for name in _COUNTED if name in values]:
        bad |= ~((values[name] == np.round(values[name])) & (np.abs(values[name]) <= MOST_LAYERS))
    if not bad.any():
        return
    i = int(np.argmax(bad))
    row = {name: float(column[i]) for name, column in values.items()}
    wrong = partial(InputError, file=path, line=int(columns.lines[i]))
    for value in row.values():
        if not math.isfinite(value):
            raise wrong(f"'{value:g}' is not a number that a waypoint can have")
    if scale * np.abs(place[i]).max() > 1e-3 * FARTHEST:
        hint = f"points are in {unit}; layers.source.unit is mm or m"
        raise wrong(f"the point is farther than {FARTHEST / 1e3:g} m from the origin", hint=hint)
    if np.abs(normal[i]).max() <= _SHORTEST_NORMAL:
        raise wrong("the normal is zero", hint="nx ny nz is a direction, of any length")
    for name in [name for name in _SIZED if name in row]:
        if not SIZES[0] <= scale * row[name] <= SIZES[1]:
            valid = f"valid: {SIZES[0] / scale:g} to {SIZES[1] / scale:g} {unit}"
            raise wrong(f"the bead's {name} is {row[name]:g} {unit}", hint=valid)
    for name in [name for name in _COUNTED if name in row]:
        if row[name] != round(row[name]) or abs(row[name]) > MOST_LAYERS:
            raise wrong(f"{name} is {row[name]:g}", hint=f"a whole number, {MOST_LAYERS:g} at most")


def _changes(rows: _Rows) -> Ints:
    """Where a column says that another bead begins: first rows of all but the first, and how many rows there are."""
    changed = np.zeros(len(rows.points) - 1, dtype=bool)
    for column in (rows.layer, rows.bead):
        if column is not None:
            changed |= column[1:] != column[:-1]
    return np.append(np.flatnonzero(changed) + 1, len(rows.points))


def _parts(ends: Ints) -> Iterator[slice]:
    """Slices up to each of the ends."""
    return (slice(int(a), int(b)) for a, b in zip(np.append(0, ends[:-1]), ends, strict=True))


def _split(rows: _Rows, spec: WaypointsSpec, path: Path) -> Iterator[slice]:
    """The rows of each bead; raises InputError for a waypoint that stands alone."""
    step = np.linalg.norm(np.diff(rows.points, axis=0), axis=1)
    ends = _changes(rows)
    within = np.ones(len(step), dtype=bool)
    within[ends[:-1] - 1] = False
    split = spec.split
    if split is None:
        split = SPLIT * float(np.median(step[within])) if rows.bead is None and within.any() else math.inf
    for part in _parts(np.union1d(ends, np.flatnonzero(step > split) + 1)):
        if part.stop - part.start < 2:
            reason, hint = "this waypoint is all of its bead", "a bead has two at least"
            if rows.bead is None and rows.layer is None:
                reason = f"this waypoint stands alone, more than {split * 1e3:g} mm from those beside it"
                hint = "leave it out, or choose a greater layers.source.split_mm"
            raise InputError(reason, file=path, line=int(rows.lines[part.start]), hint=hint)
        yield part


def distinct(points: Array) -> NDArray[np.bool_]:
    """Which points (n) are no repetition of the last one kept before them."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moving = step[step > SAME_PLACE]  # points that creep say nothing of how densely the path is written
    same = max(SAME_POINT * float(np.median(moving)), SAME_PLACE) if len(moving) else SAME_PLACE
    keep = np.concatenate([[True], step > same])
    before, last = 0, -1
    for i in np.flatnonzero(~keep).tolist():  # a few creeping points may add up to a step
        before = before if last == i - 1 and not keep[last] else i - 1
        keep[i] = math.dist(points[i], points[before]) > same
        last = i
    return keep
