"""Where along a task its rungs and knots stand: evenly in its samples, denser where the layer's normal turns."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from planner.readonly import Array
from planner.task import NozzleTask

NARROW = np.radians(30.0)  # cone of the layer to gravity below which the table has to follow the normal
_TURN_SHARE = 0.5  # of that cone: how far the normal may turn from one place to the next
_FEWEST = 4  # samples from one place to the next where the normal turns
_CALM = 8  # samples to both sides over which the places draw together
_SHARP = 3e-3  # m: radius of a bend round which knots stand twice as dense; wider bends have less of that
_BESIDE = 2e-3  # m before and behind a bend that knots stand as dense: joints that hurry round it start early


def places_along(task: NozzleTask, spacing: float, fewest: int) -> Array:
    """Places (m) along a task, in shares of its samples, from 0 to 1: `spacing` [m] apart, on the average.

    They are `fewest` samples apart at least. Where the layer must stay nearly upright and its normal turns quickly, what
    follows the normal needs more of them.
    """
    return _placed(task, spacing, fewest, np.ones(len(task) - 1))


def knots_along(task: NozzleTask, spacing: float, fewest: int) -> Array:
    """The same, up to twice as dense where the path bends: there joints have to hurry, and need to be free to do so.

    Not where the table has to follow the normal: round bends the table has no freedom left, and more knots only get in
    each other's way (the part of Chen et al. is printed at speed on less of its length with them).
    """
    if task.cones.layer_gravity < NARROW:
        return places_along(task, spacing, fewest)
    steps = np.linalg.norm(np.diff(task.tip, axis=0), axis=1)
    ahead = np.diff(task.tip, axis=0) / np.maximum(steps, 1e-12)[:, None]
    bend = np.append(0.0, _angles(ahead)) / np.maximum(steps, 1e-6)
    beside = 2 * max(int(_BESIDE / np.median(steps)), 1) + 1
    crowd = 1.0 + np.minimum(_SHARP * maximum_filter1d(bend, beside, mode="nearest"), 1.0)
    return _placed(task, spacing, fewest, uniform_filter1d(crowd, 2 * _CALM + 1, mode="nearest"))


def _placed(task: NozzleTask, spacing: float, fewest: int, crowd: Array) -> Array:
    """Places that crowd as many times as dense (n - 1) between samples."""
    n = len(task)
    m = max(min(int(np.ceil((task.s[-1] - task.s[0]) / spacing)), (n - 1) // fewest), 1)
    density = np.minimum(m / (n - 1) * crowd, max(1.0 / fewest, m / (n - 1)))
    if task.cones.layer_gravity < NARROW:
        needed = np.minimum(_angles(task.frames[:, :, 2]) / (_TURN_SHARE * task.cones.layer_gravity), 1.0 / _FEWEST)
        width = 2 * _CALM + 1
        density = maximum_filter1d(np.maximum(needed, density), width, mode="nearest")
        density = uniform_filter1d(density, width, mode="nearest")
    count = np.concatenate([[0.0], np.cumsum(density)])
    m = max(int(np.ceil(count[-1] - 1e-6)), m)
    return np.interp(np.linspace(0.0, count[-1], m + 1), count, np.linspace(0.0, 1.0, n))


def _angles(ways: Array) -> Array:
    """Angles (n - 1) between unit vectors (n, 3) and the next."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(np.diff(ways, axis=0), axis=1), 1.0)))


def breaks_of(places: Array, count: int) -> Array:
    """`count` points from 0 to 1, as evenly spread among places (m) as they are among themselves."""
    return np.interp(np.linspace(0.0, len(places) - 1.0, count), np.arange(len(places)), places)
