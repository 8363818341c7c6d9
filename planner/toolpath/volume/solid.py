"""A closed mesh and its sections by curved layers: the mesh is bent so that layers become level, then cut by planes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.readonly import Array, Ints, ReadOnlyArrays

MOST_FACETS = 2_000_000  # once they are
_DECIMALS = 9  # of a metre: corners that are one corner differ by rounding, once the file is turned
_AREA = 1e-12  # m^2: an outline around less is none


class NotClosed(ValueError):
    """A body with a hole in its skin, or with skins that meet in one edge, at `place` (3) [m]."""

    def __init__(self, place: Array) -> None:
        self.place = place
        super().__init__("the mesh is not closed")


class TooFine(ValueError):
    """More facets than can be cut."""


@dataclass(frozen=True)
class Solid(ReadOnlyArrays):
    """A closed body: vertices (n, 3) [m], part frame, and facets (m, 3), counter-clockwise seen from outside."""

    vertices: Array
    facets: Ints

    @classmethod
    def of(cls, corners: Array) -> Solid:
        """The body with facets (m, 3, 3). Raises NotClosed where an edge has not exactly one facet to either side."""
        vertices, number = np.unique(np.round(corners.reshape(-1, 3), _DECIMALS), axis=0, return_inverse=True)
        facets = number.reshape(-1, 3).astype(np.int64)
        edges = np.stack([facets, np.roll(facets, -1, axis=1)], axis=-1).reshape(-1, 2)
        key = edges[:, 0] * len(vertices) + edges[:, 1]
        back = edges[:, 1] * len(vertices) + edges[:, 0]
        once, count = np.unique(key, return_counts=True)
        alone = ~np.isin(back, key) | (count[np.searchsorted(once, key)] > 1)
        if alone.any():
            raise NotClosed(vertices[edges[np.argmax(alone)]].mean(axis=0))
        return cls(vertices, facets)

    @property
    def volume(self) -> float:
        """What it holds [m^3]."""
        a, b, c = (self.vertices[self.facets[:, k]] for k in range(3))
        return float((a * np.cross(b, c)).sum() / 6.0)

    def finer(self, longest: float) -> Solid:
        """The same body with edges halved until none is longer than `longest` [m] in the plane.

        Raises TooFine where that would take too many facets.
        """
        solid = self
        while len(solid.facets) <= MOST_FACETS:
            finer = solid._halved(longest)
            if finer is solid:
                return solid
            solid = finer
        raise TooFine(f"more than {MOST_FACETS} facets")

    def _halved(self, longest: float) -> Solid:
        """Every edge longer than `longest` [m] in the plane cut in its middle, and facets as its halves ask; itself if none."""
        edges = np.sort(np.stack([self.facets, np.roll(self.facets, -1, axis=1)], axis=-1), axis=2)
        once, number = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
        ends = self.vertices[once]
        long = np.linalg.norm((ends[:, 1] - ends[:, 0])[:, :2], axis=1) > longest
        if not long.any():
            return self
        middle = (len(self.vertices) + np.cumsum(long) - 1)[number].reshape(-1, 3)
        cut = long[number].reshape(-1, 3)
        count = cut.sum(axis=1)
        # Turned so that the cut edges come first: ab of one, ab and bc of two.
        first = np.where(count == 2, (np.argmin(cut, axis=1) + 1) % 3, np.argmax(cut, axis=1))
        turn = (first[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(self.facets, turn, axis=1).T
        ab, bc, ca = np.take_along_axis(middle, turn, axis=1).T
        pieces = {
            0: ((a, b, c),),
            1: ((a, ab, c), (ab, b, c)),
            2: ((ab, b, bc), (a, ab, bc), (a, bc, c)),
            3: ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)),
        }
        facets = [np.column_stack(each)[count == k] for k, many in pieces.items() for each in many]
        return Solid(np.vstack([self.vertices, ends[long].mean(axis=1)]), np.concatenate(facets))

    def section(self, heights: Array, level: float) -> shapely.MultiPolygon:
        """The region in the plane that belongs to the body where the vertices' `heights` (n) come to `level`."""
        return _region(list(self._outlines(heights, level)))

    def _outlines(self, heights: Array, level: float) -> Iterator[Array]:
        """Closed outlines (k, 2) of that region, x and y."""
        above = heights >= level
        corner_above = above[self.facets]
        cut = np.flatnonzero(corner_above.any(axis=1) & ~corner_above.all(axis=1))
        facets, up = self.facets[cut], corner_above[cut]
        following = np.roll(up, -1, axis=1)
        n = np.int64(len(self.vertices))

        def crossing(where: NDArray[np.bool_]) -> tuple[Ints, Array]:
            """Of the one edge a facet is crossed at: a number that both its facets know it by, and the place (2)."""
            k = np.argmax(where, axis=1)
            row = np.arange(len(facets))
            ends = np.sort(np.column_stack([facets[row, k], facets[row, (k + 1) % 3]]), axis=1)
            a, b = heights[ends[:, 0]], heights[ends[:, 1]]
            t = ((level - a) / (b - a))[:, None]
            places = (1.0 - t) * self.vertices[ends[:, 0], :2] + t * self.vertices[ends[:, 1], :2]
            return ends[:, 0] * n + ends[:, 1], places

        enter, _ = crossing(up & ~following)
        leave, places = crossing(~up & following)
        follows = dict(zip(enter.tolist(), range(len(enter)), strict=True))
        left = leave.tolist()
        done = np.zeros(len(cut), dtype=bool)
        for first in range(len(cut)):
            loop = []
            k = first
            while not done[k]:
                done[k] = True
                loop.append(k)
                k = follows[left[k]]
            if len(loop) > 2:
                yield places[loop]


def _region(outlines: list[Array]) -> shapely.MultiPolygon:
    """What outlines enclose, counted even and odd, so that it does not matter which way they run."""
    whole: shapely.Geometry = shapely.MultiPolygon()
    rings = [polygons(shapely.make_valid(shapely.Polygon(outline))) for outline in outlines]
    for ring in sorted(rings, key=lambda ring: -ring.area):
        if ring.area > _AREA:
            whole = whole.symmetric_difference(ring)
    return polygons(whole)


def polygons(found: shapely.Geometry) -> shapely.MultiPolygon:
    """The areas of what an operation gave, without its lines and points."""
    parts = shapely.get_parts(found, return_index=False)
    flat = [inner for part in parts for inner in shapely.get_parts(part)]
    return shapely.MultiPolygon([part for part in flat if isinstance(part, shapely.Polygon) and part.area > _AREA])
