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

Source = Callable[[Problem, Any], Toolpath]


# Each is loaded for who asks for it only: what reads drawings, meshes and CAD files takes a second together.


def _drawing() -> Source:
    from planner.toolpath.wrapped import wrap_drawing

    return wrap_drawing


def _projected() -> Source:
    from planner.toolpath.substrate.projection import project_curves

    return project_curves


def _core() -> Source:
    from planner.toolpath.substrate.cores import lay_core

    return lay_core


def _waypoints() -> Source:
    from planner.toolpath.waypoints.through import through_waypoints

    return through_waypoints


def _slicer() -> Source:
    from planner.toolpath.gcode.level import slicer_print

    return slicer_print


def _volume() -> Source:
    from planner.toolpath.volume.layers import fill_mesh

    return fill_mesh


def _wing() -> Source:
    from planner.toolpath.wing.layers import wing

    return wing


def _faces() -> Source:
    from planner.toolpath.step.cover import cover_faces

    return cover_faces


SOURCES: dict[type, Callable[[], Source]] = {
    LayersSpec: _drawing,
    ProjectedDrawingSpec: _projected,
    ProjectedPatternSpec: _projected,
    ProjectedCurvesSpec: _projected,
    CoreLayersSpec: _core,
    WaypointLayersSpec: _waypoints,
    GcodeLayersSpec: _slicer,
    VolumeLayersSpec: _volume,
    AerofoilLayersSpec: _wing,
    FaceLayersSpec: _faces,
}


def build_toolpath(problem: Problem) -> Toolpath:
    """Read the source, round its corners and lay its beads in print order.

    Beads to which their source gives no material are of the layers' own.
    Raises InputError for a file that cannot be read, and for a drawing that does not fit on the part.
    """
    toolpath = SOURCES[type(problem.layers)]()(problem, problem.layers)
    materials = problem.process.materials
    if not materials:
        return toolpath
    own = problem.layers.material or next(iter(materials))
    beads = tuple(bead if bead.material else replace(bead, material=own) for bead in toolpath.beads)
    return replace(toolpath, beads=beads)
