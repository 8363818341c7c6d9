"""The surface of a part known only by its waypoints: a disc under each, one bead's height below.

Nothing else is known of the part, so nothing else is claimed: the discs are the ground of the first layer and the
printed beads, with a solid shell beneath each. Any path through the part passes through a shell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints, read_only
from planner.base.compiled import njit
from planner.toolpath.bead import Bead
from planner.toolpath.waypoints.nearest import ALWAYS, FAR, PrintedPoints, nearest_printed, printed_points

SHELL = 10e-3  # m of solid material beneath a disc
_OTHER_HEIGHT = (0.5, 1.5)  # × a bead's height: it does not count as printed on places closer or farther beneath it
_NEIGHBOURS = 8  # nearest places that are examined for one beneath a waypoint
_STENCIL = 6  # samples through which normals are interpolated
_ABOVE = 0.9  # share of the distance along the normal, above which the place belongs to another layer
_STEPS = 3  # Newton steps to the nearest place on a bead
# Measuring how far apart layers lie
_LOOKED = 300  # samples, at most
_BENEATH = (0.1, 3.0)  # bead widths beneath them: closer places are in their own layer
_CLEARLY = 0.2  # least bead widths between layers: less may be a layer's own slope
_ASIDE = 0.5  # bead widths from straight beneath
_SHARE = 0.3  # of the samples, at least, must have a place beneath them: half do in two layers
_LIKE, _MOST_UNLIKE = 0.25, 0.3  # share by which distances may differ from the usual one; share that may exceed it


class Samples:
    """The samples of all beads; for the fields see `Surfels` and `Struts`."""

    tips: Array
    outward: Array
    along: Array
    first: Ints
    tip_tree: PrintedPoints

    def normals(self, points: Array) -> Array:
        """Outward unit vectors (n, 3) at the places of the beads nearest to points (n, 3)."""
        _, k = nearest_printed(self.tip_tree, 0, points, np.inf)
        bead = np.searchsorted(self.first, k, side="right") - 1
        start = np.clip(k - _STENCIL // 2 + 1, self.first[bead], self.first[bead + 1] - _STENCIL)
        return _normals(read_only(points), self.tips, self.outward, start, (k - start).astype(float))

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Outward unit vectors (n, 3) of a bead at its places nearest to tips (n, 3), near arc lengths s (n) [m].

        Other passes and other parts of the bead have no influence, however close they lie.
        """
        first, last = self.first[bead], self.first[bead + 1]
        along = self.along[first:last]
        start = np.clip(first + np.searchsorted(along, s) - _STENCIL // 2, first, last - _STENCIL)
        near = first + np.interp(s, along, np.arange(last - first)) - start
        return _normals(read_only(np.ascontiguousarray(tips)), self.tips, self.outward, start, near)


@dataclass(frozen=True)
class Surfels(Samples):
    """Discs under the samples of all beads, in print order; lengths in metres, part frame.

    tips, outward (n, 3)   the samples and their outward unit normals
    along (n)              arc length of the samples in their bead
    centres (n, 3)         of the discs: one bead's height below the tips
    radius                 of the discs: neighbours touch
    first (beads + 1)      index of each bead's first sample
    printed                how many beads are already there
    tree, tip_tree         search trees of the centres, where a disc with nothing printed beneath it is there from the
                           start; and of all tips
    """

    tips: Array
    outward: Array
    along: Array
    centres: Array
    radius: float
    first: Ints
    printed: int
    tree: PrintedPoints
    tip_tree: PrintedPoints

    def before(self, bead: int) -> Surfels:
        """The surface after the first `bead` beads."""
        return replace(self, printed=bead)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the discs that are there, FAR at most; negative inside a shell."""
        points = read_only(points)
        _, nearest = nearest_printed(self.tree, self.printed, points)
        return _from_discs(points, nearest, self.centres, self.outward, self.radius)

    def nearest_layer(self, point: Array) -> float:
        """Distance [m] of a point (3) from the nearest sample above or below it, along that sample's normal.

        Infinite if there is none within FAR.
        """
        near = np.flatnonzero(((self.tips - point) ** 2).sum(axis=1) <= FAR**2)
        way = point - self.tips[near]
        away = np.linalg.norm(way, axis=1)
        above = np.abs((way * self.outward[near]).sum(axis=1)) > _ABOVE * away
        return float(away[above & (away > 0.0)].min(initial=np.inf))


@njit
def _from_discs(points: Array, nearest: Ints, centres: Array, outward: Array, radius: float) -> Array:
    """Distance (n) of points (n, 3) from the discs `nearest` (n), FAR where that is -1; negative inside a shell."""
    out = np.empty(len(points))
    for i in range(len(points)):
        k = nearest[i]
        if k < 0:
            out[i] = FAR
            continue
        above, size = 0.0, 0.0
        for d in range(3):
            above += (points[i, d] - centres[k, d]) * outward[k, d]
        for d in range(3):
            size += (points[i, d] - centres[k, d] - above * outward[k, d]) ** 2
        aside = max(np.sqrt(size) - radius, 0.0)
        inside = -SHELL < above < 0.0 and aside <= -above
        out[i] = (-1.0 if inside else 1.0) * np.hypot(above, aside)
    return out


@njit
def _normals(points: Array, tips: Array, outward: Array, start: Ints, near: Array) -> Array:
    """Unit normals (n, 3) where the polynomials through six samples from `start` come nearest to points (n, 3).

    near (n): roughly where among the six that is.
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
    """Assign each bead to its layer, and return the surface of all of them.

    A bead lies on a layer if an earlier one is beneath most of its length, one bead's height below.
    """
    tips, normals = (np.vstack([getattr(bead, name) for bead in beads]) for name in ("points", "normals"))
    first = np.concatenate([[0], np.cumsum([len(bead.points) for bead in beads])])
    height, along = (np.concatenate([getattr(bead, name) for bead in beads]) for name in ("height", "s"))
    centres = tips - height[:, None] * normals
    spacing = float(np.median(np.concatenate([np.diff(bead.s) for bead in beads])))
    radius = 0.5 * (spacing + max(float(bead.width.max()) for bead in beads))
    beneath = _beneath(_dense(tips, normals, first, radius), tips, normals, centres, height, 2.0 * radius)
    owner = np.where(beneath >= 0, np.searchsorted(first, beneath, side="right") - 1, -1)
    layers = np.zeros(len(beads), dtype=np.int64)
    for i, bead in enumerate(beads):
        below = owner[first[i] : first[i + 1]]
        below = below[(below >= 0) & (below < i)]
        if 2 * len(below) > len(bead.points):
            layers[i] = int(np.median(layers[below])) + 1
    since = np.where(beneath < 0, ALWAYS, np.repeat(np.arange(len(beads)), np.diff(first)))
    surfels = Surfels(
        read_only(tips),
        read_only(normals),
        read_only(along),
        read_only(centres),
        radius,
        first,
        len(beads),
        printed_points(centres, since),
        tips_tree(tips),
    )
    return tuple(replace(bead, layer=layer) for bead, layer in zip(beads, layers.tolist(), strict=True)), surfels


def tips_tree(tips: Array) -> PrintedPoints:
    """A search tree of tips (n, 3), all of which are there from the start."""
    return printed_points(tips, np.full(len(tips), ALWAYS))


def _dense(tips: Array, normals: Array, first: Ints, apart: float) -> tuple[Array, Array, Ints]:
    """Samples, and places between those more than `apart` [m] from each other, as on straight lines.

    Returns tips and normals (m, 3), and the sample (m) with which each place is laid.
    """
    step = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    step[first[1:-1] - 1] = 0.0  # nothing is laid between beads
    count = np.append(1, np.maximum(np.ceil(step / apart), 1.0).astype(np.int64))
    sample = np.repeat(np.arange(len(tips)), count)
    back = (np.cumsum(count)[sample] - 1 - np.arange(len(sample))) / count[sample]
    before = np.maximum(sample - 1, 0)
    mixed = [x[sample] + back[:, None] * (x[before] - x[sample]) for x in (tips, normals)]
    return mixed[0], mixed[1], sample


def _beneath(
    laid: tuple[Array, Array, Ints], tips: Array, normals: Array, centres: Array, height: Array, reach: float
) -> Ints:
    """For each sample (n) an earlier one that is laid about one bead's height beneath it, or -1; laid: see `_dense`.

    The difference in height of two places is measured along the mean of their normals: 0 on any sphere.
    """
    n, (low, high) = len(tips), _OTHER_HEIGHT
    places, leaning, sample = laid
    tree = cKDTree(places, balanced_tree=False, compact_nodes=False)
    _, near = tree.query(centres, k=min(_NEIGHBOURS, n), workers=-1)
    near = near.reshape(n, -1)
    found = np.full(n, -1, dtype=np.int64)
    for other in near.T[::-1]:
        way = tips - places[other]
        mean = normals + leaning[other]
        mean = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
        up = (way * mean).sum(axis=1)
        aside = np.linalg.norm(way - up[:, None] * mean, axis=1)
        under = (sample[other] < np.arange(n)) & (up > low * height) & (up < high * height) & (aside <= reach)
        found = np.where(under, sample[other], found)
    return found


def other_height(beads: Sequence[Bead], height: float) -> float | None:
    """The usual distance of layers [m], if beads of this height [m] then do not count as printed on each other.

    None if they do, and if the distances of layers vary.
    """
    apart = _layers_apart(beads)
    low, high = _OTHER_HEIGHT
    return apart if apart is not None and not low * height < apart < high * height else None


def _layers_apart(beads: Sequence[Bead]) -> float | None:
    """The usual distance [m], along their normals, of samples from the nearest earlier place beneath them."""
    tips, normals = (np.vstack([getattr(bead, name) for bead in beads]) for name in ("points", "normals"))
    first = np.concatenate([[0], np.cumsum([len(bead.points) for bead in beads])])
    width = max(float(bead.width.max()) for bead in beads)
    places, leaning, laid = _dense(tips, normals, first, _ASIDE * width)
    some = np.unique(np.linspace(0, len(tips) - 1, min(len(tips), _LOOKED)).round().astype(np.int64))
    found = cKDTree(places).query_ball_point(tips[some], _BENEATH[1] * width)
    own = np.repeat(np.arange(len(some)), [len(each) for each in found])
    near = np.concatenate([np.asarray(each, dtype=np.int64) for each in found])
    way, mean = tips[some[own]] - places[near], normals[some[own]] + leaning[near]
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
    up = (way * mean).sum(axis=1)
    aside = np.linalg.norm(way - up[:, None] * mean, axis=1)
    beneath = (laid[near] < some[own]) & (up > _BENEATH[0] * width) & (aside <= _ASIDE * width)
    least = np.full(len(some), np.inf)
    np.minimum.at(least, own[beneath], up[beneath])
    least = least[np.isfinite(least)]
    if len(least) < _SHARE * len(some):
        return None
    usual = float(np.median(least))
    alike = np.mean(np.abs(least - usual) > _LIKE * usual) <= _MOST_UNLIKE
    return usual if alike and usual > _CLEARLY * width else None
