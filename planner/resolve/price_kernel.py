"""What a path costs, compiled.

The price of a path is in seconds. At the commanded speed v the joints' rates are known from the path, so each
sample has a greatest speed that the limits allow, v / (1 + slack): the slack is the share of its time that is lost.

    price = sum over samples of  step * (deposits * lost(slack) + effort + closeness + excess)

lost is the time that a slack loses, and a little for every dip.
effort is small and grows with the squares of the rates' shares of their limits, ever more slowly beyond them: of two
choices at full speed the calmer one wins. Where no time is lost anyway, peaks of the joints' speed are part of it.
closeness grows towards singularities of the arm and the ends of the joints' ranges.
excess is dear: what goes beyond bounds. Tilt, and ends of beads that move, are priced in `refine`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.resolve.node_kernel import LIMIT_COMFORT, LIMIT_PRICE, SIGMA_COMFORT, SIGMA_PRICE

EFFORT = np.array([3.0, 0.1, 0.1])  # seconds a second of printing, for joints at their speed, acceleration, jerk
PEAK_PRICE = 0.1  # seconds a second of printing, for joints at the speed that counts as a peak
DIP_PRICE = 0.25  # seconds a second of printing below the commanded speed: one deep dip beats two shallow ones
DIP = 0.05  # slack at which half of that is counted
HARD_PRICE = 1e3  # seconds a second and unit (rad, or the share of a bound) beyond what must not be exceeded


@njit(cache=True, nogil=True, error_model="numpy")
def differentiate(values, centre, D, out) -> None:
    """Fill out (n, 3, k) with the first three time derivatives of values (n, k)."""
    n, k = values.shape
    for i in range(n):
        for o in range(3):
            for j in range(k):
                total = 0.0
                for s in range(5):
                    total += D[i, o, s] * values[centre[i] + s - 2, j]
                out[i, o, j] = total


@njit(cache=True, nogil=True, error_model="numpy")
def allowed(order: int, slack: float):
    """Bound of a rate's share of its limit at a slack, linear from there on, and its slope: (1 + slack)^order."""
    if order == 0:
        return 1.0 + slack, 1.0
    if order == 1:
        return (1.0 + slack) ** 2, 2.0 * (1.0 + slack)
    return (1.0 + slack) ** 3, 3.0 * (1.0 + slack) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def lost(slack: float) -> float:
    """Price a second of a slack: the time lost, and that there is a dip at all."""
    return slack + DIP_PRICE * slack / (slack + DIP)


@njit(cache=True, nogil=True, error_model="numpy")
def lost_slope(slack: float) -> float:
    """Derivative of `lost`, which is concave: its tangent is never below it."""
    return 1.0 + DIP_PRICE * DIP / (slack + DIP) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def price_of(rates, limits, step, deposits, q, low, high, sigma, least_sigma, bounds, peak, slack):
    """Price of a path [s]; fills slack (n). bounds (n, b): what must not be positive, for instance a cone's excess.

    peak: see `peak_price`.
    """
    n, _, nj = rates.shape
    na = low.size
    total = 0.0
    for i in range(n):
        v, a, y = 0.0, 0.0, 0.0
        for j in range(nj):
            v = max(v, abs(rates[i, 0, j]) / limits[0, j])
            a = max(a, abs(rates[i, 1, j]) / limits[1, j])
            y = max(y, abs(rates[i, 2, j]) / limits[2, j])
        slack[i] = max(v, np.sqrt(a), np.cbrt(y), 1.0) - 1.0
        effort = 0.0
        for o in range(3):
            for j in range(nj):
                square = (rates[i, o, j] / limits[o, j]) ** 2
                effort += EFFORT[o] * square / (1.0 + square)
        cost = deposits[i] * lost(slack[i]) + effort / nj
        close = max(0.0, SIGMA_COMFORT / sigma[i] - 1.0)
        cost += SIGMA_PRICE * close * close + deposits[i] * HARD_PRICE * max(0.0, least_sigma - sigma[i])
        for j in range(na):
            room = min(q[i, j] - low[j], high[j] - q[i, j])
            near = max(0.0, 1.0 - room / LIMIT_COMFORT)
            cost += LIMIT_PRICE * near * near + HARD_PRICE * max(0.0, -room)
        for c in range(bounds.shape[1]):
            cost += HARD_PRICE * max(0.0, bounds[i, c])
        total += step[i] * cost
    return total + peak_price(rates, step, peak)


@njit(cache=True, nogil=True, error_model="numpy")
def peak_price(rates, step, peak):
    """Price [s] of peaks of the joints' speed in rates (n, 3, nj): of its eighth power, PEAK_PRICE at the speed `peak`."""
    n, _, nj = rates.shape
    total = 0.0
    if peak < np.inf:
        for i in range(n):
            for j in range(nj):
                total += step[i] * (rates[i, 0, j] / peak) ** 8
    return PEAK_PRICE / nj * total
