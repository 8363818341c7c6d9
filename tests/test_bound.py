"""The lower bound of a ladder's price, against exact searches of the whole fine grid."""

from __future__ import annotations

import pytest

from planner.cell.cell import Cell, build_cell
from planner.problem import load_problem
from planner.resolve.ladder import ladder_route, lower_bound
from planner.resolve.nodes import evaluate, full_grid
from planner.resolve.search import LadderRoute, best_route
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import make_tasks

SETTINGS = ["layers.count=1", "resolve.rung_mm=20", "resolve.roll_step_deg=45", "resolve.table_step_deg=45"]


@pytest.fixture(scope="module")
def searched() -> tuple[Cell, LadderRoute, float, float]:
    """A cell, the ladder's route over two beads, the least singular value, and the best price on the fine grid."""
    problem = load_problem("cylinder_logo", SETTINGS)
    cell = build_cell(problem)
    tasks = make_tasks(build_toolpath(problem), problem.process.speed, problem.process.run_in)[:2]
    found = ladder_route(cell, tasks, problem.resolve)
    grid = found.nodes.grid
    whole = full_grid(found.demand, 8, grid.roll_step, grid.holder_step, True, grid.swept, grid.held)
    sigma = problem.resolve.min_sigma
    best, _ = best_route(evaluate(cell, found.demand, whole, sigma), found.demand, cell.limits)
    assert best is not None
    return cell, found, sigma, best.price


@pytest.mark.slow
@pytest.mark.parametrize("piece", [1, 3, 1000])
def test_no_route_on_the_fine_grid_costs_less_than_the_bound(
    searched: tuple[Cell, LadderRoute, float, float], piece: int
) -> None:
    cell, found, sigma, best = searched
    bound = lower_bound(cell, found, sigma, piece)
    assert 0.0 < bound <= best * (1.0 + 1e-9)
    assert best <= found.route.price * (1.0 + 1e-9)


@pytest.mark.slow
def test_longer_pieces_bound_no_worse(searched: tuple[Cell, LadderRoute, float, float]) -> None:
    cell, found, sigma, _ = searched
    short, long = (lower_bound(cell, found, sigma, piece) for piece in (1, 1000))
    assert short <= long * (1.0 + 1e-9)


def test_one_rung_at_a_time_is_the_sum_of_the_cheapest_nodes(searched: tuple[Cell, LadderRoute, float, float]) -> None:
    cell, found, sigma, _ = searched
    grid = found.nodes.grid
    whole = full_grid(found.demand, 8, grid.roll_step, grid.holder_step, True, grid.swept, grid.held)
    prices = evaluate(cell, found.demand, whole, sigma).price
    assert lower_bound(cell, found, sigma, 1) == pytest.approx(prices.min(axis=(1, 2, 3)).sum(), rel=1e-9)
