"""The search over a grid against brute force, with turns counted, and how its route is spread over samples."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_resolve import TURN

import planner.resolve.ladder
import planner.resolve.search
from planner.base.arrays import Array
from planner.cell.cell import Cell, Limits
from planner.problem import Problem
from planner.resolve.joint_path import MARGIN, SampledTasks, spread
from planner.resolve.ladder import ClearSearch, coarse_nodes
from planner.resolve.nodes import Grid, Nodes
from planner.resolve.prices import (
    DIP_PRICE,
    FAR,
    FAR_PRICE,
    TRAVEL_PRICE,
    TURN_PRICE,
)
from planner.resolve.search import (
    JUMP,
    SPEED_SHARE,
    Route,
    best_route,
    greedy_route,
    may_be_counted,
    turns_counted,
)
from planner.toolpath.task import NozzleTask

# --- the search -------------------------------------------------------------------------------------------------


def slow_travel(qa: Array, qb: Array, turn: float, limits: Limits) -> float:
    """Rest to rest with bang-bang acceleration; the slowest of the seven axes; those with room for a turn go the short way."""
    d = qb - qa
    wraps = (limits.q_max - limits.q_min)[: len(d)] > TURN
    d = np.abs(np.append(np.where(wraps, np.remainder(d + np.pi, TURN) - np.pi, d), turn))
    v, a = limits.velocity, limits.acceleration
    times = [2 * np.sqrt(x / y) if x < w * w / y else x / w + w / y for x, w, y in zip(d, v, a, strict=True)]
    return TRAVEL_PRICE * max(times)


def slow_edge(q0: Array, q1: Array, straight: Array, turn: float, time: float, limits: Limits, far: float) -> float:
    def difference(x: Array, y: Array) -> Array:
        d = x - y
        wraps = (limits.q_max - limits.q_min)[: len(d)] > TURN
        return np.where(wraps, np.remainder(d + np.pi, TURN) - np.pi, d)

    steps = np.abs(np.append(difference(q1.copy(), q0), turn))
    if (steps[:-1] > JUMP).any():
        return np.inf
    need = float((steps / (SPEED_SHARE * limits.velocity)).max())
    change = np.abs(np.append(difference(q1.copy(), straight), turn))
    share = min(float((change / (SPEED_SHARE * limits.velocity)).max()) / time, 1.0)
    beyond = max(0.0, steps[:-1].max() - far)
    return TURN_PRICE * time * share**2 + (1.0 + DIP_PRICE) * max(0.0, need - time) + FAR_PRICE * beyond


def table_turn(nodes: Nodes, there: int, here: int, limits: Limits) -> float:
    """What the swept joint, the seventh, turns by in travel [rad of the grid]: the short way round, or within its range."""
    zero, unit = nodes.scale
    angles = np.array([there, here]) * nodes.grid.holder_step
    if 6 in limits.sliding or limits.q_max[6] - limits.q_min[6] < TURN:
        middle = (0.5 * (limits.q_min[6] + limits.q_max[6]) - zero) / unit
        angles = middle + np.remainder(angles - middle + np.pi, TURN) - np.pi
        return float(angles[0] - angles[1])
    turn = angles[0] - angles[1]
    return float(turn - TURN * np.round(turn / TURN))


def edge_matrix(nodes: Nodes, demand: SampledTasks, r: int, limits: Limits, far: float = FAR) -> Array:
    """Prices (k, k) of getting from each node of rung r - 1 to each of rung r."""
    grid = nodes.grid
    shape = nodes.price.shape[1:]
    k = int(np.prod(shape))
    E = np.full((k, k), np.inf)
    q = nodes.q.astype(float)
    starts_a_task = r in demand.task_rungs
    for f, (a0, b0, c0) in enumerate(np.ndindex(shape)):
        for t, (a1, b1, c1) in enumerate(np.ndindex(shape)):
            db = (grid.holder_from[r] + b1) - (grid.holder_from[r - 1] + b0)
            if starts_a_task:
                turn = table_turn(nodes, grid.holder_from[r] + b1, grid.holder_from[r - 1] + b0, limits)
                E[f, t] = slow_travel(q[r - 1, a0, b0, c0], q[r, a1, b1, c1], turn, limits)
                continue
            if c0 != c1:
                continue
            da = (grid.roll_from[r] + a1) - (grid.roll_from[r - 1] + a0)
            stay_a, stay_b = a1 - da, b1 - db  # where keeping roll and holder would lead, in this rung's window
            if grid.periodic:
                da = (da + shape[0] // 2) % shape[0] - shape[0] // 2
                db = (db + shape[1] // 2) % shape[1] - shape[1] // 2
                stay_a, stay_b = (a1 - da) % shape[0], (b1 - db) % shape[1]
            if abs(da) > 1 or abs(db) > 1 or not (0 <= stay_a < shape[0] and 0 <= stay_b < shape[1]):
                continue
            if not np.isfinite(nodes.price[r, stay_a, stay_b, c1]):
                continue
            E[f, t] = slow_edge(
                q[r - 1, a0, b0, c0], q[r, a1, b1, c1], q[r, stay_a, stay_b, c1],
                db * grid.holder_step, demand.time[r], limits, far,
            )  # fmt: skip
    return E


def brute_force(nodes: Nodes, demand: SampledTasks, limits: Limits) -> tuple[Array, list[Array]]:
    """The price of every way through the ladder there is, and the edges' prices."""
    R = len(demand.rung)
    edges = [edge_matrix(nodes, demand, r, limits) for r in range(1, R)]
    total = nodes.price[0].ravel()
    for r in range(1, R):
        total = total[..., None] + edges[r - 1] + nodes.price[r].ravel()
    return total, edges


