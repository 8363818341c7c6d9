"""Samples faces at desired distances along their parameters (Onstein et al., Algorithms 1 and 2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints
from planner.toolpath.coverage.tours import SampledSurface
from planner.toolpath.step.body import ON_THE_RIM, FaceBody

TOLERANCE = 1e-6  # m: default tolerance of the distance between samples
MOST_SAMPLES = 200_000
_TRIES = 60  # of rescaling a step
_LINES = 9  # lines across the rows: the distance between rows is measured on the longest
_LOOKS = 33  # points on each of them
_TOO_CLOSE = 0.5  # × the spacing: of two samples of different rows this close, at a seam or pole, one is dropped
_OTHER_SHEET = 0.0  # cosine between normals below which samples lie on different sheets


class TooMany(ValueError):
    """More than MOST_SAMPLES samples of a face."""


@dataclass(frozen=True)
class Sampling:
    """How faces are sampled.

    spacing    desired distances along u and along v [m], the paper's d_u* and d_v*
    along      parameter along which rows run: 0 for u, 1 for v; the other one is constant on a row
    tolerance  greatest deviation from a desired distance [m], the paper's t
    """

    spacing: tuple[float, float]
    along: int = 1
    tolerance: float = TOLERANCE

    @property
    def row(self) -> float:
        """Distance between neighbours on a row [m]."""
        return self.spacing[self.along]

    @property
    def apart(self) -> float:
        """Distance between neighbouring rows [m]."""
        return self.spacing[1 - self.along]


def sample_faces(body: FaceBody, sampling: Sampling) -> SampledSurface:
    """Samples of all faces of a body; those of different rows are at least half the smaller spacing apart."""
    faces, uvs, rows = [], [], []
    start = 0
    for k in range(len(body.side)):
        uv, row = _sample(body, k, sampling)
        faces.append(np.full(len(uv), k, dtype=np.int64))
        uvs.append(uv)
        rows.append(row + start)
        start += int(row.max(initial=-1)) + 1
    face, uv, row = np.concatenate(faces), np.vstack(uvs), np.concatenate(rows)
    at = body.at(face, uv)
    keep = _clear_of_seams(at.points, at.normals, row, min(sampling.spacing))
    return SampledSurface(at.points[keep], at.normals[keep], uv[keep], face[keep], row[keep], sampling.spacing)


def _sample(body: FaceBody, face: int, sampling: Sampling) -> tuple[Array, Ints]:
    """Parameters (n, 2) of the samples inside a face, and the row (n) of each."""
    along, across = sampling.along, 1 - sampling.along
    low, high = body.low[face], body.high[face]

    def at(row: Array | float, place: Array) -> Array:
        """Parameters (n, 2) of places on rows."""
        uv = np.empty((len(place), 2))
        uv[:, across], uv[:, along] = row, place
        return uv

    def points(uv: Array) -> Array:
        return body.splines.points(np.full(len(uv), face), uv)

    looks, lines = np.linspace(low[across], high[across], _LOOKS), np.linspace(low[along], high[along], _LINES)
    grid = np.stack([points(at(looks, np.full(_LOOKS, line))) for line in lines])
    lengths = np.linalg.norm(np.diff(grid, axis=1), axis=2).sum(axis=1)
    longest = float(lines[int(np.argmax(lengths > lengths.max() * (1.0 - 1e-9)))])  # at a pole steps have no length
    tolerance = sampling.tolerance
    begun = np.array([low[across]])
    rows = _march(lambda c: points(at(c, np.full(len(c), longest))), begun, high[across], sampling.apart, tolerance)
    row = rows[:, 0]
    begun = np.full(len(row), low[along])
    steps = _march(lambda c: points(at(row[: len(c)], c)), begun, high[along], sampling.row, tolerance)
    number = np.broadcast_to(np.arange(len(row)), steps.shape)
    there = np.isfinite(steps)
    uv, number = at(np.broadcast_to(row, steps.shape)[there], steps[there]), number[there]
    inside = _on_face(body, face, uv)
    return uv[inside], number[inside]


def _march(points: Callable[[Array], Array], start: Array, end: float, distance: float, tolerance: float) -> Array:
    """Parameters (k, n) of steps of `distance` [m] from start (n) up to `end`; NaN where a line has ended.

    Algorithm 2: the step in the parameter is scaled by the ratio of desired to actual distance until this fits.
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
            done = (np.abs(off - distance) <= tolerance) | (beyond & (off <= distance))
            if done.all():
                break
            low, high = np.where(off < distance, alpha, low), np.where(off > distance, alpha, high)
            scaled = alpha * np.clip(distance / np.maximum(off, tolerance), 0.1, 10.0)
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
    """Which samples (n) to keep: all but those too close to a sample of an earlier row on the same sheet."""
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
