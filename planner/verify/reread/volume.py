"""Filled meshes read again: layer heights from the facets, and each layer's outline from lines through the body.

Vertical lines all over the body show the heights at which it is entered and left. They give a layer's outline to within
their spacing; walls and infill are compared with it. Lengths are in metres in the part frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from planner.base.arrays import Array, Flags
from planner.base.errors import InputError
from planner.plan import Check
from planner.problem.layers import GuideSpec, VolumeLayersSpec
from planner.verify.checks import EVERYWHERE, Judged
from planner.verify.reread.areas import depth_of
from planner.verify.reread.facets import Crossings, Facets, facets_of
from planner.verify.reread.harmonic import LevelsOff, levels_off
from planner.verify.reread.places import (
    INSIDE,
    OFF_LEVEL,
    ON_PART,
    AskedPlaces,
    Places,
    begun_layers,
    by_number,
    filled,
    not_read,
    worst_of,
)
from planner.verify.reread.slopes import SEEN, Heights, axis_along, normals_over, off_facets

_PITCH = 1.0 / 3.0  # bead widths between lines through the body
_AROUND = 3.0  # bead widths that the lines reach beyond the body
_MOST = 160_000  # most lines
_KNOWN = 0.9  # × the lines: if fewer are known, the file has too many holes
_BEND = 0.2  # × (greatest - least height of a layer): range over which heights blend into the least
_BENT = 0.16  # × that range: greatest distance of the blend from the larger of the two
_UNSURE = 0.02  # layers: uncertainty of the body's height
_MORE = 2  # × the number of layers of even height: most that a harmonic field may have
_LIKELY = 2  # likeliest of these numbers, by layers of even height, for which the field is solved
_NEAR = 0.75  # bead widths: a place of a wall counts as filled this near to a middle line
_LINES = 1.5  # × the spacing of infill lines: greatest hole between them
_SPREAD = 1.6  # × that in sparse infill, where turns count as filling and lines lie farther apart
_DENSE = 0.05  # × the required amount: beads may hold this much less than the notes report
_TELLS = 0.95  # × the required amount: notes report a share below this
_STEEPEST = 0.2  # least upward component of normals


@dataclass(frozen=True)
class BodyFacets:
    """A body's facets, and vertical lines through it on a grid.

    low       x and y of the first line [m]; pitch: distance between lines
    shape     number of lines along x and along y; plane (n, 2): x and y of each
    lines     their crossings
    """

    facets: Facets
    low: Array
    pitch: float
    shape: tuple[int, int]
    plane: Array
    lines: Crossings

    @classmethod
    def of(cls, facets: Facets, width: float) -> BodyFacets:
        """With lines a share of a bead's width apart, or farther through a large body."""
        corners = facets.corners.reshape(-1, 3)[:, :2]
        low, high = corners.min(axis=0) - _AROUND * width, corners.max(axis=0) + _AROUND * width
        pitch = max(_PITCH * width, float(np.sqrt(np.prod(high - low) / _MOST)))
        axes = [np.arange(a, b + pitch, pitch) for a, b in zip(low, high, strict=True)]
        plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        return cls(facets, low, pitch, (len(axes[0]), len(axes[1])), plane, facets.crossings(plane))

    def depths(self, z: Array) -> tuple[Array, Flags]:
        """Depth (shape) [m] of lines within the body's outline at heights z (n), and whether that is known."""
        inside, known = self.lines.inside(np.nan_to_num(z, nan=-1.0))
        inside &= ~np.isnan(z)
        steps = (self.pitch, self.pitch)
        return depth_of(inside.reshape(self.shape), steps), known.reshape(self.shape)

    def at(self, values: Array, plane: Array) -> Array:
        """Values on the grid (shape), interpolated linearly at x, y (n, 2)."""
        return np.asarray(map_coordinates(values, ((plane - self.low) / self.pitch).T, order=1, mode="nearest"))


@dataclass(frozen=True)
class Stack:
    """Layers from a lower surface to an upper one, `count` where these are farthest apart; heights [m].

    off: offset from an even share, for levels of a harmonic field
    """

    lower: Heights
    upper: Heights
    count: int
    greatest: float
    least: float
    off: LevelsOff | None = None

    def thickness(self, plane: Array) -> tuple[Array, Array]:
        """Thickness of layers at x, y (n, 2), and its uncertainty where it blends into the least one [m]."""
        share = (self.upper(plane) - self.lower(plane)) / self.count
        reach = _BEND * (self.greatest - self.least)
        bent = np.where(np.abs(share - self.least) < reach, _BENT * reach, 0.0)
        return np.maximum(share, self.least) + 0.5 * bent, 0.5 * bent

    def above_lower(self, plane: Array, level: Array) -> Array:
        """Height (n) [m] above the lower surface of the top of `level` (n) layers at x, y (n, 2)."""
        even = level * self.thickness(plane)[0]
        return even if self.off is None else even + self.off.at(plane, level / self.count)

    def at(self, level: float) -> Heights:
        """Heights of the surface on top of `level` layers."""
        return lambda plane: self.lower(plane) + self.above_lower(plane, np.full(len(plane), level))

    def harmonic(self, low: Array, high: Array) -> Stack:
        """Levels of the harmonic field from the lower surface to the last layer, over a body from low to high (2)."""
        return replace(self, off=levels_off(self.lower, self.at(float(self.count)), low, high))


