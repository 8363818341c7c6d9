"""Drawings wrapped around a cylinder, in layers (Pollard et al., eq. 2): x becomes angle, y becomes height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from planner.base.arrays import Array
from planner.problem import Problem
from planner.problem.drawings import DxfSpec, LayersSpec, WrappedDxfSpec
from planner.toolpath.bead import Bead, Told, Toolpath, cylinder_shape
from planner.toolpath.dxf.reader import read_dxf
from planner.toolpath.ordering import rows_of_layers
from planner.toolpath.plane_paths import (
    PlaneCurve,
    check_size,
    densify,
    length,
    make_bead,
    round_corners,
    with_seam,
)
from planner.toolpath.substrate.clipping import SHORT, Clipped, Cut, vanishes
from planner.toolpath.svg.outlines import PlanePath, read_svg_once
from planner.toolpath.workload import check_curves


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder on the part frame's xy plane; lengths in metres.

    centre (2) of its axis in the part frame, which need not be the axis of the table
    """

    radius: float
    height: float
    centre: Array

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the solid cylinder; negative inside."""
        radial = np.hypot(points[:, 0] - self.centre[0], points[:, 1] - self.centre[1]) - self.radius
        axial = np.abs(points[:, 2] - 0.5 * self.height) - 0.5 * self.height
        outside = np.hypot(np.maximum(radial, 0.0), np.maximum(axial, 0.0))
        return outside + np.minimum(np.maximum(radial, axial), 0.0)

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the lateral surface at points (n, 3)."""
        d = points[:, :2] - self.centre
        d = d / np.hypot(d[:, 0], d[:, 1])[:, None]
        return np.column_stack([d, np.zeros(len(d))])

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """The lateral surface's normals at the tips (n, 3), whatever bead is laid there."""
        return self.normals(tips)

    def before(self, bead: int) -> Cylinder:
        """The bare cylinder, whatever has been printed on it."""
        return self

    def wrap(self, plane: Array, rise: float) -> tuple[Array, Array, Array]:
        """Points, normals and upright directions (n, 3) of plane points (n, 2), `rise` above the lateral surface.

        The plane's origin maps to half the cylinder's height at angle 0; x is arc length on the bare lateral surface.
        """
        angle = plane[:, 0] / self.radius
        c, s, zero = np.cos(angle), np.sin(angle), np.zeros(len(plane))
        r = self.radius + rise
        z = plane[:, 1] + 0.5 * self.height
        points = np.column_stack([self.centre[0] + r * c, self.centre[1] + r * s, z])
        return points, np.column_stack([c, s, zero]), np.column_stack([zero, zero, zero + 1.0])


def wrap_layer(
    curves: Sequence[PlaneCurve], cylinder: Cylinder, layer: int, layer_height: float, width: float, height: float
) -> list[Bead]:
    """Beads of one layer: layer k's nozzle tip runs k + 1 layer heights above the lateral surface."""
    rise = (layer + 1) * layer_height
    beads = []
    for curve in curves:
        points, normals, upright = cylinder.wrap(curve.points, rise)
        source, _, _ = cylinder.wrap(densify(curve.source), rise)
        beads.append(make_bead(curve.name, layer, points, normals, upright, source, width, height, curve.closed))
    return beads


def wrap_drawing(problem: Problem, spec: LayersSpec | WrappedDxfSpec) -> Toolpath:
    """Round a drawing's corners, order its beads and lay the layers around the part."""
    part = problem.part
    if part is None or part.cylinder is None:
        raise problem.error("part", "is missing", "the body to wrap around: cylinder")
    process = problem.process
    cylinder = Cylinder(part.cylinder.radius, part.cylinder.height, np.asarray(part.cylinder.centre))
    paths, told = drawn_paths(problem, spec)
    _check_fit(problem, paths, cylinder)

    # x is longest on the outermost layer. With corners rounded once, in that layer's metric, all layers keep the
    # tolerance, have the same shape, and lie exactly above each other.
    stretch = np.array([1.0 + spec.count * spec.height / cylinder.radius, 1.0])
    clipped = Clipped.of([replace(path, points=path.points * stretch) for path in paths], process.bead.width)
    _check_left_out(problem, spec, clipped)
    check_curves(problem, [path.points for path in clipped.paths], spec.count, "layers.source.width_mm")
    curves, cuts = [], list(clipped.cuts)

    def on_layer(points: Array) -> Array:
        return cylinder.wrap(points / stretch, spec.height)[0]

    for path in clipped.paths:
        curve = round_corners(with_seam(path, process.seam, on_layer), process.corner_tolerance)
        if vanishes(path.points, curve.points, process.bead.width):
            cuts.append(Cut(path.name, SHORT, path.points))
            continue
        wider = "choose a smaller tolerance, or a greater layers.source.width_mm"
        check_size(problem, path.name, length(path.points), length(curve.points), wider)
        curves.append(replace(curve, points=curve.points / stretch, source=curve.source / stretch))
    clipped = replace(clipped, cuts=tuple(cuts), paths=clipped.paths if curves else ())
    _check_left_out(problem, spec, clipped)
    beads: list[Bead] = []
    for layer, row in enumerate(rows_of_layers(curves, spec.count, process.order)):
        beads += wrap_layer(row, cylinder, layer, spec.height, process.bead.width, process.bead.height)
    shape = cylinder_shape(cylinder.radius, cylinder.height, cylinder.centre)
    specks = tuple(cylinder.wrap(cut.points / stretch, spec.height)[0] for cut in clipped.cuts)
    return Toolpath(tuple(beads), cylinder, shape, (*told, *clipped.notes), left_out=specks, told=Told(clipped.share))


def _check_left_out(problem: Problem, spec: LayersSpec | WrappedDxfSpec, clipped: Clipped) -> None:
    """Raise InputError if more is left out than permitted, or everything."""
    if clipped.share > spec.source.crumbs or not clipped.paths:
        raise clipped.refusal(problem, "layers.source.width_mm", clipped.share if clipped.paths else None)


def drawn_paths(problem: Problem, spec: LayersSpec | WrappedDxfSpec) -> tuple[tuple[PlanePath, ...], tuple[str, ...]]:
    """The paths of a drawing, and notes about its file. Raises InputError if it cannot be read."""
    tolerance = problem.process.chord_tolerance
    if isinstance(spec.source, DxfSpec):
        return read_dxf(spec.source, tolerance, partial(problem.error, "layers.source.dxf"))
    where = partial(problem.error, "layers.source.svg")
    return read_svg_once(spec.source.svg, spec.source.width, tolerance, where)


def _check_fit(problem: Problem, paths: tuple[PlanePath, ...], cylinder: Cylinder) -> None:
    points = np.vstack([path.points for path in paths])
    around = 2.0 * np.pi * cylinder.radius
    width, height = np.ptp(points[:, 0]), np.ptp(points[:, 1])
    if width >= around:
        raise problem.error(
            "layers.source.width_mm",
            f"the drawing, {width * 1e3:.1f} mm wide, does not fit around the cylinder",
            f"the circumference is {around * 1e3:.1f} mm",
        )
    if height > cylinder.height:
        raise problem.error(
            "layers.source.width_mm",
            f"the drawing, {height * 1e3:.1f} mm high at this width, is higher than the cylinder",
            f"the cylinder is {cylinder.height * 1e3:.1f} mm high: "
            f"width_mm at most {np.floor(width * 1e4 * cylinder.height / height) / 10:.1f}",
        )
