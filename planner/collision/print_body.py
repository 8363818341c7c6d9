"""The space that part and print take up, as points in print order: for the nozzle and whatever else comes near."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints, ReadOnlyArrays
from planner.base.compiled import inner_njit, njit
from planner.base.geometry import subdivided
from planner.cell.bodies import nozzle_profile
from planner.cell.cell import Cell, rigid_inverse
from planner.cell.robot import bodies_with_tip
from planner.cell.solids import Body, triangles_of
from planner.collision.point_tree import FROM_THE_START, PointTree, point_tree
from planner.problem import Problem
from planner.problem.cell import NozzleSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.contacts import BeadContacts, contacts

# ----------------------------------------------------------------------------------------------------
# Triangles that are far longer than wide, cut across: halving their longest sides would make ever thinner ones.

# Longest side over height. Halving a triangle down to a given length makes about this many times as many pieces as for
# a well-shaped one of its area: a cylinder of 10 m, drawn in facets 1.7 mm wide, would make thousands of millions.
SLENDER = 150.0


def without_slivers(triangles: Array, longest: float) -> Array:
    """The same surface (n, 3, 3) [m] with slender triangles longer than `longest` cut across.

    Pieces are about as long as they are wide, or as `longest`. Other triangles come first, unchanged. Which side of the
    pieces is the front is not preserved.
    """
    sides = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    k, n = np.argmax(sides, axis=1), np.arange(len(triangles))
    long = sides[n, k]
    a, b, c = (triangles[n, (k + i) % 3] for i in range(3))  # a to b is the longest side
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(long, np.finfo(float).tiny)
    slender = (long > longest) & (long > SLENDER * height)
    if not slender.any():
        return triangles
    a, b, c, height = a[slender], b[slender], c[slender], height[slender]
    along = (b - a) / long[slender, None]
    foot = a + np.einsum("ij,ij->i", c - a, along)[:, None] * along
    strips = [_strips(tip, foot, c, np.maximum(height, longest)) for tip in (a, b)]
    return np.concatenate([triangles[~slender], *strips])


def _strips(tip: Array, foot: Array, top: Array, wide: Array) -> Array:
    """Triangles (m, 3, 3) of right-angled ones (n, 3) with the right angle at the foot, cut across from the tip on."""
    count = np.maximum(np.ceil(np.linalg.norm(foot - tip, axis=1) / wide), 1.0).astype(int)
    own = np.repeat(np.arange(len(count)), count)
    first = np.arange(len(own)) - np.repeat(np.cumsum(count) - count, count)
    u, v = (first / count[own])[:, None], ((first + 1) / count[own])[:, None]
    tip, to_foot, to_top = tip[own], (foot - tip)[own], (top - tip)[own]
    begin, end = (tip + u * to_foot, tip + u * to_top), (tip + v * to_foot, tip + v * to_top)
    halves = np.stack([begin[0], end[0], end[1]], axis=1), np.stack([begin[0], end[1], begin[1]], axis=1)
    return np.concatenate([halves[0], halves[1][first > 0]])


# ----------------------------------------------------------------------------------------------------
# Points all over a surface of triangles, compiled: small triangles first, then one of the corners that nearly coincide.

_MIXES = 0x9E3779B97F4A7C15  # odd, and 2**64 over the golden ratio: consecutive keys land far apart


@njit
def split(triangles, longest):
    """The same surface (n, 3, 3) in triangles with no side over `longest`: each is halved across its longest side."""
    done, count = np.empty((max(4 * len(triangles), 16), 3, 3)), 0
    now = triangles
    while len(now):
        across, long = np.full(len(now), -1), 0
        for i in range(len(now)):
            side, k = 0.0, 0
            for j in range(3):
                length = _apart(now[i, j], now[i, (j + 1) % 3])
                if length > side:
                    side, k = length, j
            if side > longest:
                across[i] = k
                long += 1
        if count + len(now) - long > len(done):
            more = np.empty((2 * (count + len(now)), 3, 3))
            for i in range(count):
                _copy(done[i], more[i])
            done = more
        halves, j = np.empty((2 * long, 3, 3)), 0
        for i in range(len(now)):
            if across[i] < 0:
                _copy(now[i], done[count])
                count += 1
                continue
            for x in range(3):
                a, b, c = now[i, across[i], x], now[i, (across[i] + 1) % 3, x], now[i, (across[i] + 2) % 3, x]
                middle = 0.5 * (a + b)
                halves[j, 0, x], halves[j, 1, x], halves[j, 2, x] = a, middle, c
                halves[long + j, 0, x], halves[long + j, 1, x], halves[long + j, 2, x] = middle, b, c
            j += 1
        now = halves
    out = np.empty((count, 3, 3))
    for i in range(count):
        _copy(done[i], out[i])
    return out


@inner_njit
def _copy(triangle, out):
    for k in range(3):
        for x in range(3):
            out[k, x] = triangle[k, x]


@njit
def merged(triangles, size):
    """One of the corners of triangles (n, 3, 3) in each cube of a grid with cubes of that size: points (m, 3), and how
    far (m) the surface that each stands for extends from it."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(triangles)):
        for k in range(3):
            for x in range(3):
                low[x], high[x] = min(low[x], triangles[i, k, x]), max(high[x], triangles[i, k, x])
    wide = np.empty(3, np.int64)
    for x in range(3):
        wide[x] = np.int64(np.floor((high[x] - low[x]) / size)) + 1
    bits = 4
    while 1 << bits < 4 * len(triangles):
        bits += 1
    place = np.full(1 << bits, -1, dtype=np.int32)  # a hash table of cubes by their keys: open addressing
    last = (1 << bits) - 1
    keys, kept = np.empty(3 * len(triangles), np.int64), np.empty((3 * len(triangles), 3))
    far, count = np.zeros(3 * len(triangles)), 0
    for i in range(len(triangles)):
        spread = _farthest(triangles[i])
        for k in range(3):
            p = triangles[i, k]
            key = np.int64(0)
            for x in range(3):
                key = key * wide[x] + np.int64(np.floor((p[x] - low[x]) / size))
            at = np.int64((np.uint64(key) * np.uint64(_MIXES)) >> np.uint64(64 - bits))
            while place[at] >= 0 and keys[place[at]] != key:
                at = (at + 1) & last
            if place[at] < 0:
                place[at] = count
                keys[count] = key
                for x in range(3):
                    kept[count, x] = p[x]
                count += 1
            m = place[at]
            far[m] = max(far[m], spread + _apart(p, kept[m]))
    order = np.argsort(keys[:count])  # what lies near in the grid lies near in the list
    points, reach = np.empty((count, 3)), np.empty(count)
    for i in range(count):
        for x in range(3):
            points[i, x] = kept[order[i], x]
        reach[i] = far[order[i]]
    return points, reach


