"""Lines around the first layer, laid before all others: a skirt, which starts the flow, or, if they touch the layer, a
brim, which holds it to the bed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import shapely

from planner.base.arrays import Array
from planner.problem import Problem
from planner.problem.by_layer import SkirtSpec
from planner.toolpath.bead import Bead, Surface, SurfaceOver, Toolpath
from planner.toolpath.plane_paths import densify, make_bead, round_corners, with_seam
from planner.toolpath.svg.outlines import PlanePath
from planner.toolpath.task import roll_zeros

_LEVEL = 1e-6  # m: height range within which a first layer is level
_UPRIGHT = 1e-9  # how far the upward component of its normals may be below 1
_ARC = 32  # segments per quarter circle: a line 50 mm away leaves its circle by 0.02 mm
_CHORD = 1e-5  # m: tolerance within which outlines are simplified


def with_skirt(problem: Problem, toolpath: Toolpath, spec: SkirtSpec) -> Toolpath:
    """The toolpath, preceded by lines around its first layer from the outside in.

    Raises InputError for a first layer that is not level: there is no bed next to it.
    """
    layer = min(bead.layer for bead in toolpath.beads)
    first = [bead for bead in toolpath.beads if bead.layer == layer]
    z = np.concatenate([bead.points[:, 2] for bead in first])
    upright = min(float(bead.normals[:, 2].min()) for bead in first)
    if np.ptp(z) > _LEVEL or upright < 1.0 - _UPRIGHT:
        reason = "the first layer is not level: there is no bed next to it to lay lines on"
        raise problem.error("process.skirt", reason, "leave it out, or draw the lines on the part")
    beads = [_bead(problem, path, first[0], float(z.mean())) for path in _lines(spec, first)]
    return replace(toolpath, beads=(*beads, *toolpath.beads), surface=SkirtedSurface(toolpath.surface, len(beads)))


def _lines(spec: SkirtSpec, first: list[Bead]) -> Iterator[PlanePath]:
    """Closed paths around the area covered by beads, the outermost first."""
    covered = shapely.union_all(
        [shapely.LineString(bead.points[:, :2]).buffer(0.5 * float(bead.width.max()), quad_segs=_ARC) for bead in first]
    )
    width, number = float(np.median(first[0].width)), 0  # median: flow may grow at its start
    for k in reversed(range(spec.loops)):
        around = covered.buffer(spec.gap + (k + 0.5) * width, quad_segs=_ARC)
        for polygon in shapely.get_parts(around):
            number += 1
            points = np.asarray(polygon.exterior.simplify(_CHORD).coords)
            yield PlanePath(f"skirt {number}", points, True)


def _bead(problem: Problem, path: PlanePath, like: Bead, z: float) -> Bead:
    """A level bead at height z with the width, height and material of another."""

    def place(plane: Array) -> Array:
        return np.column_stack([plane, np.full(len(plane), z)])

    curve = round_corners(with_seam(path, problem.process.seam, place), problem.process.corner_tolerance)
    points = place(curve.points)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    (zero,) = roll_zeros([normals])
    size = float(np.median(like.width)), float(np.median(like.height))
    return make_bead(
        path.name, like.layer, points, normals, zero, place(densify(curve.source)), *size, True, like.material
    )


@dataclass(frozen=True)
class SkirtedSurface(SurfaceOver):
    """The surface beneath a toolpath whose first `lines` beads lie around its first layer, on the bed."""

    lines: int

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Upwards for the lines, otherwise as for the surface."""
        if bead < self.lines:
            return np.tile([0.0, 0.0, 1.0], (len(tips), 1))
        return self.surface.normals_on(bead - self.lines, s, tips)

    def before(self, bead: int) -> Surface:
        """The surface after so many beads have been printed, not counting the lines."""
        return self.surface.before(max(bead - self.lines, 0))
