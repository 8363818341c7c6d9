"""Corner rounding: the smoothest curve that stays within a tolerance of a plane polyline.

A corner cut by a blend uses the tolerance on one side only. Here every sample may move anywhere in a disc
around its place on the input path, and the curve's third derivative, which is what drives joint jerk, is
made as small as the discs allow:

    minimise  sum |l^3 x'''|^2 + |x - p|^2   subject to  |x_i - p_i| <= tolerance

with l the rounding length: far from corners the second term holds the curve to the input. The problem is
convex; a log-barrier Newton method with a banded Cholesky factorisation solves it in time linear in samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solveh_banded

from planner.readonly import Array

if TYPE_CHECKING:
    from planner.toolpath.svg import PlanePath


SAMPLES_PER_TOLERANCE = 2.0  # sample spacing = tolerance / 2: a rounded corner is some 10 tolerances long
ROUNDING_LENGTH = 12.5  # l in tolerances: long enough that a right angle uses its whole disc
OVERLAP = 16.0  # in l: how far a closed path is unrolled past its seam; the ends' influence is e^-8 there
_BARRIERS = (1e4, 1e3, 1e2, 1e1)  # against an objective of some 6,000 a sample at a corner
_NEWTON_STEPS = 20
_KEPT_ROOM = 0.01  # of the squared distance to a disc's rim that a step must leave: numbers stay finite
_FINEST = 0.5  # of the tolerance: where less of it is used, samples draw no closer together
_LEAST = 0.1  # of the tolerance, radius of any disc: where the tolerance is shared out, few samples see a corner
_SHRINK = 0.98  # of the tolerance: leaves room for what the curve does between samples


@dataclass(frozen=True)
class PlaneCurve:
    """A rounded path, sampled uniformly in the arc length u of its input path.

    points (n, 2) on the curve, source (m, 2) the input polyline [m]; closed: the last point is the first.
    The samples draw together where the curve turns sharply.
    """

    name: str
    points: Array
    source: Array
    closed: bool


def round_corners(path: PlanePath, tolerance: float, share: Callable[[Array], Array] | None = None) -> PlaneCurve:
    """Smooth a polyline within `tolerance` [m] of itself, sample by sample (so in Fréchet distance too).

    Open paths keep their end points; closed ones are smooth across the seam. Where `share` is given, only that part
    (n) of the tolerance is used at points (n, 2) of the path.
    """
    length = ROUNDING_LENGTH * tolerance
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.points, axis=0).T))])
    finest = tolerance if share is None else tolerance * max(float(share(path.points).min()), _FINEST)
    n = max(int(np.ceil(arc[-1] / finest * SAMPLES_PER_TOLERANCE)), 8)
    step = arc[-1] / n
    if path.closed:
        extra = int(np.ceil(OVERLAP * length / step))
        u = np.arange(-extra, n + extra + 1) * step
        p = _along(path.points, arc, np.mod(u, arc[-1]))
        radius = _disc_radii(path, arc, u, p, _rooms(p, tolerance, share))
        x = _smooth(p, radius, length / step)[extra : extra + n + 1]
        gap = x[0] - x[-1]  # some nanometres: spread it, so that the curve closes exactly
        x = x + np.linspace(-0.5, 0.5, n + 1)[:, None] * gap
        x[-1] = x[0]
    else:
        u = np.arange(n + 1) * step
        p = _along(path.points, arc, u)
        x = _smooth(p, _disc_radii(path, arc, u, p, _rooms(p, tolerance, share)), length / step)
    return PlaneCurve(path.name, x, path.points, path.closed)


def _along(points: Array, arc: Array, u: Array) -> Array:
    return np.column_stack([np.interp(u, arc, points[:, k]) for k in range(2)])


def _rooms(p: Array, tolerance: float, share: Callable[[Array], Array] | None) -> Array:
    """The tolerance (n) at each sample."""
    return np.full(len(p), tolerance) if share is None else tolerance * share(p)


def _disc_radii(path: PlanePath, arc: Array, u: Array, p: Array, tolerance: Array) -> Array:
    """Radius (n) of each sample's disc [m], within its tolerance (n): smaller beside corners between samples.

    A corner at a distance h from the chord of its two samples p is within radius + h of the curve.
    """
    radius = tolerance * _SHRINK
    corner = path.points[:-1] if path.closed else path.points[1:-1]
    at = arc[:-1] if path.closed else arc[1:-1]
    if path.closed:
        loops = np.arange(np.floor(u[0] / arc[-1]), np.ceil(u[-1] / arc[-1]) + 1)
        at = (at[None, :] + loops[:, None] * arc[-1]).ravel()
        corner = np.tile(corner, (len(loops), 1))
    k = np.floor((at - u[0]) / (u[1] - u[0])).astype(int)
    inside = (k >= 0) & (k < len(u) - 1)
    k, corner = k[inside], corner[inside]
    chord = p[k + 1] - p[k]
    t = ((corner - p[k]) * chord).sum(axis=1) / np.maximum((chord * chord).sum(axis=1), 1e-30)
    h = np.linalg.norm(corner - p[k] - np.clip(t, 0.0, 1.0)[:, None] * chord, axis=1)
    for beside in (k, k + 1):
        np.minimum.at(radius, beside, tolerance[beside] * _SHRINK - h)
    return np.maximum(radius, _LEAST * tolerance)


def _smooth(p: Array, radius: Array, stiffness: float) -> Array:
    """Solve the problem above for samples p (n, 2) with discs of `radius` (n); `stiffness` is l in sample steps.

    End points are kept.
    """
    n = len(p)
    third = _third_difference_bands(n, stiffness**6)
    scale = float(radius.max())
    P = p / scale
    r2 = (radius / scale) ** 2
    X = P.copy()
    held = np.ones(n)
    held[[0, -1]] = 1e12  # weight of |x - p|^2 that pins the ends
    for barrier in _BARRIERS:
        for _ in range(_NEWTON_STEPS):
            e = X - P
            room = r2 - (e * e).sum(axis=1)
            pull = held + 2.0 * barrier / room
            bend = 4.0 * barrier / room**2
            gradient = _apply(third, X) + e * pull[:, None]
            bands = np.zeros((7, 2 * n))
            for k in range(4):
                bands[2 * k, 0::2] = bands[2 * k, 1::2] = third[k]
            bands[0, 0::2] += pull + bend * e[:, 0] ** 2
            bands[0, 1::2] += pull + bend * e[:, 1] ** 2
            bands[1, 0::2] = bend * e[:, 0] * e[:, 1]
            step = -solveh_banded(bands, gradient.ravel(), lower=True, overwrite_ab=True, check_finite=False)
            step = step.reshape(n, 2)
            decrement = -float((gradient * step).sum())
            X = _line_search(X, step, decrement, P, r2, third, held, barrier)
            if decrement < 0.1 * barrier:
                break
    return X * scale


def _line_search(
    X: Array, step: Array, decrement: float, P: Array, r2: Array, third: Array, held: Array, barrier: float
) -> Array:
    """Largest halving of a Newton step that stays inside every disc and lowers the barrier function."""

    def value(Y: Array) -> float:
        e = Y - P
        e2 = (e * e).sum(axis=1)
        if np.any(r2 - e2 < _KEPT_ROOM * room):
            return np.inf
        return float(0.5 * (Y * _apply(third, Y)).sum() + 0.5 * held @ e2 - barrier * np.log(r2 - e2).sum())

    room = r2 - ((X - P) ** 2).sum(axis=1)
    start, scale = value(X), 1.0
    while scale > 1e-6 and value(X + scale * step) > start - 0.1 * scale * decrement:
        scale *= 0.5
    return X + scale * step if scale > 1e-6 else X


def _third_difference_bands(n: int, weight: float) -> Array:
    """Lower bands (4, n) of weight * D^T D, D the third difference."""
    d = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for a in range(4):
        for b in range(a + 1):
            bands[a - b, b : b + n - 3] += weight * d[a] * d[b]
    return bands


def _apply(bands: Array, x: Array) -> Array:
    """Product of a symmetric matrix given by its lower bands with x (n, 2)."""
    n = len(x)
    y = bands[0][:, None] * x
    for k in range(1, len(bands)):
        y[k:] += bands[k, : n - k, None] * x[:-k]
        y[:-k] += bands[k, : n - k, None] * x[k:]
    return y
