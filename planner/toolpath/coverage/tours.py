"""Orders in which to visit the samples of a face: greedy, weighted greedy, and a travelling salesman's tour.

Onstein et al., algorithms 3 to 5. Both greedy orders may leave samples behind and come back for them across printed
material. The tour is open and starts from the greedy order. PyVRP searches for it with one vehicle and a depot at
distance zero from everywhere; it stops after a fixed number of iterations, never by the clock, so every machine finds
the same tour. PyVRP does not reverse pieces of a tour; `improve` does, which removes the last crossings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pyvrp
from numpy.typing import NDArray
from pyvrp.stop import MaxIterations
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.base.compiled import inner_njit, njit

# Samples nearer than this many spacings are neighbours. With a knight's move (2.24) included, the shortest path over
# neighbours is at most 3 % longer than the straight one.
_REACH = 2.3
# Cosine of the angle between normals: from here down, two samples are on different sheets that happen to be close.
_OTHER_SHEET = 0.0

_LONGEST_MOVED = 3  # samples in a piece that is moved (Or-opt)
_GAIN = 1e-9  # × the mean distance: a smaller gain is rounding

# Cost of leaving the row, in spacings: more than the next sample of the row can be farther away than the next row.
ROW_WEIGHT = 1.0

MOST_SAMPLES = 4000  # of a tour: distances between all pairs are held at once, 128 MB
ITERATIONS = 2000  # 4 s for 1,000 samples
_UNIT = 1e-6  # spacings: PyVRP counts in whole numbers
_SEED = 1


@dataclass(frozen=True)
class SampledSurface:
    """Samples of faces, as used to order visits.

    points, normals (n, 3)  places and unit outward normals [m, part frame]
    parameters (n, 2)       u and v of each on its face
    face (n,)               number of the face
    row (n,)                number of the line of constant u (or v, if faces were sampled the other way) that it lies
                            on; no number is used twice
    spacing                 desired distance along u and along v [m]
    """

    points: Array
    normals: Array
    parameters: Array
    face: Ints
    row: Ints
    spacing: tuple[float, float]

    def links(self) -> csr_array:
        """Chords between neighbours [m], (n, n) sparse and symmetric: approximately the distance along the surface."""
        pairs = cKDTree(self.points).query_pairs(_REACH * max(self.spacing), output_type="ndarray")
        a, b = pairs[:, 0], pairs[:, 1]
        same = self.are_neighbours(a, b)
        a, b = a[same], b[same]
        # a chord of zero length would be no link: samples at the same place (a pole) are kept a hair apart
        chord = np.maximum(np.linalg.norm(self.points[a] - self.points[b], axis=1), np.finfo(float).tiny)
        n = len(self.points)
        return csr_array(
            (np.concatenate([chord, chord]), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n)
        )

    def are_neighbours(self, a: Ints, b: Ints) -> Flags:
        """Whether samples a (k) and b (k) are near each other, on the same sheet."""
        near = np.linalg.norm(self.points[a] - self.points[b], axis=1) <= _REACH * max(self.spacing)
        return np.asarray(near & (np.einsum("ij,ij->i", self.normals[a], self.normals[b]) > _OTHER_SHEET))

    def row_neighbours(self) -> tuple[Ints, Ints]:
        """The sample before and after each one on its row (n,); n where there is none."""
        n = len(self.row)
        order = np.argsort(self.row, kind="stable")
        a, b = order[:-1], order[1:]
        beside = (self.row[a] == self.row[b]) & self.are_neighbours(a, b)
        before, after = np.full(n, n), np.full(n, n)
        before[b[beside]], after[a[beside]] = a[beside], b[beside]
        return before, after


def along_surface(surface: SampledSurface, links: csr_array, start: Ints) -> Array:
    """Distances (len(start), n) along the surface over the links [m].

    Where no links lead: the chord through the air, plus more than any path along the surface.
    """
    way = np.atleast_2d(dijkstra(links, indices=start))
    if np.isinf(way).any():
        longest = float(links.data.sum()) if links.nnz else 0.0
        chord = np.linalg.norm(surface.points[start][:, None] - surface.points, axis=2)
        way = np.where(np.isinf(way), longest + chord, way)
    return way


@njit
def improve(order: Ints, distance: Array) -> Ints:
    """The order (n,) of an open tour, improved until no 2-opt or Or-opt move shortens it; distance (n, n) is symmetric.

    If distances are those in a plane, no two chords of the result cross: reversing the piece between them would shorten
    the tour.
    """
    tour = order.copy()
    n = len(tour)
    total = 0.0
    for k in range(n - 1):
        total += distance[tour[k], tour[k + 1]]
    least = _GAIN * total / max(n - 1, 1)
    better = True
    while better:
        better = False
        for i in range(n - 1):
            for j in range(i + 1, n):
                # reversing tour[i..j] changes the chords before i and after j, if there are any
                change = 0.0
                if i > 0:
                    change += distance[tour[i - 1], tour[j]] - distance[tour[i - 1], tour[i]]
                if j < n - 1:
                    change += distance[tour[i], tour[j + 1]] - distance[tour[j], tour[j + 1]]
                if change < -least:
                    for k in range((j - i + 1) // 2):
                        tour[i + k], tour[j - k] = tour[j - k], tour[i + k]
                    better = True
        for size in range(1, _LONGEST_MOVED + 1):
            for i in range(n - size + 1):
                better = _move(tour, distance, i, size, least) or better
    return tour


@inner_njit
def _move(tour: Ints, distance: Array, i: int, size: int, least: float) -> bool:
    """Move tour[i : i + size] to where it costs least, in either direction, if that shortens the tour."""
    n = len(tour)
    last = i + size - 1
    freed = 0.0
    if i > 0:
        freed += distance[tour[i - 1], tour[i]]
    if last < n - 1:
        freed += distance[tour[last], tour[last + 1]]
    if i > 0 and last < n - 1:
        freed -= distance[tour[i - 1], tour[last + 1]]
    rest = np.concatenate((tour[:i], tour[last + 1 :]))
    best, place, back = -least, -1, False
    for p in range(len(rest) + 1):
        for turned in (False, True):
            head, tail = (tour[last], tour[i]) if turned else (tour[i], tour[last])
            price = -freed
            if p > 0:
                price += distance[rest[p - 1], head]
            if p < len(rest):
                price += distance[tail, rest[p]]
            if 0 < p < len(rest):
                price -= distance[rest[p - 1], rest[p]]
            if price < best:
                best, place, back = price, p, turned
    if place < 0:
        return False
    piece = tour[i : last + 1].copy()
    for k in range(n):
        if k < place:
            tour[k] = rest[k]
        elif k < place + size:
            tour[k] = piece[place + size - 1 - k] if back else piece[k - place]
        else:
            tour[k] = rest[k - size]
    return True


@dataclass(frozen=True)
class VisitRule:
    """Options of an order of visits: the first sample, and how many spacings more a sample off the row costs."""

    start: int = 0
    weight: float = ROW_WEIGHT


def greedy(surface: SampledSurface, rule: VisitRule = VisitRule()) -> Ints:
    """Always go to the nearest unvisited sample (n,); of equally near ones, to that with the lowest index."""
    return _nearest_first(surface, rule.start, 0.0)


def weighted_greedy(surface: SampledSurface, rule: VisitRule = VisitRule()) -> Ints:
    """As `greedy` (n,), but samples off the row cost more, and twice as much amid their row: side to side, row by row.

    The second weight is not from the paper. Rows differ in length; if the next one is longer, its nearest sample is not
    its last one, which would be left behind.
    """
    return _nearest_first(surface, rule.start, rule.weight * max(surface.spacing))


def _nearest_first(surface: SampledSurface, start: int, weight: float) -> Ints:
    """Always go where distance plus weight is least, from sample `start` on."""
    links, before, after = surface.links(), *surface.row_neighbours()
    n = len(surface.points)
    order = np.full(n, start, dtype=np.int64)
    left = np.ones(n + 1, dtype=np.bool_)  # the last entry stands for a missing neighbour
    left[[start, n]] = False
    for k in range(1, n):
        here = int(order[k - 1])
        span = slice(links.indptr[here], links.indptr[here + 1])
        near: NDArray[np.int64] = np.sort(links.indices[span][left[links.indices[span]]]).astype(np.int64)
        if near.size:
            way: Array = np.linalg.norm(surface.points[near] - surface.points[here], axis=1)
        else:
            near = np.flatnonzero(left)
            way = along_surface(surface, links, order[k - 1 : k])[0, near]
        off = surface.row[near] != surface.row[here]
        amid = left[before[near]] & left[after[near]]
        # rounded, so that equally near ones are equal whatever the last digit says
        price = np.round((way + weight * (off * (1.0 + amid))) / max(surface.spacing), 9)
        order[k] = near[np.argmin(price)]
        left[order[k]] = False
    return order


def without_jumps(surface: SampledSurface, order: Ints) -> list[Ints]:
    """Split an order of visits where the next sample is no neighbour: the path there would cross printed material."""
    return np.split(order, np.flatnonzero(~surface.are_neighbours(order[:-1], order[1:])) + 1)


class TooManySamplesError(ValueError):
    """A tour over more samples than MOST_SAMPLES."""


def tour(surface: SampledSurface, rule: VisitRule = VisitRule()) -> Ints:
    """A short open tour over the samples (n,), searched from the greedy one; its start and end are free.

    Raises TooManySamplesError.
    """
    n = len(surface.points)
    if n > MOST_SAMPLES:
        raise TooManySamplesError(f"a tour over {n} samples: at most {MOST_SAMPLES}")
    start = greedy(surface, rule)
    if n < 3:
        return start
    distance = along_surface(surface, surface.links(), np.arange(n, dtype=np.int64))
    distance = 0.5 * (distance + distance.T)
    unit = _UNIT * max(surface.spacing)
    whole: Any = np.zeros((n + 1, n + 1), dtype=np.int64)  # the first is the depot
    whole[1:, 1:] = np.rint(distance / unit)
    np.fill_diagonal(whole, 0)
    places = [pyvrp.Location(0.0, 0.0), *(pyvrp.Location(*xy) for xy in surface.points[:, :2].tolist())]
    data = pyvrp.ProblemData(
        places,
        [pyvrp.Client(place) for place in range(1, n + 1)],
        [pyvrp.Depot(0)],
        [pyvrp.VehicleType()],
        [whole],
        [0 * whole],
    )
    first = pyvrp.Solution(data, [[int(i) for i in improve(start, distance)]])
    found = pyvrp.solve(data, MaxIterations(ITERATIONS), seed=_SEED, collect_stats=False, initial_solution=first)
    visited = [step.idx for route in found.best.routes() for step in route if step.is_client()]
    return improve(np.array(visited, dtype=np.int64), distance)


ORDERS: MappingProxyType[str, Callable[[SampledSurface, VisitRule], Ints]] = MappingProxyType(
    {"greedy": greedy, "weighted_greedy": weighted_greedy, "tour": tour}
)
