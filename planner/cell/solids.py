"""Simple solids that make up the bodies of robots, tools and fixtures (metres)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planner.base.arrays import Array, Ints, ReadOnlyArrays

BOX, FRUSTUM, CAPSULE, HULL = 0, 1, 2, 3  # numbers of the kinds in compiled kernels
SIZES = 6  # numbers that describe a solid's size, at most
_FILLED = 1e-6  # share of its hull's volume that a mesh may lack and still count as that hull
_AROUND = 48  # corners of a circle drawn as triangles


@dataclass(frozen=True)
class Box:
    """A box about the origin; size along x, y, z."""

    size: tuple[float, float, float]


@dataclass(frozen=True)
class Frustum:
    """A cylinder, cone or truncated cone: along z from 0 to `height`, its radius from `bottom` to `top`."""

    bottom: float
    top: float
    height: float


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of a segment along z, `length` long and centred on the origin; length 0: a ball."""

    radius: float
    length: float


@dataclass(frozen=True)
class Hull(ReadOnlyArrays):
    """The convex hull of vertices (n, 3). Raises ValueError if they lie in one plane."""

    vertices: Array

    @cached_property
    def _hull(self) -> ConvexHull:
        try:
            return ConvexHull(self.vertices)
        except QhullError:
            raise ValueError("all vertices of a hull lie in one plane") from None

    @property
    def planes(self) -> Array:
        """Outward unit normals and offsets (k, 4): a point p is inside where n . p + offset <= 0 for all of them."""
        return np.unique(np.round(self._hull.equations, 12), axis=0)

    @property
    def corners(self) -> Array:
        """The vertices (k, 3) that are corners of the hull."""
        return np.asarray(self.vertices[self._hull.vertices])

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        return float(self._hull.volume)

    @property
    def facets(self) -> tuple[Array, Ints]:
        """Vertices (m, 3) and triangles (k, 3), counter-clockwise seen from outside."""
        hull = self._hull
        triangles = hull.simplices.astype(np.int64)
        a, b, c = (self.vertices[triangles[:, k]] for k in range(3))
        inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
        triangles[inward] = triangles[inward][:, ::-1]
        return self.vertices, triangles


@dataclass(frozen=True)
class Mesh(ReadOnlyArrays):
    """Triangles unchanged, hollows and all: vertices (n, 3), triangles (m, 3), counter-clockwise seen from outside."""

    vertices: Array
    triangles: Ints

    @cached_property
    def filled(self) -> Hull | None:
        """Its convex hull if the mesh fills it, otherwise None."""
        own = self.vertices[self.triangles]
        volume = float(np.einsum("ni,ni->", own[:, 0], np.cross(own[:, 1], own[:, 2]))) / 6.0
        hull = Hull(self.vertices)
        try:
            whole = hull.volume
        except ValueError:  # it is flat
            return None
        return hull if volume >= (1.0 - _FILLED) * whole else None


ConvexSolid = Box | Frustum | Capsule | Hull
Solid = ConvexSolid | Mesh


@dataclass(frozen=True)
class Body:
    """A named solid and its pose T_frame_solid (4, 4) in the frame that carries it.

    link    for a body of a robot: the URDF's link that it belongs to
    beside  names of links of the same robot that it may touch
    colour, trim  in pictures, such as #f47a20: its own, that of covers on joints; empty if its robot's file names none
    below   for a body of a carrier: fixed relative to the arm's foot, which does not stand on it, so that it is no
            neighbour of the arm's first link
    """

    name: str
    solid: Solid
    T_frame_solid: Array
    link: str = ""
    beside: frozenset[str] = frozenset()
    colour: str = ""
    trim: str = ""
    below: bool = False


@dataclass(frozen=True)
class Look:
    """A link's visual mesh: its file, its scale along x, y and z, and its pose in the frame that carries it.

    colour  of the whole mesh; empty to use the file's own colours
    """

    link: str
    file: Path
    scale: tuple[float, float, float]
    T_frame_solid: Array
    colour: str = ""


def in_touch(a: Body, b: Body) -> bool:
    """Whether two bodies of one robot may touch, according to its file."""
    return b.link in a.beside


@dataclass(frozen=True)
class Packed(ReadOnlyArrays):
    """Convex solids as numbers for compiled kernels (b solids), in one frame.

    kind (b), size (b, SIZES)   of Box: half sizes; Capsule: radius, half length; Hull: first plane, number of planes;
                             Frustum: bottom, top, height, direction (2, outwards and up) and length of its side
    planes (k, 4)            of all hulls
    T_solid_frame (b, 4, 4)  takes points of the frame into the solid
    centre (b, 3), reach (b) ball around the solid, in the frame
    """

    kind: Ints
    size: Array
    planes: Array
    T_solid_frame: Array
    centre: Array
    reach: Array


