"""Noise of recorded samples, estimated without knowing the motion, and smoothing that preserves curvature."""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from planner.base.arrays import MAD_TO_SIGMA, Array, Flags


def noise_of(samples: Array, among: Flags | None = None) -> Array:
    """Standard deviation (c) of single, evenly spaced samples (s, c).

    Estimated from third differences, which contain noise and hardly any motion; their median is robust against a few
    wrong samples. 0 for fewer than four in a row. among (s): the samples that count, all by default.
    """
    third = np.diff(samples, 3, axis=0)
    if among is not None and len(third):
        third = third[np.lib.stride_tricks.sliding_window_view(among, 4).all(axis=1)]
    if not len(third):
        return np.zeros(samples.shape[1])
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(third), axis=0) / np.sqrt(20.0))


def window_of(span: float, step: float) -> int:
    """The odd number of samples, a step [s] apart, closest to a span [s], and at least enough for a parabola."""
    return max(2 * int(0.5 * span / step) + 1, 5)


def smoothed(values: Array, window: int) -> Array:
    """Values (s) or (s, c) smoothed by parabolas over a window of samples (Savitzky and Golay)."""
    return np.asarray(savgol_filter(values, window, 2, axis=0))


def slope_of(values: Array, window: int, step: float) -> Array:
    """Derivative of values (s) a step [s] apart, from parabolas over a window of samples."""
    return np.asarray(savgol_filter(values, window, 2, deriv=1, delta=step))


def noise_left(window: int, slope: float = 0.0) -> float:
    """Standard deviation of noise after smoothing, relative to that before it.

    slope: sample interval [s], for the noise of the derivative instead
    """
    weights = savgol_coeffs(window, 2, deriv=1, delta=slope) if slope else savgol_coeffs(window, 2)
    return float(np.sqrt((weights**2).sum()))
