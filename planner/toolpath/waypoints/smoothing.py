"""Normals along a path, smoothed within a bound: measured ones carry noise that an arm should not follow."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded

from planner.readonly import Array

REACH = 3.0  # waypoints, about, to either side over which a normal is averaged; waves of 20 or more stay
_ROUNDS = 40  # in which normals that were turned too far are held more firmly
_FIRMER = 1.3  # least factor for those
_NONE = 1e-12  # rad, and length of a mean of normals: none at all
_ORDER = 3  # of the difference that is made small


def smooth_normals(normals: Array, bound: float) -> tuple[Array, Array]:
    """Smooth unit normals (n, 3) along their path; none is turned by more than `bound` [rad].

    Third differences are weighed against what the normals are changed by, so that some REACH neighbours to either side
    are averaged; a normal that would turn too far is held back, more firmly until it does not. Returns the normals
    and the angles (n) [rad] by which they were turned.
    """
    n = len(normals)
    if n <= _ORDER:
        return normals, np.zeros(n)
    bands = _bands(n)
    hold = np.full(n, REACH ** (-2 * _ORDER))
    smooth, turned = normals, np.zeros(n)
    for _ in range(_ROUNDS):
        system = bands.copy()
        system[0] += hold
        smooth = solveh_banded(system, hold[:, None] * normals, lower=True)
        smooth = smooth / np.maximum(np.linalg.norm(smooth, axis=1), _NONE)[:, None]
        turned = _angles(smooth, normals)
        far = turned > bound
        if not far.any():
            return smooth, turned
        hold = np.where(far, hold * np.maximum(turned / bound, _FIRMER) ** 2, hold)
    # a few are still a little beyond the bound: all go back towards the file's by that share
    share = bound / turned.max()
    back, ahead = np.sin((1.0 - share) * turned), np.sin(share * turned)
    still = turned <= _NONE
    smooth = np.where(still[:, None], normals, back[:, None] * normals + ahead[:, None] * smooth)
    smooth = smooth / np.linalg.norm(smooth, axis=1)[:, None]
    return smooth, _angles(smooth, normals)


def _bands(n: int) -> Array:
    """Lower bands (4, n) of D^T D, D the third difference of n values."""
    d = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((_ORDER + 1, n))
    for a in range(_ORDER + 1):
        for b in range(a + 1):
            bands[a - b, b : b + n - _ORDER] += d[a] * d[b]
    return bands


def _angles(a: Array, b: Array) -> Array:
    """Angles (n) between vectors a and b (n, 3)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
