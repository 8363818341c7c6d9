"""Waypoint files that others published, as they are: their likely meaning, and where their part is put.

Such files do not state units, axes or the normals' sense. These are found from the numbers and put into words, so a
wrong guess can be seen and corrected.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.waypoint_spacing import Spacing, spacing_of, unit_of
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.toolpath.waypoints.reader import LENGTHS, read_columns

SUFFIXES = (".txt", ".csv", ".xyz", ".dat", ".npz")
LEANING = 0.2  # a mean of unit normals, along an axis, that is less than this says nothing of up and down
AVOIDED = 0.5  # of what normals have along another axis: less than this along an axis is that they turn round it
WALL = 0.9  # a mean of unit normals along x that is more than this is a wall's, which is laid on its back
LAYERS = 4  # files of which the order may say where a part grows to,
STEADY = 0.9  # where so much of their middles' spread is a straight line in that order (correlation)
MOSTLY = 0.8  # that is along y or z: so much of its unit vector
FIT = 0.4  # of the nozzle's reach: the largest side of a part that may be expected to be printable all round
_TO_MM = {"mm": 1.0, "m": 1e3}


@dataclass(frozen=True)
class Look:
    """What the numbers of a file, or of several, are: low, high (3) of the points, the sum (3) of unit normals and of their
    components' sizes, count, how far apart waypoints, passes and layers lie, and the unit vector (3) along which layers
    follow each other; None where no order of files says that."""

    low: Array
    high: Array
    normals: Array
    spread: Array
    count: int
    unit: str | None  # where a header says it
    spacing: Spacing
    growth: Array | None = None


@dataclass(frozen=True)
class Meaning:
    """What a file is taken for; None: told from its numbers."""

    unit: str | None = None
    up: str | None = None
    normals: str | None = None


@dataclass(frozen=True)
class Placed:
    """How a file becomes a part in the cell: settings of its waypoints, and by how much it is shrunk (1: not at all)."""

    unit: str
    up: str
    normals: str
    origin_mm: tuple[float, float, float]
    scale: float
    side_mm: float  # the largest, before
    split_mm: float | None = None  # where steps are too uneven for the reader's own rule
    bead_mm: tuple[float, float] | None = None  # width and height, where they are the file's own

    @property
    def words(self) -> list[str]:
        """For the table."""
        at = " ".join(f"{value:g}" for value in self.origin_mm)
        out = [f"unit={self.unit}", f"up={self.up}", f"normals={self.normals}", f"origin_mm={at}"]
        out += [f"side_mm={self.side_mm:.0f}"] + ([f"scale={self.scale:g}"] if self.scale != 1.0 else [])
        out += [] if self.split_mm is None else [f"split_mm={self.split_mm:.4g}"]
        return out + ([] if self.bead_mm is None else [f"bead_mm={self.bead_mm[0]:g}x{self.bead_mm[1]:g}"])

    def source(self, file: Path) -> dict[str, str | float | list[float]]:
        """The section `layers.source` of the problem."""
        return {
            "waypoints": str(file), "unit": self.unit, "up": self.up, "normals": self.normals,
            "origin_mm": list(self.origin_mm), **({} if self.split_mm is None else {"split_mm": self.split_mm}),
        }  # fmt: skip


def files_in(folder: Path, patterns: Sequence[str]) -> list[Path]:
    """The files of waypoints in a folder and all below it, 2.txt before 10.txt; patterns (`TOOL_PATH/*.txt`) choose some.

    Raises InputError where there is no folder, or nothing in it.
    """
    if not folder.is_dir():
        raise InputError("there is no such folder", file=folder)
    found = [path for pattern in patterns or ["**/*"] for path in folder.glob(pattern)]
    known = {path for path in found if path.suffix.lower() in SUFFIXES and path.is_file()}
    if not known:
        raise InputError("holds no files of waypoints", file=folder, hint=f"they end in {', '.join(SUFFIXES)}")
    return sorted(known, key=lambda path: _natural(path.relative_to(folder).as_posix()))


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def look_at(file: Path) -> Look:
    """Read a file's numbers. Raises InputError for what the planner would not read either."""
    complain = partial(InputError, file=file)
    unit = None
    try:
        values = read_columns(file, "mm", complain).values
    except InputError as error:
        if error.hint != "unit: m":
            raise
        unit = "m"
        values = read_columns(file, unit, complain).values
    points = np.column_stack([values[name] for name in ("x", "y", "z")])
    normals = np.column_stack([values[name] for name in ("nx", "ny", "nz")])
    good = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1)
    if not good.any():
        raise complain("holds no waypoint whose numbers are all finite")
    points, normals = points[good], normals[good]
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    spacing = spacing_of(points, normals)
    if "bead" in values:  # the file says where beads begin
        spacing = replace(spacing, split=None)
    return Look(
        points.min(axis=0),
        points.max(axis=0),
        normals.sum(axis=0),
        np.abs(normals).sum(axis=0),
        len(points),
        unit,
        spacing,
    )


