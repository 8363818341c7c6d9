"""Builds a Toolpath from the problem's part and layers: each kind of layers has its own source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

from planner.problem import Problem
from planner.problem.drawings import (
    LayersSpec,
    ProjectedCurvesSpec,
    ProjectedDrawingSpec,
    ProjectedDxfSpec,
    ProjectedLayersSpec,
    ProjectedNurbsSpec,
    ProjectedPatternSpec,
    WrappedDxfSpec,
    WrappedLayersSpec,
)
from planner.problem.layers import (
    AerofoilLayersSpec,
    CoreLayersSpec,
    FaceLayersSpec,
    GcodeLayersSpec,
    VolumeLayersSpec,
    WaypointLayersSpec,
)
from planner.toolpath.as_printed import on_what_is_printed
from planner.toolpath.bead import Toolpath
from planner.toolpath.speeds import check_layers, with_speeds
from planner.toolpath.workload import check_laid

# Module and function of each source. Only the problem's own is imported: together, the readers of drawings, meshes and
# CAD files take a second to load.
SOURCES: dict[type, tuple[str, str]] = {
    LayersSpec: ("wrapped", "wrap_drawing"),
    WrappedDxfSpec: ("wrapped", "wrap_drawing"),
    ProjectedDxfSpec: ("substrate.projection", "project_curves"),
    ProjectedDrawingSpec: ("substrate.projection", "project_curves"),
    ProjectedPatternSpec: ("substrate.projection", "project_curves"),
    ProjectedCurvesSpec: ("substrate.projection", "project_curves"),
    ProjectedNurbsSpec: ("substrate.projection", "project_curves"),
    CoreLayersSpec: ("substrate.cores", "lay_core"),
    WaypointLayersSpec: ("waypoints.beads", "through_waypoints"),
    GcodeLayersSpec: ("gcode.layers", "slicer_print"),
    VolumeLayersSpec: ("volume.layers", "fill_mesh"),
    AerofoilLayersSpec: ("wing.wing", "lay_wing"),
    FaceLayersSpec: ("step.cover", "cover_faces"),
}


SEAMS = (WrappedLayersSpec, ProjectedLayersSpec, VolumeLayersSpec)  # sources whose closed beads may begin anywhere
ORDERS = (*SEAMS, CoreLayersSpec)  # those whose beads may be laid in any order


def build_toolpath(problem: Problem) -> Toolpath:
    """Read the source, round its corners and lay its beads in print order.

    Beads without a material from their source get the layers' own.
    Raises InputError for a file that cannot be read, a drawing that does not fit on the part, layers or beads that the
    process names but that do not exist, and anything too large to plan.
    """
    check_arrangement(problem)
    module, name = SOURCES[type(problem.layers)]
    source: Callable[[Problem, Any], Toolpath] = getattr(import_module(f"planner.toolpath.{module}"), name)
    toolpath = source(problem, problem.layers)
    drawn = len(toolpath.beads)
    if (spec := problem.process.skirt) is not None:
        from planner.toolpath.skirt import with_skirt  # imports shapely, which is slow

        toolpath = with_skirt(problem, toolpath, spec)
    check_laid(problem, toolpath)
    check_layers(problem, toolpath)
    if problem.process.interlayer_time is not None:
        from planner.toolpath.interlayer import with_interlayer_order  # loaded only if needed

        toolpath = with_interlayer_order(problem, toolpath, len(toolpath.beads) - drawn)
    toolpath = on_what_is_printed(problem, toolpath)
    toolpath = with_speeds(problem, toolpath)
    materials = problem.process.materials
    if not materials:
        return toolpath
    own = problem.layers.material or next(iter(materials))
    beads = tuple(bead if bead.material else replace(bead, material=own) for bead in toolpath.beads)
    return replace(toolpath, beads=beads)


def check_arrangement(problem: Problem) -> None:
    """Raise InputError for a seam or an order of beads that the source already fixes."""
    for key, given, sources in (("seam", problem.process.seam, SEAMS), ("order", problem.process.order, ORDERS)):
        if given and not isinstance(problem.layers, sources):
            reason = "where closed beads begin is fixed" if key == "seam" else "the order of beads is fixed"
            raise problem.error(f"process.{key}", f"{reason} by this source already", "leave it out")
