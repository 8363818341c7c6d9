"""How good a placement is: the margin that the best way over the whole path never falls below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Ints
from planner.base.compiled import inner_njit, njit
from planner.base.geometry import TURN
from planner.base.processes import in_threads
from planner.cell.cell import Cell
from planner.cell.kinematics.chain import chain_state, largest_singular_value, pose_of
from planner.cell.kinematics.inverse import SPHERICAL_WRIST, branches_of, solve_one
from planner.collision.scene import NOTHING, Obstacles
from planner.collision.table import workspace_for
from planner.motion.timing.timed_path import bound_time
from planner.resolve.by_nozzle import nozzles_of
from planner.resolve.joint_path import JointPath, SampledTasks, at_rest, sample_tasks
from planner.resolve.nodes import full_grid
from planner.resolve.prices import SIGMA_COMFORT
from planner.resolve.reach import (
    angle_in_range,
    arm_limits,
    arm_numbers,
    flange_pose,
    grid_scale,
    inverse_in_part,
    lacks_clearance,
    nearest_turns,
    part_pose,
    room_for_poses,
    rung_numbers,
    swept_joint,
)
from planner.resolve.search import SPEED_SHARE
from planner.toolpath.task import NozzleTask

# ----------------------------------------------------------------------------------------------------
# Compiled kernels of a placement's score: the margin of every posture, and the best worst case of any way through them.

NO_WRIST, SPHERICAL, OFFSET = 0, 1, 2  # how joint 5 measures the wrist's distance from its singularity


@inner_njit
def _speed_share(Ji, solved, twist, rate, weight, samples, v_max, a_max) -> float:
    """Mean share of the commanded speed that the joints' speed and acceleration limits allow over some samples.

    Ji (6, 6): the Jacobian's inverse at one posture; samples: indices, padded with -1.
    """
    time, needed = 0.0, 0.0
    for i in samples:
        if i < 0 or weight[i] == 0.0:
            continue
        most = 1.0  # of the squared commanded speed
        for k in range(6):
            j = solved[k]
            speed, acceleration = 0.0, 0.0
            for m in range(6):
                speed += Ji[k, m] * twist[i, m]
                acceleration += Ji[k, m] * rate[i, m]
            if speed * speed * most > v_max[j] * v_max[j]:
                most = (v_max[j] / speed) ** 2
            if abs(acceleration) * most > a_max[j]:
                most = a_max[j] / abs(acceleration)
        time += weight[i]
        needed += weight[i] / np.sqrt(most)
    return time / needed if time > 0.0 else 1.0


@inner_njit
def _least_angle(q, q_min, q_max, turns) -> float:
    """The least angle [rad] between a revolute joint and the ends of its range, at a posture q (na)."""
    least = np.inf
    for j in range(q.size):
        if turns[j]:
            least = min(least, min(q[j] - q_min[j], q_max[j] - q[j]))
    return least


class MarginsAsked(NamedTuple):
    """The requirements on postures.

    samples (r, m)   samples whose rates each rung represents, padded with -1
    wrist            how joint 5 measures the wrist's distance from its singularity: NO_WRIST, SPHERICAL or OFFSET
    fifth            index of joint 5 among the arm's
    comfort (3)      comfortable values of sigma, angle to a limit and wrist's angle [rad]
    floor            for these terms over comfort: a posture with one that is not above it does not count
    upright          least cosine of the angle between the layer's normal and the vertical
    straight         angle of joint 5 when the wrist is straight [rad]
    """

    samples: Ints
    wrist: int
    fifth: int
    comfort: Array
    floor: float
    upright: float
    straight: float


class MarginsFilled(NamedTuple):
    """Output arrays: joints q (r, rolls, holders, 8, na) [rad] and terms (r, rolls, holders, 8, 4) of every posture,
    and lacking (r, rolls), see `Course`."""

    q: NDArray[np.float32]
    terms: NDArray[np.float32]
    lacking: NDArray[np.int8]


@njit
def evaluate_margins(first, last, arm, limits, swept, grid, rungs, table, asked, out) -> None:
    """Fill in `out` for every posture of rungs first .. last; poses and clearance are as in the ladder's nodes.

    arm: ArmNumbers, limits: ArmLimits, swept: SweptJoint, grid: GridNumbers, rungs: RungNumbers, table: Table of the
    obstacles, asked: MarginsAsked, out: MarginsFilled
    terms are sigma, the least angle to a joint's limit, the wrist's angle [rad], and the share of the commanded speed.
    sigma stays 0 where there is no posture, or where it is not clear of obstacles, or where one of its first three
    terms over comfort is not above floor.
    """
    kind, solver, q_min, q_max, v_max, a_max = (
        arm.kind,
        arm.solver,
        limits.q_min,
        limits.q_max,
        limits.v_max,
        limits.a_max,
    )
    comfort, floor, q_out, terms = asked.comfort, asked.floor, out.q, out.terms
    n_rolls, n_holders, na = q_out.shape[1], q_out.shape[2], q_out.shape[4]
    middle = 0.5 * (q_min + q_max)
    crowded = len(table.pair) + len(table.look) > 0
    slots = branches_of(kind)
    room = room_for_poses(na, swept.holder.shape[1], slots)
    branch_q, ok, J, J6, Jp, Ji = room.postures, room.ok, room.J, room.J6, room.Jp, room.Ji
    R, z_axis, T_world_task, T_rolled = room.R, room.z_axis, room.T_world_task, room.T_rolled
    T_world_part, T_base_nozzle, T_base_flange = room.T_world_part, room.T_base_nozzle, room.T_base_flange
    origins, directions, posture = room.origins, room.directions, room.posture
    placements, axes, T_last_tip, p, solved = arm.placements, arm.axes, arm.T_last_tip, arm.parameters, arm.solved
    T_base_world, T_nozzle_flange = arm.T_base_world, arm.T_nozzle_flange
    twist, rate, weight, samples = rungs.twist, rungs.rate, rungs.weight, asked.samples
    roll_from, redundant = grid.roll_from, swept.redundant
    known, sigmas, shares = np.empty(slots, dtype=np.bool_), np.empty(slots), np.empty(slots)
    for r in range(first, last):
        given = redundant[r].copy()
        bodies = workspace_for(table)  # one per rung: what it remembered of others would depend on the threads
        now, lacking = rungs.now[rungs.rung[r]], out.lacking[r]
        for h in range(swept.holder.shape[1]):
            posture[0, na + h] = swept.holder[r, h]
        pose_of(rungs.frames[rungs.rung[r]], rungs.tip[rungs.rung[r]], room.T_part_task)
        for b in range(n_holders):
            angle, inside = angle_in_range(swept, (grid.holder_from[r] + b) * grid.holder_step)
            if not inside:
                continue
            if swept.sweeps == 1:
                posture[0, swept.joint] = angle
            part_pose(swept, r, angle, room)
            if -T_world_task[2, 2] < asked.upright:
                continue
            for a in range(n_rolls):
                roll = (roll_from[r] + a) * grid.roll_step
                flange_pose(
                    T_base_world, T_nozzle_flange, T_world_task, z_axis, roll, R, T_rolled, T_base_nozzle, T_base_flange
                )
                if swept.sweeps >= 2:
                    given[swept.sweeps - 2] = angle
                solve_one(kind, solver, p, given, T_base_flange, branch_q, ok)
                known[:] = False
                for c in range(slots):
                    if not ok[c]:
                        continue
                    room_left = nearest_turns(branch_q[c], middle, q_min, q_max, limits.turns)
                    away, wrist = _least_angle(branch_q[c], q_min, q_max, limits.turns), np.inf
                    if asked.wrist == SPHERICAL:
                        wrist = abs(branch_q[c, asked.fifth])
                    elif asked.wrist == OFFSET:
                        wrist = np.arcsin(abs(np.sin(branch_q[c, asked.fifth] - asked.straight)))
                    if room_left < limits.room or away <= floor * comfort[1] or wrist <= floor * comfort[2]:
                        continue
                    # a flipped spherical wrist has the same axes, one of them reversed: the same rates and sigma
                    pair = c // 2 if kind == SPHERICAL_WRIST else c
                    if not known[pair]:
                        sigmas[pair], shares[pair] = 0.0, 0.0
                        chain_state(placements, axes, T_last_tip, branch_q[c], origins, directions, T_rolled)
                        if inverse_in_part(origins, directions, solved, T_world_part, T_world_task, J, Jp, Ji):
                            sigmas[pair] = 1.0 / largest_singular_value(Ji, J6, Jp)
                        if sigmas[pair] > floor * comfort[0]:
                            shares[pair] = _speed_share(Ji, solved, twist, rate, weight, samples[r], v_max, a_max)
                        known[pair] = True
                    if sigmas[pair] <= floor * comfort[0]:
                        continue
                    if crowded and lacks_clearance(table, bodies, posture, branch_q[c], now, lacking, a):
                        continue
                    own = terms[r, a, b, c]
                    own[0], own[1], own[2], own[3] = sigmas[pair], away, wrist, shares[pair]
                    for j in range(na):
                        q_out[r, a, b, c, j] = branch_q[c, j]


@inner_njit
def _reachable_in(q0, q1, turn: float, time: float, v: Array, wraps: NDArray[np.bool_]) -> bool:
    """Whether the joints can go from q0 to q1 (na), and the swept one by `turn`, in a time [s] at speeds v (na + 1)."""
    if abs(turn) > v[wraps.size] * time:
        return False
    for j in range(wraps.size):
        d = abs(float(q1[j]) - float(q0[j]))
        if wraps[j]:
            d = abs(d - 2.0 * np.pi * np.rint(d / (2.0 * np.pi)))
        if d > v[j] * time:
            return False
    return True


@njit
def bottleneck(q, margin, holder_step, task_rungs, time, v, wraps, floor, came):
    """Greatest margin that some way along each task never falls below (tasks), 0 without one; its last nodes.

    margin (r, rolls, holders, 8): 0 or less where there is no posture. A way keeps its branch and changes roll and
    holder, both periodic, by at most one step from rung to rung, and no faster than the joints can. The search ends at
    the first task whose margin is not above floor. came (like margin) is filled with the step by which each node was
    reached: 3 (roll step + 1) + holder step + 1.
    """
    A, B, C = margin.shape[1], margin.shape[2], margin.shape[3]
    n = task_rungs.size - 1
    out = np.zeros(n)
    ends = np.full(n, -1, dtype=np.int64)
    for task in range(n):
        first = task_rungs[task]
        best = margin[first].copy()
        for r in range(first + 1, task_rungs[task + 1]):
            arrived = best
            best = np.zeros((A, B, C), dtype=np.float32)
            for a in range(A):
                for b in range(B):
                    for c in range(C):
                        own = margin[r, a, b, c]
                        if own <= 0.0:
                            continue
                        least = np.float32(0.0)
                        for step in (4, 1, 7, 3, 5, 0, 2, 6, 8):  # no change first: the calmest of equals
                            da, db = step // 3 - 1, step % 3 - 1
                            if (db != 0 and B == 1) or (da != 0 and A == 1):
                                continue
                            a0, b0 = (a - da) % A, (b - db) % B
                            through = min(arrived[a0, b0, c], own)
                            if through <= least:
                                continue
                            if _reachable_in(q[r - 1, a0, b0, c], q[r, a, b, c], db * holder_step, time[r], v, wraps):
                                least = through
                                came[r, a, b, c] = step
                        best[a, b, c] = least
        ends[task] = best.argmax()
        out[task] = best.max()
        if out[task] <= floor:
            break
    return out, ends


@njit
def way_back(ends, came, task_rungs):
    """Nodes (r, 3), as roll, holder and branch, of the ways that `bottleneck` found."""
    A, B, C = came.shape[1], came.shape[2], came.shape[3]
    picked = np.empty((task_rungs[-1], 3), dtype=np.int64)
    for task in range(ends.size):
        k = ends[task]
        a, b, c = k // (B * C), (k // C) % B, k % C
        for r in range(task_rungs[task + 1] - 1, task_rungs[task] - 1, -1):
            picked[r, 0], picked[r, 1], picked[r, 2] = a, b, c
            if r > task_rungs[task]:
                step = came[r, a, b, c]
                a, b = (a - (step // 3 - 1)) % A, (b - (step % 3 - 1)) % B
    return picked


# ----------------------------------------------------------------------------------------------------
# How good a placement is: the margin that the best way over the whole path never falls below.
#
# A posture's margin is the least of its distances from a singularity, from joint limits and from the wrist's flip, each
# divided by a comfortable distance, times the share of the commanded speed that the joints allow there. A way is as
# good as its worst posture, and a placement as good as the best of all ways on a grid of roll, holder angle and branch.
# That is found exactly, since the greatest least margin can be computed rung by rung.

ROOM_COMFORT = 0.175  # rad (10 deg) from joint limits and the wrist's flip: a part 2 mm off takes a tenth of it
COMFORT = np.array([SIGMA_COMFORT, ROOM_COMFORT, ROOM_COMFORT])
_SAMPLES = 16  # most samples whose rates a rung represents
_SHARES = 0.9, 0.6, 0.0  # × the score without obstacles: floors, in turn, of the search for the score with them
_PROBES = 12  # rungs tried first: if one of them is out of reach, so is the part
_SHARE_OF_BEADS = 4  # rungs per bead at least, on average: a bead has two or more


@dataclass(frozen=True)
class Course:
    """A print as sampled for a study, at one resolution (r rungs).

    demand             of some of the tasks, with its rungs
    samples (r, m)     samples whose rates each rung represents, padded with -1
    probes (p)         rungs at the extremes of the path, in every direction
    roll_step, holder_step   of the grid [rad]
    lacking (r, rolls)   whether the head at each roll lacks clearance from part and print, wherever the part stands: 1
                         or 0, or -1 if not known yet; valid for one cell's obstacles, which score and rate must be
                         given
    nozzle             which of several nozzles follows it
    """

    demand: SampledTasks
    samples: NDArray[np.int64]
    probes: NDArray[np.int64]
    roll_step: float
    holder_step: float
    lacking: NDArray[np.int8]
    nozzle: int = 0

    @property
    def at_probes(self) -> Course:
        """Only the probes, as one path."""
        at = self.probes
        return replace(
            self, demand=self.demand.only(at, [0, len(at)]), samples=self.samples[at], lacking=self.lacking[at]
        )


@dataclass(frozen=True)
class Rating:
    """A placement's score, and the worst of each of its terms along the way with that score.

    score          1: comfortable everywhere, 0: out of reach
    sigma          smallest singular value of the arm's Jacobian
    limit, wrist   angles from joint limits and from the wrist's flip [rad]; wrist is infinite for arms without one
    share          least share of the commanded speed
    place (3)      nozzle tip on the part where the margin is least [m]
    """

    score: float
    sigma: float
    limit: float
    wrist: float
    share: float
    place: tuple[float, float, float]


def courses_of(cell: Cell, tasks: Sequence[NozzleTask], rungs: int, step: float, spacing: float) -> tuple[Course, ...]:
    """The course of each nozzle in use, see `course_of`."""
    return tuple(
        replace(course_of([tasks[i] for i in which], rungs, step, spacing), nozzle=own.in_use)
        for own, which in nozzles_of(cell, tasks)
    )


def course_of(tasks: Sequence[NozzleTask], rungs: int, step: float, spacing: float) -> Course:
    """The path of some tasks at about `rungs` rungs, at least `spacing` [m] apart, on a grid of `step` [rad]."""
    beads = _far_apart(tasks, max(rungs // _SHARE_OF_BEADS, 1))
    length = sum(float(task.s[-1] - task.s[0]) for task in beads)
    demand = sample_tasks(beads, max(length / max(rungs - len(beads), 1), spacing))
    widest = min(int((demand.stop - demand.start).max()), _SAMPLES)
    share = np.linspace(0.0, 1.0, widest)
    samples = np.round(demand.start[:, None] + share * (demand.stop - 1 - demand.start)[:, None]).astype(np.int64)
    samples[:, 1:][np.diff(samples, axis=1) == 0] = -1
    tip, z = demand.tip[demand.rung], demand.frames[demand.rung][:, :, 2]
    ends = np.concatenate([each.argmin(axis=0) for each in (tip, -tip, z, -z)])
    lacking = np.full((len(demand.rung), int(np.ceil(2.0 * np.pi / step - 1e-9))), -1, dtype=np.int8)
    return Course(demand, samples, np.unique(ends)[:_PROBES], step, step, lacking)


def _far_apart(tasks: Sequence[NozzleTask], count: int) -> list[NozzleTask]:
    """At most `count` tasks, in their order: the farthest out, then repeatedly the farthest from those taken."""
    if len(tasks) <= count:
        return list(tasks)
    middle = np.array([np.concatenate([task.tip.mean(axis=0), task.frames[:, :, 2].mean(axis=0)]) for task in tasks])
    scale = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # a radian counts as 0.1 m, the tip's distance from the wrist
    middle = middle * scale
    taken = [int(np.linalg.norm(middle - middle.mean(axis=0), axis=1).argmax())]
    away = np.linalg.norm(middle - middle[taken[0]], axis=1)
    while len(taken) < count:
        taken.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(middle - middle[taken[-1]], axis=1))
    return [tasks[i] for i in sorted(taken)]


def score(cell: Cell, course: Course, min_sigma: float, floor: float = 0.0, obstacles: Obstacles = NOTHING) -> float:
    """The margin that the best way over a course never falls below; 0 where there is no way above a floor.

    The higher the floor, the sooner a placement below it is rejected. Postures that lack clearance from obstacles do
    not count; obstacles are given for any place of the part.
    """
    cell = cell.with_nozzle(course.nozzle)
    free = _score(cell, course, min_sigma, floor, NOTHING)
    if free <= floor or not obstacles.any:
        return free
    here = obstacles.of(cell)
    for share in _SHARES:  # most placements are clear, and few postures exceed a high floor: only these are checked
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
    """The score as by `score`, and the worst of each term along the way with that score."""
    cell = cell.with_nozzle(course.nozzle)
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
    the joints' speed and acceleration limits allow over all of them."""
    na, least = len(cell.arm), np.inf
    ideal = bound = 0.0
    for path in paths:
        task = path.task
        laid = slice(task.first, task.last + 1)
        q = path.q[laid]
        jacobians = cell.at(task.material).arm.jacobians(q[:, :na])[:, :, list(cell.solved)]
        sigma = float(np.linalg.svd(jacobians, compute_uv=False)[:, -1].min())
        limit = float(np.minimum(q - cell.limits.q_min, cell.limits.q_max - q)[:, cell.limits.turns].min())
        bent = q[:, cell.rails + 4] - cell.straight_at
        wrist = float(np.abs(np.arcsin(np.sin(bent))).min()) if cell.straightens else np.inf
        least = min(least, float((np.array([sigma, limit, wrist]) / COMFORT).min()))
        ideal += float(task.s[task.last] - task.s[task.first]) / task.speed
        bound += bound_time(cell, path)
    return least * min(ideal / bound, 1.0)


