"""Where along a task its rungs and knots stand: evenly in its samples, denser where the layer's normal turns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from planner.task import NozzleTask

Array = NDArray[np.float64]

NARROW = np.radians(30.0)  # cone of the layer to gravity below which the table has to follow the normal
_TURN_SHARE = 0.5  # of that cone: how far the normal may turn from one place to the next
_FEWEST = 4  # samples from one place to the next where the normal turns
_CALM = 8  # samples to both sides over which the places draw together


def places_along(task: NozzleTask, spacing: float, fewest: int) -> Array:
    """Places (m) along a task, in shares of its samples, from 0 to 1: `spacing` [m] apart, on the average.

    They are `fewest` samples apart at least. Where the layer must stay nearly upright and its normal turns quickly, what
    follows the normal needs more of them.
    """
    n = len(task)
    m = max(min(int(np.ceil((task.s[-1] - task.s[0]) / spacing)), (n - 1) // fewest), 1)
    if task.cones.layer_gravity >= NARROW:
        return np.linspace(0.0, 1.0, m + 1)
    even = m / (n - 1)
    needed = np.minimum(_turns(task) / (_TURN_SHARE * task.cones.layer_gravity), 1.0 / _FEWEST)
    width = 2 * _CALM + 1
    density = uniform_filter1d(maximum_filter1d(np.maximum(needed, even), width, mode="nearest"), width, mode="nearest")
    count = np.concatenate([[0.0], np.cumsum(density)])
    m = max(int(np.ceil(count[-1] - 1e-6)), m)
    return np.interp(np.linspace(0.0, count[-1], m + 1), count, np.linspace(0.0, 1.0, n))


def _turns(task: NozzleTask) -> Array:
    """Angles (n - 1) by which the normal turns from sample to sample."""
    z = task.frames[:, :, 2]
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(np.diff(z, axis=0), axis=1), 1.0)))


def breaks_of(places: Array, count: int) -> Array:
    """`count` points from 0 to 1, as evenly spread among places (m) as they are among themselves."""
    return np.interp(np.linspace(0.0, len(places) - 1.0, count), np.arange(len(places)), places)
