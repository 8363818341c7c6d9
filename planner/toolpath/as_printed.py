"""Layers laid on what is really there: the height map of a scan, smoothed, and beads that make up for it layer by layer.

The map has places on the planned top of the last printed layer, each with the deviation of the print along the normal
there. At a place of any layer it is read by local linear regression in the tangent plane (moving least squares): the
nodes within a radius count with Wendland's weight, which is smooth and ends at the radius. Where the map ends, the place
nearest to its end stands for those beyond.

A bead may be made higher or lower by `most` at most. Of a deviation e of what lies beneath it makes up for
most * tanh(e / most): all of a small one, `most` of a large one, and smooth in between. What is left is the next layer's.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.errors import Complaint
from planner.base.files import read_text
from planner.problem import Problem
from planner.toolpath.bead import Bead, Surface, SurfaceOver, Toolpath
from planner.toolpath.plane_paths import arc_length

COLUMNS = ("x_mm", "y_mm", "z_mm", "nx", "ny", "nz", "deviation_mm")  # of a map's file, and more that is for people
LARGEST_MAP = 100_000_000  # bytes: a million places
MOST_SHARE = (
    0.5  # of a bead's height, by which it may be made higher or lower: thinner ones do not hold, higher ones sag
)
SAME_SIDE = 0.5  # least cosine of a node's normal and a place's: the other side of a thin wall says nothing
LEVELLING = 1e-3  # of the weights' spread, added to that of slopes: a single row of nodes has none across
_KNOTS = 12.0  # in the radius: places along a bead between which deviations are interpolated
_WITHIN = 0.5  # of the radius, by which places may lie beside the map
_TOGETHER = 4096  # places
_STEPS = 2  # from a place above the map down to its nearest node


@dataclass(frozen=True)
class DeviationField(ReadOnlyArrays):
    """A height map (n nodes) that can be asked anywhere.

    points (n, 3)   on the planned top of a layer, part frame [m];  normals (n, 3) outward, of unit length
    deviation (n)   of the printed top along the normal [m]
    radius          within which nodes count [m]
    bent            whether regression is quadratic, as holes ask for, instead of linear
    """

    points: Array
    normals: Array
    deviation: Array
    radius: float
    bent: bool = False

    def at(self, places: Array, normals: Array) -> Array:
        """Smoothed deviation (k) [m] beneath places (k, 3) of any layer whose unit normals are (k, 3)."""
        out = np.empty(len(places))
        for first in range(0, len(places), _TOGETHER):
            rows = slice(first, first + _TOGETHER)
            out[rows] = self._some(places[rows], normals[rows])
        return out

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)

    def _some(self, places: Array, normals: Array) -> Array:
        foot, tree = places, self._tree
        for _ in range(_STEPS):
            _, near = tree.query(foot)
            rise = ((places - self.points[near]) * normals).sum(axis=1)
            foot = places - rise[:, None] * normals
        away, near = tree.query(foot)
        beyond = np.maximum(1.0 - _WITHIN * self.radius / np.maximum(away, 1e-12), 0.0)
        foot = foot + beyond[:, None] * (self.points[near] - foot)
        own = tree.query_ball_point(foot, self.radius)
        count = np.array([len(each) for each in own])
        of = np.repeat(np.arange(len(foot)), count)
        node = np.concatenate([np.asarray(each, dtype=np.int64) for each in own])
        same = (self.normals[node] * normals[of]).sum(axis=1) > SAME_SIDE
        return self._regressed(foot, normals, of[same], node[same], near)

    def _regressed(self, foot: Array, normals: Array, of: Ints, node: Ints, near: Ints) -> Array:
        """Deviation (k) at feet (k, 3) from pairs (m) of a foot and a node; that of the nearest node (k) where there is none."""
        k = len(foot)
        first = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
        first /= np.linalg.norm(first, axis=1)[:, None]
        second = np.cross(normals, first)
        way = self.points[node] - foot[of]
        x, y = (way * first[of]).sum(axis=1), (way * second[of]).sum(axis=1)
        weight = wendland(np.hypot(x, y) / self.radius)
        x, y = x / self.radius, y / self.radius
        rows = [np.ones(len(of)), x, y, *((x * x, x * y, y * y) if self.bent else ())]
        m = len(rows)
        matrix, right = np.empty((k, m, m)), np.empty((k, m))
        for i in range(m):
            right[:, i] = np.bincount(of, weight * rows[i] * self.deviation[node], minlength=k)
            for j in range(m):
                matrix[:, i, j] = np.bincount(of, weight * rows[i] * rows[j], minlength=k)
        total = matrix[:, 0, 0]
        none = total <= 0.0
        matrix[none] = np.eye(m)
        slopes = np.arange(1, m)
        matrix[:, slopes, slopes] += LEVELLING * np.where(none, 1.0, total)[:, None]
        found = np.linalg.solve(matrix, right[:, :, None])[:, 0, 0]
        return np.where(none, self.deviation[near], found)


def wendland(share: Array) -> Array:
    """Weight (...) at shares of a radius: 1 in the middle, 0 from the radius on, twice differentiable (Wendland, 1995)."""
    inside = np.clip(1.0 - share, 0.0, 1.0)
    return np.asarray(inside**4 * (4.0 * share + 1.0))


def made_up(deviation: Array, most: float) -> Array:
    """How much of a deviation (n) [m] one layer makes up for, where its beads may change by `most` [m]."""
    return np.asarray(most * np.tanh(deviation / most))


def left(deviation: Array, most: float, layers: int) -> Array:
    """What is left (n) [m] of a deviation (n) on top of so many layers."""
    for _ in range(layers):
        deviation = deviation - made_up(deviation, most)
    return deviation


def read_map(path: Path, radius: float, complain: Complaint) -> DeviationField:
    """The height map in a file. Raises InputError, made by `complain`, where there is none, or one of its rows is none."""
    lines = read_text(path, LARGEST_MAP, complain)
    try:
        rows = [row for row in csv.reader(line for line in lines if not line.startswith("#")) if row]
    except csv.Error as error:
        raise complain(f"{path.name} is not CSV: {error}", hint="beadwise scan writes it") from None
    header = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in COLUMNS if name not in header]
    if missing or len(rows) < 2:
        raise complain(
            f"{path.name} is no height map: {missing[0] if missing else 'places'} missing", hint="beadwise scan"
        )
    at = [header.index(name) for name in COLUMNS]
    try:
        table = np.array([[float(row[k]) for k in at] for row in rows[1:]])
    except (ValueError, IndexError):
        raise complain(f"{path.name} has a row that is not numbers", hint="beadwise scan writes it") from None
    size = np.linalg.norm(table[:, 3:6], axis=1)
    if not np.isfinite(table).all() or (np.abs(size - 1.0) > 1e-3).any():
        raise complain(f"{path.name} has numbers that are not finite, or normals not of unit length", hint=None)
    return DeviationField(table[:, :3] * 1e-3, table[:, 3:6] / size[:, None], table[:, 6] * 1e-3, radius)


def printed_beads(problem: Problem, toolpath: Toolpath) -> int:
    """How many beads lie in the layers that a scan found printed; 0 without one.

    Raises InputError where no layer is above them, or beads of lower layers come after those of higher ones.
    """
    if problem.as_printed is None:
        return 0
    layers = [bead.layer for bead in toolpath.beads]
    return beads_up_to(layers, problem.as_printed.after_layer, partial(problem.error, "as_printed.after_layer"))


def beads_up_to(layers: Sequence[int], last: int, complain: Complaint) -> int:
    """How many of beads in these layers (from 0), in print order, belong to the first `last` layers. Raises InputError, made
    by `complain`, where there is no such layer, none above it, or beads do not come layer by layer."""
    there = sorted({layer + 1 for layer in layers})
    if last not in there:
        raise complain(f"there is no layer {last}", hint=f"layers {there[0]} to {there[-1]} are printed")
    if last == there[-1]:
        raise complain(f"no layer is above layer {last}", hint="the last one has nothing to make up for it")
    count = sum(layer < last for layer in layers)
    if any(layer >= last for layer in layers[:count]):
        raise complain(
            f"beads of layer {last} or below come after others above it", hint="this print is not made in layers"
        )
    return count


def on_what_is_printed(problem: Problem, toolpath: Toolpath) -> Toolpath:
    """The toolpath on what a scan found; as it is where there was none.

    Beads of printed layers are moved to where the print is, and those above by what is left of its deviation there; the
    latter are as high as it takes. Raises InputError for a map that cannot be read, layers that there are not, bounds beyond
    what beads bear, and prints without tops or heights to correct.
    """
    spec = problem.as_printed
    if spec is None:
        return toolpath
    printed = printed_beads(problem, toolpath)
    if any(bead.round for bead in toolpath.beads):
        raise problem.error("as_printed", "struts in space have no top that others lie on", "leave it out")
    if problem.process.section == "fibre":
        reason = "a fibre is as thick as it comes, and makes up for nothing"
        raise problem.error("as_printed", reason, "leave it out")
    least = min(float(bead.height.min()) for bead in toolpath.beads[printed:])
    if spec.most > MOST_SHARE * least:
        reason = f"is more than half of a bead, which is {least * 1e3:g} mm high"
        raise problem.error("as_printed.most_mm", reason, f"at most {MOST_SHARE * least * 1e3:g}")
    field = read_map(spec.map, spec.smoothing, partial(problem.error, "as_printed.map"))
    beads = tuple(_moved(problem, field, bead) for bead in toolpath.beads)
    off = field.at(field.points, field.normals)
    over = left(off, spec.most, toolpath.layers - spec.after_layer)
    note = (
        f"layers above layer {spec.after_layer} are laid on what is printed, which is off by up to "
        f"{np.abs(off).max() * 1e3:.2f} mm; {np.abs(over).max() * 1e3:.2f} mm of that are left on top"
    )
    if problem.process.extruder.motor == "on_off":
        note += "; its motor is on or off, so that flow follows from bead to bead only, not within one"
    surface = ScannedSurface(
        toolpath.surface, tuple(bead.s for bead in beads), tuple(bead.s for bead in toolpath.beads)
    )
    return replace(toolpath, beads=beads, surface=surface, notes=(*toolpath.notes, note))


@dataclass(frozen=True)
class ScannedSurface(SurfaceOver):
    """The surface beneath a toolpath whose beads were moved to where a print is: arc lengths of each bead's samples as it is
    laid, and as it was drawn [m]."""

    laid: tuple[Array, ...]
    drawn: tuple[Array, ...]

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Normals on which a bead was drawn, at the same samples."""
        laid, drawn = self.laid[bead], self.drawn[bead]
        return self.surface.normals_on(bead, s + np.interp(s, laid, drawn - laid), tips)

    def before(self, bead: int) -> Surface:
        """The surface when so many beads have been printed."""
        return self.surface.before(bead)


