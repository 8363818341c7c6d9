"""Where along a path a recorded motion is: each sample's place, in order, however late and slow the robot is.

The place is the nearest one not far ahead of the last, unless advancing by about the robot's own motion leads to
another that is nearly as near: this distinguishes adjacent lines, and lines that run to and fro on each other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from planner.base.arrays import Array, Indices
from planner.base.compiled import njit
from planner.base.geometry import arc_lengths

AHEAD = 25e-3  # m of path searched for the next place: beyond corners that a controller cuts in travel
AHEAD_TIMES = 2.0  # × the robot's own motion, in addition
BACK = 0.3e-3  # m by which a place may lie before the last one, because of noise
# Weight of the squared difference between the advance along the path and the robot's own motion, compared with the
# squared distance from the path: 20 mm of path count as 1 mm of distance.
ASTRAY = 0.05**2


class TrackedPath(NamedTuple):
    """A path that a motion is compared with (n points, linearly interpolated): points (n, d) [m], the first three
    coordinates being the tip's and the others whatever else distinguishes places, and the arc length (n) up to each
    [m]."""

    points: Array
    way: Array


def tracked_path(points: Array) -> TrackedPath:
    """The path through points (n, d) [m]."""
    return TrackedPath(np.ascontiguousarray(points), arc_lengths(points))


def track(path: TrackedPath, samples: Array, gone: Array) -> tuple[Array, Array]:
    """Place (m) of each sample along a path, as a fractional index of its points, and its distance from there (m) [m].

    samples (m, d) like the path's points; gone (m): how far the robot moved since the previous sample [m], -inf where
    it is at the start of the path
    """
    place, off = _track(path.points, path.way, np.ascontiguousarray(samples), gone)
    return place, off


@njit
def _track(points: Array, way: Array, samples: Array, gone: Array) -> Any:
    m, n, d = len(samples), len(points), points.shape[1]
    place, off = np.zeros(m), np.zeros(m)
    at = 0.0  # arc length covered
    first = 0  # segment from which places are searched
    for i in range(m):
        rests = gone[i] < 0.0
        while first < n - 2 and way[first + 1] < at - BACK:
            first += 1
        best, found, where = np.inf, 0.0, at
        k = first
        while k < n - 1:
            if k > first and (rests or way[k] > at + AHEAD + AHEAD_TIMES * gone[i]):
                break
            dot, square = 0.0, 0.0
            for j in range(d):
                step = points[k + 1, j] - points[k, j]
                dot += step * (samples[i, j] - points[k, j])
                square += step * step
            u = 0.0
            if square > 0.0 and not rests:
                u = min(max(dot / square, (at - BACK - way[k]) / np.sqrt(square), 0.0), 1.0)
            distance = 0.0
            for j in range(d):
                gap = points[k, j] + u * (points[k + 1, j] - points[k, j]) - samples[i, j]
                distance += gap * gap
            there = way[k] + u * (way[k + 1] - way[k])
            price = distance
            if not rests:
                price += ASTRAY * (there - at - gone[i]) ** 2
            if price < best:
                best, found, where = price, k + u, there
                off[i] = np.sqrt(distance)
            k += 1
        place[i] = found
        at = max(at, where)
    return place, off


def beside(path: Array, tips: Array, segment: Indices, around: Array) -> Array:
    """Vectors from the nearest point of a path (n, 3) to each tip (m, 3) [m], within a distance (m) [m] along the path
    from its segment (m)."""
    return np.asarray(_beside(np.ascontiguousarray(path), np.ascontiguousarray(tips), segment.astype(np.int64), around))


@njit
def _beside(path: Array, tips: Array, segment: Array, around: Array) -> Any:
    out = np.zeros((len(tips), 3))
    last = len(path) - 2
    for i in range(len(tips)):
        least = np.inf
        for side in (-1, 1):
            gone, k = 0.0, segment[i] if side < 0 else segment[i] + 1
            while 0 <= k <= last and gone <= around[i]:
                dot, square = 0.0, 0.0
                for j in range(3):
                    step = path[k + 1, j] - path[k, j]
                    dot += step * (tips[i, j] - path[k, j])
                    square += step * step
                u = min(max(dot / square, 0.0), 1.0) if square > 0.0 else 0.0
                far = 0.0
                for j in range(3):
                    far += (tips[i, j] - path[k, j] - u * (path[k + 1, j] - path[k, j])) ** 2
                if far < least:
                    least = far
                    for j in range(3):
                        out[i, j] = tips[i, j] - path[k, j] - u * (path[k + 1, j] - path[k, j])
                gone += np.sqrt(square)
                k += side
    return out