def packed(bodies: Sequence[Body]) -> Packed:
    """Convex bodies in one frame as numbers. Raises TypeError for a mesh."""
    b = len(bodies)
    kind, size = np.zeros(b, dtype=np.int64), np.zeros((b, SIZES))
    T_solid_frame, centre, reach = np.zeros((b, 4, 4)), np.zeros((b, 3)), np.zeros(b)
    planes: list[Array] = [np.zeros((0, 4))]
    for i, body in enumerate(bodies):
        solid, T = body.solid, body.T_frame_solid
        if isinstance(solid, Box):
            kind[i], size[i, :3] = BOX, 0.5 * np.array(solid.size)
            middle, reach[i] = np.zeros(3), np.linalg.norm(size[i, :3])
        elif isinstance(solid, Frustum):
            wider = solid.top - solid.bottom
            side = np.sqrt(wider * wider + solid.height * solid.height)
            kind[i] = FRUSTUM
            size[i] = solid.bottom, solid.top, solid.height, wider / side, solid.height / side, side
            middle = np.array([0.0, 0.0, 0.5 * solid.height])
            reach[i] = np.hypot(max(solid.bottom, solid.top), 0.5 * solid.height)
        elif isinstance(solid, Capsule):
            kind[i], size[i, :2] = CAPSULE, (solid.radius, 0.5 * solid.length)
            middle, reach[i] = np.zeros(3), solid.radius + 0.5 * solid.length
        elif isinstance(solid, Hull):
            own = solid.planes
            kind[i], size[i, :2] = HULL, (sum(map(len, planes)), len(own))
            planes.append(own)
            middle = 0.5 * (solid.vertices.min(axis=0) + solid.vertices.max(axis=0))
            reach[i] = np.linalg.norm(solid.vertices - middle, axis=1).max()
        else:
            raise TypeError(f"{body.name} is not convex")
        T_solid_frame[i] = np.linalg.inv(T)
        centre[i] = T[:3, :3] @ middle + T[:3, 3]
    return Packed(kind, size, np.concatenate(planes), T_solid_frame, centre, reach)


def triangles_of(solid: Solid) -> tuple[Array, Ints]:
    """Vertices (n, 3) and triangles (m, 3) of a solid's surface, counter-clockwise seen from outside.

    Round surfaces become facets with their corners on the surface; between these they are inside it by at most 0.2 % of
    the radius around an axis, and 1.1 % on the ends of capsules.
    """
    if isinstance(solid, Mesh):
        return solid.vertices, solid.triangles
    if isinstance(solid, Hull):
        return solid.facets
    if isinstance(solid, Box):
        corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        return Hull(corners * np.array(solid.size)).facets
    angle = np.arange(_AROUND) * 2.0 * np.pi / _AROUND
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_AROUND)])
    if isinstance(solid, Frustum):
        rings = [(solid.bottom, 0.0), (solid.top, solid.height)]
    else:
        down = np.linspace(-0.5, 0.5, 13) * np.pi
        shift = np.where(np.arange(13) < 6, -0.5, 0.5) * solid.length
        rings = list(zip(solid.radius * np.cos(down), solid.radius * np.sin(down) + shift, strict=True))
        rings.insert(6, (solid.radius, -0.5 * solid.length))
    return _turned([(float(r), float(z)) for r, z in rings], circle)


def _turned(rings: Sequence[tuple[float, float]], circle: Array) -> tuple[Array, Ints]:
    """Triangles of a solid of revolution from its rings (radius, height), lowest first, and a circle (n, 3)."""
    n = len(circle)
    points = [radius * circle + [0.0, 0.0, z] for radius, z in rings]
    vertices = np.vstack([*points, [[0.0, 0.0, rings[0][1]], [0.0, 0.0, rings[-1][1]]]])
    own = np.arange(n)
    after = (own + 1) % n
    triangles = []
    for k in range(len(rings) - 1):
        a, b = k * n, (k + 1) * n
        triangles += [
            np.column_stack([a + own, a + after, b + after]),
            np.column_stack([a + own, b + after, b + own]),
        ]
    last = (len(rings) - 1) * n
    bottom, top = np.full(n, len(vertices) - 2), np.full(n, len(vertices) - 1)
    triangles += [np.column_stack([bottom, after, own]), np.column_stack([top, last + own, last + after])]
    return vertices, np.concatenate(triangles)
