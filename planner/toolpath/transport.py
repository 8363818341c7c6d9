"""Directions in the tangent plane from which roll is counted: smooth along a bead, without spin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from planner.readonly import Array

_CLEAR = 0.3  # least sine of the angle between normals and an axis that is projected onto the tangent plane


def roll_zeros(normals: Sequence[Array]) -> list[Array]:
    """Unit tangents (n, 3) for each bead's unit normals (n, 3).

    Where one axis of the part frame keeps clear of all normals, it is its projection, the same on all beads. Else
    the nearest to that at each bead's start, carried along without turning about the normal (parallel transport).
    """
    sines = [np.sqrt(np.maximum(1.0 - n**2, 0.0)).min(axis=0) for n in normals]
    least = np.min(sines, axis=0)
    if least.max() >= _CLEAR:
        axis = np.eye(3)[int(np.argmax(least))]
        return [_projected(axis, n) for n in normals]
    starts = (np.eye(3)[int(np.argmin(np.abs(n[0])))] for n in normals)
    return [
        _transport(np.ascontiguousarray(n), _projected(axis, n[:1])[0]) for axis, n in zip(starts, normals, strict=True)
    ]


def _projected(axis: Array, normals: Array) -> Array:
    tangent = axis - (normals @ axis)[:, None] * normals
    return np.asarray(tangent / np.linalg.norm(tangent, axis=1)[:, None])


@njit(cache=True)
def _transport(normals: Array, start: Array) -> Array:
    """Carry a tangent from sample to sample by the smallest rotation that takes one normal to the next."""
    out = np.empty_like(normals)
    out[0] = start
    for i in range(1, len(normals)):
        a, b, r = normals[i - 1], normals[i], out[i - 1]
        cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        share = (r[0] * b[0] + r[1] * b[1] + r[2] * b[2]) / max(1.0 + cosine, 1e-9)
        for k in range(3):
            out[i, k] = r[k] - share * (a[k] + b[k])
        # rounding, and nothing else, makes it leave the plane
        lean = out[i, 0] * b[0] + out[i, 1] * b[1] + out[i, 2] * b[2]
        size = 0.0
        for k in range(3):
            out[i, k] -= lean * b[k]
            size += out[i, k] ** 2
        for k in range(3):
            out[i, k] /= np.sqrt(size)
    return out
