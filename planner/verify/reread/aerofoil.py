"""A wing's sections and sides, derived again: by NACA's formula or a file's points, and the lines joining two sections.

The points of a file are interpolated by the curve that the documentation names, a spline of degree 5 in chord length,
whose coefficients are solved for here; sides are then lines of many points. Lengths are in metres in the part frame: x
along the chord, y along the span, z upwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.problem.layers import AerofoilSpec, TipSpec

_DENSE = 3000  # points of a side: 0.3 um off it at a chord of 100 mm
_FINE = 30_000  # places at which NACA's formula is evaluated
_DEGREE = 5
_STATIONS = 25  # along the span, from which searches for the nearest line start
_BEYOND = 0.25  # × the span: lines extend this far beyond both sections
_STEPS = 40  # most steps to the foot of a perpendicular; each reduces the error by depth / radius of curvature
_STILL = 1e-4  # lines: that search ends at a smaller step
_PIVOT = 0.25  # × the chord: a section is turned about this point
_LEAP = 50.0  # lines: longest step of that search
_NUDGE = 1e-6  # m along the side: a perpendicular may miss a point by this
_TINY = 1e-30


@dataclass(frozen=True)
class Sides:
    """Upper and lower side of a section: points (n, 2) from the nose on and unit tangents (n, 2), at the same shares of
    the side's parameter in all sections: its length or, for a file, the chord length of its points."""

    upper: tuple[Array, Array]
    lower: tuple[Array, Array]


def sections_of(source: AerofoilSpec) -> tuple[Sides, Sides]:
    """The sections at root and tip, in place. Raises OSError and ValueError for files that are missing or empty."""
    x, _, z = source.origin
    root = _section(source, source.chord, np.array([x, z]), 0.0)
    tip = source.tip
    if tip is None:
        return root, root
    named: AerofoilSpec | TipSpec = source if tip.aerofoil is None and tip.naca is None else tip
    return root, _section(named, tip.chord, np.array([x + tip.sweep, z]), tip.washout)


def _section(named: AerofoilSpec | TipSpec, chord: float, nose: Array, down: float) -> Sides:
    """A section of a chord [m] with its leading edge at `nose` (2), then turned nose down about a quarter of its chord."""
    if named.naca is not None:
        found = _naca(named.naca)
    elif named.aerofoil is not None:
        stamp = named.aerofoil.stat()
        found = _of_file(named.aerofoil, stamp.st_mtime_ns, stamp.st_size)
    else:
        raise ValueError("no section is named")
    c, s = np.cos(down), np.sin(down)
    turn, about = np.array([[c, s], [-s, c]]), np.array([_PIVOT, 0.0])  # from z towards x: the nose goes down

    def placed(side: tuple[Array, Array]) -> tuple[Array, Array]:
        points, along = side
        return chord * ((points - about) @ turn + about) + nose, along @ turn

    return Sides(placed(found.upper), placed(found.lower))


def _naca(digits: str) -> Sides:
    """A section of four digits, of chord 1, by the formula of NACA report 460."""
    m, p, t = int(digits[0]) * 0.01, int(digits[1]) * 0.1, int(digits[2:]) * 0.01
    turn = np.linspace(0.0, np.pi, _FINE)
    x = np.sin(0.5 * turn) ** 2
    thick = t / 0.2 * (0.2969 * np.sin(0.5 * turn) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)
    if m == 0.0:
        line, slope = np.zeros_like(x), np.zeros_like(x)
    else:
        line = np.where(x < p, m / p**2 * (2 * p * x - x**2), m / (1 - p) ** 2 * (1 - 2 * p + 2 * p * x - x**2))
        slope = np.where(x < p, 2 * m / p**2 * (p - x), 2 * m / (1 - p) ** 2 * (p - x))
    lean = np.arctan(slope)
    sides = [np.column_stack([x - s * thick * np.sin(lean), line + s * thick * np.cos(lean)]) for s in (1.0, -1.0)]
    tangents = [_unit(np.gradient(side, turn, axis=0, edge_order=2)) for side in sides]
    for along in tangents:
        along[-1] = along[-2]  # at the tail, the derivative by the angle vanishes
    lengths = [np.append(0.0, np.cumsum(np.linalg.norm(np.diff(side, axis=0), axis=1))) for side in sides]
    return Sides(*(_spread(*each) for each in zip(lengths, sides, tangents, strict=True)))


