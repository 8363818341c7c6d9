"""The study of a problem's placement: the score over the whole range, slices of it, and the best places."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planner.base.arrays import Array
from planner.base.distribution import Spread
from planner.base.errors import PlannerError, Refusal
from planner.cell.cell import Cell
from planner.place.rating import COMFORT, Rating, score_of_paths
from planner.place.search import Axis, Point, ScoredPoint, lattice, one_by_one, polish, well_apart
from planner.place.site import ANGLES, PartPlace, Site, StudyRequest, changed_fields, own_site, reach
from planner.planning.pipeline import try_out
from planner.resolve.strategies import STRATEGIES
from planner.verify.verdict import Report

# ----------------------------------------------------------------------------------------------------
# The pieces of work of a study, each independent: done here, or spread over processes and machines.

# kind, pieces, counter of finished pieces → their results in order
Crew = Callable[[str, Sequence[Any], Callable[[], None]], list[Any]]

LAID_LIMITS = "laid_limit_margin_deg"  # least angle to a joint's limit while material is laid


@dataclass(frozen=True)
class PlaceOutcome:
    """The result of solving at a place: the plan's metrics, and the reason if there is no printable plan."""

    place: PartPlace
    predicted: float
    metrics: dict[str, float]
    failure: str | None

    @classmethod
    def of(cls, place: PartPlace, predicted: float, report: Report) -> PlaceOutcome:
        """The result of verification, with LAID_LIMITS added, since home and travel do not depend on the place."""
        failed = [check.name for check in report.checks if not check.ok]
        laid = np.isfinite(report.series["sigma"])  # NaN in travel
        least = float(report.series["limit_margin_deg"][laid].min(initial=180.0))
        return cls(
            place, predicted, report.metrics | {LAID_LIMITS: least}, f"not verified: {failed[0]}" if failed else None
        )

    @property
    def score(self) -> float:
        """The placement's score as defined in `rating`, from the verified plan; 0 without one."""
        if self.failure is not None:
            return 0.0
        m = self.metrics
        limits, wrist = np.radians(m[LAID_LIMITS]), np.radians(m.get("wrist_margin_deg", 180.0))
        least = float((np.array([m["sigma_min"], limits, wrist]) / COMFORT).min())
        return least * m["ideal_deposition_time_s"] / m["deposition_time_s"]


def crew_of(asked: StudyRequest, site: Site, over: Spread, beside: bool) -> Crew:
    """The crew for a site's study; `beside`: work in other processes, which read the site's files themselves.

    An error of a piece is raised as soon as it arrives.
    """

    def crew(kind: str, pieces: Sequence[Any], tick: Callable[[], None]) -> list[Any]:
        results: list[Any] = [None] * len(pieces)
        items = [(asked, site.digest, kind, piece) for piece in pieces]
        done = over(_elsewhere, items) if beside else ((i, WORK[kind](site, piece)) for i, piece in enumerate(pieces))
        for i, result in done:
            if isinstance(result, PlannerError):
                raise result
            results[i] = result
            for _ in range(len(pieces[i]) if kind == "score" else 1):
                tick()
        return results

    return crew


def _elsewhere(item: tuple[StudyRequest, str, str, Any]) -> Any:
    asked, digest, kind, piece = item
    return WORK[kind](own_site(asked, digest), piece)


def _score(site: Site, places: Sequence[PartPlace]) -> list[float]:
    """Scores of places at the resolution of lattice and map."""
    return [site.scored(site.coarse, place, 0.0) for place in places]


def _polish(site: Site, start: Point) -> list[ScoredPoint]:
    """Ever better points from a start."""
    return polish(site.axes, one_by_one(lambda point, floor: site.scored(site.fine, site.at(point), floor)), start)


def _follow(site: Site, point: Point) -> float:
    """The score of the paths that the strategy finds at a point; 0 where it finds none."""
    cell, settings = site.moved(point), site.problem.resolve
    try:
        return score_of_paths(cell, STRATEGIES[site.strategy](cell, site.guides, settings, site.around.exactly(cell)))
    except Refusal:
        return 0.0


def _solve(site: Site, piece: tuple[PartPlace, float]) -> PlaceOutcome:
    """The whole plan at a place with a predicted score, verified."""
    place, predicted = piece
    problem = site.problem
    settings = [f"{field}={value}" for field, value in changed_fields(problem, place).items()]
    moved = problem.changed(settings)
    try:
        report = try_out(moved, site.toolpath, site.strategy, True)
    except Refusal as refusal:
        return PlaceOutcome(place, predicted, {}, f"no plan: {refusal}")
    return PlaceOutcome.of(place, predicted, report)


WORK: dict[str, Callable[[Site, Any], Any]] = {"score": _score, "polish": _polish, "follow": _follow, "solve": _solve}


# ----------------------------------------------------------------------------------------------------
# The study of a problem's placement: the score over the whole range, slices of it for a map, and the best places.

Progress = Callable[[str, int], AbstractContextManager[Callable[[], None]]]  # stage, steps → their counter

_SAMPLES_RESOLVED = 200_000  # waypoints over all places tried with the strategy: a minute or two
_RESOLVED = 6, 30  # least and greatest number of such places
_NEAR = 0.1  # × the lattice's step: as many more places are tried this near to the best of them
_STARTS = {False: 10, True: 6}  # lattice points to polish, at most; key: whether any joint is chosen (table, rail)
_MAP = {False: 21, True: 17}  # most places along a side of a map; key as in _STARTS
_APART = 0.1  # × the reach: placements nearer to each other than this are one
_APART_TURNED = math.radians(30.0)  # the same where only the turn is free
_CHUNK = 24  # places of the lattice or of a map scored as one piece of work


