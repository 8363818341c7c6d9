"""A scanned part once more: at each place, a curved sheet of its own through the nearest points of the file.

No surface is fitted to all of the scan. A sheet, a polynomial of x and y through some dozen points, says how high the part
is there and how it leans. Large and stiff sheets average noise, others follow shape: how surely one says so is told by its
scatter, and by what less sure ones say against it beyond what they may be off themselves (Goldenshluger and Lepski); the
surest one counts. Lengths are metres in the part frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.files import stamp_of
from planner.base.geometry import angles_between
from planner.problem.clouds import read_scan
from planner.problem.part import ScanSpec

# Points of a sheet and its degree, the least sure first: as a rule a cubic one needs two and a half times the points.
_SHEETS = ((24, 2), (60, 3), (36, 2), (90, 3), (54, 2), (150, 3), (80, 2), (120, 2), (150, 2))
_MOST = 150  # points of a sheet
SURE = 4.0  # standard errors by which the sheet may be wrong
_OWN = 0.5  # of what a less sure sheet may be off, by which a surer one differs without being told against
_HELD = 1e-9  # of a sheet's normal equations: points in a line say nothing of what is beside it,
_FINEST = 1e-7  # m of scatter at least, so that such sheets are unsure even without noise


@dataclass(frozen=True)
class ScanSheets:
    """Sheets at places: heights (n) [m], upward unit normals (n, 3), and how far either may be off: (n) [m], (n) [rad]."""

    z: Array
    normals: Array
    unsure: Array
    turn: Array


def sheets_at(spec: ScanSpec, plane: Array) -> ScanSheets:
    """The sheets of a scan at x, y (n, 2). Raises InputError for a file that cannot be read any more."""
    points, tree = _points(spec, *stamp_of(spec.file))
    away, near = tree.query(plane, k=_MOST)
    found = [_through(points[near[:, :count]], plane, away[:, count - 1], degree) for count, degree in _SHEETS]
    surest = found[0]
    for k, sheet in enumerate(found[1:], start=1):
        unsure, turn = sheet.unsure, sheet.turn
        for less in found[:k]:
            against = np.abs(less.z - sheet.z) - _OWN * less.unsure
            unsure = np.maximum(unsure, sheet.unsure + against)
            turn = np.maximum(turn, sheet.turn + angles_between(less.normals, sheet.normals) - _OWN * less.turn)
        higher, leaning = unsure < surest.unsure, turn < surest.turn
        surest = ScanSheets(
            np.where(higher, sheet.z, surest.z),
            np.where(leaning[:, None], sheet.normals, surest.normals),
            np.minimum(unsure, surest.unsure),
            np.minimum(turn, surest.turn),
        )
    return surest


def _through(near: Array, plane: Array, radius: Array, degree: int) -> ScanSheets:
    """The sheets of a degree through points (n, k, 3) within a radius (n) of x, y (n, 2), as sure as their scatter says."""
    count = near.shape[1]
    radius = np.maximum(radius, 1e-9)[:, None]
    u, v = ((near[:, :, k] - plane[:, k : k + 1]) / radius for k in (0, 1))
    A = np.stack([u ** (total - k) * v**k for total in range(degree + 1) for k in range(total + 1)], axis=2)
    z = near[:, :, 2]
    middle = z.mean(axis=1)
    inverse = np.linalg.inv(np.swapaxes(A, 1, 2) @ A + _HELD * np.eye(A.shape[2]))
    found = np.einsum("nij,nkj,nk->ni", inverse, A, z - middle[:, None])
    left = z - middle[:, None] - np.einsum("nkj,nj->nk", A, found)
    scatter = np.maximum(np.sqrt((left**2).sum(axis=1) / (count - A.shape[2])), _FINEST)
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
