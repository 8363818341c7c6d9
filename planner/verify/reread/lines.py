"""Polylines in the plane: places along them, and distances of points from them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.verify.reread.places import APART, by_number

_PIECE = 16  # chords per entry of the tree of lines


def dots_of_lines(lines: Sequence[Array]) -> tuple[Array, Array]:
    """Places (n, 2) along lines, and the length (n) [m] that each represents."""
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
    """Distances (n) of points (n, 2) from the nearest line."""
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


def between_ends(lines: Sequence[Array], join: float, least: float) -> list[Array]:
    """Straight lines longer than `least` [m] between ends of lines (n, 2) linked by steps of up to `join` [m]."""
    ends = np.concatenate([line[[0, -1]] for line in lines])
    near = cKDTree(ends).query_pairs(join, output_type="ndarray")
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(ends), len(ends)))
    _, meeting = connected_components(links, directed=False)
    far = (own for _, own in by_number(meeting) if np.hypot(*np.ptp(ends[own], axis=0)) > least)
    pairs = [ends[list(pair)] for own in far for pair in combinations(own, 2)]
    return [pair for pair in pairs if np.hypot(*(pair[1] - pair[0])) > least]
