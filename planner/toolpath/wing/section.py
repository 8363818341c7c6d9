"""A wing's section: its points, two smooth curves through them, and its place on the part.

Points come from NACA's four-digit formula, or from a file in one of the two layouts of the UIUC collection. Selig's
runs from the trailing edge around the leading edge and back. Lednicer's gives the number of points on each side, then
the upper and the lower side, both from the leading edge on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial import cKDTree

from planner.base.arrays import Array, true_runs
from planner.base.errors import Complaint, InputError
from planner.base.files import read_lines
from planner.problem import Problem
from planner.problem.layers import AerofoilLayersSpec, AerofoilSpec, TipSpec

_DEGREE = 5  # so that the nozzle's angular acceleration has no steps
_SAMPLES = 2000  # of a side: start of Newton's method, and of the search for the ends of a parallel
_NEWTON_STEPS = 3  # from a sample some 40 um away
_CROSSES = 1e-8  # m by which a parallel may come closer to its own side than its distance
_HALVINGS = 24  # of a grid cell of some 40 um
_SWINGS = 0.3  # of a step, by which the curve may leave the chord between two points; 0.13 on a circle of six points

Row = tuple[int, float, float]  # line from 1, x, z
LARGEST_FILE = 1_000_000  # bytes
MOST_POINTS = 5000
FEWEST = 5  # points of a side, including the leading edge: a curve of degree 5 needs six in all
FARTHEST = 1e6  # in the file's unit
_COMMENTS = ("#", "//", "%", ";")
_BOUNDS = 4  # numbers in a line of bounds
_NACA_POINTS = 80  # of a side
_UNEVEN_ENDS = 0.02  # chords along the chord: the largest in a complete published section is 0.009
_SAME = 1e-9  # chords: points closer than this are one

# Where a layer ends, the other side is farther away than its own by so many layer heights: in the lower half enough to
# keep the halves apart; in the upper half so that no bead has less than half its height above the lower half's steps.
CLEAR_LOWER, CLEAR_UPPER = 0.1, 0.5
SHORTEST = 3.0  # bead widths: a shorter piece of a layer is left out
_PIVOT = 0.25  # of the chord: point about which a section is turned


class TooUneven(ValueError):
    """No smooth curve goes through the points: it would swing out next to this one (counted from 0)."""

    def __init__(self, point: int) -> None:
        self.point = point
        super().__init__(f"no smooth curve through point {point}")


@dataclass(frozen=True)
class SectionSide:
    """One side of a section, from parameter `first` to `last` of a curve whose inner side is on its left [m]."""

    curve: BSpline
    first: float
    last: float

    def points(self, t: Array) -> Array:
        """Points (n, 2) at parameters t (n)."""
        return np.asarray(self.curve(t))

    def inward(self, t: Array) -> Array:
        """Unit normals (n, 2) pointing into the section."""
        along = np.asarray(self.curve(t, 1))
        return np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]

    def nearest(self, points: Array) -> Array:
        """Parameters (n) of the places nearest to points (n, 2)."""
        grid, tree = self._search
        _, k = tree.query(points)
        t = grid[k]
        cell = grid[1] - grid[0]
        for _ in range(_NEWTON_STEPS):
            away, along, bend = points - self.curve(t), self.curve(t, 1), self.curve(t, 2)
            slope = np.maximum((along * along).sum(axis=1) - (away * bend).sum(axis=1), 1e-3)
            step = np.clip((away * along).sum(axis=1) / slope, -cell, cell)
            t = np.clip(t + step, self.first, self.last)
        return np.asarray(t)

    def distance(self, points: Array) -> Array:
        """Distances (n) of points (n, 2) from this side."""
        return np.asarray(np.linalg.norm(points - self.points(self.nearest(points)), axis=1))

    @cached_property
    def grid(self) -> Array:
        """Parameters along the whole side."""
        return np.linspace(self.first, self.last, _SAMPLES)

    @cached_property
    def _search(self) -> tuple[Array, cKDTree]:
        return self.grid, cKDTree(self.points(self.grid))


@dataclass(frozen=True)
class AerofoilSection:
    """Upper and lower side [m]: x along the chord, z upwards."""

    upper: SectionSide
    lower: SectionSide


def section_through(points: Array, nose: int) -> AerofoilSection:
    """The section through points (n, 2) [m], from the trailing edge over the upper side to `nose` and back below.

    One spline in chord length through all of them, so that the leading edge is round. Raises TooUneven.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    curve = make_interp_spline(t, points, k=_DEGREE)
    between = np.linspace(0.0, 1.0, 7)[1:-1]
    swung = np.asarray(curve(t[:-1, None] + steps[:, None] * between))
    chords = points[:-1, None] + between[:, None] * np.diff(points, axis=0)[:, None]
    off = np.linalg.norm(swung - chords, axis=2).max(axis=1) / steps
    if off.max() > _SWINGS:
        raise TooUneven(int(np.argmax(off)))
    return AerofoilSection(SectionSide(curve, 0.0, float(t[nose])), SectionSide(curve, float(t[nose]), float(t[-1])))


