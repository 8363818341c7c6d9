"""The table's path where cones about the vertical bind it: dynamic programming against brute force, and leans in a cell."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.random_cells import make_case
from planner.cell.cell import Cell, build_cell
from planner.problem import load_problem
from planner.problem.settings import ResolveSpec
from planner.resolve import table_path as module
from planner.resolve.joint_path import leaned, sample_tasks, spread, turned_from
from planner.resolve.ladder import ladder
from planner.resolve.prices import (
    BRANCH_PRICE,
    DIP_PRICE,
    HOME_PRICE,
    NO_POSTURE_PRICE,
    TABLE_MOVE_PRICE,
    TRAVEL_PRICE,
)
from planner.resolve.table_path import Cells, Steps, _cheapest, _posture_prices, carried, table_path
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import Cones, NozzleTask, smooth_normals, tasks_of

SIZE = (5, 4, 3)  # tilts, rotations, headings
BRANCHES = 2
STEPS = Steps(np.array([0.3, 0.4, 2.0]), np.array([1.0, 2.0, 5.0]), np.array([2, 1, 1]))


def some_cells(seed: int) -> tuple[Cells, NDArray[np.float32], NDArray[np.bool_]]:
    """Four rungs of two beads with a few cells each, and random prices."""
    rng = np.random.default_rng(seed)
    places = [rng.choice(SIZE[0] * SIZE[1], rng.integers(2, 4), replace=False) for _ in range(4)]
    first = np.concatenate([[0], np.cumsum([len(p) for p in places])])
    at = np.concatenate(places)
    cells = Cells(
        first,
        (at // SIZE[1]).astype(np.int32),
        (at % SIZE[1]).astype(np.int32),
        rng.uniform(0.0, 1.0, len(at)).astype(np.float32),
        rng.integers(0, 6, len(at)),
        np.concatenate([[0.0], rng.uniform(0.05, 0.4, 3)]),
        np.array([True, False, True, False]),
    )
    price = rng.uniform(0.0, 2.0, (6, SIZE[2], BRANCHES)).astype(np.float32)
    return cells, price, np.array([seed % 2 == 0, seed % 3 == 0, True])


def price_of(
    way: list[tuple[int, int, int]],
    cells: Cells,
    price: NDArray[np.float32],
    turns: NDArray[np.bool_],
    anywhere: bool = False,
) -> float:
    """The price of one way (cell, heading, branch) [s], written down once more; infinite for a move that is too long, or leads
    past what are no cells, unless it may anywhere."""
    total = HOME_PRICE * (cells.a[way[0][0]] * 0.3 / 1.0 + cells.b[way[0][0]] * 0.4 / 2.0)  # from 0, 0
    for k, (x, h, c) in enumerate(way):
        begins = bool(cells.begins[k])
        time = cells.time[k]
        spell = cells.time[k + 1] if begins else time
        total += spell * (cells.lean[x] + price[cells.voxel[x], h, c])
        if k == 0:
            continue
        y, g, e = way[k - 1]
        for axis, (one, other) in enumerate(((cells.a[x], cells.a[y]), (cells.b[x], cells.b[y]), (h, g))):
            d = abs(int(one) - int(other))
            if turns[axis]:
                d = min(d, SIZE[axis] - d)
            need = d * STEPS.step[axis] / STEPS.speed[axis]
            if begins:
                total += TRAVEL_PRICE * need
            elif d > STEPS.longest[axis]:
                return np.inf
            else:
                share = min(need / time, 1.0)
                total += TABLE_MOVE_PRICE * time * share**2 + (1.0 + DIP_PRICE) * max(0.0, need - time)
        if not (begins or anywhere or leads_past_cells(cells, k, y, x, turns)):
            return np.inf
        if e != c:
            if not begins:
                return np.inf
            total += BRANCH_PRICE
    return float(total)


def leads_past_cells(cells: Cells, k: int, y: int, x: int, turns: NDArray[np.bool_]) -> bool:
    """Whether tilt and then rotation pass lattice points alone, from cell y to cell x of rung k, that are cells of either rung."""
    either = slice(cells.first[k - 1], cells.first[k + 1])
    there = set(zip(cells.a[either].tolist(), cells.b[either].tolist(), strict=True))
    (a0, b0), (a1, b1) = ((int(cells.a[i]), int(cells.b[i])) for i in (y, x))
    tilts = [(a, b0) for a in between(a0, a1, SIZE[0], turns[0])]
    return there >= {*tilts, *((a1, b) for b in between(b0, b1, SIZE[1], turns[1]))}


def between(one: int, other: int, n: int, turns: bool) -> list[int]:
    """Numbers on the way from one to another, round the circle if that is shorter."""
    d = other - one
    if turns and 2 * abs(d) > n:
        d -= n if d > 0 else -n
    step = 1 if d > 0 else -1
    return [(one + step * i) % n for i in range(1, abs(d))]


@pytest.mark.slow(keep=("2-1.0",))
@pytest.mark.parametrize("kept", [5e7, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_cheapest_way_against_all_ways(seed: int, kept: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the programme is searched in blocks, whose values are found again on the way back."""
    monkeypatch.setattr(module, "_MOST_VALUES", kept)
    cells, price, turns = some_cells(seed)
    per_rung = [
        list(itertools.product(range(cells.first[k], cells.first[k + 1]), range(SIZE[2]), range(BRANCHES)))
        for k in range(4)
    ]
    for anywhere in (False, True):
        prices = {}  # of the best way with these cells
        for way in itertools.product(*per_rung):
            key = tuple(int(x) for x, _, _ in way)
            prices[key] = min(prices.get(key, np.inf), price_of(list(way), cells, price, turns, anywhere))
        least = min(prices.values())
        if np.isfinite(least):
            break
    if not np.isfinite(least):
        pytest.skip("no way at all")
    picked = _cheapest(cells, price, turns, STEPS, SIZE, np.zeros(2, dtype=np.int64))
    found = []
    for k, (a, b) in enumerate(picked):
        here = np.arange(cells.first[k], cells.first[k + 1])
        found.append(int(here[(cells.a[here] == a) & (cells.b[here] == b)][0]))
    assert prices[tuple(found)] == pytest.approx(least, rel=1e-5)


