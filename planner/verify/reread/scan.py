"""A scanned part read again: at each place, a separate curved sheet through the nearest points of the file.

No surface is fitted to all of the scan. A sheet, a polynomial in x and y through some dozens of points, gives the
part's height and slope there. Large and stiff sheets average out noise, others follow the shape: a sheet's uncertainty
comes from its scatter, and from how far less certain ones contradict it beyond their own uncertainty (Goldenshluger and
Lepski); the most certain one counts. Lengths are in metres in the part frame.
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

# Points of a sheet and its degree, the least certain first; a cubic typically needs two and a half times the points.
_SHEETS = ((24, 2), (60, 3), (36, 2), (90, 3), (54, 2), (150, 3), (80, 2), (120, 2), (150, 2))
_MOST = 150  # most points of a sheet
SURE = 4.0  # standard errors that count as a sheet's uncertainty
_OWN = 0.5  # × a less certain sheet's uncertainty: a smaller difference from it does not count as a contradiction
_HELD = 1e-9  # added to the diagonal of a sheet's normal equations: collinear points do not determine the slope across,
_FINEST = 1e-7  # m: least scatter, so that such sheets are uncertain even without noise


@dataclass(frozen=True)
class ScanSheets:
    """Sheets at places: heights (n) [m], upward unit normals (n, 3), and uncertainties of both (n) [m], (n) [rad]."""

    z: Array
    normals: Array
    unsure: Array
    turn: Array


def sheets_at(spec: ScanSpec, plane: Array) -> ScanSheets:
    """The sheets of a scan at x, y (n, 2). Raises InputError for a file that can no longer be read."""
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
    """The sheets of a degree through points (n, k, 3) within a radius (n) of x, y (n, 2), with uncertainties."""
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
    """A scan's points and their tree, seen from above; `changed` and `size` identify the file."""
    points = read_scan(spec, partial(InputError, file=spec.file))
    return points, cKDTree(points[:, :2])
