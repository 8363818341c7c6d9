"""What a core is between: the height of a body and of a middle, the layers between and beyond, and the core as it grows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from planner.readonly import Array
from planner.toolpath.substrate.bodies import MeshTop
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.substrate.height_field import HeightField

_PITCH = 1e-3  # m between corners of the facets that stand for layers: 0.08 mm off them where 1.5 mm is their radius
_MOST_PITCHES = 300  # along the longer side
_WHOLE = 1e-9  # layers: so little more than a whole number is that number


@dataclass(frozen=True)
class Level:
    """A layer of a core: nozzle tips at lower * (height of the body) + middle * (of the middle) + rise [m].

    room    least height of the middle above the body where it is laid [m]
    height  of the layer along z, and `share` of the middle's height above the body more [m]
    """

    lower: float
    middle: float
    rise: float
    room: float
    height: float
    share: float

    @property
    def above_middle(self) -> bool:
        """Whether it belongs to the reflected half."""
        return self.lower < 0.0


REFLECTED = Level(-1.0, 2.0, 0.0, 0.0, 0.0, 0.0)  # the body's own, in the middle: a core's upper surface


def even_levels(height: float, most: float, both: bool) -> list[Level]:
    """Layers of one height [m] where the middle is up to `most` [m] above the body, in print order.

    Those of the lower half end where they would reach beyond the middle. Their reflections begin half a layer earlier,
    so that everywhere less than a layer's height is left open between the halves, and nowhere do they overlap.
    """
    lower = [
        Level(1.0, 0.0, (k + 1) * height, (k + 1) * height, height, 0.0) for k in range(int(most / height + _WHOLE))
    ]
    upper = [
        Level(-1.0, 2.0, -k * height, (k + 0.5) * height, height, 0.0) for k in range(int(most / height + 0.5 + _WHOLE))
    ]
    return lower + upper[::-1] if both else lower


def varying_levels(height: float, least: float, most: float, both: bool) -> list[Level]:
    """Layers that share the height between body and middle, up to `most` [m], out evenly, none higher than `height`.

    They end where they would be less high than `least` [m].
    """
    count = int(np.ceil(most / height - _WHOLE))
    shares = [(k + 1) / count for k in range(2 * count if both else count)]
    return [Level(1.0 - share, share, 0.0, count * least, 0.0, 1.0 / count) for share in shares]


@dataclass(frozen=True)
class CoreSurface:
    """A body, and the layers of a core on it.

    lower, middle  heights of the body and of the middle, with the same knots
    least, upright least height of the middle above the body [m] and least upward component of its normals where the
                   core is; beyond, the heights mean nothing
    levels         of the layers that are laid, in print order
    layers         of all beads in print order
    solid          how many layers count as there; beneath the layer that is printed the core has grown everywhere
    grown          its upper side as facets, by the number of layers; filled in when it is asked for
    """

    body: MeshTop
    lower: HeightField
    middle: HeightField
    least: float
    upright: float
    levels: tuple[Level, ...]
    layers: tuple[int, ...]
    solid: int
    grown: dict[int, FacetTree | None]

    def before(self, bead: int) -> CoreSurface:
        """The surface when the first `bead` beads have been printed: the last one's layer lies on it."""
        return replace(self, solid=self.layers[bead - 1] if bead > 0 else 0)

    def field(self, level: Level) -> HeightField:
        """The nozzle tips of a layer."""
        heights = level.lower * self.lower.coefficients + level.middle * self.middle.coefficients + level.rise
        return HeightField(self.lower.corner, self.lower.step, heights)

    def room(self, plane: Array) -> Array:
        """Height (n,) of the middle above the body at x, y (n, 2) [m]."""
        return np.asarray(self.middle.at(plane)[0][:, 2] - self.lower.at(plane)[0][:, 2])

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from what is there; negative inside."""
        body, grown = self.body.signed_distance(points), self._grown()
        if grown is None:
            return body
        top, _ = grown.top(points[:, :2])
        return np.asarray(np.minimum(body, np.where(points[:, 2] < top, -1.0, 1.0) * grown.distance(points)))

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3) of the topmost layer above or below points (n, 3); upwards beside the core."""
        top = self.lower if self.solid == 0 else self.field(self.levels[self.solid - 1])
        normals = top.at(points[:, :2])[1]
        normals[~self._there(points[:, :2])] = [0.0, 0.0, 1.0]
        return normals

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Upward unit normals (n, 3) of the layer of a bead above or below the tips (n, 3)."""
        return self.field(self.levels[self.layers[bead]]).at(tips[:, :2])[1]

    def _there(self, plane: Array) -> NDArray[np.bool_]:
        """Where, of places x, y (n, 2), the core is."""
        low, high = self.lower.span
        within = ((plane >= low) & (plane <= high)).all(axis=1)
        return np.asarray(within & (self.room(plane) >= self.least) & (self.lower.at(plane)[1][:, 2] >= self.upright))

    def _grown(self) -> FacetTree | None:
        """What has grown on the body, up to its middle where the reflected half is begun; None before the first layer."""
        if self.solid not in self.grown:
            self.grown[self.solid] = None if self.solid == 0 else self._facets(self.levels[self.solid - 1])
        return self.grown[self.solid]

    def _facets(self, level: Level) -> FacetTree | None:
        low, high = self.lower.span
        pitch = max(_PITCH, float((high - low).max()) / _MOST_PITCHES)
        axes = [np.arange(a, b, pitch) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        plane = grid.reshape(-1, 2)
        layer, middle = self.field(level).at(plane)[0], self.middle.at(plane)[0][:, 2]
        layer[:, 2] = np.maximum(layer[:, 2], middle) if level.above_middle else np.minimum(layer[:, 2], middle)
        there = binary_dilation(self._there(plane).reshape(grid.shape[:2]))  # so that the rim is not cut off
        layer[~there.ravel()] = np.nan
        p = layer.reshape(*grid.shape[:2], 3)
        a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
        facets = np.concatenate([np.stack(each, axis=-2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))])
        facets = facets[np.isfinite(facets).all(axis=(1, 2))]
        return FacetTree.of(facets) if len(facets) else None
