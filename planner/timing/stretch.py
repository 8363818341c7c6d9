"""Stretch: a piece of a joint path in a parameter in which it can start and end at rest.

A profile x(u) of squared rates cannot leave rest with bounded jerk and a bounded second derivative: there x grows
with u^(4/3). So near an end at rest the path parameter u follows a nominal motion u(sigma) that begins with the cube
of sigma, as motion of constant jerk does. Profiles over sigma are then regular, and positive, everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Array = NDArray[np.float64]
_LEAST_NOMINAL = 0.2  # of the nominal motion's full rate: below it counts as nearly at rest
_MEAN = 0.6  # mean speed of a nominal ramp over its last


@dataclass(frozen=True)
class Stretch:
    """The path from u = first to u = last, over sigma from 0 to `end`.

    path: joints and arc length over u [s at the commanded speed]; ramps: the parts of u in which the nominal motion
    gathers speed at the start and loses it at the end, 0 at an end that is passed in motion
    """

    path: BSpline
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
        knots = np.unique(self.path.t)
        return float((knots[-1] - knots[0]) / (len(knots) - 1))

    def along(self, sigma: Array) -> Array:
        """Rate of arc length by sigma (k), where the nominal motion is nearly at rest as if it were not [m].

        So a commanded speed bounds profiles there too, which the vanishing rate itself would leave free.
        """
        u, u1, _, _ = self._nominal(sigma)
        return np.asarray(self.path(u, 1))[:, -1] * np.maximum(u1, _LEAST_NOMINAL)

    def u(self, sigma: Array) -> Array:
        """Path parameter (k) at sigma (k)."""
        return self._nominal(sigma)[0]

    def rates(self, sigma: Array, orders: int) -> list[Array]:
        """Derivatives by sigma of joints and arc length, (k, nj + 1) each, of order 1 to `orders` (at most 3)."""
        u, u1, u2, u3 = (each[:, None] for each in self._nominal(sigma))
        by_u = [np.asarray(self.path(u[:, 0], order)) for order in range(1, orders + 1)]
        out = [by_u[0] * u1]
        if orders > 1:
            out.append(by_u[1] * u1**2 + by_u[0] * u2)
        if orders > 2:
            out.append(by_u[2] * u1**3 + 3.0 * by_u[1] * (u1 * u2) + by_u[0] * u3)
        return out

    def _nominal(self, sigma: Array) -> tuple[Array, Array, Array, Array]:
        """u(sigma) and its first three derivatives (k)."""
        start, end = self.lasts
        u = self.first + self.ramps[0] + sigma - start
        u1, u2, u3 = np.ones_like(sigma), np.zeros_like(sigma), np.zeros_like(sigma)
        for lasts, way, forwards in ((start, self.ramps[0], True), (end, self.ramps[1], False)):
            if way == 0.0:
                continue
            since = sigma if forwards else self.end - sigma
            inside = since < lasts
            t = np.clip(since[inside] / lasts, 0.0, 1.0)
            w = (2.0 * t**3 - 2.0 * t**4 + 0.6 * t**5) / _MEAN  # speed's slope and bend vanish where the ramp ends
            u[inside] = self.first + way * w if forwards else self.last - way * w
            u1[inside] = t**2 * (6.0 - 8.0 * t + 3.0 * t**2)
            u2[inside] = (12.0 * t - 24.0 * t**2 + 12.0 * t**3) / lasts * (1.0 if forwards else -1.0)
            u3[inside] = (12.0 - 48.0 * t + 36.0 * t**2) / lasts**2
        return np.clip(u, self.first, self.last), u1, u2, u3
