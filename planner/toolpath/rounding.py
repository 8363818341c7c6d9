"""Corner rounding: the smoothest curve that stays within a tolerance of a plane polyline.

A corner cut by a blend uses the tolerance on one side only. Here every sample may move anywhere in a disc
around its place on the input path, and the curve's third derivative, which is what drives joint jerk, is
made as small as the discs allow:

    minimise  sum |l^3 x'''|^2 + |x - p|^2   subject to  |x_i - p_i| <= tolerance

with l the rounding length: far from corners the second term holds the curve to the input. The problem is
convex; a log-barrier Newton method with a banded Cholesky factorisation solves it in time linear in samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from planner.toolpath.svg import PlanePath

Array = NDArray[np.float64]

SAMPLES_PER_TOLERANCE = 2.0  # sample spacing = tolerance / 2: a rounded corner is some 10 tolerances long
ROUNDING_LENGTH = 12.5  # l in tolerances: long enough that a right angle uses its whole disc
OVERLAP = 16.0  # in l: how far a closed path is unrolled past its seam; the ends' influence is e^-8 there
_BARRIERS = (1e4, 1e3, 1e2, 1e1)  # against an objective of some 6,000 a sample at a corner
_NEWTON_STEPS = 20
_SHRINK = 0.98  # of the tolerance: leaves room for the corners of the input that fall between samples


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


def round_corners(path: PlanePath, tolerance: float) -> PlaneCurve:
    """Smooth a polyline within `tolerance` [m] of itself, sample by sample (so in Fréchet distance too).

    Open paths keep their end points; closed ones are smooth across the seam.
    """
    length = ROUNDING_LENGTH * tolerance
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.points, axis=0).T))])
    n = max(int(np.ceil(arc[-1] / tolerance * SAMPLES_PER_TOLERANCE)), 8)
    step = arc[-1] / n
    if path.closed:
        extra = int(np.ceil(OVERLAP * length / step))
        u = np.arange(-extra, n + extra + 1) * step
        p = _along(path.points, arc, np.mod(u, arc[-1]))
        radius = _disc_radii(path, arc, u, step, tolerance)
        x = _smooth(p, radius, length / step)[extra : extra + n + 1]
        gap = x[0] - x[-1]  # some nanometres: spread it, so that the curve closes exactly
        x = x + np.linspace(-0.5, 0.5, n + 1)[:, None] * gap
        x[-1] = x[0]
    else:
        u = np.arange(n + 1) * step
        p = _along(path.points, arc, u)
        x = _smooth(p, _disc_radii(path, arc, u, step, tolerance), length / step)
    return PlaneCurve(path.name, x, path.points, path.closed)


def _along(points: Array, arc: Array, u: Array) -> Array:
    return np.column_stack([np.interp(u, arc, points[:, k]) for k in range(2)])


def _disc_radii(path: PlanePath, arc: Array, u: Array, step: float, tolerance: float) -> Array:
    """Radius (n) of each sample's disc [m]: smaller beside a corner that falls between samples.

    The corner itself then stays within tolerance of the curve: of sample i it is at most |x_i - p_i| + d away,
    with d from sample to corner, of which a turn by alpha adds sin(alpha / 2).
    """
    radius = np.full(len(u), tolerance * _SHRINK)
    d = np.diff(path.points, axis=0)
    heading = np.arctan2(d[:, 1], d[:, 0])
    if path.closed:
        corner, turn = arc[:-1], heading - np.roll(heading, 1)
    else:
        corner, turn = arc[1:-1], np.diff(heading)
    share = np.minimum(1.2 * np.abs(np.sin(0.5 * turn)), 1.0)
    loops = np.arange(np.floor(u[0] / arc[-1]), np.ceil(u[-1] / arc[-1]) + 1) if path.closed else np.zeros(1)
    at = (corner[None, :] + loops[:, None] * arc[-1]).ravel()
    lost = np.tile(share, len(loops))
    near = np.round((at - u[0]) / step).astype(int)
    inside = (near >= 0) & (near < len(u))
    near, at, lost = near[inside], at[inside], lost[inside]
    np.minimum.at(radius, near, tolerance * _SHRINK - np.abs(u[near] - at) * lost)
    return radius


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
        if np.any(e2 >= r2):
            return np.inf
        return float(0.5 * (Y * _apply(third, Y)).sum() + 0.5 * held @ e2 - barrier * np.log(r2 - e2).sum())

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