def price_along(route: Route, nodes: Nodes, edges: list[Array]) -> float:
    """Price of a route, added up node by node and edge by edge."""
    grid = nodes.grid
    shape = nodes.price.shape[1:]
    r = np.arange(len(route.roll))
    a, b = route.roll - grid.roll_from, route.holder - grid.holder_from
    c = np.array([list(grid.branch[i]).index(k) for i, k in enumerate(route.branch)])
    flat = np.ravel_multi_index((a, b, c), shape)
    total = sum(float(nodes.price[i].ravel()[flat[i]]) for i in r)
    return total + sum(float(edges[i][flat[i], flat[i + 1]]) for i in r[:-1])


def first_dead_rung(nodes: Nodes, edges: list[Array]) -> int:
    """The first rung that no way reaches."""
    alive = np.isfinite(nodes.price[0].ravel())
    for r in range(len(nodes.price)):
        if r > 0:
            alive = (alive[:, None] & np.isfinite(edges[r - 1])).any(axis=0) & np.isfinite(nodes.price[r].ravel())
        if not alive.any():
            return r
    return -1


def tiny_ladder(rng: np.random.Generator, periodic: bool) -> tuple[Nodes, SampledTasks, Limits]:
    """At most four rungs in one to three tasks, three rolls, three holder angles, two branches."""
    R = int(rng.integers(2, 5))
    A, B, C = int(rng.integers(1, 4)), int(rng.integers(1, 4)), int(rng.integers(1, 3))
    if periodic:
        A, B = max(A, 2), B if B != 2 else 3
        roll_from = holder_from = np.zeros(R, dtype=np.int64)
    else:
        roll_from, holder_from = (np.cumsum(rng.integers(-1, 2, R)) for _ in range(2))
        if B == 1:
            holder_from = np.zeros(R, dtype=np.int64)
    step = TURN / max(B, 3) if periodic else 0.2
    branch = np.tile(rng.permutation(8)[:C], (R, 1)).astype(np.int64)
    grid = Grid(0.3, step, roll_from, holder_from, A, B, periodic, branch)
    q = rng.uniform(0.0, rng.choice([0.5, 1.2, 3.0]), (R, A, B, C, 6))
    q[..., 5] += TURN * rng.integers(-1, 2, (R, A, B, C))
    price = rng.exponential(0.3, (R, A, B, C))
    price[rng.random((R, A, B, C)) < rng.choice([0.0, 0.3, 0.6])] = np.inf
    q[~np.isfinite(price)] = 0.0
    cuts = np.sort(rng.choice(np.arange(1, R), rng.integers(0, min(R - 1, 2) + 1), replace=False))
    task_rungs = np.concatenate([[0], cuts, [R]]).astype(np.int64)
    time = rng.uniform(0.7, 1.5, R)
    time[task_rungs[:-1]] = 0.0
    empty = np.zeros(0)
    index = np.arange(R)
    demand = SampledTasks(
        empty, empty, empty, empty, empty, empty, empty, index, empty, index, index + 1, time, task_rungs
    )
    v, a = rng.uniform(0.5, 1.2, 7), rng.uniform(2.0, 6.0, 7)
    v[6] = 4.0 if periodic else 0.5
    limits = Limits(np.full(7, -9.0), np.full(7, 9.0), v, a, 50 * a)
    return Nodes(grid, q.astype(np.float32), price, 6), demand, limits


