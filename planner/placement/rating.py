"""How well a part stands: the margin that the best way over the whole path never falls below.

A posture's margin is the least of its distances from a singularity, from joint limits and from the wrist's flip, each
over the distance that is comfortable, times the share of the commanded speed that joints allow there. A way is as good
as its worst posture, and a placement as good as the best of all ways on a grid of roll, holder angle and branch, which
is found exactly: a greatest least margin can be found rung by rung.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.background import in_threads
from planner.cell import Cell, rigid_inverse
from planner.kinematics.inverse import kind_of
from planner.obstacles import NOTHING, Obstacles
from planner.placement.margin_kernel import (
    NO_WRIST,
    OFFSET,
    SPHERICAL,
    bottleneck,
    evaluate_margins,
    way_back,
)
from planner.readonly import Array
from planner.resolve.demand import Demand, demand_of
from planner.resolve.jointpath import JointPath
from planner.resolve.node_kernel import SIGMA_COMFORT
from planner.resolve.nodes import BRANCHES, full_grid, holder_around
from planner.resolve.search import ROUND
from planner.resolve.search_kernel import SPEED_SHARE
from planner.task import NozzleTask
from planner.timing import bound_time

ROOM_COMFORT = 0.175  # rad, 10 degrees, from joint limits and the wrist's flip: what a part 2 mm off takes is a tenth
COMFORT = np.array([SIGMA_COMFORT, ROOM_COMFORT, ROOM_COMFORT])
_SAMPLES = 16  # whose rates a rung answers for, at most
_SHARES = 0.9, 0.6, 0.0  # of the score without obstacles, above which the score with them is looked for
_PROBES = 12  # rungs that are tried first: where one of them is out of reach, so is the part
_SHARE_OF_BEADS = 4  # a bead has two rungs at least, so no more beads than this part of the rungs


@dataclass(frozen=True)
class Course:
    """What is looked at of a print, at one fineness (r rungs).

    demand             of some of the tasks, with its rungs
    samples (r, m)     whose rates a rung answers for, -1 where there are fewer
    probes (p)         rungs at the ends of the path, in every direction
    roll_step, holder_step   of the grid [rad]
    lacking (r, rolls)   at which rolls the head lacks clearance from part and print, wherever the part stands: 1 or 0, and
                         -1 where nobody has asked yet; of one cell's obstacles, which score and rate must be given
    """

    demand: Demand
    samples: NDArray[np.int64]
    probes: NDArray[np.int64]
    roll_step: float
    holder_step: float
    lacking: NDArray[np.int8]

    @property
    def at_probes(self) -> Course:
        """The probes alone, as one path."""
        at = self.probes
        return replace(
            self, demand=self.demand.only(at, [0, len(at)]), samples=self.samples[at], lacking=self.lacking[at]
        )


@dataclass(frozen=True)
class Rating:
    """A placement's score, and the worst of each of its terms along the way that has it.

    score          1 is comfortable everywhere, 0 out of reach
    sigma          smallest singular value of the arm's Jacobian
    limit, wrist   angles from joint limits and from the wrist's flip [rad]; wrist infinite for arms that have none
    share          of the commanded speed, where it is least
    place (3)      where the margin is least: nozzle tip on the part [m]
    """

    score: float
    sigma: float
    limit: float
    wrist: float
    share: float
    place: tuple[float, float, float]


def course_of(tasks: Sequence[NozzleTask], rungs: int, step: float, spacing: float) -> Course:
    """The path of some tasks, seen at about so many rungs `spacing` [m] apart at least, on a grid of `step` [rad]."""
    beads = _far_apart(tasks, max(rungs // _SHARE_OF_BEADS, 1))
    length = sum(float(task.s[-1] - task.s[0]) for task in beads)
    demand = demand_of(beads, max(length / max(rungs - len(beads), 1), spacing))
    widest = min(int((demand.stop - demand.start).max()), _SAMPLES)
    share = np.linspace(0.0, 1.0, widest)
    samples = np.round(demand.start[:, None] + share * (demand.stop - 1 - demand.start)[:, None]).astype(np.int64)
    samples[:, 1:][np.diff(samples, axis=1) == 0] = -1
    tip, z = demand.tip[demand.rung], demand.frames[demand.rung][:, :, 2]
    ends = np.concatenate([each.argmin(axis=0) for each in (tip, -tip, z, -z)])
    lacking = np.full((len(demand.rung), int(np.ceil(2.0 * np.pi / step - 1e-9))), -1, dtype=np.int8)
    return Course(demand, samples, np.unique(ends)[:_PROBES], step, step, lacking)


def _far_apart(tasks: Sequence[NozzleTask], count: int) -> list[NozzleTask]:
    """At most `count` tasks, in their order: the one farthest out, then always the one farthest from those taken."""
    if len(tasks) <= count:
        return list(tasks)
    middle = np.array([np.concatenate([task.tip.mean(axis=0), task.frames[:, :, 2].mean(axis=0)]) for task in tasks])
    scale = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # a radian counts as 0.1 m: that far the tip is from the wrist
    middle = middle * scale
    taken = [int(np.linalg.norm(middle - middle.mean(axis=0), axis=1).argmax())]
    away = np.linalg.norm(middle - middle[taken[0]], axis=1)
    while len(taken) < count:
        taken.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(middle - middle[taken[-1]], axis=1))
    return [tasks[i] for i in sorted(taken)]


def score(cell: Cell, course: Course, min_sigma: float, floor: float = 0.0, obstacles: Obstacles = NOTHING) -> float:
    """The margin that the best way over a course never falls below; 0 where there is no way above a floor.

    The higher the floor, the sooner it is known that a placement is not above it. Postures that lack clearance from
    obstacles do not count; these are given for any place of the part.
    """
    free = _score(cell, course, min_sigma, floor, NOTHING)
    if free <= floor or not obstacles.any:
        return free
    here = obstacles.of(cell)
    for share in _SHARES:  # most placements are clear, and few postures have so much margin: only they are looked at
        above = max(floor, share * free)
        found = _score(cell, course, min_sigma, above, here)
        if found > 0.0 or above == floor:
            return found
    return 0.0


def _score(cell: Cell, course: Course, min_sigma: float, floor: float, obstacles: Obstacles) -> float:
    _, terms, _, _ = _postures(cell, course.at_probes, floor, obstacles)
    if not (_margins(terms, min_sigma).max(axis=(1, 2, 3)) > floor).all():
        return 0.0
    worst, _, _ = best_worst(cell, course, min_sigma, floor, obstacles)
    return float(worst.min()) if worst.min() > floor else 0.0


def rate(cell: Cell, course: Course, min_sigma: float, obstacles: Obstacles = NOTHING) -> Rating:
    """The score of `score`, and the worst of each term along the way that has it."""
    above = (1.0 - 1e-6) * score(cell, course, min_sigma, 0.0, obstacles)
    worst, terms, picked = best_worst(cell, course, min_sigma, above, obstacles.of(cell))
    if worst.min() <= above:
        return Rating(0.0, 0.0, 0.0, 0.0, 0.0, (np.nan, np.nan, np.nan))
    along = terms[np.arange(len(picked)), picked[:, 0], picked[:, 1], picked[:, 2]].astype(float)
    sigma, limit, wrist, share = (float(term) for term in along.min(axis=0))
    at = course.demand.tip[course.demand.rung[_margins(along, min_sigma).argmin()]]
    return Rating(float(worst.min()), sigma, limit, wrist, share, (float(at[0]), float(at[1]), float(at[2])))


def score_of_paths(cell: Cell, paths: Sequence[JointPath]) -> float:
    """The score of joint paths that a strategy found: their least margin, times the share of the commanded speed that
    joints' speeds and accelerations allow over all of them."""
    na, least = len(cell.arm), np.inf
    ideal = bound = 0.0
    for path in paths:
        task = path.task
        laid = slice(task.first, task.last + 1)
        q = path.q[laid]
        jacobians = cell.arm.jacobians(q[:, :na])[:, :, list(cell.solved)]
        sigma = float(np.linalg.svd(jacobians, compute_uv=False)[:, -1].min())
        limit = float(np.minimum(q - cell.limits.q_min, cell.limits.q_max - q).min())
        wrist = float(np.abs(np.arcsin(np.sin(q[:, 4]))).min()) if na == 6 else np.inf
        least = min(least, float((np.array([sigma, limit, wrist]) / COMFORT).min()))
        ideal += float(task.s[task.last] - task.s[task.first]) / task.speed
        bound += bound_time(cell, path)
    return least * min(ideal / bound, 1.0)


