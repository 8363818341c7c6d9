"""Bodies that plane curves are projected onto, and nozzle directions from the facets of a mesh.

Planes, corrugated sheets, ellipsoids and balls are known exactly; a mesh has its top (`mesh_top.py`). Lengths are
metres in the part frame.

Normals of facets (Pollard et al., section 4.1) jump where a bead passes from one facet to the next, and no arm can
follow a jump. `Facing` turns the normal over a stated length around each edge: it averages the facets' normals along
the bead with a B-spline kernel of degree 5, so that joints accelerate smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from planner.base.arrays import Array
from planner.problem.part import PartSpec
from planner.toolpath.bead import Shape, dome_shape, skin_shape

_KNOTS = 6
_SHARE = BSpline.basis_element(np.arange(_KNOTS + 1.0)).antiderivative()  # completed share of a jump, over its length

_TRIES = 24  # places within a wave that are tried as starts for the nearest one
_NEWTON_STEPS = 60  # starting next to a pole, each step gains a factor of 1.5
_CLOSE = 1e-12  # relative: a Newton step as small as this ends the search
_OFF_AXIS = 1e-9  # × a radius: on a centre plane, both sides are equally near, and one is chosen
_BLOCK = 16384  # points at once: bounds the memory of the tries


@dataclass(frozen=True)
class Facing:
    """Unit normals along a bead: `first` (3), then jumps (k, 3) at arc lengths `places` (k), each over `blend` [m]."""

    first: Array
    places: Array
    jumps: Array
    blend: float

    @classmethod
    def along(cls, s: Array, normals: Array, blend: float, closed: bool) -> Facing:
        """From the facets' normals (n, 3) at arc lengths s (n) of a bead."""
        if closed:  # one lap before and one after
            s = np.concatenate([s[:-1] - s[-1], s, s[-1] + s[1:]])
            normals = np.vstack([normals[:-1], normals, normals[1:]])
        jumps = np.diff(normals, axis=0)
        at = np.flatnonzero(np.abs(jumps).max(axis=1) > 0.0)
        return cls(normals[0], 0.5 * (s[at] + s[at + 1]), jumps[at], blend)

    def at(self, s: Array) -> Array:
        """Unit normals (n, 3) at arc lengths s (n) [m]."""
        order = np.argsort(s, kind="stable")
        ahead = s[order]
        begun, done = np.searchsorted(ahead, [self.places - 0.5 * self.blend, self.places + 0.5 * self.blend])
        out = np.zeros((len(s) + 1, 3))
        np.add.at(out, done, self.jumps)
        out = self.first + np.cumsum(out, axis=0)[:-1]
        for place, jump, i, j in zip(self.places, self.jumps, begun, done, strict=True):
            behind = _SHARE(_KNOTS * ((ahead[i:j] - place) / self.blend + 0.5))
            out[i:j] += behind[:, None] * jump
        normals = np.empty_like(out)
        normals[order] = out / np.linalg.norm(out, axis=1)[:, None]
        return normals


class SubstrateBody(Protocol):
    """A body whose surface is seen from above (metres, part frame)."""

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the surface at x, y (n, 2)."""
        ...

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the surface's normals at x, y (n, 2); NaN where there is no surface."""
        ...

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) at the places of the surface nearest to points (n, 3)."""
        ...

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the body; negative inside."""
        ...

    def shape(self) -> Shape | None:
        """The body for drawing, if it can be drawn."""
        ...


