"""A joint path by arc length: its derivatives, which at a constant speed are the joints' rates.

At speed v along the path a joint moves at q' v, accelerates at q'' v^2 and jerks at q''' v^3, with derivatives by arc
length: a limit of the joint is a limit on a derivative of the path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from planner.readonly import Array
from planner.resolve.jointpath import JointPath

ORDERS = np.array([1, 2, 3])
_STILL = 1e-6  # of a sample's mean length: where less is moved from sample to sample, a path has no direction


@dataclass(frozen=True)
class ByArcLength:
    """Derivatives (k, nj, 3) of a joint path by arc length at places s (k) [m]: q', q'', q''' in rad and m."""

    s: Array
    rates: Array


def spline_of(path: JointPath) -> BSpline:
    """Joints and arc length (nj + 1) by the number of the sample, with four continuous derivatives."""
    n = len(path.task)
    return make_interp_spline(np.arange(n, dtype=float), np.column_stack([path.q, path.task.s]), k=min(5, n - 1))


def by_arc_length(path: JointPath, spline: BSpline, low: float, high: float, per_sample: int) -> ByArcLength:
    """Derivatives between two arc lengths of the task [m], at so many places a sample of it.

    A place where samples coincide has no direction and is left out.
    """
    s = path.task.s
    k = np.interp([low, high], s, np.arange(len(s), dtype=float))
    u = np.linspace(k[0], k[1], max(int(np.ceil(per_sample * (k[1] - k[0]))), 1) + 1)
    first, second, third = (np.asarray(spline(u, order)) for order in ORDERS)
    moving = first[:, -1] > _STILL * (s[-1] - s[0]) / len(s)
    u, first, second, third = u[moving], first[moving], second[moving], third[moving]
    s1, s2, s3 = (each[:, -1:] for each in (first, second, third))
    by_s = first[:, :-1] / s1
    by_ss = (second[:, :-1] - by_s * s2) / s1**2
    by_sss = (third[:, :-1] - 3.0 * by_ss * s1 * s2 - by_s * s3) / s1**3
    return ByArcLength(np.asarray(spline(u))[:, -1], np.stack([by_s, by_ss, by_sss], axis=-1))
