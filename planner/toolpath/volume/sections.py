"""A closed mesh, and its sections by layers that morph from one surface into another.

Layer k is lower + k * thickness, over x and y. The thickness divides the gap between the two surfaces evenly, but never
falls below a bound: where it is held there, layers run parallel to the lower surface and end where they reach the upper
one. Alternatively, layers are levels of the harmonic field between the lower surface and the last of those layers,
stored as departures from the even share. For slicing, the mesh is bent so that layers become level planes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.toolpath.substrate.mesh_surface import FacetTree, HeightField, LastTrees, fit
from planner.toolpath.substrate.mesh_top import MeshTop
from planner.toolpath.volume.harmonic import POWERS, departures, harmonic_departures

Heights = Callable[[Array], Array]  # of places x, y (n, 2): z (n) [m]
_BEND = 0.2  # share of the range from least to greatest height over which the thickness eases into the least
_KNOTS = 40  # of the layers' surfaces, along the longer side
_BRICKS = 60  # of the harmonic field, along the longer side
_MOST_BRICKS = 120  # likewise, margin included
_BESIDE = 1.5  # × the greatest height: margin of the field; its sides then still have an effect of a hundredth
_ROUNDS = 40  # of the iteration for a level of the field: the closer that is to an even share, the faster it converges
_SAMPLES = 3  # of the surfaces, from knot to knot
_PITCH = 1e-3  # m between corners of the facets that represent printed layers
_MOST_PITCHES = 300  # along the longer side
_WHOLE = 1e-6  # layers: up to this much above a whole number counts as that number

MOST_FACETS = 2_000_000  # after halving of edges
_DECIMALS = 9  # of a metre: identical corners differ by rounding after the file is turned
_TINY = 1e-30  # m
_SAME_ANGLE = 6  # decimals of a radian to which facets of two touching bodies agree
_HAIR = 1e-8  # m between bodies that touch
_AREA = 1e-12  # m^2: outlines around less are ignored


@dataclass(frozen=True)
class Morph:
    """A stack of `count` layers: the k-th begins at lower + k * thickness [m], both with the same knots.

    off  factors of `departures` (k / count) that are added, likewise; none if layers divide the height evenly
    """

    lower: HeightField
    thickness: HeightField
    count: float = 1.0
    off: tuple[HeightField, ...] = ()

    @classmethod
    def between(
        cls, lower: Heights, upper: Heights, greatest: float, least: float, room: float, low: Array, high: Array
    ) -> Morph:
        """Layers at most `greatest` and at least `least` high [m], over the rectangle from low (2) to high (2).

        room  greatest height of the upper surface above the lower one [m]
        """
        count = np.ceil(room / greatest - _WHOLE)
        step = float((high - low).max()) / _KNOTS
        cells = np.ceil((high - low) / step - 1e-9)
        axes = [np.linspace(a, a + n * step, int(n) * _SAMPLES + 1) for a, n in zip(low, cells, strict=True)]
        plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        base = lower(plane)
        share = (upper(plane) - base) / count
        high_enough = least + _ramp(share - least, _BEND * (greatest - least))
        weights = np.ones(len(plane))
        end = low + cells * step
        fields = [fit(np.column_stack([plane, z]), weights, low, end, step) for z in (base, high_enough)]
        return cls(fields[0], fields[1], float(count))

    def harmonic(self) -> Morph:
        """The levels of the harmonic field between the first and the last of these layers.

        Beyond their rectangle these continue straight, far enough for the sides of the field not to matter.
        """
        low, high = self.lower.span
        thickest = float(self.thickness.coefficients.max())
        beside = _BESIDE * self.count * thickest
        longest = float((high - low).max())
        pitch = max(longest / _BRICKS, (longest + 2.0 * beside) / _MOST_BRICKS)
        axes = [
            np.arange(a - np.ceil(beside / pitch) * pitch, b + beside + pitch, pitch)
            for a, b in zip(low, high, strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        plane = grid.reshape(-1, 2)
        first, thickness = (_straight_on(surface, plane) for surface in (self.lower, self.thickness))
        least = self.thickness.at(plane)[0][:, 2].min()
        last = first + self.count * np.maximum(thickness, least)
        shape = grid.shape[:2]
        factors = harmonic_departures(first.reshape(shape), last.reshape(shape), pitch).reshape(-1, POWERS)
        within = ((plane >= low - 0.01 * pitch) & (plane <= high + 0.01 * pitch)).all(axis=1)
        ones = np.ones(int(within.sum()))
        off = [fit(np.column_stack([plane, z])[within], ones, low, high, self.lower.step) for z in factors.T]
        return replace(self, off=tuple(off))

    def field(self, level: float) -> HeightField:
        """The surface `level` layers up."""
        heights = self.lower.coefficients + level * self.thickness.coefficients
        return self._with(heights, self._departures(level))

    def layer(self, level: float) -> HeightField:
        """The height of the layer that ends `level` layers up."""
        return self._with(self.thickness.coefficients, self._departures(level) - self._departures(level - 1.0))

    def _departures(self, level: float) -> Array:
        return departures(np.clip(np.array(level / self.count), 0.0, 1.0))[: len(self.off)]

    def _with(self, heights: Array, factors: Array) -> HeightField:
        """Heights plus the departures with these factors."""
        for factor, surface in zip(factors.tolist(), self.off, strict=True):
            heights = heights + factor * surface.coefficients
        return HeightField(self.lower.corner, self.lower.step, heights)

    def levels(self, points: Array) -> Array:
        """How many layers up points (n, 3) are."""
        lower, thickness = (surface.at(points[:, :2])[0][:, 2] for surface in (self.lower, self.thickness))
        even = (points[:, 2] - lower) / thickness
        if not self.off:
            return np.asarray(even)
        off = np.column_stack([surface.at(points[:, :2])[0][:, 2] for surface in self.off]) / thickness[:, None]
        found = even
        for _ in range(_ROUNDS):
            found = even - (off * departures(np.clip(found / self.count, 0.0, 1.0))).sum(axis=1)
        return np.asarray(found)

    def heights(self, plane: Array, level: Array) -> Array:
        """Heights (n) at x, y (n, 2) of the surfaces `level` (n) layers up [m]."""
        lower, thickness = (surface.at(plane)[0][:, 2] for surface in (self.lower, self.thickness))
        out = lower + level * thickness
        for factor, surface in zip(departures(np.clip(level / self.count, 0.0, 1.0)).T, self.off, strict=False):
            out += factor * surface.at(plane)[0][:, 2]
        return np.asarray(out)

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3) of the surfaces that run through points (n, 3)."""
        slopes = []
        for surface in (self.lower, self.thickness, *self.off):
            n = surface.at(points[:, :2])[1]
            slopes.append(n[:, :2] / n[:, 2:])
        level = self.levels(points)
        across = slopes[0] + level[:, None] * slopes[1]
        for factor, slope in zip(departures(np.clip(level / self.count, 0.0, 1.0)).T, slopes[2:], strict=False):
            across = across + factor[:, None] * slope
        normals = np.column_stack([across, np.ones(len(points))])
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def _straight_on(surface: HeightField, plane: Array) -> Array:
    """Heights (n) [m] of a surface at x, y (n, 2); outside its rectangle, straight on from the nearest place in it."""
    held = np.clip(plane, *surface.span)
    points, normals = surface.at(held)
    return np.asarray(points[:, 2] - ((plane - held) * normals[:, :2]).sum(axis=1) / normals[:, 2])