@inner_njit
def _apart(a, b):
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    return np.sqrt(x * x + y * y + z * z)


@inner_njit
def _farthest(t):
    """Greatest distance of any place of a triangle (3, 3) from its nearest corner."""
    a, b, c = _apart(t[0], t[1]), _apart(t[1], t[2]), _apart(t[2], t[0])
    a, b = min(a, b), max(a, b)
    b, c = min(b, c), max(b, c)
    a, b = min(a, b), max(a, b)
    if a * a + b * b <= c * c:
        return 0.5 * c
    ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return a * b * c / max(2.0 * np.sqrt(x * x + y * y + z * z), 1e-30)


# ----------------------------------------------------------------------------------------------------
# The space that part and print take up, as points in print order: for the nozzle and whatever else comes near.
#
# The substrate, what it stands on, and the beads as rows of balls. Time is counted in beads: what is laid at a fraction
# x of the length of bead i is there from i + x on, and travel to bead i takes place at i.

# No full clearance can be kept where the nozzle lays a bead next to another: a point of part or print requires this
# share of its distance from the nozzle's tip, less that share of the distance at which the nozzle's face and bead end.
TIP_SLOPE = 0.25
# What is there from the start may be penetrated by at most this share of the bead's height, however near it is to the
# tip, as beads may: `verify.pressed`.
_GRAZED = 0.5
CLEARANCE = 2e-3  # m: at this distance from the points, nothing between them is nearer
_NEAR = 20e-3  # m from a bead, within which surfaces are sampled finely
_SOME = 1000  # samples of a bead, roughly, that decide what is near, with places between them where they are far apart
_FINE, _COARSE = 1.4e-3, 4e-3  # m, longest side of a triangle whose corners stand for it: near beads, and elsewhere
_FINE_ENOUGH = 0.15e-3  # m of ball radius that a bead must tolerate for _FINE to do; if it does not, sides are shorter
_MOST = 100_000  # points of either kind, roughly: rather than more of them, there are larger gaps between them,
_MOST_NEAR = 1_000_000  # but near beads up to this many, rather than balls that are larger than beads tolerate
_SPREAD = 0.8  # share of that side: no place of a triangle is farther than this from a corner, corners being merged
_BORNE = 0.75  # share of what a bead tolerates that balls may use: a nozzle that leans has less room beneath it
CORNER_AREA = 0.3  # surface for each corner, as a share of the square of that side
MERGED = 0.125  # share of that side: corners nearer to each other count as one
_OVERHANG = 0.25  # share of the height by which a bead may be wider than its balls
_CAPSULE = 0.25  # diameters between the balls of a strut: their surface is at most 2 % of one beneath the strut's
_CHORD = 2e-3  # m that a picture's triangles may deviate from the true surface
_ON = 1e-5  # m: this close counts as on the surface
_TURN = 3.0  # widths of a bead that it runs, at least, before it can lie on itself,
_LIES = 0.5  # and widths by which its line is offset from what it lies on, at most
_BETWEEN = 0.51  # share of the spacing of contacts: places of a bead this close to a contact lie on something, too
PART = "part"


