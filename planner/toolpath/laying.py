"""From a plane curve and where it comes to lie in space to its bead."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from planner.readonly import Array
from planner.toolpath.bead import Bead
from planner.toolpath.rounding import PlaneCurve

_SOURCE_STEP = 1e-4  # m: an input polyline is laid this densely, 0.04 um from the true helix at 34 mm


def bead_along(
    curve: PlaneCurve,
    layer: int,
    points: Array,
    normals: Array,
    roll_zero: Array,
    source: Array,
    width: Array | float,
    height: Array | float,
    material: str = "",
) -> Bead:
    """The bead of a curve whose points lie at points (n, 3) [m], its input at source (m, 3), for the rest see Bead.

    width and height [m] are those of every place (n,), or of the whole bead.
    """
    return Bead(
        name=curve.name,
        layer=layer,
        s=arc_length(points),
        points=points,
        normals=normals,
        roll_zero=roll_zero,
        source=source,
        width=np.full(len(points), width),
        height=np.full(len(points), height),
        closed=curve.closed,
        material=material,
    )


def arc_length(points: Array) -> Array:
    """Arc length (n,) along the smooth curve through points (n, 3) that are uniform in its parameter."""
    u = np.arange(len(points), dtype=float)
    spline = make_interp_spline(u, points, k=5)
    # Gauss-Legendre, three points an interval: exact to 1e-12 m where the spline is resolved at all
    nodes, weights = np.polynomial.legendre.leggauss(3)
    mid = u[:-1, None] + 0.5 * (nodes[None, :] + 1.0)
    speed = np.linalg.norm(spline(mid.ravel(), 1), axis=1).reshape(mid.shape)
    return np.concatenate([[0.0], np.cumsum(0.5 * speed @ weights)])


def densify(polyline: Array) -> Array:
    """The same polyline with no segment longer than `_SOURCE_STEP`; its vertices are kept."""
    lengths = np.hypot(*np.diff(polyline, axis=0).T)
    pieces = np.maximum(np.ceil(lengths / _SOURCE_STEP).astype(int), 1)
    index = np.repeat(np.arange(len(pieces)), pieces)
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    t = within / pieces[index]
    dense = polyline[index] + t[:, None] * np.diff(polyline, axis=0)[index]
    return np.vstack([dense, polyline[-1]])
