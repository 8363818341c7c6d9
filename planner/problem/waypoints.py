"""Toolpaths that a file says point by point: the section `layers`, where its source is a file of waypoints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from planner.problem.fields import PATH, Position, Quantity, Section, key, one_of
from planner.problem.materials import MaterialName, material_key
from planner.problem.sources import SourceSection


class WaypointsSpec(SourceSection):
    """A file of waypoints, each with its normal, that become beads."""

    waypoints: Annotated[Path, PATH] = key(
        "waypoints",
        "the file, counted from the folder of the problem file: CSV or text, lines x y z nx ny nz, or NPZ with arrays "
        "of these names; columns layer, bead, width and height too, where they are named",
    )
    unit: Annotated[Literal["mm", "m"], one_of(("mm", "m"))] = key(
        "unit", "of the file's points, widths and heights: mm or m", "mm"
    )
    up: Annotated[Literal["z", "y"], one_of(("z", "y"))] = key(
        "up", "the file's axis that is the part frame's z; y turns (x, y, z) to (x, -z, y)", "z"
    )
    normals: Annotated[Literal["outward", "inward"], one_of(("outward", "inward"))] = key(
        "normals", "where the file's normals point: outward, against the nozzle, or inward, along it", "outward"
    )
    origin: Position = key("origin_mm", "the file's origin in the part frame, its axes turned [mm]", (0, 0, 0))
    split: Annotated[float, Quantity("mm", 0.01, 10_000)] | None = key(
        "split_mm",
        "a step longer than this begins a new bead [mm]; default: three median steps, or no step with a column bead",
        None,
    )
    smoothing: Annotated[float, Quantity("deg", 0, 30)] = key(
        "smooth_normals_deg",
        "how far a normal may be turned to smooth them along a bead [deg]; 0 takes them as they are",
        0,
    )


class WaypointLayersSpec(Section):
    """What is printed, if a file says it point by point: all layers stand in the file."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: WaypointsSpec = key("source", "where the waypoints come from")
    material: MaterialName | None = material_key("all beads")
