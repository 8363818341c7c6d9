"""Plans spoilt in one thing, and what the verifier says of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from solved import body_of

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.plan import TRAVEL, Plan, Trajectory
from planner.problem import Problem
from planner.toolpath.bead import Toolpath
from planner.verify.verdict import Report, verify


def report(
    plan: Plan,
    trajectory: Trajectory | None = None,
    *,
    toolpath: Toolpath | None = None,
    problem: Problem | None = None,
    cell: Cell | None = None,
) -> Report:
    """The verifier's report on a plan of which parts are exchanged."""
    body = body_of(plan.toolpath, plan.cell) if toolpath is None and cell is None else None
    trajectory = trajectory or plan.trajectory
    return verify(problem or plan.problem, cell or plan.cell, toolpath or plan.toolpath, trajectory, body=body)


def failed(plan: Plan, trajectory: Trajectory | None = None, **parts: Any) -> set[str]:
    """Names of the checks that fail."""
    return {check.name for check in report(plan, trajectory, **parts).checks if not check.ok}


def worst(found: Report, name: str) -> float:
    return next(check.worst for check in found.checks if check.name == name)


def where(found: Report, name: str) -> str:
    return next(check.where for check in found.checks if check.name == name)


def with_joints(plan: Plan, trajectory: Trajectory, q: Array) -> Trajectory:
    """Other joints; what the trajectory says of tip, axis, orientation and speed of travel follows them."""
    T = plan.cell.T_part_nozzle(q)
    tip = T[:, :3, 3]
    moving = np.linalg.norm(np.gradient(tip, trajectory.dt, axis=0), axis=1)
    speed = np.where(trajectory.deposit, trajectory.speed, moving)
    quat = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    return replace(trajectory, q=q, tip=tip, axis=T[:, :3, 2], quat=quat, speed=speed)


def with_process(problem: Problem, **changes: Any) -> Problem:
    return problem.model_copy(update={"process": problem.process.model_copy(update=changes)})


def loose(cell: Cell, factor: float) -> Cell:
    """The cell with `factor` times the speed, acceleration and jerk limits."""
    limits = cell.limits
    return replace(
        cell,
        limits=replace(
            limits,
            velocity=factor * limits.velocity,
            acceleration=factor**2 * limits.acceleration,
            jerk=factor**3 * limits.jerk,
        ),
    )


def rows(trajectory: Trajectory, index: NDArray[np.intp]) -> Trajectory:
    """The samples at `index`, one after the other."""
    fields = {k: v[index] for k, v in vars(trajectory).items() if isinstance(v, np.ndarray) and k != "t"}
    return replace(trajectory, t=np.arange(len(index)) * trajectory.dt, **fields)


def paused(plan: Plan, at: int, dq: Array) -> Trajectory:
    """The trajectory, stopped at sample `at` (at rest, in travel) for the motion q[at] + dq (m, nj)."""
    trajectory = plan.trajectory
    n, m = len(trajectory), len(dq)
    longer = rows(trajectory, np.concatenate([np.arange(at + 1), np.full(m, at), np.arange(at + 1, n)]))
    q = longer.q.copy()
    q[at + 1 : at + 1 + m] += dq
    return with_joints(plan, longer, q)


def deposit_of(trajectory: Trajectory, bead: int) -> NDArray[np.intp]:
    return np.flatnonzero(trajectory.bead == bead)


def resting(trajectory: Trajectory) -> NDArray[np.intp]:
    """Samples at which all joints stand still, but for the rest of a sample's deceleration."""
    step = np.abs(np.diff(trajectory.q, axis=0)).max(axis=1)
    return np.flatnonzero((step[1:] < 2.5e-4) & (step[:-1] < 2.5e-4) & (trajectory.bead[1:-1] == TRAVEL)) + 1


