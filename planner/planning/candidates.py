"""The default strategy against the simpler ones: whatever these can print, it prints at least as well.

A path that was searched and refined is nearly always the best one. If it is refused, fails verification, loses speed,
or spends much of the print's time on travel, the paths of the simpler strategies are planned as well, both as they are
and refined, and the best plan is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from planner.base.errors import Refusal
from planner.motion.travel.plan import Travel
from planner.plan import Trajectory
from planner.planning.context import PlanningContext
from planner.resolve.by_nozzle import nozzles_of
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import binds_table
from planner.resolve.sqp import BEYOND, Priced, given_prices, refine_paths
from planner.resolve.strategies import STRATEGIES
from planner.resolve.terms import model_of
from planner.verify.verdict import Report

DEFAULT = "sqp"
OLDEST = "interlayer time at most"  # the check that fails if the window is too narrow for a layer's duration
SIMPLER = ("ladder", "as_published", "fixed", "greedy")
# Those that search a part of what the default's first search covers entirely, unless there are several joints to
# choose, and are seldom worth their time. They also keep all axes of a table but one at rest, which leads nowhere where
# cones bind the table.
COVERED = ("fixed", "greedy")
SMALL = 5_000  # waypoints up to which they are tried all the same, and AT_SPEED applies
AT_SPEED = 0.999  # share of the length at speed below which others are tried,
LARGE_AT_SPEED = 0.99  # or this above SMALL waypoints, where trying them takes longer than everything else
TRAVEL_SHARE = 0.35  # share of the print's time above which others are tried
# Waypoints up to which others are tried from SOME_TRAVEL on, and all of them are timed: only timing reveals what travel
# takes.
TINY = 2_000
SOME_TRAVEL = 0.05  # share of the print's time
LARGE = 20_000  # waypoints above which a verified plan is taken as it is: the others would take too long
MANY = 1_000  # beads above which it is, too: travel takes some 10 ms per bead and plan, and there are seven plans
SAME_SPEED = 1e-3  # share of the length at speed within which two plans are equally good
# Share of the length at speed less than the best, and × the least time: a plan within both is as good as any.
AS_GOOD_SPEED, AS_GOOD_TIME = 9e-4, 1.019
WORTH_TIMING = 5e-4  # share of the time that paths must save before they are timed and verified
SAME_TIME = 1.01  # × the least cost within which the default's own plan is taken
SPEED_PRICE = 5.0  # 1 % of the length at speed is worth so many per cent of the print's time
LONGER = 1.02  # × the least time above which the ladder's paths are refined once more,
HELD = "ladder, refined with ends held"
CLEAR = "ladder with its head clear"  # upright, although the usual search relies on a nozzle that may lean
HOLDS = 100.0  # × the usual price of moving the ends of beads
# Events in which the robot rests equally long whatever its joint paths are.
WAITS = frozenset({"heat", "purge", "pause", "change", "cut"})
FAR_BEYOND = 0.1  # rad beyond a cone, and
FAR_BEHIND = 0.01  # additional share of the time lost, from which refining seldom recovers paths


@dataclass(frozen=True)
class PlannedPaths:
    """Joint paths of all beads with their trajectory, its verification report and its travels.

    by: the strategy that found the paths; "refined" is added if a simpler one's were refined
    """

    by: str
    paths: Sequence[JointPath]
    trajectory: Trajectory
    report: Report
    travels: Sequence[Travel]

    @property
    def verified(self) -> bool:
        """Whether all checks passed."""
        return all(check.ok for check in self.report.checks)

    @property
    def at_speed(self) -> float:
        """Share of the length at the commanded speed."""
        return self.report.metrics["at_speed_fraction"]

    @property
    def time(self) -> float:
        """Time of the whole print [s], without the rests that all joint paths share."""
        waits = sum(event.duration for event in self.trajectory.events if event.kind in WAITS)
        return self.report.metrics["print_time_s"] - waits


PlanPaths = Callable[[str, Sequence[JointPath]], PlannedPaths]


def best_of_all(
    given: PlanningContext, own: PlannedPaths | None, waypoints: int, plan_paths: PlanPaths
) -> PlannedPaths | None:
    """The default's own plan (None if it was refused), or a better one of a simpler strategy.

    None if no plan is verified and there is no own one.
    """
    taken = own is not None and own.verified and given.draft
    if own is not None and (taken or not _leaves_to_be_desired(own, waypoints, len(given.tasks))):
        return own
    verified = [own] if own is not None and own.verified else []

    def plan(name: str, paths: Sequence[JointPath]) -> None:
        with suppress(Refusal):  # if a travel has no way
            planned = plan_paths(name, paths)
            if planned.verified:
                verified.append(planned)

    for name, paths in _simpler_paths(given, own, waypoints):
        plan(name, paths)
    if own is not None and own.verified and own.time > LONGER * _soonest(verified):
        with suppress(Refusal):
            plan(HELD, _refined_with_held_ends(given))
    return _best(verified) if verified else own


def _refined_with_held_ends(given: PlanningContext) -> Sequence[JointPath]:
    """The ladder's paths refined with the ends of beads hardly moved, so that travel takes as long as before."""
    settings = given.problem.resolve
    weights = settings.weights.model_copy(update={"travel": HOLDS * settings.weights.travel})
    return refine_paths(
        given.cell, given.start, settings.model_copy(update={"weights": weights}), given.obstacles, given.terms
    )