def volume(judged: Judged, places: Places) -> Iterator[Check]:
    """All checks of a mesh filled with layers; none for other prints."""
    spec, width = judged.problem.layers, judged.problem.process.bead.width
    if not isinstance(spec, VolumeLayersSpec):
        return
    try:
        body = BodyFacets.of(facets_of(spec.source.file), width)
        lower, upper = _guide(spec.lower, body, "lower"), _guide(spec.upper, body, "upper")
    except (InputError, OSError) as error:
        yield not_read(str(error))
        return
    stack = _stack(spec, body, lower, upper, places)
    if stack is None:
        yield not_read("no layer lies between the lower and the upper surface")
        return
    yield from _heights(judged, stack, places)
    layers = dict(_layers(body, stack, int(places.layer.max()), width, off_facets(judged)))
    known = float(np.mean([layer.known.mean() for layer in layers.values()]))
    if known < _KNOWN:
        yield Check(INSIDE, 0.0, 0.0, "mm", True, f"not read again: {1.0 - known:.0%} of lines end inside the body")
        return
    yield from _outlines(judged, spec, body, stack, layers, places)


def _guide(spec: GuideSpec | None, body: BodyFacets, which: str) -> Heights:
    """Heights of the surface at which layers begin or end."""
    if spec is not None and spec.mesh is not None:
        facets = facets_of(spec.mesh)
        return lambda plane: facets.top(plane)[0]
    if spec is not None and spec.z is not None:
        z = spec.z
        return lambda plane: np.full(len(plane), z)
    if which == "upper":
        return lambda plane: body.facets.top(plane)[0]
    lowest = float(body.facets.corners[:, :, 2].min())
    return lambda plane: np.full(len(plane), lowest)


def _stack(spec: VolumeLayersSpec, body: BodyFacets, lower: Heights, upper: Heights, places: Places) -> Stack | None:
    """The layers; where a hair of the body's height decides their number, the one that fits most tips."""
    there = ~np.isnan(body.lines.top()[0])
    gap = (upper(body.plane) - lower(body.plane))[there]
    most = float(np.nanmax(np.append(gap, 0.0)))
    some = places.few(SEEN)
    fewest, last = (int(np.ceil(most / spec.height + hair)) for hair in (-_UNSURE, _UNSURE))
    harmonic = spec.transition == "harmonic"
    counts = range(max(fewest, 1), (_MORE * last if harmonic else last) + 1)

    def usual(stack: Stack) -> float:
        off = np.abs(_off(stack, some)[0])
        return float(np.nanmedian(np.append(off, 1.0) if np.isnan(off).all() else off))

    stacks = sorted((Stack(lower, upper, count, spec.height, spec.thinnest) for count in counts), key=usual)
    if not stacks or not harmonic:
        return stacks[0] if stacks else None
    corners = body.facets.corners.reshape(-1, 3)[:, :2]
    ends = corners.min(axis=0), corners.max(axis=0)
    return min((stack.harmonic(*ends) for stack in stacks[:_LIKELY]), key=usual)


def _off(stack: Stack, places: Places) -> tuple[Array, Array]:
    """How far (n) [m] tips are above their layers, along z, and the uncertainty of that."""
    plane, level = places.tip[:, :2], np.asarray(places.layer + 1.0, dtype=float)
    return places.tip[:, 2] - stack.lower(plane) - stack.above_lower(plane, level), level * stack.thickness(plane)[1]


def _heights(judged: Judged, stack: Stack, places: Places) -> Iterator[Check]:
    """Layers are at their required heights, and the nozzle is normal to them."""
    off, unsure = _off(stack, places)
    some = places.few(SEEN)
    normals = np.full((3, len(some.tip), 3), np.nan)
    for k, own in by_number(some.layer):
        normals[:, own] = normals_over(stack.at(k + 1.0), some.tip[own, :2])
    normals[:, stack.thickness(some.tip[:, :2])[1] > 0.0] = np.nan  # only the planner knows how heights blend there
    upright = np.interp(places.sample, some.sample, np.nan_to_num(normals[1, :, 2], nan=1.0))
    off = np.maximum(np.abs(off) - unsure, 0.0) * np.maximum(upright, _STEEPEST)
    bound = off_facets(judged) + OFF_LEVEL
    yield worst_of(judged, places, ON_PART, np.nan_to_num(off) * 1e3, bound * 1e3, "mm")
    yield axis_along(judged, some, normals)