def parallels(
    side: SectionSide, other: SectionSide, distance: float, apart: float, tilt: float
) -> list[tuple[float, float]]:
    """Intervals of t where a curve parallel to `side`, `distance` [m] inside (outside if negative), is worth printing.

    It ends where the other side is less than `apart` [m] away, where it would cross itself, and where it is steeper
    than `tilt` [rad].
    """

    def room(t: Array) -> Array:
        inward = side.inward(t)
        points = side.points(t) + distance * inward
        clear = other.distance(points) - apart
        if distance != 0.0:
            clear = np.minimum(clear, side.distance(points) - abs(distance) + _CROSSES)
        return np.minimum(clear, np.abs(inward[:, 1]) - np.cos(tilt))

    found = []
    for start, behind in true_runs(room(side.grid) >= 0.0):
        bounds: list[float] = []
        for k, beyond in ((start, start - 1), (behind - 1, behind)):
            good, bad = side.grid[k], side.grid[int(np.clip(beyond, 0, len(side.grid) - 1))]
            for _ in range(_HALVINGS):
                middle = 0.5 * (good + bad)
                good, bad = (middle, bad) if room(np.array([middle]))[0] >= 0.0 else (good, middle)
            bounds.append(float(good))
        found.append((bounds[0], bounds[1]))
    return found


def naca_section(digits: str) -> Array:
    """Points (n, 2) of a NACA section of four digits, in chords.

    They run from the trailing edge over the upper side to the leading edge, (0, 0), and along the lower side back. The
    trailing edge is open, as in NACA report 460.
    """
    camber, place, thick = int(digits[0]) / 100.0, int(digits[1]) / 10.0, int(digits[2:]) / 100.0
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, _NACA_POINTS)))
    half = 5.0 * thick * (0.2969 * np.sqrt(x) - x * (0.1260 + x * (0.3516 - x * (0.2843 - 0.1015 * x))))
    line, slope = np.zeros_like(x), np.zeros_like(x)
    if camber > 0.0:
        fore = x < place
        scale = camber / np.where(fore, place, 1.0 - place) ** 2
        line = scale * np.where(fore, x * (2.0 * place - x), 1.0 - 2.0 * place + x * (2.0 * place - x))
        slope = 2.0 * scale * (place - x)
    across = half[:, None] * np.column_stack([-slope, np.ones_like(x)]) / np.hypot(1.0, slope)[:, None]
    middle = np.column_stack([x, line])
    return np.vstack([(middle + across)[::-1], (middle - across)[1:]])


