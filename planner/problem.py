"""The problem: cell, part, layers, process and strategy, from one YAML file into frozen SI values.

The keys of the file are the aliases, in mm and degrees; the names of the attributes carry no unit because they are SI
(m, s, rad). What a value may be, and why, stands with its field.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import PrivateAttr, ValidationError, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticKnownError

from planner.errors import InputError
from planner.problem_extrusion import BeadSpec, ExtruderSpec, SectionName
from planner.problem_fields import (
    IDENTIFIER,
    INCREASING,
    TEXT,
    UNIQUE,
    UNIT_VECTOR,
    Position,
    Quantity,
    Section,
    Vector,
    one_of,
    refusal,
)
from planner.problem_fields import key as _key
from planner.problem_file import Source, apply_overrides, find_problem, read_problem_file, shipped_problems
from planner.problem_mistakes import first_mistake
from planner.problem_process import AroundBeadSpec
from planner.problem_sources import (
    AnyLayersSpec,
    LayersSpec,
    MeshSpec,
    PartSpec,
    PatternSpec,
    ProjectedLayersSpec,
    SvgSpec,
    WaypointLayersSpec,
    WaypointsSpec,
    check_body,
)

__all__ = [
    "STRATEGY_NAMES",
    "CellSpec",
    "LayersSpec",
    "MeshSpec",
    "PartSpec",
    "PatternSpec",
    "PositionerSpec",
    "Problem",
    "ProjectedLayersSpec",
    "SvgSpec",
    "WaypointLayersSpec",
    "WaypointsSpec",
    "find_problem",
    "load_problem",
    "shipped_problems",
]

StrategyName = Literal["as_published", "fixed", "greedy", "ladder", "sqp", "nlp"]
STRATEGY_NAMES: tuple[str, ...] = get_args(StrategyName)
QPName = Literal["interior_point", "osqp"]
QP_NAMES: tuple[str, ...] = get_args(QPName)

Text = Annotated[str, TEXT]
Identifier = Annotated[str, IDENTIFIER]
Angle = Annotated[float, Quantity("deg", -3600, 3600)]  # ten turns: no cable allows more
MOST_JOINTS = 12  # of an arm; how many it has, its own file says
Speed = Annotated[float, Quantity("mm/s", 0.1, 2000)]  # below, a print takes days; above, no arm is exact


class NozzleSpec(Section):
    """The nozzle on the arm's flange."""

    tip: Position = _key("tip_mm", "nozzle tip in the flange frame [mm]")
    axis: Annotated[Vector, Quantity("", -1e6, 1e6, count=3), UNIT_VECTOR] = _key(
        "axis", "direction in which the nozzle points, in the flange frame, any length but 0", (0, 0, 1)
    )
    diameter: Annotated[float, Quantity("mm", 0.05, 50)] = _key("diameter_mm", "bore of the nozzle [mm]")


class PositionerSpec(Section):
    """A positioner, or an arm, that holds the part; its plate or flange carries the part frame."""

    robot: Text = _key("robot", "key of the positioner in robots/, or of an arm that holds the part")
    origin: Position | None = _key(
        "origin_mm", "centre of the plate in the world, all its axes at 0 [mm]; default: none, but base_mm", None
    )
    base: Position | None = _key("base_mm", "where its base stands in the world [mm]; default: none", None)
    turn: Annotated[float, Quantity("deg", -360, 360)] = _key(
        "turn_deg", "by how much its base is turned about the vertical [deg]", 0
    )
    free: Annotated[tuple[Text, ...], UNIQUE] = _key("free", "axes that the planner may move; the others are held")
    held: dict[Text, Angle] = _key("held_deg", "angles of held axes by name [deg]; each default 0", {})
    home: dict[Text, Angle] = _key(
        "home_deg", "angles of free axes that the search starts from, by name [deg]; each default 0", {}
    )
    part: Position = _key("part_mm", "origin of the part frame on the plate or flange [mm]", (0, 0, 0))
    part_rpy: Annotated[Vector, Quantity("deg", -360, 360, count=3)] = _key(
        "part_rpy_deg", "the part frame turned about x, then y, then z of the plate or flange [deg]", (0, 0, 0)
    )

    @model_validator(mode="after")
    def _one_place(self) -> PositionerSpec:
        if (self.origin is None) == (self.base is None):
            found = "neither origin_mm nor base_mm is" if self.base is None else "both origin_mm and base_mm are"
            raise refusal(f"{found} given", "give exactly one of them", fields=["origin_mm", "base_mm"])
        return self

    @model_validator(mode="after")
    def _free_or_held(self) -> PositionerSpec:
        for name in self.free:
            if name in self.held:
                raise refusal(
                    f"axis {name!r} is both free and held", "an axis is one or the other", fields=["free", "held_deg"]
                )
        return self


