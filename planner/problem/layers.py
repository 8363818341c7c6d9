"""What to print: the kinds of the section `layers` of the problem file, told apart by their keys."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast, get_args

from pydantic import Discriminator, Tag, WithJsonSchema, model_validator

from planner.base.errors import nearest_name
from planner.problem.drawings import (
    Crumbs,
    LayersSpec,
    OnPartSpec,
    PatternSpec,
    ProjectedCurvesSpec,
    ProjectedDrawingSpec,
    ProjectedDxfSpec,
    ProjectedLayersSpec,
    ProjectedNurbsSpec,
    ProjectedPatternSpec,
    SourceSection,
    WrappedDxfSpec,
    WrappedLayersSpec,
    crumbs_key,
)
from planner.problem.fields import (
    PATH,
    PATH_OR_ARRAYS,
    UNIQUE,
    Angles,
    FilamentDiameter,
    Form,
    Position,
    Quantity,
    Section,
    Thickness,
    exactly_one,
    key,
    one_of,
    refusal,
)
from planner.problem.part import (
    ANY_FACES,
    Faces,
    MeshSpec,
    PartSpec,
    Scale,
    Smooth,
    Unit,
    scale_key,
    smooth_key,
    unit_key,
)
from planner.problem.process import MaterialName, material_key
from planner.problem.waypoint_arrays import Place, WaypointArrays
from planner.problem.yaml_file import describe, shorten

CoverName = Literal["rows", "weighted_greedy", "greedy", "tour"]
COVER_NAMES: tuple[str, ...] = get_args(CoverName)

DirectionName = Literal["u", "v"]
DIRECTION_NAMES: tuple[str, ...] = get_args(DirectionName)

TransitionName = Literal["linear", "harmonic"]
TRANSITIONS: tuple[str, ...] = get_args(TransitionName)

ShareName = Literal["purge", "skirt", "brim", "support", "ironing"]
SHARE_NAMES: tuple[str, ...] = get_args(ShareName)

PASSES = ("joined", "apart")
METHODS = ("curved", "planar")
_POINTS = "file of the section's points, path relative to the problem file's folder"

_A_PATH = {"type": "string", "format": "path"}  # all that a file can hold there
_LEAST = 0.5  # × height_mm: thinner layers press the nozzle into those beneath


class FacesSpec(SourceSection):
    """Faces to cover with beads at a given spacing."""

    faces: Faces = key("faces", f"the faces to cover, out of those of part.step: {ANY_FACES}")
    spacing: Annotated[float, Quantity("mm", 0.1, 1000)] = key(
        "spacing_mm", "distance between samples of a face, and between neighbouring rows [mm]"
    )
    path: Annotated[CoverName, one_of(COVER_NAMES)] = key(
        "path", f"how samples are joined: {', '.join(COVER_NAMES)}", "weighted_greedy"
    )
    spacing_v: Annotated[float, Quantity("mm", 0.1, 1000)] | None = key(
        "spacing_v_mm", "distance between samples along v [mm]; default: spacing_mm, that along u", None
    )
    direction: Annotated[DirectionName, one_of(DIRECTION_NAMES)] | None = key(
        "direction",
        "face parameter along which samples form rows: u or v; default: the one whose path crosses itself, or is "
        "cut, less often",
        None,
    )
    weight: Annotated[float, Quantity("", 0, 100)] | None = key(
        "weight", "with weighted_greedy, extra cost of leaving a row, in distances between samples; default: 1", None
    )
    start: Position | None = key(
        "start_mm", "place on the part near which the first bead starts [mm]; default: the first sample", None
    )
    tolerance: Annotated[float, Quantity("mm", 1e-6, 1)] | None = key(
        "tolerance_mm", "greatest error of distances between samples [mm]; default: 0.001", None
    )

    @property
    def spacings(self) -> tuple[float, float]:
        """Distances between samples along u and along v [m]."""
        return self.spacing, self.spacing if self.spacing_v is None else self.spacing_v

    @model_validator(mode="after")
    def _as_joined(self) -> FacesSpec:
        of_samples = ("spacing_v", "direction", "start", "tolerance")
        unknown = {"rows": (*of_samples, "weight"), "weighted_greedy": ()}
        for name in unknown.get(self.path, ("weight",)):
            if getattr(self, name) is not None:
                with_it = "weighted_greedy" if name == "weight" else ", ".join(COVER_NAMES[1:])
                told = type(self).model_fields[name].alias
                raise refusal(f"path {self.path} does not use it", f"it belongs to path: {with_it}", item=told)
        if self.path == "tour" and self.start is not None:
            raise refusal("a tour chooses its own start", "leave it out, or set path: weighted_greedy", item="start_mm")
        return self


class FaceLayersSpec(Section):
    """Layers of beads that cover faces."""

    bodies: ClassVar[tuple[str, ...]] = ("step",)

    source: FacesSpec = key("source", "which faces to cover, and how")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm], along the faces' normals")
    material: MaterialName | None = material_key("all beads")


class GcodeSpec(SourceSection):
    """A file of planar G-code, whose extruding moves become beads."""

    gcode: Annotated[Path, PATH] = key("gcode", "the file, path relative to the problem file's folder")
    filament_diameter: FilamentDiameter | None = key(
        "filament_diameter_mm",
        "diameter of the filament that the file was sliced for [mm]; default: the one it states, else "
        "process.filament_diameter_mm",
        None,
    )
    origin: Position = key("origin_mm", "the file's origin in the part frame, whose z = 0 is the bed [mm]", (0, 0, 0))
    leave_out: Annotated[tuple[Annotated[ShareName, one_of(SHARE_NAMES)], ...], UNIQUE] = key(
        "leave_out",
        f"what not to print, of {', '.join(SHARE_NAMES)}, as named in the slicer's comments; skirt includes a brim "
        "if the slicer has one name for both",
        ("purge", "ironing"),
    )
    crumbs: Annotated[float, Quantity("", 0, 0.5)] = key(
        "leave_out_share",
        "share of the length up to which pieces shorter than a bead's width are left out; if there are more, the "
        "file is refused",
        0.01,
    )
    tools: tuple[MaterialName, ...] | None = key(
        "tool_materials", "the material of each tool in the file, that of tool 0 first; default: layers.material", None
    )


class GcodeLayersSpec(Section):
    """Layers from a slicer: the file holds all of them, and the beads' widths and heights."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: GcodeSpec = key("source", "where the G-code comes from")
    count: Annotated[int, Quantity("", 1, 100_000, whole=True)] | None = key(
        "count", "number of layers, from the lowest; default: all in the file", None
    )
    material: MaterialName | None = material_key("all beads")


