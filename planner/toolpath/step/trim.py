"""Inside or outside of the loops that trim faces, and what is known along their rims."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.readonly import Array, Ints

Raster = NDArray[np.int8]

ON_THE_RIM = 5e-6  # m: so near a face's rim a place counts as on it; its edges are known to 2 um
CELLS = 64  # of a raster of each face, along both sides, which tells most places inside from those outside
_MIXED = 2
_SAME = 1.0 - 1e-6  # cosine between normals that count as one


def shared(loops: Sequence[Ints], points: Array, following: Ints) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the edges of loops, by their numbers, stand in another loop too, or twice in one, or are a pole (m); and
    whether they are a pole (m), which has no length."""
    edge = np.concatenate(loops)
    offsets = np.concatenate([[0], np.cumsum([len(on) for on in loops])[:-1]])
    begins = np.concatenate(
        [
            offset + (np.flatnonzero(on != np.roll(on, 1)) if (on != on[0]).any() else np.array([0]))
            for offset, on in zip(offsets, loops, strict=True)
        ]
    )
    numbers, runs = np.unique(edge[begins], return_counts=True)
    lengths = np.zeros(int(edge.max()) + 1)
    np.add.at(lengths, edge, np.linalg.norm(points[following] - points, axis=1))
    pole = lengths[edge] < ON_THE_RIM
    joined = np.isin(edge, numbers[runs > 1]) | pole
    if pole.any():  # the edges that end there stand there too
        pole = cKDTree(points[pole]).query(points)[0] <= ON_THE_RIM
    return joined, pole


def normals_met(points: Array, normals: Array) -> Array:
    """For points (m, 3) of rims the sum (m, 3) of the normals at the same place, each direction once.

    Each once, for of two nearly opposite ones the sum points out of the material only if they weigh the same.
    """
    pairs = cKDTree(points).query_pairs(2.0 * ON_THE_RIM, output_type="ndarray")
    pairs = pairs[(normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1) < _SAME]
    met: dict[int, list[Array]] = {}
    for i, j in np.vstack([pairs, pairs[:, ::-1]]):
        known = met.setdefault(int(i), [normals[i]])
        if all(other @ normals[j] < _SAME for other in known):
            known.append(normals[j])
    total = normals.copy()
    for i, known in met.items():
        total[i] = np.sum(known, axis=0)
    return total


def raster_of(uv: Array, following: Ints, first: int, last: int, low: Array, high: Array) -> Raster:
    """Cells (64, 64) of a face's box: 0 outside, 1 inside, 2 where its rim runs."""
    step = (high - low) / CELLS
    a, b = (uv[first:last] - low) / step, (uv[following[first:last]] - low) / step
    cells = np.zeros((CELLS, CELLS), dtype=np.int8)
    pieces = np.maximum(np.ceil(4.0 * np.abs(b - a).max(axis=1)).astype(int), 1)
    index = np.repeat(np.arange(len(a)), pieces + 1)
    t = (np.arange(len(index)) - np.repeat(np.cumsum(pieces + 1) - pieces - 1, pieces + 1)) / pieces[index]
    run = a[index] + t[:, None] * (b - a)[index]
    near = np.floor(run[:, None, :] + np.array([[x, y] for x in (-0.3, 0.3) for y in (-0.3, 0.3)])).astype(int)
    near = np.clip(near.reshape(-1, 2), 0, CELLS - 1)
    cells[near[:, 0], near[:, 1]] = _MIXED
    clear = np.argwhere(cells != _MIXED)
    middles = low + (clear + 0.5) * step
    cells[clear[:, 0], clear[:, 1]] = _within(middles, uv, following, first, last)
    return cells


@njit(cache=True)
def _crossings(u: float, v: float, uv: Array, following: Ints, first: int, last: int) -> bool:
    """Even-odd rule."""
    odd = False
    for i in range(first, last):
        j = following[i]
        if (uv[i, 1] > v) != (uv[j, 1] > v):
            at = uv[i, 0] + (v - uv[i, 1]) / (uv[j, 1] - uv[i, 1]) * (uv[j, 0] - uv[i, 0])
            if u < at:
                odd = not odd
    return odd


@njit(cache=True)
def _within(places: Array, uv: Array, following: Ints, first: int, last: int) -> Raster:
    out = np.zeros(len(places), dtype=np.int8)
    for i in range(len(places)):
        if _crossings(places[i, 0], places[i, 1], uv, following, first, last):
            out[i] = 1
    return out


@njit(cache=True)
def is_inside(
    face: int,
    u: float,
    v: float,
    raster: Raster,
    low: Array,
    high: Array,
    rim_uv: Array,
    rim_next: Ints,
    rim_first: Ints,
) -> bool:
    """Whether a place lies within the loops of a face; its raster answers, or the even-odd rule."""
    if u < low[face, 0] or u > high[face, 0] or v < low[face, 1] or v > high[face, 1]:
        return False
    i = min(int((u - low[face, 0]) / (high[face, 0] - low[face, 0]) * CELLS), CELLS - 1)
    j = min(int((v - low[face, 1]) / (high[face, 1] - low[face, 1]) * CELLS), CELLS - 1)
    if raster[face, i, j] != _MIXED:
        return raster[face, i, j] == 1
    return _crossings(u, v, rim_uv, rim_next, rim_first[face], rim_first[face + 1])


@njit(cache=True)
def all_inside(
    face: Ints,
    uv: Array,
    raster: Raster,
    low: Array,
    high: Array,
    rim_uv: Array,
    rim_next: Ints,
    rim_first: Ints,
) -> NDArray[np.bool_]:
    """The same for parameters (n, 2) of faces (n)."""
    out = np.zeros(len(uv), dtype=np.bool_)
    for i in range(len(uv)):
        out[i] = is_inside(face[i], uv[i, 0], uv[i, 1], raster, low, high, rim_uv, rim_next, rim_first)
    return out