class JointLimitsSpec(Section):
    """Limits of one joint, where the user knows better than the robot's own file."""

    range: Annotated[tuple[float, float], Quantity("deg", -3600, 3600, count=2), INCREASING] | None = _key(
        "range_deg", "least and greatest angle [deg]; default: the robot's", None
    )
    speed: Annotated[float, Quantity("deg/s", 0.01, 10_000)] | None = _key(
        "speed_deg_s", "greatest speed [deg/s]; default: the robot's", None
    )
    acceleration: Annotated[float, Quantity("rad/s2", 0.001, 10_000)] | None = _key(
        "acceleration_rad_s2", "greatest acceleration [rad/s2]; default: the robot's", None
    )
    jerk: Annotated[float, Quantity("rad/s3", 0.01, 1e7)] | None = _key(
        "jerk_rad_s3", "greatest jerk [rad/s3]; default: the robot's", None
    )


class CellSpec(Section):
    """Arm, nozzle and what carries the part: a positioner or a fixed bed."""

    arm: Text = _key("arm", "key of the arm in robots/")
    base: Position = _key("base_mm", "base of the arm in the world [mm]", (0, 0, 0))
    nozzle: NozzleSpec = _key("nozzle", "the nozzle on the arm's flange")
    home: Annotated[tuple[float, ...], Quantity("deg", -3600, 3600, count=(1, MOST_JOINTS))] = _key(
        "home_deg", "posture of the arm before and after the print, each joint from the base on [deg]"
    )
    positioner: PositionerSpec | None = _key("positioner", "what turns the part; default: none, but a bed", None)
    bed: Position | None = _key("bed_mm", "origin of the part frame on a fixed bed [mm]; default: none", None)
    limits: dict[Text, JointLimitsSpec] = _key("limits", "limits of your own by joint; default: the robots'", {})

    @model_validator(mode="after")
    def _one_holder(self) -> CellSpec:
        if (self.positioner is None) == (self.bed is None):
            found = "neither positioner nor bed_mm is" if self.bed is None else "both positioner and bed_mm are"
            reason = f"{found} given"
            raise refusal(reason, "give exactly one of them", fields=["positioner", "bed_mm"])
        return self


class ConesSpec(Section):
    """How far the nozzle and the layer may lean, as half angles of cones."""

    tilt: Annotated[float, Quantity("deg", 0, 60)] = _key(
        "nozzle_normal_deg", "nozzle axis from the surface normal [deg]; 0 keeps it on the normal", 0
    )
    nozzle_gravity: Annotated[float, Quantity("deg", 1, 180)] = _key(
        "nozzle_gravity_deg", "nozzle axis from straight down [deg]; 180 is free", 180
    )
    layer_gravity: Annotated[float, Quantity("deg", 1, 180)] = _key(
        "layer_gravity_deg", "surface normal from straight up [deg]; 180 is free", 180
    )


