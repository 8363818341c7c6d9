"""The study of a problem's placement: the score over the whole range, slices of it for a map, and the best places."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.cell import Cell
from planner.errors import Refusal
from planner.obstacles import Obstacles
from planner.placement.freedom import ANGLES, Place, moved_cell
from planner.placement.ranges import reach
from planner.placement.rating import Course, Rating, course_of, rate, score, score_of_paths
from planner.placement.search import Axis, Point, Tried, over_lattice, polish, well_apart
from planner.problem import Problem
from planner.resolve import STRATEGIES
from planner.resolve.ladder import first_of_each_name
from planner.task import NozzleTask

Array = NDArray[np.float64]
Progress = Callable[[str, int], AbstractContextManager[Callable[[], None]]]  # stage, steps → what counts them

COARSE = 40, math.radians(30.0)  # rungs and steps of the grid, for lattice and map
FINE = {False: (120, math.radians(15.0)), True: (60, math.radians(20.0))}  # for what is polished; with a table
_SAMPLES_RESOLVED = 200_000  # waypoints, over all places that are tried with the strategy: a minute or two
_RESOLVED = 6, 30  # such places, at least and at most
_NEAR = 0.1  # of the lattice's step: around the best of them as many more are tried
_STARTS = {False: 10, True: 6}  # that are polished
_MAP = {False: 21, True: 17}  # places to a side of a map
_APART = 0.1  # of the reach: placements that are nearer to each other are one
_APART_TURNED = math.radians(30.0)  # likewise, where nothing but the turn is free
FOOT_SHARE = 0.25  # of the reach: so near to the arm's first axis stands its foot


@dataclass(frozen=True)
class Surroundings:
    """What may be in the way, wherever the part stands; nothing, if a strategy knows of no obstacles.

    nearly    obstacles for scores, of any place: on a bed without fixtures in the way of the print head
    exactly   the obstacles of a cell, all of them
    """

    nearly: Obstacles
    exactly: Callable[[Cell], Obstacles]


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


def study(
    problem: Problem,
    cell: Cell,
    tasks: Sequence[NozzleTask],
    now: Place,
    around: Surroundings,
    axes: Sequence[Axis],
    strategy: str,
    count: int,
    progress: Progress,
) -> Study:
    """Search the places of a part for the `count` best, for a cell that was built with the part at `now`.

    A strategy does not go the way of the greatest margin, which is what the grid tells; so the best places of the grid
    are tried with the strategy, and their own paths count.
    Of layers that repeat the first counts. Raises Refusal where no place in the range reaches the whole part.
    """
    guides = first_of_each_name(tasks)
    table = len(cell.chosen) > 0
    min_sigma, spacing = problem.resolve.min_sigma, problem.resolve.rung
    coarse = course_of(guides, *COARSE, spacing)
    fine = course_of(guides, *FINE[table], spacing)
    foot = FOOT_SHARE * reach(cell)

    def at(point: Point) -> Place:
        return replace(now, **{axis.name: value for axis, value in zip(axes, point, strict=True)})

    def scored(course: Course, place: Place, floor: float) -> float:
        moved = moved_cell(cell, now, place)
        if _nearest_to_axis(moved, course) < foot and place != now:
            return 0.0
        return score(moved, course, min_sigma, floor, around.nearly)

    total = math.prod(axis.count for axis in axes)
    with progress("lattice", total) as tick:
        lattice = over_lattice(axes, lambda point, floor: scored(coarse, at(point), floor), tick)
    starts = well_apart(lattice, _STARTS[table], lambda a, b: _apart(axes, a, b, reach(cell)))
    here = tuple(axis.put(getattr(now, axis.name)) for axis in axes)
    if scored(coarse, at(here), 0.0) > 0.0:
        starts.append(Tried(here, 0.0))
    if not starts:
        raise Refusal(f"none of {total} places in the range reaches the whole part", hints=_hints(axes, cell))
    trails: list[list[Tried]] = []
    with progress("polish", len(starts)) as tick:
        for start in starts:
            trails.append(polish(axes, lambda point, floor: scored(fine, at(point), floor), start.point))
            tick()
    ends = sorted((trail[-1] for trail in trails), key=lambda tried: -tried.score)
    steps = sorted((tried for trail in trails for tried in trail[:-1]), key=lambda tried: -tried.score)
    most = int(np.clip(_SAMPLES_RESOLVED // sum(len(task) for task in guides), *_RESOLVED))
    points = list(dict.fromkeys(tried.point for tried in (*ends, *steps) if tried.score > 0.0))[:most]
    resolved: list[Tried] = []

    def followed(point: Point, floor: float) -> float:
        resolved.append(Tried(point, _resolved(moved_cell(cell, now, at(point)), guides, strategy, problem, around)))
        tick()
        return resolved[-1].score

    with progress("resolve", 2 * len(points)) as tick:
        for point in points:
            followed(point, 0.0)
        top = max(resolved, key=lambda tried: tried.score, default=None)
        if top is not None and top.score > 0.0:
            polish(axes, followed, top.point, _NEAR, len(points))
    best = well_apart(resolved, count, lambda a, b: _apart(axes, a, b, reach(cell)))
    if not best:
        raise Refusal("no place in the range reaches the whole part without a break", hints=_hints(axes, cell))
    top_place = at(best[0].point)
    planes = [("through the best place", top_place)]
    if any(getattr(top_place, axis.name) != getattr(now, axis.name) for axis in axes[2:]):
        planes.append(("through the present place", now))
    slices = []
    side = [min(_MAP[table], max(2 * axis.count, 2)) for axis in axes[:2]]
    with progress("map", len(planes) * math.prod(side)) as tick:
        for title, others in planes:
            slices.append(_slice(title, others, axes[:2], side, lambda place: scored(coarse, place, 0.0), tick))
    return Study(
        tuple(axes),
        now,
        rate(cell, fine, min_sigma, around.nearly),
        tuple((at(each.point), each.score) for each in lattice),
        tuple((at(each.point), each.score) for each in resolved),
        tuple(slices),
        tuple(
            (at(each.point), rate(moved_cell(cell, now, at(each.point)), fine, min_sigma, around.nearly))
            for each in best
        ),
    )


def _resolved(cell: Cell, tasks: Sequence[NozzleTask], strategy: str, problem: Problem, around: Surroundings) -> float:
    """The score of the paths that a strategy finds; 0 where it finds none."""
    try:
        return score_of_paths(cell, STRATEGIES[strategy](cell, tasks, problem.resolve, around.exactly(cell)))
    except Refusal:
        return 0.0


def _slice(
    title: str,
    others: Place,
    axes: Sequence[Axis],
    side: Sequence[int],
    scored: Callable[[Place], float],
    tick: Callable[[], None],
) -> Slice:
    u = np.linspace(axes[0].low, axes[0].high, side[0])
    v = np.linspace(axes[1].low, axes[1].high, side[1]) if len(axes) > 1 else np.zeros(1)
    scores = np.zeros((len(u), len(v)))
    for i, j in np.ndindex(scores.shape):
        place = replace(others, **{axes[0].name: float(u[i])})
        if len(axes) > 1:
            place = replace(place, **{axes[1].name: float(v[j])})
        scores[i, j] = scored(place)
        tick()
    return Slice(title, others, u, v, scores)


def _nearest_to_axis(cell: Cell, course: Course) -> float:
    """Least horizontal distance [m] of the path, and of what carries it, from the arm's first axis; holder at home."""
    T_world_part = cell.holder.poses(cell.home[None, len(cell.arm) :])[0]
    tips = course.demand.tip[course.demand.rung] @ T_world_part[:3, :3].T + T_world_part[:3, 3]
    points = np.vstack([tips, cell.T_world_holder_base[:3, 3]])
    return float(np.linalg.norm(points[:, :2] - cell.T_world_base[:2, 3], axis=1).min())


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
