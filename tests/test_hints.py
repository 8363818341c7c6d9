"""What a refusal tells to try: every change that is named is made, and the search is run again."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.cell.cell import build_cell
from planner.problem import load_problem
from planner.resolve.infeasible import _angles_around, _collision, _turned
from planner.resolve.joint_path import JointPath, flange_poses
from planner.resolve.ladder import coarse_nodes, ladder
from planner.resolve.search import best_route
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, make_tasks

BASE = ("layers.count=1", "resolve.rung_mm=10")


@pytest.fixture(scope="module")
def toolpath() -> Toolpath:
    return build_toolpath(load_problem("cylinder_logo", BASE))


def plan(toolpath: Toolpath, *overrides: str) -> tuple[JointPath, ...]:
    problem = load_problem("cylinder_logo", [*BASE, *overrides])
    tasks = make_tasks(toolpath, problem.process.speed, problem.process.run_in)[:1]
    return ladder(build_cell(problem), tasks, problem.resolve)


def has_coarse_path(toolpath: Toolpath, *overrides: str) -> bool:
    problem = load_problem("cylinder_logo", [*BASE, *overrides])
    cell = build_cell(problem)
    tasks = make_tasks(toolpath, problem.process.speed, problem.process.run_in)[:1]
    demand, nodes = coarse_nodes(cell, tasks, problem.resolve)
    return best_route(nodes, demand, cell.limits)[0] is not None


def hints_of(toolpath: Toolpath, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(Refusal) as caught:
        plan(toolpath, *overrides)
    assert not any("roll " in hint for hint in caught.value.hints)  # it may turn all round as it is
    return caught.value.hints


def vector_in(hint: str) -> Array:
    found = re.search(r"by \[(.*?)\]", hint)
    assert found, hint
    return np.array([float(x) for x in found[1].split(",")])


@pytest.mark.slow
def test_a_speed_that_no_joint_can_hold_is_no_reason_to_refuse(toolpath: Toolpath) -> None:
    assert len(plan(toolpath, "process.speed_mm_s=400", "process.travel_speed_mm_s=400")) == 1


@pytest.mark.slow(cases=("cell.positioner*",))
@pytest.mark.parametrize(
    ("field", "where"), [("cell.positioner.origin_mm", [1200.0, 9.87, 380.0]), ("cell.bed_mm", [-1020.0, 455.0, 300.0])]
)
def test_a_part_out_of_reach_is_moved_to_where_it_can_be_printed(
    toolpath: Toolpath, field: str, where: list[float]
) -> None:
    fixed = ["cell.positioner=null"] if field == "cell.bed_mm" else []
    hint = next(h for h in hints_of(toolpath, *fixed, f"{field}={where}") if h.startswith(field))
    assert "towards the arm's base" in hint
    assert hint.endswith("gives a path in the coarse search")
    move = vector_in(hint)
    assert np.sign(move[0]) == -np.sign(where[0])
    assert move[2] == 0.0
    assert has_coarse_path(toolpath, *fixed, f"{field}={(np.array(where) + move).tolist()}")
    assert not has_coarse_path(toolpath, *fixed, f"{field}={(np.array(where) + 0.75 * move).tolist()}")


@pytest.mark.slow
def test_a_held_axis_is_turned_to_where_there_is_a_path(toolpath: Toolpath) -> None:
    tight = "resolve.min_sigma=0.24"
    hint = next(h for h in hints_of(toolpath, tight) if "held_deg" in h)
    found = re.fullmatch(r"cell.positioner.held_deg: \{tilt: (-?\d+)\} gives a path in the coarse search", hint)
    assert found, hint
    assert len(plan(toolpath, tight, f"cell.positioner.held_deg={{tilt: {found[1]}}}")) == 1


@pytest.mark.parametrize("free", ("[rotation]", "[]"))
def test_a_held_axis_is_turned_with_the_part_where_it_stands_on_the_plate(free: str) -> None:
    of_plate = ["cell.positioner.part_mm=[10, -20, 60]", "cell.positioner.part_rpy_deg=[0, 10, 30]"]
    free = f"cell.positioner.free={free}"
    cell, turned = (
        build_cell(load_problem("cylinder_logo", [*of_plate, free, f"cell.positioner.held_deg={{tilt: {tilt}}}"]))
        for tilt in (0, 30)
    )
    found = _turned(cell, "tilt", np.radians(30.0))
    np.testing.assert_allclose(found.T_world_holder, turned.T_world_holder, rtol=0, atol=1e-12)
    rest = turned.home[None, len(turned.arm) :]
    np.testing.assert_allclose(found.holder.poses(rest), turned.holder.poses(rest), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("given", "low", "high"), [("[-30, 20]", -30.0, 15.0), ("[-400, 400]", -180.0, 180.0)])
def test_a_held_axis_is_turned_within_the_range_that_the_problem_gives_it(given: str, low: float, high: float) -> None:
    cell = build_cell(load_problem("cylinder_logo", [f"cell.limits={{tilt: {{range_deg: {given}}}}}"]))
    angles = np.degrees(list(_angles_around(cell, "tilt", 0.0)))
    assert (angles.min(), angles.max()) == pytest.approx((low, high))


def test_the_tilt_that_is_named_is_the_least_that_has_a_posture(toolpath: Toolpath) -> None:
    """Against the arm's inverse kinematics, direction by direction, at the place of the refusal."""
    bed = ("cell.positioner=null", "cell.base_mm=[20, -30, 40]", "cell.bed_mm=[-450, 450, 300]")
    overrides = (*bed, "cell.limits={joint_5: {range_deg: [-70, -45]}}", "cell.home_deg=[30, 20, 30, 90, -60, 60]")
    problem = load_problem("cylinder_logo", [*BASE, *overrides])
    cell = build_cell(problem)
    task = make_tasks(toolpath, problem.process.speed, problem.process.run_in)[0]
    with pytest.raises(Refusal) as caught:
        ladder(cell, [task], problem.resolve)
    (hint,) = (h for h in caught.value.hints if h.startswith("process.cones.nozzle_normal_deg"))
    tilts = [5.0, 10.0, 20.0]
    found = re.fullmatch(r"process.cones.nozzle_normal_deg: (\d+) gives the nozzle a posture here", hint)
    assert found
    named = float(found[1])
    assert named > tilts[0]
    assert caught.value.point_mm is not None
    i = int(np.argmin(np.linalg.norm(task.tip * 1e3 - caught.value.point_mm, axis=1)))
    for tilt in tilts[: tilts.index(named) + 1]:
        turns, rolls = np.meshgrid(np.arange(0, 360, 30.0), np.arange(0, 360, 15.0))
        turns, rolls = np.radians(turns.ravel()), np.radians(rolls.ravel())
        spot = NozzleTask(0, "spot", 0, task.tip[[i] * len(turns)], task.frames[[i] * len(turns)], turns, 0, 1, 0.04)
        lean = np.radians(tilt) * np.column_stack([np.cos(turns), np.sin(turns)])
        q, ok = cell.inverse.solve(flange_poses(cell, spot, rolls, lean, np.empty((len(turns), 0))))
        inside = ok & ((q >= cell.limits.q_min) & (q <= cell.limits.q_max)).all(axis=2)
        assert inside.any() or tilt != named
        room = np.minimum(q - cell.limits.q_min, cell.limits.q_max - q).min(axis=2)
        if tilt < named:
            assert not (inside & (room > 0.07)).any()


def test_nothing_is_named_where_nothing_helps(toolpath: Toolpath) -> None:
    """A least singular value beyond what an arm of this size can reach anywhere."""
    assert hints_of(toolpath, "resolve.min_sigma=0.9") == ()


@pytest.mark.parametrize(
    ("margin", "said"), [(-3.42e-3, "3.4 mm"), (-0.11e-3, "0.1 mm"), (-0.0108e-3, "0.011 mm"), (-4e-7, "0.0004 mm")]
)
def test_what_lacks_is_never_nothing(margin: float, said: str) -> None:
    obstacles: Any = SimpleNamespace(names=lambda _: ("nozzle", "part or print"))
    assert f"every posture lacks {said} of clearance" in _collision(obstacles, 0, margin, "every posture")