class WaypointsSpec(SourceSection):
    """A file of waypoints, each with its normal, that become beads."""

    waypoints: Annotated[Path | WaypointArrays, PATH_OR_ARRAYS, WithJsonSchema(_A_PATH)] = key(
        "waypoints",
        "the file, path relative to the problem file's folder: CSV or text, lines x y z nx ny nz, or NPZ with arrays "
        "of these names; also columns layer, bead, width and height, if they are named",
    )
    unit: Annotated[Literal["mm", "m"], one_of(("mm", "m"))] = key(
        "unit", "unit of the file's points, widths and heights: mm or m", "mm"
    )
    up: Annotated[Literal["z", "y", "x"], one_of(("z", "y", "x"))] = key(
        "up",
        "the file's axis that becomes the part frame's z; y turns (x, y, z) into (x, -z, y), x into (y, z, x)",
        "z",
    )
    normals: Annotated[Literal["outward", "inward"], one_of(("outward", "inward"))] = key(
        "normals", "where the file's normals point: outward, against the nozzle, or inward, along it", "outward"
    )
    origin: Position = key("origin_mm", "the file's origin in the part frame, once its axes are turned [mm]", (0, 0, 0))
    kind: Annotated[Literal["surface", "spatial"], one_of(("surface", "spatial"))] | None = key(
        "kind",
        "what the beads lie on: surface, each other or a substrate; spatial, nothing: round struts and columns in "
        "space; default: surface, or spatial if the file describes no surface",
        None,
    )
    split: Annotated[float, Quantity("mm", 0.01, 10_000)] | None = key(
        "split_mm",
        "a step longer than this begins a new bead [mm]; default: three median steps, or no step with a column bead",
        None,
    )
    crumbs: Annotated[float, Quantity("", 0, 0.5)] = key(
        "leave_out_share",
        "share of the length up to which paths shorter than a bead's width and isolated waypoints are left out, and "
        "normals that point the wrong way are reversed; if there are more, the file is refused",
        0.01,
    )
    smoothing: Annotated[float, Quantity("deg", 0, 30)] | None = key(
        "smooth_normals_deg",
        "how far normals may be turned to smooth them along a bead [deg]; 0 leaves them as they are; default: at "
        "most 3 where they are noisy and the nozzle may not lean, else 0",
        None,
    )

    @property
    def name(self) -> str:
        """The file's name, or "arrays", for notes."""
        return self.waypoints.name if isinstance(self.waypoints, Path) else "arrays"

    def place(self, row: int) -> Place:
        """The place of a waypoint for an error: file and line, or its index in the arrays."""
        given = self.waypoints
        if isinstance(given, Path):
            return {"file": given, "line": int(row)}
        return {"field": f"points{given.index(int(row))}"}

    def rows(self, numbers: Sequence[int], most: int) -> str:
        """Some waypoints in words, at most `most` of them: lines of the file, or indices."""
        given, s = self.waypoints, "s" if len(numbers) > 1 else ""
        more = ", ..." if len(numbers) > most else ""
        if isinstance(given, Path):
            return f"line{s} {', '.join(map(str, numbers[:most]))}{more}"
        return f"waypoint{s} {', '.join(given.index(row) for row in numbers[:most])}{more}"


