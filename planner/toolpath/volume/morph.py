"""Layers that change from one surface into another: all of them lower + k * thickness, over x and y.

The thickness is the gap between the two surfaces shared out evenly, but never less than a bound: where it is held there,
layers run parallel to the lower surface and end where they reach the upper one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from scipy.ndimage import binary_dilation

from planner.readonly import Array
from planner.toolpath.substrate.bodies import MeshTop
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.substrate.height_field import HeightField, fit

Heights = Callable[[Array], Array]  # of places x, y (n, 2): z (n) [m]

_BEND = 0.2  # of the way from the least to the greatest height, over which the thickness bends towards the least
_KNOTS = 40  # of the layers, along the longer side
_SAMPLES = 3  # of the surfaces, from knot to knot
_PITCH = 1e-3  # m between corners of the facets that stand for what is printed
_MOST_PITCHES = 300  # along the longer side
_WHOLE = 1e-6  # layers: so little more than a whole number is that number


@dataclass(frozen=True)
class Morph:
    """A stack of layers: the k-th begins at lower + k * thickness [m], both with the same knots."""

    lower: HeightField
    thickness: HeightField

    @classmethod
    def between(
        cls, lower: Heights, upper: Heights, greatest: float, least: float, room: float, low: Array, high: Array
    ) -> Morph:
        """Layers at most `greatest` and at least `least` high [m], over the rectangle from low (2) to high (2).

        room  greatest height of the upper surface above the lower one [m]
        """
        count = np.ceil(room / greatest - _WHOLE)
        step = float((high - low).max()) / _KNOTS
        cells = np.ceil((high - low) / step - 1e-9)
        axes = [np.linspace(a, a + n * step, int(n) * _SAMPLES + 1) for a, n in zip(low, cells, strict=True)]
        plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        base = lower(plane)
        share = (upper(plane) - base) / count
        high_enough = least + _ramp(share - least, _BEND * (greatest - least))
        weights = np.ones(len(plane))
        end = low + cells * step
        fields = [fit(np.column_stack([plane, z]), weights, low, end, step) for z in (base, high_enough)]
        return cls(*fields)

    def field(self, level: float) -> HeightField:
        """The surface `level` layers up."""
        heights = self.lower.coefficients + level * self.thickness.coefficients
        return HeightField(self.lower.corner, self.lower.step, heights)

    def levels(self, points: Array) -> Array:
        """How many layers up points (n, 3) are."""
        lower, thickness = (surface.at(points[:, :2])[0][:, 2] for surface in (self.lower, self.thickness))
        return np.asarray((points[:, 2] - lower) / thickness)

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3) of the surfaces that run through points (n, 3)."""
        slopes = []
        for surface in (self.lower, self.thickness):
            n = surface.at(points[:, :2])[1]
            slopes.append(n[:, :2] / n[:, 2:])
        across = slopes[0] + self.levels(points)[:, None] * slopes[1]
        normals = np.column_stack([across, np.ones(len(points))])
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def _ramp(x: Array, reach: float) -> Array:
    """The greater of x and 0, bent within `reach` of 0, with three continuous derivatives."""
    t = np.clip((x + reach) / (2.0 * reach), 0.0, 1.0)
    return np.where(x >= reach, x, 2.0 * reach * t**4 * (2.5 - 3.0 * t + t**2))


@dataclass(frozen=True)
class MorphedLayers:
    """What carries the layers, and the layers as they are printed, solid down to the bed (metres, part frame).

    base     what the layers begin at, where it is a mesh
    regions  what each layer covers in the plane
    layers   of all beads in print order
    solid    how many layers are there
    grown    their upper side as facets, by their number; filled in when it is asked for
    """

    morph: Morph
    base: MeshTop | None
    regions: tuple[shapely.MultiPolygon, ...]
    layers: tuple[int, ...]
    solid: int = 0
    grown: dict[int, FacetTree | None] = field(default_factory=dict, compare=False)

    def before(self, bead: int) -> MorphedLayers:
        """The surface when the first `bead` beads have been printed: without the layer of the last of them."""
        return replace(self, solid=self.layers[bead - 1] if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from bed, base and layers; negative inside."""
        nearest = points[:, 2].copy()
        if self.base is not None:
            nearest = np.minimum(nearest, self.base.signed_distance(points))
        grown = self._grown()
        if grown is None:
            return nearest
        top, _ = grown.top(points[:, :2])
        return np.asarray(np.minimum(nearest, np.where(points[:, 2] < top, -1.0, 1.0) * grown.distance(points)))

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3) of the layers' surfaces through points (n, 3), of the first or last beyond them."""
        held = points.copy()
        level = np.clip(self.morph.levels(points), 0.0, len(self.regions))
        lower, thickness = (s.at(points[:, :2])[0][:, 2] for s in (self.morph.lower, self.morph.thickness))
        held[:, 2] = lower + level * thickness
        return self.morph.normals(held)

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Upward unit normals (n, 3) of the bead's layer, above or below the tips (n, 3)."""
        return self.morph.field(self.layers[bead] + 1).at(tips[:, :2])[1]

    def _grown(self) -> FacetTree | None:
        if self.solid not in self.grown:
            self.grown[self.solid] = self._facets() if self.solid else None
        return self.grown[self.solid]

    def _facets(self) -> FacetTree | None:
        """Facets over a grid, at the top of the uppermost layer that covers its corners."""
        low, high = self.morph.lower.span
        pitch = max(_PITCH, float((high - low).max()) / _MOST_PITCHES)
        axes = [np.arange(a, b, pitch) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        plane = grid.reshape(-1, 2)
        top = np.full(len(plane), np.nan)
        for layer, region in enumerate(self.regions[: self.solid]):
            there = shapely.contains_xy(region, plane[:, 0], plane[:, 1]).reshape(grid.shape[:2])
            covered = binary_dilation(there).ravel()  # so that the rim is not cut off
            top[covered] = self.morph.field(layer + 1).at(plane[covered])[0][:, 2]
        p = np.column_stack([plane, top]).reshape(*grid.shape[:2], 3)
        a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
        facets = np.concatenate([np.stack(each, axis=-2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))])
        facets = facets[np.isfinite(facets).all(axis=(1, 2))]
        return FacetTree.of(facets) if len(facets) else None
