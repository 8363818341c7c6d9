"""Circular moves in the XY plane in G-code: where they replace lines, and how they are written and read."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array, Flags, Indices
from planner.base.geometry import arc_lengths
from planner.export.arcs import segments
from planner.export.axes.machine import Followed
from planner.export.primitives import LEAST_CHORD, LEAST_SWEPT, MOST_SWEPT

LEAST_LINES = 2  # that an arc replaces
MOST_LINES = 256  # likewise; bounds the work, not the print
STEADY = 0.5e-9  # [m, rad] between two samples of an axis at rest: rounding, which is finer than the numbers written
SAME_PLACE = 0.05e-6  # [m] between the ends of an arc: half of the last decimal written
RADII_APART = 0.5e-6  # [m] between an arc's radii at both ends; rounding gives at most 0.3 um


def centre_and_swept(begin: Array, via: Array, end: Array) -> tuple[Array, float]:
    """Centre (2) and angle, positive anticlockwise [rad], of the arc in XY through three points (2 or 3).

    The angle is 0 if the points are collinear.
    """
    three = np.zeros((3, 3))
    three[:, :2] = begin[:2], via[:2], end[:2]
    arc = segments(three[:1], three[1:2], three[2:], np.array([True]))
    sign = 1.0 if np.cross(arc.e1[0], arc.e2[0])[2] > 0.0 else -1.0
    return arc.centre[0, :2], sign * float(arc.swept[0])


def via_point(begin: Array, end: Array, centre: Array, clockwise: bool) -> Array | None:
    """The middle (2) of an arc in XY as given by G2 (clockwise) or G3; None if there is no such arc."""
    a, b = begin - centre, end - centre
    if abs(np.hypot(*a) - np.hypot(*b)) > RADII_APART or np.allclose(a, b, atol=SAME_PLACE):
        return None
    turn = np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b) % (2.0 * np.pi)
    half = 0.5 * (turn - 2.0 * np.pi if clockwise else turn)
    c, s = np.cos(half), np.sin(half)
    out: Array = centre + np.array([c * a[0] - s * a[1], s * a[0] + c * a[1]])
    return out


def with_arcs(
    motion: Followed, at: Indices, must: Indices, tolerance: tuple[float, float, float]
) -> tuple[Indices, Array]:
    """Fewer targets: those of lines `at` (sorted), without those that arcs make redundant; and the arcs' via points.

    must       targets that stay, sorted
    tolerance  chord [m], filament [m], time [s] by which an arc may miss a sample
    Returns samples (m) and via points (m, 3) X Y Z of the moves that end there, NaN for lines.
    """
    level = _level(motion)
    edges = np.searchsorted(at, must)
    kept, vias = [int(at[0])], [np.full(3, np.nan)]
    i = 0
    while i < len(at) - 1:
        end = int(edges[np.searchsorted(edges, i, side="right")])
        end = min(end, i + MOST_LINES, int(np.searchsorted(at, level[at[i]], side="right")) - 1)
        taken, via = _longest(motion, at, i, end, tolerance)
        kept.append(int(at[taken]))
        vias.append(via)
        i = taken
    return np.array(kept, dtype=np.intp), np.array(vias)


def _level(motion: Followed) -> Indices:
    """For each sample, the last one up to which only X, Y and filament move."""
    others = np.column_stack([motion.straight[:, 2:], motion.angles, motion.station])
    moves = np.flatnonzero((np.abs(np.diff(others, axis=0)) > STEADY).any(axis=1))
    ends = np.append(moves, len(motion) - 1)
    out: Indices = ends[np.searchsorted(ends, np.arange(len(motion)))]
    return out


def _longest(
    motion: Followed, at: Indices, i: int, end: int, tolerance: tuple[float, float, float]
) -> tuple[int, Array]:
    """The target that the longest arc from target i reaches, and its via point; the next target if there is no arc."""
    best, via, reach = i + 1, np.full(3, np.nan), min(i + LEAST_LINES, end)
    high = end + 1
    while high - best > 1:
        found = _arc(motion, int(at[i]), int(at[reach]), tolerance)
        if found is None:
            high = reach
        else:
            best, via = reach, found
        # doubling while it fits, then bisection
        reach = min(2 * best - i, end) if high > end else (best + high) // 2
    return best, via


def _arc(motion: Followed, a: int, b: int, tolerance: tuple[float, float, float]) -> Array | None:
    """Via point (3) of the arc that meets samples a to b and the midpoints between them; None if there is none."""
    p, t, feed = motion.straight[a : b + 1], motion.t[a : b + 1], motion.feed[a : b + 1]
    chord, filament, late = tolerance
    path = arc_lengths(p)
    middle = int(np.argmin(np.abs(path - 0.5 * path[-1])))
    via = p[middle]
    arc = segments(p[:1], via[None], p[-1:], np.array([True]))
    if np.linalg.norm(p[-1] - p[0]) < LEAST_CHORD or not LEAST_SWEPT <= arc.swept[0] <= MOST_SWEPT:
        return None
    points, times, fed = (np.concatenate([v, 0.5 * (v[1:] + v[:-1])]) for v in (p, t, feed))
    flows = motion.laid[a : b + 1]
    laid: Flags = np.concatenate([flows, flows[1:] & flows[:-1]])
    share = (times - t[0]) / (t[-1] - t[0])
    own = arc.take(np.zeros(len(points), dtype=np.intp))
    u = own.fraction(points, share)
    worst = max(
        float(np.linalg.norm(own.at(u) - points, axis=1).max()) / chord,
        float(np.abs(feed[0] + u * (feed[-1] - feed[0]) - fed).max()) / filament,
        float((np.abs(share - u) * laid).max()) * (t[-1] - t[0]) / late,
    )
    return via if worst <= 1.0 else None
