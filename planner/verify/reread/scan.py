"""A scanned part once more: at each place, a curved sheet of its own through the nearest points of the file.

No surface is fitted to all of the scan. A sheet z = a + bx + cy + dx² + exy + fy² through a few dozen points says how high
the part is there and how it leans, and by their scatter how surely. Lengths are metres in the part frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem.clouds import read_scan
from planner.problem.part import ScanSpec

_POINTS = 150  # of a sheet
SURE = 4.0  # standard errors by which the sheet may be wrong


@dataclass(frozen=True)
class ScanSheets:
    """Sheets at places: heights (n) [m], upward unit normals (n, 3), and how far either may be off: (n) [m], (n) [rad]."""

    z: Array
    normals: Array
    unsure: Array
    turn: Array


def sheets_at(spec: ScanSpec, plane: Array) -> ScanSheets:
    """The sheets of a scan at x, y (n, 2). Raises InputError and OSError for a file that cannot be read any more."""
    stamp = spec.file.stat()
    points, tree = _points(spec, stamp.st_mtime_ns, stamp.st_size)
    count = min(_POINTS, len(points))
    away, near = tree.query(plane, k=count)
    radius = np.maximum(away[:, -1:], 1e-9)
    x, y = (points[near][:, :, k] - plane[:, k : k + 1] for k in (0, 1))
    u, v = x / radius, y / radius
    A = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    z = points[near][:, :, 2]
    middle = z.mean(axis=1)
    inverse = np.linalg.inv(np.swapaxes(A, 1, 2) @ A)
    found = np.einsum("nij,nkj,nk->ni", inverse, A, z - middle[:, None])
    left = z - middle[:, None] - np.einsum("nkj,nj->nk", A, found)
    scatter = np.sqrt((left**2).sum(axis=1) / max(count - 6, 1))
    error = SURE * scatter[:, None] * np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))
    slope = found[:, 1:3] / radius
    normals = np.column_stack([-slope, np.ones(len(plane))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    turn = np.hypot(*(error[:, 1:3] / radius).T) * normals[:, 2] ** 2
    return ScanSheets(found[:, 0] + middle, normals, error[:, 0] * normals[:, 2], turn)


@lru_cache(maxsize=2)
def _points(spec: ScanSpec, changed: int, size: int) -> tuple[Array, cKDTree]:
    """A scan's points and their tree, seen from above; `changed` and `size` tell one file from another."""
    points = read_scan(spec, partial(InputError, file=spec.file))
    return points, cKDTree(points[:, :2])
