"""Samples of a face at desired distances along its parameters (Onstein et al., Algorithms 1 and 2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints
from planner.toolpath.coverage.tours import SampledSurface
from planner.toolpath.step.body import ON_THE_RIM, FaceBody

TOLERANCE = 1e-6  # m: the paper's t, by which a distance may miss the desired one
MOST_SAMPLES = 200_000
_TRIES = 60  # of rescaling a step
_LINES = 9  # of constant v: steps along u are measured on the longest, for at a pole they have no length
_LOOKS = 33  # points of each of them
_TOO_CLOSE = 0.5  # of the spacing between samples of different rows: nearer at a seam or a pole one is enough
_OTHER_SHEET = 0.0  # cosine between normals, below which samples are not of one sheet


class TooMany(ValueError):
    """More than MOST_SAMPLES samples of a face."""


def sample_faces(body: FaceBody, spacing: float) -> SampledSurface:
    """Samples of all faces of a body, `spacing` [m] apart along u and v; nowhere nearer than half of that from row to row."""
    faces, uvs, rows = [], [], []
    start = 0
    for k in range(len(body.side)):
        uv, row = _sample(body, k, spacing)
        faces.append(np.full(len(uv), k, dtype=np.int64))
        uvs.append(uv)
        rows.append(row + start)
        start += int(row.max(initial=-1)) + 1
    face, uv, row = np.concatenate(faces), np.vstack(uvs), np.concatenate(rows)
    at = body.at(face, uv)
    keep = _clear_of_seams(at.points, at.normals, row, spacing)
    return SampledSurface(at.points[keep], at.normals[keep], uv[keep], face[keep], row[keep], (spacing, spacing))


def _sample(body: FaceBody, face: int, spacing: float) -> tuple[Array, Ints]:
    """Parameters (n, 2) of the samples inside a face, and the line of constant u (n) that each stands on."""
    low, high = body.low[face], body.high[face]

    def points(uv: Array) -> Array:
        return body.splines.points(np.full(len(uv), face), uv)

    v = _longest_line(points, low, high)
    u = _march(lambda at: points(np.column_stack([at, np.full(len(at), v)])), np.array([low[0]]), high[0], spacing)
    u = u[:, 0]
    lines = _march(lambda at: points(np.column_stack([u[: len(at)], at])), np.full(len(u), low[1]), high[1], spacing)
    steps, count = lines.shape
    uv = np.stack([np.broadcast_to(u, (steps, count)), lines], axis=-1)
    row = np.broadcast_to(np.arange(count), (steps, count))
    there = np.isfinite(lines)
    uv, row = uv[there], row[there]
    inside = _on_face(body, face, uv)
    return uv[inside], row[inside]


def _longest_line(points: Callable[[Array], Array], low: Array, high: Array) -> float:
    """The v of the longest of some lines of constant v."""
    looks, lines = np.linspace(low[0], high[0], _LOOKS), np.linspace(low[1], high[1], _LINES)
    grid = np.stack(np.meshgrid(looks, lines, indexing="ij"), axis=-1).reshape(-1, 2)
    steps = np.diff(points(grid).reshape(_LOOKS, _LINES, 3), axis=0)
    lengths = np.linalg.norm(steps, axis=2).sum(axis=0)
    return float(lines[int(np.argmax(lengths > lengths.max() * (1.0 - 1e-9)))])


def _march(points: Callable[[Array], Array], start: Array, end: float, distance: float) -> Array:
    """Parameters (k, n) of steps of `distance` [m] from start (n) up to `end`; NaN where a line has ended.

    Algorithm 2: the step in the parameter is rescaled by the desired over the present distance until that is right.
    points: the points (n, 3) at parameters (n).
    """
    at = start.copy()
    here = points(at)
    alpha = np.full(len(at), (end - start[0]) / _LOOKS)
    rows = [at.copy()]
    while True:
        low, high = np.zeros(len(at)), np.full(len(at), np.inf)
        for _ in range(_TRIES):
            off = np.linalg.norm(points(np.minimum(at + alpha, end)) - here, axis=1)
            beyond = at + alpha >= end
            done = (np.abs(off - distance) <= TOLERANCE) | (beyond & (off <= distance))
            if done.all():
                break
            low, high = np.where(off < distance, alpha, low), np.where(off > distance, alpha, high)
            scaled = alpha * np.clip(distance / np.maximum(off, TOLERANCE), 0.1, 10.0)
            halved = np.where(np.isfinite(high), 0.5 * (low + high), 2.0 * alpha)
            scaled = np.where((scaled > low) & (scaled < high), scaled, halved)
            alpha = np.where(done, alpha, scaled)
        at = at + alpha
        ended = at > end * (1.0 + 1e-12 * np.sign(end)) + (1e-12 * np.abs(end - start))
        at = np.where(ended, np.nan, at)
        if np.isnan(at).all():
            return np.array(rows)
        rows.append(at.copy())
        if len(rows) * len(at) > MOST_SAMPLES:
            raise TooMany
        moved = points(np.where(np.isnan(at), end, at))
        here = np.where(np.isnan(at)[:, None], here, moved)


def _on_face(body: FaceBody, face: int, uv: Array) -> NDArray[np.bool_]:
    """Whether parameters (n, 2) are inside a face, or on its rim."""
    faces = np.full(len(uv), face)
    inside = body.inside(faces, uv)
    out = np.flatnonzero(~inside)
    if len(out):
        points = body.splines.points(faces[out], uv[out])
        inside[out] = body.rim_distance(faces[out], points) <= ON_THE_RIM
    return inside


def _clear_of_seams(points: Array, normals: Array, row: Ints, spacing: float) -> NDArray[np.bool_]:
    """Which samples (n) stay: one too close to a sample of an earlier row, on the same sheet, goes."""
    keep = np.ones(len(points), dtype=bool)
    tree = cKDTree(points)
    pairs = tree.query_pairs(_TOO_CLOSE * spacing, output_type="ndarray")
    a, b = pairs.min(axis=1), pairs.max(axis=1)
    seam = (row[a] != row[b]) & ((normals[a] * normals[b]).sum(axis=1) > _OTHER_SHEET)
    for i, j in _sorted(a[seam], b[seam]):
        if keep[i]:
            keep[j] = False
    return keep


def _sorted(a: Ints, b: Ints) -> Sequence[tuple[int, int]]:
    order = np.lexsort((b, a))
    return list(zip(a[order].tolist(), b[order].tolist(), strict=True))