def best_worst(
    cell: Cell, course: Course, min_sigma: float, floor: float, obstacles: Obstacles
) -> tuple[Array, NDArray[np.float32], NDArray[np.int64]]:
    """The best worst-case margin of each task, every posture's terms, and the nodes (r, 3) of the ways."""
    demand, limits, na = course.demand, cell.limits, len(cell.arm)
    q, terms, joint, holder_step = _postures(cell, course, floor, obstacles)
    speed = np.ones(na + 1)
    speed[:na] = limits.velocity[:na]
    if joint is not None:
        speed[na] = limits.velocity[joint] / grid_scale(limits, joint)[1]
    wraps = limits.turns[:na] & ((limits.q_max - limits.q_min)[:na] > TURN)
    margins = _margins(terms, min_sigma)
    came = np.full(margins.shape, 4, dtype=np.int8)
    worst, ends = bottleneck(
        q, margins, holder_step, demand.task_rungs, demand.time, SPEED_SHARE * speed, wraps, floor, came
    )
    picked = way_back(ends, came, demand.task_rungs) if worst.min() > floor else np.zeros((0, 3), dtype=np.int64)
    return worst, terms, picked


def _margins(terms: NDArray[np.float32], min_sigma: float) -> NDArray[np.float32]:
    """Margins (...) of postures with terms (..., 4); 0 where sigma is too small or there is no posture."""
    least = (terms[..., :3] / COMFORT.astype(np.float32)).min(axis=-1) * terms[..., 3]
    return np.where(terms[..., 0] > min_sigma, least, np.float32(0.0))


