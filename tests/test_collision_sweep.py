"""Least distances against dense sampling and brute force, on motions drawn at random."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from collision_scenes import scene

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.cell.solids import Body, packed
from planner.collision.point_tree import point_tree, solid_distance
from planner.collision.print_body import TIP_SLOPE, PrintBody, TipRoom
from planner.verify.bodies import CellBodies, Distances, pairs
from planner.verify.checks import FAR
from planner.verify.collision import PrintPair, print_pairs, sweep
from planner.verify.executed import ExecutedMotion
from planner.verify.nozzle import beyond_the_tip, nozzle_nearness

FIXTURES = (
    "  bed_mm: [-500, 600, 100]\n"
    "  fixtures:\n    post: {cylinder: {radius_mm: 30, height_mm: 500}, centre_mm: [420, 150, 300]}\n"
    "    block: {box_mm: [120, 80, 60], centre_mm: [450, -200, 420], rpy_deg: [20, 30, 40]}\n"
)


def _wandering(rng: np.random.Generator, low: Array, high: Array, n: int) -> Array:
    """A smooth way (n, joints) through four postures drawn at random."""
    knots = rng.uniform(low, high, (4, len(low)))
    u = np.linspace(0.0, 3.0, n)
    share = 0.5 - 0.5 * np.cos(np.pi * (u % 1.0))
    k = np.minimum(u.astype(int), 2)
    share = np.where(u >= 3.0, 1.0, share)[:, None]
    return np.asarray((1.0 - share) * knots[k] + share * knots[k + 1])


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("seed", range(3))
def test_least_distances_are_those_of_dense_sampling(tmp_path: Path, seed: int) -> None:
    problem, cell = scene(tmp_path, FIXTURES)
    bodies = CellBodies.of(cell)
    hits = pairs(bodies, problem.collision.nozzle, problem.collision.arm)
    rng = np.random.default_rng(seed)
    low, high = np.radians([-60, -10, -40, -90, -90, -90]), np.radians([60, 60, 30, 90, 90, 90])
    q = _wandering(rng, low, high, 400)
    body = PrintBody(point_tree(np.array([[9.0, 9.0, 9.0]])), np.array([0, 1]), ("part",))
    found = sweep(bodies, hits, q, body, np.zeros(len(q)))
    dense = np.repeat(q[:-1], 2, axis=0)
    dense[1::2] = 0.5 * (q[:-1] + q[1:])
    distance = Distances(bodies)
    poses = bodies.poses(dense)
    near = 0
    for k, pair in enumerate(hits):
        if {bodies.things[pair.a].kind, bodies.things[pair.b].kind} != {"fixture", "arm"} and pair.need > 0.002:
            continue  # a share of the pairs is enough
        least = min(distance.of(pair, T) for T in poses[:: 1 + seed])
        if least >= FAR:
            assert found.distance[k] >= FAR - 1e-3
            continue
        near += 1
        spare = max(1e-4, 0.2 * abs(found.distance[k] - pair.need))
        assert found.distance[k] <= least + spare
        assert (least < pair.need - 1e-4) <= (found.distance[k] < pair.need)
    assert near > 3


def _from_points(cell: Cell, bodies: CellBodies, pair: PrintPair, q: Array, points: Array, there: Array) -> Array:
    """Distances (n) of a pair's body from those of points (m, 3) of the part that are there (n, m), at postures q (n, nq)."""
    thing, body = bodies.things[pair.a], packed([Body("", pair.solid, np.eye(4))])
    T_world_solid = bodies.poses(q)[:, thing.carrier] @ thing.T_carrier_solid
    T = np.linalg.inv(T_world_solid) @ cell.holder.poses(q[:, len(cell.arm) :])
    out = np.full(len(q), np.inf)
    for k, own in enumerate(there):
        local = points[own] @ T[k, :3, :3].T + T[k, :3, 3]
        out[k] = min((solid_distance(body.kind[0], body.size[0], body.planes, *p) for p in local), default=np.inf)
    return out


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("seed", range(3))
def test_a_print_on_a_table_that_turns_is_as_near_as_at_every_sample(tmp_path: Path, seed: int) -> None:
    """Of links, a fixture and the table's own cradle; the print grows meanwhile."""
    table = "  positioner: {robot: irbp_a250, origin_mm: [500, 0, 250], free: [tilt, rotation]}\n"
    _, cell = scene(tmp_path, table + FIXTURES.split("\n", 1)[1])
    bodies, rng, need, n = CellBodies.of(cell), np.random.default_rng(seed), 5e-3, 250
    points = rng.uniform([-0.25, -0.25, 0.0], [0.25, 0.25, 0.2], (40, 3))
    time = np.append(np.full(10, -np.inf), np.sort(rng.uniform(0.0, 2.0, 30)))
    body = PrintBody(point_tree(points, 0.0, time), np.array([0, 40]), ("part",))
    low, high = np.radians([-60, -10, -40, -90, -90, -90, -20, -300]), np.radians([60, 60, 30, 90, 90, 90, 20, 300])
    q, now = _wandering(rng, low, high, n), np.linspace(0.0, 2.5, n)
    near = print_pairs(bodies, need, body)
    assert {bodies.things[pair.a].kind for pair in near} == {"arm", "fixture", "holder"}
    found, some = sweep(bodies, near, q, body, now), 0
    for k, pair in enumerate(near):
        least = _from_points(cell, bodies, pair, q, points, time < now[:, None]).min()
        if least >= FAR:
            assert found.distance[k] >= FAR - 1e-3 or found.distance[k] < least
            continue
        some += 1
        assert found.distance[k] <= least + max(1e-4, 0.2 * abs(found.distance[k] - need))
        assert found.distance[k] < need or least >= need - 1e-4
        at = found.at[k]
        posture = np.array([np.interp(at, np.arange(n), column) for column in q.T])
        there = time < now[int(np.ceil(at))]
        assert _from_points(cell, bodies, pair, posture[None], points, there[None])[0] == pytest.approx(
            found.distance[k]
        )
    assert some > 3


