"""What happens around a bead: run-in and run-out, where the nozzle moves but nothing is deposited."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from planner.toolpath.bead import Bead

Array = NDArray[np.float64]

RISE_PER_LENGTH = 0.5  # height of the far end of a run over its length: clears a bead within the run's last half
_STRAIGHTEN = 0.4  # share of a run in which the bead's curvature fades to a straight line
_SUBSTEPS = 8  # of the integration of a run, per sample


@dataclass(frozen=True)
class Run:
    """A bead with its run-in and run-out: what the nozzle follows from rest to rest.

    points, normals, roll_zero (n, 3) part frame [m, unit]; s (n,) arc length [m], 0 where the bead starts,
    negative in the run-in; deposit lasts from sample `first` to sample `last`, both included.
    """

    points: Array
    normals: Array
    roll_zero: Array
    s: Array
    first: int
    last: int


def with_runs(bead: Bead, length: float) -> Run:
    """Extend a bead by a run-in and a run-out of `length` [m] each.

    A run leaves along the bead's tangent with its curvature (continuous to the second derivative), becomes
    straight, and rises from the surface with the cube of the distance.
    """
    before, s_before = _leave(bead, length, at_end=False)
    after, s_after = _leave(bead, length, at_end=True)
    points, normals, roll_zero = (
        np.vstack([a[::-1], here, b])
        for a, here, b in zip(before, (bead.points, bead.normals, bead.roll_zero), after, strict=True)
    )
    s = np.concatenate([-s_before[::-1], bead.s, bead.length + s_after])
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    roll_zero = roll_zero - (roll_zero * normals).sum(axis=1)[:, None] * normals
    roll_zero = roll_zero / np.linalg.norm(roll_zero, axis=1)[:, None]
    first = len(s_before)
    return Run(points, normals, roll_zero, s, first, first + len(bead.points) - 1)


def _leave(bead: Bead, length: float, at_end: bool) -> tuple[tuple[Array, Array, Array], Array]:
    """Samples (m, 3) of points, normals and roll directions beyond one end, walking away from the bead, and the
    arc length (m) from that end."""
    k = min(len(bead.points), 12)  # enough samples for the end's derivatives
    take = slice(-1, -k - 1, -1) if at_end else slice(0, k)
    rows = np.hstack([bead.points[take], bead.normals[take], bead.roll_zero[take]])
    spline = make_interp_spline(np.arange(k, dtype=float), rows, k=min(5, k - 1))
    values, slopes, bends = (np.split(sign * spline(0.0, order), 3) for order, sign in ((0, 1.0), (1, -1.0), (2, 1.0)))
    step = float(np.linalg.norm(slopes[0]))
    m = max(int(np.ceil(length / step)), 4)
    u = np.arange(m * _SUBSTEPS + 1) / _SUBSTEPS
    fade = _fade(u / (_STRAIGHTEN * m))
    # x'' = x''(0) fade: the point's slope settles; n' = (n'(0) + n''(0) u) fade: the nozzle stops turning
    slope = slopes[0] + bends[0] * _integral(fade, u)[:, None]
    points = values[0] + _integral(slope, u)
    turned = [values[i] + _integral((slopes[i] + bends[i] * u[:, None]) * fade[:, None], u) for i in (1, 2)]
    away = np.linalg.norm(points - values[0], axis=1)
    points = points + (RISE_PER_LENGTH * length * (away / length) ** 3)[:, None] * turned[0]
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    keep = slice(_SUBSTEPS, None, _SUBSTEPS)
    return (points[keep], turned[0][keep], turned[1][keep]), arc[keep]


def _fade(x: Array) -> Array:
    """From 1 at x = 0 to 0 at x = 1 and beyond, with two flat derivatives at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def _integral(f: Array, u: Array) -> Array:
    """Integral of f (m, ...) over u (m) from u[0], by the trapezoidal rule."""
    mid = 0.5 * (f[1:] + f[:-1])
    steps = np.diff(u).reshape((-1,) + (1,) * (f.ndim - 1))
    return np.concatenate([np.zeros_like(f[:1]), np.cumsum(mid * steps, axis=0)])
