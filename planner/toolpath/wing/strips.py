"""Layers of a print that is straight along its span: strips of the section, and the solid that they make up.

Unrolled, a strip is a rectangle, which one zig-zag line fills.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.problem.layers import AerofoilLayersSpec
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead
from planner.toolpath.interpolation import interpolate
from planner.toolpath.plane_paths import make_bead
from planner.toolpath.task import roll_zeros
from planner.toolpath.wing.section import SectionSide

_Piece = tuple[Array, Array]  # part of an _Outline: places and normals
_SAMPLE = 5e-5  # m between places at which outlines are sampled
_NUDGE = 1e-6  # m by which a place on an outline is moved out to see whether something else is there
_DENSE = 400  # intervals over which the length of a parallel curve is integrated

STEP = 1e-3  # m between waypoints where a strip is flat
TURN = 0.06  # rad: most that the nozzle turns between waypoints, where a strip bends most
APART = 0.5  # × the distance between passes: the source's points lie no farther apart
PER_RUN = 10.0  # samples per run-in, which set the spacing at the bead's ends


class Strip(Protocol):
    """One layer seen along the span: the area under its tip curve. Points are (x, z) in the part frame [m]."""

    @property
    def length(self) -> float:
        """Of the tip curve [m]."""
        ...

    @property
    def height(self) -> float:
        """From its bottom to its top [m]."""
        ...

    @property
    def bend(self) -> float:
        """Greatest curvature of the tip curve [1/m]."""
        ...

    def tips(self, s: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 2) of the tip curve at lengths s (n) from its start."""
        ...

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 2) of the tip curve's direction at points (n, 2)."""
        ...

    @property
    def side(self) -> SectionSide | None:
        """The side to which it is parallel; None if it is level."""
        ...

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """Parameter range on its side, and range of distances inwards from there [m]; if level, ranges of x and z."""
        ...


@dataclass(frozen=True)
class CurvedStrip:
    """A layer parallel to one side of the section, between parameters `first` and `last` of that side.

    tip, base   signed distances inwards from the side, of its top and its bottom [m]
    """

    side: SectionSide
    tip: float
    base: float
    first: float
    last: float

    @property
    def length(self) -> float:
        """Of the tip curve [m]."""
        return float(self._lengths(self.last))

    @property
    def height(self) -> float:
        """From its bottom to its top [m]."""
        return abs(self.tip - self.base)

    @property
    def bend(self) -> float:
        """Greatest curvature of the tip curve [1/m]."""
        t = np.linspace(self.first, self.last, _DENSE)
        return float(np.abs(self._curvature(t) / (1.0 - self.tip * self._curvature(t))).max())

    @property
    def _outward(self) -> float:
        return 1.0 if self.tip > self.base else -1.0

    def tips(self, s: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 2) of the tip curve at lengths s (n) from its start."""
        t = np.asarray(self._parameters(s))
        inward = self.side.inward(t)
        return self.side.points(t) + self.tip * inward, self._outward * inward

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 2) of the side at the places, within the strip, nearest to points (n, 2)."""
        t = np.clip(self.side.nearest(points), self.first, self.last)
        return self._outward * self.side.inward(t)

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """Parameter range on its side, and range of distances inwards from there [m]."""
        return self.first, self.last, min(self.tip, self.base), max(self.tip, self.base)

    def _curvature(self, t: Array) -> Array:
        along, bend = self.side.curve(t, 1), self.side.curve(t, 2)
        return np.asarray((along[:, 0] * bend[:, 1] - along[:, 1] * bend[:, 0]) / np.linalg.norm(along, axis=1) ** 3)

    @cached_property
    def _grid(self) -> tuple[Array, Array]:
        """Parameters along the tip curve, and its length up to them."""
        t = np.linspace(self.first, self.last, _DENSE + 1)
        nodes, weights = np.polynomial.legendre.leggauss(4)
        middle = 0.5 * (t[1:] + t[:-1])[:, None] + 0.5 * np.diff(t)[:, None] * nodes
        speed = np.linalg.norm(self.side.curve(middle.ravel(), 1), axis=1)
        speed = speed * (1.0 - self.tip * self._curvature(middle.ravel()))
        pieces = 0.5 * np.diff(t) * (speed.reshape(middle.shape) @ weights)
        return t, np.concatenate([[0.0], np.cumsum(pieces)])

    @cached_property
    def _lengths(self) -> CubicSpline:
        return CubicSpline(*self._grid)

    @cached_property
    def _parameters(self) -> CubicSpline:
        """Parameter by length: within a micrometre, which moves a point along the curve and never off it."""
        return CubicSpline(*self._grid[::-1])


