"""Lines of the plane: places along them, and how far points are from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.base.arrays import Array
from planner.verify.reread.places import APART

_PIECE = 16  # chords of a line in the tree of lines


def dots_of_lines(lines: Sequence[Array]) -> tuple[Array, Array]:
    """Places (n, 2) along lines, and the length (n) [m] that each stands for."""
    dots, weight = [], []
    for line in lines:
        step = np.hypot(*np.diff(line, axis=0).T)
        s = np.concatenate([[0.0], np.cumsum(step)])
        count = max(2, int(np.ceil(s[-1] / APART)))
        at = (np.arange(count) + 0.5) * s[-1] / count
        dots.append(np.column_stack([np.interp(at, s, line[:, k]) for k in (0, 1)]))
        weight.append(np.full(count, s[-1] / count))
    return np.concatenate(dots), np.concatenate(weight)


def distances_from_lines(lines: Sequence[Array], points: Array) -> Array:
    """Distances (n) of points (n, 2) from the nearest of some lines."""
    import shapely

    pieces = [line[i : i + _PIECE + 1] for line in lines for i in range(0, len(line) - 1, _PIECE)]
    if not pieces:
        return np.full(len(points), np.inf)
    indices = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    tree = shapely.STRtree(shapely.linestrings(np.concatenate(pieces), indices=indices))
    (asked, _), away = tree.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    out = np.full(len(points), np.inf)
    out[asked] = away
    return out
