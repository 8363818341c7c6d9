"""The judge of all planners, ours among them: joints at the waypoints -> what they do, timed and verified alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.rows import Row, at_waypoints, judged
from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.collision.scene import NOTHING, Obstacles
from planner.motion.timing.timed_path import time_path
from planner.plan import Trajectory
from planner.planning.context import PlanningContext
from planner.planning.options import DEFAULT_DT
from planner.planning.pipeline import trajectory_of
from planner.resolve.joint_path import JointPath
from planner.verify.checks import SPEED_TOLERANCE
from planner.verify.verdict import AXIS_TOLERANCE, POSITION_TOLERANCE, Report, verify

BETWEEN = 5.0  # times what is allowed at waypoints: how far tip and axis may stray between two of them
FRACTIONS = (0.25, 0.5, 0.75)  # of the way between two waypoints
PATH_COLUMNS = (
    "holds", "holds_reason", "off_waypoints_mm", "off_waypoints_deg", "off_between_mm", "off_between_deg",
    "path_joint_step_max_rad", "path_limit_margin_rad", "path_sigma_min",
)  # fmt: skip
# In the names of checks on distances from cell and print, of which no peer was told anything.
UNTOLD = "clear of"


@dataclass(frozen=True)
class Timed:
    """What the joints of all beads become: the trajectory and what the verifier says of it."""

    trajectory: Trajectory
    report: Report


def paths_of(given: PlanningContext, beads: Sequence[Array]) -> tuple[JointPath, ...]:
    """Joint paths of joints (n, nj) at the waypoints of each bead. Raises ValueError for other numbers of them."""
    if len(beads) != len(given.tasks):
        raise ValueError(f"joints of {len(beads)} beads, not {len(given.tasks)}")
    paths = []
    for task, q in zip(given.tasks, beads, strict=True):
        if q.shape != (len(task), len(given.cell.joint_names)):
            raise ValueError(f"bead {task.bead}: joints {q.shape}, not {(len(task), len(given.cell.joint_names))}")
        if not np.isfinite(q).all():
            raise ValueError(f"bead {task.bead}: joints that are no finite numbers")
        branch = int(given.cell.inverse.branches(q[:1, : len(given.cell.arm)])[0])
        paths.append(JointPath(task, np.zeros(len(q)), np.zeros((len(q), 2)), q, branch))
    return tuple(paths)


def path_facts(given: PlanningContext, beads: Sequence[Array]) -> Row:
    """What joints are at the waypoints, and between them by linear interpolation, as a controller moves them.

    A path holds if tip and axis are within the verifier's tolerances at every waypoint and within BETWEEN times these
    between them, of the straight line there, and all joints are within their ranges: nothing of time, jerk or dips.
    """
    cell, na, turns = given.cell, len(given.cell.arm), given.cell.limits.turns
    off, turned, off_between, turned_between, step = 0.0, 0.0, 0.0, 0.0, 0.0
    beyond, margin, sigma = -np.inf, np.inf, np.inf
    for task, q in zip(given.tasks, beads, strict=True):
        T = cell.T_part_nozzle(q)
        off = max(off, float(np.linalg.norm(T[:, :3, 3] - task.tip, axis=1).max()))
        turned = max(turned, _angle(T[:, :3, 2], task.frames[:, :, 2]))
        for f in FRACTIONS:
            T_between = cell.T_part_nozzle((1.0 - f) * q[:-1] + f * q[1:])
            line = (1.0 - f) * T[:-1, :3, 2:] + f * T[1:, :3, 2:]  # axis and tip
            off_between = max(off_between, float(np.linalg.norm(T_between[:, :3, 3] - line[:, :, 1], axis=1).max()))
            turned_between = max(turned_between, _angle(T_between[:, :3, 2], line[:, :, 0]))
        step = max(step, float(np.abs(np.diff(q[:, turns], axis=0)).max()))
        room = np.minimum(q - cell.limits.q_min, cell.limits.q_max - q)
        beyond, margin = max(beyond, float(-room.min())), min(margin, float(room[:, turns].min()))
        jacobians = cell.arm.jacobians(q[:, :na])
        sigma = min(sigma, float(np.linalg.svd(jacobians, compute_uv=False)[:, -1].min()))
    broken = [
        f"{name} {value:.4g} {unit}"
        for name, value, limit, unit in (
            ("off at waypoints", off * 1e3, POSITION_TOLERANCE * 1e3, "mm"),
            ("axis at waypoints", np.degrees(turned), np.degrees(AXIS_TOLERANCE), "deg"),
            ("off between", off_between * 1e3, BETWEEN * POSITION_TOLERANCE * 1e3, "mm"),
            ("axis between", np.degrees(turned_between), BETWEEN * np.degrees(AXIS_TOLERANCE), "deg"),
            ("beyond a joint's range by", beyond, 0.0, "rad or m"),
        )
        if value > limit
    ]
    values = (off * 1e3, np.degrees(turned), off_between * 1e3, np.degrees(turned_between), step, margin, sigma)
    return dict(zip(PATH_COLUMNS, (not broken, ", ".join(broken), *map(float, values)), strict=True))


def _angle(a: Array, b: Array) -> float:
    """Largest angle between rows of a and b (n, 3), which need not be unit vectors [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)).max())


