"""The top of a mesh: its facets, and the smooth surface that beads lie on, which is a stated distance off them at most.

Facets that are fine need none to speak of. Coarse ones are bent into the surface that their corners stand on
(`curved_facets`); of noisy ones, as of a scan, the surface keeps what they have in common. Lengths are metres in the part
frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.base.geometry import angles_between
from planner.problem.mesh_repair import turned_words
from planner.toolpath.bead import Shape, facets_shape, skin_shape
from planner.toolpath.substrate.curved_facets import CREASE, bent, bulges, corner_normals
from planner.toolpath.substrate.mesh_surface import FacetTree, HeightField, fit

Part = Callable[[Array], Flags]  # which places x, y (n, 2) belong to it

FARTHEST_FROM_FACETS = 5e-5  # m, of the smooth surface, at the curves; of coarse or noisy facets more:
MOST_UNASKED = 5e-4  # m, where nothing is said of it,
MOST_ASKED = 5e-3  # m, and at most: beyond, it is another part
_COARSE = 2e-5  # m by which facets bulge from which on they are bent: less costs no speed
_BETTER = 0.85  # times as far off: else twice the knots are no better
_STALLS = 0.7  # times the root mean square: noise is hardly less with twice the knots, a shape's error far less
_EVEN = 8.0  # times the median: the worst of noise; an edge or a bump is alone
_ROUGH = 0.5  # correlation of what is off, a facet apart: of noise less, of a shape more
_SMALL = 0.1  # quantile of facets' heights
_A_FACET = 1.5  # heights of a facet between knots at least: closer ones repeat the facets' own steps
_COARSEST, _FINEST = 4, 64  # knots of the smooth surface along the longer side of what is covered
_SAMPLES = 240  # of the facets along that side
_FARTHEST_NEAR = 5e-3  # m: facets larger than this are looked at no farther aside
_ASIDE = 1e-3  # weight of the facets that no curve comes near, against those at a curve
_STEEPEST = 0.17  # upward component of a facet's normal: steeper ones say nothing of the surface
_TOO_STEEP = float(np.degrees(np.arccos(_STEEPEST)))  # deg from the horizontal
_NEXT = 1e-3  # m: points of curves this near follow each other


class TooRoughMesh(ValueError):
    """Every smooth surface leaves the facets by `gap` at `place` (2) [m] at least: they have an edge there, or noise.

    gaps (n)  how far the closest one leaves them at the curves
    """

    def __init__(self, gap: float, place: Array, gaps: Array) -> None:
        self.gap, self.place, self.gaps = gap, place, gaps
        super().__init__(f"the facets are {gap * 1e3:.3f} mm off any smooth surface")

    def said(self, what: str) -> str:
        """The reason in words; what: the facets, by name."""
        x, y = self.place * 1e3
        if not np.isfinite(self.gap):
            return f"no layer can lie on {what}: around x {x:.1f}, y {y:.1f} mm all of it is steeper than {_TOO_STEEP:.0f} deg"
        return f"the smooth surface through {what} is {self.gap * 1e3:.3f} mm off them at x {x:.1f}, y {y:.1f} mm"

    @property
    def words(self) -> str:
        """What lets a smooth surface be laid all the same, if anything; an ending of a hint."""
        if self.gap > MOST_ASKED:
            return ""
        return f"; smooth_mm: {enough(self.gap)} takes a surface that far off the facets, edges rounded"


def enough(gap: float) -> str:
    """A value of smooth_mm for a surface that is so far off the facets [m]."""
    return f"{np.ceil(gap * 1e5 + 0.5) / 100:.2f}"


@dataclass(frozen=True)
class MeshTop:
    """The top of a mesh, solid beneath: facets for distances, a smooth surface near curves for points and normals.

    gap   by how much the smooth surface leaves the facets at the curves, at most [m]
    why   the facets are followed no closer: "coarse", "noisy", "asked", or empty
    turn  of its normals from the facets' at the curves: the greatest and the mean [rad]
    too_far  how far a smooth surface through coarse facets' corners would be off them [m], where that is too far
    """

    facets: FacetTree
    surface: HeightField
    gap: float
    why: str = ""
    turn: tuple[float, float] = (0.0, 0.0)
    too_far: float = 0.0

    @classmethod
    def near(
        cls, facets: FacetTree, curves: Array, reach: float, part: Part | None = None, bound: float | None = None
    ) -> MeshTop:
        """Lay a smooth surface through facets near curves, given as points x, y (n, 2) that all fall onto facets.

        Near is what is within `reach` [m] (see reach_beside); where `part` is given, what it says no to counts nowhere,
        and the surface goes on there as it was. The surface leaves the facets at a curve by at most `bound` [m]; where
        that is None by FARTHEST_FROM_FACETS, or by MOST_UNASKED where they are coarse or noisy. Raises TooRoughMesh.
        """
        near = _Near.of(facets, curves, reach)
        closest: _SmoothedFacets | None = None
        too_far = 0.0
        for target, why in near.targets(bound):
            steps: list[_SmoothedFacets] = []
            kept = _kept(near.steps(target, part), steps, near, bound)
            if kept is not None:
                step, noisy = kept
                told = "asked" if bound is not None and bound > FARTHEST_FROM_FACETS else "noisy" if noisy else why
                return near.top(step, told, too_far)
            if not steps:
                continue
            least = min(steps, key=lambda step: step.gap)
            too_far = least.gap if why and least.gap > MOST_UNASKED else 0.0
            if closest is None or least.gap < closest.gap:
                closest = least
        if closest is None:
            raise TooRoughMesh(np.inf, curves[0], np.full(len(curves), np.inf))
        raise TooRoughMesh(closest.gap, curves[closest.worst], closest.gaps)

    @property
    def words(self) -> str:
        """What is to be said of facets that were turned, and of a surface that leaves them by more than usual."""
        turned = turned_words(self.facets.turned) if self.facets.turned else ""
        return "; ".join(each for each in (turned, self._smoothed) if each)

    @property
    def told_gap(self) -> float:
        """By how much the surface is told to leave the facets [m]; 0 where that is no more than usual."""
        return self.gap if self.why else 0.0

    @property
    def _smoothed(self) -> str:
        """What is to be said of a surface that leaves the facets by more than usual, or would have to."""
        if MOST_UNASKED < self.too_far <= MOST_ASKED:
            return (
                f"facets are coarse, and the nozzle turns from one to the next: a smooth surface through their corners is "
                f"{self.too_far * 1e3:.3f} mm off them; smooth_mm: {enough(self.too_far)} lays beads on that"
            )
        if not self.why:
            return ""
        most, mean = np.degrees(self.turn)
        said = "" if self.why == "asked" else f"since facets are {self.why}, "
        return (
            f"{said}beads lie on a smooth surface, {self.gap * 1e3:.3f} mm off the facets at most; its normals are "
            f"{mean:.1f} degrees off theirs on average, {most:.1f} at most"
            + ("" if self.why == "asked" else f"; smooth_mm: {FARTHEST_FROM_FACETS * 1e3:g} keeps to the facets")
        )

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the smooth surface at x, y (n, 2), a hair beyond the facets too."""
        return self.surface.at(plane)

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the smooth surface's normals at x, y (n, 2); NaN where there is no facet."""
        return np.where(self.facets.top(plane)[1] >= 0, self.surface.at(plane)[1][:, 2], np.nan)

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the smooth surface at the places nearest to points (n, 3)."""
        return self.surface.at(self.surface.nearest(points))[1]

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the facets; negative below the top."""
        z, found = self.facets.top(points[:, :2])
        inside = (found >= 0) & (points[:, 2] < z)
        return np.where(inside, -1.0, 1.0) * self.facets.distance(points)

    def shape(self) -> Shape:
        """The facets, or of too many only where the smooth surface is."""
        return facets_shape(self.facets.corners) or skin_shape(self.at, *self.surface.span)