def rest_after(trajectory: Trajectory, bead: int) -> int:
    """The sample at the end of a bead's run-out, where the nozzle stands still just above the part."""
    last = int(deposit_of(trajectory, bead)[-1])
    near = resting(trajectory)
    near = near[near > last]
    near = near[near < near[0] + 5]
    step = np.linalg.norm(np.diff(trajectory.q, axis=0), axis=1)
    return int(near[np.argmin(step[near] + step[near - 1])])


def hump(m: int) -> Array:
    """m samples from 0 to 1 and back, smooth at both ends."""
    return np.sin(np.linspace(0.0, np.pi, m)) ** 4


def jacobian(cell: Cell, q: Array) -> Array:
    """Twist of the nozzle at its tip (6) in the part frame by the arm's joints (6), by central differences."""
    eps = 1e-6
    T = cell.T_part_nozzle(q[None])[0]
    columns = []
    for j in range(6):
        dq = np.zeros(len(q))
        dq[j] = eps
        a, b = cell.T_part_nozzle(np.stack([q - dq, q + dq]))
        spin = (b[:3, :3] - a[:3, :3]) / (2 * eps) @ T[:3, :3].T
        columns.append([*(b[:3, 3] - a[:3, 3]) / (2 * eps), spin[2, 1], spin[0, 2], spin[1, 0]])
    return np.array(columns).T


def nudged(plan: Plan, samples: NDArray[np.intp], twist: Array) -> Trajectory:
    """The nozzle displaced by twist (6) [m, rad, part frame] in a smooth hump over a stretch of samples."""
    q = plan.trajectory.q.copy()
    for i, share in zip(samples, hump(len(samples)), strict=True):
        q[i, :6] += np.linalg.solve(jacobian(plan.cell, q[i]), share * twist)
    return with_joints(plan, plan.trajectory, q)


def straight_stretch(plan: Plan, m: int) -> NDArray[np.intp]:
    """m samples inside the wave's bead, which has no sharp corner."""
    at = deposit_of(plan.trajectory, bead_named(plan, "wave"))
    start = (len(at) - m) // 2
    return at[start : start + m]


def bead_named(plan: Plan, name: str) -> int:
    return next(i for i, bead in enumerate(plan.toolpath.beads) if bead.name == name)


def with_bead(toolpath: Toolpath, i: int, **changes: Any) -> Toolpath:
    beads = list(toolpath.beads)
    beads[i] = replace(beads[i], **changes)
    return replace(toolpath, beads=tuple(beads))


def swapped(values: Array, i: int, by: float) -> Array:
    """A copy with one value changed."""
    out = values.copy()
    out[i] += by
    return out


def swing(plan: Plan, joint: int, share: float) -> Array:
    """(m, nj) a swing and back whose greatest speed is `share` of the joint's, at 0.9 of its acceleration."""
    v, a = share * plan.cell.limits.velocity[joint], 0.9 * plan.cell.limits.acceleration[joint]
    lobe = np.sin(np.linspace(0.0, np.pi, int(np.pi * v / a / plan.trajectory.dt) + 1)) ** 2
    dq = np.zeros((2 * len(lobe) + 10, plan.trajectory.q.shape[1]))
    dq[5:-5, joint] = np.cumsum(v * plan.trajectory.dt * np.concatenate([lobe, -lobe]))
    return dq


def shake(plan: Plan, joint: int, order: int, limit: float, samples: int) -> Array:
    """(m, nj) to and fro by lobes of acceleration that last so many samples, with `limit` as the greatest second or
    third central difference."""
    lobe = np.sin(np.linspace(0.0, np.pi, samples + 1)[:-1]) ** 2
    way = np.cumsum(np.cumsum(np.concatenate([np.zeros(6), lobe, -lobe, -lobe, lobe, np.zeros(6)])))
    steps = np.diff(way, 2) if order == 2 else 0.5 * (way[4:] - 2.0 * way[3:-1] + 2.0 * way[1:-3] - way[:-4])
    dq = np.zeros((len(way), plan.trajectory.q.shape[1]))
    dq[:, joint] = way * limit * plan.trajectory.dt**order / np.abs(steps).max()
    return dq
