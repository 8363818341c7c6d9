"""The surface of a part that is known by its waypoints alone: a disc under each, one bead's height below.

Nothing else is known of the part, so nothing else is claimed: the discs are what the first layer lies on and what has
been printed, with a shell of solid beneath each. Whoever passes through the part passes through a shell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints, read_only
from planner.base.compiled import njit
from planner.toolpath.bead import Bead

FAR = 50e-3  # m: what is farther away than this is that far away
SHELL = 10e-3  # m of solid beneath a disc
_NEIGHBOURS = 8  # that are looked at to see what lies beneath a waypoint
_STENCIL = 6  # samples through which normals are interpolated
_ABOVE = 0.9  # of the distance, along the normal: a place of another layer
_MANY = 2_000  # points, fewer than which threads take longer to start than to search
_STEPS = 3  # of Newton's method for the nearest place on a bead


@dataclass(frozen=True)
class Surfels:
    """Discs under the samples of all beads, in print order; lengths in metres, part frame.

    tips, outward (n, 3)   the samples and their outward unit normals
    along (n)              arc length of the samples in their bead
    centres (n, 3)         of the discs: one bead's height below the tips
    radius                 of the discs: neighbours touch
    first (beads + 1)      index of each bead's first sample
    bare (m + 1)           samples beneath which nothing is printed: what they lie on is there from the start; then a -1
    printed                how many beads are there
    trees                  search trees by (size, number) of a block of beads; those of `bare` and of all tips
    """

    tips: Array
    outward: Array
    along: Array
    centres: Array
    radius: float
    first: Ints
    bare: Ints
    printed: int
    trees: dict[tuple[int, int], cKDTree]
    bare_tree: cKDTree
    tip_tree: cKDTree

    def before(self, bead: int) -> Surfels:
        """The surface when the first `bead` beads have been printed."""
        return replace(self, printed=bead)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from what is there, FAR at most; negative inside a shell."""
        best, nearest = self.bare_tree.query(points, distance_upper_bound=FAR, workers=workers_for(points))
        _, nearest = nearest_printed(self.trees, self.first, self.printed, points, (best, self.bare[nearest]))
        away = points - self.centres[nearest]
        above = (away * self.outward[nearest]).sum(axis=1)
        aside = np.linalg.norm(away - above[:, None] * self.outward[nearest], axis=1)
        aside = np.maximum(aside - self.radius, 0.0)
        inside = (above < 0.0) & (above > -SHELL) & (aside <= -above)
        distance = np.where(inside, -1.0, 1.0) * np.hypot(above, aside)
        return np.where(nearest < 0, FAR, distance)

    def nearest_layer(self, point: Array) -> float:
        """Distance [m] of a point (3) from the nearest sample that lies above or below it, along its own normal; infinite where
        none does within FAR."""
        near = self.tip_tree.query_ball_point(point, FAR)
        way = point - self.tips[near]
        away = np.linalg.norm(way, axis=1)
        above = np.abs((way * self.outward[near]).sum(axis=1)) > _ABOVE * away
        return float(away[above & (away > 0.0)].min(initial=np.inf))

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) at the places of the beads nearest to points (n, 3)."""
        return normals_nearest(self, points)

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Outward unit normals (n, 3) of a bead nearest to tips (n, 3) beside its arc lengths s (n) [m].

        However close other passes lie, or other parts of the bead, they say nothing here.
        """
        return normals_beside(self, bead, s, tips)


class Samples(Protocol):
    """The samples of all beads, as `Surfels` has them."""

    @property
    def tips(self) -> Array:
        """As of Surfels."""
        ...

    @property
    def outward(self) -> Array:
        """As of Surfels."""
        ...

    @property
    def along(self) -> Array:
        """As of Surfels."""
        ...

    @property
    def first(self) -> Ints:
        """As of Surfels."""
        ...

    @property
    def tip_tree(self) -> cKDTree:
        """As of Surfels."""
        ...