@dataclass(frozen=True)
class _SmoothedFacets:
    """A smooth surface with knots `apart` [m]: how far it is off what it goes through at curves (n), and off the facets.

    gaps   likewise from the facets (n)
    """

    surface: HeightField
    apart: float
    off: Array
    gaps: Array

    @property
    def worst(self) -> int:
        return int(np.argmax(self.gaps))

    @property
    def gap(self) -> float:
        return float(self.gaps[self.worst])

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.off**2)))

    @property
    def most(self) -> float:
        return float(np.abs(self.off).max())


@dataclass(frozen=True)
class _Near:
    """Facets near curves: points x, y (n, 2) of these, their heights z (n) on the facets, and which facets (n)."""

    facets: FacetTree
    curves: Array
    z: Array
    found: Ints
    reach: float

    @classmethod
    def of(cls, facets: FacetTree, curves: Array, reach: float) -> _Near:
        z, found = facets.top(curves)
        return cls(facets, curves, z, found, reach)

    @property
    def span(self) -> tuple[Array, Array]:
        """The rectangle's corners of least and of greatest x and y (2)."""
        return self.curves.min(axis=0) - self.reach, self.curves.max(axis=0) + self.reach

    @property
    def least(self) -> float:
        """Least distance of knots [m]."""
        return _A_FACET * _narrowness(self.facets.corners[self.found])

    def targets(self, bound: float | None) -> Iterator[tuple[FacetTree, str]]:
        """What a smooth surface may go through, and why it is not the facets."""
        if (bound is None or bound > FARTHEST_FROM_FACETS) and self._bulge() > _COARSE:
            curved = self._curved()
            if curved is not None:
                yield curved, "coarse"
        yield self.facets, ""

    def _bulge(self) -> float:
        """How far facets under the curves bulge at most, about, from what their normals turn from one to the next [m]."""
        step = np.flatnonzero(
            (self.found[1:] != self.found[:-1]) & (np.abs(np.diff(self.curves, axis=0)) < _NEXT).all(1)
        )
        if len(step) == 0:
            return 0.0
        one, other = self.found[step], self.found[step + 1]
        turn = angles_between(self.facets.normals[one], self.facets.normals[other])
        smooth = turn < CREASE
        height = np.minimum(_heights(self.facets.corners[one]), _heights(self.facets.corners[other]))
        return float((turn * height)[smooth].max(initial=0.0)) / 8.0

    def _curved(self) -> FacetTree | None:
        """The facets near the curves, bent; None where they do not bulge, or more than any surface may be off."""
        low, high = self.span
        corners = self.facets.corners
        there = _over(corners, low, high)
        beside = float(np.linalg.norm(np.diff(corners[there], axis=1), axis=2).max())
        around = np.flatnonzero(_over(corners, low - beside, high + beside))
        normals, _ = corner_normals(corners[around])
        own = there[around]
        chosen, normals = corners[around][own], normals[own]
        return FacetTree.of(bent(chosen, normals)) if bulges(chosen, normals).max() > _COARSE else None

    def steps(self, target: FacetTree, part: Part | None) -> Iterator[_SmoothedFacets]:
        """Surfaces through a target with ever more knots; none where all of it is too steep."""
        low, high = self.span
        side = float((high - low).max())
        z, found = target.top(self.curves)
        there = found >= 0  # between bent facets there may be cracks
        samples, weights = _samples(target, np.column_stack([self.curves, self.z]), low, high, self.reach, part)
        up, knots = self.facets.normals[self.found, 2], _COARSEST
        while len(samples) and knots <= _FINEST:
            surface = fit(samples, weights, low, high, side / knots)
            points, normals = surface.at(self.curves)
            flat = np.minimum(normals[:, 2], up)
            off = np.where(there, (points[:, 2] - z) * np.minimum(normals[:, 2], target.normals[found, 2]), 0.0)
            gaps = np.abs(points[:, 2] - self.z) * flat
            yield _SmoothedFacets(surface, side / knots, off, gaps)
            knots *= 2

    def rough(self, off: Array) -> bool:
        """Whether what is off at the curves (n) is another thing from facet to facet, as noise is."""
        step = np.linalg.norm(np.diff(self.curves, axis=0), axis=1)
        usual = float(np.median(step))
        lag = max(round(_narrowness(self.facets.corners[self.found]) / usual), 1)
        if lag >= len(off):
            return False
        along = np.linalg.norm(self.curves[lag:] - self.curves[:-lag], axis=1)
        pairs = (along > 0.3 * lag * usual) & (along < 1.1 * lag * usual)
        one, other = off[:-lag][pairs], off[lag:][pairs]
        return bool(len(one) > 0 and (one * other).mean() < _ROUGH * (off**2).mean())

    def top(self, step: _SmoothedFacets, why: str, too_far: float) -> MeshTop:
        """The mesh with that surface."""
        points, normals = step.surface.at(self.curves)
        turned = angles_between(normals, self.facets.normals[self.found])
        gap = max(step.gap, float(self.facets.distance(points).max()))
        return MeshTop(self.facets, step.surface, gap, why, (float(turned.max()), float(turned.mean())), too_far)


