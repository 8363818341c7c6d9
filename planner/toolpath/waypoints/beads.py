"""Beads through the waypoints of a file; each path is checked before it is followed.

A path must be long enough for a bead, and run along the surface that its normals belong to.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.geometry import angles_between, arc_lengths, subdivided
from planner.problem import Problem
from planner.problem.layers import WaypointLayersSpec
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.interpolation import Interpolated, TooRough, interpolate
from planner.toolpath.plane_paths import check_size, length, make_bead
from planner.toolpath.task import noise_of, roll_zeros
from planner.toolpath.waypoints.normals import UNASKED, calm_normals
from planner.toolpath.waypoints.reader import Waypoints, read_waypoints
from planner.toolpath.waypoints.surfels import Surfels, with_layers

MOST_TURN = 90.0  # deg, of the normal from one waypoint to the next: no surface that a nozzle can follow turns further
STEEPEST = 0.8  # sine of the angle between path and surface; steeper over half its length, it is on no surface
LOOKS_PER_WIDTH = 4.0  # places in each bead's width of a path at which it is seen whether the nozzle is clear there
NOTED = np.radians(0.05)  # noise of half the normals; of those that come from formulas it is less than a tenth
CLEAR = 2e-5  # m, and a tenth of a bead's height: how far it must be, since it may be that far off its path

_UNLIKE = 1.5  # times a bead's height from which on layers are evidently farther apart than that
_APART = 0.5  # of the bead's width: passes lie no closer to each other
_PER_RUN = 10.0  # samples in a run-in, whose spacing is that of the bead's end


def check_waypoints(path: Waypoints, file: Path, width: float) -> None:
    """Raise InputError, with file and line, for a path that is no bead of this width [m]."""
    _check_length(path, file, width)
    _check_normals(path, file)
    _check_slope(path, file)


def check_section(path: Waypoints, process: ProcessSpec, file: Path) -> None:
    """Raise InputError, with file and line, where a rounded bead would be higher than wide."""
    if process.section != "rounded" or (path.width is None and path.height is None):
        return
    width = np.broadcast_to(process.bead.width if path.width is None else path.width, path.lines.shape)
    height = np.broadcast_to(process.bead.height if path.height is None else path.height, path.lines.shape)
    if (width < height).any():
        i = int(np.argmax(width < height))
        raise InputError(
            f"a rounded bead cannot be {width[i] * 1e3:g} mm wide and {height[i] * 1e3:g} mm high",
            file=file,
            line=int(path.lines[i]),
            hint="at least as wide as high, or process.bead.section: rectangle",
        )


def _check_length(path: Waypoints, file: Path, width: float) -> None:
    """At least as long as its bead is wide."""
    drawn = length(path.points)
    if drawn < width:
        raise InputError(
            f"{path.name}, which begins here, is only {drawn * 1e3:.4f} mm long",
            file=file,
            line=int(path.lines[0]),
            hint=f"a path is at least as long as its bead is wide, {width * 1e3:g} mm; layers.source.leave_out_share says how "
            "much may be left out",
        )


def _check_normals(path: Waypoints, file: Path) -> None:
    """A normal that jumps to the other side belongs to no surface, and half way there is none at all."""
    turn = np.degrees(angles_between(path.normals[:-1], path.normals[1:]))
    i = int(np.argmax(turn > MOST_TURN))
    if turn[i] > MOST_TURN:
        raise InputError(
            f"the normal turns by {turn[i]:.0f} degrees from the waypoint before to this one",
            file=file,
            line=int(path.lines[i + 1]),
            hint=f"normals point out of the part, and turn by at most {MOST_TURN:g} degrees",
        )


def _check_slope(path: Waypoints, file: Path) -> None:
    """A path may climb to its next layer, but not run along its normals throughout."""
    way, middle = np.diff(path.points, axis=0), path.normals[:-1] + path.normals[1:]
    length = np.linalg.norm(way, axis=1)
    climb = np.abs((way * middle).sum(axis=1)) / np.linalg.norm(middle, axis=1)
    steep = climb > STEEPEST * length
    if 2.0 * float(length[steep].sum()) > float(length.sum()):
        raise InputError(
            f"{path.name} runs along its normals, not along a surface",
            file=file,
            line=int(path.lines[int(np.argmax(steep))]),
            hint="nx ny nz is the normal of the surface, not the direction of the path",
        )


def check_clear(path: Waypoints, bead: Bead, surface: Surfels, file: Path) -> None:
    """Raise InputError, with file and line, where the nozzle would lay the path's bead inside the part.

    surface: what the first layer lies on and all that is printed before the bead. Inside is where passes contradict
    each other: what one lies on is where another one runs.
    """
    steps = np.ceil(np.diff(bead.s) * LOOKS_PER_WIDTH / bead.width[:-1]).astype(int)
    sample, share = subdivided(steps)
    points = make_interp_spline(np.arange(len(bead.s)), bead.points, k=5)(np.append(sample + share, len(steps)))
    gap = surface.signed_distance(points)
    if (gap < min(CLEAR, 0.1 * float(bead.height.min()))).any():
        i = int(np.argmin(gap))
        depth = f"{-gap[i] * 1e3:.2f} mm deep " if gap[i] < -CLEAR else ""
        _, nearest = cKDTree(path.points).query(points[i])
        hint = "passes that cross or lie beside each other stand at one height, or a bead's height apart"
        layer, height = surface.nearest_layer(points[i]), float(bead.height.min())
        if layer > _UNLIKE * height:
            hint += f"; here the nearest one above or below is {layer * 1e3:.1f} mm away, beads are {height * 1e3:g} mm high"
        raise InputError(
            f"near here {path.name} runs {depth}in what another pass lies on",
            file=file,
            line=int(path.lines[nearest]),
            hint=hint,
        )


def through_waypoints(problem: Problem, spec: WaypointLayersSpec) -> Toolpath:
    """Lay a bead through each path of a file of waypoints, in the file's order."""
    process = problem.process
    file = spec.source.waypoints
    read = read_waypoints(spec.source, partial(problem.error, "layers.source.waypoints"), process.bead.width)
    widths = [process.bead.width if path.width is None else float(path.width.min()) for path in read.beads]
    for path, width in zip(read.beads, widths, strict=True):
        check_waypoints(path, file, width)
        check_section(path, process, file)
    # a nozzle that may lean passes over noise by itself
    unasked = UNASKED if process.cones.tilt == 0.0 else 0.0
    paths, told = calm_normals(read.beads, spec.source.smoothing, unasked)
    ends = process.run_in / _PER_RUN
    curves = [_curve(problem, spec, path, _APART * width, ends) for path, width in zip(paths, widths, strict=True)]
    zeros = roll_zeros([curve.normals for curve in curves])
    beads = [
        make_bead(
            path.name,
            0,
            curve.points,
            curve.normals,
            zero,
            curve.source,
            width=_sizes(path, path.width, process.bead.width, curve),
            height=_sizes(path, path.height, process.bead.height, curve),
        )
        for path, curve, zero in zip(paths, curves, zeros, strict=True)
    ]
    laid, surface = with_layers(beads)
    if paths[0].layer is not None:  # the file knows
        _, layers = np.unique([path.layer for path in paths], return_inverse=True)
        laid = tuple(replace(bead, layer=int(layer)) for bead, layer in zip(laid, layers, strict=True))
    for i, (path, bead) in enumerate(zip(paths, laid, strict=True)):
        check_clear(path, bead, surface.before(i), file)
    if told:
        notes = [f"{file.name}: {told}"]
    else:
        notes = [] if process.cones.tilt > 0.0 else list(_noise_note(laid))
    return Toolpath(laid, surface, notes=(*read.notes, *notes))


def _noise_note(beads: Sequence[Bead]) -> Iterator[str]:
    """What noisy normals cost where the nozzle has to follow them, and what would spare it; nothing for clean ones."""
    half, nearly_all = noise_of(beads)
    if half > NOTED:
        enough = int(np.ceil(np.degrees(2.0 * nearly_all)))
        yield (
            f"normals are noisy: half of them are more than {np.degrees(half):.2f} deg off what they are smoothed along the "
            f"bead, and the joints follow all of that; process.cones.nozzle_normal_deg: {enough} would let the nozzle pass "
            "over it, layers.source.smooth_normals_deg smooths it away"
        )


def _sizes(path: Waypoints, given: Array | None, usual: float, curve: Interpolated) -> Array:
    """Width or height (n) [m] along the curve: linear between waypoints, where the file says it; else the usual one."""
    if given is None:
        return np.full(len(curve.points), usual)
    return np.interp(curve.chord, arc_lengths(path.points), given)


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
