"""Noise of recorded samples, told without knowing the motion, and smoothing that keeps what is bent."""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from planner.base.arrays import MAD_TO_SIGMA, Array, Flags


def noise_of(samples: Array, among: Flags | None = None) -> Array:
    """Standard deviation (c) of single samples (s, c), evenly spaced: of their third differences, which hold noise and hardly
    any motion, by the median, which few wrong samples do not change. 0 of fewer than four in a row; among (s): those that
    count, all where nothing is said."""
    third = np.diff(samples, 3, axis=0)
    if among is not None and len(third):
        third = third[np.lib.stride_tricks.sliding_window_view(among, 4).all(axis=1)]
    if not len(third):
        return np.zeros(samples.shape[1])
    return np.asarray(MAD_TO_SIGMA * np.median(np.abs(third), axis=0) / np.sqrt(20.0))


def window_of(span: float, step: float) -> int:
    """An odd number of samples, a step [s] apart, near a span [s]: enough for a parabola."""
    return max(2 * int(0.5 * span / step) + 1, 5)


def smoothed(values: Array, window: int) -> Array:
    """Values (s) or (s, c) smoothed by parabolas over a window of samples (Savitzky and Golay)."""
    return np.asarray(savgol_filter(values, window, 2, axis=0))


def slope_of(values: Array, window: int, step: float) -> Array:
    """Derivative of values (s) that are a step [s] apart, of parabolas over a window of samples."""
    return np.asarray(savgol_filter(values, window, 2, deriv=1, delta=step))


def noise_left(window: int, slope: float = 0.0) -> float:
    """What smoothing leaves of the standard deviation of noise; slope: of the derivative, by samples that are so far apart [s]."""
    weights = savgol_coeffs(window, 2, deriv=1, delta=slope) if slope else savgol_coeffs(window, 2)
    return float(np.sqrt((weights**2).sum()))
