"""Plane paths: sampling density, rounded corners, seams, minimum sizes, and the beads made from them.

Corners are rounded by the smoothest curve that stays within a tolerance of the polyline. A blend that cuts a corner
uses the tolerance on one side only; here every sample may move anywhere in a disc around its place on the input path,
and the curve's third derivative, which drives joint jerk, is made as small as the discs allow:

    minimise  sum |l^3 x'''|^2 + |x - p|^2   subject to  |x_i - p_i| <= tolerance

l is the rounding length; far from corners the second term holds the curve to the input. The problem is convex: a
log-barrier Newton method with a banded Cholesky factorisation solves it in time linear in the samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter1d

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths, subdivided
from planner.problem import Problem
from planner.problem.by_layer import SeamSpec
from planner.toolpath.bead import Bead

if TYPE_CHECKING:
    from planner.toolpath.svg.outlines import PlanePath

_SMOOTHING = 8.0  # mean steps: sigma of the Gaussian that averages the waypoints' own density
_REACH = 30.0  # × a corner's width: how far from it samples are closer together
_DENSITY_STEPS = 4

SAMPLES_PER_TOLERANCE = 2.0  # sample spacing = tolerance / 2: a rounded corner is some 10 tolerances long
ROUNDING_LENGTH = 12.5  # l in tolerances: long enough that a right angle uses its whole disc
OVERLAP = 16.0  # in l: how far a closed path is unrolled past its seam; the ends' influence is e^-8 there
_BARRIERS = (1e4, 1e3, 1e2, 1e1)  # against an objective of some 6,000 per sample at a corner
_NEWTON_STEPS = 20
_KEPT_ROOM = 0.01  # share of a sample's room r^2 - |e|^2 that a step must leave: numbers stay finite
_FINEST = 0.5  # × the tolerance: if less of it is used, samples get no closer together
_LEAST = 0.1  # × the tolerance: least radius of a disc; where the tolerance is shared out, few samples see a corner
_SHRINK = 0.98  # × the tolerance: leaves a margin for the curve between samples

_SHRUNK = 0.5  # share of its length that a path must keep when its corners are rounded
_KINK = np.radians(10.0)  # a turn above this at one vertex counts as a corner when a seam is placed

_ASIDE = 0.1  # × the distance between two corners: a seam keeps this far from both
_SEAMS = 360  # candidate places for a seam between two corners, or around a path without corners

_CLOSED = 1e-6  # m: a bead whose ends are nearer than this is closed
_SOURCE_STEP = 1e-4  # m: greatest step of a densified polyline, 0.04 um off the true helix at a radius of 34 mm


@dataclass(frozen=True)
class SampleDensity:
    """Samples per metre along a curve of chord length `length` [m].

    counted   spline of the number of samples up to a chord length, without those added at corners
    corners   chord lengths (k) around which samples are added, `spacing` (k) apart there, over about `width` (k)
    """

    length: float
    counted: Any
    corners: Array
    spacing: Array
    width: Array

    @classmethod
    def of_steps(cls, chord: Array, samples: Array) -> SampleDensity:
        """The smoothed density of waypoints at chord lengths (m); each step is worth so many samples (m - 1)."""
        cells = max(len(chord) - 1, 4)
        grid = np.linspace(0.0, chord[-1], cells + 1)
        steps = np.diff(np.interp(grid, chord, np.concatenate([[0.0], np.cumsum(samples)])))
        even = gaussian_filter1d(steps, _SMOOTHING, mode="nearest") / (chord[-1] / cells)
        middle = 0.5 * (grid[1:] + grid[:-1])
        x, y = np.concatenate([grid[:1], middle, grid[-1:]]), np.concatenate([even[:1], even, even[-1:]])
        none = np.zeros(0)
        return cls(float(chord[-1]), CubicSpline(x, y).antiderivative(), none, none, none)

    def denser(self, corners: Array, spacing: float, width: float) -> SampleDensity:
        """The same, plus samples `spacing` [m] apart at corners (chord lengths), over about `width` [m]."""
        k = np.ones(len(corners))
        return replace(
            self,
            corners=np.concatenate([self.corners, corners]),
            spacing=np.concatenate([self.spacing, k * spacing]),
            width=np.concatenate([self.width, k * width]),
        )

    def spacing_at(self, c: Array) -> Array:
        """Distance (k) between samples at chord lengths c (k) [m]."""
        return 1.0 / self._density(c)

    def samples(self, fewest: int) -> Array:
        """Chord lengths (n) of the samples, both ends included; n is at least `fewest`."""
        rough = np.linspace(0.0, self.length, max(8, int(self.counted(self.length)) + 1))
        offsets = np.sinh(np.linspace(-4.0, 4.0, 65))
        around = (self.corners[:, None] + self.width[:, None] * offsets).ravel()
        rough = np.unique(np.clip(np.concatenate([rough, around]), 0.0, self.length))
        total = self._count(rough)
        n = max(round(float(total[-1])), fewest - 1)
        target = np.linspace(0.0, total[-1], n + 1)
        c = np.interp(target, total, rough)
        for _ in range(_DENSITY_STEPS):
            c = np.clip(c - (self._count(c) - target) / self._density(c), 0.0, self.length)
            c = np.maximum.accumulate(c)
        c[[0, -1]] = 0.0, self.length
        return c

    def _count(self, c: Array) -> Array:
        """Number of samples up to increasing chord lengths c (n)."""
        count = np.asarray(self.counted(c))
        bump = _bumps_up_to()
        for corner, spacing, width in zip(self.corners, self.spacing, self.width, strict=True):
            first, last = np.searchsorted(c, [corner - _REACH * width, corner + _REACH * width])
            here = width / spacing
            start = float(bump(np.clip(-corner / width, -_REACH, 0.0)))  # counted from the curve's start
            count[first:last] += here * (bump((c[first:last] - corner) / width) - start)
            count[last:] += here * (bump(_REACH) - start)
        return count

    def _density(self, c: Array) -> Array:
        density = np.asarray(self.counted(c, 1))
        bump = _bump()
        for corner, spacing, width in zip(self.corners, self.spacing, self.width, strict=True):
            near = slice(*np.searchsorted(c, [corner - _REACH * width, corner + _REACH * width]))
            density[near] += bump((c[near] - corner) / width) / spacing
        return density


@cache
def _bump() -> CubicSpline:
    """1 / (1 + x^2) on [-REACH, REACH], faded to 0 at both ends: neighbouring spacings grow by a fifth at most."""
    x = np.sinh(np.linspace(-1.0, 1.0, 1601) * np.arcsinh(_REACH))
    return CubicSpline(x, (1.0 - (x / _REACH) ** 2) ** 3 / (1.0 + x * x))


@cache
def _bumps_up_to() -> Any:
    """Integral of `_bump` from -REACH."""
    return _bump().antiderivative()


@dataclass(frozen=True)
class PlaneCurve:
    """A rounded path, sampled uniformly in the arc length u of its input path.

    points (n, 2) on the curve, source (m, 2) the input polyline [m]; closed: the last point is the first.
    The samples are closer together where the curve turns sharply.
    """

    name: str
    points: Array
    source: Array
    closed: bool


def round_corners(path: PlanePath, tolerance: float, share: Callable[[Array], Array] | None = None) -> PlaneCurve:
    """Smooth a polyline within `tolerance` [m] of itself, sample by sample (so in Fréchet distance too).

    Open paths keep their end points; closed ones are smooth across the seam. If `share` is given, only that share (n)
    of the tolerance is used at points (n, 2) of the path.
    """
    length = ROUNDING_LENGTH * tolerance
    arc = arc_lengths(path.points)
    finest = tolerance if share is None else tolerance * max(float(share(path.points).min()), _FINEST)
    n = max(int(np.ceil(arc[-1] / finest * SAMPLES_PER_TOLERANCE)), 8)
    step = arc[-1] / n
    if path.closed:
        extra = int(np.ceil(OVERLAP * length / step))
        u = np.arange(-extra, n + extra + 1) * step
        p = _along(path.points, arc, np.mod(u, arc[-1]))
        radius = _disc_radii(path, arc, u, p, _rooms(p, tolerance, share))
        x = _smooth(p, radius, length / step)[extra : extra + n + 1]
        gap = x[0] - x[-1]  # some nanometres: spread it, so that the curve closes exactly
        x = x + np.linspace(-0.5, 0.5, n + 1)[:, None] * gap
        x[-1] = x[0]
    else:
        u = np.arange(n + 1) * step
        p = _along(path.points, arc, u)
        x = _smooth(p, _disc_radii(path, arc, u, p, _rooms(p, tolerance, share)), length / step)
    return PlaneCurve(path.name, x, path.points, path.closed)


def _along(points: Array, arc: Array, u: Array) -> Array:
    return np.column_stack([np.interp(u, arc, points[:, k]) for k in range(2)])


def _rooms(p: Array, tolerance: float, share: Callable[[Array], Array] | None) -> Array:
    """The tolerance (n) at each sample."""
    return np.full(len(p), tolerance) if share is None else tolerance * share(p)


def _disc_radii(path: PlanePath, arc: Array, u: Array, p: Array, tolerance: Array) -> Array:
    """Radius (n) of each sample's disc [m], within its tolerance (n): smaller next to corners between samples.

    A corner at a distance h from the chord of its two samples p is within radius + h of the curve.
    """
    radius = tolerance * _SHRINK
    corner = path.points[:-1] if path.closed else path.points[1:-1]
    at = arc[:-1] if path.closed else arc[1:-1]
    if path.closed:
        loops = np.arange(np.floor(u[0] / arc[-1]), np.ceil(u[-1] / arc[-1]) + 1)
        at = (at[None, :] + loops[:, None] * arc[-1]).ravel()
        corner = np.tile(corner, (len(loops), 1))
    k = np.floor((at - u[0]) / (u[1] - u[0])).astype(int)
    inside = (k >= 0) & (k < len(u) - 1)
    k, corner = k[inside], corner[inside]
    chord = p[k + 1] - p[k]
    t = ((corner - p[k]) * chord).sum(axis=1) / np.maximum((chord * chord).sum(axis=1), 1e-30)
    h = np.linalg.norm(corner - p[k] - np.clip(t, 0.0, 1.0)[:, None] * chord, axis=1)
    for beside in (k, k + 1):
        np.minimum.at(radius, beside, tolerance[beside] * _SHRINK - h)
    return np.maximum(radius, _LEAST * tolerance)


def _smooth(p: Array, radius: Array, stiffness: float) -> Array:
    """Solve the rounding problem (see the top of this file) for samples p (n, 2) with discs of `radius` (n).

    `stiffness` is l in sample steps. End points are kept. Internally, x and y are rows: numpy is three times as fast
    along rows of n as along pairs.
    """
    n = len(p)
    third = _third_difference_bands(n, stiffness**6)
    scale = float(radius.max())
    held = np.ones(n)
    held[[0, -1]] = 1e12  # weight of |x - p|^2 that pins the ends
    problem = _Rounding(np.ascontiguousarray((p / scale).T), (radius / scale) ** 2, held, third)
    at = problem.at(problem.P)
    for barrier in _BARRIERS:
        for _ in range(_NEWTON_STEPS):
            pull = held + 2.0 * barrier / at.room
            bend = 4.0 * barrier / at.room**2
            gradient = at.bent + at.e * pull
            bands = np.zeros((7, 2 * n))
            for k in range(4):
                bands[2 * k, 0::2] = bands[2 * k, 1::2] = third[k]
            bands[0, 0::2] += pull + bend * at.e[0] ** 2
            bands[0, 1::2] += pull + bend * at.e[1] ** 2
            bands[1, 0::2] = bend * at.e[0] * at.e[1]
            step = -solveh_banded(bands, gradient.T.ravel(), lower=True, overwrite_ab=True, check_finite=False)
            step = np.ascontiguousarray(step.reshape(n, 2).T)
            decrement = -float((gradient * step).sum())
            at = _line_search(problem, at, step, decrement, barrier)
            if decrement < 0.1 * barrier:
                break
    return at.X.T * scale


class _Samples(NamedTuple):
    """Samples X (2, n), e = X - P, |e|^2 (n), the room (n) left in their discs, and the bands' product with X."""

    X: Array
    e: Array
    e2: Array
    room: Array
    bent: Array