class ProcessSpec(AroundBeadSpec):
    """How material is laid down, and what happens around a bead."""

    speed: Speed = _key("speed_mm_s", "speed of the nozzle along the part while printing [mm/s]")
    travel_speed: Speed = _key("travel_speed_mm_s", "greatest speed between beads [mm/s]")
    bead: BeadSpec = _key("bead", "cross-section of a bead")
    corner_tolerance: Annotated[float, Quantity("mm", 0.01, 5)] = _key(
        "corner_tolerance_mm", "how far a rounded corner may leave the drawn one [mm]; finer than an arm repeats", 0.2
    )
    chord_tolerance: Annotated[float, Quantity("mm", 0.0005, 1)] = _key(
        "chord_tolerance_mm", "how far curves may leave the lines that approximate them [mm]", 0.01
    )
    cones: ConesSpec = _key("cones", "how far nozzle and layer may lean; each has a default", {})
    filament_diameter: Annotated[float, Quantity("mm", 0.5, 10)] = _key(
        "filament_diameter_mm", "diameter of the filament that the extruder pushes [mm]", 1.75
    )
    extruder: ExtruderSpec = _key("extruder", "what pushes the filament; each has a default", {})

    @property
    def section(self) -> SectionName:
        """Shape of a bead's cross-section."""
        return self.bead.section or ("rectangle" if self.fibre is None else "fibre")

    @model_validator(mode="after")
    def _motor_can_pull_back(self) -> ProcessSpec:
        if self.extruder.motor == "on_off" and self.retract.length > 0.0:
            reason = "a motor that is only on or off cannot pull filament back"
            raise refusal(reason, "leave out retract, or take another motor", fields=["extruder", "retract"])
        return self

    @model_validator(mode="after")
    def _fibre_is_fed_as_it_is_laid(self) -> ProcessSpec:
        if self.section != "fibre":
            if self.fibre is not None:
                raise refusal(f"a fibre's section is not {self.section}", "leave out section", fields=["fibre", "bead"])
            return self
        if self.extruder.motor == "on_off":
            reason = "a fibre is fed as fast as it is laid, which a motor that is only on or off cannot do"
            raise refusal(reason, "take another motor", fields=["fibre", "bead", "extruder"])
        if self.extruder.lag > 0.0:
            raise refusal(
                "a fibre does not lag the motor that feeds it", "leave out lag_s", fields=["fibre", "bead", "extruder"]
            )
        return self


class ResolveSpec(Section):
    """Settings of the search for joint paths: finer is better and slower."""

    roll_step: Annotated[float, Quantity("deg", 2, 90)] = _key(
        "roll_step_deg", "step between tried rotations about the nozzle axis [deg]; refined to a third", 15
    )
    table_step: Annotated[float, Quantity("deg", 1, 90)] = _key(
        "table_step_deg", "step between tried angles of the positioner [deg]; refined to a third", 15
    )
    rung: Annotated[float, Quantity("mm", 0.5, 100)] = _key(
        "rung_mm", "distance along a bead at which postures are searched [mm]; interpolated between", 5
    )
    knot: Annotated[float, Quantity("mm", 0.5, 100)] = _key(
        "knot_mm", "distance along a bead between control values of the refined free angles [mm]", 2.5
    )
    min_sigma: Annotated[float, Quantity("", 0, 1)] = _key(
        "min_sigma", "least singular value of the arm's Jacobian (metres); below it joints race", 0.05
    )
    qp: Annotated[QPName, one_of(QP_NAMES)] = _key(
        "qp", f"solver of the quadratic programs of strategy sqp: {' or '.join(QP_NAMES)} (slower)", "interior_point"
    )


