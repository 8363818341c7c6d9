"""Angles of orientations, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.export import euler

RANDOM = Rotation.random(300, rng=np.random.default_rng(3))
WAYS = {
    "ZYX": (euler.fixed_xyz, euler.from_fixed_xyz, slice(None, None, -1)),
    "XYZ": (euler.turning_xyz, euler.from_turning_xyz, slice(None)),
    "ZYZ": (euler.turning_zyz, euler.from_turning_zyz, slice(None)),
}
EDGES = [0.0, 30.0, 90.0, -90.0, 180.0]


@pytest.mark.parametrize("order", WAYS)
def test_angles_are_the_named_turns(order: str) -> None:
    to, back, turn = WAYS[order]
    edges = Rotation.from_euler(order, [[a, b, c] for a in EDGES for b in EDGES for c in EDGES], degrees=True)
    for rotations in (RANDOM, edges):
        found = to(rotations.as_matrix())
        assert (Rotation.from_euler(order, found[:, turn]).inv() * rotations).magnitude().max() < 1e-7
        assert (Rotation.from_quat(back(found)).inv() * rotations).magnitude().max() < 1e-7