class _Rounding(NamedTuple):
    """The rounding problem: places P (2, n), squared radii (n), weights (n) of |x - p|^2, bands (4, n) of l^6 D^T D."""

    P: Array
    r2: Array
    held: Array
    third: Array

    def at(self, X: Array) -> _Samples:
        """Everything derived from samples X."""
        e = X - self.P
        e2 = e[0] * e[0] + e[1] * e[1]
        return _Samples(X, e, e2, self.r2 - e2, _apply(self.third, X))

    def has_room(self, X: Array, least_room: Array) -> bool:
        """Whether all samples X have at least `least_room`."""
        e = X - self.P
        return bool((self.r2 - (e[0] * e[0] + e[1] * e[1]) >= least_room).all())

    def value(self, at: _Samples, barrier: float) -> float:
        """The barrier function."""
        energy = 0.5 * (at.X * at.bent).sum() + 0.5 * self.held @ at.e2
        return float(energy - barrier * np.log(at.room).sum())


def _line_search(problem: _Rounding, at: _Samples, step: Array, decrement: float, barrier: float) -> _Samples:
    """Halve a Newton step until it stays inside every disc and lowers the barrier function enough."""
    start, least_room, scale = problem.value(at, barrier), _KEPT_ROOM * at.room, 1.0
    while scale > 1e-6:
        X = at.X + scale * step
        if problem.has_room(X, least_room):
            then = problem.at(X)
            if problem.value(then, barrier) <= start - 0.1 * scale * decrement:
                return then
        scale *= 0.5
    return at


