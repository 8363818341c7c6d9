"""Arcs of G-code as polylines."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array

_OFF = 0.01, 5e-5  # share of the radius, and m, by which the radii at an arc's ends may differ: files are rounded
_MOST_CHORDS = 10_000


class NoArc(ValueError):
    """There is no such arc; the message says why."""


def arc_by_centre(start: Array, end: Array, centre: Array, clockwise: bool, chord_tolerance: float) -> Array:
    """Points (n, 2) of an arc from start (2, exclusive) to end (2, inclusive) [m]; a full circle if they are equal.

    Chords leave the arc by at most `chord_tolerance` [m]. Raises NoArc.
    """
    a, b = start - centre, end - centre
    r, last = float(np.hypot(*a)), float(np.hypot(*b))
    if r == 0.0:
        raise NoArc("the arc's centre is where it starts")
    if abs(last - r) > max(_OFF[0] * r, _OFF[1]):
        raise NoArc(f"the arc starts {r * 1e3:.3f} mm from its centre and ends {last * 1e3:.3f} mm from it")
    first = float(np.arctan2(a[1], a[0]))
    sweep = float(np.arctan2(b[1], b[0])) - first
    sweep = -((-sweep) % (2.0 * np.pi)) if clockwise else sweep % (2.0 * np.pi)
    if sweep == 0.0 or np.array_equal(start, end):
        sweep = -2.0 * np.pi if clockwise else 2.0 * np.pi
    step = 2.0 * np.arccos(max(1.0 - chord_tolerance / r, 0.0))
    n = int(min(max(np.ceil(abs(sweep) / step), 1), _MOST_CHORDS))
    u = np.arange(1, n + 1) / n
    radius = r + (last - r) * u
    angle = first + sweep * u
    points = centre + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    points[-1] = end
    return np.asarray(points)


def centre_by_radius(start: Array, end: Array, radius: float, clockwise: bool) -> Array:
    """Centre (2) of the arc from start to end with a radius [m], negative for the longer arc. Raises NoArc."""
    way = end - start
    half = 0.5 * float(np.hypot(*way))
    if half == 0.0:
        raise NoArc("an arc given by its radius ends where it starts")
    if half > abs(radius) + _OFF[1]:
        raise NoArc(f"an arc of radius {abs(radius) * 1e3:.3f} mm cannot join points {half * 2e3:.3f} mm apart")
    away = float(np.sqrt(max(radius**2 - half**2, 0.0)))
    left = np.array([-way[1], way[0]]) / (2.0 * half)
    # the centre of a counter-clockwise arc of less than half a turn lies to the left
    side = -1.0 if clockwise == (radius > 0.0) else 1.0
    return np.asarray(0.5 * (start + end) + side * away * left)