@dataclass(frozen=True)
class FlatStrip:
    """A level layer between x `first` and `last`, its top and its bottom at heights `tip` and `base` [m]."""

    first: float
    last: float
    tip: float
    base: float

    side = None

    @property
    def length(self) -> float:
        """Of the tip curve [m]."""
        return self.last - self.first

    @property
    def height(self) -> float:
        """From its bottom to its top [m]."""
        return self.tip - self.base

    @property
    def bend(self) -> float:
        """Greatest curvature of the tip curve [1/m]."""
        return 0.0

    def tips(self, s: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 2) of the tip curve at lengths s (n) from its start."""
        points = np.column_stack([self.first + s, np.full(len(s), self.tip)])
        return points, self.normals(points)

    def normals(self, points: Array) -> Array:
        """Upwards (n, 2)."""
        return np.tile([0.0, 1.0], (len(points), 1))

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """Ranges of x and of z [m]."""
        return self.first, self.last, self.base, self.tip


@dataclass(frozen=True)
class StripUnion:
    """Strips that are checked all at once for points that lie in any of them.

    curved  sides of the section, and the edges (k, 4) of the strips parallel to each
    level   edges (k, 4) of level strips
    """

    curved: tuple[tuple[SectionSide, Array], ...]
    level: Array

    @classmethod
    def of(cls, strips: Sequence[Strip]) -> StripUnion:
        """The union of all strips."""
        sides = {id(strip.side): strip.side for strip in strips if strip.side is not None}
        curved = tuple((side, np.array([s.edges for s in strips if s.side is side])) for side in sides.values())
        return cls(curved, np.array([s.edges for s in strips if s.side is None]).reshape(-1, 4))

    def holds(self, points: Array) -> Flags:
        """Which points (n, 2) lie in a strip."""
        x, z = points.T
        first, last, low, high = self.level.T[:, :, None]
        held = ((x > first) & (x < last) & (z > low) & (z < high)).any(axis=0)
        for side, edges in self.curved:
            t, depth = _beside(side, points)
            first, last, low, high = edges.T[:, :, None]
            held |= ((t >= first) & (t <= last) & (depth > low) & (depth < high)).any(axis=0)
        return np.asarray(held)


def _beside(side: SectionSide, points: Array) -> tuple[Array, Array]:
    """Parameters (n) of the places on a side nearest to points (n, 2), and depths (n) inside; NaN beyond its ends."""
    t = side.nearest(points)
    away, inward = points - side.points(t), side.inward(t)
    ahead = np.abs(away[:, 0] * inward[:, 1] - away[:, 1] * inward[:, 0])
    beyond = ((t <= side.first) | (t >= side.last)) & (ahead > _NUDGE)
    return t, np.where(beyond, np.nan, (away * inward).sum(axis=1))


@dataclass(frozen=True)
class _Outline:
    """Places (n, 2) on the edges of strips, their outward normals (n, 2), and the strips."""

    points: Array
    normals: Array
    tree: cKDTree
    strips: StripUnion

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Corners (2) of the least box that holds the places."""
        return self.points.min(axis=0), self.points.max(axis=0)


