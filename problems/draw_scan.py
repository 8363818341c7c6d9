"""Writes the scan of a mould that is not where its problem has it, as a laser scanner would: aerofoil_core_tapered_scan.ply.

The top and the sides of aerofoil_core_tapered.stl, moved and turned as MOVED and TURNED say, and the bed around it, in the
world frame [mm]: with noise along the surface, points that are far off, and a hole where something stood in the way.

Run it from anywhere: python problems/draw_scan.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
MOULD, TARGET = FOLDER / "aerofoil_core_tapered.stl", FOLDER / "aerofoil_core_tapered_scan.ply"

BED = np.array([560.0, -93.0, 290.0])  # of the problem: where the part should be
MOVED, TURNED = np.array([3.0, -2.0, 0.4]), np.radians([0.2, -0.3, 1.5])  # in and about the part frame

POINTS, AROUND = 5_000, 1_000  # on the part, and on the bed around it
NOISE = 0.05  # standard deviation
STRAY, FARTHEST = 0.02, 20.0  # share of points that are far off, and how far
HOLE, RADIUS = np.array([30.0, 20.0]), 8.0  # x, y of the part frame


def facets() -> Array:
    """Corners (n, 3, 3) of the mould."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.asarray(np.frombuffer(MOULD.read_bytes()[84:], record)["corners"], dtype=np.float64)


def turned(angles: Array) -> Array:
    """The rotation by a vector (3) [rad], by Rodrigues' formula."""
    angle = float(np.linalg.norm(angles))
    x, y, z = angles / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def scan(random: np.random.Generator) -> Array:
    """Points (n, 3) in the world."""
    corners = facets()
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    seen = across[:, 2] > -0.5 * area  # what looks down is hidden
    corners, across, area = corners[seen], across[seen], area[seen]
    k = random.choice(len(corners), POINTS, p=area / area.sum())
    u, v = np.sort(random.uniform(size=(2, POINTS)), axis=0)
    share = np.column_stack([u, v - u, 1.0 - v])
    points = np.einsum("ni,nij->nj", share, corners[k])
    points += random.normal(0.0, NOISE, POINTS)[:, None] * (across[k] / area[k, None])
    points = points[np.hypot(*(points[:, :2] - HOLE).T) > RADIUS]
    stray = random.uniform(size=len(points)) < STRAY
    points[stray] += random.uniform(-FARTHEST, FARTHEST, (int(stray.sum()), 3))
    there = points @ turned(TURNED).T + MOVED + BED
    half = np.ptp(points[:, :2], axis=0) / 2.0 + 20.0
    around = random.uniform(-half, half, (AROUND, 2))
    around = around[(np.abs(around) > half - 20.0).any(axis=1)]
    bed = np.column_stack([around + BED[:2], BED[2] + random.normal(0.0, NOISE, len(around))])
    return np.vstack([there, bed])


def ply(points: Array) -> bytes:
    """The points as a binary PLY file."""
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{axes}end_header\n"
    return head.encode() + points.astype("<f4").tobytes()


if __name__ == "__main__":
    TARGET.write_bytes(ply(scan(np.random.default_rng(0))))
