"""The part's surface, derived again from the problem: formulas of exact bodies, and distances from facets by coal.

Beads of layer k must lie k + 1 layer heights above it. Lengths are in metres, in the part frame.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import coal
import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.files import stamp_of
from planner.problem.mesh_files import read_corners
from planner.problem.part import MeshSpec, PartSpec
from planner.verify.bodies import triangle_model

_STEPS = 60  # most steps to the foot of a perpendicular; each reduces the error by height / radius of curvature
_CLOSE = 1e-9  # m

Level = Callable[
    [Array], tuple[Array, Array]
]  # of points (n, 3): a function that is 0 on the surface, and its gradient (n, 3)


def level_of(part: PartSpec) -> Level | None:
    """A function that is 0 on an exact body's surface and grows outwards, with its gradient; None for files."""
    if part.cylinder is not None:
        x, y = part.cylinder.centre
        return _round(part.cylinder.radius, np.array([x, y, 0.0]), np.array([1.0, 1.0, 0.0]))
    if part.sphere is not None:
        return _round(part.sphere.radius, np.asarray(part.sphere.centre), np.ones(3))
    if part.ellipsoid is not None:
        return _ellipsoid(np.asarray(part.ellipsoid.radii), np.asarray(part.ellipsoid.centre))
    if part.plane is not None:
        slope, rises = part.plane.slope, part.plane.rises
        up = np.array([-np.sin(slope) * np.cos(rises), -np.sin(slope) * np.sin(rises), np.cos(slope)])
        centre = np.asarray(part.plane.centre)
        return lambda p: ((p - centre) @ up, np.broadcast_to(up, p.shape))
    if part.corrugation is not None:
        wave = part.corrugation
        return _waves(wave.amplitude, wave.wavelength, wave.direction, np.asarray(wave.centre))
    return None


def _round(radius: float, centre: Array, along: Array) -> Level:
    """A ball, or the wall of a cylinder if `along` (3) leaves out its axis."""

    def level(p: Array) -> tuple[Array, Array]:
        away = (p - centre) * along
        far = np.linalg.norm(away, axis=1)
        return far - radius, away / np.maximum(far, _CLOSE)[:, None]

    return level


def _ellipsoid(radii: Array, centre: Array) -> Level:
    def level(p: Array) -> tuple[Array, Array]:
        share = (p - centre) / radii
        far = np.linalg.norm(share, axis=1)
        return far - 1.0, share / radii / np.maximum(far, _CLOSE)[:, None]

    return level


def _waves(amplitude: float, wavelength: float, direction: float, centre: Array) -> Level:
    k, ahead = 2.0 * np.pi / wavelength, np.array([np.cos(direction), np.sin(direction)])

    def level(p: Array) -> tuple[Array, Array]:
        phase = k * ((p - centre)[:, :2] @ ahead)
        slope = amplitude * k * np.sin(phase)
        gradient = np.column_stack([slope * ahead[0], slope * ahead[1], np.ones(len(p))])
        return p[:, 2] - centre[2] - amplitude * np.cos(phase), gradient

    return level


def feet(level: Level, tips: Array, rise: Array) -> tuple[Array, Array, Array]:
    """Feet (n, 3), `rise` (n) [m] below tips (n, 3) along a surface's normal; how far they are off the surface (n) [m];
    and the outward unit normals (n, 3) there."""
    foot = tips
    for _ in range(_STEPS):
        normal = _unit(level(foot)[1])
        moved = tips - rise[:, None] * normal
        done = np.abs(moved - foot).max(initial=0.0) < _CLOSE
        foot = moved
        if done:
            break
    value, gradient = level(foot)
    return foot, value / np.linalg.norm(gradient, axis=1), _unit(gradient)


def nearest_on(level: Level, points: Array) -> Array:
    """Places (n, 3) on a surface nearest to points (n, 3), by steps onto it and along it towards the perpendicular."""
    foot = points.copy()
    for _ in range(_STEPS * _STEPS):
        value, gradient = level(foot)
        square = (gradient**2).sum(axis=1)
        normal = gradient / np.sqrt(np.maximum(square, 1e-300))[:, None]
        off = points - foot
        aside = off - (off * normal).sum(axis=1)[:, None] * normal
        step = 0.5 * aside - (value / np.maximum(square, 1e-300))[:, None] * gradient
        foot = foot + step
        if np.abs(step).max(initial=0.0) < _CLOSE:
            break
    return foot


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None])


def distances_from_facets(spec: MeshSpec, points: Array) -> Array:
    """Unsigned distances (n) [m] of points (n, 3) from a file of facets. Raises InputError if it cannot be read."""
    model = _facets(spec, *stamp_of(spec.file))
    dot, still, request, at = coal.Sphere(_CLOSE), coal.Transform3s(), coal.DistanceRequest(), coal.Transform3s()
    out = np.empty(len(points))
    for i, point in enumerate(points):
        at.setTranslation(point)
        out[i] = coal.distance(model, still, dot, at, request, coal.DistanceResult())
    return out


@lru_cache(maxsize=2)
def _facets(spec: MeshSpec, changed: int, size: int) -> coal.BVHModelOBBRSS:
    """A file's facets in the part frame; `changed` and `size` identify the file."""
    corners = read_corners(spec.file, partial(InputError, file=spec.file), spec.unit, spec.scale).reshape(-1, 3)
    placed = Rotation.from_euler("xyz", spec.rpy).apply(np.array(corners)) + np.asarray(spec.origin)
    return triangle_model(placed, np.arange(len(placed)).reshape(-1, 3))
