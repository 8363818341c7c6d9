"""The table's path where the layer must stay upright: dynamic programming against brute force, and lean in a cell."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from planner.cell.cell import build_cell
from planner.problem import load_problem
from planner.resolve.joint_path import sample_tasks
from planner.resolve.prices import TABLE_BEYOND_PRICE, TABLE_LEAN_PRICE, TABLE_MOVE_PRICE, TABLE_RETURN_PRICE
from planner.resolve.table_first import ARM_SHARES, _cheapest, slowed, upright_table
from planner.toolpath.task import Cones, NozzleTask


def price(way: list[tuple[int, int]], normals, up, time, step, speed, aim, most, turns, start) -> float:  # type: ignore[no-untyped-def]
    """Price of one way through the lattice, written down once more."""
    shape = up.shape[:2]

    def apart(x: int, y: int, axis: int) -> int:
        d = abs(x - y)
        return min(d, shape[axis] - d) if turns[axis] else d

    total = TABLE_RETURN_PRICE * step * sum(apart(way[0][axis], start[axis], axis) for axis in (0, 1))
    for k, here in enumerate(way):
        if k:
            for axis in (0, 1):
                moved = apart(here[axis], way[k - 1][axis], axis)
                pace = step / (time[k] * speed[axis])
                total += TABLE_MOVE_PRICE * time[k] * (moved * pace) ** 2
        lean = np.arccos(np.clip(normals[k] @ up[here], -1.0, 1.0))
        total += time[max(k, 1)] * (
            TABLE_LEAN_PRICE * max(0.0, lean / aim - 1.0) ** 2 + TABLE_BEYOND_PRICE * max(0.0, lean - most)
        )
    return float(total)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_cheapest_way_against_all_ways(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normals, up = rng.normal(size=(4, 3)), rng.normal(size=(4, 3, 3))
    normals[:, 2], up[..., 2] = 3.0, 3.0
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    up /= np.linalg.norm(up, axis=2)[..., None]
    turns = np.array([seed % 2 == 0, seed % 3 == 0])
    start = rng.integers(0, 3, 2)
    time, step, speed, aim, most = rng.uniform(0.05, 0.4, 4), 0.3, np.array([1.0, 2.0]), 0.2, 0.3
    picked = _cheapest(normals, up, time, step, speed, aim, most, turns, start)
    inputs = (normals, up, time, step, speed, aim, most, turns, start)
    cells = list(itertools.product(range(4), range(3)))
    least = min(price(list(way), *inputs) for way in itertools.product(cells, repeat=4))
    assert price([(int(i), int(j)) for i, j in picked], *inputs) == pytest.approx(least, rel=1e-12)


def leaning_task(lean: float) -> NozzleTask:
    """A circle whose normals lean outwards, all round."""
    phi = np.linspace(0.0, 1.8 * np.pi, 300)
    n = np.column_stack([np.sin(lean) * np.cos(phi), np.sin(lean) * np.sin(phi), np.full(300, np.cos(lean))])
    x = np.cross(n, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x, axis=1)[:, None]
    tip = 0.03 * np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])
    cones = Cones(layer_gravity=np.radians(8.0))
    frames = np.stack([x, np.cross(-n, x), -n], axis=-1)
    return NozzleTask(0, "ring", 0, tip, frames, 0.03 * phi, 0, 299, 0.02, cones)


@pytest.mark.slow
def test_layer_stays_upright_and_the_print_slows_where_the_table_must_hurry() -> None:
    problem = load_problem("cylinder_logo", ["cell.positioner.held_deg={}", "cell.positioner.free=[tilt, rotation]"])
    cell = build_cell(problem)
    task = leaning_task(np.radians(25.0))
    demand = sample_tasks([task], 2e-3)
    angles = upright_table(cell, [task], demand)
    up = cell.holder.poses(angles)[:, 2, :3]
    normals = -demand.frames[demand.rung][:, :, 2]
    lean = np.degrees(np.arccos((up * normals).sum(axis=1)))
    assert lean.max() < 8.0
    assert (np.abs(np.diff(angles, axis=0)) < np.pi / 2).all()  # no turn counted twice
    assert (slowed(cell, demand, angles, ARM_SHARES[0]).time >= demand.time).all()
    quick = replace(demand, time=0.1 * demand.time)
    first, second = (slowed(cell, quick, angles, share).time for share in ARM_SHARES)
    assert first.sum() > quick.time.sum()
    assert (second >= first).all()
    assert second.sum() > first.sum()


def passing_task() -> NozzleTask:
    """Normals that pass the vertical at 9 degrees, quickly: the way straight through the table's axis is the shortest."""
    n = 200
    x, y = np.linspace(0.5, -0.5, n), np.full(n, np.tan(np.radians(9.0)))
    normal = np.column_stack([x, y, np.ones(n)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1)[:, None]
    s = np.linspace(0.0, 0.006, n)
    frames = np.stack([across, np.cross(-normal, across), -normal], axis=-1)
    cones = Cones(layer_gravity=np.radians(8.0))
    return NozzleTask(0, "pass", 0, np.column_stack([s, 0 * s, 0 * s]), frames, s, 0, n - 1, 0.04, cones)


def test_table_turns_all_it_must_rather_than_leave_the_cone() -> None:
    problem = load_problem("cylinder_logo", ["cell.positioner.held_deg={}", "cell.positioner.free=[tilt, rotation]"])
    cell = build_cell(problem)
    demand = sample_tasks([passing_task()], 0.5e-3)
    up = cell.holder.poses(upright_table(cell, [passing_task()], demand))[:, 2, :3]
    normals = -demand.frames[demand.rung][:, :, 2]
    assert np.degrees(np.arccos((up * normals).sum(axis=1))).max() < 8.0
