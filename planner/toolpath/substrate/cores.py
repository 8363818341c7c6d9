"""Aerofoil cores (Pollard et al., section 4.2): layers from a body up to a middle surface, and their reflection."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.problem import Problem
from planner.problem.layers import CoreLayersSpec
from planner.toolpath.bead import Bead, Told, Toolpath
from planner.toolpath.ordering import in_order
from planner.toolpath.plane_paths import PlaneCurve, densify, length, make_bead, round_corners
from planner.toolpath.substrate.clipping import share_words, trim_curve, trim_path
from planner.toolpath.substrate.mesh_surface import FacetTree, HeightField, LastTrees
from planner.toolpath.substrate.mesh_top import FARTHEST_FROM_FACETS, MeshTop, reach_beside
from planner.toolpath.substrate.projection import (
    REACH,
    RESERVE,
    nothing_falls,
    paths_of,
    placed,
    seen_from_above,
    size_key,
    smooth_top,
    top_facets,
)
from planner.toolpath.svg.outlines import PlanePath
from planner.toolpath.task import roll_zeros
from planner.toolpath.workload import check_curves

_PITCH = 1e-3  # m between corners of the facets that represent layers: 0.08 mm off them at a radius of 1.5 mm
_MOST_PITCHES = 300  # along the longer side
_WHOLE = 1e-9  # layers: up to this much above a whole number counts as that number

_LEAST = 0.2  # × the height of layers: where they would be lower, they are left out
_SHORTEST = 3.0  # bead widths: a shorter piece of a layer is left out
_STEEPER = np.radians(5.0)  # by which a facet may tilt more than layers: the smooth surface decides
_FARTHER = np.radians(15.0)  # likewise for facets that the smooth surface is fitted to
_PART = 0.5  # × the least room: with less, the surface is close to ending in an edge
_MIDDLE = "layers.up_to.mesh.file"


@dataclass(frozen=True)
class Level:
    """A layer of a core: nozzle tips at lower * (height of the body) + middle * (of the middle) + rise [m].

    room    least height of the middle above the body where it is laid [m]
    height  of the layer along z, plus `share` of the middle's height above the body [m]
    """

    lower: float
    middle: float
    rise: float
    room: float
    height: float
    share: float

    @property
    def above_middle(self) -> bool:
        """Whether it belongs to the reflected half."""
        return self.lower < 0.0


REFLECTED = Level(-1.0, 2.0, 0.0, 0.0, 0.0, 0.0)  # the body's own reflection in the middle: a core's upper surface


def even_levels(height: float, most: float, both: bool) -> list[Level]:
    """Layers of one height [m] where the middle is up to `most` [m] above the body, in print order.

    Those of the lower half end where they would reach beyond the middle. Their reflections begin half a layer earlier,
    so that the gap between the halves is everywhere less than a layer's height, and they never overlap.
    """
    lower = [
        Level(1.0, 0.0, (k + 1) * height, (k + 1) * height, height, 0.0) for k in range(int(most / height + _WHOLE))
    ]
    upper = [
        Level(-1.0, 2.0, -k * height, (k + 0.5) * height, height, 0.0) for k in range(int(most / height + 0.5 + _WHOLE))
    ]
    return lower + upper[::-1] if both else lower


def varying_levels(height: float, least: float, most: float, both: bool) -> list[Level]:
    """Layers that evenly divide the height between body and middle, up to `most` [m], none higher than `height`.

    They end where they would be lower than `least` [m].
    """
    count = int(np.ceil(most / height - _WHOLE))
    shares = [(k + 1) / count for k in range(2 * count if both else count)]
    return [Level(1.0 - share, share, 0.0, count * least, 0.0, 1.0 / count) for share in shares]


@dataclass(frozen=True)
class CoreSurface:
    """A body, and the layers of a core on it.

    lower, middle  heights of the body and of the middle, with the same knots
    least, upright least height of the middle above the body [m] and least upward component of its normals where the
                   core is; outside it, the heights are meaningless
    levels         of the layers that are laid, in print order
    layers         of all beads in print order
    solid          how many layers count as printed: beneath the layer being printed, the core has grown everywhere
    grown          its upper side as facets, computed on request
    """

    body: MeshTop
    lower: HeightField
    middle: HeightField
    least: float
    upright: float
    levels: tuple[Level, ...]
    layers: tuple[int, ...]
    solid: int
    grown: LastTrees = field(default_factory=LastTrees, compare=False)

    def before(self, bead: int) -> CoreSurface:
        """The surface after the first `bead` beads: the one on which the last one's layer lies."""
        return replace(self, solid=self.layers[bead - 1] if bead > 0 else 0)

    def field(self, level: Level) -> HeightField:
        """The nozzle tips of a layer."""
        heights = level.lower * self.lower.coefficients + level.middle * self.middle.coefficients + level.rise
        return HeightField(self.lower.corner, self.lower.step, heights)

    def room(self, plane: Array) -> Array:
        """Height (n,) of the middle above the body at x, y (n, 2) [m]."""
        return np.asarray(self.middle.at(plane)[0][:, 2] - self.lower.at(plane)[0][:, 2])

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from body and core; negative inside."""
        body, grown = self.body.signed_distance(points), self._grown()
        if grown is None:
            return body
        top, _ = grown.top(points[:, :2])
        return np.asarray(np.minimum(body, np.where(points[:, 2] < top, -1.0, 1.0) * grown.distance(points)))

    def normals(self, points: Array) -> Array:
        """Upward unit normals (n, 3) of the topmost layer above or below points (n, 3); straight up off the core."""
        top = self.lower if self.solid == 0 else self.field(self.levels[self.solid - 1])
        normals = top.at(points[:, :2])[1]
        normals[~self._there(points[:, :2])] = [0.0, 0.0, 1.0]
        return normals

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Upward unit normals (n, 3) of the layer of a bead above or below the tips (n, 3)."""
        return self.field(self.levels[self.layers[bead]]).at(tips[:, :2])[1]

    def _there(self, plane: Array) -> NDArray[np.bool_]:
        """Which of the places x, y (n, 2) lie within the core."""
        low, high = self.lower.span
        within = ((plane >= low) & (plane <= high)).all(axis=1)
        return np.asarray(within & (self.room(plane) >= self.least) & (self.lower.at(plane)[1][:, 2] >= self.upright))

    def _grown(self) -> FacetTree | None:
        """The layers on the body, filled up to the middle once the reflected half has begun; None before the first."""
        return self.grown.of(self.solid, self._facets) if self.solid else None

    def _facets(self) -> FacetTree | None:
        level = self.levels[self.solid - 1]
        low, high = self.lower.span
        pitch = max(_PITCH, float((high - low).max()) / _MOST_PITCHES)
        axes = [np.arange(a, b, pitch) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        plane = grid.reshape(-1, 2)
        layer, middle = self.field(level).at(plane)[0], self.middle.at(plane)[0][:, 2]
        layer[:, 2] = np.maximum(layer[:, 2], middle) if level.above_middle else np.minimum(layer[:, 2], middle)
        there = binary_dilation(self._there(plane).reshape(grid.shape[:2]))  # so that the rim is not cut off
        layer[~there.ravel()] = np.nan
        return FacetTree.over(layer.reshape(*grid.shape[:2], 3))


@dataclass(frozen=True)
class _Cavity:
    """The facets of the body and of the middle, or the middle's height [m]."""

    body: FacetTree
    middle: FacetTree | float

    def room(self, plane: Array, steepest: float) -> Array:
        """Height (n,) of the middle above the body at x, y (n, 2) [m]; -inf off them and where the body is steeper."""
        middle = self.middle if isinstance(self.middle, float) else self.middle.top(plane)[0]
        room = np.where(self.body.upward(plane) >= np.cos(steepest), middle - self.body.top(plane)[0], -np.inf)
        return np.where(np.isnan(room), -np.inf, room)


def lay_core(problem: Problem, spec: CoreLayersSpec) -> Toolpath:
    """Trim a pattern to where there is room for layers, round its corners and lay the layers of a core.

    Raises InputError for a pattern that leaves the part, a middle that is not above it, and where no layer has room.
    """
    process = problem.process
    paths = [placed(path, spec) for path in paths_of(problem, spec.source)]
    space = _space(problem, spec)
    shortest = _SHORTEST * process.bead.width
    found, least = _trimmed(problem, spec, space, paths)
    trimmed = [path for path in found if length(path.points) >= shortest]
    crumbs = [path for path in found if length(path.points) < shortest]
    if not trimmed:
        raise _no_room(problem, "all pieces of the pattern within the core are too short")
    check_curves(problem, [path.points for path in trimmed], 1, size_key(spec.source))
    surface, meshes = _surface(problem, spec, space, trimmed, least)
    curves = [_rounded(problem, surface, path) for path in trimmed]

    rows: list[list[PlaneCurve]] = []
    left_out: list[float] = []
    laid: list[Level] = []
    for level in _levels(spec, max(float(surface.room(curve.points).max()) for curve in curves)):
        pieces, short = _pieces(surface, level, curves, spec.tilt, shortest)
        left_out += [*short, *_lengths_within(space, level, crumbs, spec.tilt)]
        if not pieces:
            continue
        rows.append(in_order(pieces, process.order, rows[-1][-1].points[-1] if rows else None))
        laid.append(level)
        if len(rows) == spec.count:
            break
    if not rows:
        raise _no_room(problem, "no layer has a piece that is long enough")
    lost, kept = sum(left_out), sum(length(each.points) for row in rows for each in row)
    _check_left_out(problem, spec.source.crumbs, lost, kept)
    surface = replace(surface, levels=tuple(laid))
    share = process.bead.height / spec.height
    beads = _lay(surface, rows, process.bead.width, share)
    surface = replace(surface, layers=tuple(bead.layer for bead in beads))
    body = surface.body
    told = Told(lost / (lost + kept), off=body.told_gap)
    return Toolpath(
        tuple(beads), surface, body.shape(), _notes(meshes, left_out, shortest), body.facets.corners, told=told
    )


def _check_left_out(problem: Problem, most: float, lost: float, laid: float) -> None:
    """Raise InputError if pieces that are too short make up more than a share `most` of the length to be laid [m]."""
    if lost > most * (lost + laid):
        share = share_words(lost / (lost + laid))
        reason = f"{lost * 1e3:.1f} mm of the layers are in pieces too short for a bead"
        raise problem.error("layers.source", reason, f"layers.source.leave_out_share: {share} leaves them out")


def _space(problem: Problem, spec: CoreLayersSpec) -> _Cavity:
    """Body and middle from their files."""
    part = problem.part
    if part is None or part.mesh is None:
        raise problem.error("part", "is missing", "the mesh whose upper side is the core's lower surface")
    body = top_facets(part.mesh, partial(problem.error, "part.mesh.file"))
    if spec.up_to.mesh is not None:
        return _Cavity(body, top_facets(spec.up_to.mesh, partial(problem.error, _MIDDLE)))
    if spec.up_to.z is None:
        raise problem.error("layers.up_to", "is empty", "z_mm or mesh")
    return _Cavity(body, spec.up_to.z)


def _trimmed(
    problem: Problem, spec: CoreLayersSpec, space: _Cavity, paths: Sequence[PlanePath]
) -> tuple[list[PlanePath], float]:
    """The pieces of the paths where layers are possible, and the least room there [m]."""
    dense = [densify(path.points) for path in paths]
    _check_there(problem, "layers.source", "part", space.body, paths, dense)
    if isinstance(space.middle, FacetTree):
        _check_there(problem, _MIDDLE, "middle", space.middle, paths, dense)
    rooms = [space.room(points, spec.tilt + _STEEPER) for points in dense]
    most = max(float(room.max()) for room in rooms)
    if most == -np.inf:
        raise _no_room(problem, f"the part leans by more than {np.degrees(spec.tilt):g} degrees under the pattern")
    levels = _levels(spec, most)
    if not levels:
        raise _no_room(problem, f"the middle is at most {most * 1e3:.2f} mm above the part under the pattern")
    least = min(level.room for level in levels) - FARTHEST_FROM_FACETS
    pieces = [
        piece
        for path, points, room in zip(paths, dense, rooms, strict=True)
        for piece in trim_path(path, points, room >= least)
    ]
    return pieces, least


def _levels(spec: CoreLayersSpec, most: float) -> list[Level]:
    """All layers where the middle is up to `most` [m] above the body."""
    both = spec.halves == "both"
    if spec.heights == "even":
        return even_levels(spec.height, most, both)
    least = _LEAST * spec.height if spec.least_height is None else spec.least_height
    return varying_levels(spec.height, least, most, both) if most > 0.0 else []


def _check_there(
    problem: Problem, field: str, what: str, facets: FacetTree, paths: Sequence[PlanePath], dense: Sequence[Array]
) -> None:
    """Raise InputError where a path does not lie above (or below) facets."""
    below = [facets.top(points)[1] >= 0 for points in dense]
    if not any(found.any() for found in below):
        raise nothing_falls(problem, what, np.vstack(dense), seen_from_above(facets))
    for path, points, found in zip(paths, dense, below, strict=True):
        if not found.all():
            x, y = points[int(np.argmin(found))] * 1e3
            reason = f"path {path.name!r} leaves the {what} at x {x:.1f}, y {y:.1f} mm"
            raise problem.error(field, reason, "make the pattern smaller or move it (layers.centre_mm)")


def _no_room(problem: Problem, reason: str) -> Exception:
    hint = "a layer needs that much room; choose a smaller height, a greater tilt_deg, or another up_to"
    return problem.error("layers.height_mm", f"there is no room for a layer: {reason}", hint)


def _surface(
    problem: Problem, spec: CoreLayersSpec, space: _Cavity, paths: Sequence[PlanePath], least: float
) -> tuple[CoreSurface, dict[str, MeshTop]]:
    """Body and middle as smooth surfaces with the same knots near paths, and the meshes they are fitted to, by key.

    least: room between the two along the paths [m]
    """

    def part(plane: Array) -> NDArray[np.bool_]:
        return np.asarray(space.room(plane, spec.tilt + _FARTHER) >= _PART * least)

    near = np.vstack([densify(path.points) for path in paths])
    reach = REACH * problem.process.bead.width
    for facets in (space.body, space.middle):
        if isinstance(facets, FacetTree):
            reach = reach_beside(facets, near, reach)
    own = problem.part.mesh.smooth if problem.part is not None and problem.part.mesh is not None else None
    body = smooth_top(space.body, near, reach, own, partial(problem.error, "part.mesh.file"), part)
    lower, meshes = body.surface, {"part.mesh": body}
    if isinstance(space.middle, float):
        middle = lower.level(space.middle)
    else:
        bound = None if spec.up_to.mesh is None else spec.up_to.mesh.smooth
        top = smooth_top(space.middle, near, reach, bound, partial(problem.error, _MIDDLE), part)
        middle, meshes["layers.up_to.mesh"] = top.surface, top
        if middle.step < lower.step:
            lower = lower.refined(middle)
        middle = middle.refined(lower)
    upright = float(np.cos(spec.tilt + _STEEPER))
    return CoreSurface(body, lower, middle, least, upright, (), (), 0), meshes


def _rounded(problem: Problem, surface: CoreSurface, path: PlanePath) -> PlaneCurve:
    """The path with its corners rounded within the tolerance in all layers.

    No layer tilts more than the body or its reflection.
    """
    dense = densify(path.points)
    ends = (surface.lower, surface.field(REFLECTED))
    stretch = np.max([1.0 / field.at(dense)[1][:, 2] for field in ends], axis=0)
    tree = cKDTree(dense)
    tolerance = problem.process.corner_tolerance
    return round_corners(path, tolerance, lambda p: np.asarray(1.0 / (RESERVE * stretch[tree.query(p)[1]])))


def _pieces(
    surface: CoreSurface, level: Level, curves: Sequence[PlaneCurve], tilt: float, shortest: float
) -> tuple[list[PlaneCurve], list[float]]:
    """The pieces of the curves that are laid in a layer, and the lengths of those that are too short [m]."""
    field = surface.field(level)
    kept: list[PlaneCurve] = []
    short: list[float] = []
    for curve in curves:
        upward = field.at(curve.points)[1][:, 2]
        found = trim_curve(curve, (surface.room(curve.points) >= level.room) & (upward >= np.cos(tilt)))
        for number, piece in enumerate(found, 1):
            size = length(piece.points)
            if size < shortest:
                short.append(size)
            else:
                kept.append(piece if len(found) == 1 else replace(piece, name=f"{curve.name} piece {number}"))
    return kept, short


def _lengths_within(space: _Cavity, level: Level, paths: Sequence[PlanePath], tilt: float) -> Iterator[float]:
    """For each path that lies partly where a layer has room, the length of that part [m]."""
    for path in paths:
        there = space.room(densify(path.points), tilt + _STEEPER) >= level.room
        if there.any():
            yield length(path.points) * float(there.mean())


def _lay(surface: CoreSurface, rows: Sequence[Sequence[PlaneCurve]], width: float, share: float) -> list[Bead]:
    """Beads `width` [m] wide and `share` times as high as their layers, layer by layer."""
    fields = [surface.field(level) for level in surface.levels]
    placed_on = [(layer, curve, *fields[layer].at(curve.points)) for layer, row in enumerate(rows) for curve in row]
    zeros = roll_zeros([normals for _, _, _, normals in placed_on])
    beads = []
    for (layer, curve, points, normals), zero in zip(placed_on, zeros, strict=True):
        level = surface.levels[layer]
        high = level.height + level.share * surface.room(curve.points)
        source, high = fields[layer].at(densify(curve.source))[0], share * high * normals[:, 2]
        beads.append(make_bead(curve.name, layer, points, normals, zero, source, width, high, curve.closed))
    return beads


def _notes(meshes: dict[str, MeshTop], left_out: Sequence[float], shortest: float) -> tuple[str, ...]:
    notes = [f"{name}: {top.words}" for name, top in meshes.items() if top.words]
    if left_out:
        total, count = sum(left_out) * 1e3, len(left_out)
        pieces = "1 piece" if count == 1 else f"{count} pieces"
        notes.append(f"{pieces} of layers shorter than {shortest * 1e3:g} mm left out, {total:.1f} mm in all")
    return tuple(notes)
