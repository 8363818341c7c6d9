"""From the problem to beads through the waypoints of a file."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.problem import Problem
from planner.problem.waypoints import WaypointLayersSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.interpolation import Interpolated, TooRough, interpolate
from planner.toolpath.paths import check_size, length
from planner.toolpath.transport import roll_zeros
from planner.toolpath.waypoints.checks import check_clear, check_waypoints
from planner.toolpath.waypoints.reader import Waypoints, read_waypoints
from planner.toolpath.waypoints.surfels import with_layers
from planner.toolpath.wrap import arc_length

Array = NDArray[np.float64]
_APART = 0.5  # of the bead's width: passes lie no closer to each other
_PER_RUN = 10.0  # samples in a run-in, whose spacing is that of the bead's end
_CLOSED = 1e-6  # m between the ends of a closed path


def through_waypoints(problem: Problem, spec: WaypointLayersSpec) -> Toolpath:
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
