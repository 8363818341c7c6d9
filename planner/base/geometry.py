"""Geometry of plain points and angles that several rooms need."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array, Ints

TURN = 2.0 * np.pi


def arc_lengths(points: Array) -> Array:
    """Length (n,) of a polyline through points (n, d) from its first point up to each of them, 0 at the first."""
    step = np.diff(points, axis=0)
    size = np.hypot(*step.T) if points.shape[1] == 2 else np.linalg.norm(step, axis=1)
    return np.concatenate([[0.0], np.cumsum(size)])


def subdivided(pieces: Ints) -> tuple[Ints, Array]:
    """Where pieces begin if each of m steps is cut into so many equal ones (m): number of the step (n), share of it (n)."""
    step = np.repeat(np.arange(len(pieces)), pieces)
    within = np.arange(len(step)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return step, within / pieces[step]


def angles_between(a: Array, b: Array) -> Array:
    """Angles (...) between vectors a and b (..., 3) [rad], exact for small ones too."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def wrap_angle(angle: Array) -> Array:
    """Angles [rad], less the whole turns that bring them into [-pi, pi)."""
    return np.asarray(np.remainder(angle + np.pi, TURN) - np.pi)
