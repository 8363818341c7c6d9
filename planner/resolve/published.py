"""As published: what the authors of the four papers did with the freedom that their paths leave.

Three ways, `resolve.published`: `turning_table` of Pollard et al., `fixed_heading` of Arigela et al., and `along_path`
of Tawfik et al. Onstein et al. have points and normals, but no turn about these: `fixed_heading` adds nothing to them.

All leave an angle to the programmer: the heading, by which the tool is turned about the nozzle. Where an axis that
could turn the part holds it still, the angle at which it does so is left as well. The papers say that their programs
were checked for reach and singularities, but not how these angles were found. Here, they are those nearest to the home
posture that pass such a check.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.base.singular_values import least_singular_values
from planner.cell.cell import Cell, rigid_inverse
from planner.cell.kinematics.chain import Chain
from planner.problem.settings import ResolveSpec
from planner.resolve.by_nozzle import with_each_nozzle
from planner.resolve.joint_path import JointPath, at_rest, choose_turns, gone_along, postures, turns_within, upright
from planner.toolpath.task import NozzleTask

SAMPLES = 500  # samples of the whole print on which angles are checked before its paths are made
_ROUNDING = 1e-9  # rad of an angle at an end of its range; also for singular values


@dataclass(frozen=True)
class _Course:
    """A task with the direction (n) [rad] of the path about the nozzle, from each frame's x."""

    task: NozzleTask
    along: Array


@dataclass(frozen=True)
class _Angles:
    """What is left to the programmer: the heading, and the angle at which the part is held, both from home [rad]."""

    heading: float
    held: float

    @property
    def away(self) -> float:
        """How far they are from home [rad]."""
        return abs(self.heading) + abs(self.held)


