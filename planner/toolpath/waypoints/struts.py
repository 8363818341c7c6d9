"""Beads that lie on no surface: struts and columns in space, known only by the nozzle's tip and axis along them.

The bead hangs from the nozzle: it is round, and its middle is half its diameter before the tip along the tool axis,
whatever the tip's path. A column along the axis is then a capsule that ends at the tip, and a nozzle that draws back
from it touches it only there. Nothing is known about anything beneath, so nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array, Ints, read_only
from planner.toolpath.bead import Bead
from planner.toolpath.waypoints.nearest import PrintedPoints, nearest_printed, printed_points
from planner.toolpath.waypoints.surfels import Samples, tips_tree

# Struts fuse where they meet, and the later one begins or ends within the earlier one: its tip may enter the outer half
# of that. The inner half is the core, which no tip needs to enter.
CORE = 0.5
_APART = 0.125  # diameters between points along a strut's middle


@dataclass(frozen=True)
class Struts(Samples):
    """The cores of struts, in print order; lengths in metres, part frame.

    tips, outward (n, 3)  the samples of all beads, and unit vectors against the tool axis
    along (n)             arc length of the samples in their bead
    first (beads + 1)     index of each bead's first sample
    middles (m, 3)        points along the middles of the struts; radius (m) of their cores there
    printed               how many beads are already there
    tree, tip_tree        search trees of the middles, and of all tips
    """

    tips: Array
    outward: Array
    along: Array
    first: Ints
    middles: Array
    radius: Array
    printed: int
    tree: PrintedPoints
    tip_tree: PrintedPoints

    def before(self, bead: int) -> Struts:
        """The struts after the first `bead` beads."""
        return replace(self, printed=bead)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the printed cores, FAR at most; negative inside."""
        distance, nearest = nearest_printed(self.tree, self.printed, points)
        return distance - np.where(nearest < 0, 0.0, self.radius[nearest])


def struts_of(beads: Sequence[Bead]) -> Struts:
    """The cores of all beads."""
    tips, outward = (np.vstack([getattr(bead, name) for bead in beads]) for name in ("points", "normals"))
    middles, radius = zip(*(_middle(bead) for bead in beads), strict=True)
    first = np.concatenate([[0], np.cumsum([len(bead.points) for bead in beads])])
    laid, cores = np.concatenate(middles), CORE * np.concatenate(radius)
    along = np.concatenate([bead.s for bead in beads])
    tree = printed_points(laid, np.repeat(np.arange(len(beads)), [len(each) for each in radius]))
    samples = (read_only(tips), read_only(outward), read_only(along))
    return Struts(*samples, first, laid, cores, len(beads), tree, tips_tree(tips))


def _middle(bead: Bead) -> tuple[Array, Array]:
    """Points (n, 3) along the middle of a strut, and its radii (n) there [m]."""
    count = max(2, int(np.ceil(bead.length / (_APART * float(bead.width.min())))) + 1)
    s = np.linspace(0.0, bead.length, count)
    tip, outward = (
        np.column_stack([np.interp(s, bead.s, column) for column in values.T]) for values in (bead.points, bead.normals)
    )
    radius = 0.5 * np.interp(s, bead.s, bead.width)
    return tip - radius[:, None] * outward, radius