@pytest.mark.slow
@pytest.mark.parametrize(("lift", "graze"), [(0.0, np.inf), (0.0, 2e-4), (2e-3, 0.0), (8e-3, 2e-4)])
def test_the_nozzle_from_print_is_as_near_as_by_brute_force(tmp_path: Path, lift: float, graze: float) -> None:
    """Every sample, every body, every point that is there; where it touches, and where it has much to spare."""
    _, cell = scene(tmp_path, FIXTURES)
    rng = np.random.default_rng(5)
    points = rng.uniform([-0.05, -0.05, -0.03], [0.05, 0.05, -0.001], (300, 3))
    time = np.sort(rng.uniform(0.0, 2.0, 300))
    time[:100] = -np.inf
    n = 300
    u = np.linspace(0.0, 1.0, n)
    tip = np.column_stack([0.04 * np.cos(7 * u), 0.04 * np.sin(5 * u), lift + 0.004 * np.cos(3 * u)])
    lean = 0.3 * np.sin(4 * u)
    rotation = np.zeros((n, 3, 3))
    rotation[:, 0] = np.column_stack([np.cos(lean), np.zeros(n), -np.sin(lean)])
    rotation[:, 1, 1] = -1.0
    rotation[:, 2] = np.column_stack([-np.sin(lean), np.zeros(n), -np.cos(lean)])
    assert np.linalg.det(rotation) == pytest.approx(np.ones(n))
    still = np.zeros(n)
    motion = ExecutedMotion(tip, rotation[:, :, 2], rotation, np.zeros((n, 3)), still, still, still.astype(np.int8))
    now, slack, clearance = 2.5 * np.floor(4 * u), np.full(n, 4e-4), 2e-3
    tree = point_tree(points, 2e-4, time)
    head = packed(cell.head)
    room = TipRoom(slack, np.full(n, graze))
    found = nozzle_nearness(tree, head, motion, now, room, clearance)
    far = beyond_the_tip(tree, head, motion, now, room, clearance)
    least, spare = np.inf, np.full(n, FAR)
    for k in range(n):
        there = time < now[k]
        local, still = (points[there] - tip[k]) @ rotation[k], np.isinf(time[there])
        away = np.linalg.norm(local, axis=1)
        need = np.minimum(clearance, TIP_SLOPE * away - slack[k])
        beyond = away >= (clearance + slack[k]) / TIP_SLOPE
        for j in range(len(head.kind)):
            T = head.T_solid_frame[j]
            own = local @ T[:3, :3].T + T[:3, 3]
            d = np.array([solid_distance(head.kind[j], head.size[j], head.planes, *p) for p in own]) - 2e-4
            if len(d):
                least = min(least, float((d - need).min()), float((d[still] + 2e-4 + graze).min(initial=np.inf)))
            spare[k] = min(spare[k], (d[beyond] - clearance).min(initial=FAR))
    assert least < FAR
    assert least - 2e-4 <= found.least <= least + 1.1e-4  # between samples it may be nearer still
    assert spare.min() < FAR
    told = max(1.1e-4, 0.1 * (spare.min() + clearance))
    assert spare.min() - 2e-4 <= far.least <= spare.min() + told
    assert far.margin[far.at] >= far.least - 1e-9
    assert np.all(far.margin >= spare.min() - 2e-4)
    assert np.median(np.abs(far.margin - spare)) < 1e-3  # what is between looks is interpolated
