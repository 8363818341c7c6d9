"""What the ways from and to home cost, and that the search heeds them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import SampledTasks
from planner.resolve.ladder import coarse_nodes, home_travel_costs
from planner.resolve.nodes import Nodes
from planner.resolve.prices import HOME_PRICE
from planner.resolve.search import Route, best_route, joint_limits, label_turns, turns_counted
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of

SETTINGS = ["layers.count=1", "resolve.rung_mm=20", "resolve.roll_step_deg=45", "resolve.table_step_deg=90"]
Searched = tuple[Problem, Cell, tuple[NozzleTask, ...], SampledTasks, Nodes]


@pytest.fixture(scope="module")
def searched() -> Searched:
    problem = load_problem("cylinder_logo", SETTINGS)
    cell = build_cell(problem)
    tasks = tasks_of(problem, build_toolpath(problem))[:2]
    return problem, cell, tasks, *coarse_nodes(cell, tasks, problem.resolve)


@pytest.mark.slow
def test_a_way_takes_as_long_as_its_slowest_joint_or_its_tip(searched: Searched) -> None:
    problem, cell, tasks, _, nodes = searched
    assert tasks[0].travel_speed == problem.process.travel_speed
    slow = [replace(task, travel_speed=1e-3) for task in tasks]
    quick = [replace(task, travel_speed=np.inf) for task in tasks]
    for rung, by_joints, by_tip in zip(
        (0, -1), home_travel_costs(cell, quick, nodes), home_travel_costs(cell, slow, nodes), strict=True
    ):
        k = tuple(np.argwhere(np.isfinite(nodes.price[rung]))[0])
        v, a, wraps, *_ = joint_limits(nodes, cell.limits)
        way = nodes.q[rung][k].astype(float) - cell.home[:6]
        way[wraps] = np.remainder(way[wraps] + np.pi, 2.0 * np.pi) - np.pi
        times = [
            2.0 * np.sqrt(d / p) if d * p < s * s else d / s + s / p
            for d, s, p in zip(np.abs(way), v[:-1], a[:-1], strict=True)
        ]
        assert by_joints[k] == pytest.approx(HOME_PRICE * max(times))
        fine = cell.home[:6] + np.linspace(0.0, 1.0, 500)[:, None] * way
        tips = cell.T_part_nozzle(np.hstack([fine, np.tile(cell.home[6:], (len(fine), 1))]))[:, :3, 3]
        length = float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())
        assert by_tip[k] == pytest.approx(HOME_PRICE * length / 1e-3, rel=0.02)


def test_counted_turns_are_wound_up_and_back(searched: Searched) -> None:
    """A joint whose turns are counted comes to its angle as it is, and one turn of it takes the time of a turn."""
    _, cell, tasks, _, nodes = searched
    quick = [replace(task, travel_speed=np.inf) for task in tasks]
    joint = 5
    turns = label_turns(turns_counted(nodes, cell.limits, [joint]))[:, 0]
    assert set(turns) >= {-1, 0, 1}
    out, _ = home_travel_costs(cell, quick, nodes, counted=[joint])
    shortest, _ = home_travel_costs(cell, quick, nodes)
    v, a, *_ = joint_limits(nodes, cell.limits)
    there = np.isfinite(nodes.price[0])
    way = nodes.q[0][there][:, joint, None].astype(float) - cell.home[joint] + 2.0 * np.pi * turns
    alone = HOME_PRICE * (np.abs(way) / v[joint] + v[joint] / a[joint])
    full = np.abs(way) > v[joint] ** 2 / a[joint]
    assert (out[there][full] >= alone[full] - 1e-9).all()
    np.testing.assert_allclose(out[there].min(axis=1), shortest[there][:, 0], rtol=1e-6)
    longest = np.maximum(alone, shortest[there])
    assert (out[there][full] <= longest[full] + 1e-9).all()
    assert (alone[full] > shortest[there].repeat(len(turns), axis=1)[full]).any()


def test_a_part_of_the_print_pays_its_share(searched: Searched) -> None:
    _, cell, tasks, _, nodes = searched
    for whole, part in zip(
        home_travel_costs(cell, tasks, nodes), home_travel_costs(cell, tasks, nodes, 0.25), strict=True
    ):
        np.testing.assert_allclose(part, 0.25 * whole)


def test_the_search_ends_where_the_way_home_is_short(searched: Searched) -> None:
    _, cell, tasks, demand, nodes = searched
    free, _ = best_route(nodes, demand, cell.limits)
    out, back = home_travel_costs(cell, tasks, nodes)
    priced, _ = best_route(nodes, demand, cell.limits, (out, back))
    assert free is not None and priced is not None
    assert free.price <= priced.price - _at_ends(priced, nodes, out, back) + 1e-9
    assert priced.price <= free.price + _at_ends(free, nodes, out, back) + 1e-9
    dear = 50.0
    dearer, _ = best_route(nodes, demand, cell.limits, (dear * out, dear * back))
    assert dearer is not None
    assert _at_ends(dearer, nodes, out, back) < _at_ends(free, nodes, out, back)


def _at_ends(route: Route, nodes: Nodes, out: Array, back: Array) -> float:
    """Price [s] of a route's ways from and to home, on a grid whose windows are the whole circle."""
    first, last = ((route.roll[k], route.holder[k], list(nodes.grid.branch[k]).index(route.branch[k])) for k in (0, -1))
    return float(out[first][0] + back[last][0])
