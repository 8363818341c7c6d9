"""The input of a placement study: the problem's scene, the coordinates searched, and their ranges."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, nearest_name
from planner.base.geometry import TURN
from planner.cell.cell import Cell, build_cell, rigid_inverse, translation
from planner.cell.kinematics.chain import Chain
from planner.collision.scene import NOTHING, Obstacles, obstacles_of
from planner.place.rating import Course, Rating, courses_of, rate, score
from planner.place.search import Axis, Point
from planner.planning.context import check_same, digest_of
from planner.problem import Problem, load_problem
from planner.resolve.guides import guides_of
from planner.resolve.strategies import UNAWARE
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of

# ----------------------------------------------------------------------------------------------------
# A part's place as the few numbers that may change: of the bed or table in the world, and of the part on the table.

FREEDOMS = ("x", "y", "z", "turn", "part_x", "part_y")
ANGLES = frozenset({"turn"})
ON_A_TABLE = frozenset({"part_x", "part_y"})


@dataclass(frozen=True)
class PartPlace:
    """A part's place: x, y, z [m] and turn about the vertical [rad] of the bed or of the table's base in the world;
    part_x, part_y [m] of the part on the table's plate."""

    x: float
    y: float
    z: float
    turn: float
    part_x: float = 0.0
    part_y: float = 0.0


def place_of(problem: Problem) -> PartPlace:
    """Where the problem puts its part."""
    cell = problem.cell
    if cell.positioner is None:
        if cell.bed is None:
            raise problem.error("cell", "neither positioner nor bed_mm is given")
        return PartPlace(*cell.bed, cell.bed_rpy[2])
    spec = cell.positioner
    at = spec.origin if spec.base is None else spec.base
    if at is None:
        raise problem.error("cell.positioner", "neither origin_mm nor base_mm is given")
    return PartPlace(*at, spec.turn, spec.part[0], spec.part[1])


def changed_fields(problem: Problem, place: PartPlace) -> dict[str, float | list[float]]:
    """Changed fields of the problem file (dotted, in mm and degrees) that put the part at a place."""
    was, cell = place_of(problem), problem.cell
    at = [_mm(place.x), _mm(place.y), _mm(place.z)]
    out: dict[str, float | list[float]] = {}
    moved = (place.x, place.y, place.z) != (was.x, was.y, was.z)
    turned = place.turn != was.turn
    if cell.positioner is None:
        if moved:
            out["cell.bed_mm"] = at
        if turned:
            roll, pitch, _ = cell.bed_rpy
            out["cell.bed_rpy_deg"] = [_deg(roll), _deg(pitch), _deg(place.turn)]
        return out
    if moved:
        out[f"cell.positioner.{'origin_mm' if cell.positioner.base is None else 'base_mm'}"] = at
    if turned:
        out["cell.positioner.turn_deg"] = _deg(place.turn)
    if (place.part_x, place.part_y) != (was.part_x, was.part_y):
        out["cell.positioner.part_mm"] = [_mm(place.part_x), _mm(place.part_y), _mm(cell.positioner.part[2])]
    return out


def moved_cell(cell: Cell, was: PartPlace, place: PartPlace) -> Cell:
    """A cell built for one place, with its part moved to another."""
    T_move = _anchor(place) @ rigid_inverse(_anchor(was))
    T_shift = translation(np.array([place.part_x - was.part_x, place.part_y - was.part_y, 0.0]))
    T_plate_part = T_shift @ cell.T_plate_part
    holder = cell.holder
    T_last = holder.T_last_tip @ rigid_inverse(cell.T_plate_part) @ T_plate_part
    if len(holder):
        placements = np.concatenate([(T_move @ holder.placements[0])[None], holder.placements[1:]])
        holder = Chain(holder.names, placements, holder.axes, T_last)
    else:
        holder = Chain(holder.names, holder.placements, holder.axes, T_move @ T_last)
    return replace(
        cell,
        holder=holder,
        T_world_holder=holder.poses(np.zeros((1, len(holder))))[0],
        T_world_holder_base=T_move @ cell.T_world_holder_base,
        T_plate_part=T_plate_part,
    )


def _anchor(place: PartPlace) -> Array:
    T = translation(np.array([place.x, place.y, place.z]))
    c, s = np.cos(place.turn), np.sin(place.turn)
    T[:2, :2] = [[c, -s], [s, c]]
    return T


def _mm(length: float) -> float:
    return round(length * 1e3, 6) + 0.0


def _deg(angle: float) -> float:
    return round(float(np.degrees(angle)), 6) + 0.0


# ----------------------------------------------------------------------------------------------------
# The coordinates of a placement that are searched, and their ranges: from the options, or from the arm's reach.

_REACH_SHARE = 0.5  # × the reach: searched to each side of the part's present place
_PLATE_SHARE = 0.1  # × the reach: the same for a part on its plate
_FINEST = {False: 10e-3, True: math.radians(5.0)}  # m and rad: about the least distance of lattice points
_GRAIN = {False: 1e-3, True: math.radians(1.0)}  # m and rad: placements are rounded to this
_COUNTS = {"x": 9, "y": 9, "z": 6, "turn": 6, "part_x": 5, "part_y": 5}  # most lattice points
_MOST_ANYWHERE = 100.0  # m: the size of a hall, as in problem files