@with_each_nozzle
def as_published(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """The published way that `settings` names, on the home posture's branch.

    turning_table  the nozzle's direction in the world stays as at home, as closely as the table's last axis allows
                   (Pollard, eq. 2 and section 3); on a fixed bed the nozzle leans from home by the least turn.
                   Singularities are not checked, as in the paper.
    fixed_heading  the part is held, and the nozzle leans from its heading by the least turn (Arigela, section 2.3.2: on
                   a wing by turns about its span)
    along_path     the part is held, and the nozzle's x keeps its angle to the path (Tawfik, section III.A: planes along
                   it)

    A track, which none of them has, goes along with the nozzle. Raises the Refusal at home's own angles if no others
    work either.
    """
    way, turning = settings.published, settings.published == "turning_table"
    courses = [_Course(task, _along(task)) for task in tasks]
    held = np.zeros(1) if turning else _held(cell, settings.table_step)
    each = [_Angles(*pair) for pair in product(_around(settings.roll_step), held)]
    each.sort(key=lambda angles: angles.away)
    checked = _checked(cell, courses, way, each, 0.0 if turning else settings.min_sigma)
    for angles in chain(each[:1], checked) if turning else checked:
        try:
            return choose_turns(cell, _paths(cell, courses, way, angles))
        except Refusal:
            continue
    return choose_turns(cell, _paths(cell, courses, way, each[0]))


def _around(step: float) -> Array:
    """Angles [rad] over a whole turn, about `step` apart, 0 among them."""
    n = max(int(np.round(np.pi / step)), 1)
    return np.asarray(np.arange(1 - n, n + 1) * (np.pi / n))


def _held(cell: Cell, step: float) -> Array:
    """Angles [rad] from home at which the holder's last axis may hold the part: just 0 if it slides or is missing."""
    if not len(cell.holder) or cell.holder.slides[-1]:
        return np.zeros(1)
    angles = _around(step)
    at = cell.home[len(cell.arm) + len(cell.holder) - 1] + angles
    j = len(cell.limits.q_min) - 1
    return angles[(at >= cell.limits.q_min[j] - _ROUNDING) & (at <= cell.limits.q_max[j] + _ROUNDING)]


def _checked(
    cell: Cell, courses: Sequence[_Course], way: str, each: Sequence[_Angles], least: float
) -> Iterator[_Angles]:
    """Angles with which the arm can follow some of the samples.

    First, in order, those with a least singular value of at least `least`; then the others, the least singular first.
    """
    few, left = _thinned(courses), []
    for angles in each:
        try:
            paths = _paths(cell, few, way, angles)
            for path in paths:
                turns_within(cell, path)
        except Refusal:
            continue
        q = np.concatenate([path.q[:, : len(cell.arm)] for path in paths])
        sigma = float(least_singular_values(cell.arm.jacobians(q)[:, :, list(cell.solved)]).min())
        if sigma >= least:
            yield angles
        else:
            left.append((round(sigma / _ROUNDING), angles))
    yield from (angles for _, angles in sorted(left, key=lambda one: -one[0]))


def _thinned(courses: Sequence[_Course]) -> list[_Course]:
    """The courses at some of their samples, about `SAMPLES` in all, with the ends of each."""
    every = max(sum(len(course.task) for course in courses) // SAMPLES, 1)
    few = []
    for course in courses:
        task, n = course.task, len(course.task)
        k = np.unique([*range(0, n, every), task.first, task.last, n - 1])
        normals = None if task.true_normals is None else task.true_normals[k]
        first, last = np.searchsorted(k, [task.first, task.last]).tolist()
        at = replace(
            task, tip=task.tip[k], frames=task.frames[k], s=task.s[k], first=first, last=last, true_normals=normals
        )
        few.append(_Course(at, course.along[k]))
    return few


def _paths(cell: Cell, courses: Sequence[_Course], way: str, angles: _Angles) -> list[JointPath]:
    """Paths on home's branch, whole turns still to be chosen; raises Refusal where there is no posture."""
    branch = int(cell.inverse.branches(cell.home[None, : len(cell.arm)])[0])
    paths, offset = [], 0.0
    for i, course in enumerate(courses):
        task = course.task
        chosen = _chosen(cell, task, way, angles.held)
        roll = _home_roll(cell, task, chosen)
        if way == "along_path":  # nearest to home where the print begins
            offset = float(roll[task.first] - course.along[task.first]) if i == 0 else offset
            roll = course.along + offset
        roll = roll + angles.heading
        paths.append(JointPath(task, roll, upright(task), postures(cell, task, roll, chosen, branch), branch))
    return paths


def _along(task: NozzleTask) -> Array:
    """Direction (n) of the path about the nozzle [rad], from the frames' x, continuous."""
    step = np.gradient(task.tip, axis=0)
    x, y = (np.einsum("ij,ij->i", step, task.frames[:, :, k]) for k in (0, 1))
    return np.unwrap(np.arctan2(y, x))


def _home_roll(cell: Cell, task: NozzleTask, chosen: Array) -> Array:
    """Roll (n), continuous, that brings the nozzle nearest to its orientation at home: by the least turn."""
    R_home = cell.arm.poses(cell.home[None, : len(cell.arm)])[0, :3, :3]
    R_world_part = cell.holder.poses(chosen[:, : len(cell.holder)])[:, :3, :3]
    # the roll that brings the nozzle's x and y closest to home's: maximises the trace of R_home^T R
    M = np.einsum("ji,njk->nik", R_home, R_world_part @ task.frames)
    return -np.unwrap(np.arctan2(M[:, 1, 0] - M[:, 0, 1], M[:, 0, 0] + M[:, 1, 1]))


def _chosen(cell: Cell, task: NozzleTask, way: str, held: float) -> Array:
    """Chosen joints (n, k): at home, except the holder's last axis, `held` [rad] from there or turning, and tracks."""
    nh = len(cell.holder)
    chosen = np.tile(at_rest(cell), (len(task), 1))
    turns = nh > 0 and not cell.holder.slides[-1]
    if turns and way == "turning_table":
        chosen[:, nh - 1] = _turn_to_face(cell, task, chosen)
    elif turns:
        chosen[:, nh - 1] += held
    T_world_part = cell.holder.poses(chosen[:, :nh])
    tip = np.einsum("nij,nj->ni", T_world_part[:, :3, :3], task.tip) + T_world_part[:, :3, 3]
    chosen[:, nh:] = gone_along(cell, tip)
    return chosen


def _turn_to_face(cell: Cell, task: NozzleTask, chosen: Array) -> Array:
    """Angles (n) of the holder's last axis that turn the nozzle axis closest to its direction at home in the world, the
    other axes as in `chosen`."""
    nh = len(cell.holder)
    direction = cell.arm.poses(cell.home[None, : len(cell.arm)])[0, :3, 2]
    before = Chain(
        cell.holder.names[:-1], cell.holder.placements[:-1], cell.holder.axes[:-1], cell.holder.placements[-1]
    )
    T_before, k = before.poses(chosen[:1, : nh - 1])[0], cell.holder.axes[-1, :3]
    R_after = cell.holder.T_last_tip[:3, :3]
    a = task.frames[:, :, 2] @ R_after.T  # nozzle axis in the turning frame
    d = rigid_inverse(T_before)[:3, :3] @ direction
    a = a - (a @ k)[:, None] * k
    d = d - (d @ k) * k
    sine, cosine = np.cross(a, d) @ k, a @ d
    return np.unwrap(np.arctan2(sine, cosine))
