"""Random paths on random surfaces: waypoints with normals, as somebody else's slicer might hand them over.

Everything is in mm and in its own frame: surfaces stand on z = 0 around the z axis, with normals out of the material.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from planner.base.arrays import Array

Surface = Callable[[Array, Array], Array]  # (u, v) [mm] → points (n, 3), x_u × x_v out of the material

POINTS = (60, 400)  # waypoints of a bead
SPACING = (0.8, 2.0)  # mm between them
HELIX_POINTS, HELIX_SPACING = 1500, 3.0  # at most
TURNS = (1.0, 80.0)
HALF_SIZES = (15.0, 60.0)  # mm: of the patch that is printed on
_TINY = 1e-3  # mm: step of the difference that gives normals
_FINE = 0.05  # mm: step at which a path's length is measured


@dataclass(frozen=True)
class Waypoints:
    """Points (n, 3) [mm], unit normals (n, 3), and of each point the layer and the bead (n) that it belongs to."""

    points: Array
    normals: Array
    layer: NDArray[np.int64]
    bead: NDArray[np.int64]

    def noisy(self, noise: float, rng: Generator) -> Waypoints:
        """The same, each normal's components off by so much (standard deviation)."""
        normals = self.normals + noise * rng.normal(size=self.normals.shape)
        return replace(self, normals=normals / np.linalg.norm(normals, axis=1)[:, None])

    def text(self, offset: Array) -> str:
        """A file of waypoints with a header, every point shifted by an offset (3) [mm]."""
        lines = ["x y z nx ny nz layer bead"]
        rows = zip(self.points + offset, self.normals, self.layer, self.bead, strict=True)
        for (x, y, z), (a, b, c), layer, bead in rows:
            lines.append(f"{x:.4f} {y:.4f} {z:.4f} {a:.7f} {b:.7f} {c:.7f} {layer} {bead}")
        return "\n".join(lines) + "\n"


# ----------------------------------------------------------------------------------------------------
# Surfaces: each takes a patch's (u, v), which are nearly lengths around its middle.


def sphere(radius: float) -> Surface:
    """A ball's cap about its top."""

    def at(u: Array, v: Array) -> Array:
        polar = np.hypot(u, v) / radius
        shrunk = np.sinc(polar / np.pi)
        return np.column_stack([u * shrunk, v * shrunk, radius * np.cos(polar)])

    return at


def upright_cone(radius: float, slope: float, azimuth: float) -> Surface:
    """The wall of a cone, narrower the higher, or of a cylinder (slope 0); u goes around from an azimuth, v up."""

    def at(u: Array, v: Array) -> Array:
        around, r = azimuth + u / radius, radius - v * np.sin(slope)
        return np.column_stack([r * np.cos(around), r * np.sin(around), v * np.cos(slope)])

    return at


def lying_cylinder(radius: float) -> Surface:
    """The upper side of a cylinder along y."""
    return lambda u, v: np.column_stack([radius * np.sin(u / radius), v, radius * np.cos(u / radius)])


def saddle(radius: float) -> Surface:
    """z = (u² - v²) / 2 r."""
    return lambda u, v: np.column_stack([u, v, (u**2 - v**2) / (2.0 * radius)])


def torus(ring: float, tube: float, azimuth: float) -> Surface:
    """A ring about z; u goes around it from an azimuth, v around its tube from the outer equator to its top."""

    def at(u: Array, v: Array) -> Array:
        around, up = azimuth + u / (ring + tube), v / tube
        r = ring + tube * np.cos(up)
        return np.column_stack([r * np.cos(around), r * np.sin(around), tube * np.sin(up)])

    return at


def height_field(waves: Array) -> Surface:
    """A sum of waves: rows (wave numbers along u and v [1/mm], phase, amplitude [mm])."""

    def at(u: Array, v: Array) -> Array:
        return np.column_stack([u, v, sum(a * np.cos(k * u + m * v + phase) for k, m, phase, a in waves)])

    return at


def on_surface(surface: Surface, u: Array, v: Array) -> tuple[Array, Array]:
    """Points and unit normals (n, 3)."""
    x_u = surface(u + _TINY, v) - surface(u - _TINY, v)
    x_v = surface(u, v + _TINY) - surface(u, v - _TINY)
    normals = np.cross(x_u, x_v)
    return surface(u, v), normals / np.linalg.norm(normals, axis=1)[:, None]


@dataclass(frozen=True)
class Patch:
    """A surface, and how far (u, v) may be from 0 on it [mm]; disc: the path keeps from its corners."""

    surface: Surface
    half: tuple[float, float]
    disc: bool = False


