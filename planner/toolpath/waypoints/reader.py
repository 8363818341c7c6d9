"""Reads a file of waypoints: one point and its surface normal a line."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.problem.waypoints import WaypointsSpec
from planner.readonly import ReadOnlyArrays
from planner.toolpath.input_file import Complaint, read_lines

Array = NDArray[np.float64]

LARGEST_FILE = 500_000_000  # bytes: some five million waypoints
FARTHEST = 1e5  # mm: a hall of 100 m
COMMENTS = ("#", "//", "%", ";")
SPLIT = 3.0  # median steps: a longer one is no step of the path but a way to the next bead
SAME_POINT = 0.02  # of the median step: points nearer than this to the one before are the same point again
SAME_PLACE = 1e-7  # m: so are points nearer than this, whatever the steps; files are rounded to that
_SHORTEST_NORMAL = 1e-6
_COLUMNS = 6


@dataclass(frozen=True)
class Waypoints(ReadOnlyArrays):
    """The waypoints of one bead: points (n, 3) [m] and outward unit normals (n, 3), part frame; n is at least 2.

    lines (n): where in the file they stand, from 1.
    """

    name: str
    points: Array
    normals: Array
    lines: NDArray[np.int64]


def read_waypoints(spec: WaypointsSpec, where: Complaint | None = None) -> tuple[Waypoints, ...]:
    """Read a file of lines `x y z nx ny nz` (mm; blanks or commas between) and split it where it jumps, in its order.

    Comments (#, //, %, ;), empty lines and one header line of words are passed over, and so are columns after the
    sixth. Points that repeat the one before are dropped. `where(reason, hint=...)` makes the InputError for what is
    wrong with the file as a whole. Raises InputError with file and line for a line that is no waypoint.
    """
    path = spec.waypoints
    complain = partial(InputError, file=path) if where is None else where
    table, numbers = _table(path, complain)
    points, normals = table[:, :3] * 1e-3, table[:, 3:]
    if spec.up == "y":
        points, normals = (np.column_stack([a[:, 0], -a[:, 2], a[:, 1]]) for a in (points, normals))
    normals = normals / np.linalg.norm(normals, axis=1)[:, None] * (1.0 if spec.normals == "outward" else -1.0)
    points = points + np.asarray(spec.origin)

    keep = distinct(points)
    points, normals, numbers = points[keep], normals[keep], numbers[keep]
    if len(points) < 2:
        raise complain(f"{path.name} holds no two different waypoints")
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    split = spec.split if spec.split is not None else SPLIT * float(np.median(step))
    ends = np.concatenate([[0], np.flatnonzero(step > split) + 1, [len(points)]])
    beads = []
    for i, (first, last) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
        if last - first < 2:
            raise InputError(
                f"this waypoint stands alone, more than {split * 1e3:g} mm from those beside it",
                file=path,
                line=int(numbers[first]),
                hint="leave it out, or choose a greater layers.source.split_mm",
            )
        rows = slice(first, last)
        beads.append(Waypoints(f"path {i + 1}", points[rows].copy(), normals[rows].copy(), numbers[rows].copy()))
    return tuple(beads)


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


def _table(path: Path, complain: Complaint) -> tuple[Array, NDArray[np.int64]]:
    """The file's first six columns (n, 6) as they stand there, and the line (n) of each row, from 1."""
    lines = read_lines(path, LARGEST_FILE, complain)
    rows, numbers = _content(lines)
    if not rows:
        raise complain(f"{path.name} holds no waypoints", hint="lines x y z nx ny nz, in mm")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            table = np.loadtxt(rows, dtype=float, comments=None, usecols=range(_COLUMNS), ndmin=2)
    except (ValueError, UserWarning):
        table = np.array([_row(path, row, number) for row, number in zip(rows, numbers.tolist(), strict=True)])
    length = np.abs(table[:, 3:]).max(axis=1)
    good = (np.abs(table[:, :3]).max(axis=1) <= FARTHEST) & (length > _SHORTEST_NORMAL) & (length < math.inf)
    if not good.all():
        i = int(np.argmin(good))
        _row(path, rows[i], int(numbers[i]))
    return table, numbers


def _content(lines: list[str]) -> tuple[list[str], NDArray[np.int64]]:
    """The lines that hold a waypoint, or should, and their numbers from 1."""
    numbers = [i for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if numbers and not any(_number(word) is not None for word in lines[numbers[0] - 1].split()):
        numbers = numbers[1:]  # a header
    return [lines[i - 1] for i in numbers], np.array(numbers, dtype=np.int64)


def _number(word: str) -> float | None:
    """The number that a word is, infinite or not; None for none."""
    try:
        return float(word) if "_" not in word else None
    except ValueError:
        return None


def _row(path: Path, line: str, number: int) -> list[float]:
    """The waypoint in a line; InputError if there is none."""
    wrong = partial(InputError, file=path, line=number)
    words = line.split()
    if len(words) < _COLUMNS:
        count = f"{len(words)} value{'s' if len(words) != 1 else ''}"
        raise wrong(f"a waypoint has six numbers, x y z nx ny nz; here are {count}")
    row = []
    for word in words[:_COLUMNS]:
        value = _number(word)
        if value is None or not math.isfinite(value):
            raise wrong(f"{word[:40]!r} is not a number" + ("" if value is None else " that a waypoint can have"))
        row.append(value)
    if max(map(abs, row[:3])) > FARTHEST:
        raise wrong(f"the point is farther than {FARTHEST / 1e3:g} m from the origin", hint="points are in mm")
    if max(map(abs, row[3:])) <= _SHORTEST_NORMAL:
        raise wrong("the normal is zero", hint="nx ny nz is a direction, of any length")
    return row
