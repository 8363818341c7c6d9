"""Leg: a piece of a joint path in a parameter in which it can start and end at rest.

A profile x(u) of squared rates cannot leave rest with bounded jerk and a bounded second derivative: there x grows
with u^(4/3). So near an end at rest the path parameter u follows a nominal motion u(sigma) that begins with the cube
of sigma, as motion of constant jerk does. Profiles over sigma are then regular, and positive, everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from planner.readonly import Array
from planner.timing.curve import Curve

_LEAST_NOMINAL = 0.2  # of the nominal motion's full rate: below it counts as nearly at rest
_MEAN = 0.6  # mean speed of a nominal ramp over its last


@dataclass(frozen=True)
class Leg:
    """The path from u = first to u = last, over sigma from 0 to `end`.

    path: joints and arc length over u [s at the commanded speed]; ramps: the parts of u in which the nominal motion
    gathers speed at the start and loses it at the end, 0 at an end that is passed in motion
    """

    path: Curve
    first: float
    last: float
    ramps: tuple[float, float]

    @property
    def end(self) -> float:
        """The last sigma."""
        a, b = self.ramps
        return self.last - self.first + (a + b) * (1.0 / _MEAN - 1.0)

    @property
    def lasts(self) -> tuple[float, float]:
        """How much of sigma the two ramps take."""
        return self.ramps[0] / _MEAN, self.ramps[1] / _MEAN

    @property
    def spacing(self) -> float:
        """Of the path's knots, of which there is at least one interval."""
        breaks = self.path.breaks
        return float((breaks[-1] - breaks[0]) / (len(breaks) - 1))

    def along(self, sigma: Array) -> Array:
        """Rate of arc length by sigma (k), where the nominal motion is nearly at rest as if it were not [m].

        So a commanded speed bounds profiles there too, which the vanishing rate itself would leave free.
        """
        u, u1, _, _ = self._nominal(sigma)
        return np.asarray(self.path.derivatives(u, 1)[0, :, -1] * np.maximum(u1, _LEAST_NOMINAL))

    def u(self, sigma: Array) -> Array:
        """Path parameter (k) at sigma (k)."""
        return np.asarray(self._nominal(sigma)[0])

    def rates(self, sigma: Array, orders: int) -> Array:
        """Derivatives by sigma of joints and arc length, (orders, k, nj + 1), of order 1 to `orders` (at most 3)."""
        u, *by_sigma = self._nominal(sigma)
        rates = self.path.derivatives(u, orders)
        _chain(rates, *by_sigma)
        return rates

    def _nominal(self, sigma: Array) -> Array:
        """u(sigma) and its first three derivatives (4, k)."""
        return _nominal(sigma, self.end, self.first, self.last, self.ramps, self.lasts)


@njit(cache=True, nogil=True)
def _nominal(
    sigma: Array, length: float, first: float, last: float, ramps: tuple[float, float], lasts: tuple[float, float]
) -> Array:
    """u(sigma) and its first three derivatives (4, k), between ramps whose speed's slope and bend vanish at their ends."""
    out = np.empty((4, len(sigma)))
    for i in range(len(sigma)):
        u, u1, u2, u3 = first + ramps[0] + sigma[i] - lasts[0], 1.0, 0.0, 0.0
        for end in range(2):
            way, long = ramps[end], lasts[end]
            since = sigma[i] if end == 0 else length - sigma[i]
            if way > 0.0 and since < long:
                t = max(since / long, 0.0)
                w = way * (2.0 * t**3 - 2.0 * t**4 + 0.6 * t**5) / _MEAN
                u = first + w if end == 0 else last - w
                u1 = t**2 * (6.0 - 8.0 * t + 3.0 * t**2)
                u2 = (12.0 * t - 24.0 * t**2 + 12.0 * t**3) / long * (1.0 if end == 0 else -1.0)
                u3 = (12.0 - 48.0 * t + 36.0 * t**2) / long**2
        out[0, i], out[1, i], out[2, i], out[3, i] = min(max(u, first), last), u1, u2, u3
    return out


@njit(cache=True, nogil=True)
def _chain(rates: Array, u1: Array, u2: Array, u3: Array) -> None:
    """Derivatives by u (orders, k, columns) become those by sigma, in place, with those of u by sigma (k)."""
    orders, k, columns = rates.shape
    for i in range(k):
        for column in range(columns):
            first = rates[0, i, column]
            rates[0, i, column] = first * u1[i]
            if orders > 1:
                second = rates[1, i, column]
                rates[1, i, column] = second * u1[i] ** 2 + first * u2[i]
                if orders > 2:
                    third = rates[2, i, column] * u1[i] ** 3
                    rates[2, i, column] = third + 3.0 * second * (u1[i] * u2[i]) + first * u3[i]