def two_axes() -> Cell:
    free = ["cell.positioner.held_deg={}", "cell.positioner.free=[tilt, rotation]"]
    return build_cell(load_problem("cylinder_logo", free))


def on_track(home_mm: float) -> tuple[Cell, ResolveSpec]:
    """The same table beside an arm on a track, which reaches it from 1500 mm; and how its paths are searched."""
    changes = [
        "cell.positioner.held_deg={}", "cell.positioner.free=[tilt, rotation]", "cell.home_deg=[-60, 20, 30, 90, -80, 60]",
        "cell.base_mm=[0, -1500, -300]", "cell.base_rpy_deg=[0, 0, 90]",
        f"cell.base={{robot: track_3m, free: [rail], home_mm: {{rail: {home_mm}}}}}",
    ]  # fmt: skip
    problem = load_problem("cylinder_logo", [*changes, "resolve.rung_mm=10", "resolve.roll_step_deg=30"])
    return build_cell(problem), problem.resolve


def on_normals(
    normals: NDArray[np.float64], tip: NDArray[np.float64], s: NDArray[np.float64], cones: Cones
) -> NozzleTask:
    x = np.cross(normals, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x, axis=1)[:, None]
    frames = np.stack([x, np.cross(-normals, x), -normals], axis=-1)
    return NozzleTask(0, "ring", 0, tip, frames, s, 0, len(s) - 1, 0.02, cones)


def ring(lean: float, cones: Cones) -> NozzleTask:
    """A circle whose normals lean outwards, all round."""
    phi = np.linspace(0.0, 1.8 * np.pi, 300)
    n = np.column_stack([np.sin(lean) * np.cos(phi), np.sin(lean) * np.sin(phi), np.full(300, np.cos(lean))])
    return on_normals(n, 0.03 * np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi]), 0.03 * phi, cones)


def leans(cell: Cell, task: NozzleTask, spacing: float) -> NDArray[np.float64]:
    """How far the layer leans at the rungs [deg]."""
    demand = sample_tasks([task], spacing)
    up = cell.holder.poses(table_path(cell, [task], demand))[:, 2, :3]
    return np.degrees(np.arccos((up * task.normals[demand.rung]).sum(axis=1)))


@pytest.mark.slow
def test_layer_stays_upright_and_no_turn_is_counted_twice() -> None:
    cell, task = two_axes(), ring(np.radians(25.0), Cones(layer_gravity=np.radians(8.0)))
    assert leans(cell, task, 2e-3).max() < 8.0
    angles = table_path(cell, [task], sample_tasks([task], 2e-3))
    assert (np.abs(np.diff(angles, axis=0)) < np.pi / 2).all()