@lru_cache(maxsize=4)
def _of_file(path: Path, changed: int, size: int) -> Sides:
    """The section in a file of points, with chord 1 and nose at the origin; `changed` and `size` identify the file."""
    rows = _rows(path)
    if (rows[0] >= 2.0).all() and rows[0].sum() == len(rows) - 1:  # Lednicer's layout
        first = int(rows[0, 0])
        rows = np.vstack([rows[1 : 1 + first][::-1], rows[1 + first :]])
    keep = np.append(True, np.linalg.norm(np.diff(rows, axis=0), axis=1) > 1e-9 * np.ptp(rows[:, 0]))
    rows = rows[keep]
    nose = int(np.argmin(rows[:, 0]))
    share = np.linspace(0.02, 0.98, 49)
    one, other = rows[: nose + 1][::-1], rows[nose:]
    mean = [np.interp(share, (side[:, 0] - side[0, 0]) / np.ptp(side[:, 0]), side[:, 1]).sum() for side in (one, other)]
    if mean[0] < mean[1]:
        rows, nose = rows[::-1], len(rows) - 1 - nose
    chord = 0.5 * (rows[0] + rows[-1]) - rows[nose]
    ahead = chord / (chord @ chord)
    away = rows - rows[nose]
    points = np.column_stack([away @ ahead, away @ np.array([-ahead[1], ahead[0]])])
    t = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    half = (_DEGREE + 1) // 2
    knots = np.concatenate([np.full(_DEGREE + 1, t[0]), t[half:-half], np.full(_DEGREE + 1, t[-1])])
    curve = BSpline(knots, np.linalg.solve(BSpline.design_matrix(t, knots, _DEGREE).toarray(), points), _DEGREE)
    bounds = ((t[nose], t[0]), (t[nose], t[-1]))  # both from the nose on
    at = [a + _shares() * (b - a) for a, b in bounds]
    return Sides(*((curve(t), _unit(curve(t, 1)) * np.sign(t[-1] - t[0])) for t in at))


def _rows(path: Path) -> Array:
    """All rows (n, 2) of exactly two numbers."""
    rows = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        try:
            row = [float(word) for word in words]
        except ValueError:
            continue
        if len(row) == 2 and "_" not in line:
            rows.append(row)
    if len(rows) < _DEGREE + 2:
        raise ValueError(f"{path.name} holds no section")
    return np.array(rows)


def _shares() -> Array:
    """Shares of a side's parameter at its points: denser at both ends."""
    return np.asarray(np.sin(0.25 * np.pi * (1.0 - np.cos(np.linspace(0.0, np.pi, _DENSE)))) ** 2)


def _spread(s: Array, points: Array, along: Array) -> tuple[Array, Array]:
    """A line with parameters s (n), resampled at the same shares for every section: points and unit tangents (n, 2)."""
    columns = np.column_stack([points, along])
    out = np.column_stack([np.interp(_shares() * s[-1], s, column) for column in columns.T])
    return out[:, :2], _unit(out[:, 2:])


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), _TINY))