@dataclass(frozen=True)
class LayeredSolid:
    """The surface on which layers lie: everything printed before the current layer, on the bed z = 0.

    strips, levels   all strips, and the layer of each in print order, never decreasing; -1: there from the start
    laid             the strip that each bead fills
    span             least and greatest y of the solid [m]
    level            the layers before this one are there
    outlines         of the strips that are there, by level; filled in on request
    """

    strips: tuple[Strip, ...]
    levels: tuple[int, ...]
    laid: tuple[int, ...]
    span: tuple[float, float]
    level: int
    outlines: dict[int, _Outline] = field(default_factory=dict, compare=False)

    def before(self, bead: int) -> LayeredSolid:
        """The solid after the first `bead` beads, without the layer of the last of them."""
        return replace(self, level=self.levels[self.laid[max(bead - 1, 0)]])

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from strips and bed; negative inside."""
        flat = points[:, ::2]
        bed = points[:, 2]
        outline = self._outline(self.level)
        if len(outline.points) == 0:
            return np.asarray(bed.copy())
        _, k = outline.tree.query(flat)
        away = flat - outline.points[k]
        out = (away * outline.normals[k]).sum(axis=1)
        aside = np.maximum(np.linalg.norm(away - out[:, None] * outline.normals[k], axis=1) - 0.5 * _SAMPLE, 0.0)
        across = np.where(self._covered(flat), -1.0, 1.0) * np.hypot(out, aside)
        beyond = np.maximum(self.span[0] - points[:, 1], points[:, 1] - self.span[1])
        outside = np.hypot(np.maximum(across, 0.0), np.maximum(beyond, 0.0))
        return np.asarray(np.minimum(outside + np.minimum(np.maximum(across, beyond), 0.0), bed))

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """True outward unit normals (n, 3) of a bead's layer at the places nearest to tips (n, 3)."""
        out = np.zeros((len(tips), 3))
        out[:, ::2] = self.strips[self.laid[bead]].normals(tips[:, ::2])
        return out

    def normals(self, points: Array) -> Array:
        """Unit directions (n, 3) in which the distance from strips grows; upwards next to the bed and inside."""
        out = np.tile([0.0, 0.0, 1.0], (len(points), 1))
        outline = self._outline(self.level)
        if len(outline.points) == 0:
            return out
        away = np.zeros_like(points)
        away[:, ::2] = points[:, ::2] - outline.points[outline.tree.query(points[:, ::2])[1]]
        away[:, 1] = points[:, 1] - np.clip(points[:, 1], *self.span)
        inside = self._covered(points[:, ::2])
        away[inside] = [0.0, 0.0, 0.0]
        size = np.linalg.norm(away, axis=1)
        free = (size > _NUDGE) & (size <= points[:, 2])
        out[free] = away[free] / size[free, None]
        return out

    def _covered(self, points: Array) -> Flags:
        """Which points (n, 2) lie in a printed strip, or one that is there from the start."""
        outline = self._outline(self.level)
        low, high = outline.box
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        covered = np.zeros(len(points), dtype=bool)
        covered[near] = outline.strips.holds(points[near])
        return covered

    def _there(self, level: int) -> list[Strip]:
        return [strip for strip, at in zip(self.strips, self.levels, strict=True) if at < level]

    def _outline(self, level: int) -> _Outline:
        if level not in self.outlines:
            there = self._there(level)
            new = (
                there if level == 0 else [s for s, at in zip(self.strips, self.levels, strict=True) if at == level - 1]
            )
            before = [] if level == 0 else [self._outline(level - 1)]
            added, whole = StripUnion.of(new), StripUnion.of(there)
            free = [_bare((o.points, o.normals), added) for o in before]
            for strip in new:
                free += [_bare(edge, whole) for edge in (_tips(strip), _bottom(strip), *_faces(strip))]
            self.outlines[level] = _collected(free, whole)
        return self.outlines[level]


def _bare(piece: _Piece, strips: StripUnion) -> _Piece:
    """The places of an edge that lie on no strip."""
    points, normals = piece
    bare = ~strips.holds(points + _NUDGE * normals)
    return points[bare], normals[bare]


def _collected(pieces: list[_Piece], strips: StripUnion) -> _Outline:
    none = np.zeros((0, 2))
    points = np.vstack([none, *(piece[0] for piece in pieces)])
    normals = np.vstack([none, *(piece[1] for piece in pieces)])
    return _Outline(points, normals, cKDTree(points), strips)


def _tips(strip: Strip) -> tuple[Array, Array]:
    """Places along a strip's tip curve, with their normals."""
    return strip.tips(np.linspace(0.0, strip.length, int(np.ceil(strip.length / _SAMPLE)) + 1))


def _bottom(strip: Strip) -> tuple[Array, Array]:
    """Places along a strip's underside, with their normals."""
    points, normals = _tips(strip)
    return points - strip.height * normals, -normals


def _faces(strip: Strip) -> list[tuple[Array, Array]]:
    """Places on the two ends of a strip, with their normals."""
    ends, normals = strip.tips(np.array([0.0, strip.length]))
    down = np.linspace(0.0, strip.height, int(np.ceil(strip.height / _SAMPLE)) + 1)
    along = np.column_stack([normals[:, 1], -normals[:, 0]])
    along *= np.sign(along @ (ends[1] - ends[0]))[:, None]
    return [
        (end - down[:, None] * normal, np.tile(out, (len(down), 1)))
        for end, normal, out in zip(ends, normals, along * [[-1.0], [1.0]], strict=True)
    ]


@dataclass(frozen=True)
class Filling:
    """How strips are filled.

    width, height  of a bead [m]
    tolerance      at the turns [m]
    run_in         length of a run-in [m]
    spacing        of passes, in bead widths, 1 or more
    apart          whether each pass is a bead of its own, with nothing laid in the turns
    """

    width: float
    height: float
    tolerance: float
    run_in: float
    spacing: float = 1.0
    apart: bool = False

    @classmethod
    def of(cls, process: ProcessSpec, spec: AerofoilLayersSpec) -> Filling:
        """For layers without gaps, as the problem says."""
        apart = spec.passes == "apart"
        return cls(process.bead.width, process.bead.height, process.corner_tolerance, process.run_in, apart=apart)

    def lines(self, passes: Sequence[Array], name: str) -> list[tuple[str, Array]]:
        """Names and waypoints (n, 2) of the beads along passes (k, 2), in print order."""
        if not self.apart or len(passes) == 1:
            return [(name, np.vstack(passes))]
        return [(f"{name} pass {k}", each) for k, each in enumerate(passes, 1)]


