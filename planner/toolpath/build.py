"""From the problem's part and layers to a Toolpath: each kind of layers by its own source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from planner.problem import Problem
from planner.problem.cores import CoreLayersSpec
from planner.problem.curves import ProjectedCurvesSpec
from planner.problem.drawings import LayersSpec, ProjectedDrawingSpec, ProjectedPatternSpec
from planner.problem.faces import FaceLayersSpec
from planner.problem.gcode import GcodeLayersSpec
from planner.problem.volume import VolumeLayersSpec
from planner.problem.waypoints import WaypointLayersSpec
from planner.problem.wing import AerofoilLayersSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.gcode.level import slicer_print
from planner.toolpath.step.cover import cover_faces
from planner.toolpath.substrate.cores import lay_core
from planner.toolpath.substrate.projection import project_curves
from planner.toolpath.volume.layers import fill_mesh
from planner.toolpath.waypoints.through import through_waypoints
from planner.toolpath.wing.layers import wing
from planner.toolpath.wrapped import wrap_drawing

SOURCES: dict[type, Callable[[Problem, Any], Toolpath]] = {
    LayersSpec: wrap_drawing,
    ProjectedDrawingSpec: project_curves,
    ProjectedPatternSpec: project_curves,
    ProjectedCurvesSpec: project_curves,
    CoreLayersSpec: lay_core,
    WaypointLayersSpec: through_waypoints,
    GcodeLayersSpec: slicer_print,
    VolumeLayersSpec: fill_mesh,
    AerofoilLayersSpec: wing,
    FaceLayersSpec: cover_faces,
}


def build_toolpath(problem: Problem) -> Toolpath:
    """Read the source, round its corners and lay its beads in print order.

    Beads to which their source gives no material are of the layers' own.
    Raises InputError for a file that cannot be read, and for a drawing that does not fit on the part.
    """
    toolpath = SOURCES[type(problem.layers)](problem, problem.layers)
    materials = problem.process.materials
    if not materials:
        return toolpath
    own = problem.layers.material or next(iter(materials))
    beads = tuple(bead if bead.material else replace(bead, material=own) for bead in toolpath.beads)
    return replace(toolpath, beads=beads)
