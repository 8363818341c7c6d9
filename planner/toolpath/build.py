"""From the problem's part and layers to a Toolpath: each kind of layers by its own source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

from planner.problem import Problem
from planner.problem.drawings import LayersSpec, ProjectedCurvesSpec, ProjectedDrawingSpec, ProjectedPatternSpec
from planner.problem.layers import (
    AerofoilLayersSpec,
    CoreLayersSpec,
    FaceLayersSpec,
    GcodeLayersSpec,
    VolumeLayersSpec,
    WaypointLayersSpec,
)
from planner.toolpath.bead import Toolpath
from planner.toolpath.task import noise_of

_NOISY = np.radians(
    0.05
)  # half of published normals are farther off, of those that come from formulas less than a tenth

# Module and function of each source. Only that of the problem is loaded: what reads drawings, meshes and CAD files takes a
# second together.
SOURCES: dict[type, tuple[str, str]] = {
    LayersSpec: ("wrapped", "wrap_drawing"),
    ProjectedDrawingSpec: ("substrate.projection", "project_curves"),
    ProjectedPatternSpec: ("substrate.projection", "project_curves"),
    ProjectedCurvesSpec: ("substrate.projection", "project_curves"),
    CoreLayersSpec: ("substrate.cores", "lay_core"),
    WaypointLayersSpec: ("waypoints.beads", "through_waypoints"),
    GcodeLayersSpec: ("gcode.layers", "slicer_print"),
    VolumeLayersSpec: ("volume.layers", "fill_mesh"),
    AerofoilLayersSpec: ("wing.wing", "lay_wing"),
    FaceLayersSpec: ("step.cover", "cover_faces"),
}


def build_toolpath(problem: Problem) -> Toolpath:
    """Read the source, round its corners and lay its beads in print order.

    Beads to which their source gives no material are of the layers' own.
    Raises InputError for a file that cannot be read, and for a drawing that does not fit on the part.
    """
    module, name = SOURCES[type(problem.layers)]
    source: Callable[[Problem, Any], Toolpath] = getattr(import_module(f"planner.toolpath.{module}"), name)
    toolpath = source(problem, problem.layers)
    if isinstance(problem.layers, WaypointLayersSpec) and problem.process.cones.tilt == 0.0:
        toolpath = replace(toolpath, notes=toolpath.notes + _noise_note(toolpath))
    materials = problem.process.materials
    if not materials:
        return toolpath
    own = problem.layers.material or next(iter(materials))
    beads = tuple(bead if bead.material else replace(bead, material=own) for bead in toolpath.beads)
    return replace(toolpath, beads=beads)


def _noise_note(toolpath: Toolpath) -> tuple[str, ...]:
    """What noisy normals cost where the nozzle has to follow them, and what would spare it; nothing for clean ones."""
    half, nearly_all = noise_of(toolpath.beads)
    if half < _NOISY:
        return ()
    enough = int(np.ceil(np.degrees(2.0 * nearly_all)))
    return (
        f"normals are noisy: half of them are more than {np.degrees(half):.2f} deg off what they are smoothed along the bead, "
        f"and the joints follow all of that; process.cones.nozzle_normal_deg: {enough} would let the nozzle pass over it, "
        "layers.source.smooth_normals_deg smooths it away",
    )
