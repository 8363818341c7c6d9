"""Redundancy resolution: demand, nodes, the joint paths that come of them, whole turns and refusals."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import ruckig

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.cell.cell import LIMIT_ROOM, Cell, build_cell
from planner.collision.scene import NOTHING
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import JointPath, SampledTasks, choose_turns, sample_tasks
from planner.resolve.ladder import coarse_nodes
from planner.resolve.nodes import RAMP_SHARE, evaluate, full_grid
from planner.resolve.prices import (
    AT_SPEED,
    DIP_PRICE,
    LIMIT_COMFORT,
    LIMIT_PRICE,
    SIGMA_COMFORT,
    SIGMA_PRICE,
)
from planner.resolve.search import best_route
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, make_tasks

Paths = dict[str, tuple[JointPath, ...]]
TURN = 2.0 * np.pi
QUICK = [name for name in STRATEGIES if name != "nlp"]  # which is for single beads, and refuses more


# --- demand -----------------------------------------------------------------------------------------------------


def helix_task(speed: float = 0.04, n: int = 400, radius: float = 0.03, pitch: float = 0.5) -> NozzleTask:
    """A nozzle that looks at the z axis from a helix; its twist is known in closed form."""
    angle = np.linspace(0.0, 2.0, n)
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(n)
    rise = radius * pitch * angle
    frames = np.stack(
        [np.column_stack([zero, zero, zero + 1]), np.column_stack([-s, c, zero]), np.column_stack([-c, -s, zero])],
        axis=-1,
    )
    arc = radius * np.hypot(1.0, pitch) * angle
    tip = np.column_stack([radius * c, radius * s, rise])
    return NozzleTask(0, "helix", 0, tip, frames, arc - arc[50], 50, n - 51, speed)


def test_demand_of_a_helix_is_the_closed_form() -> None:
    speed, radius, pitch = 0.04, 0.03, 0.5
    task = helix_task(speed, radius=radius, pitch=pitch)
    assert np.allclose(np.linalg.det(task.frames), 1.0)
    demand = sample_tasks([task], 5e-3)
    rate = speed / (radius * np.hypot(1.0, pitch))  # of the angle, rad/s
    angle = np.linspace(0.0, 2.0, len(task))
    c, s, one = np.cos(angle), np.sin(angle), np.ones(len(task))
    linear = rate * radius * np.column_stack([-s, c, pitch * one])
    inner = slice(2, -2)
    np.testing.assert_allclose(demand.twist[inner, :3], linear[inner], rtol=0, atol=1e-6)
    np.testing.assert_allclose(demand.twist[inner, 3:], np.outer(one, [0, 0, rate])[inner], rtol=0, atol=1e-4)
    turning = rate**2 * radius * np.column_stack([-c, -s, 0 * one])
    np.testing.assert_allclose(demand.rate[inner, :3], turning[inner], rtol=0, atol=1e-4)
    np.testing.assert_allclose(demand.rate[inner, 3:], 0.0, atol=1e-3)


def test_motions_of_tasks_are_those_of_each_alone_by_numpy(tasks: tuple[NozzleTask, ...]) -> None:
    demand, begin = sample_tasks(tasks, 5e-3), 0
    for task in tasks:
        t, own = task.s / task.speed, slice(begin, begin + len(task))
        spin = np.gradient(task.frames, t, axis=0)
        angular = 0.5 * np.cross(task.frames, spin, axisa=1, axisb=1).sum(axis=1)
        twist = np.concatenate([np.gradient(task.tip, t, axis=0), angular], axis=1)
        weight = np.gradient(t)
        weight[: task.first] = weight[task.last + 1 :] = 0.0
        np.testing.assert_allclose(demand.twist[own], twist, rtol=0, atol=1e-12)
        np.testing.assert_allclose(demand.rate[own], np.gradient(twist, t, axis=0), rtol=0, atol=1e-9)
        np.testing.assert_allclose(demand.weight[own], weight, rtol=0, atol=1e-15)
        begin += len(task)


def test_twists_are_finite_differences_of_poses(tasks: tuple[NozzleTask, ...]) -> None:
    demand = sample_tasks(tasks, 5e-3)
    offset = 0
    for task in tasks:
        t = task.s / task.speed
        for i in range(1, len(task) - 1, 7):
            dt = t[i + 1] - t[i - 1]
            turned = pin.log3(task.frames[i + 1] @ task.frames[i - 1].T) / dt
            moved = (task.tip[i + 1] - task.tip[i - 1]) / dt
            twist = demand.twist[offset + i]
            # the differences on the two sides are not equally long where samples draw together
            assert np.linalg.norm(twist[:3] - moved) < 0.02 * task.speed
            assert np.linalg.norm(twist[3:] - turned) < 0.02 * (np.linalg.norm(turned) + 0.1)
        inside = slice(offset + task.first + 1, offset + task.last)
        np.testing.assert_allclose(np.linalg.norm(demand.twist[inside, :3], axis=1), task.speed, rtol=1e-2)
        offset += len(task)
    assert offset == len(demand.twist)


@pytest.mark.parametrize("spacing", [2e-3, 5e-3, 1.0])
def test_rungs_cover_every_task(tasks: tuple[NozzleTask, ...], spacing: float) -> None:
    demand = sample_tasks(tasks, spacing)
    offset = 0
    for i, task in enumerate(tasks):
        rungs = demand.rungs_of(i)
        at = demand.rung[rungs] - offset
        assert (at[0], at[-1]) == (0, len(task) - 1)
        covered = [k for a, b in zip(demand.start[rungs], demand.stop[rungs], strict=True) for k in range(a, b)]
        assert covered == list(range(offset, offset + len(task)))  # each sample answered for once
        assert ((demand.start[rungs] <= demand.rung[rungs]) & (demand.rung[rungs] < demand.stop[rungs])).all()
        np.testing.assert_allclose(demand.time[rungs][1:], np.diff(task.s[at]) / task.speed, rtol=1e-12)
        assert demand.time[rungs][0] == 0.0
        steps = np.diff(at)
        assert np.ptp(steps) <= 1
        assert len(at) == 2 or np.median(np.diff(task.s[at])) < 1.25 * spacing
        weight = demand.weight[offset : offset + len(task)]
        assert (weight[: task.first] == 0).all()
        assert (weight[task.last + 1 :] == 0).all()
        deposited = (task.s[task.last] - task.s[task.first]) / task.speed
        assert weight.sum() == pytest.approx(deposited, rel=0.01)
        offset += len(task)


def test_rungs_closer_than_samples_take_time(tasks: tuple[NozzleTask, ...]) -> None:
    demand = sample_tasks(tasks, 2e-5)
    for i in range(len(tasks)):
        assert (demand.time[demand.rungs_of(i)][1:] > 0.0).all()


# --- nodes ------------------------------------------------------------------------------------------------------


def slow_price(
    cell: Cell, demand: SampledTasks, rung: int, roll: float, holder: float, branch: int, min_sigma: float
) -> tuple[float, Array | None, float]:
    """Price [s], joints and smallest singular value of one node, sample by sample and joint by joint."""
    limits = cell.limits
    i0 = demand.rung[rung]
    R_roll = pin.exp3(np.array([0.0, 0.0, roll]))
    T_part_nozzle = pin.SE3(demand.frames[i0] @ R_roll, demand.tip[i0]).homogeneous
    T_world_part = cell.holder.poses(np.full((1, len(cell.holder)), holder))[0]
    T_flange = np.linalg.inv(cell.T_world_base) @ T_world_part @ T_part_nozzle @ np.linalg.inv(cell.T_flange_nozzle)
    solutions, ok = cell.wrist.solve(T_flange[None])
    if not ok[0, branch]:
        return np.inf, None, 0.0
    middle = 0.5 * (limits.q_min[:6] + limits.q_max[:6])
    q = np.array([x - TURN * round((x - m) / TURN) for x, m in zip(solutions[0, branch], middle, strict=True)])
    room = min(min(x - a, b - x) for x, a, b in zip(q, limits.q_min, limits.q_max, strict=False))
    J = cell.arm.jacobians(q[None])[0]
    sigma = float(np.linalg.svd(J, compute_uv=False)[-1])
    if room < LIMIT_ROOM or sigma < min_sigma:
        return np.inf, q, sigma
    R_part_world = T_world_part[:3, :3].T
    inverse = np.linalg.inv(np.vstack([R_part_world @ J[:3], R_part_world @ J[3:]]))
    samples = range(demand.start[rung], demand.stop[rung])
    x, gain = [], []
    for i in samples:
        if demand.weight[i] == 0.0:
            x.append(1.0)
            gain.append(np.inf)
            continue
        rates, bends = np.abs(inverse @ demand.twist[i]), np.abs(inverse @ demand.rate[i])
        x.append(min(1.0, *(limits.velocity[:6] / rates) ** 2, *(limits.acceleration[:6] / bends)))
        gain.append(2.0 * RAMP_SHARE * demand.weight[i] * min(limits.acceleration[:6] / rates))
    for k in range(1, len(x)):
        x[k] = min(x[k], x[k - 1] + gain[k])
    for k in range(len(x) - 2, -1, -1):
        x[k] = min(x[k], x[k + 1] + gain[k])
    price = 0.0
    for i, value in zip(samples, x, strict=True):
        if value < 1.0:
            price += demand.weight[i] * (value**-0.5 - 1.0 + (DIP_PRICE if value < AT_SPEED else 0.0))
    duration = float(demand.weight[list(samples)].sum())
    price += duration * SIGMA_PRICE * max(0.0, SIGMA_COMFORT / sigma - 1.0) ** 2
    price += duration * LIMIT_PRICE * max(0.0, 1.0 - room / LIMIT_COMFORT) ** 2
    return price, q, sigma


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("holder", ["table", "bed"])
def test_nodes_against_a_slow_reference(
    holder: str, cell: Cell, tasks: tuple[NozzleTask, ...], drawing_problem: Problem
) -> None:
    if holder == "bed":
        spot = ["cell.positioner=null", "cell.bed_mm=[-600, -30, 380]", "cell.base_mm=[10, 20, 30]"]
        cell = build_cell(load_problem("cylinder_logo", spot))
    demand = sample_tasks(tasks[:3], 10e-3)
    grid = full_grid(demand, 8, np.radians(40), np.radians(60), len(cell.holder) > 0)
    assert (grid.rolls, grid.holders) == (9, 6 if holder == "table" else 1)
    min_sigma = 0.05
    nodes = evaluate(cell, demand, grid, min_sigma)
    rng = np.random.default_rng(1)
    finite = forbidden = 0
    for r, a, b, c in zip(
        rng.integers(0, len(demand.rung), 1500), rng.integers(0, grid.rolls, 1500),
        rng.integers(0, grid.holders, 1500), rng.integers(0, 8, 1500), strict=True,
    ):  # fmt: skip
        price, q, sigma = slow_price(cell, demand, r, a * grid.roll_step, b * grid.holder_step, c, min_sigma)
        seen = nodes.price[r, a, b, c]
        if 0.7 * min_sigma < sigma < min_sigma:
            continue  # the kernel only estimates sigma
        assert np.isfinite(seen) == np.isfinite(price)
        if not np.isfinite(seen):
            forbidden += 1
            continue
        assert q is not None
        np.testing.assert_allclose(nodes.q[r, a, b, c], q, rtol=0, atol=2e-6)  # single precision
        finite += 1
        if sigma > SIGMA_COMFORT * 1.02:
            assert seen == pytest.approx(price, rel=1e-6, abs=1e-9)
    assert finite > 80
    assert forbidden > 80


def test_prices_near_a_singularity_follow_sigma(
    cell: Cell, tasks: tuple[NozzleTask, ...], drawing_problem: Problem
) -> None:
    demand, nodes = coarse_nodes(cell, tasks[:1], drawing_problem.resolve)
    checked = 0
    for r, a, b, c in np.argwhere(np.isfinite(nodes.price))[::37]:
        grid = nodes.grid
        price, _, sigma = slow_price(cell, demand, r, a * grid.roll_step, b * grid.holder_step, c, 0.0)
        if sigma < SIGMA_COMFORT:
            # sigma is estimated from above, by at most a third
            assert nodes.price[r, a, b, c] < price * (1 + 1e-6) + 1e-9
            assert nodes.price[r, a, b, c] > 0.2 * price
            checked += 1
    assert checked > 20


def test_steps_are_rounded_to_divide_the_circle(tasks: tuple[NozzleTask, ...]) -> None:
    demand = sample_tasks(tasks, 10e-3)
    grid = full_grid(demand, 8, np.radians(50.0), np.radians(360.0 / 7), True)
    assert (grid.rolls, grid.holders) == (8, 7)
    assert grid.rolls * grid.roll_step == pytest.approx(TURN)
    assert grid.periodic
    assert full_grid(demand, 8, 0.5, 0.5, False).holders == 1


# --- joint paths ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("strategy", QUICK)
def test_joint_paths_hold_the_task_exactly(strategy: str, cell: Cell, joint_paths: Paths) -> None:
    """By Pinocchio, from the joints alone."""
    assert cell.holder_robot is not None
    arm, table = cell.arm_robot.model, cell.holder_robot.model
    arm_data, table_data = arm.createData(), table.createData()
    flange, plate = arm.getFrameId("tool0"), table.getFrameId("plate")
    for path in joint_paths[strategy]:
        task = path.task
        assert path.q.shape == (len(task), 7)
        for i in range(0, len(task), 5):
            pin.framesForwardKinematics(arm, arm_data, path.q[i, :6])
            pin.framesForwardKinematics(table, table_data, np.array([0.0, path.q[i, 6]]))
            T_world_nozzle = arm_data.oMf[flange].homogeneous @ cell.T_flange_nozzle
            T_world_part = cell.T_world_holder_base @ table_data.oMf[plate].homogeneous @ cell.T_plate_part
            T = np.linalg.inv(T_world_part) @ T_world_nozzle
            assert np.linalg.norm(T[:3, 3] - task.tip[i]) < 1e-9
            assert np.linalg.norm(T[:3, 2] - task.frames[i, :, 2]) < 1e-9
            x = task.frames[i] @ [np.cos(path.roll[i]), np.sin(path.roll[i]), 0.0]
            assert np.linalg.norm(T[:3, 0] - x) < 1e-9


@pytest.mark.parametrize("strategy", QUICK)
def test_joint_paths_are_smooth_within_limits_and_on_one_branch(strategy: str, cell: Cell, joint_paths: Paths) -> None:
    for path in joint_paths[strategy]:
        assert (path.q > cell.limits.q_min).all()
        assert (path.q < cell.limits.q_max).all()
        assert set(cell.wrist.branches(path.q[:, :6])) == {path.branch}
        moved = np.linalg.norm(np.diff(path.task.tip, axis=0), axis=1)
        assert (np.abs(np.diff(path.q, axis=0)).max(axis=1) < 0.02 + 400.0 * moved).all()  # no jump, no turn


@pytest.mark.parametrize("strategy", QUICK)
def test_every_task_gets_its_path_in_order(strategy: str, tasks: tuple[NozzleTask, ...], joint_paths: Paths) -> None:
    assert [path.task for path in joint_paths[strategy]] == list(tasks)


def test_ladder_is_deterministic(
    cell: Cell, tasks: tuple[NozzleTask, ...], drawing_problem: Problem, joint_paths: Paths
) -> None:
    again = STRATEGIES["ladder"](cell, tasks, drawing_problem.resolve, NOTHING)
    for a, b in zip(again, joint_paths["ladder"], strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_as_published_keeps_the_nozzles_orientation_in_the_world(cell: Cell, joint_paths: Paths) -> None:
    """And the table does the turning: by as much as the bead goes round the cylinder."""
    rotations = np.concatenate([cell.arm.poses(p.q[:, :6])[:, :3, :3] for p in joint_paths["as_published"]])
    apart = np.linalg.norm(rotations - rotations[0], axis=(1, 2)) / np.sqrt(2.0)
    assert apart.max() < 1e-9
    home = cell.arm.poses(cell.home[None, :6])[0, :3, :3]
    tilted = abs(home[2, 2])  # home's axis is not quite horizontal; the cylinder's normals are
    assert np.linalg.norm(rotations[0] - home) < 1e-6 + 2.0 * tilted
    for path in joint_paths["as_published"]:
        normal = -path.task.frames[:, :, 2]
        around = np.unwrap(np.arctan2(normal[:, 1], normal[:, 0]))
        np.testing.assert_allclose(path.q[:, 6] - path.q[0, 6], around[0] - around, rtol=0, atol=1e-9)


def test_fixed_holds_roll_and_table(joint_paths: Paths) -> None:
    paths = joint_paths["fixed"]
    assert len({path.roll[0] for path in paths}) == 1  # one roll for the whole print
    by_name: dict[str, set[tuple[float, int]]] = {}
    for path in paths:
        assert np.ptp(path.roll) == 0.0
        assert np.ptp(path.q[:, 6]) == 0.0
        angle = float(np.round(np.remainder(path.q[0, 6], TURN), 9))
        by_name.setdefault(path.task.name, set()).add((angle, path.branch))
    assert all(len(choices) == 1 for choices in by_name.values())


# --- whole turns ------------------------------------------------------------------------------------------------


def made_up_paths(cell: Cell, rng: np.random.Generator, beads: int) -> list[JointPath]:
    """Paths whose joints all could be turned; only their ends matter."""
    task = helix_task(n=120)
    paths = []
    for i in range(beads):
        start, end = cell.home + rng.uniform(-0.3, 0.3, (2, 7))
        q = np.linspace(start, end, len(task))
        q[:, 5] += rng.uniform(-2.5, 2.5) + TURN * rng.integers(-3, 4)
        q[:, 6] += rng.uniform(-9, 9)
        paths.append(JointPath(replace(task, bead=i), np.zeros(len(task)), np.zeros((len(task), 2)), q, 0))
    return paths


def travel_time(cell: Cell, paths: Sequence[JointPath]) -> float:
    """Of all travels, home included, if nothing stood in the way [s], by the general formulas of ruckig."""
    q = [(path.q[0], path.q[-1]) for path in paths]
    home = cell.home.copy()
    home[6] = q[0][0][6]
    last = cell.home.copy()
    last[6] = q[-1][1][6]
    stops = [home, *itertools.chain.from_iterable(q), last]
    return sum(ruckig_time(cell, a, b) for a, b in zip(stops[::2], stops[1::2], strict=True))


def ruckig_time(cell: Cell, a: Array, b: Array) -> float:
    inputs = ruckig.InputParameter(len(a))
    inputs.current_position, inputs.target_position = list(a), list(b)
    inputs.max_velocity, inputs.max_acceleration = list(cell.limits.velocity), list(cell.limits.acceleration)
    inputs.max_jerk = list(cell.limits.jerk)
    trajectory = ruckig.Trajectory(len(a))
    ruckig.Ruckig(len(a)).calculate(inputs, trajectory)
    return float(trajectory.duration)


def test_choose_turns_changes_no_pose_and_keeps_limits(cell: Cell) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        before = made_up_paths(cell, rng, 4)
        after = choose_turns(cell, before)
        for a, b in zip(before, after, strict=True):
            turns = (b.q - a.q) / TURN
            np.testing.assert_allclose(turns, np.round(turns[:1]).repeat(len(turns), axis=0), rtol=0, atol=1e-9)
            assert (b.q >= cell.limits.q_min).all()
            assert (b.q <= cell.limits.q_max).all()
            T = (cell.T_part_nozzle(a.q[::20]), cell.T_part_nozzle(b.q[::20]))
            np.testing.assert_allclose(T[0], T[1], rtol=0, atol=1e-12)


def test_choose_turns_travels_least(cell: Cell) -> None:
    """Joint 6 has two turns of play: every combination of them, tried one by one, travels at least as long."""
    rng = np.random.default_rng(6)
    low, high = cell.limits.q_min[5], cell.limits.q_max[5]
    for _ in range(8):
        after = choose_turns(cell, made_up_paths(cell, rng, 4))
        options = [
            [k for k in range(-3, 4) if p.q[:, 5].min() + k * TURN >= low and p.q[:, 5].max() + k * TURN <= high]
            for p in after
        ]
        assert max(len(o) for o in options) > 1
        turn = np.eye(7)[5] * TURN
        best = min(
            travel_time(cell, [replace(p, q=p.q + turn * k) for p, k in zip(after, ks, strict=True)])
            for ks in itertools.product(*options)
        )
        # what nearness to home may cost: of four beads, a thousandth of the time that a joint takes to it
        assert travel_time(cell, after) <= best + 1e-3 * 4 * (high - low) / cell.limits.velocity[5]


def test_a_joint_turns_back_where_another_one_takes_the_time_anyway(cell: Cell) -> None:
    """Joint 6 has to turn back once: in the travel where the slow table turns far, not in one that would be short."""
    task = helix_task(n=120)
    paths, at = [], cell.home.copy()
    at[5] = 0.0
    for i, table in enumerate((0.0, 0.0, 12.0, 0.0, 0.0)):
        end = at.copy()
        at[6] += table
        end[6] = at[6]
        end[5] = at[5] + 0.45 * TURN
        q = np.linspace(at, end, len(task))
        paths.append(JointPath(replace(task, bead=i), np.zeros(len(task)), np.zeros((len(task), 2)), q, 0))
        at = end
    after = choose_turns(cell, paths)
    back = [round((b.q[0, 5] - a.q[-1, 5]) / TURN) for a, b in itertools.pairwise(after)]
    assert back[1] != 0
    assert [turns for i, turns in enumerate(back) if i != 1] == [0, 0, 0]


@pytest.mark.parametrize(("joint", "reach", "each"), [(3, 200.0, 35.0), (5, 400.0, 110.0), (6, 300.0, 110.0)])
def test_joints_and_table_unwind_in_travel_and_never_in_a_bead(
    cell: Cell, joint: int, reach: float, each: float
) -> None:
    """Beads that all turn a joint the same way: it unwinds whenever its limit nears, between them."""
    q_min, q_max = cell.limits.q_min.copy(), cell.limits.q_max.copy()
    q_min[joint], q_max[joint] = -np.radians(reach), np.radians(reach)
    cell = replace(cell, limits=replace(cell.limits, q_min=q_min, q_max=q_max))
    task = helix_task(n=120)
    paths, at = [], cell.home.copy()
    at[joint] = 0.0
    for i in range(24):
        end = at.copy()
        end[joint] += np.radians(each)
        q = np.linspace(at, end, len(task))
        paths.append(JointPath(replace(task, bead=i), np.zeros(len(task)), np.zeros((len(task), 2)), q, 0))
        at = end
    after = choose_turns(cell, paths)
    q = np.vstack([path.q for path in after])
    assert (q >= q_min).all()
    assert (q <= q_max).all()
    for a, b in zip(paths, after, strict=True):  # as it was but for whole turns: what it does in a bead stays
        np.testing.assert_allclose(np.diff(b.q, axis=0), np.diff(a.q, axis=0), rtol=0, atol=1e-9)
    jumps = np.array([b.q[0, joint] - a.q[-1, joint] for a, b in itertools.pairwise(after)])
    turns = np.round(jumps / TURN)
    np.testing.assert_allclose(jumps, turns * TURN, rtol=0, atol=1e-9)
    needed = np.ceil((24 * each - 2 * reach) / 360.0)  # the beads turn further than the range by this
    assert needed <= -turns.sum() <= needed + 2
    assert (turns <= 0).all()


def test_a_table_that_goes_round_in_every_bead_goes_on(cell: Cell) -> None:
    """Beads that all go round once, the same way: the table comes back in none of the travels, for its range is 100 turns to
    both sides; and one that goes round fifty times begins at home."""
    task, start = helix_task(n=120), cell.home.copy()

    def wound(bead: int, turns: float) -> JointPath:
        q = np.linspace(start, start + turns * TURN * np.eye(7)[6], len(task))
        return JointPath(replace(task, bead=bead), np.zeros(len(task)), np.zeros((len(task), 2)), q, 0)

    after = choose_turns(cell, [wound(i, 1.0) for i in range(24)])
    begins = [path.q[0, 6] for path in after]
    np.testing.assert_allclose(begins, start[6] + TURN * np.arange(24), rtol=0, atol=1e-9)
    (alone,) = choose_turns(cell, [wound(0, 50.0)])
    assert alone.q[0, 6] == pytest.approx(start[6], abs=1e-9)


def test_choose_turns_refuses_what_no_turn_brings_inside(cell: Cell) -> None:
    (path,) = made_up_paths(cell, np.random.default_rng(7), 1)
    q = path.q.copy()
    q[60, 4] = np.radians(150.0)  # joint 5 ends at 115 deg
    with pytest.raises(Refusal) as caught:
        choose_turns(cell, [replace(path, q=q)])
    assert "joint_5" in str(caught.value)
    assert (caught.value.bead, caught.value.waypoint) == (0, 60 - path.task.first)


# --- refusals ---------------------------------------------------------------------------------------------------


def refusal_of(strategy: str, *overrides: str, toolpath: Toolpath) -> Refusal:
    problem = load_problem("cylinder_logo", ["resolve.rung_mm=10", *overrides])
    tasks = make_tasks(toolpath, 0.04, 3e-3)
    with pytest.raises(Refusal) as caught:
        STRATEGIES[strategy](build_cell(problem), tasks[:3], problem.resolve, NOTHING)
    return caught.value


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("strategy", QUICK)
def test_cylinder_out_of_reach_is_refused_with_place_and_distance(strategy: str, toolpath: Toolpath) -> None:
    near, far = (
        refusal_of(strategy, f"cell.positioner.origin_mm=[{x}, 9.87, 380]", toolpath=toolpath) for x in (1900, 2000)
    )
    for refusal in (near, far):
        assert refusal.bead == 0
        assert refusal.waypoint is not None
        assert refusal.waypoint >= 0
        assert refusal.s_mm is not None
        assert refusal.point_mm is not None
        assert np.hypot(refusal.point_mm[0] - 31.4, refusal.point_mm[1] - 37.0) > 34.0
        assert refusal.missing_mm is not None
        text = str(refusal)
        assert "bead 0" in text
        assert f"waypoint {refusal.waypoint}" in text
        assert f"{refusal.missing_mm:.1f} mm" in text
        assert "reach" in text
    assert near.missing_mm is not None
    assert far.missing_mm is not None
    assert 700.0 < near.missing_mm < 1900.0 - 515.0  # 1900 mm away, and the arm's reach is some 810 mm and the nozzle
    assert far.missing_mm - near.missing_mm == pytest.approx(100.0, abs=3.0)


def test_a_singularity_margin_that_cannot_be_kept_is_named(toolpath: Toolpath) -> None:
    refusal = refusal_of("ladder", "resolve.min_sigma=0.6", toolpath=toolpath)
    assert "min_sigma" in str(refusal)
    assert refusal.missing_mm is None


def test_a_joint_range_that_no_posture_fits_is_named(toolpath: Toolpath) -> None:
    narrow = ["cell.limits={joint_1: {range_deg: [100, 120]}}", "cell.home_deg=[110, 20, 30, 90, -80, 60]"]
    refusal = refusal_of("ladder", *narrow, toolpath=toolpath)
    assert "joint_1" in str(refusal)
    assert "deg" in str(refusal)


def test_a_range_too_narrow_for_the_room_kept_from_limits_is_no_singularity(toolpath: Toolpath) -> None:
    refusal = refusal_of("ladder", "cell.limits={joint_2: {range_deg: [17, 22]}}", toolpath=toolpath)
    assert "singularity" not in str(refusal)


def test_a_table_too_slow_for_the_path_is_refused(toolpath: Toolpath) -> None:
    """The published way needs the table; a greedy or best path does without."""
    slow = load_problem("cylinder_logo", ["resolve.rung_mm=10", "cell.limits={rotation: {speed_deg_s: 0.01}}"])
    cell = build_cell(slow)
    tasks = make_tasks(toolpath, 0.04, 3e-3)[:3]
    for path in STRATEGIES["ladder"](cell, tasks, slow.resolve, NOTHING):
        assert np.ptp(path.q[:, 6]) < 1e-9


@pytest.mark.slow
def test_ladder_finds_a_way_where_its_own_coarse_grid_has_one() -> None:
    """A table 900 mm away: the coarse route is feasible, joint limits and all."""
    problem = load_problem(
        "cylinder_logo", ["layers.count=1", "resolve.rung_mm=10", "cell.positioner.origin_mm=[900, 9.87, 380]"]
    )
    cell = build_cell(problem)
    tasks = make_tasks(build_toolpath(problem), problem.process.speed, problem.process.run_in)[:1]
    demand, nodes = coarse_nodes(cell, tasks, problem.resolve)
    assert best_route(nodes, demand, cell.limits)[0] is not None
    assert len(STRATEGIES["ladder"](cell, tasks, problem.resolve, NOTHING)) == 1
