"""How tightly a fibre is steered: the least radius of its executed path within the surface that it lies on.

A tow on a curved surface bends with it freely; what its fibres resist is bending sideways, within the surface. That is
measured by the geodesic curvature, n · (x' × x'') of the executed tip x by its arc length, n being the surface normal:
0 along a geodesic, 1 / R along a circle of radius R on a plane. A tow has a width and cannot follow anything much
shorter, so derivatives are those of the parabolas that fit the tip best over SPAN tow widths; noise of the input hardly
affects them. A rounded corner appears as the radius that turns as much over that length.

Run-in and run-out lay nothing and are not judged. Lengths are in metres.
"""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths
from planner.verify.checks import Findings, Judged, check_least

SPAN = 4.0  # tow widths over which curvature is found: a tow follows nothing shorter
STRAIGHT = 10.0  # m: greatest radius reported
_STEPS = 40  # places on that length at which the tip is sampled
_STILL = 1e-7  # m: samples nearer to each other are one place, as where the nozzle rests
_FEWEST = 5  # least number of steps on a bead
_LEAST_SPEED = 1e-6  # of the tip by its arc length, which is 1 except where a path doubles back


def geodesic_curvature(tip: Array, normals: Array, span: float) -> Array:
    """Geodesic curvature (n) [1/m], found over a length `span` [m], of a path of tips (n, 3) [m] on a surface with unit
    normals (n, 3): positive where it bends to the left as seen from outside. A shorter path counts as a whole; for one
    that stands still it is 0.
    """
    s = arc_lengths(tip)
    moved = np.flatnonzero(np.diff(s, prepend=-1.0) > _STILL)
    length = float(s[-1])
    if len(moved) < 3 or length <= _STILL:
        return np.zeros(len(tip))
    span = min(span, length)
    count = max(round(_STEPS * length / span), _FEWEST) + 1
    even, step = np.linspace(0.0, length, count, retstep=True)
    window = min(2 * round(0.5 * span / step) + 1, count - 1 + count % 2)
    points, up = (
        np.stack([np.interp(even, s[moved], of[moved, k]) for k in range(3)], axis=1) for of in (tip, normals)
    )
    half = window // 2
    fitted = np.linalg.pinv(np.vander(np.arange(-half, half + 1) * step, 3, increasing=True))
    around = np.lib.stride_tricks.sliding_window_view(points, window, axis=0)
    along, bend = around @ fitted[1], around @ (2.0 * fitted[2])
    within = slice(half, half + len(around))  # nearer to the ends, that of the first and last whole span is used
    level = (np.cross(along, bend) * up[within]).sum(axis=1)
    curvature = level / np.maximum(np.linalg.norm(along, axis=1), _LEAST_SPEED)
    return np.asarray(np.interp(s, even[within], curvature))


def steering(judged: Judged) -> Findings:
    """The least steering radius of all fibre beads, and the check of it where the problem bounds it."""
    process, t, toolpath = judged.problem.process, judged.trajectory, judged.toolpath
    if process.section != "fibre":
        return Findings()
    radius = np.full(len(t), STRAIGHT)
    for i, (at, bead) in enumerate(zip(judged.samples, toolpath.beads, strict=True)):
        if len(at) < 3:
            continue  # two places show no bend
        tip = judged.drawn_tip[at]
        normals = toolpath.surface.normals_on(i, t.s[at], tip)
        curvature = np.abs(geodesic_curvature(tip, normals, SPAN * float(bead.width.max())))
        radius[at] = 1.0 / np.maximum(curvature, 1.0 / STRAIGHT)
    limit = None if process.fibre is None else process.fibre.least_radius
    found = check_least(t, "steering radius of the fibre", radius * 1e3, 1e3 * (limit or 0.0), "mm")
    return Findings(() if limit is None else (found,), {"steering_radius_min_mm": found.worst})
