"""Aerofoil cores (Pollard et al., section 4.2): a pattern from a body's surface up to a middle, and its reflection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.problem import Problem
from planner.problem.cores import CoreLayersSpec
from planner.readonly import Array
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.laying import bead_along, densify
from planner.toolpath.ordering import shorten_travel
from planner.toolpath.paths import length
from planner.toolpath.rounding import PlaneCurve, round_corners
from planner.toolpath.substrate.bodies import FARTHEST_FROM_FACETS, reach_beside
from planner.toolpath.substrate.core_surface import REFLECTED, CoreSurface, Level, even_levels, varying_levels
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.substrate.projection import REACH, RESERVE, paths_of, placed, smooth_top, top_facets
from planner.toolpath.substrate.trimming import trim_curve, trim_path
from planner.toolpath.svg import PlanePath
from planner.toolpath.transport import roll_zeros

_LEAST = 0.2  # of the height of layers: where they were less high, they are left out
_SHORTEST = 3.0  # bead widths: a shorter piece of a layer is left out
_STEEPER = np.radians(5.0)  # by which a facet may lean more than layers: the smooth surface decides
_FARTHER = np.radians(15.0)  # likewise for what the smooth surface is laid through
_PART = 0.5  # of the least room: with less, the surface is about to end in an edge
_MIDDLE = "layers.up_to.mesh.file"


@dataclass(frozen=True)
class _Space:
    """The facets of the body and of the middle, or the middle's height [m]."""

    body: FacetTree
    middle: FacetTree | float

    def room(self, plane: Array, steepest: float) -> Array:
        """Height (n,) of the middle above the body at x, y (n, 2) [m]; -inf beside them and where the body is steeper."""
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
    trimmed, least = _trimmed(problem, spec, space, paths)
    trimmed = [path for path in trimmed if length(path.points) >= shortest]
    if not trimmed:
        raise _no_room(problem, "all pieces of the pattern within the core are too short")
    surface = _surface(problem, spec, space, trimmed, least)
    curves = [_rounded(problem, surface, path) for path in trimmed]

    rows: list[list[PlaneCurve]] = []
    left_out: list[float] = []
    laid: list[Level] = []
    for level in _levels(spec, max(float(surface.room(curve.points).max()) for curve in curves)):
        pieces, short = _pieces(surface, level, curves, spec.tilt, shortest)
        left_out += short
        if not pieces:
            continue
        rows.append(shorten_travel(pieces, rows[-1][-1].points[-1] if rows else None))
        laid.append(level)
        if len(rows) == spec.count:
            break
    if not rows:
        raise _no_room(problem, "no layer has a piece that is long enough")
    surface = replace(surface, levels=tuple(laid))
    share = process.bead.height / spec.height
    beads = _lay(surface, rows, process.bead.width, share)
    surface = replace(surface, layers=tuple(bead.layer for bead in beads))
    body = surface.body
    return Toolpath(tuple(beads), surface, body.shape(), _notes(left_out, shortest), body.facets.corners)


def _space(problem: Problem, spec: CoreLayersSpec) -> _Space:
    """Body and middle from their files."""
    part = problem.part
    if part is None or part.mesh is None:
        raise problem.error("part", "is missing", "the mesh whose upper side is the core's lower surface")
    body = top_facets(part.mesh, partial(problem.error, "part.mesh.file"))
    if spec.up_to.mesh is not None:
        return _Space(body, top_facets(spec.up_to.mesh, partial(problem.error, _MIDDLE)))
    if spec.up_to.z is None:
        raise problem.error("layers.up_to", "is empty", "z_mm or mesh")
    return _Space(body, spec.up_to.z)


def _trimmed(
    problem: Problem, spec: CoreLayersSpec, space: _Space, paths: Sequence[PlanePath]
) -> tuple[list[PlanePath], float]:
    """What of the paths lies where there may be layers, and the least room there [m]."""
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
        hint = "the middle of the curves, x and y of the part frame"
        raise problem.error("layers.centre_mm", f"no curve falls onto the {what}", hint)
    for path, points, found in zip(paths, dense, below, strict=True):
        if not found.all():
            x, y = points[int(np.argmin(found))] * 1e3
            reason = f"path {path.name!r} leaves the {what} at x {x:.1f}, y {y:.1f} mm"
            raise problem.error(field, reason, "make the pattern smaller or move it (layers.centre_mm)")


def _no_room(problem: Problem, reason: str) -> Exception:
    hint = "a layer needs as much room; choose a lesser height, a greater tilt_deg, or another up_to"
    return problem.error("layers.height_mm", f"there is room for no layer: {reason}", hint)


def _surface(
    problem: Problem, spec: CoreLayersSpec, space: _Space, paths: Sequence[PlanePath], least: float
) -> CoreSurface:
    """Body and middle as smooth surfaces with the same knots, near paths that keep `least` [m] between them."""

    def part(plane: Array) -> NDArray[np.bool_]:
        return np.asarray(space.room(plane, spec.tilt + _FARTHER) >= _PART * least)

    near = np.vstack([densify(path.points) for path in paths])
    reach = REACH * problem.process.bead.width
    for facets in (space.body, space.middle):
        if isinstance(facets, FacetTree):
            reach = reach_beside(facets, near, reach)
    body = smooth_top(space.body, near, reach, partial(problem.error, "part.mesh.file"), part)
    lower = body.surface
    if isinstance(space.middle, float):
        middle = lower.level(space.middle)
    else:
        middle = smooth_top(space.middle, near, reach, partial(problem.error, _MIDDLE), part).surface
        if middle.step < lower.step:
            lower = lower.refined(middle)
        middle = middle.refined(lower)
    upright = float(np.cos(spec.tilt + _STEEPER))
    return CoreSurface(body, lower, middle, least, upright, (), (), 0, {})


def _rounded(problem: Problem, surface: CoreSurface, path: PlanePath) -> PlaneCurve:
    """The path with its corners rounded within the tolerance in all layers.

    None leans more than the body or the body's reflection does.
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
    """What of the curves is laid in a layer, and the lengths of pieces that are too short for that [m]."""
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


def _lay(surface: CoreSurface, rows: Sequence[Sequence[PlaneCurve]], width: float, share: float) -> list[Bead]:
    """Beads `width` [m] wide and `share` times as high as their layers, those of one layer after another."""
    fields = [surface.field(level) for level in surface.levels]
    placed_on = [(layer, curve, *fields[layer].at(curve.points)) for layer, row in enumerate(rows) for curve in row]
    zeros = roll_zeros([normals for _, _, _, normals in placed_on])
    beads = []
    for (layer, curve, points, normals), zero in zip(placed_on, zeros, strict=True):
        level = surface.levels[layer]
        high = level.height + level.share * surface.room(curve.points)
        source, high = fields[layer].at(densify(curve.source))[0], share * high * normals[:, 2]
        beads.append(bead_along(curve, layer, points, normals, zero, source, width, high))
    return beads


def _notes(left_out: Sequence[float], shortest: float) -> tuple[str, ...]:
    if not left_out:
        return ()
    total, count = sum(left_out) * 1e3, len(left_out)
    pieces = "1 piece" if count == 1 else f"{count} pieces"
    return (f"{pieces} of layers shorter than {shortest * 1e3:g} mm left out, {total:.1f} mm in all",)