@dataclass(frozen=True)
class PrintBody(ReadOnlyArrays):
    """Points of part and print, in the part frame.

    tree    of all of them; its `number` counts bodies, substrate, then beads
    first   (k + 1) number of the first point of each thing; names (k) of the things
    bodies  how many of them are bodies of the cell
    """

    tree: PointTree
    first: Ints
    names: tuple[str, ...]
    bodies: int = 0

    @cached_property
    def without_bodies(self) -> PrintBody:
        """Part and print alone."""
        return self._of(self.bodies, len(self.names)) if self.bodies else self

    @cached_property
    def bodies_alone(self) -> PrintBody:
        """The cell's bodies alone."""
        return replace(self._of(0, self.bodies), bodies=self.bodies)

    def _of(self, begin: int, end: int) -> PrintBody:
        """Some of the things, none of them a body of the cell."""
        first, last = int(self.first[begin]), int(self.first[end])
        tree = self.tree
        kept = np.argsort(tree.number)[first:last]
        alone = point_tree(tree.points[kept], tree.radius[kept], tree.time[kept])
        return PrintBody(alone, self.first[begin : end + 1] - first, self.names[begin:end])

    def name_of(self, point: int) -> str:
        """What a point belongs to; it is given by its index in the tree's order."""
        number = self.tree.number[point]
        return self.names[int(np.searchsorted(self.first, number, side="right")) - 1]


def print_body(toolpath: Toolpath, bodies: Sequence[Body] = ()) -> PrintBody:
    """Part and print of a toolpath, with bodies fixed in the part frame: see `standing`."""
    beads = toolpath.beads
    corners = _substrate(toolpath)
    surfaces = [(body.name, _corners(body)) for body in bodies]
    surfaces += [(PART, corners)] if corners is not None and len(corners) else []
    tips = cKDTree(np.concatenate([_tips(bead) for bead in beads]))
    pieces = [
        split(without_slivers(np.ascontiguousarray(triangles, dtype=float), _NEAR), _NEAR) for _, triangles in surfaces
    ]
    near = [_is_near(each, tips) for each in pieces]
    sides = _sides(pieces, near, _BORNE * min(float((bead.height + TIP_SLOPE * bead.width).min()) for bead in beads))
    names, points, radius, time = [], [], [], []
    for k, ((name, _), piece, by) in enumerate(zip(surfaces, pieces, near, strict=True)):
        at, spread = _spread(piece, by, sides)
        if k == len(bodies) and toolpath.solid is None:
            at = _onto(toolpath, at)
        names.append(name)
        points.append(at)
        radius.append(np.hypot(CLEARANCE, spread) - CLEARANCE)
        time.append(np.full(len(at), FROM_THE_START))
    if corners is None and not beads[0].round:  # nothing is known to be beneath a strut
        first = _on_the_part(toolpath.lowest)
        names.append(PART)
        points.append(np.concatenate(first))
        radius.append(np.zeros(len(points[-1])))
        time.append(np.full(len(points[-1]), FROM_THE_START))
    for i, bead in enumerate(beads):
        at, share, thick = _rows(bead, 0.5)
        names.append(f"bead {i}")
        points.append(at)
        radius.append(thick)
        time.append(np.minimum(i + share, np.nextafter(i + 1.0, 0.0)))  # its last ball is there before bead i + 1
    first_of = np.concatenate([[0], np.cumsum([len(each) for each in points])]).astype(np.int64)
    tree = point_tree(np.concatenate(points), np.concatenate(radius), np.concatenate(time))
    return PrintBody(tree, first_of, tuple(names), len(bodies))


