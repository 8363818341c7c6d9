"""Coarse facets bent into the smooth surface on which their corners lie: curved PN triangles (Vlachos et al. 2001).

Programs that write facets place their corners on the surface; between them a facet cuts through it. Each facet becomes
a cubic patch through its corners, whose normal at a corner is the mean over the facets around it. An edge sharper than
a crease is not part of a smooth surface: means are taken separately on either side of it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.base.arrays import Array, Flags, Ints

CREASE = np.radians(40.0)  # between facets: a nine-sided body still counts as round, a machined part has creases
_DECIMALS = 8  # of a metre: corners of two facets that agree to these are one
_FLATNESS = 2e-6  # m: deviation of the small facets into which a patch is divided
_MOST_SIDES = 24  # of them along a patch's side
MOST_PATCHES = 400_000  # small facets; to stay below, patches are divided less


def corner_normals(corners: Array, crease: float = CREASE) -> tuple[Array, Flags]:
    """Unit normals (n, 3, 3) at the corners of facets (n, 3, 3), and which edges (n, 3) are smooth.

    Edge k runs from corner k to corner k + 1.
    A normal is the mean over the facets around a corner that are joined by smooth edges, weighted by their angles.
    """
    n = len(corners)
    edges = np.roll(corners, -1, axis=1) - corners
    length = np.maximum(np.linalg.norm(edges, axis=2), 1e-30)
    facet = np.cross(edges[:, 0], edges[:, 1])
    facet = facet / np.maximum(np.linalg.norm(facet, axis=1), 1e-300)[:, None]
    cosine = -(edges * np.roll(edges, 1, axis=1)).sum(axis=2) / (length * np.roll(length, 1, axis=1))
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))

    one, other, sides = _neighbours(corners)
    flat = (facet[one] * facet[other]).sum(axis=1) >= np.cos(crease)
    one, other, sides = one[flat], other[flat], sides[flat]
    smooth = np.zeros((n, 3), dtype=bool)
    smooth[one, sides[:, 0]] = smooth[other, sides[:, 1]] = True
    # across a smooth edge the corners at either end belong together: k with k' + 1, and k + 1 with k'
    begin, end = 3 * one + sides[:, 0], 3 * one + (sides[:, 0] + 1) % 3
    begin_there, end_there = 3 * other + sides[:, 1], 3 * other + (sides[:, 1] + 1) % 3
    row, column = np.concatenate([begin, end]), np.concatenate([end_there, begin_there])
    joined = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(3 * n, 3 * n))
    count, fan = connected_components(joined, directed=False)
    weighted = (angle[:, :, None] * facet[:, None, :]).reshape(-1, 3)
    total = np.stack([np.bincount(fan, weighted[:, k], minlength=count) for k in range(3)], axis=1)
    size = np.linalg.norm(total, axis=1)
    normals = np.where(
        size[fan, None] > 1e-9, total[fan] / np.maximum(size[fan, None], 1e-30), np.repeat(facet, 3, axis=0)
    )
    return normals.reshape(n, 3, 3), smooth


def _neighbours(corners: Array) -> tuple[Ints, Ints, Ints]:
    """Pairs of facets that alone share an edge: their numbers (m), (m), and which side of each it is (m, 2)."""
    _, vertex = np.unique(np.round(corners.reshape(-1, 3), _DECIMALS), axis=0, return_inverse=True)
    facets = vertex.reshape(-1, 3).astype(np.int64)
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=-1).reshape(-1, 2)
    key = ends.min(axis=1) * (facets.max() + 1) + ends.max(axis=1)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    pairs = first[np.diff(first, append=len(key)) == 2]
    a, b = order[pairs], order[pairs + 1]
    against = ends[a, 0] == ends[b, 1]  # otherwise one of the two faces the other way
    a, b = a[against], b[against]
    return a // 3, b // 3, np.column_stack([a % 3, b % 3])


def bulges(corners: Array, normals: Array) -> Array:
    """Approximate distance between the middle of each facet's sides (n, 3) and the curve over it [m]."""
    edges = np.roll(corners, -1, axis=1) - corners
    turn = np.roll(normals, -1, axis=1) - normals
    return np.asarray(np.abs((edges * turn).sum(axis=2)) / 8.0)


def bent(corners: Array, normals: Array) -> Array:
    """Small facets (m, 3, 3) of the patches over facets (n, 3, 3) with unit normals (n, 3, 3) at their corners."""
    bulge = bulges(corners, normals).max(axis=1, initial=0.0)
    sides = np.clip(np.ceil(np.sqrt(bulge / _FLATNESS)), 1, _MOST_SIDES).astype(int)
    while int((sides**2).sum()) > MOST_PATCHES and sides.max() > 1:
        sides = np.maximum(sides // 2, 1)
    parts = [_divided(corners[sides == k], normals[sides == k], int(k)) for k in np.unique(sides)]
    return np.concatenate(parts)


def _divided(corners: Array, normals: Array, k: int) -> Array:
    """The patches over facets (n, 3, 3), each as k * k small facets (n k k, 3, 3)."""
    if k == 1:
        return corners
    control = _control_points(corners, normals)
    number: dict[tuple[int, int], int] = {}
    shares: list[tuple[float, float]] = []
    for i in range(k + 1):
        for j in range(k + 1 - i):
            number[i, j] = len(shares)
            shares.append((i / k, j / k))
    u, v = np.array(shares).T
    w = 1.0 - u - v
    # in the order of _control_points: the corners, then two along each side, then the middle
    weights = np.column_stack([
        w**3, u**3, v**3, 3 * w * w * u, 3 * w * u * u, 3 * u * u * v, 3 * u * v * v, 3 * v * v * w, 3 * v * w * w, 6 * u * v * w
    ])  # fmt: skip
    points = np.einsum("pc,ncx->npx", weights, control)
    small = []
    for i in range(k):
        for j in range(k - i):
            small.append((number[i, j], number[i + 1, j], number[i, j + 1]))
            if i + j < k - 1:
                small.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    return np.asarray(points[:, np.array(small)].reshape(-1, 3, 3))


def _control_points(corners: Array, normals: Array) -> Array:
    """The ten control points (n, 10, 3) of each patch: corners, two along each side, the middle."""
    tangents = []
    for i in range(3):
        for a, b in ((i, (i + 1) % 3), ((i + 1) % 3, i)):
            lift = ((corners[:, b] - corners[:, a]) * normals[:, a]).sum(axis=1)[:, None] * normals[:, a]
            tangents.append((2.0 * corners[:, a] + corners[:, b] - lift) / 3.0)
    rim = np.stack(tangents, axis=1)
    inner, middle = rim.mean(axis=1), corners.mean(axis=1)
    return np.concatenate([corners, rim, (1.5 * inner - 0.5 * middle)[:, None]], axis=1)