def _postures(
    cell: Cell, course: Course, floor: float, obstacles: Obstacles
) -> tuple[NDArray[np.float32], NDArray[np.float32], int | None, float]:
    """Joints and terms of every posture (see `evaluate_margins`), the swept joint, and its step [rad].

    Of several chosen joints, the one next to the part is swept; the others rest at home.
    """
    demand = course.demand
    if demand.cones.tilt > 0.0:  # leaning may give the head its clearance from part and print
        obstacles = obstacles.but_head_on_part
    r, na, nh = len(demand.rung), len(cell.arm), len(cell.holder)
    held = np.tile(at_rest(cell), (r, 1))
    index = max(nh - 1, 0) if cell.chosen else None
    grid = full_grid(
        demand, cell.inverse.branch_count, course.roll_step, course.holder_step, index is not None, index, held
    )
    swept = swept_joint(cell, index, held)
    wrist = NO_WRIST if not cell.straightens else (SPHERICAL if cell.spherical else OFFSET)
    cone = min(demand.cones.layer_gravity, demand.cones.tilt + demand.cones.nozzle_gravity)
    upright = float(np.cos(min(cone, np.pi)) - 1e-9)
    q = np.zeros((r, grid.rolls, grid.holders, cell.inverse.branch_count, na), dtype=np.float32)
    terms = np.zeros((r, grid.rolls, grid.holders, cell.inverse.branch_count, 4), dtype=np.float32)
    arguments = (
        arm_numbers(cell), arm_limits(cell), swept, grid.numbers, rung_numbers(demand), obstacles.table,
        MarginsAsked(course.samples, wrist, cell.rails + 4, COMFORT, float(floor), upright, cell.straight_at),
        MarginsFilled(q, terms, course.lacking),
    )  # fmt: skip
    in_threads(lambda first, last: evaluate_margins(first, last, *arguments), r)
    return q, terms, swept.joint if swept.joint >= 0 else None, grid.holder_step