def finish(given: PlanningContext, paths: Sequence[JointPath], stages: Stages, obstacles: Obstacles = NOTHING) -> Timed:
    """Time joint paths, plan the travel between them and verify all of it, as planning does.

    Raises Refusal where no travel is found, or a path turns back on itself.
    """
    problem, cell, toolpath = given.problem, given.cell, given.toolpath
    with stages.stage("timing"):
        trajectory, _ = trajectory_of(problem, cell, toolpath, paths, obstacles, DEFAULT_DT, second_process=True)
    with stages.stage("verify"):
        report = verify(problem, cell, toolpath, trajectory, given.body)
    return Timed(trajectory, report)


def judge(given: PlanningContext, beads: Sequence[Array], told: bool = False) -> Row:
    """Of joints (n, nj) at the waypoints of each bead: all that a row says of them, in columns of both tables.

    Among it the seconds that timing, travel and verification took, which whoever planned the joints has yet to do.

    told: whoever planned them knew of the bodies around, so that distances from them count, too.
    """
    try:
        paths = paths_of(given, beads)
    except ValueError as error:
        return {"found": False, "verified": False, "reason": str(error)}
    facts, stages = path_facts(given, beads), Stages()
    try:
        timed = finish(given, paths, stages)
    except Refusal as refusal:
        row: Row = {"found": True, "verified": False, "reason": f"cannot be timed or left: {refusal}", **facts}
        return row | speeds(given, paths)
    seconds: Row = {f"seconds_{stage}": value for stage, value in stages.seconds.items()}
    return {"found": True, **facts, **seconds, **verdict(given, timed, told)}


def speeds(given: PlanningContext, paths: Sequence[JointPath]) -> Row:
    """How fast joint paths can be followed, of paths between which there is no travel; empty if they cannot."""
    commanded, laid, at_speed, seconds = given.problem.process.speed, 0.0, 0.0, 0.0
    try:
        timed = [time_path(given.cell, path) for path in paths]
    except Refusal:
        return {}
    for path, bead in zip(timed, given.toolpath.beads, strict=True):
        s = path.at(np.arange(0.0, path.duration, DEFAULT_DT))[1]
        step = np.diff(s[(s >= 0.0) & (s <= bead.length)])
        laid, seconds = laid + float(step.sum()), seconds + len(step) * DEFAULT_DT
        kept = np.abs(step / DEFAULT_DT / commanded - 1.0) <= SPEED_TOLERANCE
        at_speed += float(step[kept].sum())
    return {"deposition_time_s": seconds, "at_speed_fraction": at_speed / laid if laid else 0.0}


def verdict(given: PlanningContext, timed: Timed, told: bool) -> Row:
    """What the verifier says of a trajectory; of distances from bodies only where they were told."""
    checks = [each for each in timed.report.checks if told or UNTOLD not in each.name]
    row = judged(checks, timed.report.metrics)
    return row | at_waypoints(given.toolpath.beads, timed.trajectory, given.cell.limits)