def _on_the_part(beads: Sequence[Bead]) -> list[Array]:
    """Places (n, 3) of the part one bead's height beneath each of the lowest beads.

    None where a bead's line lies on an earlier one, or on its own earlier turn, as a spiral's does: no part is there.
    """
    lying, found = contacts(beads), []
    for i, bead in enumerate(beads):
        places, share, _ = _rows(bead, 1.0)
        own = np.flatnonzero(lying.upper == i)
        turn = (lying.lower[own] != i) | (lying.at[own] - lying.below[own] > _TURN * float(bead.width.max()))
        own = own[
            turn & (lying.below[own] > 0.0)
        ]  # a line that climbs steeply does not lie on itself, nor on what is before its start
        own = own[_aside(bead, beads, lying, own) <= _LIES]
        if len(own):
            at, s = np.unique(lying.at[own]), share * bead.length
            k = np.searchsorted(at, s)
            away = np.minimum(np.abs(s - at[np.maximum(k - 1, 0)]), np.abs(s - at[np.minimum(k, len(at) - 1)]))
            places = places[away > _BETWEEN * float(lying.around[own].max())]
        found.append(places)
    return found


def _aside(bead: Bead, beads: Sequence[Bead], lying: BeadContacts, own: Ints) -> Array:
    """Lateral offsets (n) of some places of a bead from what they lie on, in widths of the latter."""
    tip, up = (_along(bead.s, values, lying.at[own]) for values in (bead.points, bead.normals))
    below, width = np.empty_like(tip), np.empty(len(own))
    for j in np.unique(lying.lower[own]):
        there, other = lying.lower[own] == j, beads[j]
        below[there] = _along(other.s, other.points, lying.below[own][there])
        width[there] = np.interp(lying.below[own][there], other.s, other.width)
    way = tip - below
    up = up / np.linalg.norm(up, axis=1)[:, None]
    return np.asarray(np.linalg.norm(way - (way * up).sum(axis=1)[:, None] * up, axis=1) / width)


def standing(cell: Cell) -> tuple[Body, ...]:
    """Bodies fixed in the part frame, given in it: plate, what it carries, and fixtures if nothing moves the part."""
    found = list(cell.carried)
    if cell.holder_robot is not None:
        T_part_plate = rigid_inverse(cell.T_plate_part)
        plate = bodies_with_tip(cell.holder_robot, cell.holder.names, cell.held)
        found += [Body(b.name, b.solid, T_part_plate @ b.T_frame_solid) for b in plate]
    if not len(cell.holder):
        T_part_world = rigid_inverse(cell.T_world_holder)
        found += [Body(b.name, b.solid, T_part_world @ b.T_frame_solid) for b in cell.fixtures]
    return tuple(found)


class TipRoom(NamedTuple):
    """Clearance that is not required near the tip, for beads or samples (n) [m]: `slack` and `graze` of a `TipRule`."""

    slack: Array
    graze: Array


def tip_room(problem: Problem, toolpath: Toolpath, nozzle: NozzleSpec | None = None) -> TipRoom:
    """Clearance that is not required next to each bead (n beads), of this nozzle or the one that lays the bead."""
    own = [nozzle or problem.nozzle_of(bead.material) for bead in toolpath.beads]
    sizes = [float((bead.height + bead.width).max()) for bead in toolpath.beads]
    slack = TIP_SLOPE * (np.array([nozzle_profile(each)[0][1] for each in own]) + np.array(sizes))
    return TipRoom(slack, _GRAZED * np.array([float(bead.height.max()) for bead in toolpath.beads]))


def _substrate(toolpath: Toolpath) -> Array | None:
    """Triangles (n, 3, 3) of the part's surface, if they are known."""
    if toolpath.solid is not None:
        return toolpath.solid
    shape = toolpath.shape
    return None if shape is None else np.asarray(shape.vertices[shape.triangles])


def _corners(body: Body) -> Array:
    vertices, triangles = triangles_of(body.solid)
    T = body.T_frame_solid
    return np.asarray((vertices @ T[:3, :3].T + T[:3, 3])[triangles])


