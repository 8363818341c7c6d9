"""Beads that cannot be followed in one go, in pieces: a search finds where to pause; the rest is planned as usual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.planning.context import PlanningContext
from planner.resolve.guides import guides_of, runs_backwards
from planner.resolve.ladder import MOST_NODES, coarse_nodes
from planner.resolve.pauses import Pause, pauses_of
from planner.toolpath.split import split_toolpath
from planner.toolpath.task import NozzleTask

_BRANCH = "no branch leads on"
_RUNS, _MOST_RUNS = 2.0, 0.5  # × the turning along a run: room kept for a joint; rad of it at most
MORE_ROOM = (0.0, 0.3)  # rad, tried in order: how much further a smooth path may wind than the coarse search saw


def in_pieces(given: PlanningContext, more_room: float) -> PlanningContext | None:
    """The same print with beads in as few pieces as possible; None if none has to be cut, or if that does not help.

    Beads that repeat in higher layers are cut where the lowest of them is. Joints that wind keep `more_room` [rad] more
    from the ends of their ranges.
    """
    process = given.problem.process
    least = max(process.run_in, process.fibre.least_length if process.fibre is not None else 0.0)
    guides, of = guides_of(given.tasks)
    pauses = [_pauses(given, guide, least, more_room) for guide in guides]
    cut = [(task, guides[g], pauses[g]) for task, g in zip(given.tasks, of, strict=True) if pauses[g]]
    if not cut:
        return None
    backwards = {task.bead for task, guide, _ in cut if runs_backwards(task, guide)}
    places = {task.bead: _places(task, guide, own, task.bead in backwards) for task, guide, own in cut}
    toolpath = split_toolpath(given.toolpath, places, backwards)
    if process.fibre is not None and min(bead.length for bead in toolpath.beads) < process.fibre.least_length:
        return None
    return given.along(toolpath)


def _pauses(given: PlanningContext, task: NozzleTask, least: float, more_room: float) -> tuple[Pause, ...]:
    """The fewest pauses with which the arm can follow a bead; none if they do not help.

    Room is left for the runs at the ends of pieces.
    """
    cell = given.cell.at(task.material)
    obstacles = given.obstacles.for_nozzle(given.cell, cell)
    demand, nodes = coarse_nodes(cell, [task], given.problem.resolve, MOST_NODES, obstacles)
    spin = float(np.linalg.norm(demand.twist[:, 3:], axis=1).max()) / task.speed  # rad/m
    room = given.cell.limits.room + min(_RUNS * given.problem.process.run_in * spin, _MOST_RUNS) + more_room
    return pauses_of(cell, task, demand, nodes, least, room) or ()


def _places(task: NozzleTask, guide: NozzleTask, pauses: Sequence[Pause], backwards: bool) -> list[tuple[float, str]]:
    """Arc lengths [m] along a task's bead at which it pauses, and why, derived from the pauses of its guide.

    backwards: whether the bead runs in the opposite direction to its guide
    """
    length, own = (each.s[each.last] - each.s[each.first] for each in (guide, task))
    shares = np.array([(pause.s - guide.s[guide.first]) / length for pause in pauses])
    words = [f"{pause.joint} would turn further than its range" if pause.joint else _BRANCH for pause in pauses]
    if backwards:
        shares, words = 1.0 - shares[::-1], words[::-1]
    return [(float(share * own), why) for share, why in zip(shares, words, strict=True)]
