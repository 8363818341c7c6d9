"""Bodies that stand in the cell or belong to the print head, and how far everything keeps apart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import model_validator

from planner.problem.fields import PATH, Position, Quantity, Section, Vector, exactly_one, key, one_of, refusal

CARRIERS = ("world", "part")
Side = Annotated[Vector, Quantity("mm", 0.1, 100_000, count=3)]
Angles = Annotated[Vector, Quantity("deg", -360, 360, count=3)]


class CylinderSolidSpec(Section):
    """A cylinder about its own z axis."""

    radius: Annotated[float, Quantity("mm", 0.1, 50_000)] = key("radius_mm", "radius [mm]")
    height: Annotated[float, Quantity("mm", 0.1, 100_000)] = key("height_mm", "height [mm]")


class SolidSpec(Section):
    """One body: a box or a cylinder about its centre, or a file of facets."""

    model_config = exactly_one("box_mm", "cylinder", "mesh")

    box: Side | None = key("box_mm", "sides of a box along x, y and z [mm]; default: none", None)
    cylinder: CylinderSolidSpec | None = key("cylinder", "a cylinder along z; default: none", None)
    mesh: Annotated[Path, PATH] | None = key("mesh", "an STL file, in mm; default: none", None)
    centre: Position = key("centre_mm", "centre of box or cylinder, or the file's origin [mm]", (0, 0, 0))
    rpy: Angles = key("rpy_deg", "turned about x, then y, then z of what carries it [deg]", (0, 0, 0))

    @model_validator(mode="after")
    def _one_shape(self) -> SolidSpec:
        shapes = {"box": "box_mm", "cylinder": "cylinder", "mesh": "mesh"}
        given = [shapes[name] for name in shapes if getattr(self, name) is not None]
        if len(given) == 1:
            return self
        if not given:
            raise refusal("no shape is given", f"give one of them: {', '.join(shapes.values())}")
        raise refusal(f"both {given[0]} and {given[1]} are given", "give one of them", fields=given)


class FixtureSpec(SolidSpec):
    """A body that stands in the cell, or is carried with the part: a table, a vice, a wall."""

    on: Annotated[Literal["world", "part"], one_of(CARRIERS)] = key(
        "on", "what carries it: the world, or the part, with which it then turns", "world"
    )


class CollisionSpec(Section):
    """How far everything in the cell keeps apart."""

    nozzle: Annotated[float, Quantity("mm", 0, 100)] = key(
        "nozzle_mm", "least distance of nozzle and print head from all but what lies at the nozzle's tip [mm]", 2
    )
    arm: Annotated[float, Quantity("mm", 0, 1000)] = key(
        "arm_mm", "least distance of the robots' links from each other, from fixtures, part and print [mm]", 5
    )