def normals_nearest(of: Samples, points: Array) -> Array:
    """Outward unit normals (n, 3) at the places of the beads nearest to points (n, 3)."""
    _, k = of.tip_tree.query(points, workers=workers_for(points))
    bead = np.searchsorted(of.first, k, side="right") - 1
    start = np.clip(k - _STENCIL // 2 + 1, of.first[bead], of.first[bead + 1] - _STENCIL)
    return _normals(read_only(points), of.tips, of.outward, start, (k - start).astype(float))


def normals_beside(of: Samples, bead: int, s: Array, tips: Array) -> Array:
    """Outward unit normals (n, 3) of a bead nearest to tips (n, 3) beside its arc lengths s (n) [m]."""
    first, last = of.first[bead], of.first[bead + 1]
    along = of.along[first:last]
    start = np.clip(first + np.searchsorted(along, s) - _STENCIL // 2, first, last - _STENCIL)
    near = first + np.interp(s, along, np.arange(last - first)) - start
    return _normals(read_only(np.ascontiguousarray(tips)), of.tips, of.outward, start, near)


def nearest_printed(
    trees: dict[tuple[int, int], cKDTree], first: Ints, printed: int, points: Array, known: tuple[Array, Ints]
) -> tuple[Array, Ints]:
    """Distance (n) [m] of points (n, 3) from the nearest point of the first `printed` beads, and its index (n).

    first: index of each bead's first point; known: distances and indices of what is nearer otherwise, FAR at most.
    """
    best, nearest = known
    start = 0
    for digit in reversed(range(printed.bit_length())):
        size = 1 << digit
        if printed & size:  # the printed beads are one block for each binary digit of their number
            distance, index = trees[size, start // size].query(
                points, distance_upper_bound=FAR, workers=workers_for(points)
            )
            closer = distance < best
            if closer.any():  # none closer: none found
                best = np.where(closer, distance, best)
                nearest = np.where(closer, index + first[start], nearest)
            start += size
    return best, nearest


def block_trees(points: Array, first: Ints) -> dict[tuple[int, int], cKDTree]:
    """Search trees of the points (n, 3) of beads, by (size, number) of a block of beads; first as in `nearest_printed`."""
    trees: dict[tuple[int, int], cKDTree] = {}
    beads, size = len(first) - 1, 1
    while size <= beads:
        for number in range(beads // size):
            trees[size, number] = tree_of(points[first[number * size] : first[(number + 1) * size]])
        size *= 2
    return trees


@njit(cache=True)
def _normals(points: Array, tips: Array, outward: Array, start: Ints, near: Array) -> Array:
    """Unit normals (n, 3) where the polynomials through six samples from `start` come nearest to points (n, 3).

    near (n): about where in the six that is.
    """
    out = np.empty_like(points)
    value, slope = np.empty(_STENCIL), np.empty(_STENCIL)
    for i in range(len(points)):
        t = near[i]
        for step in range(_STEPS + 1):
            for k in range(_STENCIL):  # Lagrange's polynomials and their slopes
                value[k], slope[k] = 1.0, 0.0
                for j in range(_STENCIL):
                    if j != k:
                        slope[k] = (slope[k] * (t - j) + value[k]) / (k - j)
                        value[k] *= (t - j) / (k - j)
            if step == _STEPS:
                break
            ahead, size = 0.0, 1e-30
            for d in range(3):
                x, dx = 0.0, 0.0
                for k in range(_STENCIL):
                    x += value[k] * tips[start[i] + k, d]
                    dx += slope[k] * tips[start[i] + k, d]
                ahead += (points[i, d] - x) * dx
                size += dx * dx
            t = min(max(t + min(max(ahead / size, -0.5), 0.5), 0.0), _STENCIL - 1.0)
        length = 0.0
        for d in range(3):
            out[i, d] = 0.0
            for k in range(_STENCIL):
                out[i, d] += value[k] * outward[start[i] + k, d]
            length += out[i, d] ** 2
        for d in range(3):
            out[i, d] /= np.sqrt(length)
    return out


def with_layers(beads: Sequence[Bead]) -> tuple[tuple[Bead, ...], Surfels]:
    """Say in which layer each bead lies, and return the surface of all of them.

    A bead lies on a layer if an earlier one is beneath most of its length, one bead's height below.
    """
    tips, normals = (np.vstack([getattr(bead, name) for bead in beads]) for name in ("points", "normals"))
    first = np.concatenate([[0], np.cumsum([len(bead.points) for bead in beads])])
    height, along = (np.concatenate([getattr(bead, name) for bead in beads]) for name in ("height", "s"))
    centres = tips - height[:, None] * normals
    spacing = float(np.median(np.concatenate([np.diff(bead.s) for bead in beads])))
    radius = 0.5 * (spacing + max(float(bead.width.max()) for bead in beads))
    tip_tree = tree_of(tips)
    beneath = _beneath(tips, normals, centres, height, 2.0 * radius, tip_tree)
    owner = np.where(beneath >= 0, np.searchsorted(first, beneath, side="right") - 1, -1)
    layers: list[int] = []
    for i, bead in enumerate(beads):
        below = owner[first[i] : first[i + 1]]
        below = below[(below >= 0) & (below < i)]
        most = 2 * len(below) > len(bead.points)
        layers.append(int(np.median(np.array(layers)[below])) + 1 if most else 0)
    bare = np.flatnonzero(beneath < 0)
    trees = block_trees(centres, first)
    bare_tree = tree_of(centres[bare])
    surfels = Surfels(
        tips, normals, along, centres, radius, first, np.append(bare, -1), len(beads), trees, bare_tree, tip_tree
    )
    return tuple(replace(bead, layer=layer) for bead, layer in zip(beads, layers, strict=True)), surfels


def workers_for(points: Array) -> int:
    """How many threads search trees for points (n, 3)."""
    return 1 if len(points) < _MANY else -1


def tree_of(points: Array) -> cKDTree:
    """A search tree that is made quickly."""
    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def _beneath(tips: Array, normals: Array, centres: Array, height: Array, reach: float, tree: cKDTree) -> Ints:
    """For each sample (n) an earlier one that lies about one bead's height beneath it, or -1.

    How far two samples are apart in height is measured along the mean of their normals: 0 on any sphere.
    """
    n = len(tips)
    _, near = tree.query(centres, k=min(_NEIGHBOURS, n), workers=-1)
    near = near.reshape(n, -1)
    found = np.full(n, -1, dtype=np.int64)
    for other in near.T[::-1]:
        way = tips - tips[other]
        mean = normals + normals[other]
        mean = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
        up = (way * mean).sum(axis=1)
        aside = np.linalg.norm(way - up[:, None] * mean, axis=1)
        under = (other < np.arange(n)) & (up > 0.5 * height) & (up < 1.5 * height) & (aside <= reach)
        found = np.where(under, other, found)
    return found