@dataclass(frozen=True)
class Ball:
    """A ball; centre (3)."""

    radius: float
    centre: Array

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the upper half at x, y (n, 2); NaN off the ball."""
        across = plane - self.centre[:2]
        square = self.radius**2 - (across**2).sum(axis=1)
        up = np.sqrt(np.where(square > 0.0, square, np.nan))
        normals = np.column_stack([across, up]) / self.radius
        normals[np.isnan(up)] = np.nan
        return self.centre + self.radius * normals, normals

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the normals at x, y (n, 2); NaN off the ball."""
        return self.at(plane)[1][:, 2]

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3): away from the centre."""
        away = points - self.centre
        return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1), 1e-12)[:, None])

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the ball; negative inside."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) - self.radius)

    def shape(self) -> Shape:
        """The dome above the bed."""
        return dome_shape(self.radius, self.centre)


def exact_body(part: PartSpec) -> SubstrateBody | None:
    """The part's body, if it is known exactly."""
    if part.sphere is not None:
        return Ball(part.sphere.radius, np.asarray(part.sphere.centre))
    if part.plane is not None:
        rise, way = np.tan(part.plane.slope), part.plane.rises
        gradient = rise * np.array([np.cos(way), np.sin(way)])
        return Plane(np.asarray(part.plane.centre), gradient, np.asarray(part.plane.size))
    if part.corrugation is not None:
        wave = part.corrugation
        along = np.array([np.cos(wave.direction), np.sin(wave.direction)])
        return Corrugation(
            np.asarray(wave.centre), wave.amplitude, 2.0 * np.pi / wave.wavelength, along, np.asarray(wave.size)
        )
    if part.ellipsoid is not None:
        return Ellipsoid(np.asarray(part.ellipsoid.centre), np.asarray(part.ellipsoid.radii))
    return None


def _beside(plane: Array, centre: Array, size: Array) -> NDArray[np.bool_]:
    """Which of x, y (n, 2) lie outside a rectangle of `size` (2) around a centre."""
    return np.asarray((np.abs(plane - centre[:2]) > 0.5 * size).any(axis=1))


@dataclass(frozen=True)
class Plane:
    """A plane through a centre (3), its height rising by `gradient` (2) per metre in x and y; solid beneath.

    It covers `size` (2) around the centre; distances are those to the infinite plane.
    """

    centre: Array
    gradient: Array
    size: Array

    @property
    def _normal(self) -> Array:
        normal = np.append(-self.gradient, 1.0)
        return np.asarray(normal / np.linalg.norm(normal))

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and upward unit normals (n, 3) at x, y (n, 2)."""
        z = self.centre[2] + (plane - self.centre[:2]) @ self.gradient
        return np.column_stack([plane, z]), np.tile(self._normal, (len(plane), 1))

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the normals at x, y (n, 2); NaN outside its size."""
        return np.where(_beside(plane, self.centre, self.size), np.nan, self._normal[2])

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3)."""
        return np.tile(self._normal, (len(points), 1))

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the plane; negative beneath."""
        return np.asarray((points - self.centre) @ self._normal)

    def shape(self) -> Shape:
        """Triangles of the plane within its size."""
        half = 0.5 * self.size
        return skin_shape(self.at, self.centre[:2] - half, self.centre[:2] + half)


@dataclass(frozen=True)
class Corrugation:
    """A sheet with a cosine wave, solid beneath.

    Its height is that of a centre (3) plus amplitude [m] times the cosine of `wave` [rad/m] times the distance from the
    centre `along` (2) the waves. It covers `size` (2) around the centre; distances are those to the infinite sheet.
    """

    centre: Array
    amplitude: float
    wave: float
    along: Array
    size: Array

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and upward unit normals (n, 3) at x, y (n, 2)."""
        t = (plane - self.centre[:2]) @ self.along
        z = self.centre[2] + self.amplitude * np.cos(self.wave * t)
        return np.column_stack([plane, z]), self._normals(t)

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the normals at x, y (n, 2); NaN outside its size."""
        return np.where(_beside(plane, self.centre, self.size), np.nan, self.at(plane)[1][:, 2])

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3) at the places nearest to points (n, 3)."""
        return self._normals(self._nearest(points)[0])

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the sheet; negative beneath."""
        u, t, z = self._nearest(points)
        over = z >= self.amplitude * np.cos(self.wave * t)
        return np.where(over, 1.0, -1.0) * np.hypot(u - t, self.amplitude * np.cos(self.wave * u) - z)

    def shape(self) -> Shape:
        """Triangles of the sheet within its size."""
        half = 0.5 * self.size
        return skin_shape(self.at, self.centre[:2] - half, self.centre[:2] + half)

    def _normals(self, t: Array) -> Array:
        slope = -self.amplitude * self.wave * np.sin(self.wave * t)
        normals = np.column_stack([-slope[:, None] * self.along, np.ones(len(t))])
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])

    def _nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """Places u (n) along the waves nearest to points (n, 3), and the points' own t and z (n), from the centre.

        The nearest place is less than half a wave away: one wave further the sheet has the same height.
        """
        t = (points[:, :2] - self.centre[:2]) @ self.along
        z = points[:, 2] - self.centre[2]
        u = np.empty(len(t))
        reach = np.pi / self.wave
        for first in range(0, len(t), _BLOCK):
            here = slice(first, first + _BLOCK)
            tries = t[here, None] + reach * np.linspace(-1.0, 1.0, _TRIES + 1)
            far = (tries - t[here, None]) ** 2 + (self.amplitude * np.cos(self.wave * tries) - z[here, None]) ** 2
            u[here] = np.take_along_axis(tries, np.argmin(far, axis=1)[:, None], axis=1)[:, 0]
        half = 2.0 * reach / _TRIES
        low, high = u - half, u + half
        for _ in range(_NEWTON_STEPS):
            c, s = self.amplitude * np.cos(self.wave * u), self.amplitude * self.wave * np.sin(self.wave * u)
            slope = (u - t) - (c - z) * s
            bend = 1.0 + s * s - (c - z) * self.wave**2 * c
            low, high = np.where(slope < 0.0, u, low), np.where(slope > 0.0, u, high)
            step = np.where(bend > 0.0, slope / np.where(bend > 0.0, bend, 1.0), np.inf)
            further = np.where((u - step > low) & (u - step < high), u - step, 0.5 * (low + high))
            done = np.abs(further - u).max(initial=0.0) <= _CLOSE * reach
            u = further
            if done:
                break
        return u, t, z