def _leaves_to_be_desired(own: PlannedPaths, waypoints: int, beads: int) -> bool:
    if not own.verified:
        return not _too_slow_for_its_window(own.report)
    if waypoints > LARGE or beads > MANY:
        return False
    enough = AT_SPEED if waypoints <= SMALL else LARGE_AT_SPEED
    much = SOME_TRAVEL if waypoints <= TINY else TRAVEL_SHARE
    return own.at_speed < enough or _travel_share(own) > much


def _too_slow_for_its_window(report: Report) -> bool:
    """Whether only the greatest interlayer time fails, and would even without any dips: other paths do not help."""
    failing = [check for check in report.checks if not check.ok]
    if [check.name for check in failing] != [OLDEST]:
        return False
    at_best = report.metrics["ideal_deposition_time_s"] / report.metrics["deposition_time_s"]
    return failing[0].worst * at_best > failing[0].limit


def _travel_share(own: PlannedPaths) -> float:
    return 1.0 - own.report.metrics["deposition_time_s"] / own.time


def _simpler_paths(
    given: PlanningContext, own: PlannedPaths | None, waypoints: int
) -> Iterator[tuple[str, Sequence[JointPath]]]:
    """Paths of the simpler strategies, refined and as they are, except those that leave their cones or promise nothing.

    If the default's own plan failed and the nozzle may lean, paths of a search that does not rely on leaning come
    first.
    """
    cell, settings, obstacles = given.cell, given.problem.resolve, given.obstacles

    def prices_of(paths: Sequence[JointPath]) -> list[Priced]:
        each = [(model_of(own), [paths[i] for i in which]) for own, which in nozzles_of(cell, paths)]
        return [price for model, mine in each for price in given_prices(model, mine, settings).values()]

    if (own is None or not own.verified) and given.tasks[0].cones.tilt > 0.0:
        with suppress(Refusal):
            clear = STRATEGIES["ladder"](cell, given.tasks, settings, obstacles.counting_head)
            yield CLEAR, clear
            yield f"{CLEAR}, refined", refine_paths(cell, clear, settings, obstacles, given.terms)

    names: tuple[str, ...] = SIMPLER if given.start else SIMPLER[1:]  # the ladder would refuse again
    most, worth_refining = np.inf, np.inf
    if own is not None and own.verified:
        covered = (waypoints > SMALL and len(cell.chosen) < 2) or (
            waypoints > TINY and binds_table(cell, given.tasks[0].cones)
        )
        names = tuple(name for name in SIMPLER if not (covered and name in COVERED))
        ideal = own.report.metrics["ideal_deposition_time_s"]
        lost = sum(price.lost for price in prices_of(own.paths))
        margin = SAME_SPEED if _travel_share(own) > TRAVEL_SHARE else -WORTH_TIMING
        most = np.inf if waypoints <= TINY else lost + margin * ideal
        worth_refining = np.inf if waypoints <= TINY else lost + FAR_BEHIND * ideal

    def within(paths: Sequence[JointPath], beyond: float, most: float) -> bool:
        prices = prices_of(paths)
        return all(price.beyond <= beyond for price in prices) and sum(price.lost for price in prices) <= most

    for name in names:
        try:
            paths = given.start if name == SIMPLER[0] else STRATEGIES[name](cell, given.tasks, settings, obstacles)
        except Refusal:
            continue
        # the ladder's paths, refined, are the default's own plan
        if name != SIMPLER[0] and within(paths, FAR_BEYOND, worth_refining):
            try:
                refined: Sequence[JointPath] = refine_paths(cell, paths, settings, obstacles, given.terms)
            except Refusal:
                refined = paths
            if within(refined, BEYOND, most):
                yield f"{name}, refined", refined
        if within(paths, BEYOND, most):
            yield name, paths


def _soonest(plans: Sequence[PlannedPaths]) -> float:
    """The least time of a print [s], see `PlannedPaths.time`."""
    return min(plan.time for plan in plans)


def _best(plans: Sequence[PlannedPaths]) -> PlannedPaths:
    """The verified plan that costs least; the first one if it costs about as little.

    The first is the default's own if that is verified. If some plans are about as good as any in both speed and time,
    only these are compared.
    """
    most, soonest = max(plan.at_speed for plan in plans), _soonest(plans)
    as_good = [plan for plan in plans if plan.at_speed >= most - AS_GOOD_SPEED and plan.time <= AS_GOOD_TIME * soonest]

    def cost(plan: PlannedPaths) -> float:
        slow = most - plan.at_speed
        return plan.time * (1.0 + SPEED_PRICE * (slow if slow > SAME_SPEED else 0.0))

    among = as_good or plans
    least = min(among, key=cost)
    return among[0] if cost(among[0]) <= SAME_TIME * cost(least) else least
