"""Beads through the waypoints of a file; each path is checked first.

A path must be long enough for a bead, and run along the surface to which its normals belong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.geometry import angles_between, arc_lengths, subdivided
from planner.base.processes import of_each
from planner.problem import Problem
from planner.problem.layers import WaypointLayersSpec, WaypointsSpec
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Told, Toolpath
from planner.toolpath.interpolation import Interpolated, TooRough, interpolate
from planner.toolpath.plane_paths import check_size, length, make_bead
from planner.toolpath.task import noise_of, roll_zeros
from planner.toolpath.waypoints.normals import UNASKED, calm_normals
from planner.toolpath.waypoints.reader import WaypointFile, Waypoints, read_waypoints
from planner.toolpath.waypoints.struts import struts_of
from planner.toolpath.waypoints.surfels import Surfels, other_height, with_layers

MOST_TURN = 90.0  # deg by which the normal may turn between waypoints: no surface that a nozzle can follow turns more
STEEPEST = 0.8  # sine of the angle between path and surface; if steeper over half its length, a path is on no surface
LOOKS_PER_WIDTH = 4.0  # places per bead width along a path at which the nozzle's clearance is checked
NOTED = np.radians(0.05)  # noise of half the normals; those from formulas have less than a tenth of it
CLEAR = 2e-5  # m, or a tenth of a bead's height if less: least clearance, since the tip may be this far off its path

SPATIAL = "layers.source.kind: spatial"
_TINY = 2.0  # bead widths: a smaller file may be in metres
_UNLIKE = 1.5  # × a bead's height above which layers are evidently farther apart than a bead is high
_APART = 0.5  # × the bead's width: spacing of the source's points; passes lie no closer together
_PER_RUN = 10.0  # samples per run-in, which set the spacing at the bead's ends


class NoSurface(InputError):
    """Waypoints that lie on no surface: if they print anything, it is struts in space."""


def in_metres(paths: Sequence[Waypoints], spec: WaypointsSpec, width: float) -> str:
    """A note on a file in mm that is hardly larger than the width of a bead [m]; empty for any other."""
    points = np.concatenate([path.points for path in paths])
    size = np.ptp(points, axis=0)
    if spec.unit != "mm" or not 0.0 < float(size.max()) < _TINY * width:
        return ""
    x, y, z = 1e3 * size
    return (
        f"it measures only {x:.3g} x {y:.3g} x {z:.3g} mm; read in metres (layers.source.unit: m) it would measure "
        f"{1e3 * x:.3g} x {1e3 * y:.3g} x {1e3 * z:.3g} mm"
    )


def check_waypoints(path: Waypoints, spec: WaypointsSpec, width: float) -> None:
    """Raise InputError, with the place, for a path that cannot be a bead of this width [m]."""
    _check_length(path, spec, width)
    _check_normals(path, spec)


def check_section(path: Waypoints, process: ProcessSpec, spec: WaypointsSpec) -> None:
    """Raise InputError, with the place, where a rounded bead would be higher than wide."""
    if process.section != "rounded" or (path.width is None and path.height is None):
        return
    width = np.broadcast_to(process.bead.width if path.width is None else path.width, path.lines.shape)
    height = np.broadcast_to(process.bead.height if path.height is None else path.height, path.lines.shape)
    if (width < height).any():
        i = int(np.argmax(width < height))
        raise InputError(
            f"a rounded bead cannot be {width[i] * 1e3:g} mm wide and {height[i] * 1e3:g} mm high",
            **spec.place(path.lines[i]),
            hint="at least as wide as high, or process.bead.section: rectangle",
        )


def _check_length(path: Waypoints, spec: WaypointsSpec, width: float) -> None:
    """Raise InputError for a path shorter than its bead is wide."""
    drawn = length(path.points)
    if drawn < width:
        raise InputError(
            f"{path.name}, which begins here, is only {drawn * 1e3:.4f} mm long",
            **spec.place(path.lines[0]),
            hint=f"a path is at least as long as its bead is wide, {width * 1e3:g} mm; layers.source.leave_out_share says how "
            "much may be left out",
        )


def _check_normals(path: Waypoints, spec: WaypointsSpec) -> None:
    """Raise InputError where a normal jumps to the other side: that is no surface, and halfway there is no normal."""
    turn = np.degrees(angles_between(path.normals[:-1], path.normals[1:]))
    i = int(np.argmax(turn > MOST_TURN))
    if turn[i] > MOST_TURN:
        raise InputError(
            f"the normal turns by {turn[i]:.0f} degrees from the waypoint before to this one",
            **spec.place(path.lines[i + 1]),
            hint=f"normals point out of the part, and turn by at most {MOST_TURN:g} degrees",
        )


def check_slope(path: Waypoints, spec: WaypointsSpec) -> None:
    """Raise NoSurface for a path that runs along its normals for most of its length; it may climb to its next layer."""
    way, middle = np.diff(path.points, axis=0), path.normals[:-1] + path.normals[1:]
    length = np.linalg.norm(way, axis=1)
    climb = np.abs((way * middle).sum(axis=1)) / np.linalg.norm(middle, axis=1)
    steep = climb > STEEPEST * length
    if 2.0 * float(length[steep].sum()) > float(length.sum()):
        raise NoSurface(
            f"{path.name} runs along its normals, not along a surface",
            **spec.place(path.lines[int(np.argmax(steep))]),
            hint="nx ny nz is the normal of the surface, not the direction of the path; for columns and struts in space, which "
            f"lie on none, it points against the nozzle: {SPATIAL}",
        )


def check_clear(path: Waypoints, bead: Bead, surface: Surfels, spec: WaypointsSpec) -> None:
    """Raise NoSurface, with the place, where the nozzle would lay the path's bead inside the part.

    surface: the ground of the first layer and everything printed before the bead. Inside means that passes contradict
    each other: one runs through what another lies on.
    """
    steps = np.ceil(np.diff(bead.s) * LOOKS_PER_WIDTH / bead.width[:-1]).astype(int)
    sample, share = subdivided(steps)
    points = make_interp_spline(np.arange(len(bead.s)), bead.points, k=5)(np.append(sample + share, len(steps)))
    gap = surface.signed_distance(points)
    if (gap < min(CLEAR, 0.1 * float(bead.height.min()))).any():
        i = int(np.argmin(gap))
        depth = f"{-gap[i] * 1e3:.2f} mm deep " if gap[i] < -CLEAR else ""
        _, nearest = cKDTree(path.points).query(points[i])
        hint = "passes that cross or lie beside each other must be at the same height, or a bead's height apart"
        layer, height = surface.nearest_layer(points[i]), float(bead.height.min())
        if layer > _UNLIKE * height:
            hint += f"; here the nearest one above or below is {layer * 1e3:.1f} mm away, beads are {height * 1e3:g} mm high"
        hint += f"; struts in space: {SPATIAL}"
        raise NoSurface(
            f"near here {path.name} runs {depth}inside what another pass lies on",
            **spec.place(path.lines[nearest]),
            hint=hint,
        )


def through_waypoints(problem: Problem, spec: WaypointLayersSpec) -> Toolpath:
    """Lay a bead through each path of a file of waypoints, in the file's order: on a surface, or as struts in space.

    If the problem does not say which, they are on a surface if there is one.
    """
    width = problem.process.bead.width
    read = read_waypoints(spec.source, partial(problem.error, "layers.source.waypoints"), width)
    metres = in_metres(read.beads, spec.source, width)
    if not metres:
        return _on_a_surface_or_not(problem, spec, read)
    try:
        return _on_a_surface_or_not(problem, spec, replace(read, notes=(*read.notes, f"{spec.source.name}: {metres}")))
    except InputError as error:
        raise InputError(
            error.reason, file=error.file, line=error.line, field=error.field, hint=metres, all=error.all
        ) from None


def _on_a_surface_or_not(problem: Problem, spec: WaypointLayersSpec, read: WaypointFile) -> Toolpath:
    """See `through_waypoints`."""
    process, kind = problem.process, spec.source.kind
    widths = [process.bead.width if path.width is None else float(path.width.min()) for path in read.beads]
    for path, width in zip(read.beads, widths, strict=True):
        check_waypoints(path, spec.source, width)
    if kind == "spatial":
        return in_space(problem, spec, read)
    try:
        return _on_a_surface(problem, spec, read, widths)
    except NoSurface as none:
        if kind == "surface":
            raise
        at = none.field if none.line is None else f"line {none.line}"
        place = "" if at is None else f" ({at})"
        why = f"taken for struts in space, since {none.reason}{place}; layers.source.kind overrides this"
        return in_space(problem, spec, replace(read, notes=(*read.notes, f"{spec.source.name}: {why}")))


def _on_a_surface(problem: Problem, spec: WaypointLayersSpec, read: WaypointFile, widths: Sequence[float]) -> Toolpath:
    """Beads on the surface beneath them. Raises NoSurface if the waypoints contradict one."""
    process = problem.process
    for path in read.beads:
        check_slope(path, spec.source)
        check_section(path, process, spec.source)
    # a nozzle that may tilt smooths over noise by itself
    unasked = UNASKED if process.cones.tilt == 0.0 else 0.0
    paths, told = calm_normals(read.beads, spec.source.smoothing, unasked)
    sizes = [
        (
            process.bead.width if path.width is None else path.width,
            process.bead.height if path.height is None else path.height,
        )
        for path in paths
    ]
    laid, surface = with_layers(laid_through(problem, spec, paths, sizes))
    laid = with_file_layers(laid, paths)
    for i, (path, bead) in enumerate(zip(paths, laid, strict=True)):
        check_clear(path, bead, surface.before(i), spec.source)
    if told:
        notes = [f"{spec.source.name}: {told}"]
    else:
        notes = [] if process.cones.tilt > 0.0 else list(_noise_note(laid))
    notes += _height_note(spec, paths, laid, process.bead.height)
    return Toolpath(laid, surface, notes=(*read.notes, *notes), told=Told(read.left_out))


def in_space(problem: Problem, spec: WaypointLayersSpec, read: WaypointFile) -> Toolpath:
    """Struts and columns in space: round beads that lie on nothing.

    Their diameter is the file's width or, if it has none, that of a circle with the cross-section of a usual bead.
    """
    process = problem.process
    unasked = UNASKED if process.cones.tilt == 0.0 else 0.0
    paths, told = calm_normals(read.beads, spec.source.smoothing, unasked)
    usual = diameter_of(process)
    sizes = [(usual, usual) if path.width is None else (path.width, path.width) for path in paths]
    laid = tuple(replace(bead, round=True) for bead in laid_through(problem, spec, paths, sizes))
    laid = with_file_layers(laid, paths)
    notes = [f"{spec.source.name}: {told}"] if told else []
    if spec.source.kind is None:  # it may be a surface, read with the wrong height
        notes += _height_note(spec, paths, laid, process.bead.height)
    return Toolpath(laid, struts_of(laid), notes=(*read.notes, *notes), told=Told(read.left_out))


def diameter_of(process: ProcessSpec) -> float:
    """Diameter [m] of a round bead with the cross-section of a usual one."""
    w, h = process.bead.width, process.bead.height
    if process.section == "fibre":
        return process.filament_diameter
    area = w * h if process.section == "rectangle" else (w - h) * h + 0.25 * np.pi * h**2
    return float(np.sqrt(4.0 * area / np.pi))


def with_file_layers(beads: Sequence[Bead], paths: Sequence[Waypoints]) -> tuple[Bead, ...]:
    """The same beads, in the layers that the file gives, if any."""
    if paths[0].layer is None:
        return tuple(beads)
    _, layers = np.unique([path.layer for path in paths], return_inverse=True)
    return tuple(replace(bead, layer=int(layer)) for bead, layer in zip(beads, layers, strict=True))


def laid_through(
    problem: Problem,
    spec: WaypointLayersSpec,
    paths: Sequence[Waypoints],
    sizes: Sequence[tuple[Array | float, Array | float]],
) -> list[Bead]:
    """A bead through each path, all in layer 0; sizes: their widths and heights [m], at each waypoint or throughout."""
    ends = problem.process.run_in / _PER_RUN

    def curve_of(of: tuple[Waypoints, tuple[Array | float, Array | float]]) -> Interpolated:
        path, (width, _) = of
        return _curve(problem, spec, path, _APART * float(np.min(width)), ends)

    curves = of_each(curve_of, list(zip(paths, sizes, strict=True)))
    zeros = roll_zeros([curve.normals for curve in curves])
    return [
        make_bead(
            path.name,
            0,
            curve.points,
            curve.normals,
            zero,
            curve.source,
            width=_sizes(path, width, curve),
            height=_sizes(path, height, curve),
        )
        for path, curve, zero, (width, height) in zip(paths, curves, zeros, sizes, strict=True)
    ]


def _height_note(
    spec: WaypointLayersSpec, paths: Sequence[Waypoints], beads: Sequence[Bead], height: float
) -> Iterator[str]:
    """A note if layers are clearly farther apart or closer than beads are high [m], and the file gives no heights."""
    apart = None if paths[0].height is not None else other_height(beads, height)
    if apart is not None:
        yield (
            f"{spec.source.name}: its layers lie {apart * 1e3:.2g} mm apart, and process.bead.height_mm is {height * 1e3:g}: none "
            "counts as printed on another"
        )


def _noise_note(beads: Sequence[Bead]) -> Iterator[str]:
    """A note on noisy normals that the nozzle has to follow, and how to avoid it; none for clean normals."""
    half, nearly_all = noise_of(beads)
    if half > NOTED:
        enough = int(np.ceil(np.degrees(2.0 * nearly_all)))
        yield (
            f"normals are noisy: half of them are more than {np.degrees(half):.2f} deg off their smoothed directions along the "
            f"bead, and the joints follow all of it; process.cones.nozzle_normal_deg: {enough} lets the nozzle pass "
            "over it, layers.source.smooth_normals_deg smooths it away"
        )


def _sizes(path: Waypoints, given: Array | float, curve: Interpolated) -> Array:
    """Width or height (n) [m] along the curve: linear between waypoints if given for each, else constant."""
    if isinstance(given, float):
        return np.full(len(curve.points), given)
    return np.interp(curve.chord, arc_lengths(path.points), given)


def _curve(problem: Problem, spec: WaypointLayersSpec, path: Waypoints, apart: float, ends: float) -> Interpolated:
    """The curve through a path of waypoints."""
    try:
        tolerance = problem.process.corner_tolerance
        curve = interpolate(path.points, path.normals, tolerance, apart, ends, tolerance)
    except TooRough as error:
        raise InputError(
            f"{path.name} is too rough from here on: no smooth curve keeps process.corner_tolerance_mm",
            **spec.source.place(path.lines[error.waypoint]),
            hint="choose a greater tolerance, or smooth the waypoints",
        ) from None
    hint = f"choose a smaller tolerance, or smooth the waypoints from {spec.source.rows([path.lines[0]], 1)} on"
    check_size(problem, path.name, length(path.points), length(curve.points), hint)
    return curve
