"""A scanned print, read and evaluated independently: how far layers above must lie off the drawing, and how high the
nozzle is above the print.

Of the displaced beads, only the normals along which they were moved are used. The map is fitted by weighted means and
covariances in the tangent plane; the nozzle's height above the print comes from the measured places alone, unsmoothed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from planner.base.arrays import Array, Ints
from planner.base.errors import InputError
from planner.plan import Trajectory
from planner.problem.as_printed import AsPrintedSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.verify.executed import ExecutedMotion

_APART = 0.2e-3  # m between the samples of a bead at which the map is evaluated
_TOGETHER = 512  # samples processed at once
_EDGE = 0.5  # × the radius: places farther off the map count as this far off
_RIDGE = 1e-3  # × the squared radius: ridge term that holds slopes level
_FACING = 0.5  # least cosine between a node's normal and the place's
_HEIGHTS = 60  # samples of a bead at which its height is checked
_NEAR = 0.5  # × the radius: measured places within it give the print's height
_AMID = 0.3  # × that: most that the mean of those places may lie to one side of the tip
_FEWEST = 4  # least number of those places
_MEASURED = "measured"
_FIELDS = ("x_mm", "y_mm", "z_mm", "nx", "ny", "nz", "deviation_mm")


@dataclass(frozen=True)
class ScannedTop:
    """The map's nodes (n): points and normals (n, 3), deviation (n) [m], and which (n) were measured, not interpolated."""

    points: Array
    normals: Array
    deviation: Array
    measured: Array

    def around(self, foot: Array, normals: Array, radius: float) -> tuple[Ints, Ints, Array]:
        """Pairs (m) of a foot (k, 3) and a node within a radius that faces the same way, and the vectors (m, 3) between
        them in the plane perpendicular to the foot's normal."""
        near = self.tree.query_ball_point(foot, radius)
        of = np.repeat(np.arange(len(foot)), [len(each) for each in near])
        node = np.array([i for each in near for i in each], dtype=np.int64)
        facing = np.einsum("ij,ij->i", self.normals[node], normals[of]) > _FACING
        of, node = of[facing], node[facing]
        way = self.points[node] - foot[of]
        return of, node, way - np.einsum("ij,ij->i", way, normals[of])[:, None] * normals[of]

    @cached_property
    def tree(self) -> KDTree:
        """A tree of the nodes, for searches."""
        return KDTree(self.points)


def scanned_top(spec: AsPrintedSpec) -> ScannedTop:
    """The map that a problem names. Raises InputError if it is gone or is no map."""
    try:
        stamp = spec.map.stat()
        return _read(spec.map, stamp.st_mtime_ns, stamp.st_size)
    except (OSError, ValueError, IndexError) as error:
        raise InputError(
            "cannot be read again as a height map", file=spec.map, hint="beadwise scan writes it"
        ) from error


@lru_cache(maxsize=2)
def _read(path: Path, changed: int, size: int) -> ScannedTop:
    """The map's file; `changed` and `size` identify its version."""
    with path.open(encoding="utf-8-sig") as stream:
        lines = [line for line in stream if not line.startswith("#")]
    table = np.genfromtxt(lines, delimiter=",", names=True, dtype=None, encoding="utf-8")
    rows = np.column_stack([np.asarray(table[name], dtype=float) for name in _FIELDS])
    measured = np.asarray(table["how"] == _MEASURED) if "how" in (table.dtype.names or ()) else np.ones(len(rows), bool)
    normals = rows[:, 3:6] / np.sqrt((rows[:, 3:6] ** 2).sum(axis=1, keepdims=True))
    return ScannedTop(rows[:, :3] / 1e3, normals, rows[:, 6] / 1e3, measured)


def deviations(top: ScannedTop, places: Array, normals: Array, radius: float) -> Array:
    """The map's smoothed deviation (k) [m] beneath places (k, 3) with unit normals (k, 3)."""
    out = np.empty(len(places))
    for first in range(0, len(places), _TOGETHER):
        rows = slice(first, first + _TOGETHER)
        out[rows] = _deviations(top, places[rows], normals[rows], radius)
    return out