def random_patch(rng: Generator, largest: float, around: bool) -> Patch:
    """A patch of any sort, at most so large [mm] to either side; around: it may reach round an upright part."""
    a, b = rng.uniform(HALF_SIZES[0], max(largest, HALF_SIZES[0] + 1.0), 2)
    azimuth = rng.uniform(0.0, 2.0 * np.pi) if around else np.pi + rng.uniform(-0.8, 0.8)
    most = 0.97 * np.pi if around else 1.0
    match rng.choice(["sphere", "cylinder", "cone", "lying", "saddle", "torus", "field", "plane"]):
        case "sphere":
            radius = rng.uniform(1.0, 3.0) * a
            half = min(a, 1.3 * radius)
            return Patch(sphere(radius), (half, half), disc=True)
        case "cylinder":
            radius = rng.uniform(0.5, 1.5) * a
            return Patch(upright_cone(radius, 0.0, azimuth), (min(2.0 * a, most * radius), 0.7 * b))
        case "cone":
            radius, slope, high = rng.uniform(0.7, 1.5) * a, rng.uniform(0.1, 1.2), 0.7 * b
            high = min(high, 0.7 * radius / np.sin(slope))  # its top stays off
            return Patch(upright_cone(radius, slope, azimuth), (min(2.0 * a, most * radius), high))
        case "lying":
            radius = rng.uniform(0.8, 3.0) * a
            return Patch(lying_cylinder(radius), (min(a, 1.3 * radius), b))
        case "saddle":
            return Patch(saddle(rng.uniform(1.5, 5.0) * max(a, b)), (a, b))
        case "torus":
            ring, tube = rng.uniform(0.8, 1.5) * a, rng.uniform(0.3, 0.7) * a
            up = rng.uniform(0.2, 0.7) * np.pi * tube
            return Patch(_raised(torus(ring, tube, azimuth), up), (min(2.0 * a, most * (ring + tube)), 0.6 * tube))
        case "field":
            n = int(rng.integers(2, 6))
            number, towards = 2.0 * np.pi / rng.uniform(60.0, 200.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
            steep = rng.uniform(0.05, 0.7) / n  # slope of each wave
            rows = [number * np.cos(towards), number * np.sin(towards), rng.uniform(0.0, 6.3, n), steep / number]
            return Patch(height_field(np.column_stack(rows)), (a, b))
    slope, towards = rng.uniform(0.0, 0.8), rng.uniform(0.0, 2.0 * np.pi)
    x, y = np.tan(slope) * np.cos(towards), np.tan(slope) * np.sin(towards)
    return Patch(lambda u, v: np.column_stack([u, v, x * u + y * v]), (a, b))


def _raised(surface: Surface, up: float) -> Surface:
    return lambda u, v: surface(u, v + up)


# ----------------------------------------------------------------------------------------------------
# Paths in (u, v): corners of pieces that are each followed to their end.


def zigzag(half: tuple[float, float], pitch: float) -> list[Array]:
    """Rows along u to and fro, with straight lines between."""
    v = np.arange(-half[1], half[1], pitch)
    corners = []
    for i, at in enumerate(v):
        ends = [[-half[0], at], [half[0], at]]
        corners += ends if i % 2 == 0 else ends[::-1]
    return [np.array(pair) for pair in zip(corners[:-1], corners[1:], strict=True)]


def spiral(half: tuple[float, float], pitch: float) -> list[Array]:
    """From near the middle outwards."""
    turns = max(min(half) / pitch - 2.0, 0.7)
    around = np.linspace(0.0, 2.0 * np.pi * turns, int(200 * turns) + 200)
    r = 2.0 * pitch + pitch * around / (2.0 * np.pi)
    r *= min(1.0, min(half) / r[-1])
    return [np.column_stack([r * np.cos(around), r * np.sin(around)])]


def wave(half: tuple[float, float], rng: Generator) -> list[Array]:
    """A smooth random curve along u that does not cross itself."""
    u = np.linspace(-1.0, 1.0, 2000)
    n = np.arange(1, 5)
    v = np.sin(np.pi * n * u[:, None] + rng.uniform(0.0, 6.3, 4)) @ (rng.normal(size=4) / n**1.5)
    v *= rng.uniform(0.2, 1.0) / max(float(np.abs(v).max()), 0.3)
    return [np.column_stack([half[0] * u, half[1] * v])]


def loop(half: tuple[float, float], rng: Generator) -> list[Array]:
    """Once around a smooth random ring, nearly closed."""
    around = np.linspace(0.0, 1.95 * np.pi, 2000) + rng.uniform(0.0, 6.3)
    r = 0.8 + 0.15 * np.cos(rng.integers(2, 5) * around + rng.uniform(0.0, 6.3))
    return [np.column_stack([half[0] * r * np.cos(around), half[1] * r * np.sin(around)])]


def random_path(half: tuple[float, float], disc: bool, width: float, rng: Generator) -> list[Array]:
    """A path of any sort within a patch, its rows at least a bead's width [mm] apart."""
    if disc:
        half = (half[0] / np.sqrt(2.0), half[1] / np.sqrt(2.0))
    pitch = width * rng.uniform(1.0, 4.0)
    match rng.choice(["zigzag", "spiral", "wave", "wave", "loop"]):
        case "zigzag":
            return zigzag(half, pitch)
        case "spiral":
            return spiral(half, pitch)
        case "wave":
            return wave(half, rng)
    return loop(half, rng)


def sampled(surface: Surface, pieces: Sequence[Array], spacing: float, most: int) -> Array:
    """Places (n, 2) in (u, v), evenly spaced [mm] on the surface along each piece; most: as many at most."""
    out: list[Array] = []
    for piece in pieces:
        apart = np.linalg.norm(np.diff(piece, axis=0), axis=1).sum()
        share = np.linspace(0.0, 1.0, max(int(apart / _FINE), 50))
        along = np.linspace(0.0, 1.0, len(piece))
        uv = np.column_stack([np.interp(share, along, column) for column in piece.T])
        steps = np.linalg.norm(np.diff(surface(*uv.T), axis=0), axis=1)
        length = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.linspace(0.0, length[-1], max(round(length[-1] / spacing), 1) + 1)
        places = np.column_stack([np.interp(at, length, column) for column in uv.T])
        out.append(places if not out else places[1:])
    return np.vstack(out)[:most]


# ----------------------------------------------------------------------------------------------------
# What is printed.


def random_beads(rng: Generator, largest: float, around: bool, width: float, height: float) -> Waypoints:
    """One to four beads on a patch: layers on each other, or side by side."""
    patch = random_patch(rng, largest, around)
    spacing, most = rng.uniform(*SPACING), int(rng.integers(POINTS[0], POINTS[1] + 1))
    beads = int(rng.choice([1, 2, 3, 4], p=[0.5, 0.25, 0.15, 0.1]))
    stacked = rng.random() < 0.5
    found = []
    if stacked:
        uv = sampled(patch.surface, random_path(patch.half, patch.disc, width, rng), spacing, most)
        points, normals = on_surface(patch.surface, *uv.T)
        for k in range(beads):
            way = slice(None, None, -1 if k % 2 else 1)
            found.append((points[way] + k * height * normals[way], normals[way], k))
    else:
        strip = patch.half[1] / beads
        for k in range(beads):
            middle = -patch.half[1] + (2 * k + 1) * strip
            pieces = random_path((patch.half[0], strip - 0.5 * width), patch.disc, width, rng)
            pieces = [piece + np.array([0.0, middle]) for piece in pieces]
            points, normals = on_surface(patch.surface, *sampled(patch.surface, pieces, spacing, most).T)
            found.append((points, normals, 0))
    return _joined(found)


def random_helix(rng: Generator, width: float) -> Waypoints:
    """A helix of one to eighty turns on an upright cylinder or cone, its wires a bead's width apart or more."""
    turns = np.exp(rng.uniform(*np.log(TURNS)))
    pitch = min(width * rng.uniform(1.0, 4.0), max(100.0 / turns, width))
    slope = 0.0 if rng.random() < 0.5 else rng.uniform(0.1, 0.9)
    longest = HELIX_POINTS * HELIX_SPACING
    radius = rng.uniform(10.0, max(min(45.0, longest / (2.0 * np.pi * turns)), 10.1))
    if slope > 0.0:
        turns = min(turns, 0.8 * radius / (pitch * np.sin(slope)))
    u = np.linspace(0.0, 2.0 * np.pi * turns * radius, int(200 * turns) + 200)
    line = np.column_stack([rng.choice([-1.0, 1.0]) * u, u * pitch / (2.0 * np.pi * radius)])
    surface = upright_cone(radius, slope, rng.uniform(0.0, 2.0 * np.pi))
    spacing = float(np.clip(u[-1] / HELIX_POINTS, rng.uniform(*SPACING), HELIX_SPACING))
    points, normals = on_surface(surface, *sampled(surface, [line], spacing, 2 * HELIX_POINTS).T)
    return _joined([(points, normals, 0)])


def _joined(beads: Sequence[tuple[Array, Array, int]]) -> Waypoints:
    """Beads of points, normals and layer in one, the lowest point at z = 0."""
    points, normals = (np.vstack([bead[k] for bead in beads]) for k in (0, 1))
    counts = [len(bead[0]) for bead in beads]
    layers = np.repeat([bead[2] for bead in beads], counts)
    return Waypoints(points - [0.0, 0.0, points[:, 2].min()], normals, layers, np.repeat(np.arange(len(beads)), counts))
