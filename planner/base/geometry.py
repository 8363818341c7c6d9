"""Lengths along polylines, and angles brought within half a turn."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array

TURN = 2.0 * np.pi


def arc_lengths(points: Array) -> Array:
    """Length (n) along a polyline from its first point to each of its points (n, d), in their unit; the first is 0."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def wrap_angle(angle: Array) -> Array:
    """Angles [rad], less the whole turns that bring them into [-pi, pi)."""
    return np.asarray(np.remainder(angle + np.pi, TURN) - np.pi)
