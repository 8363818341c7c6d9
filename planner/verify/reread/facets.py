"""Facets of a file seen from above: the heights at which vertical lines meet them, and which heights lie inside.

Heights come from the facets themselves, by areas of triangles; nothing is smoothed, and no facet is repaired. Lengths
are in metres in the part frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import InputError
from planner.base.files import stamp_of
from planner.problem.mesh_files import read_corners
from planner.problem.part import MeshSpec

if TYPE_CHECKING:
    from shapely import STRtree

_ASIDE = np.array([3.1e-8, 1.7e-8])  # m: offset of lines, so that they miss edges shared by two facets
_UPRIGHT = 1e-12  # m^2: a facet with a smaller area seen from above is a wall
_SAME = 1e-7  # m: crossings nearer than this count as one, of coinciding facets
_BLOCK = 200_000  # lines at once


@dataclass(frozen=True)
class Crossings:
    """Where lines meet facets, line by line from the lowest crossing up.

    line   (k) number of the line
    z      (k) [m]
    up     (k) 1 where the facet looks up, -1 where it looks down
    facet  (k) its number
    first  (n + 1) index of each line's first crossing
    """

    line: Ints
    z: Array
    up: Ints
    facet: Ints
    first: Ints

    def top(self) -> tuple[Array, Ints]:
        """The uppermost heights (n), NaN where there are none, and their facets (n), -1 there."""
        count = np.diff(self.first)
        last = np.where(count > 0, self.first[1:] - 1, 0)
        if not len(self.z):
            return np.full(len(count), np.nan), np.full(len(count), -1, dtype=np.int64)
        return np.where(count > 0, self.z[last], np.nan), np.where(count > 0, self.facet[last], -1)

    def inside(self, z: Array) -> tuple[Flags, Flags]:
        """Whether heights z (n), one per line, lie inside, and whether that is known (n).

        It is known for a line that enters as often as it leaves. A line that leaves before it enters reveals facets
        that face the wrong way; only there, crossings alternate between entering and leaving.
        """
        n, total = len(z), len(self.z)
        count = np.diff(self.first)
        below = self.z < z[self.line]
        depth = -np.concatenate([[0], np.cumsum(self.up)])  # bodies entered and not left, from the first line on
        within = depth[1:] - depth[self.first[self.line]]
        lowest = np.zeros(n, dtype=np.int64)
        np.minimum.at(lowest, self.line, within)
        even = depth[self.first[1:]] - depth[self.first[:-1]] == 0
        under = np.bincount(self.line[below], minlength=n) if total else np.zeros(n, dtype=np.int64)
        at = np.minimum(self.first[:-1] + under, total)
        entered = depth[at] - depth[self.first[:-1]]
        turned = (lowest < 0) | ~even
        inside = np.where(turned, under % 2 == 1, entered > 0)
        return inside, np.asarray(~turned | (count % 2 == 0))


@dataclass(frozen=True)
class Facets:
    """Facets (m, 3, 3) [m], their unit normals (m, 3), and the tree of the boxes of those (k) that are not walls."""

    corners: Array
    normals: Array
    tree: STRtree
    flat: Ints

    @classmethod
    def of(cls, corners: Array) -> Facets:
        """From corners (m, 3, 3) [m], unchanged."""
        import shapely

        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(across, axis=1)
        flat = np.flatnonzero(np.abs(across[:, 2]) > 2.0 * _UPRIGHT)
        low, high = corners[flat].min(axis=1), corners[flat].max(axis=1)
        tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        return cls(corners, across / np.maximum(size, 1e-300)[:, None], tree, flat)

    def crossings(self, plane: Array) -> Crossings:
        """Where vertical lines at x, y (n, 2) meet facets."""
        found = [self._crossed(plane[k : k + _BLOCK] + _ASIDE, k) for k in range(0, len(plane), _BLOCK)]
        line, facet, z = (np.concatenate(each) for each in zip(*found, strict=True))
        order = np.lexsort((z, line))
        line, facet, z = line[order], facet[order], z[order]
        up = np.where(self.normals[facet, 2] > 0.0, 1, -1)
        again = np.zeros(len(line), dtype=bool)  # crossings of coinciding facets
        again[1:] = (line[1:] == line[:-1]) & (np.diff(z) < _SAME) & (up[1:] == up[:-1])
        line, facet, z, up = (each[~again] for each in (line, facet, z, up))
        return Crossings(line, z, up, facet, np.searchsorted(line, np.arange(len(plane) + 1)))

    def _crossed(self, plane: Array, first: int) -> tuple[Ints, Ints, Array]:
        import shapely

        line, box = self.tree.query(shapely.points(plane))
        facet = self.flat[box]
        a, b, c = (self.corners[facet, k] for k in range(3))
        p = plane[line]
        whole = _area(a, b, c)
        shares = np.stack([_area(p, b, c), _area(a, p, c), _area(a, b, p)]) / whole
        hit = (shares >= 0.0).all(axis=0)
        z = shares[0] * a[:, 2] + shares[1] * b[:, 2] + shares[2] * c[:, 2]
        return line[hit] + first, facet[hit], z[hit]

    def top(self, plane: Array) -> tuple[Array, Array]:
        """Heights (n) of the uppermost facets at x, y (n, 2), NaN for none, and their unit normals (n, 3)."""
        z, facet = self.crossings(plane).top()
        return z, self.normals[facet]


def _area(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed areas (n) of triangles in the plane."""
    return np.asarray((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))


def facets_of(spec: MeshSpec) -> Facets:
    """The facets of a file in the part frame. Raises InputError for a file that can no longer be read."""
    return _read(spec, *stamp_of(spec.file))


@lru_cache(maxsize=3)
def _read(spec: MeshSpec, changed: int, size: int) -> Facets:
    corners = read_corners(spec.file, partial(InputError, file=spec.file), spec.unit, spec.scale)
    turned = Rotation.from_euler("xyz", spec.rpy).apply(np.array(corners).reshape(-1, 3)) + np.asarray(spec.origin)
    return Facets.of(turned.reshape(-1, 3, 3))
