"""The pieces of work of a study, each done for itself: here, or by who is spread over processes and machines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.errors import PlannerError, Refusal
from planner.placement.freedom import Place, changed_fields
from planner.placement.rating import COMFORT, score_of_paths
from planner.placement.search import Point, Tried, one_by_one, polish
from planner.placement.site import Asked, Site, own_site
from planner.planning import try_out
from planner.problem import load_problem
from planner.resolve import STRATEGIES
from planner.spread import Spread

# kind, pieces, what counts pieces that are done → their results in order
Crew = Callable[[str, Sequence[Any], Callable[[], None]], list[Any]]


@dataclass(frozen=True)
class Outcome:
    """What solving at a place came to: the plan's metrics, and why it is no plan to print, if it is none."""

    place: Place
    predicted: float
    metrics: dict[str, float]
    failure: str | None

    @property
    def score(self) -> float:
        """The placement's score as `rating` counts it, from the verified plan; 0 without one."""
        if self.failure is not None:
            return 0.0
        m = self.metrics
        limits, wrist = np.radians(m["joint_limit_margin_deg"]), np.radians(m.get("wrist_margin_deg", 180.0))
        least = float((np.array([m["sigma_min"], limits, wrist]) / COMFORT).min())
        return least * m["ideal_deposition_time_s"] / m["deposition_time_s"]


def crew_of(asked: Asked, site: Site, over: Spread, beside: bool) -> Crew:
    """Who does the pieces of a site's study; `beside`: in other processes, which read the site's files themselves.

    An error of a piece is raised once it comes.
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


def _elsewhere(item: tuple[Asked, str, str, Any]) -> Any:
    asked, digest, kind, piece = item
    return WORK[kind](own_site(asked, digest), piece)


def _score(site: Site, places: Sequence[Place]) -> list[float]:
    """Scores of places, as lattice and map see them."""
    return [site.scored(site.coarse, place, 0.0) for place in places]


def _polish(site: Site, start: Point) -> list[Tried]:
    """Ever better points from a start on."""
    return polish(site.axes, one_by_one(lambda point, floor: site.scored(site.fine, site.at(point), floor)), start)


def _follow(site: Site, point: Point) -> float:
    """The score of the paths that the strategy finds at a point; 0 where it finds none."""
    cell, settings = site.moved(point), site.problem.resolve
    try:
        return score_of_paths(cell, STRATEGIES[site.strategy](cell, site.guides, settings, site.around.exactly(cell)))
    except Refusal:
        return 0.0


def _solve(site: Site, piece: tuple[Place, float]) -> Outcome:
    """The whole plan at a place, verified, whose score was predicted."""
    place, predicted = piece
    problem = site.problem
    settings = [f"{field}={value}" for field, value in changed_fields(problem, place).items()]
    moved = load_problem(problem.file, [*problem.overrides, *settings])
    try:
        report = try_out(moved, site.toolpath, site.strategy, True)
    except Refusal as refusal:
        return Outcome(place, predicted, {}, f"no plan: {refusal}")
    failed = [check.name for check in report.checks if not check.ok]
    return Outcome(place, predicted, report.metrics, f"not verified: {failed[0]}" if failed else None)


WORK: dict[str, Callable[[Site, Any], Any]] = {"score": _score, "polish": _polish, "follow": _follow, "solve": _solve}
