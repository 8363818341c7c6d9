"""The bound over all choices: against finite differences, linear programs, other paths, and where it must be tight."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import linprog

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.cell.cell import Cell, build_cell
from planner.cell.kinematics.chain import chain_state, jacobian_at
from planner.collision.scene import NOTHING
from planner.motion.timing.timed_path import bound_time
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.resolve import bound
from planner.resolve.joint_path import JointPath, flange_poses, postures, sample_tasks
from planner.resolve.reach import arm_numbers
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of

PIN = ("layers.count=1", "resolve.rung_mm=8")


@cache
def loaded(name: str, *overrides: str) -> tuple[Problem, Cell, tuple[NozzleTask, ...]]:
    problem = load_problem(name, overrides)
    cell, tasks = build_cell(problem), tasks_of(problem, build_toolpath(problem))
    return problem, cell, tasks if len(tasks) < 3 else tuple(task for task in tasks if "pin" in task.name)


def slowed(cell: Cell, velocity: float = 1.0, acceleration: float = 1.0) -> Cell:
    limits = cell.limits
    v, a = velocity * limits.velocity, acceleration * limits.acceleration
    return replace(cell, limits=replace(limits, velocity=v, acceleration=a))


@cache
def paths_by(name: str, strategy: str) -> tuple[JointPath, ...]:
    problem, cell, tasks = loaded(name, *PIN) if name == "cylinder_logo" else loaded(name)
    return STRATEGIES[strategy](cell, tasks, problem.resolve, NOTHING)


def ideal(tasks: tuple[NozzleTask, ...]) -> float:
    return sum(float(task.s[task.last] - task.s[task.first]) / task.speed for task in tasks)


def projected(cell: Cell, task: NozzleTask, i: int, q: Array, qd: Array, qdd: Array, rates: Array) -> Array:
    """What G q'' less d(rates) leaves beyond the twist of the path and the nozzle's axis (6)."""
    arm, numbers, demand = arm_numbers(cell), bound._cell_numbers(cell), sample_tasks([task], 0.1)
    na, nh = len(cell.arm), len(cell.holder)
    room = bound._room(na, nh, len(cell.chosen), len(numbers.triples), 8)
    path = bound.PathNumbers(demand.tip, demand.frames, demand.twist, demand.rate)
    T_world_part = cell.holder.poses(q[None, na:])[0]
    R = T_world_part[:3, :3]
    tip = R @ task.tip[i] + T_world_part[:3, 3]
    for chain, part, sign in ((cell.arm, slice(0, na), 1.0), (cell.holder, slice(na, na + nh), -1.0)):
        lines, T, J = np.empty((2, len(chain), 3)), np.empty((4, 4)), np.empty((6, len(chain)))
        chain_state(chain.placements, chain.axes, chain.T_last_tip, q[part], lines[0], lines[1], T)
        jacobian_at(lines[0], lines[1], tip, J)
        room.G[part] = sign * J.T
    twist, rate = path.twist[i], path.rate[i]
    X = np.concatenate([R @ twist[:3], R @ twist[3:]])
    X1 = np.concatenate([R @ (rate[:3] - np.cross(twist[3:], twist[:3])), R @ rate[3:]])
    Z = np.concatenate([np.zeros(3), R @ task.frames[i][:, 2]])
    assert bound._rates(numbers, arm, X, Z, room)
    assert np.abs(rates @ room.e - qd).max() < 2e-3 * np.abs(qd).max()
    turned, d = np.zeros(6), np.empty(6)
    bound._bracket(X, Z, 1.0, turned)
    bound._bend(rates, na + nh, na, X, X1, Z, turned, room, d)
    basis = np.linalg.qr(np.stack([X, Z], axis=1))[0]
    left, size = room.G.T @ qdd - d, room.G.T @ qdd
    return np.asarray((left - basis @ (basis.T @ left)) / np.linalg.norm(size))


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("name", ["cylinder_logo", "peer_cap"])
def test_accelerations_are_those_of_a_path_on_which_everything_moves(name: str) -> None:
    _, cell, _ = loaded(name, *PIN) if name == "cylinder_logo" else loaded(name)
    (path, *_) = paths_by(name, "ladder")
    task = path.task
    t = task.s / task.speed
    roll = path.roll[len(t) // 2] + 0.2 * np.sin(3.0 * t)
    chosen = path.q[:, list(cell.chosen)].mean(axis=0) + 0.15 * np.cos(2.0 * t)[:, None] * np.ones(len(cell.chosen))
    q = postures(cell, task, roll, chosen, path.branch)
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)
    off = []
    for i in range(task.first + 5, task.last - 5, 7):
        rates = np.array([1.0, np.gradient(roll, t)[i], *np.gradient(chosen, t, axis=0)[i]])
        off.append(np.abs(projected(cell, task, i, q[i], qd[i], qdd[i], rates)).max())
    assert np.median(off) < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cylinder_logo", "peer_cap"])
