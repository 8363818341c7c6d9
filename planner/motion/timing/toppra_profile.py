"""TOPP-RA instead of our own timing: the library toppra, which does not limit jerk, as a reference for comparison.

Pham and Pham, "A new approach to time-optimal path parameterization based on reachability analysis", IEEE T-RO 2018.
"""

from __future__ import annotations

import numpy as np
import toppra
from toppra import algorithm, constraint

from planner.base.arrays import Array
from planner.cell.cell import Limits
from planner.motion.timing.profile import HEADROOM, LEAST_RATE, Leg, Profile

_REFINE = 4  # grid intervals for each of the path's samples, as for the bound
_LEAST_INTERVALS = 60
_ANY = 1e9  # rad/s^2: the acceleration along the path has no limit of its own
_ROUNDING = 1e-6  # share by which the rate at an end stays below the greatest
_TRIES, _LESS = 60, 0.9  # rates tried at the end, each this share of the one before: the greatest may be infeasible

toppra.setup_logging("ERROR")


class _LegPath(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
    """Joints of a leg over sigma, followed by the arc length, whose rate does not vanish at rest: see `Leg.along`."""

    def __init__(self, leg: Leg, columns: int) -> None:
        self._leg, self._columns = leg, columns

    def __call__(self, sigma: Array, order: int = 0) -> Array:
        at = np.atleast_1d(np.asarray(sigma, dtype=float))
        values = self._leg.path(self._leg.u(at)) if order == 0 else self._leg.rates(at, order)[order - 1]
        if order == 1:
            values = np.column_stack([values[:, :-1], self._leg.along(at)])
        return np.asarray(values if np.ndim(sigma) else values[0])

    @property
    def dof(self) -> int:
        return self._columns

    @property
    def path_interval(self) -> Array:
        return np.array([0.0, self._leg.end])

    @property
    def waypoints(self) -> tuple[Array, Array]:
        ends = self.path_interval
        return ends, self(ends)


def toppra_profile(leg: Leg, limits: Limits, speed: float) -> Profile:
    """The profile that toppra finds for a leg whose last column is arc length, its rate at most `speed` [m/s].

    It keeps the same headroom below speed and acceleration limits as our own timing, and has no limit on jerk.
    """
    v, a = np.append(HEADROOM * limits.velocity, speed), np.append(HEADROOM * limits.acceleration, _ANY)
    intervals = max(int(np.ceil(_REFINE * leg.end / leg.spacing)), _LEAST_INTERVALS)
    sigma = np.linspace(0.0, leg.end, intervals + 1)
    bounds = [
        constraint.JointVelocityConstraint(np.column_stack([-v, v])),
        constraint.JointAccelerationConstraint(
            np.column_stack([-a, a]), discretization_scheme=constraint.DiscretizationType.Interpolation
        ),
    ]
    search = algorithm.TOPPRA(bounds, _LegPath(leg, len(v)), gridpoints=sigma)
    x = np.maximum(_rates(search) ** 2, LEAST_RATE)
    root = np.sqrt(x)
    times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(sigma) / (root[1:] + root[:-1]))])
    return Profile(leg, sigma, np.column_stack([x[:-1], np.diff(x), np.zeros(intervals)]), times)


def _rates(search: algorithm.TOPPRA) -> Array:
    """Rates (k) of sigma at the grid points, those at the ends as close as possible to the nominal motion's, 1."""
    last = float(np.sqrt(max(search.compute_feasible_sets()[-1, 1], 0.0)))
    for tried in range(_TRIES):
        end = _LESS**tried * min((1.0 - _ROUNDING) * last, 1.0)
        first = search.compute_controllable_sets(end, end)[0, 1]
        if np.isfinite(first) and first > 0.0:
            begin = min((1.0 - _ROUNDING) * float(np.sqrt(first)), 1.0)
            rates = search.compute_parameterization(begin, end)[1]
            if rates is not None:
                return np.asarray(rates)
    raise RuntimeError("toppra finds no profile, although a slow enough one always exists")
