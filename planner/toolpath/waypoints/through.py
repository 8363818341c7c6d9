"""From the problem to beads through the waypoints of a file."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from planner.errors import InputError
from planner.problem import Problem
from planner.problem.waypoints import WaypointLayersSpec
from planner.readonly import Array
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.interpolation import Interpolated, TooRough, interpolate
from planner.toolpath.laying import arc_length
from planner.toolpath.paths import check_size, length
from planner.toolpath.transport import roll_zeros
from planner.toolpath.waypoints.checks import check_clear, check_section, check_waypoints
from planner.toolpath.waypoints.reader import Waypoints, read_waypoints
from planner.toolpath.waypoints.surfels import with_layers

_APART = 0.5  # of the bead's width: passes lie no closer to each other
_PER_RUN = 10.0  # samples in a run-in, whose spacing is that of the bead's end
_CLOSED = 1e-6  # m between the ends of a closed path


def through_waypoints(problem: Problem, spec: WaypointLayersSpec) -> Toolpath:
    """Lay a bead through each path of a file of waypoints, in the file's order."""
    process = problem.process
    file = spec.source.waypoints
    read = read_waypoints(spec.source, partial(problem.error, "layers.source.waypoints"))
    paths, curves = read.beads, []
    for path in paths:
        width = process.bead.width if path.width is None else float(path.width.min())
        check_waypoints(path, file, width)
        check_section(path, process, file)
        curves.append(_curve(problem, spec, path, _APART * width, process.run_in / _PER_RUN))
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
            width=_sizes(path, path.width, process.bead.width, curve),
            height=_sizes(path, path.height, process.bead.height, curve),
            closed=bool(np.linalg.norm(curve.points[-1] - curve.points[0]) < _CLOSED),
        )
        for path, curve, zero in zip(paths, curves, zeros, strict=True)
    ]
    laid, surface = with_layers(beads)
    if paths[0].layer is not None:  # the file knows
        _, layers = np.unique([path.layer for path in paths], return_inverse=True)
        laid = tuple(replace(bead, layer=int(layer)) for bead, layer in zip(laid, layers, strict=True))
    for i, (path, bead) in enumerate(zip(paths, laid, strict=True)):
        check_clear(path, bead, surface.before(i), file)
    return Toolpath(laid, surface, notes=read.notes)


def _sizes(path: Waypoints, given: Array | None, usual: float, curve: Interpolated) -> Array:
    """Width or height (n) [m] along the curve: linear between waypoints, where the file says it; else the usual one."""
    if given is None:
        return np.full(len(curve.points), usual)
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points, axis=0), axis=1))])
    return np.interp(curve.chord, chord, given)


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
