"""A polyline averaged along itself, so that it turns as a tool can."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import convolve1d

from planner.toolpath.coverage.patches import Array

_POWER = 4  # of the kernel (1 - x^2)^4: four times differentiable


def evenly(line: Array, step: float, closed: bool) -> Array:
    """Points (m, 3) of a polyline (n, 3), about `step` apart; a closed one does not repeat its first point."""
    if closed:
        line = np.vstack([line, line[:1]])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = max(round(s[-1] / step), 2)
    at = np.linspace(0.0, s[-1], count + 1)[: count + (not closed)]
    return np.stack([np.interp(at, s, line[:, i]) for i in range(line.shape[1])], axis=1)


def smooth(line: Array, half_width: float, step: float, closed: bool) -> Array:
    """A polyline (n, 3) averaged over `half_width` to both sides, points about `step` apart; open ends stay."""
    even = evenly(line, step, closed)
    reach = min(max(round(half_width / step), 1), len(even) - 1)
    x = np.arange(-reach, reach + 1) / (reach + 1.0)
    kernel = (1.0 - x**2) ** _POWER
    kernel /= kernel.sum()
    if closed:
        return convolve1d(even, kernel, axis=0, mode="wrap")
    # the line goes on beyond its ends as its own mirror image in the end point
    before = 2.0 * even[0] - even[reach:0:-1]
    after = 2.0 * even[-1] - even[-2 : -2 - reach : -1]
    return convolve1d(np.vstack([before, even, after]), kernel, axis=0)[reach : reach + len(even)]
