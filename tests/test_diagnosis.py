"""Why there is no path: postures that are looked at are those that a search could have, and are judged as it judges them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.base.errors import Refusal
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING
from planner.problem import Problem, load_problem
from planner.resolve.infeasible import _ALONG, Stuck, _finer_hints, _tried_at, refuse_rung
from planner.resolve.joint_path import SampledTasks, sample_tasks
from planner.resolve.ladder import _with_one_joint
from planner.resolve.nodes import full_grid
from planner.toolpath.task import Cones, NozzleTask

Array = NDArray[np.float64]


def coarse(demand: SampledTasks) -> Any:
    """Nodes of a whole coarse grid that nobody has looked at."""
    return SimpleNamespace(grid=full_grid(demand, 8, 0.5, 0.5, True), scale=(0.0, 1.0))


def with_range(cell: Cell, joint: int, low: float, high: float) -> Cell:
    limits = replace(cell.limits, q_min=cell.limits.q_min.copy(), q_max=cell.limits.q_max.copy())
    limits.q_min[joint], limits.q_max[joint] = low, high
    return replace(cell, limits=limits)


@pytest.mark.parametrize(("low", "high"), [(-1.5, 1.0), (2.0, 5.0), (-7.0, 7.0)])
def test_a_table_is_looked_at_within_its_range(
    cell: Cell, tasks: tuple[NozzleTask, ...], low: float, high: float
) -> None:
    demand = sample_tasks(tasks, 10e-3)
    angles = _tried_at(with_range(cell, 6, low, high), tasks, demand, coarse(demand), 5).holder[:, 0]
    if high - low < 2.0 * np.pi:
        assert (angles.min(), angles.max()) == (low, high)
    else:
        assert np.ptp(angles) > 6.0


@pytest.mark.parametrize(("cones", "share"), [(Cones(np.radians(45.0), np.radians(15.0)), 0.25), (Cones(), 1.0)])
def test_the_nozzle_is_looked_at_as_it_leans_in_the_search(
    cell: Cell, tasks: tuple[NozzleTask, ...], cones: Cones, share: float
) -> None:
    leaning = [replace(task, cones=cones) for task in tasks]
    demand = sample_tasks(leaning, 10e-3)
    rung = 5
    tried = _tried_at(cell, leaning, demand, coarse(demand), rung)
    R_world_part = cell.holder.poses(tried.holder)[:, :3, :3]
    axis = (cell.T_world_base @ tried.T_base_flange @ cell.T_flange_nozzle)[:, :3, 2]
    lean, normal = (
        np.arccos(np.clip(z, -1.0, 1.0)) for z in (-axis[:, 2], R_world_part[:, 2] @ demand.normals[demand.rung[rung]])
    )
    assert normal.max() > np.radians(20.0)
    np.testing.assert_allclose(lean, share * normal, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("rough", "told"), [(1.0, "15"), (2.0, "7.5")])
def test_finer_steps_are_told_as_the_settings_have_them(
    cell: Cell, tasks: tuple[NozzleTask, ...], monkeypatch: pytest.MonkeyPatch, rough: float, told: str
) -> None:
    monkeypatch.setattr(Stuck, "serves", lambda *_: _ALONG)
    demand = sample_tasks(tasks, 10e-3)
    grid = full_grid(demand, 8, np.radians(30.0), np.radians(30.0), True)
    (hint,) = _finer_hints(Stuck(cell, tasks, demand, grid, 0, 0.1, NOTHING, rough))
    assert hint.startswith(f"resolve: {{roll_step_deg: {told}, table_step_deg: {told}}}")


@pytest.mark.parametrize(("most", "rough"), [(np.inf, 1), (1.0, 2)])
def test_a_refusal_knows_that_steps_were_doubled(
    drawing_problem: Problem,
    cell: Cell,
    tasks: tuple[NozzleTask, ...],
    monkeypatch: pytest.MonkeyPatch,
    most: float,
    rough: int,
) -> None:
    told = []

    def refuse(*given: Any) -> None:
        told.append(given[-1])
        raise Refusal("no way")

    monkeypatch.setattr("planner.resolve.ladder.refuse_rung", refuse)
    monkeypatch.setattr("planner.resolve.ladder.MOST_NODES", most)
    settings = drawing_problem.resolve.model_copy(update={"min_sigma": 0.9})
    with pytest.raises(Refusal):
        _with_one_joint(cell, tasks[:1], settings, NOTHING, 1.0)
    assert told == [rough]


def test_of_seven_axes_the_six_that_are_solved_for_are_too_singular() -> None:
    bed = ["cell.positioner=null", "cell.bed_mm=[450, 0, 200]"]
    cell = build_cell(
        load_problem("cylinder_logo", ["cell.arm=panda", "cell.home_deg=[0, -30, 0, -120, 0, 100, 45]", *bed])
    )
    y = np.linspace(0.0, 0.03, 40)
    tip = np.column_stack([0.0 * y, y, 0.0 * y])
    tasks = [NozzleTask(0, "line", 0, tip, np.tile(np.diag([1.0, -1.0, -1.0]), (40, 1, 1)), y, 4, 35, 0.04)]
    demand = sample_tasks(tasks, 10e-3)
    nodes = coarse(demand)
    nodes.price = np.full((len(demand.rung), 1, 1, 1), np.inf)
    tried = _tried_at(cell, tasks, demand, nodes, 1)
    inner = np.minimum(tried.q - cell.limits.q_min, cell.limits.q_max - tried.q)
    away = tried.ok & (inner >= cell.limits.room).all(axis=2)
    J = cell.arm.jacobians(tried.q[away])
    seven, six = (np.linalg.svd(J[:, :, list(of)], compute_uv=False)[:, -1].max() for of in (range(7), cell.solved))
    assert six < 0.98 * seven
    with pytest.raises(Refusal, match=f"too close to a singularity: sigma at most {six:.4f}"):
        refuse_rung(cell, tasks, demand, nodes, 1, 0.5 * (six + seven))