@dataclass(frozen=True)
class Ellipsoid:
    """An upright ellipsoid: centre (3), half axes `radii` (3) along x, y and z."""

    centre: Array
    radii: Array

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points and outward unit normals (n, 3) of the upper half at x, y (n, 2); NaN off the ellipsoid."""
        across = (plane - self.centre[:2]) / self.radii[:2]
        square = 1.0 - (across**2).sum(axis=1)
        unit = np.column_stack([across, np.sqrt(np.where(square > 0.0, square, np.nan))])
        normals = self._outward(unit)
        normals[np.isnan(unit[:, 2])] = np.nan
        return self.centre + self.radii * unit, normals

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the normals at x, y (n, 2); NaN off the ellipsoid."""
        return self.at(plane)[1][:, 2]

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) at the places nearest to points (n, 3)."""
        return self._outward(self._nearest(points) / self.radii)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the ellipsoid; negative inside."""
        away = points - self.centre
        inside = ((away / self.radii) ** 2).sum(axis=1) < 1.0
        return np.where(inside, -1.0, 1.0) * np.linalg.norm(away - self._nearest(points), axis=1)

    def shape(self) -> Shape:
        """Triangles of the part above its own centre and above z = 0."""
        ball = dome_shape(1.0, np.array([0.0, 0.0, self.centre[2] / self.radii[2]]))
        return Shape(self.centre + self.radii * ball.normals, self._outward(ball.normals), ball.triangles)

    def _outward(self, unit: Array) -> Array:
        """Unit normals (n, 3) where the ellipsoid, scaled to a ball of radius 1, has points (n, 3)."""
        normals = unit / self.radii
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])

    def _nearest(self, points: Array) -> Array:
        """Places (n, 3) nearest to points (n, 3), from the centre.

        With radii r they are r^2 y / (r^2 + t) for a point y, where sum (r y / (r^2 + t))^2 = 1. That sum falls and is
        convex in t: Newton's method, started where it is above 1, converges to the root from one side.
        """
        y = points - self.centre
        away = np.maximum(np.abs(y), _OFF_AXIS * self.radii)
        square = self.radii**2
        t = np.max(self.radii * away - square, axis=1)  # where a single term is 1
        for _ in range(_NEWTON_STEPS):
            terms = (self.radii * away / (square + t[:, None])) ** 2
            slope = -2.0 * (terms / (square + t[:, None])).sum(axis=1)
            step = (terms.sum(axis=1) - 1.0) / slope
            t = t - step
            if np.abs(step).max(initial=0.0) <= _CLOSE * float(square.max()):
                break
        return np.asarray(np.copysign(square * away / (square + t[:, None]), y))
