"""What a study of placements looks at, and how any process comes by it: from a few words, by reading the files itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from planner.cell import Cell, build_cell
from planner.given import check_same, digest_of
from planner.obstacles import NOTHING, Obstacles, obstacles_of
from planner.placement.freedom import Place, moved_cell, place_of
from planner.placement.ranges import axes_of, reach
from planner.placement.rating import Course, course_of, score
from planner.placement.search import Axis, Point
from planner.problem import Problem, load_problem
from planner.resolve import UNAWARE
from planner.resolve.ladder import first_of_each_name
from planner.task import NozzleTask, tasks_of
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath

COARSE = 40, np.radians(30.0)  # rungs and steps of the grid, for lattice and map
FINE = {False: (120, np.radians(15.0)), True: (60, np.radians(20.0))}  # for what is polished; with a table
FOOT_SHARE = 0.25  # of the reach: so near to the arm's first axis stands its foot


@dataclass(frozen=True)
class Asked:
    """What a study is asked for, in the command's words; `problem` is a name, or a path from the root."""

    problem: str
    overrides: tuple[str, ...] = ()
    strategy: str | None = None
    free: str | None = None
    ranges: tuple[str, ...] = ()


@dataclass(frozen=True)
class Surroundings:
    """What may be in the way, wherever the part stands; nothing, if a strategy knows of no obstacles.

    nearly    obstacles for scores, of any place: on a bed without fixtures in the way of the print head
    exactly   the obstacles of a cell, all of them
    """

    nearly: Obstacles
    exactly: Callable[[Cell], Obstacles]


@dataclass(frozen=True)
class Site:
    """A problem whose part may stand elsewhere: `cell` was built with the part at `now`, `axes` are searched.

    Of layers that repeat the first counts.
    """

    problem: Problem
    cell: Cell
    now: Place
    axes: tuple[Axis, ...]
    strategy: str
    toolpath: Toolpath
    around: Surroundings
    guides: tuple[NozzleTask, ...]

    @cached_property
    def coarse(self) -> Course:
        """The path as lattice and map see it."""
        return course_of(self.guides, *COARSE, self.problem.resolve.rung)

    @cached_property
    def fine(self) -> Course:
        """The path as it is seen where a place is polished."""
        return course_of(self.guides, *FINE[len(self.cell.chosen) > 0], self.problem.resolve.rung)

    @cached_property
    def digest(self) -> str:
        """Of what the files say; see `digest_of`."""
        return digest_of(self.cell, self.guides)

    def at(self, point: Point) -> Place:
        """The place of a point of the search."""
        return replace(self.now, **{axis.name: value for axis, value in zip(self.axes, point, strict=True)})

    def moved(self, point: Point) -> Cell:
        """The cell with the part there."""
        return moved_cell(self.cell, self.now, self.at(point))

    def scored(self, course: Course, place: Place, floor: float) -> float:
        """A place's score, 0 where it is not above a floor."""
        moved = moved_cell(self.cell, self.now, place)
        if _nearest_to_axis(moved, course) < FOOT_SHARE * reach(self.cell) and place != self.now:
            return 0.0
        return score(moved, course, self.problem.resolve.min_sigma, floor, self.around.nearly)


def site_of(asked: Asked, problem: Problem, cell: Cell, axes: Sequence[Axis]) -> Site:
    """The site of a problem that was loaded. Raises InputError for what its files say of the toolpath."""
    toolpath = build_toolpath(problem)
    strategy = asked.strategy or problem.strategy
    around = surroundings(strategy, problem, cell, toolpath)
    guides = tuple(first_of_each_name(tasks_of(problem, toolpath)))
    return Site(problem, cell, place_of(problem), tuple(axes), strategy, toolpath, around, guides)


@lru_cache(maxsize=1)
def own_site(asked: Asked, digest: str) -> Site:
    """The same site in another process. Raises InputError where its files say something else there."""
    problem = load_problem(asked.problem, asked.overrides)
    cell = build_cell(problem)
    site = site_of(asked, problem, cell, axes_of(problem, cell, place_of(problem), asked.free, asked.ranges))
    check_same(problem, site.digest, digest)
    return site


def surroundings(strategy: str, problem: Problem, cell: Cell, toolpath: Toolpath) -> Surroundings:
    """What a strategy keeps clear of while it prints a toolpath.

    On a bed, fixtures are points of the part's frame; where the part moves between them, these are found anew.
    """
    among = len(cell.holder) == 0 and len(cell.fixtures) > 0
    if strategy in UNAWARE:
        return Surroundings(NOTHING, lambda _: NOTHING)
    nearly = obstacles_of(problem, replace(cell, fixtures=()) if among else cell, toolpath)
    if among:
        return Surroundings(nearly, lambda moved: obstacles_of(problem, moved, toolpath))
    return Surroundings(nearly, nearly.of)


def _nearest_to_axis(cell: Cell, course: Course) -> float:
    """Least horizontal distance [m] of the path, and of what carries it, from the arm's first axis; holder at home."""
    T_world_part = cell.holder.poses(cell.home[None, len(cell.arm) :])[0]
    tips = course.demand.tip[course.demand.rung] @ T_world_part[:3, :3].T + T_world_part[:3, 3]
    points = np.vstack([tips, cell.T_world_holder_base[:3, 3]])
    return float(np.linalg.norm(points[:, :2] - cell.T_world_base[:2, 3], axis=1).min())
