"""A wall in one spiral: what its upper turns lie on is the turn below, and no part that was there before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.collision.print_body import PART, print_body
from planner.planning.pipeline import load, solve
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from tests.test_reread import OBSTACLES, failed, found

TEXT = """name: spiral
cell:
  arm: irb2600
  nozzle: {tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}
  home_deg: [0, 0, 0, 0, 60, 0]
  positioner: {robot: irbp_a250, origin_mm: [1100, 0, 600], free: [rotation]}
layers: {source: {waypoints: path.txt}}
process: {speed_mm_s: 20, travel_speed_mm_s: 200, bead: {width_mm: 0.8, height_mm: 0.5}}
"""
RADIUS, TURNS, EVERY = 8.0, 3.0, 10.0  # mm, turns, and degrees between waypoints


def spiral(folder: Path, lean: float = 0.0) -> Any:
    """A problem: turns half a millimetre above each other, each by `lean` mm farther out."""
    t = np.radians(np.arange(0.0, 360.0 * TURNS + 1.0, EVERY))
    rise = 0.5 * t / (2.0 * np.pi)
    r = RADIUS + lean * rise / 0.5
    rows = np.column_stack([r * np.cos(t), r * np.sin(t), 0.5 + rise, 0 * t, 0 * t, 1 + 0 * t])
    np.savetxt(folder / "path.txt", rows, fmt="%.5f")
    (folder / "spiral.yaml").write_text(TEXT)
    return load(folder / "spiral.yaml")


def part_of(toolpath: Toolpath) -> np.ndarray:
    """Points (n, 3) [m] of the part that are kept clear of."""
    body = print_body(toolpath)
    return np.array([p for i, p in enumerate(body.tree.points) if body.name_of(i) == PART])


@pytest.mark.parametrize("lean", [0.0, 0.2])
def test_only_the_first_turn_lies_on_the_part(tmp_path: Path, lean: float) -> None:
    part = part_of(build_toolpath(spiral(tmp_path, lean)))
    turn = np.unwrap(np.arctan2(part[:, 1], part[:, 0]))
    assert part[:, 2].max() < 0.55e-3
    assert np.ptp(turn) > 1.9 * np.pi  # all the way round


def test_turns_beside_each_other_lie_on_the_part(tmp_path: Path) -> None:
    """More than half a width aside."""
    part = part_of(build_toolpath(spiral(tmp_path, 1.0)))
    assert part[:, 2].max() > 1.4e-3


def test_a_line_that_climbs_does_not_lie_on_itself(tmp_path: Path) -> None:
    x = np.arange(0.0, 20.0, 0.4)
    rows = np.column_stack([x, 0 * x, 0.5 + 0.6 * x, 0 * x, 0 * x, 1 + 0 * x])
    problem = spiral(tmp_path)
    np.savetxt(tmp_path / "path.txt", rows, fmt="%.5f")
    part = part_of(build_toolpath(problem))
    assert np.diff(np.sort(part[:, 0])).max() < 1e-3
    assert part[:, 0].max() > 19e-3


def test_what_turns_lie_on_is_checked(tmp_path: Path) -> None:
    """Without the part beneath the first turn, or without the turns themselves, something lies on nothing."""
    problem = spiral(tmp_path)
    toolpath = build_toolpath(problem)
    body = print_body(toolpath)
    assert OBSTACLES not in failed(found(problem, toolpath, body=body))
    is_part = np.array([body.name_of(i) == PART for i in range(len(body.tree.points))])
    low = [0.0, 0.0, 3e-3]
    sunk = replace(body.tree, points=body.tree.points - np.where(is_part[:, None], low, 0.0))
    late = replace(body.tree, time=np.where(is_part, body.tree.time, 0.999))
    for spoilt in (sunk, late):
        assert OBSTACLES in failed(found(problem, toolpath, body=replace(body, tree=spoilt)))


@pytest.mark.slow
def test_a_spiral_is_verified(tmp_path: Path) -> None:
    """The nozzle passes below where upper turns will lie."""
    assert solve(spiral(tmp_path), baseline=False).verified
