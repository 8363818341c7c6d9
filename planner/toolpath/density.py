"""Where to sample a curve: as densely as its waypoints stand, more densely at corners, smoothly in between."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from planner.readonly import Array

_SMOOTHING = 8.0  # mean steps over which the waypoints' own density is averaged
_REACH = 30.0  # widths around a corner up to which samples draw together
_NEWTON_STEPS = 4


@dataclass(frozen=True)
class SampleDensity:
    """Samples per metre along a curve of chord length `length` [m].

    counted   (spline) how many waypoints' steps lie up to a chord length
    corners   chord lengths (k) around which samples draw together, spacing (k) there, and over what width (k)
    """

    length: float
    counted: Any
    corners: Array
    spacing: Array
    width: Array

    @classmethod
    def of_steps(cls, chord: Array, samples: Array) -> SampleDensity:
        """The density of waypoints at chord lengths (m), evened out; each step is worth so many samples (m - 1)."""
        cells = max(len(chord) - 1, 4)
        grid = np.linspace(0.0, chord[-1], cells + 1)
        steps = np.diff(np.interp(grid, chord, np.concatenate([[0.0], np.cumsum(samples)])))
        even = gaussian_filter1d(steps, _SMOOTHING, mode="nearest") / (chord[-1] / cells)
        middle = 0.5 * (grid[1:] + grid[:-1])
        x, y = np.concatenate([grid[:1], middle, grid[-1:]]), np.concatenate([even[:1], even, even[-1:]])
        none = np.zeros(0)
        return cls(float(chord[-1]), CubicSpline(x, y).antiderivative(), none, none, none)

    def denser(self, corners: Array, spacing: float, width: float) -> SampleDensity:
        """The same with samples `spacing` [m] apart at corners (chord lengths), over some `width` [m]."""
        k = np.ones(len(corners))
        return replace(
            self,
            corners=np.concatenate([self.corners, corners]),
            spacing=np.concatenate([self.spacing, k * spacing]),
            width=np.concatenate([self.width, k * width]),
        )

    def spacing_at(self, c: Array) -> Array:
        """Distance (k) between samples at chord lengths c (k) [m]."""
        return 1.0 / self._density(c)

    def samples(self, fewest: int) -> Array:
        """Chord lengths (n) of the samples, the two ends among them, n at least `fewest`."""
        rough = np.linspace(0.0, self.length, max(8, int(self.counted(self.length)) + 1))
        offsets = np.sinh(np.linspace(-4.0, 4.0, 65))
        around = (self.corners[:, None] + self.width[:, None] * offsets).ravel()
        rough = np.unique(np.clip(np.concatenate([rough, around]), 0.0, self.length))
        total = self._count(rough)
        n = max(round(float(total[-1])), fewest - 1)
        target = np.linspace(0.0, total[-1], n + 1)
        c = np.interp(target, total, rough)
        for _ in range(_NEWTON_STEPS):
            c = np.clip(c - (self._count(c) - target) / self._density(c), 0.0, self.length)
            c = np.maximum.accumulate(c)
        c[[0, -1]] = 0.0, self.length
        return c

    def _count(self, c: Array) -> Array:
        """Samples up to chord lengths c (n), which increase."""
        count = np.asarray(self.counted(c))
        bump = _bump().antiderivative()
        for corner, spacing, width in zip(self.corners, self.spacing, self.width, strict=True):
            first, last = np.searchsorted(c, [corner - _REACH * width, corner + _REACH * width])
            here = width / spacing
            start = float(bump(np.clip(-corner / width, -_REACH, 0.0)))  # counted from the curve's start
            count[first:last] += here * (bump((c[first:last] - corner) / width) - start)
            count[last:] += here * (bump(_REACH) - start)
        return count

    def _density(self, c: Array) -> Array:
        density = np.asarray(self.counted(c, 1))
        bump = _bump()
        for corner, spacing, width in zip(self.corners, self.spacing, self.width, strict=True):
            near = slice(*np.searchsorted(c, [corner - _REACH * width, corner + _REACH * width]))
            density[near] += bump((c[near] - corner) / width) / spacing
        return density


@cache
def _bump() -> CubicSpline:
    """1 / (1 + x^2) on [-REACH, REACH], faded to 0 at both ends: neighbouring spacings grow by a fifth at most."""
    x = np.sinh(np.linspace(-1.0, 1.0, 1601) * np.arcsinh(_REACH))
    return CubicSpline(x, (1.0 - (x / _REACH) ** 2) ** 3 / (1.0 + x * x))
