"""Splines over a task's samples: placement of knots, bases, and time derivatives at the commanded speed."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from planner.base.arrays import Array, Ints
from planner.base.compiled import njit
from planner.toolpath.task import NozzleTask

# ----------------------------------------------------------------------------------------------------
# Where along a task its rungs and knots are: evenly over its samples, denser where the layer's normal turns.

NARROW = np.radians(30.0)  # cone of the layer to gravity below which the table has to follow the normal
_TURN_SHARE = 0.5  # share of that cone by which the normal may turn from one place to the next
FEWEST_TURNING = 4  # samples from one place to the next, at least, where the normal turns
_CALM = 8  # samples to each side over which the density of places is smoothed
_SHARP = 3e-3  # m: knots are twice as dense in bends of this radius or less, and less so in wider ones
_BESIDE = 2e-3  # m before and after a bend over which knots are as dense: joints that hurry around it start early


def places_along(
    task: NozzleTask, spacing: float, fewest: int, turn: float = np.inf, turning: int = FEWEST_TURNING
) -> Array:
    """Places (m) along a task, as fractions of its samples from 0 to 1, on average `spacing` [m] apart.

    They are at least `fewest` samples apart. Where the normal turns quickly, they are denser: from one to the next it
    turns by at most `turn` [rad], and by less where the layer must stay nearly upright, as far as places `turning`
    samples apart allow.
    """
    return _placed(task, spacing, fewest, np.ones(len(task) - 1), turn, turning)


def knots_along(task: NozzleTask, spacing: float, fewest: int) -> Array:
    """As `places_along`, up to twice as dense where the path bends: joints have to hurry there and need the freedom.

    Not where the table has to follow the normal: around bends the table has no freedom left, and more knots only get in
    each other's way (with them, less of the part of Chen et al. is printed at speed).
    """
    if task.cones.layer_gravity < NARROW:
        return places_along(task, spacing, fewest)
    steps = np.linalg.norm(np.diff(task.tip, axis=0), axis=1)
    ahead = np.diff(task.tip, axis=0) / np.maximum(steps, 1e-12)[:, None]
    bend = np.append(0.0, _angles(ahead)) / np.maximum(steps, 1e-6)
    beside = 2 * max(int(_BESIDE / np.median(steps)), 1) + 1
    crowd = 1.0 + np.minimum(_SHARP * maximum_filter1d(bend, beside, mode="nearest"), 1.0)
    return _placed(task, spacing, fewest, uniform_filter1d(crowd, 2 * _CALM + 1, mode="nearest"))


def _placed(
    task: NozzleTask, spacing: float, fewest: int, crowd: Array, turn: float = np.inf, turning: int = FEWEST_TURNING
) -> Array:
    """Places whose density is multiplied by `crowd` (n - 1) between samples."""
    n = len(task)
    m = max(min(int(np.ceil((task.s[-1] - task.s[0]) / spacing)), (n - 1) // fewest), 1)
    density = np.minimum(m / (n - 1) * crowd, max(1.0 / fewest, m / (n - 1)))
    if task.cones.layer_gravity < NARROW:
        turn = min(turn, _TURN_SHARE * task.cones.layer_gravity)
    if turn < np.inf:
        needed = np.minimum(_angles(task.frames[:, :, 2]) / turn, 1.0 / turning)
        width = 2 * _CALM + 1
        density = maximum_filter1d(np.maximum(needed, density), width, mode="nearest")
        density = uniform_filter1d(density, width, mode="nearest")
    count = np.concatenate([[0.0], np.cumsum(density)])
    m = max(int(np.ceil(count[-1] - 1e-6)), m)
    return np.interp(np.linspace(0.0, count[-1], m + 1), count, np.linspace(0.0, 1.0, n))


def _angles(ways: Array) -> Array:
    """Angles (n - 1) between consecutive unit vectors (n, 3)."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(np.diff(ways, axis=0), axis=1), 1.0)))


def breaks_of(places: Array, count: int) -> Array:
    """`count` points from 0 to 1, distributed as the places (m) are."""
    return np.interp(np.linspace(0.0, len(places) - 1.0, count), np.arange(len(places)), places)


# ----------------------------------------------------------------------------------------------------
# Splines over a task's samples, and derivatives in time at the commanded speed.
#
# Samples are a smooth function of their index, so derivatives by the index (five-point finite differences) become
# time derivatives by the chain rule.

DEGREE = 5  # four continuous derivatives: jerk has no steps
LEAST_SAMPLES = 5  # samples that a stencil needs
_OFFSETS = np.arange(-2.0, 3.0)


