"""Bounds of margins by height, and searches along the nozzle's way that use them, against all points at all samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from collision_scenes import scene

from planner.base.arrays import Array
from planner.cell.solids import CAPSULE, FRUSTUM, Packed, packed
from planner.collision.point_tree import TipRule, point_tree
from planner.collision.print_body import TIP_SLOPE, TipRoom
from planner.verify.by_height import height_bounds, least_so_high
from planner.verify.checks import FAR
from planner.verify.executed import ExecutedMotion
from planner.verify.nozzle import HeadSolids, beyond_the_tip, nozzle_nearness

SLACK, CLEARANCE, RADIUS = 5e-4, 2e-3, 2e-4  # m


def _distance(head: Packed, j: int, points: Array) -> Array:
    """Signed distances (n) of points (n, 3) in the nozzle's frame from a body: frustums and capsules by their outlines."""
    T, size = head.T_solid_frame[j], head.size[j]
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    r = np.hypot(x, y)
    if head.kind[j] == CAPSULE:
        return np.asarray(np.hypot(r, np.maximum(np.abs(z) - size[1], 0.0)) - size[0])
    assert head.kind[j] == FRUSTUM
    corners = np.array([[0.0, 0.0], [size[0], 0.0], [size[1], size[2]], [0.0, size[2]]])
    away, inside = np.full(len(r), np.inf), (z > 0.0) & (z < size[2])
    inside &= r < size[0] + (size[1] - size[0]) * z / size[2]
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        way = b - a
        share = np.clip(((r - a[0]) * way[0] + (z - a[1]) * way[1]) / max(way @ way, 1e-30), 0.0, 1.0)
        away = np.minimum(away, np.hypot(r - a[0] - share * way[0], z - a[1] - share * way[1]))
    return np.where(inside, -away, away)


def _head(tmp_path: Path) -> Packed:
    _, cell = scene(tmp_path, "  bed_mm: [-500, 600, 100]\n")
    return packed(cell.head)


@pytest.mark.parametrize("slope", [TIP_SLOPE, 1e3])
def test_no_point_has_less_to_spare_than_its_height_says(tmp_path: Path, slope: float) -> None:
    """Of all bodies, at heights from far beneath the tip to above it; near bounds of a round body are close, too."""
    head, rng = _head(tmp_path), np.random.default_rng(3)
    solids = HeadSolids(head.kind, head.size, head.planes, head.T_solid_frame, head.centre, head.reach)
    zone = (CLEARANCE + SLACK) / TIP_SLOPE
    slack = SLACK if slope == TIP_SLOPE else slope * zone
    rule = TipRule(CLEARANCE, slope, slack, np.inf)
    nearest, fine = (2e-5, 0.02) if slope == TIP_SLOPE else (0.98 * zone, 0.006)
    tree = point_tree(np.zeros((1, 3)), 0.0, 0.0)
    bounds = height_bounds(tree.arrays, solids, rule, 20e-3, nearest, fine)
    span = np.geomspace(1e-5, 0.1, 40_000)
    ways = rng.normal(size=(len(span), 3))
    points = span[:, None] * ways / np.linalg.norm(ways, axis=1)[:, None]
    points[: len(span) // 2, 2] = np.abs(points[: len(span) // 2, 2]) * 0.05  # z goes down
    need = np.minimum(CLEARANCE, slope * np.linalg.norm(points, axis=1) - slack)
    close = np.inf
    for j in range(len(head.kind)):
        value = _distance(head, j, points) - need
        low = np.array([least_so_high(bounds, j, -z, 0.0, False, 0.0) for z in points[:, 2]])
        assert np.all(low <= value + 1e-12)
        level = np.abs(points[:, 2]) < 1e-4
        close = min(close, float((value - low)[level & np.isfinite(low)].min()))
    assert close < (1e-4 if slope == TIP_SLOPE else 5e-4)


def _way(n: int, bow: float, radius: float) -> tuple[Array, Array]:
    """Tips (n, 3) along rows on a bowl turned over, and rotations (n, 3, 3) with z along the normal, down."""
    u = np.linspace(0.0, 6.0, n)
    x = radius * np.where(u.astype(int) % 2 == 0, u % 1.0 - 0.5, 0.5 - u % 1.0)
    y = radius * (u / 6.0 - 0.5) * 0.4
    tip = np.column_stack([x, y, -(x**2 + y**2) / (2.0 * bow)])
    z = -np.column_stack([x / bow, y / bow, np.ones(n)])
    z /= np.linalg.norm(z, axis=1)[:, None]
    across = np.cross(z, np.tile([1.0, 0.0, 0.0], (n, 1)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    return tip, np.stack([np.cross(across, z), across, z], axis=-1)


@pytest.mark.parametrize(("bow", "bumps"), [(0.3, 0.0), (0.06, 0.0), (0.3, 1.5e-3), (-0.08, 0.0)])
def test_a_long_way_over_a_print_is_as_near_as_by_brute_force(tmp_path: Path, bow: float, bumps: float) -> None:
    """Where all lies beneath the tip, where it is strongly curved, where some stands above it, and in a hollow."""
    head, rng, n = _head(tmp_path), np.random.default_rng(1), 2400
    tip, rotation = _way(n, bow, 0.05)
    points = np.repeat(tip[::6], 2, axis=0) + rng.uniform(-1e-3, 1e-3, (n // 3, 3)) * [1.0, 1.0, 0.1]
    points[:, 2] -= RADIUS + np.where(np.arange(len(points)) % 2 == 0, 0.0, 5e-4)
    points[::97, 2] += bumps
    time = np.sort(rng.uniform(0.0, 1.0, len(points)))
    time[:40] = -np.inf
    still, none = np.zeros((n, 3)), np.zeros(n)
    motion = ExecutedMotion(tip, rotation[:, :, 2], rotation, still, none, none, none.astype(np.int8))
    now, graze = np.linspace(0.2, 1.0, n), 2e-4
    tree, room = point_tree(points, RADIUS, time), TipRoom(np.full(n, SLACK), np.full(n, graze))
    found = nozzle_nearness(tree, head, motion, now, room, CLEARANCE, look=0.0)
    far = beyond_the_tip(tree, head, motion, now, room, CLEARANCE, look=0.0)
    least, spare = np.inf, np.full(n, FAR)
    for k in range(n):
        there = time < now[k]
        local, first = (points[there] - tip[k]) @ rotation[k], np.isinf(time[there])
        away = np.linalg.norm(local, axis=1)
        need, outside = np.minimum(CLEARANCE, TIP_SLOPE * away - SLACK), away >= (CLEARANCE + SLACK) / TIP_SLOPE
        for j in range(len(head.kind)):
            d = _distance(head, j, local)
            least = min(least, float((d - RADIUS - need).min()), float((d[first] + graze).min()))
            spare[k] = min(spare[k], float((d[outside] - RADIUS - CLEARANCE).min(initial=FAR)))
    assert least - 1e-4 <= found.least <= least + 1.1e-4  # between samples it may be nearer still
    assert spare.min() - 2e-4 <= far.least <= spare.min() + max(1.1e-4, 0.1 * (spare.min() + CLEARANCE))
    assert np.all(far.margin >= spare.min() - 2e-4)
    assert far.margin[far.at] >= far.least - 1e-9
