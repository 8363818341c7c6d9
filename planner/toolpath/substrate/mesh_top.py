"""The top of a mesh: its facets, and the smooth surface on which beads lie, within a stated distance of them.

For fine facets that distance is negligible. Coarse ones are bent into the surface on which their corners lie
(`curved_facets`); of noisy ones, as from a scan, the surface keeps what they have in common. Lengths are metres in the
part frame.
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

FARTHEST_FROM_FACETS = 5e-5  # m: greatest distance of the smooth surface from the facets, at the curves
MOST_UNASKED = 5e-4  # m: the same for coarse or noisy facets, by default
MOST_ASKED = 5e-3  # m: the most that can be requested; farther off, it is another part
_COARSE = 2e-5  # m: facets that bulge by more are bent; a smaller bulge costs no speed
_BETTER = 0.85  # × the error: twice the knots count as better only if they bring it below this
_STALLS = 0.7  # × the rms error: with twice the knots, noise stays above this; a shape's error falls far below
_EVEN = 8.0  # × the median error: noise stays below; an edge or a bump stands out
_ROUGH = 0.5  # correlation of errors one facet apart: less for noise, more for a shape
_SMALL = 0.1  # quantile of facets' heights that counts as their least
_A_FACET = 1.5  # least heights of a facet between knots: closer knots reproduce the facets' own steps
_COARSEST, _FINEST = 4, 64  # knots of the smooth surface along the longer side of the covered area
_SAMPLES = 240  # samples of the facets along that side
_FARTHEST_NEAR = 5e-3  # m: facets, however large, extend the reach no farther than this
_ASIDE = 1e-3  # weight of facets away from all curves, relative to those near a curve
_STEEPEST = 0.17  # least upward component of a facet's normal: steeper ones are ignored
_TOO_STEEP = float(np.degrees(np.arccos(_STEEPEST)))  # deg from the horizontal
_NEXT = 1e-3  # m: points of curves this near follow each other


class TooRoughMesh(ValueError):
    """Every smooth surface deviates from the facets by at least `gap` at `place` (2) [m]: an edge, or noise.

    gaps (n)  deviation of the closest one at the curves
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
        """The end of a hint: the setting that allows a smooth surface all the same, if there is one."""
        if self.gap > MOST_ASKED:
            return ""
        return f"; smooth_mm: {enough(self.gap)} allows a surface that far off the facets, with rounded edges"


def enough(gap: float) -> str:
    """A value of smooth_mm that allows a surface this far off the facets [m]."""
    return f"{np.ceil(gap * 1e5 + 0.5) / 100:.2f}"


@dataclass(frozen=True)
class MeshTop:
    """The top of a mesh, solid beneath: facets for distances, a smooth surface near curves for points and normals.

    gap   greatest deviation of the smooth surface from the facets at the curves [m]
    why   the reason for following the facets no closer: "coarse", "noisy", "asked", or empty
    turn  greatest and mean angle between its normals and the facets' at the curves [rad]
    too_far  distance of a smooth surface through coarse facets' corners from them [m], if that is too far
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
        """Fit a smooth surface to facets near curves, given as points x, y (n, 2) that all fall onto facets.

        Near means within `reach` [m] (see reach_beside); if `part` is given, places it rejects are ignored, and the
        surface is extrapolated there. At a curve the surface deviates from the facets by at most `bound` [m]; if None,
        by FARTHEST_FROM_FACETS, or by MOST_UNASKED where facets are coarse or noisy. Raises TooRoughMesh.
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
        """Notes on facets that were turned, and on a surface that deviates from them by more than usual."""
        turned = turned_words(self.facets.turned) if self.facets.turned else ""
        return "; ".join(each for each in (turned, self._smoothed) if each)

    @property
    def told_gap(self) -> float:
        """The reported deviation of the surface from the facets [m]; 0 if it is no more than usual."""
        return self.gap if self.why else 0.0

    @property
    def _smoothed(self) -> str:
        """A note on a surface that deviates from the facets by more than usual, or would have to."""
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
        """Points and outward unit normals (n, 3) of the smooth surface at x, y (n, 2), even just beyond the facets."""
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
        """The facets or, if there are too many, the smooth surface."""
        return facets_shape(self.facets.corners) or skin_shape(self.at, *self.surface.span)


@dataclass(frozen=True)
class _SmoothedFacets:
    """A smooth surface with knots `apart` [m].

    off    how far it lies above its target at the curves (n) [m]
    gaps   its distance from the facets there (n) [m]
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
        """The rectangle's corners with the least and the greatest x and y (2)."""
        return self.curves.min(axis=0) - self.reach, self.curves.max(axis=0) + self.reach

    @property
    def least(self) -> float:
        """Least distance between knots [m]."""
        return _A_FACET * _narrowness(self.facets.corners[self.found])

    def targets(self, bound: float | None) -> Iterator[tuple[FacetTree, str]]:
        """Targets for a smooth surface to fit, and why, where they are not the facets."""
        if (bound is None or bound > FARTHEST_FROM_FACETS) and self._bulge() > _COARSE:
            curved = self._curved()
            if curved is not None:
                yield curved, "coarse"
        yield self.facets, ""

    def _bulge(self) -> float:
        """Approximate greatest bulge of the facets under the curves, by the turn of their normals [m]."""
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
        """The facets near the curves, bent; None if they hardly bulge."""
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
        """Surfaces fitted to a target with ever more knots; none if all of it is too steep."""
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
        """Whether the errors at the curves (n) vary from facet to facet, as noise does."""
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
    """The surface to use, and whether what it leaves out is noise; None if all are too far off.

    Those that were tried are appended to `steps`.
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
    """Whether a surface is close enough to its target, and within `far` of the facets [m]."""
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
    """The height of small facets among (n, 3, 3) [m]: where nothing bends, facets may be of any size."""
    return float(np.quantile(_heights(corners), _SMALL))


def reach_beside(facets: FacetTree, curves: Array, least: float) -> float:
    """How far beside curves (n, 2) facets count: `least` [m], or farther if they are larger."""
    size = np.linalg.norm(np.diff(facets.corners[facets.top(curves)[1]], axis=1), axis=2).max(axis=1)
    return max(least, min(float(np.median(size)), _FARTHEST_NEAR))


def _samples(
    facets: FacetTree, curves: Array, low: Array, high: Array, reach: float, part: Part | None
) -> tuple[Array, Array]:
    """Points (n, 3) of the facets on a grid, and the weights (n) of their squared heights; curves (m, 3).

    A height counts as much as the distance from the surface that it represents; beyond a cliff, nothing counts.
    """
    step = float((high - low).max()) / _SAMPLES
    axes = [np.arange(a + 0.5 * step, b, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    away, nearest = cKDTree(curves[:, :2]).query(grid)
    z, found = facets.top(grid)
    up = np.where(found >= 0, facets.normals[found, 2], 0.0)
    weights = np.where(away <= reach, 1.0, _ASIDE) * up**2
    beyond = np.abs(z - curves[nearest, 2]) * _STEEPEST > away + step  # where no slope would lead
    keep = (up > _STEEPEST) & ~beyond
    if part is not None:
        keep &= part(grid)
    return np.column_stack([grid, z])[keep], weights[keep]
