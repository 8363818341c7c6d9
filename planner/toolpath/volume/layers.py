"""From a closed mesh to curved layers between two surfaces: walls and infill, each layer on the one before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely

from planner.errors import Complaint
from planner.facets import read_facets
from planner.problem import Problem
from planner.problem.volume import VolumeLayersSpec
from planner.readonly import Array
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.laying import bead_along, densify
from planner.toolpath.ordering import shorten_travel
from planner.toolpath.paths import length, seam_on_smooth_part
from planner.toolpath.rounding import PlaneCurve, round_corners
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.substrate.height_field import HeightField
from planner.toolpath.svg import PlanePath
from planner.toolpath.transport import roll_zeros
from planner.toolpath.volume.fill import walls, zigzag
from planner.toolpath.volume.guides import stack_of
from planner.toolpath.volume.morph import Morph, MorphedLayers
from planner.toolpath.volume.solid import NotClosed, Solid, TooFine

_GRID = 120  # places along the body's longer side at which the tilt is looked at
_CUT = 1e-3  # m: longest edge of the facets that are bent with the layers; 1.3 um off them where 100 mm is their radius
_SHORTEST = 3.0  # bead widths: a shorter path is left out
_RESERVE = 1.02  # the stretch varies within a tolerance
_BELOW = 1e-5  # m by which a body may reach below the bed: rounding
_MOST_LAYERS = 2000


@dataclass(frozen=True)
class _Line:
    """A rounded path, and its material where that is not the layers'."""

    curve: PlaneCurve
    material: str


def fill_mesh(problem: Problem, spec: VolumeLayersSpec) -> Toolpath:
    """Cut a closed mesh by layers that change from its lower surface to its upper one, and fill each of them.

    Raises InputError for a mesh that is not closed, surfaces that are not one above the other, layers that are too
    steep, and where nothing is long enough to be printed.
    """
    complain = partial(problem.error, "layers.source.mesh")
    name = spec.source.mesh.name
    corners = read_facets(spec.source.file, complain)
    solid = _solid(corners, name, complain)
    morph, base = stack_of(problem, spec, solid, FacetTree.of(corners))
    longest = max(_CUT, float(np.ptp(solid.vertices[:, :2], axis=0).max()) / 400.0)
    try:
        fine = solid.finer(longest)
    except TooFine as error:
        raise complain(f"{name} takes {error} to be cut finely", "a mesh of fewer facets") from None
    regions = _regions(problem, spec, morph, fine)
    _check_tilt(problem, spec, morph, regions)
    rows, left_out = _rows(problem, spec, morph, regions)
    if not rows:
        reason = (
            f"nothing in {name} is long enough to be printed with a bead {problem.process.bead.width * 1e3:g} mm wide"
        )
        raise problem.error("process.bead.width_mm", reason, "a narrower bead, or a larger part")
    beads = _lay(morph, rows, problem.process.bead.width, problem.process.bead.height / spec.height)
    surface = MorphedLayers(morph, base, tuple(regions), tuple(bead.layer for bead in beads))
    shape, beneath = (None, None) if base is None else (base.shape(), base.facets.corners)
    return Toolpath(tuple(beads), surface, shape, _notes(name, morph, len(rows), regions, beads, left_out), beneath)


def _solid(corners: Array, name: str, complain: Complaint) -> Solid:
    try:
        solid = Solid.of(corners)
    except NotClosed as error:
        x, y, z = error.place * 1e3
        raise complain(
            f"{name} is not closed: an edge at x {x:.2f}, y {y:.2f}, z {z:.2f} mm has not one facet to either side",
            "mend it in a CAD or mesh program: what is inside must be known",
        ) from None
    if solid.volume <= 0.0:
        raise complain(f"{name} is inside out: its facets face inwards", "flip its normals in a CAD program")
    lowest = float(solid.vertices[:, 2].min())
    if lowest < -_BELOW:
        raise complain(
            f"{name} reaches {-lowest * 1e3:.3f} mm below the bed",
            "raise it by layers.source.origin_mm: z = 0 is the bed",
        )
    return solid


def _regions(problem: Problem, spec: VolumeLayersSpec, morph: Morph, fine: Solid) -> list[shapely.MultiPolygon]:
    """What each layer covers in the plane: the body halfway up the layer. None is empty."""
    levels = morph.levels(fine.vertices)
    count = int(np.floor(levels.max() + 0.5))
    if count > _MOST_LAYERS:
        reason = f"the body takes {count} layers"
        raise problem.error("layers.height_mm", reason, f"{_MOST_LAYERS} at most: higher layers")
    found = [fine.section(levels, layer + 0.5) for layer in range(count)]
    regions = [region for region in found if not region.is_empty]
    if not regions or any(region.is_empty for region in found[: len(regions)]):
        field = "layers.lower" if spec.lower is not None else "layers.height_mm"
        reason = "no layer lies within the body" if not regions else "the lowest layers lie below the body"
        raise problem.error(field, reason, "the lower surface where the body begins, or less high layers")
    return regions


