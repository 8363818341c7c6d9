"""What is printed, and on what: the sections `layers` and `part` of the problem file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast, get_args

from pydantic import Discriminator, Tag, model_validator

from planner.errors import nearest_name
from planner.problem_fields import PATH, Position, Quantity, Section, Thickness, Vector, key, one_of, refusal
from planner.problem_wing import AerofoilLayersSpec


class CylinderSpec(Section):
    """An upright cylinder, standing on the part frame's xy plane."""

    radius: Annotated[float, Quantity("mm", 1, 2000)] = key("radius_mm", "radius [mm]")
    height: Annotated[float, Quantity("mm", 1, 10_000)] = key("height_mm", "height [mm]")
    centre: Annotated[tuple[float, float], Quantity("mm", -10_000, 10_000, count=2)] = key(
        "centre_mm", "its axis in the part frame, x and y [mm]", (0, 0)
    )


class SphereSpec(Section):
    """A ball; where it reaches below the bed, it is a dome."""

    radius: Annotated[float, Quantity("mm", 1, 5000)] = key("radius_mm", "radius [mm]")
    centre: Position = key("centre_mm", "its centre in the part frame [mm]", (0, 0, 0))


class MeshSpec(Section):
    """A body from a file of facets; what is seen of it from above is printed on."""

    file: Annotated[Path, PATH] = key("file", "the STL file, in mm, counted from the folder of the problem file")
    origin: Position = key("origin_mm", "the file's origin in the part frame, once the file is turned [mm]", (0, 0, 0))
    rpy: Annotated[Vector, Quantity("deg", -360, 360, count=3)] = key(
        "rpy_deg",
        "the file turned about x, then y, then z of the part frame [deg]; [90, 0, 0] where y points up",
        (0, 0, 0),
    )


class PartSpec(Section):
    """The body to print on: one of these."""

    cylinder: CylinderSpec | None = key("cylinder", "an upright cylinder; default: none", None)
    sphere: SphereSpec | None = key("sphere", "a ball or a dome; default: none", None)
    mesh: MeshSpec | None = key("mesh", "a file of facets; default: none", None)

    @property
    def body(self) -> str:
        """Which of them it is, by its key."""
        return next(name for name in type(self).model_fields if getattr(self, name) is not None)

    @model_validator(mode="after")
    def _one_body(self) -> PartSpec:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) == 1:
            return self
        names = list(type(self).model_fields)
        if not given:
            raise refusal("no body is given", f"give one of them: {', '.join(names)}")
        raise refusal(f"both {given[0]} and {given[1]} are given", "give one of them", fields=given)


def _one_source(value: Any) -> Any:
    names = dict.fromkeys(name for kind in KINDS for name in kind.names)
    given = [name for name in names if isinstance(value, dict) and name in value]
    if len(given) > 1:
        raise refusal(f"both {given[0]} and {given[1]} are given", "give one of them", fields=given)
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


PatternName = Literal["honeycomb", "zigzag", "squares", "concentric"]
PATTERN_NAMES: tuple[str, ...] = get_args(PatternName)


class PatternSpec(Section):
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

    _one_source = model_validator(mode="before")(_one_source)


class LayersSpec(Section):
    """What is printed, and how often: a drawing wrapped around the part."""

    bodies: ClassVar[tuple[str, ...]] = ("cylinder",)  # what they can be laid on

    source: SvgSpec = key("source", "where the curves come from")
    wrap: Annotated[Literal["cylinder"], one_of(("cylinder",))] = key("wrap", "the surface they are laid on")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm]")


class ProjectedLayersSpec(Section):
    """What is printed, and how often: plane curves projected onto the part."""

    bodies: ClassVar[tuple[str, ...]] = ("sphere", "mesh")

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


class ProjectedDrawingSpec(ProjectedLayersSpec):
    """A drawing projected onto the part."""

    source: SvgSpec = key("source", "where the curves come from")


class ProjectedPatternSpec(ProjectedLayersSpec):
    """A pattern projected onto the part."""

    source: PatternSpec = key("source", "where the curves come from")


class WaypointLayersSpec(Section):
    """What is printed, if a file says it point by point: all layers stand in the file."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: WaypointsSpec = key("source", "where the waypoints come from")


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
    _Kind("[waypoints]", WaypointLayersSpec, ("waypoints",)),
    _Kind("[aerofoil]", AerofoilLayersSpec, ("aerofoil", "naca")),
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
    | Annotated[WaypointLayersSpec, Tag("[waypoints]")]
    | Annotated[AerofoilLayersSpec, Tag("[aerofoil]")],
    Discriminator(_kind_of_layers),
]


def check_body(part: PartSpec, layers: AnyLayersSpec) -> None:
    """Raise the refusal of a body that layers of this kind are not laid on."""
    if part.body in layers.bodies:
        return
    if not layers.bodies:
        wing = isinstance(layers, AerofoilLayersSpec)
        what = "a wing is its own body" if wing else "waypoints carry their own surface: there is no body"
        raise refusal(what, "leave out part")
    way, other = ("wrap", "project: z") if isinstance(layers, LayersSpec) else ("project", "wrap: cylinder")
    hint = f"layers.{way} goes with {' or '.join(layers.bodies)}; layers.{other} with {part.body}"
    raise refusal(f"layers.{way} and a {part.body} do not go together", hint, item=part.body)