@dataclass(frozen=True)
class _Layer:
    """A layer's outline halfway up: least and greatest depth (grid) [m] of lines within it; z (grid) of its surface."""

    depth: Array
    perhaps: Array
    known: Flags
    z: Array

    @classmethod
    def of(cls, body: BodyFacets, stack: Stack, layer: int, off: float) -> _Layer:
        level = layer + 0.5
        by, middle = level * stack.thickness(body.plane)[1] + off, stack.at(level)(body.plane)
        found = [body.depths(middle + sense * by) for sense in (-1.0, 1.0)]
        steps = (body.pitch, body.pitch)
        here = [depth > 0.0 for depth, _ in found]
        surely, perhaps = (depth_of(each, steps) for each in (here[0] & here[1], here[0] | here[1]))
        z = stack.at(layer + 1.0)(body.plane).reshape(body.shape)
        return cls(surely, perhaps, found[0][1] & found[1][1], z)


def _layers(body: BodyFacets, stack: Stack, last: int, width: float, off: float) -> Iterator[tuple[int, _Layer]]:
    """The layers from the first to the last printed, and further ones as long as a bead fits into them."""
    for k in itertools.count():
        layer = _Layer.of(body, stack, k, off)
        if k > last and not ((layer.depth >= 0.5 * width) & layer.known).any():
            return
        yield k, layer


def _outlines(
    judged: Judged, spec: VolumeLayersSpec, body: BodyFacets, stack: Stack, layers: dict[int, _Layer], places: Places
) -> Iterator[Check]:
    """Beads lie within their layers' outlines, walls are there, and the inside is as dense as required."""
    process, told, width = judged.problem.process, judged.toolpath.told, judged.problem.process.bead.width
    within = np.empty(len(places.tip))
    for k, own in by_number(places.layer):
        within[own] = body.at(layers[k].perhaps, places.tip[own, :2])
    limit = process.corner_tolerance + 2.0 * body.pitch + process.chord_tolerance
    most = 0.5 * (width + body.pitch)  # a middle line lies inside, as far as the grid can resolve
    beyond = np.maximum(0.5 * width - within, 0.0)
    yield worst_of(judged, places, INSIDE, beyond * 1e3, min(limit, most) * 1e3, "mm")

    begun, asked = begun_layers(judged), {}
    near = _NEAR * width + 0.5 * body.pitch
    apart = width / spec.infill.density
    hole = (_SPREAD if spec.infill.density < 1.0 else 1.0) * _LINES * 0.5 * apart + near
    for k, layer in layers.items():
        walled = (layer.depth >= 0.5 * width) & (layer.depth <= spec.perimeters * width) & layer.known
        inner = (layer.depth >= (spec.perimeters + 0.5) * width) & layer.known
        if k not in begun:
            wanted = walled | inner
            points = np.column_stack([body.plane, layer.z.ravel()])[wanted.ravel()]
            reach = np.where(walled, near, hole)[wanted]
            asked[k] = AskedPlaces(points, np.ones(len(points)), reach, float(max((layer.depth > 0.0).sum(), 1)))
    yield filled(places, asked, min(told.left_out, spec.source.crumbs) + told.open)
    if not begun:
        yield _as_dense(judged, spec, body, layers)


def _as_dense(judged: Judged, spec: VolumeLayersSpec, body: BodyFacets, layers: dict[int, _Layer]) -> Check:
    """The share of the area required by walls and infill that beads cover, in the plane."""
    width, told = judged.problem.process.bead.width, judged.toolpath.told
    wanted = 0.0
    for layer in layers.values():
        whole, inner = (layer.depth > 0.0).sum(), (layer.depth > spec.perimeters * width).sum()
        wanted += float(whole - (1.0 - spec.infill.density) * inner) * body.pitch**2
    t, tip = judged.trajectory, judged.motion.tip
    on = t.deposit[1:] & t.deposit[:-1] & (t.bead[1:] == t.bead[:-1])
    laid = width * float(np.linalg.norm(np.diff(tip[:, :2], axis=0), axis=1)[on].sum())
    least = min(told.held, _TELLS) - _DENSE
    share = laid / max(wanted, 1e-12)
    return Check("layers as dense as asked", share, least, "of what is asked", share >= least, EVERYWHERE, least=True)
