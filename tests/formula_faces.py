"""Faces given by formulas, to test how paths cover them; sampled as Onstein's paper does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.toolpath.coverage.sheet import inside
from planner.toolpath.coverage.tours import SampledSurface

_DIFFERENCE = 1e-6  # of u and v, for normals
_CALIBRATED = 1e-3  # of the desired distance


@dataclass(frozen=True)
class FormulaFace:
    """formula: (u, v) -> points (..., 3) [m]; loops as in planner.toolpath.coverage.sheet.Patch; turned: whether the
    outward normal is that of dr/dv x dr/du."""

    formula: Callable[[Array, Array], Array]
    loops: tuple[Array, ...]
    turned: bool = False

    def points(self, uv: Array) -> Array:
        return self.formula(uv[:, 0], uv[:, 1])

    def normals(self, uv: Array) -> Array:
        h = _DIFFERENCE
        along_u = self.points(uv + [h, 0.0]) - self.points(uv - [h, 0.0])
        along_v = self.points(uv + [0.0, h]) - self.points(uv - [0.0, h])
        normal = np.cross(along_u, along_v) * (-1.0 if self.turned else 1.0)
        return normal / np.linalg.norm(normal, axis=1)[:, None]


def box(u: tuple[float, float], v: tuple[float, float], across: int, along: int) -> Array:
    """The edge of a rectangle of (u, v), so many points on its sides."""
    corners = np.array([[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]])
    return polygon(corners, (across, along, across, along))


def polygon(corners: Array, count: tuple[int, ...]) -> Array:
    """The edge of a polygon (k, 2), so many points on each of its sides."""
    ends = np.roll(corners, -1, axis=0)
    return np.concatenate(
        [a + (b - a) * np.arange(n)[:, None] / n for a, b, n in zip(corners, ends, count, strict=True)]
    )


def circle(u: float, v: float, radius: float, count: int) -> Array:
    """The edge of a circle of (u, v)."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return np.stack([u + radius * np.cos(angle), v + radius * np.sin(angle)], axis=1)


def sampled(face: FormulaFace, spacing: float, number: int = 0) -> SampledSurface:
    """Samples of a face about `spacing` [m] apart along u and v: algorithms 1 and 2 of the paper."""
    low, high = face.loops[0].min(axis=0), face.loops[0].max(axis=0)
    uv: list[list[float]] = []
    row: list[int] = []
    u, k = float(low[0]), 0
    while u <= high[0]:
        v = float(low[1])
        while v <= high[1]:
            uv.append([u, v])
            row.append(k)
            v += _calibrated(face, u, v, 1, spacing, float(high[1] - low[1]))
        u += _calibrated(face, u, float(low[1]), 0, spacing, float(high[0] - low[0]))
        k += 1
    places, rows = np.array(uv), np.array(row, dtype=np.int64)
    middle = 0.5 * (low + high)
    # points on the edge count as inside: they are judged a hair towards the middle
    judged = places + 1e-9 * (middle - places)
    kept = inside(face.loops[0], judged)
    for hole in face.loops[1:]:
        kept &= ~inside(hole, judged)
    places, rows = places[kept], rows[kept]
    owner = np.full(len(rows), number, dtype=np.int64)
    return SampledSurface(face.points(places), face.normals(places), places, owner, rows, (spacing, spacing))


def _calibrated(face: FormulaFace, u: float, v: float, direction: int, spacing: float, extent: float) -> float:
    """Step in u (0) or v (1) to the point that is `spacing` away."""
    step = 0.01 * extent
    here = face.points(np.array([[u, v]]))
    while True:
        there = np.array([[u, v]])
        there[0, direction] += step
        distance = float(np.linalg.norm(face.points(there) - here))
        if abs(distance - spacing) <= _CALIBRATED * spacing:
            return step
        step *= spacing / distance


def _curved(u: Array, v: Array) -> Array:
    """A sheet that rises upright, bends over and hangs over, cambered across, within 200 x 400 x 200 mm."""
    radius = 0.19 - 0.006 * (2.0 * u - 1.0) ** 2
    angle = 0.85 * np.pi * v
    return np.stack([0.098 * (2.0 * u - 1.0), 0.2 - radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


CURVED_PLATE = FormulaFace(_curved, (box((0.0, 1.0), (0.0, 1.0), 100, 260),))
