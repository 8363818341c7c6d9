"""A scanned part: a smooth surface through noisy points, as stiff as cross-validation suggests.

A spline is fitted to heights over x and y with ever more knots; of these, the number is chosen with which half of the
points best predicts the other half. Fewer knots lose shape, more reproduce noise. Where there are points, the surface
is cut into facets, and is a mesh from then on. Lengths are metres in the part frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.base.errors import Complaint, InputError
from planner.problem.part import NOISIEST_MM, ScanSpec
from planner.toolpath.substrate.mesh_surface import FacetTree, HeightField, fit
from planner.toolpath.substrate.mesh_top import MeshTop

BESIDE = 10e-3  # m beside curves within which points count, or a wider bead's width
KNOTS = (4, 6, 8, 11, 16, 23, 32, 45, 64)  # of the surface along the longer side of the covered area
_BINS = 240  # along that side: points in one bin count as their mean
_FACETS, _LEAST_FACET = 300, 0.5e-3  # facets along that side, and the smallest facet in m
_LOOKED = 200_000  # points at most in each of the two halves by which the number of knots is chosen
_BETTER = 0.998  # × the prediction error: more knots count as better only if they bring it below this
_WORSE = 2  # tries in a row without improvement after which no more knots are tried
_NEAREST = 16  # neighbours by which the density of points is measured
_HOLE, _LEAST_HOLE = 5.0, 2e-3  # × the usual distance between points, and m: random points leave no gap this wide
_GRID = 400  # cells along the longer side of the scan when searching for holes
_MANY = 0.2  # share of the points: too many to be strays or a single step
_AROUND = (12, 24, 48)  # numbers of points around a place that are tested for a tilt against the surface
_SURE, _LEAN = 4.0, np.radians(0.5)  # standard errors of that tilt, and rad beyond them, that are accepted
_IN_LINE = 1e-3  # share of the points' squared extent: with less across, the slope that way is unknown
_PLACES = 1500  # most places on the curves that are tested
FEWEST = 200  # points near the curves


@dataclass(frozen=True)
class ScanSurface:
    """The smooth surface of a scan near curves, as facets, and how far the points deviate from it.

    most, rms  of the points' distances from it [m];  count of these points;  apart: distance between its knots [m]
    """

    facets: FacetTree
    field: HeightField
    most: float
    rms: float
    count: int
    apart: float

    @property
    def top(self) -> MeshTop:
        """The body: its facets are cut from the smooth surface, on which beads lie."""
        return MeshTop(self.facets, self.field, 0.0)

    @property
    def words(self) -> str:
        """A note on it."""
        return (
            f"part.scan: a smooth surface through {self.count} points near the curves, which are {self.most * 1e3:.3f} mm off "
            f"it at most, {self.rms * 1e3:.3f} mm root mean square; its knots are {self.apart * 1e3:.1f} mm apart"
        )


def scan_surface(spec: ScanSpec, points: Array, curves: Sequence[Array], width: float, where: Complaint) -> ScanSurface:
    """The surface of points (n, 3) near curves, each of points x, y (k, 2), along which beads of a width [m] are laid.

    Raises the InputError of `where` for holes under the curves, and for points that deviate by more than the noise.
    """
    plane = np.vstack(curves)
    usual = _usual_distance(points)
    hole = spec.hole or max(_HOLE * usual, _LEAST_HOLE)
    _check_holes(spec, points, plane, hole, where)
    beside = max(BESIDE, width)
    low, high = plane.min(axis=0) - beside, plane.max(axis=0) + beside
    near = points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)]
    if len(near) < FEWEST:
        lowest, highest = points.min(axis=0) * 1e3, points.max(axis=0) * 1e3
        spans = ", ".join(f"{axis} {a:.1f} to {b:.1f}" for axis, a, b in zip("xyz", lowest, highest, strict=True))
        raise where(
            f"{spec.file.name} has {len(near)} points under the curves", hint=f"at least {FEWEST}; it spans {spans} mm"
        )
    low, high = np.maximum(low, near[:, :2].min(axis=0)), np.minimum(high, near[:, :2].max(axis=0))
    side = float((high - low).max())
    apart = _knots_apart(near, low, high, side)
    field = _fitted(near, low, high, side, apart)
    off = _off(field, near)
    worst = int(np.argmax(np.abs(off)))
    most = float(np.abs(off[worst]))
    if most > spec.noise:
        raise _too_far_off(spec, off, near[worst] * 1e3, where)
    _check_shape(spec, near, off, plane, usual, where)
    tree = _facets(field, near, low, high, side, hole)
    return ScanSurface(tree, field, most, float(np.sqrt(np.mean(off**2))), len(near), apart)


def _too_far_off(spec: ScanSpec, off: Array, worst: Array, where: Complaint) -> InputError:
    """The error for points (n) `off` the surface [m], the farthest at `worst` [mm]: many of them, or a few."""
    most, share = float(np.abs(off).max()) * 1e3, float((np.abs(off) > spec.noise).mean())
    noise, (x, y) = spec.noise * 1e3, worst[:2]
    if share > _MANY and most > NOISIEST_MM:
        return where(
            f"{share:.0%} of the points of {spec.file.name} near the curves are more than noise_mm ({noise:g}) off the smooth "
            f"surface, up to {most:.3f} mm at x {x:.1f}, y {y:.1f} mm: seen from above they are not a single surface",
            hint="leave out the underside and anything below the surface, or turn it with rpy_deg",
        )
    wider = np.ceil(most * 100) / 100
    return where(
        f"a point of {spec.file.name} is {most:.3f} mm off the smooth surface at x {x:.1f}, y {y:.1f} mm, and noise_mm "
        f"allows {noise:g}",
        hint="there is a step, or a stray point: clean the scan"
        + (f"; or noise_mm: {wider:.2f}" if wider <= NOISIEST_MM else ""),
    )


def _check_shape(spec: ScanSpec, points: Array, off: Array, plane: Array, usual: float, where: Complaint) -> None:
    """Raise where points (n) `off` the surface [m] are tilted against it around curves x, y (k, 2).

    Noise does not tilt them. Shape too fine for the points to show does, and there the tool axis is unknown.
    """
    places = plane[np.unique(np.linspace(0, len(plane) - 1, _PLACES).astype(np.int64))]
    near = cKDTree(points[:, :2]).query(places, k=_AROUND[-1])[1]
    usual_off, most, worst = float(np.median(np.abs(off))), 0.0, 0
    for count in _AROUND:
        beside = points[near[:, :count], :2] - places[:, None]
        beside -= beside.mean(axis=1, keepdims=True)
        inverse = np.linalg.pinv(np.swapaxes(beside, 1, 2) @ beside, rcond=_IN_LINE, hermitian=True)
        high = off[near[:, :count]] - off[near[:, :count]].mean(axis=1, keepdims=True)
        slope = np.einsum("nij,nkj,nk->ni", inverse, beside, high)
        left = high - np.einsum("nkj,nj->nk", beside, slope)
        scatter = np.maximum(np.sqrt((left**2).sum(axis=1) / (count - 3)), usual_off)
        error = scatter * np.sqrt(np.trace(inverse, axis1=1, axis2=2))
        beyond = np.arctan(np.linalg.norm(slope, axis=1)) - np.arctan(_SURE * error)
        if (greatest := float(beyond.max())) > most:
            most, worst = greatest, int(np.argmax(beyond))
    if most > _LEAN:
        x, y = places[worst] * 1e3
        raise where(
            f"around x {x:.1f}, y {y:.1f} mm the points of {spec.file.name} lean {np.degrees(most):.1f} deg or more off the smooth "
            f"surface: the scan has shape there that is too fine for points {usual * 1e3:.2f} mm apart",
            hint="scan it finer, smooth the scan, or keep off that place",
        )


def _usual_distance(points: Array) -> float:
    """Distance between points at their median density, seen from above [m]."""
    some = points[:: max(len(points) // _LOOKED, 1), :2]
    away = cKDTree(points[:, :2]).query(some, k=_NEAREST + 1)[0][:, -1]
    return float(np.median(away) * np.sqrt(np.pi / _NEAREST))


def _check_holes(spec: ScanSpec, points: Array, plane: Array, hole: float, where: Complaint) -> None:
    """Raise where a curve crosses a place without points that lies within the scan, not outside it."""
    tree = cKDTree(points[:, :2])
    away = tree.query(plane)[0]
    bare = np.flatnonzero(away > 0.5 * hole)
    if not len(bare):
        return
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    step = max(float((high - low).max()) / _GRID, 0.25 * hole)
    axes = [np.arange(a - 2.0 * step, b + 3.0 * step, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    empty = tree.query(grid.reshape(-1, 2))[0].reshape(grid.shape[:2]) > 0.5 * hole
    region, _ = ndimage.label(empty)
    outside = region[0, 0]
    cell = np.rint((plane[bare] - [axes[0][0], axes[1][0]]) / step).astype(int)
    there = (cell >= 0).all(axis=1) & (cell < np.array(empty.shape)).all(axis=1)
    found = np.where(there, region[tuple(np.where(there[:, None], cell, 0).T)], outside)
    inside = bare[(found != outside) & (found != 0)]
    if len(inside):
        worst = inside[np.argmax(away[inside])]
        x, y = plane[worst] * 1e3
        raise where(
            f"{spec.file.name} has a hole under the curves: no point within {away[worst] * 1e3:.1f} mm of x {x:.1f}, y {y:.1f} mm",
            hint=f"scan that place again, or keep off it; holes up to hole_mm ({hole * 1e3:.1f}) wide are bridged",
        )


def _knots_apart(points: Array, low: Array, high: Array, side: float) -> float:
    """The distance between knots [m] with which half of the points best predicts the other half."""
    order = np.random.default_rng(0).permutation(len(points))[: 2 * _LOOKED]
    made, held = points[order[::2]], points[order[1::2]]
    best, least, worse = KNOTS[0], np.inf, 0
    for knots in KNOTS:
        if knots > KNOTS[0] and (side / knots) ** 2 * len(made) < 4.0 * side * float((high - low).min()):
            break  # fewer than four points for each knot
        error = float(np.sqrt(np.mean(_off(_fitted(made, low, high, side, side / knots), held) ** 2)))
        if error < _BETTER * least:
            best, least, worse = knots, error, 0
        elif (worse := worse + 1) == _WORSE:
            break
    return side / best


def _fitted(points: Array, low: Array, high: Array, side: float, apart: float) -> HeightField:
    """The spline with knots `apart` [m] that best fits points (n, 3); those of one bin count as their mean."""
    step = side / _BINS
    cell = np.floor((points[:, :2] - low) / step).astype(np.int64)
    _, which = np.unique(cell[:, 0] * (2 * _BINS) + cell[:, 1], return_inverse=True)
    count = np.bincount(which).astype(float)
    means = np.column_stack([np.bincount(which, points[:, k]) / count for k in range(3)])
    return fit(means, count, low, high, apart)


def _off(field: HeightField, points: Array) -> Array:
    """Distance (n) by which points (n, 3) lie above the surface, perpendicular to it [m]."""
    foot, normals = field.at(points[:, :2])
    return np.asarray((points[:, 2] - foot[:, 2]) * normals[:, 2])


def _facets(field: HeightField, points: Array, low: Array, high: Array, side: float, hole: float) -> FacetTree:
    """The surface as facets, where there are points."""
    step = max(side / _FACETS, _LEAST_FACET)
    counts = [max(int(np.ceil(length / step)), 1) + 1 for length in high - low]
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    known: Flags = cKDTree(points[:, :2]).query(plane.reshape(-1, 2))[0].reshape(counts) <= 0.5 * hole
    place = field.at(plane.reshape(-1, 2))[0].reshape(*counts, 3)
    a, b, c, d = place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]
    whole = known[:-1, :-1] & known[1:, :-1] & known[1:, 1:] & known[:-1, 1:]
    return FacetTree.of(np.concatenate([np.stack(each, axis=2)[whole] for each in ((a, b, c), (a, c, d))]))
