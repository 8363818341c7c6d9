"""Toolpaths that a file says point by point: the section `layers`, where its source is a file of waypoints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from planner.problem.fields import PATH, Position, Quantity, Section, key, one_of
from planner.problem.sources import SourceSection


class WaypointsSpec(SourceSection):
    """A file of waypoints, each with its normal, that become beads."""

    waypoints: Annotated[Path, PATH] = key(
        "waypoints", "the file, counted from the folder of the problem file: lines x y z nx ny nz, points in mm"
    )
    up: Annotated[Literal["z", "y"], one_of(("z", "y"))] = key(
        "up", "the file's axis that is the part frame's z; y turns (x, y, z) to (x, -z, y)", "z"
    )
    normals: Annotated[Literal["outward", "inward"], one_of(("outward", "inward"))] = key(
        "normals", "where the file's normals point: outward, against the nozzle, or inward, along it", "outward"
    )
    origin: Position = key("origin_mm", "the file's origin in the part frame, its axes turned [mm]", (0, 0, 0))
    split: Annotated[float, Quantity("mm", 0.01, 10_000)] | None = key(
        "split_mm", "a step longer than this begins a new bead [mm]; default: three median steps", None
    )


class WaypointLayersSpec(Section):
    """What is printed, if a file says it point by point: all layers stand in the file."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: WaypointsSpec = key("source", "where the waypoints come from")