def together(looks: Iterable[Look]) -> Look:
    """Several files as one, in the order of layers; there is one at least. Some may count their normals the other way: most
    decide."""
    every = list(looks)
    sums = [each.normals for each in every]
    largest = max(sums, key=lambda normals: float(normals @ normals))
    aligned = np.sum([normals * (1.0 if normals @ largest >= 0.0 else -1.0) for normals in sums], axis=0)
    most = aligned if float(np.sum(sums, axis=0) @ aligned) >= 0.0 else -aligned
    return Look(
        np.min([each.low for each in every], axis=0),
        np.max([each.high for each in every], axis=0),
        most,
        np.sum([each.spread for each in every], axis=0),
        sum(each.count for each in every),
        next((each.unit for each in every if each.unit is not None), None),
        Spacing(
            step=_median([each.spacing.step for each in every]),
            beside=_median([each.spacing.beside for each in every]),
            above=_median([each.spacing.above for each in every]),
            split=None,
        ),
        _growth(np.array([0.5 * (each.low + each.high) for each in every])),
    )


def _growth(middles: Array) -> Array | None:
    """The unit vector (3) along which middles (n, 3) of layers move steadily; None where they do not."""
    if len(middles) < LAYERS:
        return None
    order = np.arange(len(middles)) - 0.5 * (len(middles) - 1)
    way = order @ middles
    length = float(np.linalg.norm(way))
    if length == 0.0:
        return None
    along = middles @ way / length
    return way / length if np.corrcoef(order, along)[0, 1] >= STEADY else None


def as_the_file_counts(look: Look, own: Look) -> Look:
    """What several files are together, with normals the other way where one of them points clearly against the others."""
    against = float(own.normals @ look.normals) < 0.0 and float(np.linalg.norm(own.normals)) > LEANING * own.count
    return replace(look, normals=-look.normals) if against else look


def _median(values: Sequence[float]) -> float:
    """Of those that are numbers; NaN where none is."""
    numbers = [value for value in values if np.isfinite(value)]
    return float(np.median(numbers)) if numbers else math.nan


def place(
    look: Look,
    given: Meaning,
    bead: tuple[float, float],
    reach: float,
    shrink: bool,
    own_beads: bool = False,
    lift_mm: float = 0.0,
) -> Placed:
    """Put a part onto the middle of bed or table, its lowest waypoint a bead's height above it.

    bead: width and height [m]; reach: of the nozzle [m]; shrink: a part whose largest side is more than FIT of that is made
    so large; own_beads: a bead is as high as the file's layers lie apart, and as wide as its passes, where they do;
    lift_mm: how much higher the part stands, on a stub.
    """
    unit = given.unit or look.unit or unit_of(float((look.high - look.low).max()), look.spacing)
    mean = look.normals / look.count
    up = given.up or _up(mean, look.spread, look.growth)
    along = float(mean["xyz".index(up)])
    normals = given.normals or ("inward" if along < -LEANING else "outward")
    low, high = (_TO_MM[unit] * _turned(corner, up) for corner in (look.low, look.high))
    low, high = np.minimum(low, high), np.maximum(low, high)
    side = float((high - low).max())
    largest = FIT * reach * 1e3
    scale = float(f"{largest / side:.3g}") if shrink and side > largest else 1.0
    middle = 0.5 * scale * (low + high)
    to_mm = scale * _TO_MM[unit]
    own = _own_bead(look.spacing, to_mm, bead) if own_beads else None
    height = bead[1] * 1e3 if own is None else own[1]
    origin = (-middle[0], -middle[1], height + lift_mm - scale * low[2])
    x, y, z = (round(float(value), 3) + 0.0 for value in origin)
    split = look.spacing.split
    # a little more than the step itself, however it is rounded
    return Placed(
        unit, up, normals, (x, y, z), scale, side, None if split is None else round(1.0001 * to_mm * split, 6), own
    )


def _up(mean: Array, spread: Array, growth: Array | None) -> str:
    """Along y or z, where layers follow each other and normals lean along it; else whichever normals lean to; along x where
    nearly all point there, as on a wall; or else, where they point all round a part, along the axis that they avoid."""
    if growth is not None:
        axis = 1 if growth[1] > growth[2] else 2
        if growth[axis] > MOSTLY and abs(mean[axis]) > LEANING:
            return "y" if axis == 1 else "z"
    if abs(mean[0]) > WALL:
        return "x"
    if max(abs(mean[1]), abs(mean[2])) > LEANING:
        return "y" if abs(mean[1]) > abs(mean[2]) else "z"
    least = int(np.argmin(spread))
    return "xyz"[least] if spread[least] < AVOIDED * float(np.delete(spread, least).min()) else "z"


def _own_bead(spacing: Spacing, to_mm: float, bead: tuple[float, float]) -> tuple[float, float] | None:
    """Width and height [mm] that the file's passes speak for; None where it has no layers."""
    if not np.isfinite(spacing.above):
        return None
    height = float(f"{to_mm * spacing.above:.2g}")
    width = float(f"{to_mm * spacing.beside:.2g}") if np.isfinite(spacing.beside) else bead[0] * 1e3
    return max(width, height), height


def _turned(point: Array, up: str) -> Array:
    """A point of the file in the part's axes."""
    x, y, z = point
    return np.array({"x": (y, z, x), "y": (x, -z, y), "z": (x, y, z)}[up])


def shrunk(file: Path, placed: Placed, folder: Path) -> Path:
    """The file, or where it is to be shrunk a copy in a folder."""
    if placed.scale == 1.0:
        return file
    values = read_columns(file, placed.unit, partial(InputError, file=file)).values
    copy = folder / f"{file.stem}.npz"
    with copy.open("wb") as stream:
        np.savez(stream, **{name: (placed.scale if name in LENGTHS else 1.0) * row for name, row in values.items()})  # type: ignore[arg-type]
    return copy
