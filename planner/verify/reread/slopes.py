"""Normals of height fields, from slopes over several lengths, and the nozzle's axis against them.

A smooth surface through facets turns where these do, but less sharply: the difference between normals over short and
long distances shows how well a normal is known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.base.arrays import Array
from planner.base.geometry import angles_between
from planner.plan import Check
from planner.verify.checks import Judged
from planner.verify.reread.places import AXIS, NORMAL, Places, beyond_limits

Heights = Callable[[Array], Array]  # from places x, y (n, 2) to z (n) [m]; NaN off the surface

SEEN = 2000  # places of the whole print at which normals are compared
_OVER = (0.25e-3, 0.75e-3, 2e-3)  # m to either side
_FACETS = np.radians(1.0)  # a smooth surface's normals may differ this much from those of fine facets
_OFF = 0.05e-3  # m: beads may lie this far off facets without a note


def off_facets(judged: Judged) -> float:
    """How far smooth surfaces may be off facets [m]: what the notes report, but at least what needs no note."""
    return max(judged.toolpath.told.off, _OFF)


def normals_over(heights: Heights, plane: Array) -> Array:
    """Upward unit normals (3, n, 3) at x, y (n, 2), over a short, a usual and a long distance; NaN off the surface."""
    found = []
    for way in _OVER:
        steps = np.array([[way, 0.0], [-way, 0.0], [0.0, way], [0.0, -way]])
        z = heights((plane + steps[:, None]).reshape(-1, 2)).reshape(4, -1)
        normals = np.column_stack([z[1] - z[0], z[3] - z[2], np.full(len(plane), 2.0 * way)])
        found.append(normals / np.linalg.norm(normals, axis=1)[:, None])
    return np.stack(found)


def axis_along(judged: Judged, places: Places, normals: Array) -> Check:
    """The check that the axis is along normals (3, n, 3), within their uncertainty; passes where they are unknown."""
    known = ~np.isnan(normals[:, :, 2])
    sure = known.sum(axis=0) >= 2
    usual = np.where(known[1, :, None], normals[1], normals[0])
    spread = np.max([np.nan_to_num(angles_between(usual, other)) for other in normals], axis=0)
    off = np.where(sure, np.nan_to_num(angles_between(usual, places.up)), 0.0)
    limits = judged.problem.process.cones.tilt + AXIS + _FACETS + spread
    return beyond_limits(judged, places, NORMAL, np.degrees(off), np.degrees(limits), "deg")