class WaypointLayersSpec(Section):
    """Layers given point by point: the file holds all of them."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: WaypointsSpec = key("source", "where the waypoints come from")
    material: MaterialName | None = material_key("all beads")


def _naca(value: Any) -> str:
    if not isinstance(value, str):
        raise refusal(f"must be four digits in quotes, not {describe(value)}", 'for example naca: "0015"')
    if not re.fullmatch(r"[0-9]{4}", value):
        raise refusal(f"{shorten(value)!r} is not a four-digit section", 'for example naca: "0015"')
    if value[2:] == "00":
        raise refusal(f"section {value} has no thickness", 'the last two digits, for example naca: "0015"')
    if (value[0] == "0") != (value[1] == "0"):
        reason = f"section {value} has camber without its place, or a place without camber"
        raise refusal(reason, "the first two digits are both 0, or neither is")
    return value


_NACA = Form(_naca, schema={"pattern": "^[0-9]{4}$"})


class TipSpec(Section):
    """A wing's section at the end of its span, joined by straight lines to the section at the start of the span."""

    aerofoil: Annotated[Path, PATH] | None = key("aerofoil", f"{_POINTS}; default: none", None)
    naca: Annotated[str, _NACA] | None = key(
        "naca", "its four-digit NACA section, in quotes; default: the one at the start of the span", None
    )
    chord: Annotated[float, Quantity("mm", 1, 10_000)] = key("chord_mm", "length of the chord [mm]")
    sweep: Annotated[float, Quantity("mm", -10_000, 10_000)] = key(
        "sweep_mm", "how far its leading edge lies behind that at the start of the span [mm]", 0
    )
    washout: Annotated[float, Quantity("deg", -30, 30)] = key(
        "washout_deg", "how far it is turned nose down, about a quarter of its chord [deg]", 0
    )

    @model_validator(mode="after")
    def _one_section(self) -> TipSpec:
        if self.aerofoil is not None and self.naca is not None:
            raise refusal("both aerofoil and naca are given", "give one of them, or none", fields=["aerofoil", "naca"])
        return self


