"""What plane curves are projected onto: a ball, exactly, or the top of a mesh with a smooth surface through it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.readonly import Array
from planner.toolpath.shape import Shape, dome_shape, facets_shape, skin_shape
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.substrate.height_field import HeightField, fit

Part = Callable[[Array], NDArray[np.bool_]]  # which places x, y (n, 2) belong to it

FARTHEST_FROM_FACETS = 5e-5  # m, of the smooth surface, at the curves
_BETTER = 0.85  # times as far off: else twice the knots are no better
_SMALL = 0.1  # quantile of facets' heights
_A_FACET = 1.5  # heights of a facet between knots at least: closer ones repeat the facets' own steps
_COARSEST, _FINEST = 4, 64  # knots of the smooth surface along the longer side of what is covered
_SAMPLES = 240  # of the facets along that side
_FARTHEST_NEAR = 5e-3  # m: facets larger than this are looked at no farther aside
_ASIDE = 1e-3  # weight of the facets that no curve comes near, against those at a curve
_STEEPEST = 0.17  # upward component of a facet's normal: steeper ones say nothing of the surface


class Body(Protocol):
    """A body whose surface is seen from above (metres, part frame)."""

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the surface at x, y (n, 2)."""
        ...

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the surface's normals at x, y (n, 2); NaN where there is no surface."""
        ...

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) at the places of the surface nearest to points (n, 3)."""
        ...

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the body; negative inside."""
        ...

    def shape(self) -> Shape | None:
        """The body to be drawn, if it can be."""
        ...


@dataclass(frozen=True)
class Ball:
    """A ball; centre (3)."""

    radius: float
    centre: Array

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the upper half at x, y (n, 2); NaN beside the ball."""
        across = plane - self.centre[:2]
        square = self.radius**2 - (across**2).sum(axis=1)
        up = np.sqrt(np.where(square > 0.0, square, np.nan))
        normals = np.column_stack([across, up]) / self.radius
        normals[np.isnan(up)] = np.nan
        return self.centre + self.radius * normals, normals

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the normals at x, y (n, 2); NaN beside the ball."""
        return self.at(plane)[1][:, 2]

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3): away from the centre."""
        away = points - self.centre
        return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1), 1e-12)[:, None])

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the ball; negative inside."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) - self.radius)

    def shape(self) -> Shape:
        """The dome that stands above the bed."""
        return dome_shape(self.radius, self.centre)


class TooRough(ValueError):
    """The smooth surface leaves the facets by `gap` at `place` (2) [m]: they are too coarse there, or have an edge."""

    def __init__(self, gap: float, place: Array) -> None:
        self.gap, self.place = gap, place
        super().__init__(f"the facets are {gap * 1e3:.3f} mm off any smooth surface")


@dataclass(frozen=True)
class MeshTop:
    """The top of a mesh, solid beneath: facets for distances, a smooth surface near curves for points and normals.

    gap  by how much the smooth surface leaves the facets at the curves, at most [m]
    """

    facets: FacetTree
    surface: HeightField
    gap: float

    @classmethod
    def near(cls, facets: FacetTree, curves: Array, reach: float, part: Part | None = None) -> MeshTop:
        """Lay a smooth surface through facets near curves, given as points x, y (n, 2) that all fall onto facets.

        Near is what is within `reach` [m] (see reach_beside); where `part` is given, what it says no to counts nowhere,
        and the surface goes on there as it was. Raises TooRough where the surface leaves them by more than
        FARTHEST_FROM_FACETS at a curve.
        """
        z, found = facets.top(curves)
        low, high = curves.min(axis=0) - reach, curves.max(axis=0) + reach
        side = float((high - low).max())
        samples, weights = _samples(facets, np.column_stack([curves, z]), low, high, reach, part)
        least = _A_FACET * _narrowness(facets.corners[found])
        best, worst = None, 0
        knots = _COARSEST
        while knots <= _FINEST:
            surface = fit(samples, weights, low, high, side / knots)
            points, normals = surface.at(curves)
            off = np.abs(points[:, 2] - z) * np.minimum(normals[:, 2], facets.normals[found, 2])
            near = best is not None and best.gap <= FARTHEST_FROM_FACETS
            if best is not None and near and (side / knots < least or off.max() > _BETTER * best.gap):
                break
            if best is None or off.max() < best.gap:
                worst = int(np.argmax(off))
                best = cls(facets, surface, float(off[worst]))
            knots *= 2
        if best is None or best.gap > FARTHEST_FROM_FACETS:
            raise TooRough(np.inf if best is None else best.gap, curves[worst])
        return best

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


def _narrowness(corners: Array) -> float:
    """The least height of facets (n, 3, 3) [m], where they are small: where nothing bends they may be of any size."""
    edges = np.roll(corners, -1, axis=1) - corners
    across = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return float(np.quantile(across / np.linalg.norm(edges, axis=2).max(axis=1), _SMALL))


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