def test_the_table_turns_all_it_must_rather_than_leave_the_cone() -> None:
    """Normals that pass the vertical at 9 degrees, quickly: the way straight through the table's axis is the shortest."""
    n = 200
    normals = np.column_stack([np.linspace(0.5, -0.5, n), np.full(n, np.tan(np.radians(9.0))), np.ones(n)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    s = np.linspace(0.0, 0.006, n)
    task = on_normals(normals, np.column_stack([s, 0 * s, 0 * s]), s, Cones(layer_gravity=np.radians(8.0)))
    assert leans(two_axes(), task, 0.5e-3).max() < 8.0


def test_a_table_that_is_wound_too_far_begins_elsewhere(tmp_path: Path) -> None:
    """Within a range of little more than a turn, of which the way along the circle would leave more than one end."""
    problem = load_problem(make_case("cones", 30).write(tmp_path))
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    tasks = tasks_of(problem, toolpath)
    demand = sample_tasks(tasks, problem.resolve.rung)
    found = table_path(cell, tasks, demand)
    round_, wound = module._table_path(cell, tasks, demand, frozenset())
    na = len(cell.arm)
    low, high = cell.limits.q_min[na:], cell.limits.q_max[na:]
    assert wound == {1}
    assert np.ptp(round_[:, 1]) > np.radians(200.0)
    assert ((low < found) & (found < high)).all()


def test_carried_twists_are_those_of_the_nozzle_while_the_table_moves() -> None:
    """A nozzle pose in the world, taken from the frames that come back, against their twists by differences."""
    cell = two_axes()
    task = ring(np.radians(20.0), Cones(np.radians(12.0), np.radians(8.0), np.radians(20.0)))
    demand = sample_tasks([task], 2e-3)
    held = table_path(cell, [task], demand)
    moved = carried(cell, [task], demand, held)
    T = cell.holder.poses(spread(held, len(task), demand.place))
    R = T[:, :3, :3] @ moved.frames
    np.testing.assert_allclose(np.swapaxes(R, 1, 2) @ R, np.tile(np.eye(3), (300, 1, 1)), atol=1e-12)
    lean = np.arccos(-R[:, 2, 2])
    layer = np.arccos((T[:, 2, :3] * task.normals).sum(axis=1))
    np.testing.assert_allclose(lean, 8.0 / 20.0 * layer, atol=1e-9)
    # the nozzle does not turn about its axis, whatever the table does: its x stays ahead
    assert (R[:, 0, 0] > 0.99).all()
    t = task.s / task.speed
    tip = np.einsum("nij,nj->ni", T[:, :3, :3], task.tip) + T[:, :3, 3]
    k = int(demand.rung[5])
    R_rung = cell.holder.poses(held[5:6])[0, :3, :3]
    np.testing.assert_allclose(R_rung @ moved.twist[k, :3], np.gradient(tip, t, axis=0)[k], atol=1e-9)
    spin = (R[k + 1] - R[k - 1]) @ R[k].T / (t[k + 1] - t[k - 1])
    seen = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    np.testing.assert_allclose(R_rung @ moved.twist[k, 3:], seen, atol=1e-3 * np.linalg.norm(seen) + 1e-6)


def test_lean_comes_down_by_a_share_and_is_found_again() -> None:
    rng = np.random.default_rng(3)
    R = np.linalg.qr(rng.normal(size=(50, 3, 3)))[0]
    R *= np.linalg.det(R)[:, None, None]
    R[R[:, 2, 2] > 0] = R[R[:, 2, 2] > 0] @ np.diag([1.0, -1.0, -1.0])
    down = leaned(R, 0.4)
    np.testing.assert_allclose(np.arccos(-down[:, 2, 2]), 0.4 * np.arccos(-R[:, 2, 2]), atol=1e-9)
    np.testing.assert_array_equal(leaned(R, 1.0).round(12), R.round(12))
    roll, tilt = turned_from(R, down)
    size = np.hypot(*tilt.T)
    np.testing.assert_allclose(size, 0.6 * np.arccos(-R[:, 2, 2]), atol=1e-9)
    assert np.abs(roll - roll[0]).max() > 0.0 or len(roll) == 1


def test_normals_are_smoothed_but_not_beyond_half_the_cone() -> None:
    rng = np.random.default_rng(0)
    s = 0.2e-3 * np.arange(1000)
    angle = s / 0.05
    clean = np.column_stack([np.sin(angle), 0 * s, np.cos(angle)])
    noisy = clean + 0.02 * rng.normal(size=(1000, 3))
    noisy /= np.linalg.norm(noisy, axis=1)[:, None]

    def off(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.arccos(np.clip((a * b).sum(axis=1), -1.0, 1.0))

    smooth = smooth_normals(noisy, s, np.radians(20.0))
    assert off(smooth, clean).mean() < 0.35 * off(noisy, clean).mean()
    jerky = np.linalg.norm(np.diff(noisy, n=3, axis=0), axis=1).max()
    assert np.linalg.norm(np.diff(smooth, n=3, axis=0), axis=1).max() < 0.05 * jerky
    np.testing.assert_allclose(smooth_normals(clean, s, 0.1), clean, atol=2e-5)  # an even turn stays as it is
    edge = clean.copy()
    edge[500:] = edge[500:] @ np.array([[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]])
    cone = np.radians(6.0)
    assert np.degrees(off(smooth_normals(edge, s, cone), edge).max()) < 3.0 + 1e-6


def test_smoothed_normals_turn_with_the_samples_round_a_corner() -> None:
    """Round a sharp corner the tip goes slower from sample to sample, and the normal turns evenly: so it is to stay."""
    u, steep = np.linspace(-5e-3, 5e-3, 201), np.radians(70.0)
    tip = np.column_stack([np.cos(steep) * u, np.sin(steep) * np.hypot(u, 1e-4)])
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1)))
    assert np.diff(s).min() < 0.5 * np.diff(s).max()
    angle = tip[:, 0] / 5e-3
    normals = np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle)])
    jerk = np.linalg.norm(np.diff(smooth_normals(normals, s, np.radians(10.0)), n=3, axis=0), axis=1).max()
    assert jerk < 10.0 * np.linalg.norm(np.diff(normals, n=3, axis=0), axis=1).max()


