"""Finds lines of a drawing that are drawn twice."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import chain, product
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths

_LOOKS = 33  # places at which lines are compared: not at even shares of their length, where lattices meet


class _Line(Protocol):
    """Anything with points (n, 2); a closed one may end at its first point or before it."""

    @property
    def points(self) -> Array: ...

    @property
    def closed(self) -> bool: ...


Line = TypeVar("Line", bound=_Line)


class _Seen(NamedTuple):
    """All points (n, 2) of a line, and some places (k, 2) on it."""

    points: Array
    looks: Array
    closed: bool


def without_twins(
    lines: Sequence[Line], same: float, group: Callable[[Line], str] = lambda line: ""
) -> tuple[list[Line], int]:
    """The lines without those that lie on another of their group, in either direction, and how many these are.

    Closed lines may begin anywhere.
    """
    seen: dict[tuple[str, int, int, int], list[_Seen]] = defaultdict(list)
    kept = []
    for line in lines:
        points = np.vstack([line.points, line.points[:1]]) if line.closed else line.points
        arc = arc_lengths(points)
        at = 0.5 * arc[-1] * (1.0 - np.cos(np.linspace(0.0, np.pi, _LOOKS)))
        looks = np.column_stack([np.interp(at, arc, points[:, k]) for k in range(2)])
        own = _Seen(points, looks, line.closed)
        x, y = 0.5 * (points.min(axis=0) + points.max(axis=0))
        size, x, y = (round(float(value) / (4.0 * same)) for value in (arc[-1], x, y))
        around = product((-1, 0, 1), repeat=3)  # twins may be in neighbouring cells of length and place
        near = (seen.get((group(line), size + a, x + b, y + c), ()) for a, b, c in around)
        if any(_alike(own, other, same) for other in chain.from_iterable(near)):
            continue
        seen[group(line), size, x, y].append(own)
        kept.append(line)
    return kept, len(lines) - len(kept)


def _alike(one: _Seen, other: _Seen, same: float) -> bool:
    """Whether two lines lie on each other."""
    if min(np.abs(one.looks - other.looks).max(), np.abs(one.looks[::-1] - other.looks).max()) <= same:
        return True
    if not (one.closed and other.closed):
        return False
    return _away(one.looks, other.points) <= same and _away(other.looks, one.points) <= same


def _away(places: Array, points: Array) -> float:
    """Greatest distance of places (k, 2) from the line through points (n, 2)."""
    way = np.diff(points, axis=0)
    square = np.maximum((way * way).sum(axis=1), np.finfo(float).tiny)
    most = 0.0
    for place in places:
        off = place - points[:-1]
        share = np.clip((off * way).sum(axis=1) / square, 0.0, 1.0)
        most = max(most, float(np.hypot(*(off - share[:, None] * way).T).min()))
    return most
