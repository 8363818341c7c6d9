"""Redundancy resolution: strategies that choose what the nozzle's path leaves free."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.problem.settings import ResolveSpec
from planner.resolve.baselines import fixed, greedy
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.published import as_published
from planner.resolve.sqp import sqp
from planner.toolpath.task import NozzleTask

Unaware = Callable[[Cell, Sequence[NozzleTask], ResolveSpec], tuple[JointPath, ...]]
Strategy = Callable[[Cell, Sequence[NozzleTask], ResolveSpec, Obstacles], tuple[JointPath, ...]]


def _nlp(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """See `planner.resolve.reference.nlp`, imported on demand: no other strategy needs CasADi."""
    from planner.resolve.reference.nlp import nlp

    return nlp(cell, tasks, settings)


def _without(strategy: Unaware) -> Strategy:
    """A strategy that ignores obstacles, with the common signature."""
    return lambda cell, tasks, settings, obstacles: strategy(cell, tasks, settings)


# Strategies for comparison, which ignore obstacles: verification reports what they collide with.
UNAWARE = ("as_published", "fixed", "greedy", "nlp")
STRATEGIES: dict[str, Strategy] = {
    "as_published": _without(as_published),
    "fixed": _without(fixed),
    "greedy": _without(greedy),
    "ladder": ladder,
    "sqp": sqp,
    "nlp": _without(_nlp),
}
