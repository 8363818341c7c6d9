"""Toolpaths that a slicer made for a printer with a level bed: the section `layers`, where its source is G-code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

from planner.problem.fields import PATH, Position, Quantity, Section, key
from planner.problem.materials import MaterialName, material_key
from planner.problem.sources import SourceSection


class GcodeSpec(SourceSection):
    """A file of planar G-code, whose extruding moves become beads."""

    gcode: Annotated[Path, PATH] = key("gcode", "the file, counted from the folder of the problem file")
    filament_diameter: Annotated[float, Quantity("mm", 0.5, 10)] | None = key(
        "filament_diameter_mm",
        "of the filament that the file was sliced for [mm]; default: process.filament_diameter_mm",
        None,
    )
    origin: Position = key("origin_mm", "the file's origin in the part frame, whose z = 0 is the bed [mm]", (0, 0, 0))


class GcodeLayersSpec(Section):
    """What is printed, if a slicer says it: all layers, and the beads' widths and heights, stand in the file."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: GcodeSpec = key("source", "where the G-code comes from")
    material: MaterialName | None = material_key("all beads")
