"""Faces of a STEP file: the body `part.step`, and the section `layers` where its source is faces that are covered."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BeforeValidator

from planner.problem.fields import PATH, Position, Quantity, Section, Thickness, Vector, key, one_of, refusal
from planner.problem.file import describe
from planner.problem.materials import MaterialName, material_key
from planner.problem.sources import SourceSection

Face = int | str  # its number in the file, from 1, or its name

_ANY_FACES = "all, or a list of names and numbers, from 1, as they stand in the file"


def _faces(value: Any) -> Any:
    if value == "all":
        return value
    if not isinstance(value, (tuple, list)):
        raise refusal(f"must be a list of faces or all, not {describe(value)}", _ANY_FACES)
    if not value:
        raise refusal("names no face", _ANY_FACES)
    for i, face in enumerate(value):
        if type(face) not in (int, str) or face == "":
            raise refusal(f"is no name and no number of a face: {describe(face)}", _ANY_FACES, item=i)
        if face in value[:i]:
            raise refusal(f"{face!r} stands in the list twice", "name each face once", item=i)
    return tuple(value)


Faces = Annotated[tuple[Face, ...] | Literal["all"], BeforeValidator(_faces)]


class StepSpec(Section):
    """A body from a STEP file: faces, with material beneath them."""

    file: Annotated[Path, PATH] = key("file", "the STEP file, counted from the folder of the problem file")
    faces: Faces = key("faces", f"the faces that are there: {_ANY_FACES}", "all")
    normals: Annotated[Literal["outward", "inward"], one_of(("outward", "inward"))] = key(
        "normals", "where the file's faces look: out of the material, or into it, as open sheets may", "outward"
    )
    origin: Position = key("origin_mm", "the file's origin in the part frame, once the file is turned [mm]", (0, 0, 0))
    rpy: Annotated[Vector, Quantity("deg", -360, 360, count=3)] = key(
        "rpy_deg", "the file turned about x, then y, then z of the part frame [deg]", (0, 0, 0)
    )


CoverName = Literal["rows", "weighted_greedy", "greedy", "tour"]
COVER_NAMES: tuple[str, ...] = get_args(CoverName)


class FacesSpec(SourceSection):
    """Faces that are covered with beads at a distance from each other."""

    faces: Faces = key("faces", f"the faces that are covered: {_ANY_FACES}; of those of part.step")
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
