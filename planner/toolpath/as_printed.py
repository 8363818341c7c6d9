"""Layers laid on the print as it really is: a scan's height map, smoothed, and beads that compensate for it.

The map has nodes on the planned top of the last printed layer, each with the deviation of the print along the normal
there. Anywhere on any layer it is evaluated by local linear regression in the tangent plane (moving least squares):
nodes within a radius are weighted with Wendland's function, which is smooth and vanishes at the radius. Beyond the edge
of the map, the nearest place at its edge stands in.

A bead may be made at most `most` higher or lower. Of a deviation e of the surface beneath, it compensates
most * tanh(e / most): all of a small one, `most` of a large one, and smooth in between. The next layer continues with
the remainder.
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

COLUMNS = ("x_mm", "y_mm", "z_mm", "nx", "ny", "nz", "deviation_mm")  # read from a map's file; others are for people
LARGEST_MAP = 100_000_000  # bytes: a million places
MOST_SHARE = 0.5  # × a bead's height: greatest correction; thinner beads do not hold, higher ones sag
SAME_SIDE = 0.5  # least cosine between the normals of a node and a place: excludes the other side of a thin wall
LEVELLING = 1e-3  # × the total weight, added to the slopes' diagonal: a single row of nodes leaves one undetermined
_KNOTS = 12.0  # per radius: knots along a bead between which deviations are interpolated
_WITHIN = 0.5  # × the radius: greatest distance from the nearest node; places farther off are moved this near
_TOGETHER = 4096  # places evaluated at once
_STEPS = 2  # in which a place above the map is projected down to its nearest node's height


@dataclass(frozen=True)
class DeviationField(ReadOnlyArrays):
    """A height map (n nodes) that can be evaluated anywhere.

    points (n, 3)   on the planned top of a layer, part frame [m];  normals (n, 3) outward, of unit length
    deviation (n)   of the printed top along the normal [m]
    radius          within which nodes count [m]
    bent            whether regression is quadratic, for filling holes, instead of linear
    """

    points: Array
    normals: Array
    deviation: Array
    radius: float
    bent: bool = False

    def at(self, places: Array, normals: Array) -> Array:
        """Smoothed deviation (k) [m] beneath places (k, 3) on any layer, with unit normals (k, 3)."""
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
        """Deviation (k) at feet (k, 3) from pairs (m) of foot and node; without any, that of the nearest node (k)."""
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
    """Weight (...) at shares of a radius: 1 at 0, 0 from the radius on, twice differentiable (Wendland, 1995)."""
    inside = np.clip(1.0 - share, 0.0, 1.0)
    return np.asarray(inside**4 * (4.0 * share + 1.0))


def made_up(deviation: Array, most: float) -> Array:
    """How much of a deviation (n) [m] one layer compensates, if its beads may change by `most` [m]."""
    return np.asarray(most * np.tanh(deviation / most))


def left(deviation: Array, most: float, layers: int) -> Array:
    """Remainder (n) [m] of a deviation (n) on top of so many layers."""
    for _ in range(layers):
        deviation = deviation - made_up(deviation, most)
    return deviation


def read_map(path: Path, radius: float, complain: Complaint) -> DeviationField:
    """Read a height map. Raises InputError, made by `complain`, if the file is no map or has an invalid row."""
    lines = read_text(path, LARGEST_MAP, complain)
    try:
        rows = [row for row in csv.reader(line for line in lines if not line.startswith("#")) if row]
    except csv.Error as error:
        raise complain(f"{path.name} is not CSV: {error}", hint="beadwise scan writes it") from None
    header = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in COLUMNS if name not in header]
    if missing or len(rows) < 2:
        raise complain(
            f"{path.name} is not a height map: {missing[0] if missing else 'places'} missing",
            hint="beadwise scan writes it",
        )
    at = [header.index(name) for name in COLUMNS]
    try:
        table = np.array([[float(row[k]) for k in at] for row in rows[1:]])
    except (ValueError, IndexError):
        raise complain(f"{path.name} has a row that is not all numbers", hint="beadwise scan writes it") from None
    size = np.linalg.norm(table[:, 3:6], axis=1)
    if not np.isfinite(table).all() or (np.abs(size - 1.0) > 1e-3).any():
        raise complain(f"{path.name} has numbers that are not finite, or normals not of unit length", hint=None)
    return DeviationField(table[:, :3] * 1e-3, table[:, 3:6] / size[:, None], table[:, 6] * 1e-3, radius)


def printed_beads(problem: Problem, toolpath: Toolpath) -> int:
    """Number of beads in the layers that a scan found printed; 0 without a scan.

    Raises InputError if no layer lies above them, or if beads of lower layers come after those of higher ones.
    """
    if problem.as_printed is None:
        return 0
    layers = [bead.layer for bead in toolpath.beads]
    return beads_up_to(layers, problem.as_printed.after_layer, partial(problem.error, "as_printed.after_layer"))


def beads_up_to(layers: Sequence[int], last: int, complain: Complaint) -> int:
    """Number of beads in the first `last` layers, given each bead's layer (from 0) in print order.

    Raises InputError, made by `complain`, if there is no such layer, if none is above it, or if beads do not come layer
    by layer.
    """
    there = sorted({layer + 1 for layer in layers})
    if last not in there:
        raise complain(f"there is no layer {last}", hint=f"layers {there[0]} to {there[-1]} are printed")
    if last == there[-1]:
        raise complain(f"layer {last} is the last one", hint="a layer above it is needed to make up for the deviation")
    count = sum(layer < last for layer in layers)
    if any(layer >= last for layer in layers[:count]):
        raise complain(
            f"beads of layer {last} or below are printed after beads above it",
            hint="this print is not built layer by layer",
        )
    return count


def on_what_is_printed(problem: Problem, toolpath: Toolpath) -> Toolpath:
    """The toolpath corrected for a scanned print; unchanged without a scan.

    Beads of printed layers are moved to where the print is, those above by what remains of its deviation there; the
    heights of the latter are adjusted to match. Raises InputError for a map that cannot be read, layers that do not
    exist, corrections greater than beads tolerate, and prints without tops or heights to correct.
    """
    spec = problem.as_printed
    if spec is None:
        return toolpath
    printed = printed_beads(problem, toolpath)
    if any(bead.round for bead in toolpath.beads):
        raise problem.error(
            "as_printed", "struts in space have no top surface for other beads to lie on", "leave it out"
        )
    if problem.process.section == "fibre":
        reason = "a fibre has a fixed thickness, so it cannot make up for deviations"
        raise problem.error("as_printed", reason, "leave it out")
    least = min(float(bead.height.min()) for bead in toolpath.beads[printed:])
    if spec.most > MOST_SHARE * least:
        reason = f"is more than half the height of a bead, {least * 1e3:g} mm"
        raise problem.error("as_printed.most_mm", reason, f"at most {MOST_SHARE * least * 1e3:g}")
    field = read_map(spec.map, spec.smoothing, partial(problem.error, "as_printed.map"))
    beads = tuple(_moved(problem, field, bead) for bead in toolpath.beads)
    off = field.at(field.points, field.normals)
    over = left(off, spec.most, toolpath.layers - spec.after_layer)
    note = (
        f"layers above layer {spec.after_layer} are laid on what is printed, which is off by up to "
        f"{np.abs(off).max() * 1e3:.2f} mm; {np.abs(over).max() * 1e3:.2f} mm of that remains on top"
    )
    if problem.process.extruder.motor == "on_off":
        note += "; its motor is on or off, so its flow adapts from bead to bead only, not within one"
    surface = ScannedSurface(
        toolpath.surface, tuple(bead.s for bead in beads), tuple(bead.s for bead in toolpath.beads)
    )
    return replace(toolpath, beads=beads, surface=surface, notes=(*toolpath.notes, note))


@dataclass(frozen=True)
class ScannedSurface(SurfaceOver):
    """The surface beneath a toolpath whose beads were moved onto a scanned print.

    laid, drawn: arc lengths of each bead's samples, as it is laid and as it was drawn [m]
    """

    laid: tuple[Array, ...]
    drawn: tuple[Array, ...]

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Normals of the bead as drawn, at the same samples."""
        laid, drawn = self.laid[bead], self.drawn[bead]
        return self.surface.normals_on(bead, s + np.interp(s, laid, drawn - laid), tips)

    def before(self, bead: int) -> Surface:
        """The surface after so many beads have been printed."""
        return self.surface.before(bead)


def _moved(problem: Problem, field: DeviationField, bead: Bead) -> Bead:
    """A bead moved onto the scanned print."""
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
    """Displacements (m, 3) of the source's points, next to samples `near` (m) of the bead: linear between samples."""
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