def read_section(path: Path, where: Complaint | None = None) -> Array:
    """Points (n, 2) of a section file, in chords.

    They run from the trailing edge over the upper side to the leading edge, (0, 0), and along the lower side back; the
    middle of the trailing edge is (1, 0).

    The file may have any unit and position, and either side first. Words before the first point and after the last one
    are skipped, and so are comments, blank lines and, before the first point, four numbers (bounds of a flow field, as
    MSES writes them). `where(reason, hint=...)` makes the InputError for a fault of the file as a whole. Raises
    InputError with file and line for a line that is not a point, or a point that cannot belong to a section.
    """
    complain = partial(InputError, file=path) if where is None else where
    rows = _rows(path, read_lines(path, LARGEST_FILE, complain))
    if len(rows) > MOST_POINTS:
        raise complain(f"{path.name} has more than {MOST_POINTS} points")
    if not rows:
        raise complain(f"{path.name} holds no points", hint="lines x z, as in the UIUC collection")
    first, second = _sides(path, rows, complain)
    for side in (first, second):
        if len(side) < FEWEST:
            raise complain(f"{path.name} has {len(side)} points on one side", hint=f"at least {FEWEST} on each")
        _check_forward(path, side)
    x = np.linspace(0.0, 1.0, 33)[1:-1]
    height = [np.interp(x, *_spread(side)) for side in (first, second)]
    upper, lower = (first, second) if height[0].sum() > height[1].sum() else (second, first)
    crossed = np.flatnonzero(np.interp(*(_at(lower), *_spread(upper))) < [row[2] for row in lower[1:-1]])
    if len(crossed):
        raise InputError("the lower side is above the upper side here", file=path, line=lower[1 + crossed[0]][0])
    points = np.array([row[1:] for row in upper[::-1]] + [row[1:] for row in lower])
    points = _in_chords(points, len(upper) - 1, complain, path)
    if abs(points[0, 0] - points[-1, 0]) > _UNEVEN_ENDS:
        ends = points[[0, -1], 0]
        name, side = ("upper", upper) if ends[0] < ends[1] else ("lower", lower)
        raise InputError(
            f"the {name} side ends here, at {ends.min() / ends.max():.2f} of the length of the other side",
            file=path,
            line=side[-1][0],
            hint="points towards the trailing edge are missing",
        )
    return points


def _rows(path: Path, lines: list[str]) -> list[Row]:
    """All lines that hold two numbers: one run of them, with only words before and after."""
    content = [(i, line.split()) for i, line in enumerate(lines, 1) if line.strip()]
    content = [(i, words) for i, words in content if not words[0].startswith(_COMMENTS)]
    rows: list[Row] = []
    behind: int | None = None  # first line of words after a point
    for place, (number, words) in enumerate(content):
        values = [_number(word) for word in words]
        point = len(words) == 2 and None not in values
        if not point and (place == 0 or behind is not None or (not rows and len(words) == _BOUNDS)):
            continue
        if _is_text(words, values):
            behind = number if rows else None
            continue
        if behind is not None:
            raise InputError(
                "is not a point, but points follow", file=path, line=behind, hint="words may only come first or last"
            )
        wrong = partial(InputError, file=path, line=number)
        if len(words) != 2:
            raise wrong(f"a point has two numbers, x z; here are {len(words)} words")
        for word, value in zip(words, values, strict=True):
            if value is None or not abs(value) <= FARTHEST:
                raise wrong(f"{word[:40]!r} is not a number" + ("" if value is None else " that a point can have"))
        x, z = (value for value in values if value is not None)
        rows.append((number, x, z))
    return rows


def _is_text(words: list[str], values: list[float | None]) -> bool:
    """Whether words are not a point. Two words, one of them a number, may be a mistyped point."""
    return None in values and (len(words) != 2 or values == [None, None])


def _number(word: str) -> float | None:
    try:
        return float(word) if "_" not in word else None
    except ValueError:
        return None


def _sides(path: Path, rows: list[Row], complain: Complaint) -> tuple[list[Row], list[Row]]:
    """The two sides, each from the leading edge on."""
    line, *counts = rows[0]
    rest = rows[1:]
    if all(count == round(count) and count >= 2 for count in counts) and max(row[1] for row in rest or rows) < 1.5:
        first, second = (int(count) for count in counts)
        if first + second != len(rest):
            reason = f"says that {first} and {second} points follow, but there are {len(rest)}"
            raise InputError(reason, file=path, line=line)
        return _distinct(rest[:first]), _distinct(rest[first:])
    rows = _distinct(rows)
    nose = min(range(len(rows)), key=lambda i: rows[i][1])
    if nose in (0, len(rows) - 1):
        raise complain(
            f"{path.name} has no leading edge: x is least at an end of its points",
            hint="points run from the trailing edge around the leading edge and back",
        )
    return rows[: nose + 1][::-1], rows[nose:]


def _distinct(rows: list[Row]) -> list[Row]:
    """The rows without points that repeat the one before."""
    size = max(row[1] for row in rows) - min(row[1] for row in rows)
    return [
        row for i, row in enumerate(rows) if i == 0 or math.dist(row[1:], rows[i - 1][1:]) > _SAME * max(size, _SAME)
    ]