def default_freedoms(problem: Problem) -> tuple[str, ...]:
    """Coordinates searched by default: the position and, on a bed, the turn, which a table can make itself."""
    return ("x", "y", "z", "turn") if problem.cell.positioner is None else ("x", "y", "z")


def reach(cell: Cell) -> float:
    """Upper bound of how far the nozzle can be from the axis of the arm's first joint, arm stretched out [m]."""
    links = np.linalg.norm(cell.arm.placements[1:, :3, 3], axis=1).sum()
    return float(links + np.linalg.norm(cell.arm.T_last_tip[:3, 3]))


def axes_of(problem: Problem, cell: Cell, place: PartPlace, free: str | None, ranges: Sequence[str]) -> list[Axis]:
    """The coordinates that are searched, in the order of FREEDOMS.

    free: names separated by commas, as in `x,y,turn`; ranges: `name=low:high` each, in mm or degrees. Without names,
    those with a range are searched; without either, `default_freedoms`.
    Raises InputError for malformed options, and for coordinates that the problem's part does not have.
    """
    limits = dict(_limits(problem, text) for text in ranges)
    if free is not None:
        names = tuple(_name(problem, name.strip(), f"--free {free}") for name in free.split(","))
        for name in limits:
            if name not in names:
                raise InputError(f"{name} has a range but is not free", field=f"--free {free}", hint=f"add {name}")
    else:
        names = tuple(limits) or default_freedoms(problem)
    far = reach(cell)
    return [_axis(cell, place, name, limits.get(name), far) for name in FREEDOMS if name in names]


def _axis(cell: Cell, place: PartPlace, name: str, given: tuple[float, float] | None, far: float) -> Axis:
    at, angle = getattr(place, name), name in ANGLES
    if given is not None:
        low, high = given
    elif angle:
        low, high = -math.pi, math.pi
    else:
        side = (_PLATE_SHARE if name in ON_A_TABLE else _REACH_SHARE) * far
        low, high = round(at - side, 3), round(at + side, 3)
        if name == "z" and cell.T_world_base[2, 2] > 0.5:  # not below an upright arm's foot, unless it is there already
            low = max(low, min(float(cell.T_world_base[2, 3]), at))
    turns = angle and high - low >= TURN - 1e-9
    count = min(_COUNTS[name], math.ceil((high - low) / _FINEST[angle]) + 1)
    return Axis(name, low, high, count, _GRAIN[angle], turns)


def _limits(problem: Problem, text: str) -> tuple[str, tuple[float, float]]:
    """Name and range [m or rad] of an option `name=low:high`."""
    field = f"--range {text}"
    name, equals, numbers = text.partition("=")
    low, colon, high = numbers.partition(":")
    if not equals or not colon:
        raise InputError("is not of the form name=low:high", field=field, hint="for example x=300:700, in mm")
    name = _name(problem, name.strip(), field)
    angle = name in ANGLES
    try:
        pair = float(low), float(high)
    except ValueError:
        raise InputError(f"{numbers.strip()!r} is not two numbers", field=field, hint="for example x=300:700") from None
    unit, most = ("deg", 360.0) if angle else ("mm", _MOST_ANYWHERE * 1e3)
    if not all(abs(value) <= most for value in pair):  # NaN fails, too
        raise InputError("is out of range", field=field, hint=f"valid: {-most:.0f} to {most:.0f} {unit}")
    if not pair[0] < pair[1]:
        raise InputError("the first number must be less than the second", field=field, hint=f"for example {name}=0:90")
    if angle and pair[1] - pair[0] > 360.0:
        raise InputError("is more than a whole turn", field=field, hint="for example turn=-180:180")
    scale = math.radians(1.0) if angle else 1e-3
    return name, (pair[0] * scale, pair[1] * scale)


def _name(problem: Problem, name: str, field: str) -> str:
    bed = problem.cell.positioner is None
    known = [each for each in FREEDOMS if not (bed and each in ON_A_TABLE)]
    if name in known:
        return name
    if name in ON_A_TABLE:
        raise InputError(f"{name} is for parts on a table", field=field, hint=f"on a bed: {', '.join(known)}")
    near = nearest_name(name, known)
    choices = f"choices: {', '.join(known)}"
    raise InputError(
        f"unknown coordinate {name!r}", field=field, hint=f"did you mean {near}? {choices}" if near else choices
    )


# ----------------------------------------------------------------------------------------------------
# The input of a placement study; any process can rebuild it from a few words, by reading the files itself.

COARSE = 40, np.radians(30.0)  # rungs and steps of the grid, for lattice and map
# For polishing; key: whether any joints are chosen, such as a table's.
FINE = {False: (120, np.radians(15.0)), True: (60, np.radians(20.0))}
FOOT_SHARE = 0.25  # × the reach: the space this near to the arm's first axis is taken by its foot