def _deviations(top: ScannedTop, places: Array, normals: Array, radius: float) -> Array:
    foot = _feet(top, places, normals)
    distance, nearest = top.tree.query(foot)
    out = distance > _EDGE * radius
    share = np.ones(len(foot))
    share[out] = _EDGE * radius / distance[out]
    foot = share[:, None] * foot + (1.0 - share)[:, None] * top.points[nearest]
    of, node, way = top.around(foot, normals, radius)
    r = np.sqrt((way**2).sum(axis=1)) / radius
    weight = np.where(r < 1.0, (1.0 - r) ** 4 * (1.0 + 4.0 * r), 0.0)
    k, d = len(foot), top.deviation[node]
    total = np.bincount(of, weight, minlength=k)
    alone = total <= 0.0
    safe = np.where(alone, 1.0, total)
    # intercept of the regression, from means and covariances in three dimensions; the ridge term holds slopes level
    mean_way = np.stack([np.bincount(of, weight * column, minlength=k) for column in way.T], axis=1) / safe[:, None]
    mean_d = np.bincount(of, weight * d, minlength=k) / safe
    spread = np.empty((k, 3, 3))
    along = np.empty((k, 3))
    centred = way - mean_way[of]
    for i in range(3):
        along[:, i] = np.bincount(of, weight * centred[:, i] * (d - mean_d[of]), minlength=k) / safe
        for j in range(3):
            spread[:, i, j] = np.bincount(of, weight * centred[:, i] * centred[:, j], minlength=k) / safe
    spread += _RIDGE * radius**2 * np.eye(3)
    slope = np.einsum("kij,kj->ki", np.linalg.inv(spread), along)
    return np.where(alone, top.deviation[nearest], mean_d - np.einsum("ki,ki->k", slope, mean_way))


def _feet(top: ScannedTop, places: Array, normals: Array) -> Array:
    """Feet of places (k, 3) on the map, down along their normals."""
    foot = places
    for _ in range(2):
        node = top.tree.query(foot)[1]
        foot = places - np.einsum("ij,ij->i", places - top.points[node], normals)[:, None] * normals
    return foot


def still_off(deviation: Array, most: float, layers: Ints) -> Array:
    """Remainder (k) [m] of deviations (k) on top of so many layers (k), each of which corrects at most `most` [m]."""
    rest = np.array(deviation, dtype=float)
    for done in range(int(layers.max(initial=0))):
        some = layers > done
        rest[some] -= most * np.tanh(rest[some] / most)
    return rest


def over_print(top: ScannedTop, tips: Array, normals: Array, radius: float) -> Array:
    """Height (k) [m] of tips (k, 3) above the print, along unit normals (k, 3), by the measured places around them; NaN
    where there are too few."""
    known = ScannedTop(*(values[top.measured] for values in (top.points, top.normals, top.deviation, top.measured)))
    out = np.full(len(tips), np.nan)
    for first in range(0, len(tips), _TOGETHER):
        rows = slice(first, first + _TOGETHER)
        n = normals[rows]
        foot = _feet(known, tips[rows], n)
        of, node, way = known.around(foot, n, _NEAR * radius)
        real = known.points[node] + known.deviation[node, None] * known.normals[node]
        high = np.einsum("ij,ij->i", tips[rows][of] - real, n[of])
        # corrected for the surface's drop from the tangent plane: exact on circles
        high += 0.5 * np.einsum("ij,ij->i", way, known.normals[node] - n[of])
        out[rows] = _levels(of, way, high, len(foot), _NEAR * radius)
    return out