def _moved(problem: Problem, field: DeviationField, bead: Bead) -> Bead:
    """A bead where it lies on what is printed."""
    spec = problem.as_printed
    if spec is None:
        raise TypeError("nothing was scanned")
    knots = max(int(np.ceil(_KNOTS * bead.length / field.radius)), 3) + 1
    s = np.linspace(0.0, bead.length, knots)
    places, normals = (
        np.stack([np.interp(s, bead.s, column) for column in values.T], axis=1)
        for values in (bead.points, bead.normals)
    )
    deviation = CubicSpline(s, field.at(places, normals / np.linalg.norm(normals, axis=1)[:, None]))(bead.s)
    above = bead.layer + 1 - spec.after_layer
    top = left(deviation, spec.most, max(above, 0))
    height = bead.height
    if above > 0:
        height = height - made_up(left(deviation, spec.most, above - 1), spec.most)
        if problem.process.section == "rounded" and (height > bead.width).any():
            reason = f"makes bead {bead.name!r} {height.max() * 1e3:.2f} mm high, more than it is wide"
            raise problem.error("as_printed.most_mm", reason, "a rounded bead is at least as wide as high")
    points = bead.points + top[:, None] * bead.normals
    near = cKDTree(bead.points).query(bead.source)[1]
    source = bead.source + _beside(bead, top, near)
    return replace(bead, s=arc_length(points), points=points, source=source, height=height)


def _beside(bead: Bead, top: Array, near: Ints) -> Array:
    """By how much (m, 3) places of the source move that lie beside samples (m) of the bead: linear between two samples."""
    out = np.empty((len(near), 3))
    moves = top[:, None] * bead.normals
    last = len(bead.s) - 1
    way = bead.points[np.minimum(near + 1, last)] - bead.points[np.maximum(near - 1, 0)]
    size = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    along = ((bead.source - bead.points[near]) * way).sum(axis=1) / size
    s = bead.s[near] + along
    for k in range(3):
        out[:, k] = np.interp(s, bead.s, moves[:, k])
    return out
