"""The paper's orders in which to visit the samples of a face, each once: greedy and weighted greedy choice.

Onstein et al., algorithms 3 and 4. Both may leave samples behind and come back for them across what is printed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.toolpath.coverage.sampled import Array, Ints, SampledSurface, along_surface

# What it costs to leave the row, in spacings: more than the next sample of the row is farther than the next row.
ROW_WEIGHT = 1.0


def greedy(surface: SampledSurface) -> Ints:
    """Go to the nearest sample that has not been visited (n,); of equally near ones, to the one with the lowest index."""
    return _nearest_first(surface, 0.0)


def weighted_greedy(surface: SampledSurface) -> Ints:
    """As greedy, but samples off the row cost ROW_WEIGHT spacings more (n,): from side to side, row by row."""
    return _nearest_first(surface, ROW_WEIGHT * max(surface.spacing))


def _nearest_first(surface: SampledSurface, weight: float) -> Ints:
    """Start at the first sample; always go where distance plus weight is least."""
    links = surface.links()
    n = len(surface.points)
    order = np.zeros(n, dtype=np.int64)
    left = np.ones(n, dtype=np.bool_)
    left[0] = False
    for k in range(1, n):
        here = int(order[k - 1])
        span = slice(links.indptr[here], links.indptr[here + 1])
        near: NDArray[np.int64] = np.sort(links.indices[span][left[links.indices[span]]]).astype(np.int64)
        if near.size:
            way: Array = np.linalg.norm(surface.points[near] - surface.points[here], axis=1)
        else:
            near = np.flatnonzero(left)
            way = along_surface(surface, links, order[k - 1 : k])[0, near]
        # rounded, so that equally near ones are equal whatever the last digit says
        price = np.round((way + weight * (surface.row[near] != surface.row[here])) / max(surface.spacing), 9)
        order[k] = near[np.argmin(price)]
        left[order[k]] = False
    return order
