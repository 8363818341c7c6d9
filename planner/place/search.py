"""A deterministic search for the best score over a few coordinates: a lattice, then ever finer steps from its best.

Scores are piecewise smooth with ridges, where steps along the coordinates alone get stuck; so each round also tries
points spread all around. Points that have been tried are remembered and not tried again.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

Point = tuple[float, ...]
Score = Callable[[Point, float], float]  # point, floor → its score, or 0 if that is not above the floor
Scores = Callable[[Sequence[Point], float], list[float]]  # the same for several points, computed in any order

_AROUND = 12  # points that each round tries in addition to steps along the coordinates
_ROUNDS = 4  # most rounds at one step width
_HALVINGS = 5  # step widths, each half of the last: down to about a thirtieth of the lattice's step


@dataclass(frozen=True)
class Axis:
    """A coordinate that is searched: from low to high, rounded to a multiple of grain; periodic if it turns.

    count is the number of lattice points.
    """

    name: str
    low: float
    high: float
    count: int
    grain: float
    turns: bool = False

    @property
    def step(self) -> float:
        """Distance of lattice points."""
        return (self.high - self.low) / max(self.count if self.turns else self.count - 1, 1)

    def lattice(self) -> list[float]:
        """The lattice points; a single one is in the middle."""
        if self.count == 1:
            return [self.put(0.5 * (self.low + self.high))]
        return [self.put(self.low + k * self.step) for k in range(self.count)]

    def put(self, value: float) -> float:
        """The nearest allowed value."""
        if self.turns:
            value = self.low + (value - self.low) % (self.high - self.low)
        else:
            value = min(max(value, self.low), self.high)
        return round(value / self.grain) * self.grain


@dataclass(frozen=True)
class ScoredPoint:
    """A point and its score."""

    point: Point
    score: float


def lattice(axes: Sequence[Axis]) -> list[Point]:
    """Every lattice point, the last axis varying fastest."""
    return list(itertools.product(*(axis.lattice() for axis in axes)))


def one_by_one(score: Score) -> Scores:
    """Scores of points one after the other; 0 for each that is not above the best so far."""

    def scores(points: Sequence[Point], floor: float) -> list[float]:
        out = []
        for point in points:
            out.append(score(point, floor))
            floor = max(floor, out[-1])
        return out

    return scores


def well_apart(tried: Iterable[ScoredPoint], count: int, apart: Callable[[Point, Point], bool]) -> list[ScoredPoint]:
    """The best points that are reachable and pairwise apart, at most `count`, best first."""
    out: list[ScoredPoint] = []
    for each in sorted(tried, key=lambda t: (-t.score, t.point)):
        if len(out) == count or each.score <= 0.0:
            break
        if all(apart(each.point, other.point) for other in out):
            out.append(each)
    return out


def polish(
    axes: Sequence[Axis], scores: Scores, start: Point, share: float = 0.5, most: int = 10**9
) -> list[ScoredPoint]:
    """Ever better points from a start, with steps that halve when none helps any more; the last point is the best.

    share: size of the first steps relative to the lattice's; most: most scores requested.
    """
    best = ScoredPoint(start, scores([start], 0.0)[0])
    trail = [best]
    width = np.array([share * axis.step for axis in axes])
    spread = qmc.Halton(len(axes), scramble=False)
    spread.fast_forward(1)  # the first point is a corner
    known = {start}
    for _ in range(_HALVINGS):
        for _ in range(_ROUNDS):
            around = np.vstack([np.eye(len(axes)), -np.eye(len(axes)), 2.0 * spread.random(_AROUND) - 1.0])
            near = [
                tuple(axis.put(at + by) for axis, at, by in zip(axes, best.point, offset, strict=True))
                for offset in around * width
            ]
            new = [point for point in dict.fromkeys(near) if point not in known][: max(most - len(known), 0)]
            known.update(new)
            found = [ScoredPoint(point, value) for point, value in zip(new, scores(new, best.score), strict=True)]
            better = max([best, *found], key=lambda tried: tried.score)  # the first of equals
            if better is best:  # also when no more scores may be requested
                break
            best = better
            trail.append(best)
        width *= 0.5
    return trail