def _kept(
    ever_finer: Iterator[_SmoothedFacets], steps: list[_SmoothedFacets], near: _Near, bound: float | None
) -> tuple[_SmoothedFacets, bool] | None:
    """Which of the surfaces is laid, and whether what it leaves out is noise; None where all are too far off.

    Those that were looked at are appended to `steps`.
    """
    asked = bound is not None and bound > FARTHEST_FROM_FACETS
    far = MOST_UNASKED if bound is None else bound if asked else FARTHEST_FROM_FACETS
    best: _SmoothedFacets | None = None
    for step in ever_finer:
        before = steps[-1] if steps else None
        steps.append(step)
        if asked and step.gap <= far:
            return step, False
        if best is not None and _close(best, far) and (step.apart < near.least or step.most > _BETTER * best.most):
            break
        if before is not None and bound is None and before.gap <= far and step.rms > _STALLS * before.rms:
            even = before.most <= _EVEN * float(np.median(np.abs(before.off)))
            if before.most > FARTHEST_FROM_FACETS and even and near.rough(before.off):
                return before, True
        if best is None or step.most < best.most:
            best = step
    return (best, False) if best is not None and not asked and _close(best, far) else None


def _close(step: _SmoothedFacets, far: float) -> bool:
    """Whether a surface is as near to what it goes through as facets need, and near enough to the facets [m]."""
    return step.most <= FARTHEST_FROM_FACETS and step.gap <= far


