"""Plane curves, wrapped around the part or projected onto it: the section `layers`, from a drawing or a pattern."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal, get_args

from planner.problem.fields import PATH, Quantity, Section, Thickness, key, one_of
from planner.problem.materials import MaterialName, material_key
from planner.problem.sources import SourceSection


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


class ProjectedLayersSpec(Section):
    """What is printed, and how often: plane curves projected onto the part."""

    bodies: ClassVar[tuple[str, ...]] = ("sphere", "ellipsoid", "plane", "corrugation", "mesh")

    project: Annotated[Literal["z"], one_of(("z",))] = key("project", "the axis along which curves fall onto the part")
    offset: Annotated[Literal["normal", "z"], one_of(("normal", "z"))] = key(
        "offset", "where the next layer lies: along the surface's normal, or along z", "normal"
    )
    centre: Annotated[tuple[float, float], Quantity("mm", -100_000, 100_000, count=2)] = key(
        "centre_mm", "where the middle of the curves lies, x and y of the part frame [mm]", (0, 0)
    )
    turn: Annotated[float, Quantity("deg", -360, 360)] = key(
        "turn_deg", "by how much the curves are turned about the vertical [deg]", 0
    )
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm]")
    material: MaterialName | None = material_key("all beads")


class ProjectedDrawingSpec(ProjectedLayersSpec):
    """A drawing projected onto the part."""

    source: SvgSpec = key("source", "where the curves come from")


class ProjectedPatternSpec(ProjectedLayersSpec):
    """A pattern projected onto the part."""

    source: PatternSpec = key("source", "where the curves come from")