def fill_strip(
    strip: Strip, along: bool, span: tuple[float, float], filling: Filling, name: str, layer: int, start: Array | None
) -> tuple[list[Callable[[], Bead]], Array]:
    """Fill a strip between two y [m] with passes along its curve or along the span.

    Returns functions that make its bead, or one bead per pass, and the point (3) at which the last one ends. Passes
    stay half a pass inside the edges. The first begins at the corner nearest to `start` (3), if given. The tip surface
    is plane when unrolled, so turns are rounded there and all samples lie on the true curve.
    """
    sizes = np.array([strip.length, span[1] - span[0]])
    step_axis = 1 if along else 0
    passes = max(round(sizes[step_axis] / (filling.width * filling.spacing)), 1)
    pitch = sizes[step_axis] / passes
    low, high = np.full(2, 0.5 * filling.width), sizes - 0.5 * filling.width
    low[step_axis], high[step_axis] = 0.5 * pitch, sizes[step_axis] - 0.5 * pitch
    step = min(STEP, TURN / max(strip.bend, 1e-9)) if along else STEP
    plane = _zigzag(low, high, step_axis, passes, step)
    flips = [np.array(flip) for flip in itertools.product((False, True), repeat=2)]
    first = plane[0, 0]
    corners = [_in_space(strip, span, np.where(flip, sizes - first, first)[None])[0][0] for flip in flips]
    nearest = 0 if start is None else int(np.argmin([np.linalg.norm(corner - start) for corner in corners]))
    plane = np.where(flips[nearest], sizes - plane, plane)

    width, ends = pitch / filling.spacing, filling.run_in / PER_RUN
    lift = partial(_in_space, strip, span)
    lines = filling.lines(list(plane), name)
    tolerance, apart, height = filling.tolerance, APART * pitch, filling.height
    beads: list[Callable[[], Bead]] = [
        partial(rolled_bead, each, layer, line, lift, tolerance, apart, ends, width, height) for each, line in lines
    ]
    ends_at, _ = lift(lines[-1][1][-1:])
    return beads, np.asarray(ends_at[0])


def rolled_bead(
    name: str,
    layer: int,
    plane: Array,
    lift: Callable[[Array], tuple[Array, Array]],
    tolerance: float,
    apart: float,
    ends: float,
    width: float,
    height: float,
) -> Bead:
    """The bead through waypoints (m, 2) on an unrolled layer, where its turns are rounded.

    lift: points and outward unit normals (n, 3) of places (n, 2); for tolerance, apart and ends see `interpolate`.
    """
    flat = np.column_stack([plane, np.zeros(len(plane))])
    upwards = np.tile([0.0, 0.0, 1.0], (len(plane), 1))
    curve = interpolate(flat, upwards, tolerance, apart, ends)
    points, normals = lift(curve.points[:, :2])
    source, _ = lift(curve.source[:, :2])
    return make_bead(name, layer, points, normals, roll_zeros([normals])[0], source, width, height, closed=False)


def _zigzag(low: Array, high: Array, step_axis: int, passes: int, step: float) -> Array:
    """Waypoints (passes, n, 2) of straight passes between corners `low` and `high` (2), every other one reversed."""
    run_axis = 1 - step_axis
    count = max(int(np.ceil((high[run_axis] - low[run_axis]) / step)), 2)
    run = np.linspace(low[run_axis], high[run_axis], count + 1)
    out = np.empty((passes, count + 1, 2))
    out[:, :, run_axis] = run
    out[1::2, :, run_axis] = run[::-1]
    out[:, :, step_axis] = np.linspace(low[step_axis], high[step_axis], passes)[:, None]
    return out


def _in_space(strip: Strip, span: tuple[float, float], plane: Array) -> tuple[Array, Array]:
    """Points and normals (n, 3) of places (n, 2) on the unrolled strip: along its curve, along the span."""
    flat, outward = strip.tips(plane[:, 0])
    y = span[0] + plane[:, 1]
    points = np.column_stack([flat[:, 0], y, flat[:, 1]])
    return points, np.column_stack([outward[:, 0], np.zeros(len(y)), outward[:, 1]])
