"""Curve: a spline as polynomials between its knots, so that all its derivatives cost little at many places: compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from planner.readonly import Array, ReadOnlyArrays


@dataclass(frozen=True)
class Curve(ReadOnlyArrays):
    """Values of k columns over a parameter from the first of its breaks to the last.

    breaks (n + 1), growing; coefficients (n, degree + 1, k) of the powers of what the parameter has grown by since the
    piece began, the highest first
    """

    breaks: Array
    coefficients: Array

    def __call__(self, u: Array) -> Array:
        """Values (m, k) at places u (m); outside the breaks those of the nearest piece, continued."""
        return derivatives_at(self.breaks, self.coefficients, u, 0)[0]

    def derivatives(self, u: Array, orders: int) -> Array:
        """Derivatives (orders, m, k) of order 1 to `orders` at places u (m)."""
        return derivatives_at(self.breaks, self.coefficients, u, orders)[1:]

    def columns(self, which: slice) -> Curve:
        """Some of its columns."""
        return Curve(self.breaks, np.ascontiguousarray(self.coefficients[:, :, which]))


def curve_of(spline: BSpline) -> Curve:
    """The same as a spline of columns, between the ends of its knots."""
    t, k = spline.t, spline.k
    spans = k + np.flatnonzero(np.diff(t[k : len(t) - k]) > 0.0)
    coefficients = _polynomials(np.asarray(t), np.ascontiguousarray(spline.c), k, spans)
    return Curve(np.append(t[spans], t[spans[-1] + 1]), coefficients)


@njit(cache=True, nogil=True)
def _polynomials(t: Array, c: Array, degree: int, spans: NDArray[np.int64]) -> Array:
    """Coefficients (n, degree + 1, k) as in `Curve` between knots t[i] and t[i + 1], i of spans (n).

    The control values c (m, k) that are felt there are differenced once for each derivative, and each of these splines
    evaluated at t[i] by de Boor's algorithm.
    """
    columns = c.shape[1]
    out = np.empty((len(spans), degree + 1, columns))
    felt, now = np.empty((degree + 1, columns)), np.empty((degree + 1, columns))
    for at in range(len(spans)):
        i = spans[at]
        for j in range(degree + 1):
            for column in range(columns):
                felt[j, column] = c[i - degree + j, column]
        scale = 1.0  # of the derivative: one over the factorial of its order
        for order in range(degree + 1):
            left = degree - order  # degree of the derivative, of which felt[order :] are control values
            if order > 0:
                scale /= order
                for j in range(degree, order - 1, -1):
                    low = i - degree + j
                    factor = (left + 1) / (t[low + left + 1] - t[low])
                    for column in range(columns):
                        felt[j, column] = factor * (felt[j, column] - felt[j - 1, column])
            for j in range(order, degree + 1):
                for column in range(columns):
                    now[j, column] = felt[j, column]
            for level in range(1, left + 1):
                for j in range(degree, order + level - 1, -1):
                    low = i - degree + j
                    share = (t[i] - t[low]) / (t[low + left + 1 - level] - t[low])
                    for column in range(columns):
                        now[j, column] = (1.0 - share) * now[j - 1, column] + share * now[j, column]
            for column in range(columns):
                out[at, left, column] = scale * now[degree, column]
    return out


@njit(cache=True, nogil=True)
def derivatives_at(breaks: Array, coefficients: Array, u: Array, orders: int) -> Array:
    """Values and derivatives (1 + orders, m, k) at places u (m), of a curve as `Curve` has it; orders: at most 3.

    Places in order are found from each other.
    """
    n, powers, k = coefficients.shape
    out = np.zeros((1 + orders, len(u), k))
    i = 0 if len(u) == 0 else min(max(np.searchsorted(breaks, u[0], side="right") - 1, 0), n - 1)
    for at in range(len(u)):
        while i < n - 1 and u[at] >= breaks[i + 1]:
            i += 1
        while i > 0 and u[at] < breaks[i]:
            i -= 1
        since = u[at] - breaks[i]
        for power in range(powers):  # Horner's scheme, of the derivatives too
            for order in range(min(orders, power), 0, -1):
                for column in range(k):
                    out[order, at, column] = out[order, at, column] * since + order * out[order - 1, at, column]
            for column in range(k):
                out[0, at, column] = out[0, at, column] * since + coefficients[i, power, column]
    return out
