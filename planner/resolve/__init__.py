"""Redundancy resolution: strategies that choose what the nozzle's path leaves free."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from planner.cell import Cell
from planner.problem.settings import ResolveSpec
from planner.resolve.baselines import as_published, fixed, greedy
from planner.resolve.jointpath import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.sqp import sqp
from planner.task import NozzleTask

Strategy = Callable[[Cell, Sequence[NozzleTask], ResolveSpec], tuple[JointPath, ...]]


def _nlp(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """See `planner.resolve.nlp`, loaded for who asks for it only: nobody else needs CasADi."""
    from planner.resolve.nlp import nlp

    return nlp(cell, tasks, settings)


STRATEGIES: dict[str, Strategy] = {
    "as_published": as_published,
    "fixed": fixed,
    "greedy": greedy,
    "ladder": ladder,
    "sqp": sqp,
    "nlp": _nlp,
}