@dataclass(frozen=True)
class StudyRequest:
    """A request for a study, in the command's words; `problem` is a name or an absolute path."""

    problem: str
    overrides: tuple[str, ...] = ()
    strategy: str | None = None
    free: str | None = None
    ranges: tuple[str, ...] = ()


@dataclass(frozen=True)
class Surroundings:
    """Obstacles for any place of the part; none if a strategy ignores obstacles.

    nearly    obstacles for scores, the same for all places: on a bed, without fixtures
    exactly   all obstacles of a cell
    """

    nearly: Obstacles
    exactly: Callable[[Cell], Obstacles]


@dataclass(frozen=True)
class Site:
    """A problem whose part may be moved: `cell` was built with the part at `now`, `axes` are searched.

    Of repeated layers, only the first counts.
    """

    problem: Problem
    cell: Cell
    now: PartPlace
    axes: tuple[Axis, ...]
    strategy: str
    toolpath: Toolpath
    around: Surroundings
    guides: tuple[NozzleTask, ...]

    @cached_property
    def coarse(self) -> tuple[Course, ...]:
        """The path of each nozzle as sampled for lattice and map."""
        return courses_of(self.cell, self.guides, *COARSE, self.problem.resolve.rung)

    @cached_property
    def fine(self) -> tuple[Course, ...]:
        """The path of each nozzle as sampled for polishing."""
        return courses_of(self.cell, self.guides, *FINE[len(self.cell.chosen) > 0], self.problem.resolve.rung)

    @cached_property
    def digest(self) -> str:
        """Digest of the content of the files; see `digest_of`."""
        return digest_of(self.problem, self.cell, self.toolpath, self.guides)

    def at(self, point: Point) -> PartPlace:
        """The place of a point of the search."""
        return replace(self.now, **{axis.name: value for axis, value in zip(self.axes, point, strict=True)})

    def moved(self, point: Point) -> Cell:
        """The cell with the part at a point of the search."""
        return moved_cell(self.cell, self.now, self.at(point))

    def scored(self, courses: Sequence[Course], place: PartPlace, floor: float) -> float:
        """A place's score, the least over all nozzles; 0 if it is not above a floor."""
        moved = moved_cell(self.cell, self.now, place)
        if _at_the_foot(moved, courses) and place != self.now:
            return 0.0
        min_sigma, nearly = self.problem.resolve.min_sigma, self.around.nearly
        return min(score(moved, course, min_sigma, floor, nearly) for course in courses)

    def rated(self, cell: Cell) -> Rating:
        """The rating of the cell with the part at a place, for the nozzle with the least score."""
        min_sigma, nearly = self.problem.resolve.min_sigma, self.around.nearly
        return min((rate(cell, course, min_sigma, nearly) for course in self.fine), key=lambda rating: rating.score)


def site_of(asked: StudyRequest, problem: Problem, cell: Cell, axes: Sequence[Axis]) -> Site:
    """The site of a loaded problem. Raises InputError for mistakes in its files that concern the toolpath."""
    toolpath = build_toolpath(problem)
    strategy = asked.strategy or problem.strategy
    around = surroundings(strategy, problem, cell, toolpath)
    guides = tuple(guides_of(tasks_of(problem, toolpath))[0])
    return Site(problem, cell, place_of(problem), tuple(axes), strategy, toolpath, around, guides)


@lru_cache(maxsize=1)
def own_site(asked: StudyRequest, digest: str) -> Site:
    """The same site in another process. Raises InputError if its files have a different content there."""
    problem = load_problem(asked.problem, asked.overrides)
    cell = build_cell(problem)
    site = site_of(asked, problem, cell, axes_of(problem, cell, place_of(problem), asked.free, asked.ranges))
    check_same(problem, site.digest, digest)
    return site


def surroundings(strategy: str, problem: Problem, cell: Cell, toolpath: Toolpath) -> Surroundings:
    """The obstacles that a strategy avoids while it prints a toolpath.

    On a bed, fixtures are points in the part frame; as the part moves among them, they are found again for each place.
    """
    among = len(cell.holder) == 0 and len(cell.fixtures) > 0
    if strategy in UNAWARE:
        return Surroundings(NOTHING, lambda _: NOTHING)
    nearly = obstacles_of(problem, replace(cell, fixtures=()) if among else cell, toolpath)
    if among:
        return Surroundings(nearly, lambda moved: obstacles_of(problem, moved, toolpath))
    return Surroundings(nearly, nearly.of)


def _at_the_foot(cell: Cell, courses: Sequence[Course]) -> bool:
    """Whether path or holder base is near the arm's first axis, holder at home; never on a rail: the arm can leave."""
    if cell.rails:
        return False
    T_world_part = cell.holder.poses(cell.home[None, len(cell.arm) :])[0]
    tips = np.vstack([course.demand.tip[course.demand.rung] for course in courses])
    points = np.vstack([tips @ T_world_part[:3, :3].T + T_world_part[:3, 3], cell.T_world_holder_base[:3, 3]])
    axis = cell.arm.screws[0]
    nearest = np.linalg.norm(np.cross(points - axis[:3], axis[3:]), axis=1).min()
    return bool(nearest < FOOT_SHARE * reach(cell))
