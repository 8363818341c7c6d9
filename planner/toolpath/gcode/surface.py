"""A bed and the level layers on it, as far as they are printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from planner.readonly import Array
from planner.toolpath.bead import Bead


@dataclass(frozen=True)
class Layer:
    """What a level layer covers, from its top [m] down: discs around the samples of its beads.

    tree of their centres in the plane; radii (n), half the beads' widths [m]
    """

    top: float
    tree: cKDTree
    radii: Array


@dataclass(frozen=True)
class LevelLayers:
    """The bed, the part frame's xy plane, and layers on it, solid down to the bed; lengths in metres, part frame.

    layers   from the lowest on
    levels   the layer of each bead, in print order
    solid    how many layers are there
    """

    layers: tuple[Layer, ...]
    levels: tuple[int, ...]
    solid: int = 0

    @classmethod
    def of(cls, beads: Sequence[Bead]) -> LevelLayers:
        """The layers that beads make; each bead is as high as its layer."""
        layers = []
        for level in range(max(bead.layer for bead in beads) + 1):
            own = [bead for bead in beads if bead.layer == level]
            centres = np.vstack([bead.points[:, :2] for bead in own])
            radii = np.concatenate([0.5 * bead.width for bead in own])
            layers.append(Layer(float(own[0].points[0, 2]), cKDTree(centres), radii))
        return cls(tuple(layers), tuple(bead.layer for bead in beads))

    def before(self, bead: int) -> LevelLayers:
        """The surface when the first `bead` beads have been printed: without the layer of the last of them."""
        return replace(self, solid=self.levels[bead - 1] if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from bed and layers; negative inside."""
        best = points[:, 2].copy()
        for layer in reversed(self.layers[: self.solid]):
            above = points[:, 2] - layer.top
            near = np.flatnonzero(above < best)
            if len(near) == 0:
                break  # the layers beneath are farther still
            away, k = layer.tree.query(points[near, :2])
            beyond, above = away - layer.radii[k], above[near]
            outside = np.hypot(np.maximum(beyond, 0.0), np.maximum(above, 0.0))
            distance = outside + np.minimum(np.maximum(beyond, above), 0.0)
            best[near] = np.minimum(best[near], distance)
        return np.asarray(best)

    def normals(self, points: Array) -> Array:
        """Straight up (n, 3), wherever the points are."""
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Straight up (n, 3), on every bead."""
        return self.normals(tips)