def _sides(surfaces: Sequence[Array], near: Sequence[Flags], borne: float) -> tuple[float, float]:
    """Longest sides of triangles near beads and elsewhere [m], such that there are not too many points; near beads,
    their balls are no larger than `borne` [m] if possible."""
    areas = np.zeros(2)
    for pieces, by in zip(surfaces, near, strict=True):
        area = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
        areas += [float(area[by].sum()), float(area[~by].sum())]
    fine, coarse = np.sqrt(areas / (_MOST * CORNER_AREA)).tolist()
    most = math.sqrt((CLEARANCE + borne) ** 2 - CLEARANCE**2) / _SPREAD
    close = max(min(fine, most), math.sqrt(_MOST / _MOST_NEAR) * fine)
    return max(_FINE * min(1.0, borne / _FINE_ENOUGH), close), max(_COARSE, fine, coarse)


def _spread(pieces: Array, near: Flags, sides: tuple[float, float]) -> tuple[Array, Array]:
    """Points (n, 3) all over triangles (m, 3, 3), and how far (n) the surface that each stands for extends from it."""
    points, spread = [np.zeros((0, 3))], [np.zeros(0)]
    for which, side in ((near, sides[0]), (~near, sides[1])):
        if which.any():
            at, far = merged(split(pieces[which], side), MERGED * side)
            points.append(at)
            spread.append(far)
    return np.concatenate(points), np.concatenate(spread)


def _tips(bead: Bead) -> Array:
    """Places (n, 3) all along a bead, each at most _NEAR after the one before."""
    some = np.append(bead.s[:: max(1, len(bead.s) // _SOME)], bead.length)
    step, share = subdivided(np.maximum(np.ceil(np.diff(some) / _NEAR), 1.0).astype(np.int64))
    return _along(bead.s, bead.points, some[step] + share * (some[step + 1] - some[step]))


def _is_near(pieces: Array, tips: cKDTree) -> Flags:
    """Which triangles (n, 3, 3), no longer than _NEAR, have a place that is near a bead."""
    away, _ = tips.query(pieces.mean(axis=1), distance_upper_bound=2.0 * _NEAR)
    return np.asarray(np.isfinite(away))


def _onto(toolpath: Toolpath, points: Array) -> Array:
    """Points (n, 3) of a picture's triangles, moved onto the surface where they are near it."""
    surface = toolpath.surface.before(0)
    off = surface.signed_distance(points)
    near = np.flatnonzero((np.abs(off) <= _CHORD) & (np.abs(off) > _ON))
    out = points.copy()
    out[near] -= off[near, None] * surface.normals(points[near])
    return out


def _rows(bead: Bead, depth: float) -> tuple[Array, Array, Array]:
    """Centres (n, 3), fractions (n) of the bead's length and radii (n) of the balls that stand for a bead.

    depth: of the centres below the nozzle's tip, in heights of the bead.
    """
    thick = np.minimum(bead.height, bead.width)
    apart = _CAPSULE if bead.round else 1.0  # a strut's sides are exposed, a bead lies between its neighbours
    count = max(2, int(np.ceil(bead.length / (apart * float(thick.min())))) + 1)
    s = np.linspace(0.0, bead.length, count)
    point, normal = (_along(bead.s, values, s) for values in (bead.points, bead.normals))
    width, height = (np.interp(s, bead.s, values) for values in (bead.width, bead.height))
    radius = 0.5 * np.minimum(width, height)
    side = np.cross(normal, np.gradient(point, axis=0))
    side /= np.maximum(np.linalg.norm(side, axis=1), 1e-12)[:, None]
    beside = int(np.ceil((0.5 * width / radius - 1.0 - _OVERHANG).max(initial=0.0))) + 1
    room = np.maximum(0.5 * width - radius, 0.0) if beside > 1 else np.zeros(count)
    across = np.linspace(-1.0, 1.0, beside) if beside > 1 else np.zeros(1)
    middle = point - depth * height[:, None] * normal
    balls = middle[:, None] + across[:, None] * (room[:, None] * side)[:, None]
    return balls.reshape(-1, 3), np.repeat(s / bead.length, beside), np.repeat(radius, beside)


def _along(s: Array, values: Array, at: Array) -> Array:
    return np.column_stack([np.interp(at, s, values[:, k]) for k in range(3)])