@dataclass(frozen=True)
class Ruled:
    """One side of a wing: straight lines (n) from points of one section to those of the other, extended beyond both.

    root, tip      (n, 2) points of the sections
    slopes         (2, n, 2) unit tangents of both
    start, span    y of the root, and from there to the tip [m]
    inward         1 if the wing is to the left of the side's direction, -1 if to the right
    """

    root: Array
    tip: Array
    slopes: Array
    start: float
    span: float
    inward: float

    def points(self, line: Array, v: Array) -> Array:
        """Points (k, 3) at fractional line numbers `line` (k) and shares v (k) of the span."""
        root, tip = self._at(self.root, line), self._at(self.tip, line)
        flat = root + v[:, None] * (tip - root)
        return np.column_stack([flat[:, 0], self.start + v * self.span, flat[:, 1]])

    def normals(self, line: Array, v: Array) -> Array:
        """Unit normals (k, 3) into the wing there."""
        along = self._along(line, v)
        across = self._at(self.tip, line) - self._at(self.root, line)
        ruling = np.column_stack([across[:, 0], np.full(len(line), self.span), across[:, 1]])
        return _unit(np.cross(ruling, along)) * self.inward

    def depths(self, points: Array) -> tuple[Array, Array, Array]:
        """Depth [m] of points (k, 3) inside the side, inward unit normals (k, 3) at their feet, and their lines (k).

        The depth is NaN past the two edges of the side, where no perpendicular reaches.
        """
        at, tree = self._search
        line = at[tree.query(points)[1]]
        last, busy = len(self.root) - 1.0, np.arange(len(points))
        for _ in range(_STEPS):
            share, off = self._off(points[busy], line[busy])
            pull = (off * self._along(line[busy], share)).sum(axis=1)
            step = np.clip(pull / np.maximum(self._pace(line[busy], share), _TINY), -_LEAP, _LEAP)
            moved = np.clip(line[busy] + step, 0.0, last)
            still = np.abs(moved - line[busy]) < _STILL
            line[busy] = moved
            busy = busy[~still]
            if not len(busy):
                break
        share, off = self._off(points, line)
        inward = self.normals(line, share)
        pull = (off * self._along(line, share)).sum(axis=1)
        beside = ((line <= 0.0) | (line >= last)) & (np.abs(pull) > _NUDGE)
        return np.where(beside, np.nan, (off * inward).sum(axis=1)), inward, line

    def _off(self, points: Array, line: Array) -> tuple[Array, Array]:
        """Shares (k) of the span at the feet of points (k, 3) on lines (k), and vectors (k, 3) from these feet [m]."""
        root, tip = self._at(self.root, line), self._at(self.tip, line)
        ruling = np.column_stack([tip[:, 0] - root[:, 0], np.full(len(line), self.span), tip[:, 1] - root[:, 1]])
        away = points - np.column_stack([root[:, 0], np.full(len(line), self.start), root[:, 1]])
        share = (away * ruling).sum(axis=1) / (ruling**2).sum(axis=1)
        return share, away - share[:, None] * ruling

    @cached_property
    def _search(self) -> tuple[Array, cKDTree]:
        """Lines (k) from which searches start, and the tree of places along them."""
        shares = np.linspace(-_BEYOND, 1.0 + _BEYOND, _STATIONS)  # more would only take longer
        at, v = (each.ravel() for each in np.meshgrid(np.arange(0.0, len(self.root), 3.0), shares, indexing="ij"))
        return at, cKDTree(self.points(at, v))

    def _at(self, values: Array, line: Array) -> Array:
        """Values (n, k) interpolated between lines."""
        low = np.clip(line.astype(np.int64), 0, len(values) - 2)
        share = (line - low)[:, None]
        return np.asarray((1.0 - share) * values[low] + share * values[low + 1])

    def _along(self, line: Array, v: Array) -> Array:
        """Unit tangents (k, 3) of the section at a share of the span."""
        pace = [self._paces(end, line) for end in (self.root, self.tip)]
        root, tip = (self._at(slopes, line) for slopes in self.slopes)
        flat = (1.0 - v)[:, None] * pace[0][:, None] * root + v[:, None] * pace[1][:, None] * tip
        return _unit(np.column_stack([flat[:, 0], np.zeros(len(line)), flat[:, 1]]))

    def _pace(self, line: Array, v: Array) -> Array:
        """Distance (k) [m] from line to line at a share of the span."""
        return np.asarray((1.0 - v) * self._paces(self.root, line) + v * self._paces(self.tip, line))

    def _paces(self, end: Array, line: Array) -> Array:
        low = np.clip(line.astype(np.int64), 0, len(end) - 2)
        return np.asarray(np.linalg.norm(end[low + 1] - end[low], axis=1))


def ruled(root: tuple[Array, Array], tip: tuple[Array, Array], start: float, span: float, upper: bool) -> Ruled:
    """A side of a wing from both sections' points and tangents, from the nose on."""
    return Ruled(root[0], tip[0], np.stack([root[1], tip[1]]), start, span, 1.0 if upper else -1.0)