def _third_difference_bands(n: int, weight: float) -> Array:
    """Lower bands (4, n) of weight * D^T D, D the third difference."""
    d = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for a in range(4):
        for b in range(a + 1):
            bands[a - b, b : b + n - 3] += weight * d[a] * d[b]
    return bands


def _apply(bands: Array, x: Array) -> Array:
    """Product of a symmetric matrix given by its lower bands with each row of x (2, n)."""
    n = x.shape[1]
    y = bands[0] * x
    for k in range(1, len(bands)):
        y[:, k:] += bands[k, : n - k] * x[:, :-k]
        y[:, :-k] += bands[k, : n - k] * x[:, k:]
    return y


def with_seam(
    path: PlanePath, spec: SeamSpec | None = None, place: Callable[[Array], Array] | None = None
) -> PlanePath:
    """Start a closed path at the requested seam, or as far from its corners as possible; an open one is unchanged.

    Run-in and run-out are smooth only away from corners. A requested seam keeps away from them, too, by a share of the
    distance between two of them.
    place: maps plane points (k, 2) to the part frame (k, 3) [m]
    """
    if not path.closed:
        return path
    loop = path.points[:-1]
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
    arc = arc_lengths(path.points)
    corners = arc[:-1][np.abs(turn) > _KINK]
    if len(corners) == 0 and spec is None:
        return path
    gaps = np.diff(np.concatenate([corners, [corners[0] + arc[-1]]])) if len(corners) else arc[-1:]
    if spec is None or place is None:
        start = corners[np.argmax(gaps)] + 0.5 * gaps.max()
    else:
        share = (
            np.linspace(_ASIDE, 1.0 - _ASIDE, _SEAMS) if len(corners) else np.linspace(0.0, 1.0, _SEAMS, endpoint=False)
        )
        tried = ((corners if len(corners) else arc[:1])[:, None] + share * gaps[:, None]).ravel() % arc[-1]
        points = place(np.column_stack([np.interp(tried, arc, column) for column in path.points.T]))
        start = tried[np.argmin(_away(points, spec))]
    start = float(np.mod(start, arc[-1]))
    k = int(np.searchsorted(arc, start, side="right"))
    t = (start - arc[k - 1]) / (arc[k] - arc[k - 1])
    seam = path.points[k - 1] + t * (path.points[k] - path.points[k - 1])
    around = np.vstack([seam[None], path.points[k:-1], path.points[:k], seam[None]])
    step = np.hypot(*np.diff(around, axis=0).T)
    keep = np.concatenate([[True], step > 1e-12])  # a seam on a vertex would be there twice
    points = around[keep]
    points[-1] = seam
    return replace(path, points=points)


