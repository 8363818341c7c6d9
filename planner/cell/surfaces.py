"""Surfaces for pictures: triangles with normals and colours, made from the solids and meshes of robots (metres).

Nothing is planned or checked with them: see `planner.cell.solids` for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.cell.solids import Box, Capsule, ConvexSolid, Frustum, Mesh, Solid, triangles_of

CREASE = np.cos(np.radians(38.0))  # cosine of 38°: where facets meet at a greater angle, their edge stays sharp
_ROUND = 0.28  # × the smallest half side or radius: how far edges are rounded
_MOST_ROUND = 12e-3  # m
_STEPS = 2  # facets of a rounded edge
_AROUND = 32  # corners of a circle


@dataclass(frozen=True)
class TriangleSurface(ReadOnlyArrays):
    """Triangles of a surface, counter-clockwise seen from outside.

    vertices (n, 3) [m]; normals (n, 3) of unit length; triangles (m, 3) indices of vertices; colours (n, 3) 8-bit RGB
    """

    vertices: Array
    normals: Array
    triangles: Ints
    colours: NDArray[np.uint8]

    def moved(self, T: Array) -> TriangleSurface:
        """The same surface, moved by a rigid transform (4, 4)."""
        turn = T[:3, :3]
        return TriangleSurface(self.vertices @ turn.T + T[:3, 3], self.normals @ turn.T, self.triangles, self.colours)


def rgb(colour: str) -> NDArray[np.uint8]:
    """The bytes (3) of a colour such as #f47a20."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], dtype=np.uint8)


def joined(surfaces: Sequence[TriangleSurface]) -> TriangleSurface:
    """Several surfaces as one."""
    first = np.cumsum([0, *(len(each.vertices) for each in surfaces)])
    return TriangleSurface(
        np.concatenate([each.vertices for each in surfaces]),
        np.concatenate([each.normals for each in surfaces]),
        np.concatenate([each.triangles + at for each, at in zip(surfaces, first, strict=False)]),
        np.concatenate([each.colours for each in surfaces]),
    )


def solid_surface(solid: Solid, colour: str) -> TriangleSurface:
    """A solid's surface, with the edges of boxes and cylinders slightly rounded: never outside the solid."""
    if isinstance(solid, Box):
        vertices, normals, triangles = _rounded_box(np.asarray(solid.size))
    elif isinstance(solid, Frustum):
        vertices, normals, triangles = _turned(_rounded_profile(solid))
    elif isinstance(solid, Capsule):
        down = np.linspace(-0.5, 0.5, 12) * np.pi
        middle = np.where(down < 0.0, -0.5, 0.5) * solid.length
        vertices, normals, triangles = _turned(
            np.column_stack([solid.radius * np.cos(down), solid.radius * np.sin(down) + middle])
        )
    else:
        return creased(*triangles_of(solid), np.tile(rgb(colour), (len(triangles_of(solid)[1]), 1)))
    return TriangleSurface(vertices, normals, triangles, np.tile(rgb(colour), (len(vertices), 1)))


def rounding(solid: ConvexSolid | Mesh) -> float:
    """How far the edges of a box or a cylinder are rounded [m]."""
    if isinstance(solid, Box):
        return min(_ROUND * 0.5 * min(solid.size), _MOST_ROUND)
    if isinstance(solid, Frustum):
        return min(_ROUND * min(solid.bottom, solid.top, 0.5 * solid.height), _MOST_ROUND)
    return 0.0


