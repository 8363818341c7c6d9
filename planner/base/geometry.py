"""Geometry of plain points and angles that several packages need."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array, Ints

TURN = 2.0 * np.pi


def arc_lengths(points: Array) -> Array:
    """Arc lengths (n,) along a polyline through points (n, d), from its first point to each of them."""
    step = np.diff(points, axis=0)
    size = np.hypot(*step.T) if points.shape[1] == 2 else np.linalg.norm(step, axis=1)
    return np.concatenate([[0.0], np.cumsum(size)])


def subdivided(pieces: Ints) -> tuple[Ints, Array]:
    """Starts of all pieces if steps are cut into `pieces` (m) equal ones each: indices of steps (n), fractions (n)."""
    step = np.repeat(np.arange(len(pieces)), pieces)
    within = np.arange(len(step)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return step, within / pieces[step]


def angles_between(a: Array, b: Array) -> Array:
    """Angles (...) between vectors a and b (..., 3) [rad], accurate for small ones, too."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def wrap_angle(angle: Array) -> Array:
    """Angles [rad] brought into [-pi, pi) by whole turns."""
    return np.asarray(np.remainder(angle + np.pi, TURN) - np.pi)
