"""A closed mesh filled with layers between two surfaces: the section `layers` of the problem file, where it names one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import model_validator

from planner.problem.cores import MiddleSpec
from planner.problem.fields import PATH, Position, Quantity, Section, Thickness, Vector, key, refusal
from planner.problem.materials import MaterialName, material_key
from planner.problem.part import MeshSpec
from planner.problem.sources import SourceSection

_LEAST = 0.5  # of height_mm: thinner layers press the nozzle into those beneath


class SolidSpec(SourceSection):
    """The body that is printed."""

    mesh: Annotated[Path, PATH] = key("mesh", "a closed STL file, in mm, counted from the folder of the problem file")
    origin: Position = key("origin_mm", "the file's origin in the part frame, once the file is turned [mm]", (0, 0, 0))
    rpy: Annotated[Vector, Quantity("deg", -360, 360, count=3)] = key(
        "rpy_deg", "the file turned about x, then y, then z of the part frame [deg]", (0, 0, 0)
    )

    @property
    def file(self) -> MeshSpec:
        """The same as any file of facets."""
        return MeshSpec.model_construct(file=self.mesh, origin=self.origin, rpy=self.rpy)


class GuideSpec(MiddleSpec):
    """A surface that the layers begin at, or come to: a level plane, or the upper side of a mesh."""


class InfillSpec(Section):
    """What fills a layer between its walls: lines that go to and fro."""

    density: Annotated[float, Quantity("", 0.02, 1)] = key("density", "share of the inside that is filled", 1)
    angle: Annotated[float, Quantity("deg", -360, 360)] = key(
        "angle_deg", "direction of the lines, counted from x; every second layer lies across [deg]", 45
    )
    material: MaterialName | None = material_key("the infill", "the layers'")


class VolumeLayersSpec(Section):
    """What is printed, if it is a closed mesh: layers that change from its lower surface to its upper one."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: SolidSpec = key("source", "the body that is printed")
    lower: GuideSpec | None = key(
        "lower", "the surface that the layers begin at: z_mm or mesh; default: level with the body's lowest point", None
    )
    upper: GuideSpec | None = key(
        "upper", "the surface that the layers come to: z_mm or mesh; default: the body's own top", None
    )
    height: Thickness = key("height_mm", "vertical height of a layer where it is greatest [mm]")
    least_height: Thickness | None = key(
        "least_height_mm",
        "least vertical height [mm]: where layers would be thinner, fewer of them are laid; default: half of height_mm",
        None,
    )
    perimeters: Annotated[int, Quantity("", 0, 20, whole=True)] = key("perimeters", "how many beads run along walls", 1)
    infill: InfillSpec = key("infill", "what fills a layer between its walls; each of its keys has a default", {})
    tilt: Annotated[float, Quantity("deg", 1, 60)] = key("tilt_deg", "greatest tilt of a layer [deg]", 30)
    material: MaterialName | None = material_key("the layers")

    @model_validator(mode="after")
    def _heights_in_order(self) -> VolumeLayersSpec:
        if self.least_height is not None and self.least_height >= self.height:
            least, most = self.least_height * 1e3, self.height * 1e3
            reason = f"the least height, {least:g} mm, is not less than the greatest, {most:g} mm"
            raise refusal(
                reason, "less than height_mm, so that layers can follow both surfaces", item="least_height_mm"
            )
        return self

    @property
    def thinnest(self) -> float:
        """Least vertical height of a layer [m]."""
        return _LEAST * self.height if self.least_height is None else self.least_height
