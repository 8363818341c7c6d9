"""Wrapping a plane path around a cylinder (Pollard, eq. 2): x becomes angle, y becomes height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.readonly import Array
from planner.toolpath.bead import Bead
from planner.toolpath.laying import bead_along, densify
from planner.toolpath.rounding import PlaneCurve


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder on the part frame's xy plane; lengths in metres.

    centre (2) of its axis in the part frame, which need not be the table's own axis
    """

    radius: float
    height: float
    centre: Array

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the solid cylinder; negative inside."""
        radial = np.hypot(points[:, 0] - self.centre[0], points[:, 1] - self.centre[1]) - self.radius
        axial = np.abs(points[:, 2] - 0.5 * self.height) - 0.5 * self.height
        outside = np.hypot(np.maximum(radial, 0.0), np.maximum(axial, 0.0))
        return outside + np.minimum(np.maximum(radial, axial), 0.0)

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the mantle at points (n, 3)."""
        d = points[:, :2] - self.centre
        d = d / np.hypot(d[:, 0], d[:, 1])[:, None]
        return np.column_stack([d, np.zeros(len(d))])

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """The mantle's at the tips (n, 3), whatever bead is laid there."""
        return self.normals(tips)

    def before(self, bead: int) -> Cylinder:
        """The bare cylinder, whatever has been printed on it."""
        return self

    def wrap(self, plane: Array, rise: float) -> tuple[Array, Array, Array]:
        """Points, normals and upright directions (n, 3) of plane points (n, 2), `rise` above the mantle.

        The plane's origin comes to half the cylinder's height at angle 0; x is arc length on the bare mantle.
        """
        angle = plane[:, 0] / self.radius
        c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(plane))
        r = self.radius + rise
        z = plane[:, 1] + 0.5 * self.height
        points = np.column_stack([self.centre[0] + r * c, self.centre[1] + r * s, z])
        return points, np.column_stack([c, s, zero]), np.column_stack([zero, zero, zero + 1.0])


def wrap_layer(
    curves: Sequence[PlaneCurve], cylinder: Cylinder, layer: int, layer_height: float, width: float, height: float
) -> list[Bead]:
    """Beads of one layer: layer k's nozzle tip runs k + 1 layer heights above the mantle."""
    rise = (layer + 1) * layer_height
    beads = []
    for curve in curves:
        points, normals, upright = cylinder.wrap(curve.points, rise)
        source, _, _ = cylinder.wrap(densify(curve.source), rise)
        beads.append(bead_along(curve, layer, points, normals, upright, source, width, height))
    return beads