def _levels(of: Ints, way: Array, high: Array, k: int, radius: float) -> Array:
    """Height (k) at each foot of the least-squares plane through the heights (m) around it; NaN where there are too
    few, or where they lie to one side."""
    count = np.bincount(of, minlength=k)
    rows = np.concatenate([np.ones((len(of), 1)), way / radius], axis=1)
    matrix, right = np.zeros((k, 4, 4)), np.zeros((k, 4))
    for i in range(4):
        right[:, i] = np.bincount(of, rows[:, i] * high, minlength=k)
        for j in range(4):
            matrix[:, i, j] = np.bincount(of, rows[:, i] * rows[:, j], minlength=k)
    matrix[:, (1, 2, 3), (1, 2, 3)] += 0.01 * np.maximum(count, 1)[:, None]
    matrix[:, 0, 0] += count == 0
    found = np.linalg.solve(matrix, right[:, :, None])[:, 0, 0]
    aside = np.linalg.norm(
        np.stack([np.bincount(of, column, minlength=k) for column in way.T], axis=1) / np.maximum(count, 1)[:, None],
        axis=1,
    )
    return np.where((count >= _FEWEST) & (aside <= _AMID * radius), found, np.nan)


def normals_along(toolpath: Toolpath, t: Trajectory, at: Ints) -> Array:
    """Unit normals (k, 3) of the beads at samples (k) of a trajectory, all of them on beads."""
    out, s = np.empty((len(at), 3)), t.s[at]
    for i, own in _by_bead(t, at):
        bead = toolpath.beads[i]
        for k in range(3):
            out[own, k] = np.interp(s[own], bead.s, bead.normals[:, k])
    return out / np.linalg.norm(out, axis=1)[:, None]


def _by_bead(t: Trajectory, at: Ints) -> Iterator[tuple[int, Ints]]:
    """Each bead of some samples (k), and the indices of its own samples among them, in order."""
    order = np.argsort(t.bead[at], kind="stable")
    beads, first = np.unique(t.bead[at][order], return_index=True)
    return zip(beads.tolist(), np.split(order, first)[1:], strict=True)


def asked_height(spec: AsPrintedSpec, bead: Bead, drawn: float) -> tuple[Ints, Array]:
    """Some samples (k) of a bead, and the height (k) [m] required there, if it was drawn `drawn` [m] high."""
    some = np.unique(np.linspace(0, len(bead.s) - 1, _HEIGHTS).astype(np.int64))
    above = bead.layer - spec.after_layer
    if above < 0:
        return some, np.full(len(some), drawn)
    found = deviations(scanned_top(spec), bead.points[some], bead.normals[some], spec.smoothing)
    beneath = np.full(len(some), above)
    return some, drawn + still_off(found, spec.most, beneath + 1) - still_off(found, spec.most, beneath)


def drawn_tips(spec: AsPrintedSpec, toolpath: Toolpath, t: Trajectory, motion: ExecutedMotion) -> Array:
    """The executed tip (n, 3) as if the print were exactly as drawn: without the displacement of its layer or, in
    travel, of the print beneath."""
    out = motion.tip.copy()
    top = scanned_top(spec)
    layers = np.array([bead.layer for bead in toolpath.beads])[np.maximum(t.begun, 0)] + 1 - spec.after_layer
    away = np.flatnonzero(~t.deposit)
    if len(away):
        off = deviations(top, motion.tip[away], -motion.axis[away], spec.smoothing)
        out[away] += still_off(off, spec.most, layers[away])[:, None] * motion.axis[away]
    laid = np.flatnonzero(t.deposit)
    for _, own in _by_bead(t, laid):
        at = laid[own]
        s, normals = t.s[at], normals_along(toolpath, t, at)
        step = np.floor(s / _APART)
        few = np.unique(np.append(np.flatnonzero(np.diff(step, prepend=-1.0) != 0.0), len(at) - 1))
        asked = few[np.unique(s[few], return_index=True)[1]]
        found = deviations(top, motion.tip[at[asked]], normals[asked], spec.smoothing)
        off = np.interp(s, s[asked], found) if len(asked) < 4 else CubicSpline(s[asked], found)(s)
        out[at] -= still_off(off, spec.most, layers[at])[:, None] * normals
    return out