def _stencils() -> Array:
    """Weights (5, 3, 5) of five neighbouring values for derivatives 1, 2 and 3 at each of the five."""
    powers = np.arange(5)
    out = np.empty((5, 3, 5))
    for place, x in enumerate(_OFFSETS):
        V = (_OFFSETS - x)[None, :] ** powers[:, None] / np.array([factorial(p) for p in powers])[:, None]
        out[place] = np.linalg.inv(V).T[1:4]
    return out


@dataclass(frozen=True)
class Clock:
    """Time at the commanded speed along n samples.

    step (n)         time that a sample stands for [s]
    rate (n, 3)      first three derivatives of time by the sample's index
    centre (n)       middle of each sample's five-point stencil
    D (n, 3, 5)      weights of five neighbours that give the first three time derivatives
    """

    step: Array
    rate: Array
    centre: Ints
    D: Array

    def rates(self, values: Array) -> Array:
        """First three time derivatives (n, 3, k) of values (n, k)."""
        return np.einsum("nos,nsk->nok", self.D, values[self.centre[:, None] + np.arange(-2, 3)])


def clock_of(t: Array) -> Clock:
    """The clock of samples at times t (n) [s], at least five of them."""
    n = len(t)
    centre = np.clip(np.arange(n), 2, n - 3)
    weights = _stencils()[np.arange(n) - centre + 2]
    rate = np.einsum("nos,ns->no", weights, t[centre[:, None] + np.arange(-2, 3)])
    return Clock(np.gradient(t), rate, centre, _by_time(weights, rate))


def _by_time(by_index: Array, rate: Array) -> Array:
    """Turn derivatives 1, 2, 3 by the index (n, 3, k) into time derivatives; rate (n, 3) as in Clock."""
    t1, t2, t3 = (rate[:, k, None] for k in range(3))
    first = by_index[:, 0] / t1
    second = (by_index[:, 1] - first * t2) / t1**2
    third = (by_index[:, 2] - 3.0 * second * t1 * t2 - first * t3) / t1**3
    return np.stack([first, second, third], axis=1)


@dataclass(frozen=True)
class Basis:
    """B-splines on clamped knots over n samples, with m control values.

    first (n)              control value of the first of a sample's degree + 1 B-splines
    B (n, 4, degree + 1)   their values and their first three time derivatives
    """

    first: Ints
    B: Array
    controls: int

    def values(self, c: Array) -> Array:
        """The spline (n, k) with control values c (m, k)."""
        return spline_values(self.first, self.B, c)


@njit
def spline_values(first: Ints, B: Array, c: Array) -> Array:
    """The spline (n, k) with control values c (m, k); first (n) and B (n, 4, degree + 1) as in Basis."""
    n, k = len(first), c.shape[1]
    out = np.zeros((n, k))
    for i in range(n):
        for b in range(B.shape[2]):
            for j in range(k):
                out[i, j] += B[i, 0, b] * c[first[i] + b, j]
    return out


def basis_over(clock: Clock, places: Array) -> Basis:
    """B-splines over a clock's samples; the degree is 5, or one less than the number of control values.

    places (m): roughly where each control value is, as a fraction of the samples from 0 to 1.
    """
    n, controls = len(clock.step), len(places)
    degree = min(DEGREE, controls - 1)
    knots = np.concatenate([np.zeros(degree), breaks_of(places, controls - degree + 1), np.ones(degree)])
    first, B = _basis(np.linspace(0.0, 1.0, n), knots, degree)
    by_index = B[:, 1:] * (1.0 / (n - 1)) ** np.arange(1, 4)[:, None]
    return Basis(first, np.concatenate([B[:, :1], _by_time(by_index, clock.rate)], axis=1), controls)


@njit
def _basis(u: Array, knots: Array, degree: int) -> tuple[Ints, Array]:
    """First nonzero B-spline (n) at each u (n), and values and three derivatives (n, 4, degree + 1) of all of them.

    The recursion of Cox and de Boor up to degree - k, then k differentiation steps.
    """
    n = u.size
    m = knots.size - degree - 1
    first = np.empty(n, dtype=np.int64)
    B = np.zeros((n, 4, degree + 1))
    N = np.empty(degree + 2)
    span = degree
    for i in range(n):
        while span < m - 1 and u[i] >= knots[span + 1]:
            span += 1
        first[i] = span - degree
        for k in range(min(4, degree + 1)):
            # N[r] belongs to the B-spline span - d + r of degree d
            N[:] = 0.0
            N[0] = 1.0
            for d in range(1, degree + 1):
                low = 0.0
                for r in range(d):
                    right, left = knots[span + r + 1], knots[span + 1 - d + r]
                    share = N[r] / (right - left)
                    if d <= degree - k:
                        N[r] = low + (right - u[i]) * share
                        low = (u[i] - left) * share
                    else:
                        N[r] = low - d * share
                        low = d * share
                N[d] = low
            for r in range(degree + 1):
                B[i, k, r] = N[r]
    return first, B
