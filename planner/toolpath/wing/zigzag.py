"""Fills a strip, which is a rectangle when it is rolled out, with one zig-zag line."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from planner.readonly import Array
from planner.toolpath.bead import Bead
from planner.toolpath.interpolation import interpolate
from planner.toolpath.laying import arc_length
from planner.toolpath.transport import roll_zeros
from planner.toolpath.wing.strips import Strip

STEP = 1e-3  # m between waypoints where a strip is flat
TURN = 0.06  # rad that the nozzle turns from one waypoint to the next at most, where a strip bends most
APART = 0.5  # of the distance of passes: the source's points lie no farther apart
PER_RUN = 10.0  # samples in a run-in, whose spacing is that of the bead's end


@dataclass(frozen=True)
class Filling:
    """How strips are filled: width and height of a bead, tolerance at the turns and length of a run-in [m];
    spacing of passes in bead widths, 1 or more."""

    width: float
    height: float
    tolerance: float
    run_in: float
    spacing: float = 1.0


def fill(
    strip: Strip, along: bool, span: tuple[float, float], filling: Filling, name: str, layer: int, start: Array | None
) -> Bead:
    """One bead that fills a strip between two y [m], in passes along its curve or along the span.

    It stays half a pass inside the edges. Of the four corners it begins at the one nearest to `start` (3), if given.
    The tip curve is a plane when rolled out, so turns are rounded there and all samples lie on the true curve.
    """
    sizes = np.array([strip.length, span[1] - span[0]])
    step_axis = 1 if along else 0
    passes = max(round(sizes[step_axis] / (filling.width * filling.spacing)), 1)
    pitch = sizes[step_axis] / passes
    low, high = np.full(2, 0.5 * filling.width), sizes - 0.5 * filling.width
    low[step_axis], high[step_axis] = 0.5 * pitch, sizes[step_axis] - 0.5 * pitch
    step = min(STEP, TURN / max(strip.bend, 1e-9)) if along else STEP
    plane = _zigzag(low, high, step_axis, passes, step)
    flips = [np.array(flip) for flip in itertools.product((False, True), repeat=2)]
    corners = [_in_space(strip, span, np.where(flip, sizes - plane[0], plane[0])[None])[0][0] for flip in flips]
    nearest = 0 if start is None else int(np.argmin([np.linalg.norm(corner - start) for corner in corners]))
    plane = np.where(flips[nearest], sizes - plane, plane)

    flat = np.column_stack([plane, np.zeros(len(plane))])
    upwards = np.tile([0.0, 0.0, 1.0], (len(plane), 1))
    curve = interpolate(flat, upwards, filling.tolerance, APART * pitch, filling.run_in / PER_RUN)
    points, normals = _in_space(strip, span, curve.points[:, :2])
    source, _ = _in_space(strip, span, curve.source[:, :2])
    return Bead(
        name=name,
        layer=layer,
        s=arc_length(points),
        points=points,
        normals=normals,
        roll_zero=roll_zeros([normals])[0],
        source=source,
        width=np.full(len(points), pitch / filling.spacing),
        height=np.full(len(points), filling.height),
        closed=False,
    )


def _zigzag(low: Array, high: Array, step_axis: int, passes: int, step: float) -> Array:
    """Waypoints (n, 2) of straight passes between corners `low` and `high` (2), every other one run backwards."""
    run_axis = 1 - step_axis
    count = max(int(np.ceil((high[run_axis] - low[run_axis]) / step)), 2)
    run = np.linspace(low[run_axis], high[run_axis], count + 1)
    out = np.empty((passes, count + 1, 2))
    out[:, :, run_axis] = run
    out[1::2, :, run_axis] = run[::-1]
    out[:, :, step_axis] = np.linspace(low[step_axis], high[step_axis], passes)[:, None]
    return out.reshape(-1, 2)


def _in_space(strip: Strip, span: tuple[float, float], plane: Array) -> tuple[Array, Array]:
    """Points and normals (n, 3) of places (n, 2) on the strip rolled out: along its curve, along the span."""
    flat, outward = strip.tips(plane[:, 0])
    y = span[0] + plane[:, 1]
    points = np.column_stack([flat[:, 0], y, flat[:, 1]])
    return points, np.column_stack([outward[:, 0], np.zeros(len(y)), outward[:, 1]])
