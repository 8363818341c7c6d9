"""Measures of a path over a face: coverage, crossings, length, turns, time and greatest distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints
from planner.base.geometry import subdivided
from planner.toolpath.coverage.tours import SampledSurface

TURN = np.radians(30.0)  # a bend of more than that within half a spacing is a turn
_TOUCH = 1e-6  # m: lines that come nearer than this meet
_PIECES = 4.0  # per spacing, of a chord laid onto the face
_NEAREST = 4  # samples whose tangent planes define the face
_SHARP = np.radians(12.0)  # at one point of a line: more is a corner, which is rounded within the tolerance
_ACCELERATION = 5.0  # m/s2, of the tool: an IRB 140's 15 rad/s2 at a third of a metre
_JERK = 250.0  # m/s3, fifty times that
_LIFT = 1.0  # s, to stop, lift and lower between strokes
_TRAVEL = 0.2  # m/s, between strokes


@dataclass(frozen=True)
class SurfaceLine:
    """A path as a fine polyline on the face: points and unit normals (n, 3) [m]; closed: back to the first point."""

    points: Array
    normals: Array
    closed: bool = False

    def opened(self) -> tuple[Array, Array]:
        """Points and normals, the first repeated at the end of a closed line."""
        if not self.closed:
            return self.points, self.normals
        return np.vstack([self.points, self.points[:1]]), np.vstack([self.normals, self.normals[:1]])


def visits_each_once(order: Ints, count: int) -> bool:
    """Whether an order visits all of `count` samples, each once."""
    return len(order) == count and bool(np.array_equal(np.sort(order), np.arange(count)))


def laid(surface: SampledSurface, order: Ints) -> SurfaceLine:
    """The chords between successive samples, laid onto the face.

    A point of a chord moves along the normal onto the tangent planes of the samples nearest to it. Its new place
    depends only on the old one, not on the chord: lines that cross on the face also cross here. A chord through the air
    from one fold of a sheet to another lies nowhere in particular.
    """
    points, spacing = surface.points[order], max(surface.spacing)
    step = np.diff(points, axis=0)
    pieces = np.maximum(np.ceil(np.linalg.norm(step, axis=1) * _PIECES / spacing).astype(np.int64), 1)
    start, share = subdivided(pieces)
    line = np.vstack([points[start] + share[:, None] * step[start], points[-1:]])
    away, near = cKDTree(surface.points).query(line, k=min(_NEAREST, len(surface.points)))
    away, near = away.reshape(len(line), -1), near.reshape(len(line), -1)
    weight = 1.0 / np.maximum(away, 1e-6 * spacing) ** 4
    weight /= weight.sum(axis=1)[:, None]
    normals = np.einsum("ik,ikj->ij", weight, surface.normals[near])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    above = np.einsum("ikj,ikj->ik", line[:, None] - surface.points[near], surface.normals[near])
    return SurfaceLine(line - np.einsum("ik,ik->i", weight, above)[:, None] * normals, normals)


def crossings(lines: Sequence[SurfaceLine]) -> Array:
    """Places (k, 3) [m] where lines on a face cross or touch one another or themselves, seen along the face's normal.

    All pairs of pieces near each other are checked in the plane between them. Successive pieces, which always meet,
    count only where the line turns back on itself; pieces on sheets with opposite normals do not meet.
    """
    opened = [line.opened() for line in lines]
    a = np.concatenate([points[:-1] for points, _ in opened])
    b = np.concatenate([points[1:] for points, _ in opened])
    normal = np.concatenate([normals[:-1] + normals[1:] for _, normals in opened])
    count = [len(points) - 1 for points, _ in opened]
    owner = np.repeat(np.arange(len(lines)), count)
    place = np.concatenate([np.arange(n) for n in count])
    size = np.array(count)[owner]
    ring = np.array([line.closed for line in lines])[owner]
    length = np.linalg.norm(b - a, axis=1)
    reach = float(length.max()) + _TOUCH
    pairs = cKDTree(0.5 * (a + b)).query_pairs(reach, output_type="ndarray")
    i, j = pairs[:, 0], pairs[:, 1]
    apart = np.abs(place[i] - place[j])
    follow = (owner[i] == owner[j]) & ((apart == 1) | (ring[i] & (apart == size[i] - 1)))
    same = np.einsum("ij,ij->i", normal[i], normal[j]) > 0.0
    cosine = np.einsum("ij,ij->i", b[i] - a[i], b[j] - a[j]) / np.maximum(length[i] * length[j], np.finfo(float).tiny)
    back = follow & (cosine < -np.cos(_SHARP / 100.0))
    i, j = i[same & (~follow | back)], j[same & (~follow | back)]
    met = _meet(a[i], b[i], a[j], b[j], normal[i] + normal[j])
    return 0.25 * (a[i] + b[i] + a[j] + b[j])[met]


def _meet(a: Array, b: Array, c: Array, d: Array, normal: Array) -> Array:
    """Whether segments ab and cd (k, 3) meet in the planes perpendicular to `normal` (k, 3)."""
    z = normal / np.linalg.norm(normal, axis=1)[:, None]
    x = np.cross(z, np.where(np.abs(z[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    x /= np.linalg.norm(x, axis=1)[:, None]
    y = np.cross(z, x)

    def plane(p: Array) -> Array:
        return np.stack([np.einsum("ij,ij->i", p - a, x), np.einsum("ij,ij->i", p - a, y)], axis=1)

    A, B, C, D = (plane(p) for p in (a, b, c, d))

    def side(p: Array, q: Array, r: Array) -> Array:
        return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])

    def beside(p: Array, q: Array, r: Array) -> Array:
        """Distance of r from the segment pq."""
        way = q - p
        t = np.clip(np.einsum("ij,ij->i", r - p, way) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-30), 0.0, 1.0)
        return np.linalg.norm(r - p - t[:, None] * way, axis=1)

    across = (side(A, B, C) * side(A, B, D) < 0.0) & (side(C, D, A) * side(C, D, B) < 0.0)
    near = np.minimum.reduce([beside(A, B, C), beside(A, B, D), beside(C, D, A), beside(C, D, B)])
    return across | (near < _TOUCH)


def length(lines: Sequence[SurfaceLine]) -> float:
    """Length of the lines, without travel between them [m]."""
    return sum(float(np.linalg.norm(np.diff(line.opened()[0], axis=0), axis=1).sum()) for line in lines)


def turns(lines: Sequence[SurfaceLine], spacing: float) -> tuple[int, float]:
    """How often the lines turn, and by how much in total [rad], within the face: its own curvature is no turn."""
    count, total = 0, 0.0
    for line in lines:
        bend, step = _bends(line)
        if not len(bend):
            continue
        total += float(np.abs(bend).sum())
        s = np.cumsum(step)[:-1]
        summed = np.concatenate([[0.0], np.cumsum(bend)])
        low, high = np.searchsorted(s, s - 0.25 * spacing, "left"), np.searchsorted(s, s + 0.25 * spacing, "right")
        turning = np.abs(summed[high] - summed[low]) > TURN
        starts = turning & ~np.concatenate([[False], turning[:-1]])
        # two adjacent corners that turn opposite ways count as two
        same = np.sign(summed[high] - summed[low])
        starts |= turning & (same != np.concatenate([[0.0], same[:-1]]))
        count += int(starts.sum())
    return count, total


def seconds(lines: Sequence[SurfaceLine], speed: float, tolerance: float) -> float:
    """Estimated time [s] to follow the lines at `speed` [m/s], for comparing paths.

    Corners are rounded within `tolerance` [m] and slow the tool down as its acceleration and jerk require; lifting
    and travel between lines are added. No arm is considered.
    """
    total = length(lines) / speed
    for before, after in zip(lines[:-1], lines[1:], strict=True):
        total += _LIFT + float(np.linalg.norm(after.points[0] - before.opened()[0][-1])) / _TRAVEL
    for line in lines:
        bend, step = _bends(line)
        if not len(bend):
            continue
        angle = np.abs(bend)
        half = np.cos(np.minimum(angle, 0.98 * np.pi) / 2.0)
        beside = 0.5 * (step[1:] + step[:-1])
        flat = np.maximum(angle, 1e-12)
        radius = np.where(angle > _SHARP, tolerance * half / np.maximum(1.0 - half, 1e-12), beside / flat)
        possible = np.minimum(np.minimum(np.sqrt(_ACCELERATION * radius), np.cbrt(_JERK * radius**2)), speed)
        slow = possible < speed
        piece = np.cumsum(slow & ~np.concatenate([[False], slow[:-1]]))[slow]
        if not len(piece):
            continue
        least = np.full(piece[-1] + 1, speed)
        np.minimum.at(least, piece, possible[slow])
        lost = speed - least
        total += float((2.0 * np.sqrt(lost / _JERK) * lost / speed).sum())
        rounded = slow & (angle <= _SHARP)
        total += float((beside[rounded] * (1.0 / possible[rounded] - 1.0 / speed)).sum())
    return total


def farthest(lines: Sequence[SurfaceLine], points: Array) -> float:
    """The greatest distance of points (n, 3) of a face from the lines [m]."""
    return float(distances([line.opened()[0] for line in lines], points).max())


def distances(opened: Sequence[Array], points: Array) -> Array:
    """Distances (n,) of points (n, 3) of a face from the nearest of the open polylines [m]."""
    a, b = np.concatenate([p[:-1] for p in opened]), np.concatenate([p[1:] for p in opened])
    ends = np.concatenate(opened)
    count = [len(p) for p in opened]
    last = np.cumsum(count) - 1
    before = np.arange(len(ends)) - np.repeat(np.arange(len(count)), count)  # the piece that starts at a point
    is_last, is_first = np.zeros(len(ends), dtype=np.bool_), np.zeros(len(ends), dtype=np.bool_)
    is_last[last], is_first[last - np.array(count) + 1] = True, True
    _, near = cKDTree(ends).query(points)
    best = np.linalg.norm(points - ends[near], axis=1)
    for piece, none in ((before[near], is_last[near]), (before[near] - 1, is_first[near])):
        k = np.where(none, 0, piece)
        way = b[k] - a[k]
        t = np.einsum("ij,ij->i", points - a[k], way) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-30)
        off = np.linalg.norm(points - a[k] - np.clip(t, 0.0, 1.0)[:, None] * way, axis=1)
        best = np.where(none, best, np.minimum(best, off))
    return best


def _bends(line: SurfaceLine) -> tuple[Array, Array]:
    """Signed turn [rad] within the face at each inner point of a line (n - 2,), and steps between points (n - 1,)."""
    points, normals = line.opened()
    step = np.diff(points, axis=0)
    size = np.linalg.norm(step, axis=1)
    kept = np.concatenate([[True], size > 0.0])
    points, normals = points[kept], normals[kept]
    step, size = np.diff(points, axis=0), size[size > 0.0]
    normal = normals[1:-1]

    def flat(v: Array) -> Array:
        return v - np.einsum("ij,ij->i", v, normal)[:, None] * normal

    before, after = flat(step[:-1]), flat(step[1:])
    sine = np.einsum("ij,ij->i", np.cross(before, after), normal)
    return np.arctan2(sine, np.einsum("ij,ij->i", before, after)), size
