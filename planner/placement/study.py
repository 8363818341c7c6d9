"""The study of a problem's placement: the score over the whole range, slices of it for a map, and the best places."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np

from planner.cell import Cell
from planner.errors import Refusal
from planner.placement.crew import Crew
from planner.placement.freedom import ANGLES, Place
from planner.placement.ranges import reach
from planner.placement.rating import Rating, rate
from planner.placement.search import Axis, Point, Tried, lattice, polish, well_apart
from planner.placement.site import Site
from planner.readonly import Array

Progress = Callable[[str, int], AbstractContextManager[Callable[[], None]]]  # stage, steps → what counts them

_SAMPLES_RESOLVED = 200_000  # waypoints, over all places that are tried with the strategy: a minute or two
_RESOLVED = 6, 30  # such places, at least and at most
_NEAR = 0.1  # of the lattice's step: around the best of them as many more are tried
_STARTS = {False: 10, True: 6}  # that are polished
_MAP = {False: 21, True: 17}  # places to a side of a map
_APART = 0.1  # of the reach: placements that are nearer to each other are one
_APART_TURNED = math.radians(30.0)  # likewise, where nothing but the turn is free
_CHUNK = 24  # places of the lattice or of a map that are scored as one piece of work


@dataclass(frozen=True)
class Slice:
    """Scores over the first two coordinates that are searched, the others held.

    others   the place whose other coordinates are held
    u, v     (m), (k) values of the first and of the second coordinate [m or rad]; v has one without a second
    scores   (m, k)
    """

    title: str
    others: Place
    u: Array
    v: Array
    scores: Array


@dataclass(frozen=True)
class Study:
    """What is known of a problem's placements.

    axes      coordinates that were searched
    now, now_rating   where the problem puts its part, and how good that is
    tried     every place that was scored, coarsely, with its score
    resolved  places from which the strategy was asked for its joint paths, with their scores
    slices    maps through the best place, and through the present one if it is another slice
    best      places whose joint paths are best, and their ratings, best first, pairwise apart
    """

    axes: tuple[Axis, ...]
    now: Place
    now_rating: Rating
    tried: tuple[tuple[Place, float], ...]
    resolved: tuple[tuple[Place, float], ...]
    slices: tuple[Slice, ...]
    best: tuple[tuple[Place, Rating], ...]


def study(site: Site, crew: Crew, count: int, progress: Progress) -> Study:
    """Search the places of a site's part for the `count` best; the crew does the work, in whatever order.

    A strategy does not go the way of the greatest margin, which is what the grid tells; so the best places of the grid
    are tried with the strategy, and their own paths count.
    Raises Refusal where no place in the range reaches the whole part.
    """
    axes, cell, now = site.axes, site.cell, site.now
    table, far = len(cell.chosen) > 0, reach(cell)
    points = lattice(axes)
    with progress("lattice", len(points)) as tick:
        seen = [Tried(point, value) for point, value in zip(points, _scores(site, crew, points, tick), strict=True)]
    starts = [each.point for each in well_apart(seen, _STARTS[table], lambda a, b: _apart(axes, a, b, far))]
    here = tuple(axis.put(getattr(now, axis.name)) for axis in axes)
    if site.scored(site.coarse, site.at(here), 0.0) > 0.0:
        starts.append(here)
    if not starts:
        raise Refusal(f"none of {len(points)} places in the range reaches the whole part", hints=_hints(axes, cell))
    with progress("polish", len(starts)) as tick:
        trails: list[list[Tried]] = crew("polish", starts, tick)
    resolved = _resolved(site, crew, trails, progress)
    best = well_apart(resolved, count, lambda a, b: _apart(axes, a, b, far))
    if not best:
        raise Refusal("no place in the range reaches the whole part without a break", hints=_hints(axes, cell))
    top_place = site.at(best[0].point)
    planes = [("through the best place", top_place)]
    if any(getattr(top_place, axis.name) != getattr(now, axis.name) for axis in axes[2:]):
        planes.append(("through the present place", now))
    side = [min(_MAP[table], max(2 * axis.count, 2)) for axis in axes[:2]]
    with progress("map", len(planes) * math.prod(side)) as tick:
        slices = tuple(_slice(site, crew, title, others, side, tick) for title, others in planes)
    min_sigma, nearly = site.problem.resolve.min_sigma, site.around.nearly
    return Study(
        axes,
        now,
        rate(cell, site.fine, min_sigma, nearly),
        tuple((site.at(each.point), each.score) for each in seen),
        tuple((site.at(each.point), each.score) for each in resolved),
        slices,
        tuple((site.at(each.point), rate(site.moved(each.point), site.fine, min_sigma, nearly)) for each in best),
    )


def _scores(site: Site, crew: Crew, points: Sequence[Point], tick: Callable[[], None]) -> list[float]:
    """Scores of points of the search, coarsely."""
    return _place_scores(crew, [site.at(point) for point in points], tick)


def _place_scores(crew: Crew, places: Sequence[Place], tick: Callable[[], None]) -> list[float]:
    chunks = [tuple(places[i : i + _CHUNK]) for i in range(0, len(places), _CHUNK)]
    return [value for chunk in crew("score", chunks, tick) for value in chunk]


def _resolved(site: Site, crew: Crew, trails: Sequence[Sequence[Tried]], progress: Progress) -> list[Tried]:
    """Places along the trails with the score of the strategy's own paths, and as many around the best of them."""
    ends = sorted((trail[-1] for trail in trails), key=lambda tried: -tried.score)
    steps = sorted((tried for trail in trails for tried in trail[:-1]), key=lambda tried: -tried.score)
    most = int(np.clip(_SAMPLES_RESOLVED // sum(len(task) for task in site.guides), *_RESOLVED))
    points = list(dict.fromkeys(tried.point for tried in (*ends, *steps) if tried.score > 0.0))[:most]
    resolved: list[Tried] = []
    with progress("resolve", 2 * len(points)) as tick:

        def followed(around: Sequence[Point], floor: float) -> list[float]:
            scores: list[float] = crew("follow", around, tick)
            resolved.extend(Tried(point, value) for point, value in zip(around, scores, strict=True))
            return scores

        followed(points, 0.0)
        top = max(resolved, key=lambda tried: tried.score, default=None)
        if top is not None and top.score > 0.0:
            polish(site.axes, followed, top.point, _NEAR, len(points))
    return resolved


def _slice(site: Site, crew: Crew, title: str, others: Place, side: Sequence[int], tick: Callable[[], None]) -> Slice:
    axes = site.axes[:2]
    u = np.linspace(axes[0].low, axes[0].high, side[0])
    v = np.linspace(axes[1].low, axes[1].high, side[1]) if len(axes) > 1 else np.zeros(1)
    places = []
    for i, j in np.ndindex(len(u), len(v)):
        place = replace(others, **{axes[0].name: float(u[i])})
        if len(axes) > 1:
            place = replace(place, **{axes[1].name: float(v[j])})
        places.append(place)
    return Slice(title, others, u, v, np.array(_place_scores(crew, places, tick)).reshape(len(u), len(v)))


def _apart(axes: Sequence[Axis], a: Point, b: Point, far: float) -> bool:
    """Whether two placements count as two: by their places if these are searched, else by their turn."""
    lengths = [abs(x - y) for axis, x, y in zip(axes, a, b, strict=True) if axis.name not in ANGLES]
    if lengths:
        return math.hypot(*lengths) >= _APART * far
    gap = abs(a[0] - b[0]) % (2.0 * math.pi)
    return min(gap, 2.0 * math.pi - gap) >= _APART_TURNED


def _hints(axes: Sequence[Axis], cell: Cell) -> tuple[str, ...]:
    base = cell.T_world_base[:3, 3] * 1e3
    return (
        f"a range nearer to the arm, whose nozzle reaches {reach(cell) * 1e3:.0f} mm at most "
        f"around {base[0]:.0f} {base[1]:.0f} {base[2]:.0f} mm (searched: {', '.join(axis.name for axis in axes)})",
    )