@pytest.mark.slow(keep=("False",))
@pytest.mark.parametrize("periodic", [True, False])
def test_search_against_brute_force(periodic: bool) -> None:
    rng = np.random.default_rng(7 + periodic)
    solved = stuck_ones = dearer = 0
    for _ in range(150):
        nodes, demand, limits = tiny_ladder(rng, periodic)
        total, edges = brute_force(nodes, demand, limits)
        route, stuck = best_route(nodes, demand, limits)
        quick, quick_stuck = greedy_route(nodes, demand, limits)
        if not np.isfinite(total.min()):
            assert route is None
            assert quick is None
            assert stuck == first_dead_rung(nodes, edges)
            stuck_ones += 1
            continue
        assert route is not None
        assert stuck == -1
        assert route.price == pytest.approx(total.min(), rel=1e-6)
        assert price_along(route, nodes, edges) == pytest.approx(total.min(), rel=1e-6)
        solved += 1
        if quick is not None:
            assert quick_stuck == -1
            own = [edge_matrix(nodes, demand, r, limits, far=JUMP) for r in range(1, len(demand.rung))]
            assert price_along(quick, nodes, own) == pytest.approx(quick.price, rel=1e-6)
            its_price = price_along(quick, nodes, edges)
            assert its_price >= route.price * (1 - 1e-6)
            dearer += its_price > route.price * (1 + 1e-6)
    assert solved > 50
    assert stuck_ones > 5
    assert dearer > 5


def test_a_table_that_slides_travels_the_whole_way() -> None:
    """No short way leads round from one end of its range to the other."""
    rng = np.random.default_rng(3)
    longer = 0
    for _ in range(60):
        nodes, demand, limits = tiny_ladder(rng, True)
        turning, _ = best_route(nodes, demand, limits)
        unit = 3.0 / TURN
        scale = np.append(np.ones(6), unit)
        sliding = replace(
            limits,
            q_min=np.append(limits.q_min[:6], 0.0),
            q_max=np.append(limits.q_max[:6], 3.0),
            velocity=limits.velocity * scale,
            acceleration=limits.acceleration * scale,
            sliding=(6,),
        )
        nodes = replace(nodes, scale=(0.0, unit))
        by_angle = replace(sliding, velocity=limits.velocity, acceleration=limits.acceleration)
        total, _ = brute_force(nodes, demand, by_angle)
        route, _ = best_route(nodes, demand, sliding)
        if route is None:
            assert turning is None and not np.isfinite(total.min())
            continue
        assert turning is not None
        assert route.price == pytest.approx(total.min(), rel=1e-6)
        longer += route.price > turning.price * (1 + 1e-6)
    assert longer


def winds_within(along: Array, low: float, high: float) -> bool:
    """Whether whole turns bring angles (r) that change by less than half a turn from rung to rung into a range."""
    angles = np.unwrap(along)
    turns = np.ceil((low - angles.min()) / TURN) * TURN
    return bool(angles.max() + turns <= high)


@pytest.mark.slow
@pytest.mark.parametrize("counted", [(5,), (4, 5), (6,), (5, 6)])
def test_counted_turns_against_brute_force(counted: tuple[int, ...]) -> None:
    """Of all ways whose joints stay within their ranges along every bead, however they are turned, the cheapest one."""
    rng = np.random.default_rng(sum(counted))
    bound = refused = 0
    for _ in range(200):
        nodes, demand, limits = tiny_ladder(rng, periodic=True)
        # joints that turn by up to 2 rad from rung to rung, in ranges of little more than a turn
        q = nodes.q.copy()
        q[..., [4, 5]] = rng.uniform(-np.pi, np.pi, (*q.shape[:-1], 2))
        nodes = replace(nodes, q=q, joint=6)
        half = np.full(7, 9.0)
        half[[4, 5]], half[6] = 3.3, rng.uniform(0.5, 4.0)
        limits = replace(limits, q_min=-half, q_max=half)
        total, _ = brute_force(nodes, demand, limits)
        for way in np.argwhere(np.isfinite(total)):
            a, b, c = np.unravel_index(way, nodes.price.shape[1:])
            r = np.arange(len(way))
            angles = np.column_stack([nodes.q[r, a, b, c], (nodes.grid.holder_from + b) * nodes.grid.holder_step])
            for k in range(len(demand.task_rungs) - 1):
                own = angles[demand.rungs_of(k)].astype(float)
                if not all(winds_within(own[:, j], -half[j] + MARGIN, half[j] - MARGIN) for j in counted):
                    total[tuple(way)] = np.inf
        free, _ = best_route(nodes, demand, limits)
        route, _ = best_route(nodes, demand, limits, counted=counted)
        if not np.isfinite(total.min()):
            assert route is None
            refused += free is not None
            continue
        assert route is not None
        assert free is not None
        assert route.price == pytest.approx(total.min(), rel=1e-6, abs=1e-5)  # joints are 32 bits
        bound += route.price > free.price * (1 + 1e-6)
    assert bound + refused > 3


