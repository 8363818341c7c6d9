"""Fewer points for display, with every extreme kept: a stride would hide exactly the dips that matter.

Budgets (points): a curve over time gets CURVE_BUDGET, all beads of a 3-D scene together SCENE_BUDGET. With
plotly.js (4.8 MB) that keeps the report below 8 MB for any number of samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices

CURVE_BUDGET = 4_000
SCENE_BUDGET = 40_000


def runs(mask: NDArray[np.bool_], label: NDArray[np.integer] | None = None) -> tuple[Indices, Indices]:
    """First and last index (both inclusive) of each stretch of samples with `mask` set and one `label`."""
    n = len(mask)
    change = np.diff(mask.astype(np.int8)) != 0
    if label is not None:
        change |= np.diff(label) != 0
    first = np.concatenate([[0], np.flatnonzero(change) + 1]) if n else np.empty(0, dtype=np.intp)
    last = np.concatenate([first[1:] - 1, [n - 1]]) if n else first
    keep = mask[first]
    return first[keep], last[keep]


def stretches(mask: NDArray[np.bool_], label: NDArray[np.integer] | None = None) -> tuple[Indices, Indices, Indices]:
    """Samples with `mask` set, and where among *these* each run (see `runs`) begins and ends, inclusive."""
    first, last = runs(mask, label)
    end = np.cumsum(last - first + 1) - 1
    return np.flatnonzero(mask), end - (last - first), end


def keep_minima(signals: Sequence[Array], budget: int, always: Indices) -> Indices:
    """Indices (sorted, unique) of at most `budget` samples, or of `always` alone if there are more of these.

    signals  each (n,): the sample where it is smallest in a bucket of neighbours is kept. Pass -y to keep maxima.
             NaN never counts as smallest unless a bucket holds nothing else.
    always   samples that are kept in any case (ends of lines)
    Buckets cover all samples, so every signal's global minimum is kept exactly.
    """
    n = len(signals[0])
    if n <= budget:
        return np.arange(n)
    buckets = (budget - len(always)) // len(signals)
    if buckets < 1:
        return np.unique(always)
    size = -(-n // buckets)
    rows = -(-n // size)
    start = np.arange(rows) * size
    kept = [np.asarray(always, dtype=np.intp)]
    for signal in signals:
        padded = np.full(rows * size, np.inf)
        padded[:n] = np.where(np.isnan(signal), np.inf, signal)
        kept.append(start + padded.reshape(rows, size).argmin(axis=1))
    return np.unique(np.concatenate(kept))


def thin_curve(y: Array, budget: int = CURVE_BUDGET, always: Indices | None = None) -> Indices:
    """Indices of at most `budget` samples of a curve y (n,) that keep its ends and both extremes per bucket."""
    ends = np.array([0, len(y) - 1], dtype=np.intp) if len(y) else np.empty(0, dtype=np.intp)
    return keep_minima([y, -y], budget, ends if always is None else np.union1d(ends, always))


def turning(points: Array, first: Indices, last: Indices) -> Array:
    """How sharply the line turns at each of points (n, 3), as 1 - cos of the angle; 0 at the ends of runs."""
    out = np.zeros(len(points))
    if len(points) < 3:
        return out
    d = np.diff(points, axis=0)
    length = np.linalg.norm(d, axis=1)
    dot = np.einsum("ij,ij->i", d[:-1], d[1:])
    scale = length[:-1] * length[1:]
    out[1:-1] = np.where(scale > 0, 1.0 - dot / np.where(scale > 0, scale, 1.0), 0.0)
    out[first] = 0.0
    out[last] = 0.0
    return out


def with_gaps(values: Array, breaks: Indices) -> Array:
    """Insert a NaN before each of the positions `breaks`, so that lines end there; float32 is plenty for a screen."""
    return np.insert(np.asarray(values, dtype=np.float32), breaks, np.nan)
