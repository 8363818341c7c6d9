"""Plane curves, wrapped around the part or projected onto it: the section `layers`, from a drawing or a pattern."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal, get_args

from pydantic import model_validator

from planner.problem.fields import PATH, Quantity, Section, Thickness, key, one_of, refusal
from planner.problem.materials import MaterialName, material_key
from planner.problem.sources import SourceSection

BLEND_MM = 6  # two facets of the published dome; measured in benchmarks.orientation


class SvgSpec(SourceSection):
    """A drawing whose lines become beads."""

    svg: Annotated[Path, PATH] = key("svg", "the drawing, counted from the folder of the problem file")
    width: Annotated[float, Quantity("mm", 0.1, 15_000)] = key("width_mm", "width of the drawing on the part [mm]")


PatternName = Literal["honeycomb", "zigzag", "squares", "concentric"]
PATTERN_NAMES: tuple[str, ...] = get_args(PatternName)


class PatternSpec(SourceSection):
    """A plane pattern whose lines become beads."""

    pattern: Annotated[PatternName, one_of(PATTERN_NAMES)] = key("pattern", f"one of {', '.join(PATTERN_NAMES)}")
    cell: Annotated[float, Quantity("mm", 0.1, 1000)] = key(
        "cell_mm", "width of a cell from wall to wall, or distance between lines [mm]"
    )
    size: Annotated[tuple[float, float], Quantity("mm", 0.1, 15_000, count=2)] = key(
        "size_mm", "what the pattern covers at most, in x and y [mm]"
    )
    outline: Annotated[Literal["rectangle", "ellipse"], one_of(("rectangle", "ellipse"))] = key(
        "outline", "shape of what it covers: rectangle or ellipse", "rectangle"
    )


class LayersSpec(Section):
    """What is printed, and how often: a drawing wrapped around the part."""

    bodies: ClassVar[tuple[str, ...]] = ("cylinder",)  # what they can be laid on

    source: SvgSpec = key("source", "where the curves come from")
    wrap: Annotated[Literal["cylinder"], one_of(("cylinder",))] = key("wrap", "the surface they are laid on")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm]")
    material: MaterialName | None = material_key("all beads")


class OnPartSpec(Section):
    """How plane curves fall onto the part."""

    project: Annotated[Literal["z"], one_of(("z",))] = key("project", "the axis along which curves fall onto the part")
    centre: Annotated[tuple[float, float], Quantity("mm", -100_000, 100_000, count=2)] = key(
        "centre_mm", "where the middle of the curves lies, x and y of the part frame [mm]", (0, 0)
    )
    turn: Annotated[float, Quantity("deg", -360, 360)] = key(
        "turn_deg", "by how much the curves are turned about the vertical [deg]", 0
    )


class ProjectedLayersSpec(OnPartSpec):
    """What is printed, and how often: plane curves projected onto the part."""

    bodies: ClassVar[tuple[str, ...]] = ("sphere", "ellipsoid", "plane", "corrugation", "mesh", "step")

    offset: Annotated[Literal["normal", "z"], one_of(("normal", "z"))] = key(
        "offset", "where the next layer lies: along the surface's normal, or along z", "normal"
    )
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm]")
    material: MaterialName | None = material_key("all beads")
    normals: Annotated[Literal["smooth", "facets"], one_of(("smooth", "facets"))] = key(
        "normals",
        "what the nozzle is normal to: a smooth surface through the facets of a mesh, or the facets themselves, between "
        "which it turns over blend_mm",
        "smooth",
    )
    blend: Annotated[float, Quantity("mm", 0.1, 100)] | None = key(
        "blend_mm",
        f"length along a bead over which the nozzle turns from one facet's normal to the next's [mm]; "
        f"default: {BLEND_MM} with normals: facets",
        None,
    )

    @model_validator(mode="after")
    def _blend_between_facets(self) -> ProjectedLayersSpec:
        if self.blend is not None and self.normals == "smooth":
            raise refusal("normals are smooth", "leave out blend_mm, or normals: facets", item="blend_mm")
        return self

    @property
    def facing(self) -> float | None:
        """Over how long a way the nozzle turns from facet to facet [m]; None where it follows the smooth surface."""
        if self.normals == "smooth":
            return None
        return BLEND_MM * 1e-3 if self.blend is None else self.blend


class ProjectedDrawingSpec(ProjectedLayersSpec):
    """A drawing projected onto the part."""

    source: SvgSpec = key("source", "where the curves come from")


class ProjectedPatternSpec(ProjectedLayersSpec):
    """A pattern projected onto the part."""

    source: PatternSpec = key("source", "where the curves come from")
