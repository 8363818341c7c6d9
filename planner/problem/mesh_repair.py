"""Repairs of facets that do not form a surface or a body, within bounds, and reported.

Defects are facets wound the other way than their neighbours, slits, and small holes.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints, ReadOnlyArrays

_SAME = 1e-9  # m between corners that are one corner: they differ by rounding once the file is turned
_SLIT = 2e-5  # m at most between corners at the two sides of a slit: single precision, or few decimals in the file
_NO_HOLE = 5e-6  # m: anything narrower is not a hole, but an edge that lies next to its two halves


@dataclass(frozen=True)
class Hole(ReadOnlyArrays):
    """A hole in a skin, and the facets (n, 3, 3) [m] that close it.

    width  4 times their area over the length of the rim [m]
    place  the middle (3) of its rim [m]
    """

    facets: Array
    width: float
    place: Array

    @property
    def area(self) -> float:
        """Area of the facets that close it [m^2]."""
        return float(_areas(self.facets).sum())


@dataclass(frozen=True)
class Mended(ReadOnlyArrays):
    """Repaired facets (n, 3, 3) [m], including those that close holes, and what was done.

    turned       how many facets were reversed
    joined, gap  how many corners were merged, and how far one was moved at most [m]
    closed       holes that were closed; open: those wider than allowed, the widest first
    twisted      a place (3) where two facets face opposite ways and reversing does not help: the surface is one-sided
    """

    corners: Array
    turned: int = 0
    joined: int = 0
    gap: float = 0.0
    closed: tuple[Hole, ...] = ()
    open: tuple[Hole, ...] = ()
    twisted: Array | None = None

    @property
    def share(self) -> float:
        """Share of the surface that closes holes."""
        return sum(hole.area for hole in self.closed) / float(_areas(self.corners).sum())

    @property
    def words(self) -> str:
        """What was done, in words; empty for nothing."""
        parts = []
        if self.turned:
            parts.append(turned_words(self.turned))
        if self.joined:
            parts.append(f"{self.joined} corners brought together along slits, by {self.gap * 1e3:.4f} mm at most")
        seen = [hole for hole in self.closed if hole.width > _NO_HOLE]
        if len(seen) < len(self.closed):
            parts.append(f"{count_of(len(self.closed) - len(seen), 'edge')} joined to the halves beside it")
        if seen:
            widest = max(hole.width for hole in seen) * 1e3
            what = count_of(len(seen), "hole")
            parts.append(f"{what} closed, {widest:.3f} mm wide at most, {self.share:.2%} of its surface")
        return "; ".join(parts)


def turned_words(count: int) -> str:
    """How many facets were reversed, in the words of a note."""
    return f"{count_of(count, 'facet')} turned round to face as {'its' if count == 1 else 'their'} neighbours do"


def count_of(number: int, what: str) -> str:
    """A number and what it counts."""
    return f"1 {what}" if number == 1 else f"{number} {what}s"


def mend(corners: Array, widest: float) -> Mended:
    """Facets (n, 3, 3) [m] as the skin of a body: oriented consistently, slits and holes up to `widest` [m] closed.

    Wider ones stay open, and are reported. A hole is closed by facets between its own corners, nearest ones first.
    """
    apart = _shared(corners)
    vertices, facets, joined, gap = _joined(*apart, min(_SLIT, widest))
    facets, turned, mixed = _turned(vertices, facets, upward=False)
    twisted = _twisted(vertices, facets)
    if twisted is not None and joined:  # sheets back to back, as in a double wall, are not the sides of a slit
        vertices, joined, gap = apart[0], 0, 0.0
        facets, turned, mixed = _turned(*apart, upward=False)
        twisted = _twisted(vertices, facets)
    holes = _holes(vertices, facets)
    if turned and _volume(np.concatenate([vertices[facets], *(hole.facets for hole in holes)])) < 0.0:
        # most of them face inwards; possible only if some were reversed, as their area alone decided which
        facets = np.where(mixed[:, None], facets[:, ::-1], facets)
        turned = int(mixed.sum()) - turned
        holes = _holes(vertices, facets)
    holes.sort(key=lambda hole: -hole.width)
    closed, left = [hole for hole in holes if hole.width <= widest], [hole for hole in holes if hole.width > widest]
    found = np.concatenate([vertices[facets], *(hole.facets for hole in closed)])
    return Mended(found, turned, joined, gap, tuple(closed), tuple(left), twisted)


def facing_alike(corners: Array) -> tuple[Array, int]:
    """Facets (n, 3, 3) [m] of a surface to print on, oriented consistently, and how many were reversed.

    Connected facets face upwards on the whole, or outwards if they are closed; those that are consistent in the file
    are left as they are.
    """
    vertices, facets = _shared(corners)
    facets, turned, _ = _turned(vertices, facets, upward=True)
    return (vertices[facets], turned) if turned else (corners, 0)


def _shared(corners: Array) -> tuple[Array, Ints]:
    """Vertices (n, 3) [m] and facets (m, 3) between them, without those that shrank to a line (two equal corners)."""
    _, first, number = np.unique(
        np.round(corners.reshape(-1, 3) / _SAME), axis=0, return_index=True, return_inverse=True
    )
    return corners.reshape(-1, 3)[first], _proper(number.reshape(-1, 3).astype(np.int64))


def _proper(facets: Ints) -> Ints:
    return np.asarray(facets[(facets != np.roll(facets, 1, axis=1)).all(axis=1)])


def _edges(facets: Ints) -> tuple[Ints, Flags, Ints]:
    """For the three sides of each facet (m, 3), in order: the index of their edge (3 m), and whether they run from its
    lower vertex to the higher (3 m); and the ends of all edges (k, 2)."""
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=-1).reshape(-1, 2)
    once, number = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    return number.ravel(), ends[:, 0] < ends[:, 1], once


def _joined(vertices: Array, facets: Ints, slit: float) -> tuple[Array, Ints, int, float]:
    """Vertices and facets with corners along open edges merged if they are no farther apart than `slit` [m]; how many
    were merged, and how far one was moved at most [m]."""
    number, _, ends = _edges(facets)
    rim = np.unique(ends[np.bincount(number) % 2 == 1])
    pairs = cKDTree(vertices[rim]).query_pairs(slit, output_type="ndarray") if len(rim) else np.empty((0, 2), dtype=int)
    if not len(pairs):
        return vertices, facets, 0, 0.0
    one, other = rim[pairs].T
    graph = coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(len(vertices), len(vertices)))
    _, group = connected_components(graph, directed=False)
    size = np.bincount(group)
    middle = np.column_stack([np.bincount(group, vertices[:, k]) for k in range(3)]) / size[:, None]
    away = np.linalg.norm(middle[group] - vertices, axis=1)
    return middle, _proper(group[facets].astype(np.int64)), int((size[group] > 1).sum()), float(away.max())


def _turned(vertices: Array, facets: Ints, upward: bool) -> tuple[Ints, int, Flags]:
    """Facets (m, 3) oriented like their neighbours across edges of two facets, how many were reversed, and which are in
    an inconsistent component.

    Each facet is in a graph twice, as it is and reversed, linked to its neighbours as these then have to be. For a
    two-sided surface this makes two components: the one is taken in which more of the area stays as it is or, if
    `upward`, the one that faces upwards or, if closed, outwards. A one-sided surface is left as it is.
    """
    m = len(facets)
    number, forward, _ = _edges(facets)
    order = np.argsort(number, kind="stable")
    count = np.bincount(number)
    start = (np.cumsum(count) - count)[count == 2]
    one, other = order[start], order[start + 1]
    against = forward[one] == forward[other]
    if not against.any():
        return facets, 0, np.zeros(m, dtype=bool)
    one, other = one // 3, other // 3
    row, column = np.concatenate([one, one + m]), np.concatenate([other + m * against, other + m * ~against])
    graph = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(2 * m, 2 * m))
    groups, group = connected_components(graph, directed=False)
    as_is, reverse = group[:m], group[m:]
    mixed = np.isin(as_is, as_is[one[against]]) | np.isin(as_is, reverse[one[against]])
    mixed &= as_is != reverse
    corners = vertices[facets]
    weight = _areas(corners)
    if upward:
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
        open_here = np.zeros(groups, dtype=bool)
        rims = (count != 2)[number].reshape(-1, 3).any(axis=1)
        open_here[as_is[rims]] = open_here[reverse[rims]] = True
        weight = np.where(open_here[as_is], across, _volumes(corners))
    kept = np.bincount(as_is, weight, minlength=groups)
    one_way, other_way = kept[as_is], kept[reverse]
    turn = mixed & np.where(one_way == other_way, as_is > reverse, one_way < other_way)
    return np.where(turn[:, None], facets[:, ::-1], facets), int(turn.sum()), mixed


def _twisted(vertices: Array, facets: Ints) -> Array | None:
    """The middle (3) of an edge of two facets that face opposite ways, if there is one."""
    number, forward, ends = _edges(facets)
    ahead = np.bincount(number, forward)
    wrong = np.flatnonzero((np.bincount(number) == 2) & (ahead != 1))
    return np.asarray(vertices[ends[wrong[0]]].mean(axis=0)) if len(wrong) else None


def _holes(vertices: Array, facets: Ints) -> list[Hole]:
    """The holes in a skin, found along sides of facets without a side that runs the other way."""
    number, forward, ends = _edges(facets)
    balance = np.bincount(number, np.where(forward, 1.0, -1.0)).astype(int)
    lone = np.repeat(np.flatnonzero(balance), np.abs(balance[balance != 0]))
    ahead = (balance[lone] > 0)[:, None]
    rim = np.where(ahead, ends[lone][:, ::-1], ends[lone])  # runs opposite to the facets next to it
    return [_closed(vertices, loop) for loop in _loops(rim)]


def _loops(rim: Ints) -> list[list[int]]:
    """Rings of vertices from the ends (n, 2) of sides; at each vertex as many begin as end."""
    following: dict[int, list[int]] = {}
    for start, end in rim.tolist():
        following.setdefault(start, []).append(end)
    loops = []
    for first in list(following):
        way, place = [first], {first: 0}
        while following[way[-1]]:
            after = following[way[-1]].pop()
            if after not in place:
                place[after] = len(way)
                way.append(after)
                continue
            loop = way[place[after] :]  # a ring is complete: the path that led to it continues from there
            loops.append(loop)
            for vertex in loop[1:]:
                del place[vertex]
            del way[place[after] + 1 :]
    return loops


def _closed(vertices: Array, loop: list[int]) -> Hole:
    """A ring of vertices, closed by facets that cut off corner after corner, always the one with the shortest cut."""
    points = vertices[loop]
    n = len(loop)
    before, after = [(i - 1) % n for i in range(n)], [(i + 1) % n for i in range(n)]

    def cut(i: int) -> tuple[float, int, int, int]:
        one, other = before[i], after[i]
        return float(np.sum((points[one] - points[other]) ** 2)), i, one, other

    queue = [cut(i) for i in range(n)]
    heapq.heapify(queue)
    found: list[tuple[int, int, int]] = []
    while len(found) < n - 2:
        _, i, one, other = heapq.heappop(queue)
        if (before[i], after[i]) != (one, other):
            continue  # a neighbour has been cut off since
        found.append((one, i, other))
        after[one], before[other] = other, one
        before[i] = after[i] = -1
        heapq.heappush(queue, cut(one))
        heapq.heappush(queue, cut(other))
    facets = points[np.array(found)]
    around = float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())
    return Hole(facets, 4.0 * float(_areas(facets).sum()) / around, points.mean(axis=0))


def _areas(corners: Array) -> Array:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(across, axis=1))


def _volumes(corners: Array) -> Array:
    """Volumes (n) of the tetrahedra between facets (n, 3, 3) and a corner of one of them."""
    a, b, c = (corners - corners[0, 0]).transpose(1, 0, 2)
    return np.asarray((a * np.cross(b, c)).sum(axis=1) / 6.0)


def _volume(corners: Array) -> float:
    return float(_volumes(corners).sum())
