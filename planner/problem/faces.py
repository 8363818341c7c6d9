"""Faces of a STEP file: the body `part.step`, and the section `layers` where its source is faces that are covered."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, get_args

from planner.problem.fields import Quantity, Section, Thickness, key, one_of
from planner.problem.materials import MaterialName, material_key
from planner.problem.part import ANY_FACES, Faces
from planner.problem.sources import SourceSection

CoverName = Literal["rows", "weighted_greedy", "greedy", "tour"]
COVER_NAMES: tuple[str, ...] = get_args(CoverName)


class FacesSpec(SourceSection):
    """Faces that are covered with beads at a distance from each other."""

    faces: Faces = key("faces", f"the faces that are covered: {ANY_FACES}; of those of part.step")
    spacing: Annotated[float, Quantity("mm", 0.1, 1000)] = key(
        "spacing_mm", "distance between samples of a face, and between neighbouring rows [mm]"
    )
    path: Annotated[CoverName, one_of(COVER_NAMES)] = key(
        "path", f"how samples are joined: {', '.join(COVER_NAMES)}", "weighted_greedy"
    )


class FaceLayersSpec(Section):
    """What is printed, and how often: beads that cover faces."""

    bodies: ClassVar[tuple[str, ...]] = ("step",)

    source: FacesSpec = key("source", "which faces are covered, and how")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm], along the faces' normals")
    material: MaterialName | None = material_key("all beads")