def _check_forward(path: Path, side: list[Row]) -> None:
    for before, row in zip(side[:-1], side[1:], strict=True):
        if row[1] < before[1]:
            raise InputError("x runs back here, towards the leading edge", file=path, line=max(row[0], before[0]))


def _spread(side: list[Row]) -> tuple[Array, Array]:
    """x from 0 to 1 along a side, and z: arguments for np.interp."""
    x, z = np.array([row[1] for row in side]), np.array([row[2] for row in side])
    return (x - x[0]) / (x[-1] - x[0]), z


def _at(side: list[Row]) -> Array:
    """x of a side's points between its ends, from 0 to 1."""
    return _spread(side)[0][1:-1]


def _in_chords(points: Array, nose: int, complain: Complaint, path: Path) -> Array:
    """Points moved, turned and scaled so that the leading edge is (0, 0) and the middle of the trailing edge (1, 0)."""
    points = points[np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.0])]
    nose = int(np.argmin(np.linalg.norm(points - points[min(nose, len(points) - 1)], axis=1)))
    away = points - points[nose]
    chord = 0.5 * (away[0] + away[-1])
    length = float(np.hypot(*chord))
    if length <= 0.0:
        raise complain(f"{path.name} has no length")
    along = chord / length
    return np.column_stack([away @ along, away @ np.array([-along[1], along[0]])]) / length


def root_section(problem: Problem, source: AerofoilSpec) -> AerofoilSection:
    """The section where the span begins. Raises InputError if it cannot be read or is not a smooth curve."""
    return _section(problem, source, "layers.source", source.chord, source.origin[0], source.origin[2])


def tip_section(problem: Problem, source: AerofoilSpec, tip: TipSpec) -> AerofoilSection:
    """The section where the span ends. Raises InputError as `root_section` does."""
    named: AerofoilSpec | TipSpec = source if tip.aerofoil is None and tip.naca is None else tip
    field = "layers.source" if named is source else "layers.source.tip"
    x, z = source.origin[0] + tip.sweep, source.origin[2]
    return _section(problem, named, field, tip.chord, x, z, tip.washout)


def _section(
    problem: Problem,
    named: AerofoilSpec | TipSpec,
    section: str,
    chord: float,
    x: float,
    z: float,
    washout: float = 0.0,
) -> AerofoilSection:
    """The section that `named` names, its leading edge at x, z [m] before it is turned nose down by `washout` [rad]."""
    if named.aerofoil is not None:
        field = f"{section}.aerofoil"
        points = read_section(named.aerofoil, partial(problem.error, field))
    else:
        field = f"{section}.naca"
        points = naca_section(named.naca or "")
    nose = int(np.argmin(np.linalg.norm(points, axis=1)))
    pivot = np.array([_PIVOT, 0.0])
    turn = np.array([[np.cos(washout), -np.sin(washout)], [np.sin(washout), np.cos(washout)]])
    placed = chord * ((points - pivot) @ turn.T + pivot) + np.array([x, z])
    try:
        return section_through(placed, nose)
    except TooUneven as error:
        x, z = points[error.point]
        reason = f"no smooth curve goes through its points: it swings out beside x = {x:.5f}, z = {z:.5f} of the chord"
        raise problem.error(field, reason, "leave out points, or set more where the section bends") from None


def check_floor(problem: Problem, spec: AerofoilLayersSpec, floor: float) -> None:
    """Raise InputError for a wing whose lowest point, at z = `floor` [m], is below the bed."""
    if floor < 0.0:
        raise problem.error(
            "layers.source.origin_mm",
            f"the lower surface reaches {-floor * 1e3:.2f} mm below the part frame's xy plane, on which the part stands",
            f"its z at least {(spec.source.origin[2] - floor) * 1e3 + 0.005:.2f}",
        )


def check_span(problem: Problem, spec: AerofoilLayersSpec) -> None:
    """Raise InputError for a span too short to be filled."""
    least = SHORTEST * problem.process.bead.width
    if spec.source.span < least:
        raise problem.error(
            "layers.source.span_mm",
            f"a wing of {spec.source.span * 1e3:g} mm is too short to be filled",
            f"at least three bead widths, {least * 1e3:g}",
        )


def too_small(problem: Problem) -> Exception:
    """The InputError for a wing without a single layer."""
    return problem.error(
        "layers.height_mm", "the section is too small for a single layer", "choose a smaller height, or tilt_deg"
    )