def _check_tilt(
    problem: Problem, spec: VolumeLayersSpec, morph: Morph, regions: Sequence[shapely.MultiPolygon]
) -> None:
    """Raise InputError where a layer is steeper than is allowed."""
    low, high = morph.lower.span
    axes = [np.linspace(a, b, _GRID) for a, b in zip(low, high, strict=True)]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    for layer, region in enumerate(regions):
        there = plane[shapely.contains_xy(region, plane[:, 0], plane[:, 1])]
        if len(there) == 0:
            continue
        tilt = np.arccos(np.clip(morph.field(layer + 1).at(there)[1][:, 2], -1.0, 1.0))
        worst = int(np.argmax(tilt))
        if tilt[worst] > spec.tilt:
            x, y = there[worst] * 1e3
            raise problem.error(
                "layers.tilt_deg",
                f"layer {layer + 1} tilts by {np.degrees(tilt[worst]):.1f} degrees at x {x:.1f}, y {y:.1f} mm, "
                f"more than {np.degrees(spec.tilt):g}",
                "a greater tilt_deg, or flatter surfaces in layers.lower and layers.upper",
            )


def _rows(
    problem: Problem, spec: VolumeLayersSpec, morph: Morph, regions: Sequence[shapely.MultiPolygon]
) -> tuple[list[list[_Line]], list[float]]:
    """The rounded paths of each layer in print order, and the lengths of those that are too short [m]."""
    process = problem.process
    width, shortest = process.bead.width, _SHORTEST * process.bead.width
    lines_of = spec.infill.material or ""
    apart = lines_of not in ("", spec.material or next(iter(process.materials), ""))
    rows: list[list[_Line]] = []
    short: list[float] = []
    for layer, region in enumerate(regions):
        surface = morph.field(layer + 1)
        name = f"layer {layer + 1}"
        angle = spec.infill.angle + (0.5 * np.pi if layer % 2 else 0.0)
        outlines = walls(region, width, spec.perimeters, process.chord_tolerance, name)
        lines = zigzag(region, width, spec.perimeters, spec.infill.density, angle, name)
        groups = [(outlines, ""), (lines, lines_of)]
        if apart and layer % 2:  # so that the material changes once a layer
            groups.reverse()
        row: list[_Line] = []
        for paths, material in groups:
            short += [size for size in (length(path.points) for path in paths) if size < shortest]
            long = [path for path in paths if length(path.points) >= shortest]
            curves = [_rounded(path, surface, process.corner_tolerance) for path in long]
            before = row or (rows[-1] if rows else [])
            start = before[-1].curve.points[-1] if before else None
            row += [_Line(curve, material) for curve in shorten_travel(curves, start)]
        if not row:
            break  # what lies above would hang in the air
        rows.append(row)
    return rows, short


def _rounded(path: PlanePath, surface: HeightField, tolerance: float) -> PlaneCurve:
    """The path with its corners rounded within the tolerance on the layer's surface."""
    stretch = _RESERVE / float(surface.at(densify(path.points))[1][:, 2].min())
    start = seam_on_smooth_part(path) if path.closed else path
    return round_corners(start, tolerance, lambda points: np.full(len(points), 1.0 / stretch))


def _lay(morph: Morph, rows: Sequence[Sequence[_Line]], width: float, share: float) -> list[Bead]:
    """Beads `share` times as high as their layers, those of one layer after another.

    On a slope, lines that are `width` [m] apart in the plane are farther apart: beads are wider by as much.
    """
    fields = [morph.field(layer + 1) for layer in range(len(rows))]
    placed = [(layer, line, *fields[layer].at(line.curve.points)) for layer, row in enumerate(rows) for line in row]
    zeros = roll_zeros([normals for _, _, _, normals in placed])
    beads = []
    for (layer, line, points, normals), zero in zip(placed, zeros, strict=True):
        curve = line.curve
        along = np.gradient(points, axis=0)
        longer = np.linalg.norm(along, axis=1) / np.linalg.norm(along[:, :2], axis=1)
        thickness = morph.thickness.at(curve.points)[0][:, 2]
        source, wide = fields[layer].at(densify(curve.source))[0], width / (normals[:, 2] * longer)
        high = share * thickness * normals[:, 2]
        beads.append(bead_along(curve, layer, points, normals, zero, source, wide, high, line.material))
    return beads


def _notes(
    name: str,
    morph: Morph,
    rows: int,
    regions: Sequence[shapely.MultiPolygon],
    beads: Sequence[Bead],
    short: Sequence[float],
) -> tuple[str, ...]:
    """How high layers are, and what was left out."""
    high = np.concatenate([morph.thickness.at(bead.points[:, :2])[0][:, 2] for bead in beads]) * 1e3
    notes = [f"{name}: {rows} layers, {high.min():.3f} to {high.max():.3f} mm high along z"]
    if short:
        pieces = "1 path" if len(short) == 1 else f"{len(short)} paths"
        notes.append(f"{name}: {pieces} shorter than 3 bead widths left out, {sum(short) * 1e3:.1f} mm in all")
    if rows < len(regions):
        left = len(regions) - rows
        above = "1 layer" if left == 1 else f"{left} layers"
        notes.append(f"{name}: {above} left out from layer {rows + 1} on, too narrow for a bead")
    return tuple(notes)
