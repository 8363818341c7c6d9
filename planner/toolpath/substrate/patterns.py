"""Plane patterns to be projected onto a part: honeycomb, zig-zag, squares and concentric lines.

All are centred on the origin and lie within an outline, a rectangle or an ellipse.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.problem.drawings import PatternSpec
from planner.toolpath.svg.outlines import PlanePath

Inside = Callable[[Array], NDArray[np.bool_]]

MOST_CELLS = 100_000
THINNEST_CELL = 4.0  # widths: in a narrower honeycomb cell the beads of two walls touch
_ROOM = 1e-9  # m: a cell counts as fitting if it is too large by no more
_SIDES = {"honeycomb": "cell", "squares": "cell", "zigzag": "pair of lines", "concentric": "line"}


class NoPattern(ValueError):
    """There is no such pattern: the reason, for the user."""


def pattern(spec: PatternSpec, width: float, flatness: float) -> tuple[PlanePath, ...]:
    """The lines of a pattern, `width` [m] apart where two run side by side, chords within `flatness` [m] of curves.

    Raises NoPattern where nothing fits into the outline, or too much does.
    """
    count = spec.size[0] * spec.size[1] / spec.cell**2
    if count > MOST_CELLS:
        raise NoPattern(f"the pattern has more than {MOST_CELLS} cells")
    if spec.pattern == "honeycomb":
        if spec.cell < THINNEST_CELL * width:
            least = f"{THINNEST_CELL * width * 1e3:.2f} mm"
            raise NoPattern(f"honeycomb cells are narrower than {least}, four beads with their rounded corners")
        paths = _honeycomb(spec, width)
    elif spec.pattern == "squares":
        paths = _squares(spec)
    elif spec.pattern == "zigzag":
        paths = _zigzag(spec)
    else:
        paths = _concentric(spec, flatness)
    if not paths:
        size = f"{spec.size[0] * 1e3:g} x {spec.size[1] * 1e3:g} mm"
        raise NoPattern(f"no {_SIDES[spec.pattern]} of {spec.cell * 1e3:g} mm fits into {size}")
    return tuple(paths)


def _inside(spec: PatternSpec) -> Inside:
    """Whether points (n, 2) lie within the outline."""
    half = 0.5 * np.asarray(spec.size) + _ROOM
    if spec.outline == "ellipse":
        return lambda p: np.asarray(((p / half) ** 2).sum(axis=-1) <= 1.0)
    return lambda p: np.asarray((np.abs(p) <= half).all(axis=-1))


def _honeycomb(spec: PatternSpec, width: float) -> list[PlanePath]:
    """Ribbons, like those of real honeycomb: each follows half of the walls of a row of cells.

    A ribbon is one line. Sloping walls are single; where two ribbons meet, in every third wall, they run side by side.
    With single walls throughout, the bead would have to restart at every second junction, three walls apart.
    """
    side, half = spec.cell / np.sqrt(3.0), 0.5 * spec.cell
    across, up = int(spec.size[0] / (1.5 * side)) + 2, int(spec.size[1] / half) + 2
    inside = _inside(spec)
    hexagon = np.array(
        [[-side, 0], [-0.5 * side, half], [0.5 * side, half], [side, 0], [0.5 * side, -half], [-0.5 * side, -half]]
    )
    # Columns and half cells upwards; a cell's centre lies where both are even or both are odd.
    i, k = (a.ravel() for a in np.meshgrid(np.arange(-across, across + 1), np.arange(-up, up + 1), indexing="ij"))
    even = (i + k) % 2 == 0
    i, k = i[even], k[even]
    centres = np.column_stack([1.5 * side * i, half * k])
    kept = inside(centres[:, None] + hexagon).all(axis=1)
    columns: dict[int, list[int]] = {}
    for column, level in zip(i[kept].tolist(), k[kept].tolist(), strict=True):
        for band in (level - 1, level):  # the cell's lower and upper half
            columns.setdefault(band, []).append(column)
    ribbons: list[PlanePath] = []
    inset = 0.5 * width
    for band in sorted(columns):
        low, high = half * band + inset, half * (band + 1) - inset
        row = np.array(sorted(columns[band]))
        for run in np.split(row, np.flatnonzero(np.diff(row) > 1) + 1):
            points = []
            for column in run.tolist():
                x = 1.5 * side * column
                upper = (column + band) % 2 == 0  # the band holds the upper half of this column's cell
                rim, flat = (low, high) if upper else (high, low)
                points += [(x - side, rim), (x - 0.5 * side, flat), (x + 0.5 * side, flat), (x + side, rim)]
            line = _distinct(np.array(points))
            line[[0, -1], 0] += np.array([1.0, -1.0]) * inset / np.sqrt(3.0)  # on the walls of the outermost cells
            ribbons.append(PlanePath(f"ribbon {len(ribbons) + 1}", line, False))
    return ribbons


def _distinct(points: Array) -> Array:
    """Ribbons of neighbouring columns share a sloping wall, which stands twice in the list."""
    keep = [points[0]]
    for p in points[1:]:
        if p[0] > keep[-1][0] + _ROOM:
            keep.append(p)
    return np.array(keep)


def _squares(spec: PatternSpec) -> list[PlanePath]:
    """A lattice of squares: each of its lines once, first along x, then along y."""
    cells = (np.asarray(spec.size) / spec.cell + 1e-9).astype(int)
    corner = [spec.cell * (np.arange(n + 1) - 0.5 * n) for n in cells]
    x, y = np.meshgrid(*corner, indexing="ij")
    there = _inside(spec)(np.stack([x, y], axis=-1))
    kept = there[1:, 1:] & there[1:, :-1] & there[:-1, 1:] & there[:-1, :-1]
    paths = []
    for axis in range(2):
        grid = kept if axis else kept.T  # lines (first index) along cells (second index)
        if not grid.size:
            continue
        beside = np.zeros((grid.shape[0] + 1, grid.shape[1]), dtype=bool)
        beside[1:] |= grid
        beside[:-1] |= grid
        for line, touched in enumerate(beside):
            at = np.flatnonzero(touched)
            if len(at) == 0:
                continue
            along, off = corner[axis][[at[0], at[-1] + 1]], np.full(2, corner[1 - axis][line])
            points = np.column_stack([along, off] if axis == 0 else [off, along])
            paths.append(PlanePath(f"{'row' if axis == 0 else 'column'} {line + 1}", points, False))
    return paths


def _zigzag(spec: PatternSpec) -> list[PlanePath]:
    """Lines along x, joined at their ends into one."""
    rows = int(spec.size[1] / spec.cell + 1e-9) + 1
    points: list[tuple[float, float]] = []
    for y in spec.cell * (np.arange(rows) - 0.5 * (rows - 1)):
        half = 0.5 * spec.size[0]
        if spec.outline == "ellipse":
            half *= float(np.sqrt(max(1.0 - (2.0 * y / spec.size[1]) ** 2, 0.0)))
        if half < 0.5 * spec.cell:  # shorter than the way to the next line
            continue
        way = half if len(points) % 4 == 0 else -half
        points += [(-way, y), (way, y)]
    return [PlanePath("zigzag", np.array(points), False)] if len(points) > 2 else []


def _concentric(spec: PatternSpec, flatness: float) -> list[PlanePath]:
    """Closed lines inside each other, each in the shape of the outline, from the innermost to the outermost."""
    paths = []
    for ring in range(int(0.5 * min(spec.size) / spec.cell + 1e-9) + 1):
        half = 0.5 * np.asarray(spec.size) - ring * spec.cell
        if half.min() < 0.5 * spec.cell - _ROOM:
            break
        if spec.outline == "ellipse":
            steps = max(int(np.ceil(np.pi / np.sqrt(2.0 * flatness / half.max()))), 12)
            angle = np.linspace(0.0, 2.0 * np.pi, steps + 1)
            points = np.column_stack([half[0] * np.cos(angle), half[1] * np.sin(angle)])
        else:
            points = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
        points[-1] = points[0]
        paths.append(PlanePath(f"ring {ring + 1}", points, True))
    return paths[::-1]