class AerofoilSpec(Section):
    """A wing: a section along a span. The part frame's x runs along the chord, y along the span."""

    model_config = exactly_one("aerofoil", "naca")

    aerofoil: Annotated[Path, PATH] | None = key("aerofoil", f"{_POINTS}; default: none, naca instead", None)
    naca: Annotated[str, _NACA] | None = key(
        "naca", "the four-digit NACA section, in quotes; default: none, aerofoil instead", None
    )
    chord: Annotated[float, Quantity("mm", 1, 10_000)] = key("chord_mm", "length of the chord [mm]")
    span: Annotated[float, Quantity("mm", 1, 10_000)] = key("span_mm", "length of the span [mm]")
    origin: Position = key("origin_mm", "leading edge at the start of the span, in the part frame [mm]", (0, 0, 0))
    tilt: Annotated[float, Quantity("deg", 5, 90)] = key(
        "tilt_deg", "greatest tilt of a layer [deg]; where a layer is steeper, it is left out", 45
    )
    tip: TipSpec | None = key("tip", "the section at the end of the span; default: the same all along the span", None)
    method: Annotated[str, one_of(METHODS)] = key(
        "method", "curved: layers parallel to the wing's surfaces; planar: level ones, for comparison", "curved"
    )

    @model_validator(mode="after")
    def _one_section(self) -> AerofoilSpec:
        if (self.aerofoil is None) == (self.naca is None):
            found = "neither aerofoil nor naca is" if self.naca is None else "both aerofoil and naca are"
            raise refusal(f"{found} given", "give exactly one of them", fields=["aerofoil", "naca"])
        return self


class SupportSpec(Section):
    """Support under a wing: sparsely filled level layers, and on them curved ones that follow the wing's surface."""

    length: Annotated[float, Quantity("mm", 1, 10_000)] = key(
        "length_mm",
        "length of the level layers along the chord, extending as far in front of the wing as behind it [mm]",
    )
    height: Annotated[float, Quantity("mm", 0, 10_000)] = key(
        "height_mm", "height of the level layers in front of and behind the wing [mm]"
    )
    infill: Annotated[float, Quantity("", 0.1, 1)] = key("infill", "share of the level layers that is filled", 0.5)
    curved: Annotated[int, Quantity("", 0, 20, whole=True)] = key("curved", "number of curved layers", 2)
    material: MaterialName | None = material_key("the support", "the wing's")


class AerofoilLayersSpec(Section):
    """Layers of a wing, parallel to its lower and its upper surface."""

    bodies: ClassVar[tuple[str, ...]] = ()  # a wing is its own body

    source: AerofoilSpec = key("source", "where the wing's section comes from")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] | None = key(
        "count", "number of layers, from the first; default: all of support and wing", None
    )
    height: Thickness = key("height_mm", "height of a layer [mm]")
    support: SupportSpec | None = key(
        "support", "support to print under the wing; default: none, it is already there", None
    )
    passes: Annotated[str, one_of(PASSES)] = key(
        "passes",
        "joined: each layer, or piece of one, as one zig-zag bead; apart: each pass as a bead of its own, with the "
        "extruder off in the turns",
        "joined",
    )
    material: MaterialName | None = material_key("the wing")


class MiddleSpec(Section):
    """The surface up to which the lower half of a core reaches, and at which it is mirrored: one of these."""

    model_config = exactly_one("z_mm", "mesh")

    z: Annotated[float, Quantity("mm", -100_000, 100_000)] | None = key(
        "z_mm", "height of a level plane in the part frame [mm]; default: none, mesh instead", None
    )
    mesh: MeshSpec | None = key("mesh", "a file of facets, used as seen from above; default: none", None)

    @model_validator(mode="after")
    def _one_middle(self) -> MiddleSpec:
        if (self.z is None) == (self.mesh is None):
            found = "neither z_mm nor mesh is" if self.z is None else "both z_mm and mesh are"
            raise refusal(f"{found} given", "give exactly one of them", fields=["z_mm", "mesh"])
        return self