class ProgramSpec(Section):
    """Names in the robot program: identifiers of RAPID."""

    tool: Identifier = _key("tool", "the tooldata", "tPen")
    work_object: Identifier = _key("work_object", "the wobjdata", "wobjPart")
    station: Identifier = _key("station", "the positioner's mechanical unit", "STN1")
    extruder_signal: Identifier = _key("extruder_signal", "the digital output of the extruder", "doExtrude")

    @model_validator(mode="after")
    def _distinct(self) -> ProgramSpec:
        keys = list(type(self).model_fields)
        seen: dict[str, str] = {}
        for key in keys:
            name = getattr(self, key)
            first = seen.setdefault(name.lower(), key)  # RAPID does not tell capitals from small letters
            if first != key:
                raise refusal(f"{name!r} names both {first} and {key}", "give each its own name", fields=[first, key])
        return self


class Problem(Section):
    """One print: everything that the planner is told, in SI units. Made by `load_problem`."""

    name: Identifier = _key("name", "name of the problem: of its results' folder and of the robot program")
    cell: CellSpec = _key("cell", "arm, nozzle, and what carries the part")
    layers: AnyLayersSpec = _key("layers", "what is printed")
    part: PartSpec | None = _key(
        "part", "the body to print on, where curves are wrapped or projected; default: none", None
    )
    process: ProcessSpec = _key("process", "how material is laid down")
    strategy: Annotated[StrategyName, one_of(STRATEGY_NAMES)] = _key(
        "strategy", f"how the free motion is decided: {', '.join(STRATEGY_NAMES)}", "sqp"
    )
    resolve: ResolveSpec = _key("resolve", "settings of the search; each has a default", {})
    program: ProgramSpec = _key("program", "names in the robot program; each has a default", {})
    _source: Source = PrivateAttr()

    @field_validator("part")
    @classmethod
    def _body_for_drawings(cls, part: PartSpec | None, info: ValidationInfo) -> PartSpec | None:
        layers = info.data.get("layers")
        if layers is None:
            return part
        if part is None and layers.bodies:
            raise PydanticKnownError("missing")
        if part is not None:
            check_body(part, layers)
        return part

    @field_validator("process")
    @classmethod
    def _bead_as_high_as_its_layer(cls, process: ProcessSpec, info: ValidationInfo) -> ProcessSpec:
        if "height" in process.bead.model_fields_set or "layers" not in info.data:
            return process
        layers = info.data["layers"]
        if isinstance(layers, WaypointLayersSpec):
            raise refusal("height_mm is missing", "height of a bead [mm]; a file of waypoints has none", item="bead")
        bead = process.bead.model_copy(update={"height": layers.height})
        return process.model_copy(update={"bead": bead})

    @field_validator("process")
    @classmethod
    def _rounded_bead_as_wide_as_high(cls, process: ProcessSpec) -> ProcessSpec:
        bead = process.bead
        if process.section == "rounded" and bead.width < bead.height:
            size = f"{bead.width * 1e3:g} mm wide and {bead.height * 1e3:g} mm high"
            raise refusal(f"a rounded bead cannot be {size}", "at least as wide as high", item="bead")
        return process

    def model_post_init(self, context: Any) -> None:
        """Keep the places of the values, which come as the validation's context."""
        self._source = context

    @property
    def file(self) -> Path:
        """The problem file, as the user gave it."""
        return self._source.file

    def error(self, field: str, reason: str, hint: str | None = None) -> InputError:
        """Return the error of a field, dotted as in the file (`cell.arm`), with its file and line, or its `--set`."""
        return self._source.error(tuple(field.split(".")), reason, hint)


def load_problem(path: str | Path, overrides: Sequence[str] = ()) -> Problem:
    """Read a problem file, or a shipped problem by name, with `dotted.key=value` overrides applied before validation.

    Raises one InputError for whatever is wrong: the first mistake by line, and how many more there are. The drawing
    that the problem names is not opened.
    """
    data, source = read_problem_file(find_problem(path))
    data, source = apply_overrides(data, source, overrides)
    try:
        return Problem.model_validate(data, context=source)
    except ValidationError as error:
        raise first_mistake(error.errors(include_url=False), source, Problem) from None
