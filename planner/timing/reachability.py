"""The fastest profile without jerk limits: what timing is measured against.

Time-optimal path parameterisation by reachability analysis, after Pham and Pham, "A new approach to time-optimal
path parameterization based on reachability analysis", IEEE T-RO 2018 (TOPP-RA). With x the squared rate of the
path parameter u and a its acceleration, joint limits are linear in (a, x):

    |q' a + q'' x| <= a_max,   |q'| sqrt(x) <= v_max,   s' sqrt(x) <= commanded speed

and each interval has constant a. The limits are imposed with the geometry of both ends of every interval. Rest
(a = x = 0) always satisfies them, so the controllable sets are never empty, however the path is shaped.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.cell import Cell
from planner.readonly import Array
from planner.resolve.jointpath import JointPath
from planner.timing.timed_path import legs_of

REFINE = 4  # grid intervals for each interval of the task's samples
_HALVINGS = 44  # of the interval in which a largest feasible x is sought: to 1e-13 of it


def bound_time(cell: Cell, path: JointPath) -> float:
    """Time [s] that deposition takes at least, from rest to rest and to the task's stops, without limits on jerk.

    No headroom is kept below the limits. Rests at stops are not counted.
    """
    task, total = path.task, 0.0
    curve, legs = legs_of(path, (False, False))
    v = np.append(cell.limits.velocity, task.speed)
    for leg in legs:
        intervals = max(int(np.ceil(REFINE * (leg.last - leg.first) / leg.spacing)), REFINE)
        grid = np.linspace(leg.first, leg.last, intervals + 1)
        first, second = curve.derivatives(grid, 2)
        with np.errstate(divide="ignore", over="ignore"):
            ceiling = (v / np.abs(first)).min(axis=1) ** 2
        slopes = np.ascontiguousarray(first[:, :-1])
        x = fastest_profile(
            slopes, np.ascontiguousarray(second[:, :-1]), ceiling, cell.limits.acceleration, float(grid[1] - grid[0])
        )
        rate = np.sqrt(x)
        times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(grid) / (rate[1:] + rate[:-1]))])
        s = curve(grid)[:, -1]
        start, end = np.interp([0.0, task.s[task.last]], s, times)
        total += float(end - start)
    return total


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
