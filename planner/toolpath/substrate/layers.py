"""Plane curves projected along z onto a body, layer on layer (Pollard et al., section 4.1), and the body as it grows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.readonly import Array
from planner.toolpath.bead import Bead
from planner.toolpath.laying import arc_length, densify
from planner.toolpath.rounding import PlaneCurve
from planner.toolpath.substrate.bodies import Body
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.substrate.facing import Facing
from planner.toolpath.transport import roll_zeros

_ASIDE = 1e-5  # m, to either side, for the slope of what a plane point is mapped to


@dataclass(frozen=True)
class Substrate:
    """A body and the layers on it, each `height` [m] above the one before: along the normal, or along z.

    layers   of all beads in print order
    solid    how many layers count as there; beneath the layer that is printed the body has grown everywhere
    facings  what the nozzle is normal to along each bead, where that is not the layer itself
    """

    body: Body
    height: float
    along_z: bool
    layers: tuple[int, ...] = ()
    solid: int = 0
    facings: tuple[Facing, ...] = ()

    def before(self, bead: int) -> Substrate:
        """The surface when the first `bead` beads have been printed: the last one's layer lies on it."""
        return replace(self, solid=self.layers[bead - 1] if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the body with its solid layers; negative inside."""
        rise = self.solid * self.height
        if self.along_z:
            return self.body.signed_distance(points - [0.0, 0.0, rise])
        return self.body.signed_distance(points) - rise

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the layer through points (n, 3)."""
        if self.along_z:
            normals = self.body.at(points[:, :2])[1]
            beside = np.isnan(normals[:, 0])
            if beside.any():
                normals[beside] = self.body.normals(points[beside])
            return normals
        return self.body.normals(points)

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """The layer's at the tips (n, 3), or those that a bead follows instead, at arc lengths s (n)."""
        return self.facings[bead].at(s) if self.facings else self.normals(tips)

    def project(self, plane: Array, layer: int) -> tuple[Array, Array]:
        """Nozzle tip and normals (n, 3) above plane points (n, 2): layer k's runs k + 1 layer heights above the body."""
        points, normals = self.body.at(plane)
        way = np.array([0.0, 0.0, 1.0]) if self.along_z else normals
        return points + (layer + 1) * self.height * way, normals

    def stretch(self, plane: Array, layer: int) -> tuple[Array, Array]:
        """How much longer a short line at plane points (n, 2) is in a layer, at most (n); and by how much less the
        layer is bent than would fold it (n): 0 or less where it is folded, 1 on the body itself."""
        steps = np.array([[_ASIDE, 0.0], [0.0, _ASIDE]])
        slope = [
            (self.project(plane + d, layer)[0] - self.project(plane - d, layer)[0]) / (2.0 * _ASIDE) for d in steps
        ]
        E, F, G = ((slope[i] * slope[j]).sum(axis=1) for i, j in ((0, 0), (0, 1), (1, 1)))
        greatest = np.sqrt(0.5 * (E + G) + np.sqrt(0.25 * (E - G) ** 2 + F**2))
        normals = self.body.at(plane)[1]
        area = (np.cross(slope[0], slope[1]) * normals).sum(axis=1)
        return greatest, area * normals[:, 2]

    def facing(self, curves: Sequence[Sequence[PlaneCurve]], blend: float, facets: FacetTree) -> Substrate:
        """The same where the nozzle is normal to facets along plane curves, those of one layer after another."""
        facings = []
        for layer, row in enumerate(curves):
            for curve in row:
                s = arc_length(self.project(curve.points, layer)[0])
                normals = facets.normals[facets.top(curve.points)[1]]
                facings.append(Facing.along(s, normals, blend, curve.closed))
        return replace(self, facings=tuple(facings))

    def lay(self, curves: Sequence[Sequence[PlaneCurve]], width: float, height: float) -> list[Bead]:
        """Beads `width` and `height` [m] along plane curves, those of one layer after another, in print order."""
        placed = [
            (layer, curve, *self.project(curve.points, layer)) for layer, row in enumerate(curves) for curve in row
        ]
        arcs = [arc_length(points) for _, _, points, _ in placed]
        axes = [normals for _, _, _, normals in placed]
        if self.facings:
            axes = [facing.at(s) for facing, s in zip(self.facings, arcs, strict=True)]
        return [
            Bead(
                name=curve.name,
                layer=layer,
                s=s,
                points=points,
                normals=axis,
                roll_zero=zero,
                source=self.project(densify(curve.source), layer)[0],
                width=np.full(len(points), width),
                height=height * (normals[:, 2] if self.along_z else np.ones(len(points))),
                closed=curve.closed,
            )
            for (layer, curve, points, normals), s, axis, zero in zip(placed, arcs, axes, roll_zeros(axes), strict=True)
        ]
