"""What every strategy plans with, and how another process gets the same: by reading the files itself."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from planner.base.errors import InputError
from planner.base.progress import Stages
from planner.base.shipped import PROBLEMS
from planner.cell.cell import Cell, build_cell
from planner.collision.print_body import PrintBody, print_body, standing
from planner.collision.scene import Obstacles, obstacles_of
from planner.plan import seal
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.segment import Term
from planner.toolpath.as_printed import printed_beads
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of


@dataclass(frozen=True)
class PlanningContext:
    """What every strategy plans with, and is verified with.

    tasks       of all beads except those that a scan found printed; only those from `first_bead` on are laid
    terms       a user's own terms of the refinement's cost
    leans       whether the nozzle leans in the tasks, see `leaning`
    draft       a verified plan is taken as it is, even if another strategy's might be better
    start       the ladder's paths of all tasks, if a search of exactly this print has found them already
    """

    problem: Problem
    cell: Cell
    toolpath: Toolpath
    tasks: tuple[NozzleTask, ...]
    body: PrintBody
    obstacles: Obstacles
    first_bead: int
    terms: tuple[Term, ...] = ()
    leans: bool = False
    draft: bool = False
    start: tuple[JointPath, ...] = ()

    @property
    def printed(self) -> int:
        """Number of beads that a scan found printed; they have no tasks."""
        return len(self.toolpath.beads) - len(self.tasks)

    @property
    def laid(self) -> slice:
        """Which of the tasks, and of the paths that strategies find for them, are laid."""
        return slice(self.first_bead - self.printed, None)

    def along(self, toolpath: Toolpath) -> PlanningContext:
        """The same print with other beads, runs or samples, nozzle on the surface normal. Raises like `context_of`."""
        return replace(context_of(self.problem, self.cell, toolpath, self.first_bead, self.terms), draft=self.draft)


def context_of(
    problem: Problem, cell: Cell, toolpath: Toolpath, first_bead: int = 0, terms: tuple[Term, ...] = ()
) -> PlanningContext:
    """The context of a problem's print. Raises InputError for a bead that is too short for the problem's fibre."""
    body, printed = print_body(toolpath, standing(cell)), printed_beads(problem, toolpath)
    tasks, obstacles = tasks_of(problem, toolpath)[printed:], obstacles_of(problem, cell, toolpath, body)
    return PlanningContext(problem, cell, toolpath, tasks, body, obstacles, max(first_bead, printed), terms)


def with_way(given: PlanningContext, stages: Stages) -> PlanningContext:
    """The same with the way that the ladder finds, unless it is known. Raises Refusal if there is none."""
    if given.start:
        return given
    with stages.stage("resolve"):
        return replace(given, start=ladder(given.cell, given.tasks, given.problem.resolve, given.obstacles))


@lru_cache(maxsize=1)
def context_elsewhere(name: str, overrides: tuple[str, ...], digest: str) -> PlanningContext:
    """The same in another process, for the problem that `found_anywhere` names.

    Raises InputError if it is a different one there, according to `digest_of`.
    """
    problem = load_problem(name, overrides)
    given = context_of(problem, build_cell(problem), build_toolpath(problem))
    check_same(problem, digest_of(problem, given.cell, given.toolpath, given.tasks), digest)
    return given


def found_anywhere(problem: Problem) -> str:
    """A problem's name in another process: its shipped name, or the absolute path of its file.

    Links are not resolved: files that the problem names are found from the folder of the link.
    """
    file = Path(os.path.abspath(problem.file))
    return file.stem if file.parent == PROBLEMS else str(file)


def digest_of(problem: Problem, cell: Cell, toolpath: Toolpath, tasks: Sequence[NozzleTask]) -> str:
    """Digest of all that searches, refinement and scores depend on: it differs if the problem or its files do."""
    bodies = cell.head, cell.nozzles, cell.fixtures, cell.carried
    robots = cell.arm, cell.holder, cell.limits, cell.home, bodies
    printed = toolpath.beads, toolpath.shape, toolpath.solid
    settings = problem.collision, problem.process, problem.resolve
    return seal.digest_of((robots, printed, tasks, settings))


def check_same(problem: Problem, here: str, there: str) -> None:
    """Raise InputError if the digests of a problem in two processes differ."""
    if here != there:
        hint = "put them in a folder that all machines share"
        raise InputError("differs on a worker, or a file that it names does", file=problem.file, hint=hint)


def check_unchanged(problem: Problem, now: Problem) -> None:
    """Raise InputError if a problem, read again, differs from what it was: results found so far do not belong to it."""
    if seal.digest_of(problem) != seal.digest_of(now):
        raise InputError("was changed in the meantime", file=problem.file, hint="start again")
