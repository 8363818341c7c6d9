"""Timing of deposition: the commanded speed wherever the joints allow it, and minimal dips where they do not.

Time-optimal path parameterisation by reachability analysis, after Pham and Pham, "A new approach to time-optimal
path parameterization based on reachability analysis", IEEE T-RO 2018 (TOPP-RA). With x the squared rate of the
path parameter u and a its acceleration, joint limits are linear in (a, x):

    |q' a + q'' x| <= a_max,   |q'| sqrt(x) <= v_max,   s' sqrt(x) <= commanded speed

and each interval has constant a. The limits are imposed with the geometry of both ends of every interval. Rest
(a = x = 0) always satisfies them, so the controllable sets are never empty, however the path is shaped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from planner.cell import Cell
from planner.resolve.jointpath import JointPath

Array = NDArray[np.float64]

HEADROOM = 0.98  # share of the joint limits that is used: the rest covers the path between grid points
REFINE = 4  # grid intervals for each interval of the task's samples
_HALVINGS = 44  # of the interval in which a largest feasible x is sought: to 1e-13 of it


@dataclass(frozen=True)
class TimedPath:
    """Joints and arc length of one bead with its runs, from rest to rest, sampled every dt from t = 0.

    q (m, nj), s (m) [m]; edges (m + 1) arc length half a sample before and after each sample; s_dot (m) speed of the
    tip between these [m/s]
    """

    path: JointPath
    q: Array
    s: Array
    s_dot: Array
    edges: Array


def time_path(cell: Cell, path: JointPath, dt: float) -> TimedPath:
    """Time one bead from rest to rest as fast as the limits and the commanded speed allow, and sample it."""
    task = path.task
    n = len(task)
    # The path parameter is time at the commanded speed, so that its rate is 1 where that speed is held.
    knots = np.linspace(0.0, (task.s[-1] - task.s[0]) / task.speed, n)
    spline = make_interp_spline(knots, np.column_stack([path.q, task.s]), k=min(5, n - 1))
    grid = np.linspace(0.0, knots[-1], REFINE * (n - 1) + 1)
    first = spline(grid, 1)
    second = np.ascontiguousarray(spline(grid, 2)[:, :-1])
    v = np.append(HEADROOM * cell.limits.velocity, task.speed)
    with np.errstate(divide="ignore"):
        ceiling = (v / np.abs(first)).min(axis=1) ** 2
    slopes = np.ascontiguousarray(first[:, :-1])
    x = fastest_profile(slopes, second, ceiling, HEADROOM * cell.limits.acceleration, float(grid[1]))
    return _sample(path, spline, grid, np.sqrt(x), dt)


@njit(cache=True)
def _accelerations(
    x: float, i: int, low: float, high: float, slopes: Array, bends: Array, a_max: Array, step: float
) -> tuple[float, float]:
    """Interval of accelerations that the limits at both ends of interval i allow, starting with squared rate x.

    The squared rate reached, x + 2 step a, lies in [low, high]. Empty if the first value exceeds the second.
    """
    least, most = (low - x) / (2.0 * step), (high - x) / (2.0 * step)
    for end in range(2):
        for j in range(slopes.shape[1]):
            # at the far end x has become x + 2 step a
            k = slopes[i + end, j] + (2.0 * step * bends[i + 1, j] if end == 1 else 0.0)
            base = bends[i + end, j] * x
            if abs(k) < 1e-12 * a_max[j]:
                if abs(base) > a_max[j]:
                    return 1.0, 0.0
                continue
            p, q = (-a_max[j] - base) / k, (a_max[j] - base) / k
            least, most = max(least, min(p, q)), min(most, max(p, q))
    return least, most


@njit(cache=True)
def fastest_profile(slopes: Array, bends: Array, ceiling: Array, a_max: Array, step: float) -> Array:
    """Largest squared rates x (n) on a uniform grid, 0 at both ends.

    slopes, bends (n, nj): q' and q''; ceiling (n): largest x that speed limits allow; a_max (nj).
    """
    n = len(ceiling)
    reachable = np.zeros(n)  # the largest x from which the end can be reached
    for i in range(n - 2, -1, -1):
        low, high = 0.0, min(ceiling[i], 1e6)
        least, most = _accelerations(high, i, 0.0, reachable[i + 1], slopes, bends, a_max, step)
        if least <= most:
            reachable[i] = high
            continue
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            least, most = _accelerations(middle, i, 0.0, reachable[i + 1], slopes, bends, a_max, step)
            if least <= most:
                low = middle
            else:
                high = middle
        reachable[i] = low
    x = np.zeros(n)
    for i in range(n - 1):
        _, most = _accelerations(x[i], i, 0.0, reachable[i + 1], slopes, bends, a_max, step)
        x[i + 1] = min(max(x[i] + 2.0 * step * most, 0.0), reachable[i + 1])
    x[n - 1] = 0.0
    return x


def _sample(path: JointPath, spline: BSpline, grid: Array, rate: Array, dt: float) -> TimedPath:
    """Sample a parameterisation with constant acceleration of u between grid points."""
    du = np.diff(grid)
    time = np.concatenate([[0.0], np.cumsum(2.0 * du / (rate[1:] + rate[:-1]))])
    acceleration = (rate[1:] ** 2 - rate[:-1] ** 2) / (2.0 * du)
    m = int(np.ceil(time[-1] / dt - 1e-9)) + 1
    half = np.clip((np.arange(2 * m + 1) - 1) * (0.5 * dt), 0.0, time[-1])  # samples, and the instants between
    k = np.clip(np.searchsorted(time, half, side="right") - 1, 0, len(du) - 1)
    tau = half - time[k]
    u = np.clip(grid[k] + tau * (rate[k] + 0.5 * acceleration[k] * tau), 0.0, grid[-1])
    values = np.asarray(spline(u))
    edges = values[0::2, -1]
    return TimedPath(path, values[1::2, :-1], values[1::2, -1], np.diff(edges) / dt, edges)