def _over(corners: Array, low: Array, high: Array) -> Flags:
    """Which of facets (n, 3, 3) look up and reach over a rectangle from low to high (2)."""
    a, b, c = corners[:, 0, :2], corners[:, 1, :2], corners[:, 2, :2]
    up = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) > (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    plane = corners[:, :, :2]
    return np.asarray(up & (plane.max(axis=1) >= low).all(axis=1) & (plane.min(axis=1) <= high).all(axis=1))


def _heights(corners: Array) -> Array:
    """The heights (n) of facets (n, 3, 3) over their longest sides [m]."""
    edges = np.roll(corners, -1, axis=1) - corners
    across = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.asarray(across / np.linalg.norm(edges, axis=2).max(axis=1))


def _narrowness(corners: Array) -> float:
    """The least height of facets (n, 3, 3) [m], where they are small: where nothing bends they may be of any size."""
    return float(np.quantile(_heights(corners), _SMALL))


def reach_beside(facets: FacetTree, curves: Array, least: float) -> float:
    """How far beside curves (n, 2) facets are looked at: `least` [m], or farther where they are larger."""
    size = np.linalg.norm(np.diff(facets.corners[facets.top(curves)[1]], axis=1), axis=2).max(axis=1)
    return max(least, min(float(np.median(size)), _FARTHEST_NEAR))


def _samples(
    facets: FacetTree, curves: Array, low: Array, high: Array, reach: float, part: Part | None
) -> tuple[Array, Array]:
    """Points (n, 3) of the facets on a grid, and the weights (n) of their squared heights; curves (m, 3).

    A height counts as much as the distance from the surface that it stands for, and nothing beyond a cliff.
    """
    step = float((high - low).max()) / _SAMPLES
    axes = [np.arange(a + 0.5 * step, b, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    away, nearest = cKDTree(curves[:, :2]).query(grid)
    z, found = facets.top(grid)
    up = np.where(found >= 0, facets.normals[found, 2], 0.0)
    weights = np.where(away <= reach, 1.0, _ASIDE) * up**2
    beyond = np.abs(z - curves[nearest, 2]) * _STEEPEST > away + step  # as no slope would take it
    keep = (up > _STEEPEST) & ~beyond
    if part is not None:
        keep &= part(grid)
    return np.column_stack([grid, z])[keep], weights[keep]