def _away(points: Array, spec: SeamSpec) -> Array:
    """How far (k) points (k, 3) are from the requested seam; infinitely far if they are NaN."""
    if spec.near is not None:
        away = np.linalg.norm(points - spec.near, axis=1)
    else:
        away = -points @ np.asarray(spec.towards)
    return np.where(np.isnan(away), np.inf, away)


def length(points: Array) -> float:
    """Length of a polyline (n, d) [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def check_size(problem: Problem, name: str, drawn: float, rounded: float, hint: str) -> None:
    """Raise InputError for a path that rounding shortens too much; lengths `drawn` and `rounded` [m]."""
    if rounded < _SHRUNK * drawn:
        raise problem.error(
            "process.corner_tolerance_mm",
            f"rounding its corners shrinks path {name!r} from {drawn * 1e3:.2f} to {rounded * 1e3:.2f} mm",
            hint,
        )


def make_bead(
    name: str,
    layer: int,
    points: Array,
    normals: Array,
    roll_zero: Array,
    source: Array,
    width: Array | float,
    height: Array | float,
    closed: bool | None = None,
    material: str = "",
) -> Bead:
    """The bead through points (n, 3) that are uniform in its parameter [m]; its fields are those of Bead.

    width and height [m] are given at each point (n,), or once for the whole bead; closed: None to decide by its ends.
    """
    return Bead(
        name=name,
        layer=layer,
        s=arc_length(points),
        points=points,
        normals=normals,
        roll_zero=roll_zero,
        source=source,
        width=np.full(len(points), width),
        height=np.full(len(points), height),
        closed=bool(np.linalg.norm(points[-1] - points[0]) < _CLOSED) if closed is None else closed,
        material=material,
    )


def arc_length(points: Array) -> Array:
    """Arc length (n,) along the smooth curve through points (n, 3) that are uniform in its parameter."""
    u = np.arange(len(points), dtype=float)
    spline = make_interp_spline(u, points, k=min(5, len(points) - 1))
    # Gauss-Legendre, three points per interval: exact to 1e-12 m if the spline is resolved at all
    nodes, weights = np.polynomial.legendre.leggauss(3)
    mid = u[:-1, None] + 0.5 * (nodes[None, :] + 1.0)
    speed = np.linalg.norm(spline(mid.ravel(), 1), axis=1).reshape(mid.shape)
    return np.concatenate([[0.0], np.cumsum(0.5 * speed @ weights)])


def densify(polyline: Array) -> Array:
    """The same polyline with no segment longer than `_SOURCE_STEP`; its vertices are kept."""
    lengths = np.hypot(*np.diff(polyline, axis=0).T)
    pieces = np.maximum(np.ceil(lengths / _SOURCE_STEP).astype(int), 1)
    index, share = subdivided(pieces)
    dense = polyline[index] + share[:, None] * np.diff(polyline, axis=0)[index]
    return np.vstack([dense, polyline[-1]])
