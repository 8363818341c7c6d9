"""From the problem's part and layers to a Toolpath: source, rounding, order, layers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.problem import LayersSpec, PartSpec, Problem, WaypointLayersSpec
from planner.problem_wing import AerofoilLayersSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.interpolation import Interpolated, TooRough, interpolate
from planner.toolpath.ordering import reverse, shorten_travel
from planner.toolpath.paths import check_length, check_size, length, seam_on_smooth_part
from planner.toolpath.projection import project_curves
from planner.toolpath.rounding import round_corners
from planner.toolpath.surfels import with_layers
from planner.toolpath.svg import PlanePath, read_svg
from planner.toolpath.transport import roll_zeros
from planner.toolpath.waypoint_checks import check_clear, check_waypoints
from planner.toolpath.waypoints import Waypoints, read_waypoints
from planner.toolpath.wing import wing
from planner.toolpath.wrap import Cylinder, arc_length, wrap_layer

Array = NDArray[np.float64]
_APART = 0.5  # of the bead's width: passes lie no closer to each other
_PER_RUN = 10.0  # samples in a run-in, whose spacing is that of the bead's end
_CLOSED = 1e-6  # m between the ends of a closed path


def build_toolpath(problem: Problem) -> Toolpath:
    """Read the source, round its corners and lay its beads in print order.

    Raises InputError for a file that cannot be read, and for a drawing that does not fit on the part.
    """
    layers, part = problem.layers, problem.part
    if isinstance(layers, WaypointLayersSpec):
        return _through_waypoints(problem, layers)
    if isinstance(layers, AerofoilLayersSpec):
        return wing(problem, layers)
    if part is None:
        raise problem.error("part", "is missing", "the body to print on")
    if isinstance(layers, LayersSpec):
        return _wrap_drawing(problem, layers, part)
    return project_curves(problem, layers, layers.source, part)


def _through_waypoints(problem: Problem, spec: WaypointLayersSpec) -> Toolpath:
    """Lay a bead through each path of a file of waypoints, in the file's order."""
    process = problem.process
    paths = read_waypoints(spec.source, partial(problem.error, "layers.source.waypoints"))
    for path in paths:
        check_waypoints(path, spec.source.waypoints, process.bead.width)
    apart = _APART * process.bead.width
    ends = process.run_in / _PER_RUN
    curves = [_curve(problem, spec, path, apart, ends) for path in paths]
    zeros = roll_zeros([curve.normals for curve in curves])
    beads = [
        Bead(
            name=path.name,
            layer=0,
            s=arc_length(curve.points),
            points=curve.points,
            normals=curve.normals,
            roll_zero=zero,
            source=curve.source,
            width=np.full(len(curve.points), process.bead.width),
            height=np.full(len(curve.points), process.bead.height),
            closed=bool(np.linalg.norm(curve.points[-1] - curve.points[0]) < _CLOSED),
        )
        for path, curve, zero in zip(paths, curves, zeros, strict=True)
    ]
    toolpath = Toolpath(*with_layers(beads))
    for i, (path, bead) in enumerate(zip(paths, toolpath.beads, strict=True)):
        check_clear(path, bead, toolpath.surface.before(i), spec.source.waypoints)
    return toolpath


def _curve(problem: Problem, spec: WaypointLayersSpec, path: Waypoints, apart: float, ends: float) -> Interpolated:
    """The curve through a path of waypoints."""
    try:
        curve = interpolate(path.points, path.normals, problem.process.corner_tolerance, apart, ends)
    except TooRough as error:
        raise InputError(
            f"{path.name} is too rough from here on: no smooth curve keeps process.corner_tolerance_mm",
            file=spec.source.waypoints,
            line=int(path.lines[error.waypoint]),
            hint="choose a greater tolerance, or smooth the waypoints",
        ) from None
    hint = f"choose a smaller tolerance, or smooth the waypoints from line {path.lines[0]} on"
    check_size(problem, path.name, length(path.points), length(curve.points), hint)
    return curve


def _wrap_drawing(problem: Problem, spec: LayersSpec, part: PartSpec) -> Toolpath:
    """Round a drawing's corners, order its beads and lay the layers around the part."""
    if part.cylinder is None:
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
    return Toolpath(tuple(beads), cylinder)


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