def best_worst(
    cell: Cell, course: Course, min_sigma: float, floor: float, obstacles: Obstacles
) -> tuple[Array, NDArray[np.float32], NDArray[np.int64]]:
    """Best worst margin of each task, every posture's terms, and the nodes (r, 3) of the ways."""
    demand, limits, na = course.demand, cell.limits, len(cell.arm)
    q, terms, joint, holder_step = _postures(cell, course, floor, obstacles)
    speed = np.ones(na + 1)
    speed[:na] = limits.velocity[:na]
    if joint is not None:
        speed[na] = limits.velocity[joint]
    wraps = (limits.q_max - limits.q_min)[:na] >= ROUND
    margins = _margins(terms, min_sigma)
    came = np.full(margins.shape, 4, dtype=np.int8)
    worst, ends = bottleneck(
        q, margins, holder_step, demand.task_rungs, demand.time, SPEED_SHARE * speed, wraps, floor, came
    )
    picked = way_back(ends, came, demand.task_rungs) if worst.min() > floor else np.zeros((0, 3), dtype=np.int64)
    return worst, terms, picked


def _margins(terms: NDArray[np.float32], min_sigma: float) -> NDArray[np.float32]:
    """Margins (...) of postures with these terms (..., 4); 0 where sigma is too small or there is no posture."""
    least = (terms[..., :3] / COMFORT.astype(np.float32)).min(axis=-1) * terms[..., 3]
    return np.where(terms[..., 0] > min_sigma, least, np.float32(0.0))