def test_every_path_takes_longer_whatever_the_limits(name: str) -> None:
    _, cell, tasks = loaded(name, *PIN) if name == "cylinder_logo" else loaded(name)
    compared, above = 0, 0
    for velocity, acceleration in ((1.0, 1.0), (0.02, 1.0), (1.0, 2e-3), (0.03, 5e-3)):
        slow = slowed(cell, velocity, acceleration)
        least = bound.bound_any_path(slow, tasks)
        assert least >= ideal(tasks) * (1.0 - 1e-9)
        above += least > 1.02 * ideal(tasks)
        for strategy in ("as_published", "fixed", "greedy", "ladder", "sqp"):
            with suppress(Refusal):
                own = sum(bound_time(slow, path) for path in paths_by(name, strategy))
                assert least <= own * (1.0 + 1e-5), strategy  # whose ends are interpolated
                compared += 1
    assert compared >= 8
    assert above >= 2  # so that there is something to undercut


@pytest.mark.slow
def test_it_is_tight_where_all_is_at_speed_and_not_where_joints_are_slow() -> None:
    _, cell, tasks = loaded("peer_cap")
    assert bound.bound_any_path(cell, tasks) == pytest.approx(ideal(tasks))
    assert bound.bound_any_path(slowed(cell, velocity=0.01), tasks) > 1.5 * ideal(tasks)
    assert bound.bound_any_path(slowed(cell, acceleration=1e-4), tasks) > 1.2 * ideal(tasks)


def by_linear_program(cell: Cell, task: NozzleTask, i: int, q: Array) -> float:
    """The greatest speed over the commanded one of an arm over a fixed bed at a sample, by a linear program."""
    demand, bed = sample_tasks([task], 0.1), cell.holder.poses(np.zeros((1, 0)))[0][:3, :3]
    X = np.concatenate([bed @ demand.twist[i, :3], bed @ demand.twist[i, 3:]])
    Z = np.concatenate([np.zeros(3), bed @ task.frames[i][:, 2]])
    rates = np.linalg.solve(cell.arm.jacobians(q[None])[0], np.stack([X, Z], axis=1))
    v = np.tile(cell.limits.velocity, 2)
    found = linprog([-1.0, 0.0], A_ub=np.concatenate([rates, -rates]), b_ub=v, bounds=[(0.0, None), (None, None)])
    return float(found.x[0])


def test_the_greatest_speed_is_that_of_linear_programs() -> None:
    _, cell, tasks = loaded("peer_cap")
    task, slow = tasks[0], slowed(cell, velocity=0.01, acceleration=1e6)
    numbers, arm, demand = bound._cell_numbers(slow), arm_numbers(slow), sample_tasks([task], 0.1)
    path = bound.PathNumbers(demand.tip, demand.frames, demand.twist, demand.rate)
    room, last = bound._room(6, 0, 0, len(numbers.triples), 8), np.zeros(1, dtype=np.int64)
    compared = 0
    for i in range(task.first, task.last, 97):
        for roll in (0.0, 1.0, 2.5, 4.0):
            found = bound._greatest(i, roll, np.empty(0), 0.0, arm, numbers, path, room, last)
            n, middle = len(task), 0.5 * (slow.limits.q_min + slow.limits.q_max)
            T = flange_poses(slow, task, np.full(n, roll), np.zeros((n, 2)), np.zeros((n, 0)))
            every, ok = slow.inverse.solve(T[i : i + 1])
            turned = middle + np.remainder(every[0][ok[0]] - middle + np.pi, 2.0 * np.pi) - np.pi
            inside = ((turned >= slow.limits.q_min) & (turned <= slow.limits.q_max)).all(axis=1)
            best = max((by_linear_program(slow, task, i, q) for q in turned[inside]), default=-1.0)
            if best > 0.0:
                assert found == pytest.approx(min(best, 1.0), rel=5e-3)
                compared += best < 1.0
    assert compared > 10


@pytest.mark.slow
def test_a_plan_carries_the_bound_and_the_gap() -> None:
    metrics = solve("peer_cap", baseline=False).metrics
    assert metrics["bound_any_path_s"] <= metrics["deposition_time_s"] + 0.004  # which samples round
    assert 0.0 <= metrics["bound_gap_fraction"] < 1e-3
    leaning = load_problem("peer_cap", ["process.cones.nozzle_normal_deg=5"])
    assert "bound_any_path_s" not in solve(leaning, baseline=False, strategy="ladder").metrics