class CoreLayersSpec(OnPartSpec):
    """A core: a pattern in layers from the part up to a middle surface, and their mirror image on top."""

    bodies: ClassVar[tuple[str, ...]] = ("mesh",)

    project: Annotated[Literal["z"], one_of(("z",))] = key(
        "project", "the axis along which curves are projected onto the part"
    )
    source: PatternSpec = key("source", "where the curves come from")
    up_to: MiddleSpec = key("up_to", "the middle of the core: z_mm or mesh")
    halves: Annotated[Literal["both", "lower"], one_of(("both", "lower"))] = key(
        "halves", "what to print: both halves, or the lower one", "both"
    )
    heights: Annotated[Literal["even", "varying"], one_of(("even", "varying"))] = key(
        "heights",
        "even: each layer height_mm above the one before, cut off at the middle; "
        "varying: all layers from end to end, sharing the height there is evenly",
        "even",
    )
    height: Thickness = key("height_mm", "vertical height of a layer; with varying heights, the greatest [mm]")
    least_height: Thickness | None = key(
        "least_height_mm",
        "layers of varying height are left out where they would be lower than this [mm]; default: a fifth of height_mm",
        None,
    )
    tilt: Annotated[float, Quantity("deg", 5, 75)] = key(
        "tilt_deg", "greatest tilt of a layer [deg]; where a layer is steeper, it is left out", 45
    )
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] | None = key(
        "count", "number of layers, from the first; default: all", None
    )
    material: MaterialName | None = material_key("all beads")

    @model_validator(mode="after")
    def _heights_in_order(self) -> CoreLayersSpec:
        if self.least_height is None:
            return self
        if self.heights == "even":
            raise refusal(
                "heights are even", "leave out least_height_mm, or set heights: varying", item="least_height_mm"
            )
        if self.least_height > self.height:
            least, most = self.least_height * 1e3, self.height * 1e3
            reason = f"the least height, {least:g} mm, is more than the greatest, {most:g} mm"
            raise refusal(reason, "at most height_mm", item="least_height_mm")
        return self


class SolidSpec(SourceSection):
    """The body to print."""

    mesh: Annotated[Path, PATH] = key(
        "mesh", "a closed body (STL, PLY, OBJ, OFF, 3MF, STEP or IGES), path relative to the problem file's folder"
    )
    unit: Unit | None = unit_key()
    scale: Scale = scale_key()
    origin: Position = key("origin_mm", "the file's origin in the part frame, once the file is turned [mm]", (0, 0, 0))
    rpy: Angles = key("rpy_deg", "the file turned about x, then y, then z of the part frame [deg]", (0, 0, 0))
    smooth: Smooth | None = smooth_key()
    crumbs: Crumbs = crumbs_key("the volume (too narrow for a bead)")
    holes: Annotated[float, Quantity("mm", 0, 10_000)] | None = key(
        "close_holes_mm",
        "holes in the mesh up to this wide are closed and reported; their width is 4 times their area over the "
        "length of their rim, which is the diameter of a round hole and twice the width of a slit [mm]; with wider "
        "holes the mesh is refused; default: a bead's width, for 5 % of the surface at most",
        None,
    )

    @property
    def file(self) -> MeshSpec:
        """The same as a section for any file of facets."""
        return MeshSpec.model_construct(
            file=self.mesh, unit=self.unit, scale=self.scale, origin=self.origin, rpy=self.rpy, smooth=self.smooth
        )


class GuideSpec(MiddleSpec):
    """The surface where layers begin, or whose shape they approach: a level plane, or the upper side of a mesh."""


class InfillSpec(Section):
    """What fills a layer between its walls: lines back and forth."""

    density: Annotated[float, Quantity("", 0.02, 1)] = key("density", "share of the inside that is filled", 1)
    angle: Annotated[float, Quantity("deg", -360, 360)] = key(
        "angle_deg", "direction of the lines, counted from x; in every second layer they lie across [deg]", 45
    )
    material: MaterialName | None = material_key("the infill", "the layers'")


class VolumeLayersSpec(Section):
    """Layers of a closed mesh that change from the shape of its lower surface to that of its upper one."""

    bodies: ClassVar[tuple[str, ...]] = ()

    source: SolidSpec = key("source", "the body to print")
    lower: GuideSpec | None = key(
        "lower", "the surface where the layers begin: z_mm or mesh; default: level with the body's lowest point", None
    )
    upper: GuideSpec | None = key(
        "upper",
        "the surface whose shape the layers approach, z_mm or mesh; it cuts nothing off: they continue up to the "
        "body's top; default: that top",
        None,
    )
    height: Thickness = key("height_mm", "vertical height of a layer where it is greatest [mm]")
    least_height: Thickness | None = key(
        "least_height_mm",
        "least vertical height [mm]; where layers would be thinner, there are fewer of them; default: half of "
        "height_mm",
        None,
    )
    transition: Annotated[TransitionName, one_of(TRANSITIONS)] = key(
        "transition",
        "how layers change from the lower surface to the upper one: linear divides the height evenly along z, harmonic "
        "follows the level surfaces of the harmonic field between them",
        "linear",
    )
    perimeters: Annotated[int, Quantity("", 0, 20, whole=True)] = key("perimeters", "number of beads along walls", 1)
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