@dataclass(frozen=True)
class Slice:
    """Scores over the first two coordinates searched, the others held.

    others   the place whose other coordinates are held
    u, v     (m), (k) values of the first and second coordinate [m or rad]; v has a single one without a second
    scores   (m, k)
    """

    title: str
    others: PartPlace
    u: Array
    v: Array
    scores: Array


@dataclass(frozen=True)
class Study:
    """The result of a study of a problem's placements.

    axes      coordinates that were searched
    now, now_rating   where the problem puts its part, and how good that is
    tried     every lattice place with its coarse score
    resolved  places tried with the strategy, with the scores of its joint paths
    slices    maps through the best place, and through the present one if that is another slice
    best      places with the best joint paths, and their ratings, best first, pairwise apart
    """

    axes: tuple[Axis, ...]
    now: PartPlace
    now_rating: Rating
    tried: tuple[tuple[PartPlace, float], ...]
    resolved: tuple[tuple[PartPlace, float], ...]
    slices: tuple[Slice, ...]
    best: tuple[tuple[PartPlace, Rating], ...]


def study(site: Site, crew: Crew, count: int, progress: Progress) -> Study:
    """Search the places of a site's part for the `count` best; the crew does the work, in any order.

    The grid gives the way with the greatest margin, which a strategy does not follow; so the best places of the grid
    are tried with the strategy, and the scores of its own paths count.
    Raises Refusal if the arm reaches the whole part at no place in the range.
    """
    axes, cell, now = site.axes, site.cell, site.now
    table, far = len(cell.chosen) > 0, reach(cell)
    points = lattice(axes)
    with progress("lattice", len(points)) as tick:
        seen = [
            ScoredPoint(point, value) for point, value in zip(points, _scores(site, crew, points, tick), strict=True)
        ]
    starts = [each.point for each in well_apart(seen, _STARTS[table], lambda a, b: _apart(axes, a, b, far))]
    here = tuple(axis.put(getattr(now, axis.name)) for axis in axes)
    if site.scored(site.coarse, site.at(here), 0.0) > 0.0:
        starts.append(here)
    if not starts:
        raise Refusal(f"none of {len(points)} places in the range reaches the whole part", hints=_hints(axes, cell))
    with progress("polish", len(starts)) as tick:
        trails: list[list[ScoredPoint]] = crew("polish", starts, tick)
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
    return Study(
        axes,
        now,
        site.rated(cell),
        tuple((site.at(each.point), each.score) for each in seen),
        tuple((site.at(each.point), each.score) for each in resolved),
        slices,
        tuple((site.at(each.point), site.rated(site.moved(each.point))) for each in best),
    )


def _scores(site: Site, crew: Crew, points: Sequence[Point], tick: Callable[[], None]) -> list[float]:
    """Coarse scores of points of the search."""
    return _place_scores(crew, [site.at(point) for point in points], tick)


def _place_scores(crew: Crew, places: Sequence[PartPlace], tick: Callable[[], None]) -> list[float]:
    chunks = [tuple(places[i : i + _CHUNK]) for i in range(0, len(places), _CHUNK)]
    return [value for chunk in crew("score", chunks, tick) for value in chunk]


def _resolved(site: Site, crew: Crew, trails: Sequence[Sequence[ScoredPoint]], progress: Progress) -> list[ScoredPoint]:
    """Places along the trails with the score of the strategy's own paths, and as many around the best of them."""
    ends = sorted((trail[-1] for trail in trails), key=lambda tried: -tried.score)
    steps = sorted((tried for trail in trails for tried in trail[:-1]), key=lambda tried: -tried.score)
    most = int(np.clip(_SAMPLES_RESOLVED // sum(len(task) for task in site.guides), *_RESOLVED))
    points = list(dict.fromkeys(tried.point for tried in (*ends, *steps) if tried.score > 0.0))[:most]
    resolved: list[ScoredPoint] = []
    with progress("resolve", 2 * len(points)) as tick:

        def followed(around: Sequence[Point], floor: float) -> list[float]:
            scores: list[float] = crew("follow", around, tick)
            resolved.extend(ScoredPoint(point, value) for point, value in zip(around, scores, strict=True))
            return scores

        followed(points, 0.0)
        top = max(resolved, key=lambda tried: tried.score, default=None)
        if top is not None and top.score > 0.0:
            polish(site.axes, followed, top.point, _NEAR, len(points))
    return resolved


def _slice(
    site: Site, crew: Crew, title: str, others: PartPlace, side: Sequence[int], tick: Callable[[], None]
) -> Slice:
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
    """Whether two placements count as distinct: by their positions if these are searched, else by their turn."""
    lengths = [abs(x - y) for axis, x, y in zip(axes, a, b, strict=True) if axis.name not in ANGLES]
    if lengths:
        return math.hypot(*lengths) >= _APART * far
    gap = abs(a[0] - b[0]) % (2.0 * math.pi)
    return min(gap, 2.0 * math.pi - gap) >= _APART_TURNED


def _hints(axes: Sequence[Axis], cell: Cell) -> tuple[str, ...]:
    base = cell.T_world_base[:3, 3] * 1e3
    foot = "its foot, wherever the carrier puts it" if cell.rails else f"{base[0]:.0f} {base[1]:.0f} {base[2]:.0f} mm"
    return (
        f"a range nearer to the arm, whose nozzle reaches {reach(cell) * 1e3:.0f} mm at most around {foot} "
        f"(searched: {', '.join(axis.name for axis in axes)})",
    )