def creased(vertices: Array, triangles: Ints, colours: NDArray[np.uint8]) -> TriangleSurface:
    """The surface of vertices (n, 3) and triangles (m, 3), its normals smooth except where facets meet at an angle.

    colours (m, 3): of the triangles
    """
    corners = vertices[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    there = area > 0.0
    triangles, across, colours = triangles[there], across[there], colours[there]
    facing = across / area[there, None]
    # each corner takes the mean normal of the facets around its vertex that face nearly the same way as its own
    vertex, facet = triangles.ravel(), np.repeat(np.arange(len(triangles)), 3)
    order = np.argsort(vertex, kind="stable")
    first = np.searchsorted(vertex[order], np.arange(len(vertices) + 1))
    many = np.diff(first)[vertex]
    mine = np.repeat(np.arange(len(vertex)), many)
    within = np.arange(len(mine)) - np.repeat(np.cumsum(many) - many, many)
    other = facet[order][first[vertex[mine]] + within]
    alike = np.einsum("ij,ij->i", facing[facet[mine]], facing[other]) > CREASE
    normal = np.zeros((len(vertex), 3))
    np.add.at(normal, mine[alike], across[other[alike]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    colour = np.repeat(colours, 3, axis=0)
    # corners that agree are merged again
    keys = np.column_stack([vertex, np.round(normal * 64.0).astype(np.int64), colour])
    _, kept, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return TriangleSurface(vertices[vertex[kept]], normal[kept], index.reshape(-1, 3), colour[kept])


def decimated(vertices: Array, triangles: Ints, step: float) -> tuple[Array, Ints, Ints]:
    """Thin out vertices (n, 3) and triangles (m, 3): each cell of a grid `step` wide [m] keeps its middlemost vertex.

    Surfaces in the same cell that face another way, or belong to another piece, keep one of their own, so that thin
    walls keep both sides.
    Returns vertices, triangles, and for each triangle the index of the one it was. Errors are below a cell's diagonal.
    """
    corners = vertices[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.column_stack(
        [np.bincount(triangles.ravel(), np.repeat(across[:, k], 3), len(vertices)) for k in range(3)]
    )
    side = np.abs(facing).argmax(axis=1)
    side = 2 * side + (facing[np.arange(len(side)), side] > 0.0)
    edges = coo_matrix(
        (np.ones(triangles.size), (triangles.ravel(), np.roll(triangles, 1, axis=1).ravel())), [len(vertices)] * 2
    )
    piece = connected_components(edges, directed=False)[1]
    cell = np.floor((vertices - vertices.min(axis=0)) / step).astype(np.int64)
    _, index, count = np.unique(np.column_stack([cell, side, piece]), axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    middle = np.column_stack([np.bincount(index, vertices[:, k]) for k in range(3)]) / count[:, None]
    off = np.linalg.norm(vertices - middle[index], axis=1)
    order = np.lexsort((off, index))
    stays = order[np.searchsorted(index[order], np.arange(len(middle)))]
    moved = index[triangles]
    kept = np.flatnonzero((moved != np.roll(moved, 1, axis=1)).all(axis=1))
    _, once = np.unique(np.sort(moved[kept], axis=1), axis=0, return_index=True)
    kept = kept[np.sort(once)]
    return vertices[stays], moved[kept], kept


def _rounded_box(size: Array) -> tuple[Array, Array, Ints]:
    """A box about the origin with rounded edges: a ball cut into eight parts that are pulled apart."""
    radius = min(_ROUND * 0.5 * float(size.min()), _MOST_ROUND)
    side = np.concatenate([np.linspace(-1.0, 0.0, _STEPS + 1), np.linspace(0.0, 1.0, _STEPS + 1)])
    half = np.repeat([-1.0, 1.0], _STEPS + 1)
    n = len(side)
    points: list[Array] = []
    normals: list[Array] = []
    triangles: list[Ints] = []
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    for k in range(3):
        for sign in (-1.0, 1.0):
            u, v = np.meshgrid(np.tan(side * np.pi / 4), np.tan(side * np.pi / 4), indexing="ij")
            out = np.stack([np.full_like(u, sign), u, v], axis=-1).reshape(-1, 3)
            out /= np.linalg.norm(out, axis=1)[:, None]
            where = np.stack([np.full((n, n), sign), *np.meshgrid(half, half, indexing="ij")], axis=-1).reshape(-1, 3)
            out, where = np.roll(out, k, axis=1), np.roll(where, k, axis=1)
            squares = np.vstack(
                [
                    np.column_stack([corner, corner + n, corner + n + 1]),
                    np.column_stack([corner, corner + n + 1, corner + 1]),
                ]
            )
            triangles.append((squares if sign > 0.0 else squares[:, ::-1]) + n * n * len(points))
            points.append(where * (0.5 * size - radius) + radius * out)
            normals.append(out)
    return np.concatenate(points), np.concatenate(normals), np.concatenate(triangles)


def _rounded_profile(solid: Frustum) -> Array:
    """Radius and height (n, 2) of a cylinder's or cone's outline, its edges rounded, from bottom to top centre."""
    radius = rounding(solid)
    turn = np.linspace(0.0, 0.5 * np.pi, _STEPS + 1)
    low = np.column_stack([solid.bottom - radius + radius * np.sin(turn), radius - radius * np.cos(turn)])
    high = np.column_stack([solid.top - radius + radius * np.cos(turn), solid.height - radius + radius * np.sin(turn)])
    return np.vstack([[0.0, 0.0], low, high, [0.0, solid.height]])


def _turned(profile: Array) -> tuple[Array, Array, Ints]:
    """A profile of radii and heights (n, 2) turned about z; its normals are smooth where it is rounded."""
    d = np.diff(profile, axis=0)
    length = np.linalg.norm(d, axis=1)
    d, profile = d[length > 0.0], np.vstack([profile[:1], profile[1:][length > 0.0]])
    out = np.column_stack([d[:, 1], -d[:, 0]]) / np.linalg.norm(d, axis=1)[:, None]
    before, after = np.vstack([out[:1], out]), np.vstack([out, out[-1:]])
    smooth = np.einsum("ij,ij->i", before, after) > CREASE
    mean = before + after
    mean /= np.linalg.norm(mean, axis=1)[:, None]
    begin, end = np.where(smooth[:, None], mean, after)[:-1], np.where(smooth[:, None], mean, before)[1:]
    a = np.linspace(0.0, 2.0 * np.pi, _AROUND + 1)
    around = np.column_stack([np.cos(a), np.sin(a)])
    own, n = np.arange(_AROUND), _AROUND + 1
    points, normals, triangles = [], [], []
    for k in range(len(d)):
        for (radius, height), (outward, up) in ((profile[k], begin[k]), (profile[k + 1], end[k])):
            points.append(np.column_stack([radius * around, np.full(n, height)]))
            normals.append(np.column_stack([outward * around, np.full(n, up)]))
        low, high = 2 * k * n + own, (2 * k + 1) * n + own
        if profile[k + 1, 0] > 0.0:
            triangles.append(np.column_stack([low, high + 1, high]))
        if profile[k, 0] > 0.0:
            triangles.append(np.column_stack([low, low + 1, high + 1]))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(triangles)
