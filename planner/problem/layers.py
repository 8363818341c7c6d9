"""What is printed: the kinds of the section `layers` of the problem file, told apart by their keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, cast

from pydantic import Discriminator, Tag

from planner.errors import nearest_name
from planner.problem.cores import CoreLayersSpec
from planner.problem.curves import ProjectedCurvesSpec
from planner.problem.drawings import LayersSpec, ProjectedDrawingSpec, ProjectedLayersSpec, ProjectedPatternSpec
from planner.problem.faces import FaceLayersSpec
from planner.problem.fields import Section, refusal
from planner.problem.gcode import GcodeLayersSpec
from planner.problem.part import PartSpec
from planner.problem.volume import VolumeLayersSpec
from planner.problem.waypoints import WaypointLayersSpec
from planner.problem.wing import AerofoilLayersSpec


@dataclass(frozen=True)
class _Kind:
    """A kind of layers: its tag, its model, and the keys of `layers.source` that name it."""

    tag: str
    model: type[Section]
    names: tuple[str, ...]

    @property
    def source_keys(self) -> list[str]:
        return _aliases(cast(type[Section], self.model.model_fields["source"].annotation))

    def claim(self, layers: set[str | None], source: set[str | None]) -> tuple[int, int, int, int]:
        """How well it fits the keys that the file holds; the greatest fits best."""
        needed = {field.alias for field in self.model.model_fields.values() if field.is_required()}
        return (
            int(any(name in source for name in self.names)),
            len(source & set(self.source_keys)),
            len(layers & set(_aliases(self.model))),
            -len(needed - layers),
        )


def _aliases(model: type[Section]) -> list[str]:
    """The keys of a section, as they stand in the file."""
    return [field.alias or name for name, field in model.model_fields.items()]


KINDS = (
    _Kind("[svg]", LayersSpec, ("svg",)),
    _Kind("[projected]", ProjectedDrawingSpec, ("svg",)),
    _Kind("[pattern]", ProjectedPatternSpec, ("pattern",)),
    _Kind("[curves]", ProjectedCurvesSpec, ("curves",)),
    _Kind("[core]", CoreLayersSpec, ("pattern",)),
    _Kind("[waypoints]", WaypointLayersSpec, ("waypoints",)),
    _Kind("[gcode]", GcodeLayersSpec, ("gcode",)),
    _Kind("[volume]", VolumeLayersSpec, ("mesh",)),
    _Kind("[aerofoil]", AerofoilLayersSpec, ("aerofoil", "naca")),
    _Kind("[faces]", FaceLayersSpec, ("faces",)),
)


def _kind_of_layers(value: Any) -> str:
    """The tag of the model that the keys of `layers` belong to, misspelt ones read as what they may mean."""
    source = value.get("source") if isinstance(value, dict) else None
    if not isinstance(source, dict):
        source = {}
    inner = [key for kind in KINDS for key in kind.source_keys]
    outer = [key for kind in KINDS for key in _aliases(kind.model)]
    layers = value if isinstance(value, dict) else {}
    meant, beside = (
        {nearest_name(key, known) for key in section if isinstance(key, str)}
        for section, known in ((source, inner), (layers, outer))
    )
    if not source:
        return max(KINDS, key=lambda kind: len(beside & set(_aliases(kind.model)))).tag
    return max(KINDS, key=lambda kind: kind.claim(beside, meant)).tag


AnyLayersSpec = Annotated[
    Annotated[LayersSpec, Tag("[svg]")]
    | Annotated[ProjectedDrawingSpec, Tag("[projected]")]
    | Annotated[ProjectedPatternSpec, Tag("[pattern]")]
    | Annotated[ProjectedCurvesSpec, Tag("[curves]")]
    | Annotated[CoreLayersSpec, Tag("[core]")]
    | Annotated[WaypointLayersSpec, Tag("[waypoints]")]
    | Annotated[GcodeLayersSpec, Tag("[gcode]")]
    | Annotated[VolumeLayersSpec, Tag("[volume]")]
    | Annotated[AerofoilLayersSpec, Tag("[aerofoil]")]
    | Annotated[FaceLayersSpec, Tag("[faces]")],
    Discriminator(_kind_of_layers),
]


def check_body(part: PartSpec, layers: AnyLayersSpec) -> None:
    """Raise the refusal of a body that layers of this kind are not laid on."""
    if part.body in layers.bodies:
        if isinstance(layers, ProjectedLayersSpec) and layers.normals == "facets" and part.body != "mesh":
            raise refusal(f"a {part.body} has no facets", "leave out layers.normals, or give a mesh", item=part.body)
        return
    if not layers.bodies:
        what = "waypoints carry their own surface: there is no body"
        if isinstance(layers, AerofoilLayersSpec):
            what = "a wing is its own body"
        elif isinstance(layers, VolumeLayersSpec):
            what = "a mesh that is filled with layers is its own body"
        elif isinstance(layers, GcodeLayersSpec):
            what = "a slicer's layers are level, on the part frame's xy plane: there is no body"
        raise refusal(what, "leave out part")
    if isinstance(layers, FaceLayersSpec) or part.body == "step":
        raise refusal(
            f"layers of this kind and a {part.body} do not go together",
            f"these layers go with {' or '.join(layers.bodies)}; layers.source.faces with step",
            item=part.body,
        )
    way, other = ("wrap", "project: z") if isinstance(layers, LayersSpec) else ("project", "wrap: cylinder")
    hint = f"layers.{way} goes with {' or '.join(layers.bodies)}; layers.{other} with {part.body}"
    raise refusal(f"layers.{way} and a {part.body} do not go together", hint, item=part.body)
