"""Fewest targets that still say it all: split spans of samples until interpolation meets every sample between."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
# (first, last, k) → how far interpolation between samples first and last misses sample k, in tolerances
Misfit = Callable[[Indices, Indices, Indices], Array]
MOST_PARTS = 4


def thin(kept: Indices, misfit: Misfit) -> Indices:
    """Sorted sample indices: `kept` (sorted, unique, never dropped) and what must be added to bring misfit to <= 1.

    All spans are judged at once, level by level. A span that misses by e tolerances is cut into about sqrt(e)
    equal parts, because on an arc the error falls with the square of the chord: this gives few targets in few passes.
    """
    found = [kept]
    first, last = kept[:-1], kept[1:]
    while True:
        inner = last - first - 1
        first, last, inner = first[inner > 0], last[inner > 0], inner[inner > 0]
        if not len(first):
            return np.unique(np.concatenate(found))
        offset = np.concatenate([[0], np.cumsum(inner)[:-1]])
        k = np.arange(int(inner.sum())) - np.repeat(offset - first - 1, inner)
        worst = np.maximum.reduceat(misfit(np.repeat(first, inner), np.repeat(last, inner), k), offset)
        bad = ~(worst <= 1.0)
        first, last = first[bad], last[bad]
        parts = np.clip(np.ceil(np.sqrt(worst[bad])), 2, np.minimum(MOST_PARTS, last - first)).astype(np.intp)
        owner = np.repeat(np.arange(len(first)), parts)
        part = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
        length = (last - first)[owner]
        first, last = (
            first[owner] + length * part // parts[owner],
            first[owner] + length * (part + 1) // parts[owner],
        )
        found.append(first)
