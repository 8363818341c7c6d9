"""What keeps facets from being a surface or a body is mended within bounds, and told: facets wound the other way than
their neighbours, slits, small holes."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints, ReadOnlyArrays

_SAME = 1e-9  # m between corners that are one corner: they differ by rounding, once the file is turned
_SLIT = 2e-5  # m between corners at a slit's two sides, at most: single precision, or a file's few decimals
_NO_HOLE = 5e-6  # m: where an edge meets two halves of it there is no hole to speak of


@dataclass(frozen=True)
class Hole(ReadOnlyArrays):
    """A hole in a skin: facets (n, 3, 3) [m] that close it, as wide as 4 times their area over its rim's length [m].

    place  the middle (3) of its rim [m]
    """

    facets: Array
    width: float
    place: Array

    @property
    def area(self) -> float:
        """Of what closes it [m^2]."""
        return float(_areas(self.facets).sum())


@dataclass(frozen=True)
class Mended(ReadOnlyArrays):
    """Facets (n, 3, 3) [m], the closing ones among them, and what was done to them.

    turned       how many facets were turned round
    joined, gap  how many corners were brought together, the farthest by so much [m]
    closed       holes that were closed; open: those that are wider than allowed, the widest first
    twisted      a place (3) where two facets face opposite ways and turning does not help, as the surface has one side only
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
        """Of its surface that closes holes."""
        return sum(hole.area for hole in self.closed) / float(_areas(self.corners).sum())

    @property
    def words(self) -> str:
        """What was done; empty for nothing."""
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
    """How many facets were turned, as a note says it."""
    return f"{count_of(count, 'facet')} turned round to face as {'its' if count == 1 else 'their'} neighbours do"


def count_of(number: int, what: str) -> str:
    """A number and what it counts."""
    return f"1 {what}" if number == 1 else f"{number} {what}s"


def mend(corners: Array, widest: float) -> Mended:
    """Facets (n, 3, 3) [m] as the skin of a body: turned as their neighbours are, slits and holes up to `widest` [m] closed.

    What is wider stays open, and is told. A hole is closed by facets between its own corners, the nearest joined first.
    """
    apart = _shared(corners)
    vertices, facets, joined, gap = _joined(*apart, min(_SLIT, widest))
    facets, turned, mixed = _turned(vertices, facets, upward=False)
    twisted = _twisted(vertices, facets)
    if twisted is not None and joined:  # sheets back to back, as of a double wall, are no slit's two sides
        vertices, joined, gap = apart[0], 0, 0.0
        facets, turned, mixed = _turned(*apart, upward=False)
        twisted = _twisted(vertices, facets)
    holes = _holes(vertices, facets)
    if turned and _volume(np.concatenate([vertices[facets], *(hole.facets for hole in holes)])) < 0.0:
        # most of them face inwards: only here, as nothing but their number told which are turned
        facets = np.where(mixed[:, None], facets[:, ::-1], facets)
        turned = int(mixed.sum()) - turned
        holes = _holes(vertices, facets)
    holes.sort(key=lambda hole: -hole.width)
    closed, left = [hole for hole in holes if hole.width <= widest], [hole for hole in holes if hole.width > widest]
    found = np.concatenate([vertices[facets], *(hole.facets for hole in closed)])
    return Mended(found, turned, joined, gap, tuple(closed), tuple(left), twisted)


def facing_alike(corners: Array) -> tuple[Array, int]:
    """Facets (n, 3, 3) [m] of what is printed on, all turned as their neighbours are, and how many were turned.

    Those that hang together face upwards on the whole, or outwards if they are closed; those that face alike in the file
    are left as they are.
    """
    vertices, facets = _shared(corners)
    facets, turned, _ = _turned(vertices, facets, upward=True)
    return (vertices[facets], turned) if turned else (corners, 0)


def _shared(corners: Array) -> tuple[Array, Ints]:
    """Vertices (n, 3) [m] and facets (m, 3) between them; those that shrank to a line with two equal corners are left out."""
    _, first, number = np.unique(
        np.round(corners.reshape(-1, 3) / _SAME), axis=0, return_index=True, return_inverse=True
    )
    return corners.reshape(-1, 3)[first], _proper(number.reshape(-1, 3).astype(np.int64))


def _proper(facets: Ints) -> Ints:
    return np.asarray(facets[(facets != np.roll(facets, 1, axis=1)).all(axis=1)])


def _edges(facets: Ints) -> tuple[Ints, Flags, Ints]:
    """Of the three sides of each facet (m, 3), in their order: the number of their edge (3 m), whether it runs from the
    lower vertex to the higher (3 m), and the edges' ends (k, 2)."""
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=-1).reshape(-1, 2)
    once, number = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    return number.ravel(), ends[:, 0] < ends[:, 1], once


def _joined(vertices: Array, facets: Ints, slit: float) -> tuple[Array, Ints, int, float]:
    """The same with corners along open edges brought together where they are no farther apart than `slit` [m]; how many
    were, and the farthest that one was moved."""
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
    """Facets (m, 3) turned as their neighbours across edges of two are, how many were, and which hang together with any.

    Each facet stands in a graph twice, as it is and turned round, beside its neighbours as these then have to be. Of a
    surface with two sides that makes two components: one is taken in which more of the area stays as it is, or, if
    `upward`, the one that faces upwards or, closed, outwards. What has but one side is left as it is.
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
    """The holes in a skin, found along sides of facets that no side the other way answers."""
    number, forward, ends = _edges(facets)
    balance = np.bincount(number, np.where(forward, 1.0, -1.0)).astype(int)
    lone = np.repeat(np.flatnonzero(balance), np.abs(balance[balance != 0]))
    ahead = (balance[lone] > 0)[:, None]
    rim = np.where(ahead, ends[lone][:, ::-1], ends[lone])  # the other way round than the facets beside it
    return [_closed(vertices, loop) for loop in _loops(rim)]


def _loops(rim: Ints) -> list[list[int]]:
    """Rings of vertices from the ends (n, 2) of sides, of which as many begin as end at each vertex."""
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
            loop = way[place[after] :]  # a ring is complete: what led to it goes on from there
            loops.append(loop)
            for vertex in loop[1:]:
                del place[vertex]
            del way[place[after] + 1 :]
    return loops


def _closed(vertices: Array, loop: list[int]) -> Hole:
    """A ring of vertices closed by facets that cut off corner after corner, always the one with the shortest cut."""
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
            continue  # a neighbour was cut off since
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
    """Of the tetrahedra (n) between facets (n, 3, 3) and a corner of one of them."""
    a, b, c = (corners - corners[0, 0]).transpose(1, 0, 2)
    return np.asarray((a * np.cross(b, c)).sum(axis=1) / 6.0)


def _volume(corners: Array) -> float:
    return float(_volumes(corners).sum())