@dataclass(frozen=True)
class _Kind:
    """A kind of layers: its tag, its model, and the keys of `layers.source` that identify it."""

    tag: str
    model: type[Section]
    names: tuple[str, ...]

    @property
    def source_keys(self) -> list[str]:
        return _aliases(cast(type[Section], self.model.model_fields["source"].annotation))

    def claim(self, layers: set[str | None], source: set[str | None]) -> tuple[int, int, int, int]:
        """How well it fits the keys in the file; the greatest fits best."""
        needed = {field.alias for field in self.model.model_fields.values() if field.is_required()}
        return (
            int(any(name in source for name in self.names)),
            len(source & set(self.source_keys)),
            len(layers & set(_aliases(self.model))),
            -len(needed - layers),
        )


def _aliases(model: type[Section]) -> list[str]:
    """The keys of a section, as in the file."""
    return [field.alias or name for name, field in model.model_fields.items()]


KINDS = (
    _Kind("[svg]", LayersSpec, ("svg",)),
    _Kind("[projected]", ProjectedDrawingSpec, ("svg",)),
    _Kind("[dxf]", WrappedDxfSpec, ("dxf",)),
    _Kind("[projected dxf]", ProjectedDxfSpec, ("dxf",)),
    _Kind("[pattern]", ProjectedPatternSpec, ("pattern",)),
    _Kind("[curves]", ProjectedCurvesSpec, ("curves",)),
    _Kind("[nurbs]", ProjectedNurbsSpec, ("nurbs",)),
    _Kind("[core]", CoreLayersSpec, ("pattern",)),
    _Kind("[waypoints]", WaypointLayersSpec, ("waypoints",)),
    _Kind("[gcode]", GcodeLayersSpec, ("gcode",)),
    _Kind("[volume]", VolumeLayersSpec, ("mesh",)),
    _Kind("[aerofoil]", AerofoilLayersSpec, ("aerofoil", "naca")),
    _Kind("[faces]", FaceLayersSpec, ("faces",)),
)


def _kind_of_layers(value: Any) -> str:
    """The tag of the model that the keys of `layers` belong to; misspelt ones are read as what they may mean."""
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
    | Annotated[WrappedDxfSpec, Tag("[dxf]")]
    | Annotated[ProjectedDxfSpec, Tag("[projected dxf]")]
    | Annotated[ProjectedPatternSpec, Tag("[pattern]")]
    | Annotated[ProjectedCurvesSpec, Tag("[curves]")]
    | Annotated[ProjectedNurbsSpec, Tag("[nurbs]")]
    | Annotated[CoreLayersSpec, Tag("[core]")]
    | Annotated[WaypointLayersSpec, Tag("[waypoints]")]
    | Annotated[GcodeLayersSpec, Tag("[gcode]")]
    | Annotated[VolumeLayersSpec, Tag("[volume]")]
    | Annotated[AerofoilLayersSpec, Tag("[aerofoil]")]
    | Annotated[FaceLayersSpec, Tag("[faces]")],
    Discriminator(_kind_of_layers),
]


def check_body(part: PartSpec, layers: AnyLayersSpec) -> None:
    """Raise the refusal of a body that layers of this kind cannot be laid on."""
    if part.body in layers.bodies:
        if isinstance(layers, ProjectedLayersSpec) and layers.normals == "facets" and part.body != "mesh":
            raise refusal(f"a {part.body} has no facets", "leave out layers.normals, or give a mesh", item=part.body)
        if isinstance(layers, ProjectedLayersSpec) and layers.project != "z" and part.body not in layers.exact:
            reason = f"layers.project: {layers.project} and a {part.body} do not go together"
            hint = f"it goes with {', '.join(layers.exact)}; turn the {part.body} with rpy_deg, and project: z"
            raise refusal(reason, hint, item=part.body)
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
    way, other = ("wrap", "project: z") if isinstance(layers, WrappedLayersSpec) else ("project", "wrap: cylinder")
    hint = f"layers.{way} goes with {' or '.join(layers.bodies)}; layers.{other} with {part.body}"
    raise refusal(f"layers.{way} and a {part.body} do not go together", hint, item=part.body)