def _ramp(x: Array, reach: float) -> Array:
    """The greater of x and 0, rounded within `reach` of 0, with three continuous derivatives."""
    t = np.clip((x + reach) / (2.0 * reach), 0.0, 1.0)
    return np.where(x >= reach, x, 2.0 * reach * t**4 * (2.5 - 3.0 * t + t**2))


@dataclass(frozen=True)
class MorphedLayers:
    """The base, and the layers as they are printed, solid down to the bed (metres, part frame).

    base     the surface at which the layers begin, if it is a mesh
    regions  regions of the layers in the plane
    layers   of all beads in print order
    solid    how many layers are already there
    grown    their upper side as facets, computed on request
    tops     the number of layers last requested, and the heights of their upper side on the grid of these facets
    """

    morph: Morph
    base: MeshTop | None
    regions: tuple[shapely.MultiPolygon, ...]
    layers: tuple[int, ...]
    solid: int = 0
    grown: LastTrees = field(default_factory=LastTrees, compare=False)
    tops: list[tuple[int, Array]] = field(default_factory=list, compare=False)

    def before(self, bead: int) -> MorphedLayers:
        """The surface after the first `bead` beads, without the layer of the last of them."""
        return replace(self, solid=self.layers[bead - 1] if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from bed, base and layers; negative inside."""
        nearest = points[:, 2].copy()
        if self.base is not None:
            nearest = np.minimum(nearest, self.base.signed_distance(points))
        grown = self._grown()
        if grown is None:
            return nearest
        top, _ = grown.top(points[:, :2])
        return np.asarray(np.minimum(nearest, np.where(points[:, 2] < top, -1.0, 1.0) * grown.distance(points)))

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3) of the layer surfaces through points (n, 3), or of the first or last of all."""
        held = points.copy()
        level = np.clip(self.morph.levels(points), 0.0, len(self.regions))
        held[:, 2] = self.morph.heights(points[:, :2], level)
        return self.morph.normals(held)

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Upward unit normals (n, 3) of the bead's layer, above or below the tips (n, 3)."""
        return self.morph.field(self.layers[bead] + 1).at(tips[:, :2])[1]

    def _grown(self) -> FacetTree | None:
        return self.grown.of(self.solid, self._facets) if self.solid else None

    def _facets(self) -> FacetTree | None:
        """Facets over a grid, at the top of the uppermost layer that covers its corners."""
        low, high = self.morph.lower.span
        pitch = max(_PITCH, float((high - low).max()) / _MOST_PITCHES)
        axes = [np.arange(a, b, pitch) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        plane = grid.reshape(-1, 2)
        known, top = self.tops[0] if self.tops else (0, np.full(len(plane), np.nan))
        if known > self.solid:
            known, top = 0, np.full(len(plane), np.nan)
        top = top.copy()
        for layer, region in enumerate(self.regions[known : self.solid], known):
            there = shapely.contains_xy(region, plane[:, 0], plane[:, 1]).reshape(grid.shape[:2])
            covered = binary_dilation(there).ravel()  # so that the rim is not cut off
            top[covered] = self.morph.field(layer + 1).at(plane[covered])[0][:, 2]
        self.tops[:] = [(self.solid, top)]  # beads are requested in print order: the next call continues from here
        return FacetTree.over(np.column_stack([plane, top]).reshape(*grid.shape[:2], 3))


class NotClosed(ValueError):
    """A body with a hole in its skin, or two facets that face opposite ways at an edge, at `place` (3) [m]."""

    def __init__(self, place: Array, opposite: bool) -> None:
        self.place, self.opposite = place, opposite
        super().__init__("the mesh is not closed")


def _sides_that_meet(vertices: Array, facets: Ints) -> tuple[Ints, Ints]:
    """Pairs of facet sides that form one edge of a body's skin; a side's number is 3 * facet + the corner it begins at.

    Where more than two meet, as where bodies touch, those with material between them are paired. Raises NotClosed.
    """
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=-1).reshape(-1, 2)
    forward = ends[:, 0] < ends[:, 1]
    key = ends.min(axis=1) * len(vertices) + ends.max(axis=1)
    ahead, back = np.flatnonzero(forward), np.flatnonzero(~forward)
    ahead, back = ahead[np.argsort(key[ahead], kind="stable")], back[np.argsort(key[back], kind="stable")]
    if len(ahead) != len(back) or (key[ahead] != key[back]).any():
        once, count = np.unique(key, return_counts=True)
        balance = np.bincount(np.searchsorted(once, key), np.where(forward, 1.0, -1.0))
        worst = int(np.argmax(np.where(balance != 0.0, 1 + (count % 2), 0)))  # holes before facets that face away
        ends_of = [once[worst] // len(vertices), once[worst] % len(vertices)]
        raise NotClosed(vertices[ends_of].mean(axis=0), bool(count[worst] % 2 == 0))
    first = np.flatnonzero(np.diff(key[ahead], prepend=-1))
    count = np.diff(first, append=len(ahead))
    for start, n in zip(first[count > 1].tolist(), count[count > 1].tolist(), strict=True):
        run = slice(start, start + n)
        back[run] = _with_material_between(vertices, facets, ahead[run], back[run])
    return ahead, back


def _with_material_between(vertices: Array, facets: Ints, ahead: Ints, back: Ints) -> Ints:
    """For each side (n) that runs ahead along an edge, the one (n) running back with which it bounds material."""
    foot, head = vertices[facets.ravel()[ahead[0]]], vertices[facets.ravel()[back[0]]]
    along = (head - foot) / np.linalg.norm(head - foot)
    sides = np.concatenate([ahead, back])
    wing = vertices[facets[sides // 3, (sides + 2) % 3]] - foot
    wing = wing - (wing @ along)[:, None] * along
    across = np.linalg.norm(wing, axis=1)
    widest = int(np.argmax(across))  # a facet without an area has no direction
    x = wing[widest] / max(float(across[widest]), _TINY)
    angle = np.round(np.arctan2(wing @ np.cross(along, x), wing @ x), _SAME_ANGLE)
    # around the edge material begins at a side that runs back, and ends at the next that runs ahead
    order = np.lexsort((np.arange(len(sides)) >= len(ahead), angle))
    order = np.concatenate([order, order])
    open_sides: list[int] = []
    partner: dict[int, int] = {}
    for i in order.tolist():
        if i >= len(ahead):
            if i not in open_sides and i not in partner.values():
                open_sides.append(i)
        elif i not in partner and open_sides:
            partner[i] = open_sides.pop()
    return np.array([back[partner[i] - len(ahead)] for i in range(len(ahead))])


class TooFine(ValueError):
    """More facets than can be cut."""


@dataclass(frozen=True)
class Solid(ReadOnlyArrays):
    """A closed body: vertices (n, 3) [m], part frame, and facets (m, 3), counter-clockwise seen from outside."""

    vertices: Array
    facets: Ints

    @classmethod
    def of(cls, corners: Array) -> Solid:
        """The body with facets (m, 3, 3), or several that may touch: where they do, each keeps vertices of its own.

        Raises NotClosed where an edge has more facets on one side than on the other.
        """
        vertices, number = np.unique(np.round(corners.reshape(-1, 3), _DECIMALS), axis=0, return_inverse=True)
        facets = number.reshape(-1, 3).astype(np.int64)
        facets = facets[(facets != np.roll(facets, 1, axis=1)).all(axis=1)]
        one, other = _sides_that_meet(vertices, facets)
        # corners that belong together: where a side begins, the other one ends
        after_one, after_other = one - one % 3 + (one + 1) % 3, other - other % 3 + (other + 1) % 3
        row, column = np.concatenate([one, after_one]), np.concatenate([after_other, other])
        joined = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(facets.size, facets.size))
        _, fan = connected_components(joined, directed=False)
        own, number = np.unique(np.column_stack([facets.ravel(), fan]), axis=0, return_inverse=True)
        return cls(vertices[own[:, 0]], number.reshape(-1, 3).astype(np.int64))

    @property
    def volume(self) -> float:
        """Its volume [m^3]."""
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
        """The body with edges longer than `longest` [m] in the plane halved, facets split to match; itself if none."""
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
        """The region in the plane within the body where the vertices' `heights` (n), interpolated, equal `level`."""
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
            """For the edge at which a facet is crossed: a number shared by both its facets, and the place (2)."""
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
    """The region that outlines enclose: the union of overlapping bodies, without their holes where no other body is.

    Outlines of holes run the other way round.
    """
    rings = [(polygons(shapely.make_valid(shapely.Polygon(outline))), _turns_left(outline)) for outline in outlines]
    covered: list[shapely.Geometry] = [shapely.MultiPolygon()]  # by one body at least, by two at least, ...
    for ring, outer in sorted(rings, key=lambda each: -each[0].area):
        if ring.area <= _AREA:
            continue
        if not outer and covered[0].intersection(ring).area > 0.5 * ring.area:
            for k in reversed(range(len(covered))):
                covered[k], ring = covered[k].difference(ring), ring.difference(covered[k])
        else:
            for k in range(len(covered)):
                covered[k], ring = covered[k].union(ring), polygons(covered[k].intersection(ring))
            if ring.area > _AREA:
                covered.append(ring)
    return _joined(polygons(covered[0]))


def _joined(region: shapely.MultiPolygon) -> shapely.MultiPolygon:
    """The same without the hairline gaps that rounding leaves between touching bodies."""
    parts = shapely.get_parts(region)
    one, other = shapely.STRtree(parts).query(parts, predicate="dwithin", distance=_HAIR)
    if (one == other).all():
        return region
    return polygons(region.buffer(_HAIR, join_style="mitre").buffer(-_HAIR, join_style="mitre"))


def _turns_left(outline: Array) -> bool:
    """Whether an outline (k, 2) runs counter-clockwise."""
    x, y = outline.T
    return bool((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0.0)


def polygons(found: shapely.Geometry) -> shapely.MultiPolygon:
    """The polygons in the result of an operation, without its lines and points."""
    parts = shapely.get_parts(found, return_index=False)
    flat = [inner for part in parts for inner in shapely.get_parts(part)]
    return shapely.MultiPolygon([part for part in flat if isinstance(part, shapely.Polygon) and part.area > _AREA])