def _postures(
    cell: Cell, course: Course, floor: float, obstacles: Obstacles
) -> tuple[NDArray[np.float32], NDArray[np.float32], int | None, float]:
    """Joints and terms of every posture (see `evaluate_margins`), the joint that is swept, and by what step [rad].

    Of several chosen joints the one next to the part is swept, the others rest at home.
    """
    demand = course.demand
    if demand.cones.tilt > 0.0:  # a lean may give the head its clearance from part and print
        obstacles = obstacles.but_head_on_part
    limits, na, nh = cell.limits, len(cell.arm), len(cell.holder)
    r = len(demand.rung)
    held = np.tile(cell.home[list(cell.chosen)], (r, 1))
    swept = max(nh - 1, 0) if cell.chosen else None
    grid = full_grid(demand, course.roll_step, course.holder_step, swept is not None, swept, held)
    sweeps = 0 if swept is None else (1 if swept < nh else 2)
    joint = None if swept is None else cell.chosen[swept]
    low, high = (-np.inf, np.inf) if joint is None else (limits.q_min[joint], limits.q_max[joint])
    T_before, axis, T_after = holder_around(cell, nh if swept is None else swept, held[:, :nh])
    redundant = cell.inverse.redundant_joint
    wrist = NO_WRIST if na != 6 else (SPHERICAL if cell.spherical else OFFSET)
    cone = min(demand.cones.layer_gravity, demand.cones.tilt + demand.cones.nozzle_gravity)
    q = np.zeros((r, grid.rolls, grid.holders, BRANCHES, na), dtype=np.float32)
    terms = np.zeros((r, grid.rolls, grid.holders, BRANCHES, 4), dtype=np.float32)
    arguments = (
        kind_of(cell.inverse), cell.inverse.parameters, np.array(cell.solved), -1 if redundant is None else redundant,
        wrist, rigid_inverse(cell.T_world_base), rigid_inverse(cell.T_flange_nozzle),
        cell.arm.placements, cell.arm.axes, cell.arm.T_last_tip,
        T_before, axis, T_after, sweeps, -1 if joint is None else joint, held[:, :nh].copy(), low, high,
        np.zeros(r) if redundant is None else held[:, nh].copy(),
        np.cos(min(cone, np.pi)) - 1e-9,
        limits.q_min[:na], limits.q_max[:na], limits.velocity[:na], limits.acceleration[:na],
        obstacles.table, demand.now, demand.tip, demand.frames, demand.twist, demand.rate, demand.weight, demand.rung, course.samples,
        grid.roll_step, grid.holder_step, COMFORT, floor, course.lacking, q, terms,
    )  # fmt: skip
    in_threads(lambda first, last: evaluate_margins(first, last, *arguments), r)
    return q, terms, joint, grid.holder_step
