"""What is printed, and on what: the sections `layers` and `part` of the problem file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import Discriminator, Tag, model_validator

from planner.errors import nearest_name
from planner.problem_fields import PATH, Position, Quantity, Section, Thickness, key, one_of, refusal
from planner.problem_wing import AerofoilLayersSpec


class CylinderSpec(Section):
    """An upright cylinder, standing on the part frame's xy plane."""

    radius: Annotated[float, Quantity("mm", 1, 2000)] = key("radius_mm", "radius [mm]")
    height: Annotated[float, Quantity("mm", 1, 10_000)] = key("height_mm", "height [mm]")
    centre: Annotated[tuple[float, float], Quantity("mm", -10_000, 10_000, count=2)] = key(
        "centre_mm", "its axis in the part frame, x and y [mm]", (0, 0)
    )


class PartSpec(Section):
    """The body to print on."""

    cylinder: CylinderSpec = key("cylinder", "an upright cylinder")


def _one_source(value: Any) -> Any:
    if isinstance(value, dict) and "svg" in value and "waypoints" in value:
        raise refusal("both svg and waypoints are given", "give one of them", fields=["svg", "waypoints"])
    return value


class SvgSpec(Section):
    """A drawing whose lines become beads."""

    svg: Annotated[Path, PATH] = key("svg", "the drawing, counted from the folder of the problem file")
    width: Annotated[float, Quantity("mm", 0.1, 15_000)] = key("width_mm", "width of the drawing on the part [mm]")

    _one_source = model_validator(mode="before")(_one_source)


class WaypointsSpec(Section):
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

    _one_source = model_validator(mode="before")(_one_source)


class LayersSpec(Section):
    """What is printed, and how often."""

    source: SvgSpec = key("source", "where the curves come from")
    wrap: Annotated[Literal["cylinder"], one_of(("cylinder",))] = key("wrap", "the surface they are laid on")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm]")


class WaypointLayersSpec(Section):
    """What is printed, if a file says it point by point: all layers stand in the file."""

    source: WaypointsSpec = key("source", "where the waypoints come from")


@dataclass(frozen=True)
class _Kind:
    """A kind of layers: its tag, its model, and the keys of `layers.source` that only it has and that name it."""

    tag: str
    model: type[Section]
    names: tuple[str, ...]

    @property
    def source_keys(self) -> list[str]:
        return _aliases(cast(type[Section], self.model.model_fields["source"].annotation))

    def claim(self, layers: dict[Any, Any], source: dict[Any, Any]) -> tuple[int, int, int, int]:
        """How well it fits what the file holds; the greatest fits best."""
        own = _aliases(self.model)
        needed = {field.alias for field in self.model.model_fields.values() if field.is_required()}
        return (
            int(any(name in source for name in self.names)),
            sum(key in self.source_keys for key in source),
            sum(key in own for key in layers),
            -len(needed - layers.keys()),
        )


def _aliases(model: type[Section]) -> list[str]:
    """The keys of a section, as they stand in the file."""
    return [field.alias or name for name, field in model.model_fields.items()]


KINDS = (
    _Kind("[svg]", LayersSpec, ("svg",)),
    _Kind("[waypoints]", WaypointLayersSpec, ("waypoints",)),
    _Kind("[aerofoil]", AerofoilLayersSpec, ("aerofoil", "naca")),
)


def _kind_of_layers(value: Any) -> str:
    """The tag of the model that the keys of `layers.source` belong to, misspelt ones read as what they may mean."""
    source = value.get("source") if isinstance(value, dict) else None
    if not isinstance(source, dict):
        return KINDS[0].tag
    known = list(dict.fromkeys(key for kind in KINDS for key in kind.source_keys))
    meant = {nearest_name(key, known): None for key in source if isinstance(key, str)}
    return max(KINDS, key=lambda kind: kind.claim(value, meant)).tag


AnyLayersSpec = Annotated[
    Annotated[LayersSpec, Tag("[svg]")]
    | Annotated[WaypointLayersSpec, Tag("[waypoints]")]
    | Annotated[AerofoilLayersSpec, Tag("[aerofoil]")],
    Discriminator(_kind_of_layers),
]