def test_where_no_angles_keep_to_the_cone_the_nearest_are_taken() -> None:
    """A table that turns about the vertical alone cannot lay a steep ring down."""
    cell = two_axes()
    limits = cell.limits
    j = len(cell.arm)
    low, high = limits.q_min.copy(), limits.q_max.copy()
    low[j], high[j] = -np.radians(5.0), np.radians(5.0)
    stiff = replace(cell, limits=replace(limits, q_min=low, q_max=high))
    lean = leans(stiff, ring(np.radians(25.0), Cones(layer_gravity=np.radians(8.0))), 4e-3)
    assert (lean > 18.0).all()
    assert lean.max() < 24.0


@pytest.mark.parametrize("home_mm", [0.0, 1500.0])
def test_the_table_is_planned_for_an_arm_that_goes_along_on_its_track(home_mm: float) -> None:
    cell, _ = on_track(home_mm)
    tips = cell.arm.poses(cell.home[None, : len(cell.arm)])[0, :3, 3] + np.outer([0.0, 0.7, 1.4], [0.0, 1.0, 0.0])
    assert (_posture_prices(cell, tips, 0.04).min(axis=(1, 2)) < NO_POSTURE_PRICE).all()


@pytest.mark.slow
def test_a_rail_brings_the_arm_to_a_bound_table() -> None:
    """From 1 m beside it, whence the arm does not reach it."""
    (cell, settings), task = on_track(500.0), ring(np.radians(12.0), Cones(layer_gravity=np.radians(8.0)))
    (path,) = ladder(cell, [task], settings)
    np.testing.assert_allclose(cell.T_part_nozzle(path.q)[:, :3, 3], task.tip, atol=1e-6)
    assert path.q[:, 0].min() > 0.9


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_noisy_normals_are_named(noise: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    s = np.arange(0.0, 40.0, 0.8)
    normals = np.column_stack([np.sin(s / 100.0), 0.0 * s, np.cos(s / 100.0)]) + noise * rng.normal(size=(len(s), 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    rows = np.column_stack([100.0 * np.sin(s / 100.0), 0.0 * s, 100.0 * np.cos(s / 100.0), normals])
    np.savetxt(tmp_path / "line.txt", rows, fmt="%.6f")
    problem = load_problem("peer_cap", [f"layers.source={{waypoints: {tmp_path / 'line.txt'}}}"])
    notes = [note for note in build_toolpath(problem).notes if "noisy" in note]
    assert len(notes) == (1 if noise else 0)
    leaning = load_problem("peer_cap", [*problem.overrides, "process.cones.nozzle_normal_deg=5"])
    assert not any("noisy" in note for note in build_toolpath(leaning).notes)