def test_turns_that_do_not_fit_in_memory_are_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is found then is the route that winds the table too far, whose paths are refused by the table's name."""
    nodes, demand, limits = tiny_ladder(np.random.default_rng(1), periodic=True)
    turns = turns_counted(nodes, limits, [6])
    assert turns.number.prod() > 1
    monkeypatch.setattr(planner.resolve.search, "MOST_LABELLED", nodes.price.size)
    assert may_be_counted(nodes, turns_counted(nodes, limits, []))
    assert not may_be_counted(nodes, turns)
    r = len(nodes.price)
    route = Route(*np.zeros((3, r), dtype=np.int64), 1.0)
    monkeypatch.setattr(ClearSearch, "_clear", lambda *_: (route, -1))
    monkeypatch.setattr(planner.resolve.ladder, "overwound", lambda *_: {6})
    search = object.__new__(ClearSearch)
    vars(search).update(
        _cell=SimpleNamespace(limits=limits), _demand=demand, nodes=nodes, _looked=np.ones(r, dtype=bool), wound=None
    )
    assert search.best() == (None, r - 1)
    assert search.wound is route


def test_search_prefers_a_short_travel() -> None:
    """Two beads of one rung each: the second one is started where the first one's joints are, price or no price."""
    q = np.zeros((2, 3, 1, 1, 6), dtype=np.float32)
    q[:, :, 0, 0, 0] = [0.0, 1.0, 2.0]
    price = np.full((2, 3, 1, 1), 1e-6)
    price[0, [0, 1]] = np.inf
    zero = np.zeros(2, dtype=np.int64)
    grid = Grid(0.3, TURN, zero, zero, 3, 1, True, np.zeros((2, 1), dtype=np.int64))
    empty = np.zeros(0)
    demand = SampledTasks(
        empty, empty, empty, empty, empty, empty, empty, zero, empty, zero, zero + 1, np.zeros(2), np.array([0, 1, 2])
    )
    limits = Limits(*(np.full(7, x) for x in (-9.0, 9.0, 1.0, 5.0, 250.0)))
    route, _ = best_route(Nodes(grid, q, price, 6), demand, limits)
    assert route is not None
    np.testing.assert_array_equal(route.roll, [2, 2])
    assert route.price == pytest.approx(2e-6)


def test_greedy_is_never_cheaper_on_the_real_ladder(
    cell: Cell, tasks: tuple[NozzleTask, ...], drawing_problem: Problem
) -> None:
    demand, nodes = coarse_nodes(cell, tasks, drawing_problem.resolve)
    best, _ = best_route(nodes, demand, cell.limits)
    quick, _ = greedy_route(nodes, demand, cell.limits)
    assert best is not None
    assert quick is not None
    assert best.price <= quick.price
    for i in range(len(tasks)):
        assert len(set(best.branch[demand.rungs_of(i)])) == 1


# --- spreading --------------------------------------------------------------------------------------------------


@given(
    values=st.lists(st.floats(-10, 10), min_size=1, max_size=14),
    n=st.integers(2, 60),
)
@settings(max_examples=80)
def test_spread_stays_within_its_values_and_keeps_the_ends(values: list[float], n: int) -> None:
    rows = np.array(values)
    places = np.linspace(0.0, 1.0, len(rows))
    curve = spread(rows, n, places)
    assert curve.shape == (n,)
    assert curve[0] == pytest.approx(values[0], abs=1e-9)
    assert curve[-1] == pytest.approx(values[-1], abs=1e-9)
    assert curve.min() >= min(values) - 1e-9
    assert curve.max() <= max(values) + 1e-9
    if (np.diff(rows) >= 0).all():
        assert (np.diff(curve) >= -1e-9).all()
    # each column for itself, and linear in the values
    both = spread(np.column_stack([rows, 2.0 * rows + 1.0]), n, places)
    np.testing.assert_allclose(both, np.column_stack([curve, 2.0 * curve + 1.0]), rtol=0, atol=1e-9)


def test_spread_keeps_close_to_where_its_values_are() -> None:
    """A local change of one value is felt nearby only."""
    values = np.zeros(40)
    values[20] = 1.0
    curve = spread(values, 401, np.linspace(0.0, 1.0, 40))
    felt = np.flatnonzero(np.abs(curve) > 1e-12) / 400
    assert felt.min() > (20 - 4) / 39
    assert felt.max() < (20 + 4) / 39
    assert 0.5 < curve.max() < 0.6  # the quintic B-spline's own maximum is 11 / 20


def test_spread_has_four_continuous_derivatives() -> None:
    values = np.random.default_rng(3).normal(size=12)
    curve = spread(values, 14_001, np.linspace(0.0, 1.0, 12))
    for order in (1, 2, 3, 4):
        rows = np.diff(curve[::20], order)
        inner = rows[5:-5]
        assert np.abs(np.diff(inner)).max() < 0.12 * np.abs(rows).max(), order
