"""From the problem to a drawing in layers around a cylinder: rounding, order, layers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.problem import Problem
from planner.problem.drawings import LayersSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.ordering import reverse, shorten_travel
from planner.toolpath.paths import check_length, check_size, length, seam_on_smooth_part
from planner.toolpath.rounding import round_corners
from planner.toolpath.shape import cylinder_shape
from planner.toolpath.svg import PlanePath, read_svg
from planner.toolpath.wrap import Cylinder, wrap_layer


def wrap_drawing(problem: Problem, spec: LayersSpec) -> Toolpath:
    """Round a drawing's corners, order its beads and lay the layers around the part."""
    part = problem.part
    if part is None or part.cylinder is None:
        raise problem.error("part", "is missing", "the body to wrap around: cylinder")
    process = problem.process
    cylinder = Cylinder(part.cylinder.radius, part.cylinder.height, np.asarray(part.cylinder.centre))
    paths = read_svg(spec.source.svg, spec.source.width, process.chord_tolerance)
    _check_fit(problem, paths, cylinder)

    # On the outermost layer x is longest. Rounded in that layer's own metric once, all layers hold the
    # tolerance, have the same shape, and lie exactly above each other.
    stretch = np.array([1.0 + spec.count * spec.height / cylinder.radius, 1.0])
    curves = []
    for path in paths:
        path = replace(path, points=path.points * stretch)
        check_length(problem, path)
        curve = round_corners(seam_on_smooth_part(path) if path.closed else path, process.corner_tolerance)
        wider = "choose a smaller tolerance, or a greater layers.source.width_mm"
        check_size(problem, path.name, length(path.points), length(curve.points), wider)
        curves.append(replace(curve, points=curve.points / stretch, source=curve.source / stretch))
    curves = shorten_travel(curves)

    beads: list[Bead] = []
    for layer in range(spec.count):
        beads += wrap_layer(curves, cylinder, layer, spec.height, process.bead.width, process.bead.height)
        curves = [reverse(curve) for curve in reversed(curves)]  # the next layer starts where this one ended
    shape = cylinder_shape(cylinder.radius, cylinder.height, cylinder.centre)
    return Toolpath(tuple(beads), cylinder, shape)


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
