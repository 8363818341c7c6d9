"""What happens along and around a bead: the section `process` of the problem file.

Temperatures stay in degrees Celsius, the unit of every printer's board, so their names carry the unit.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, model_validator

from planner.base.errors import nearest_name
from planner.base.gcode_lines import commands_in, time_of
from planner.base.rapid_names import LONGEST_NAME
from planner.problem.by_layer import (
    LEAST_WAIT,
    InterlayerTimeSpec,
    LayerTimeSpec,
    Order,
    Pauses,
    SeamSpec,
    SkirtSpec,
    Speed,
    Speeds,
)
from planner.problem.fields import (
    IDENTIFIER,
    FilamentDiameter,
    Form,
    Quantity,
    Section,
    Thickness,
    Truth,
    key,
    one_of,
    refusal,
)
from planner.problem.settings import INPUTS, POSITIONER
from planner.problem.yaml_file import describe

if TYPE_CHECKING:
    from planner.problem.problem import Problem

SectionName = Literal["rectangle", "rounded", "fibre"]
MotorName = Literal["e_axis", "speed_demand", "on_off"]
SECTIONS: tuple[str, ...] = get_args(SectionName)
MOTORS: tuple[str, ...] = get_args(MotorName)

MaterialName = Annotated[str, IDENTIFIER]
CUT_PAUSE = 0.5  # s for the cutter, on a fan's output, to close, and again to open; Tawfik et al., section III.B
MOST_LINES = 20
CORNER_SHARE = 0.5  # × a bead's width: the most that corners are rounded by default
KLIPPER_LACKS = ("M42", "M280")  # commands of a cut that Klipper does not have
_COMMAND = r"(M(42|106|107|280)( [A-FH-LO-Z]-?\d{1,6}(\.\d{1,4})?)*|G4 P\d{1,6})"
_ORDER = re.compile(f"{_COMMAND}( {_COMMAND})*")
SHARING = ("reprap",)  # firmwares that take several commands on a line

FIBRE_RAMP_DEG = 30  # Tawfik et al., section III.A.2: laid down at this angle, the end of the fibre sticks
Wait = Annotated[float, Quantity("s", 0, 3600)]  # an hour heats any bed
HandOver = Literal["rest", "motion"]
HAND_OVERS: tuple[str, ...] = get_args(HandOver)
TravelName = Literal["quickest", "upright"]
TRAVELS: tuple[str, ...] = get_args(TravelName)
CrossingsName = Literal["refused", "told"]
CROSSINGS_NAMES: tuple[str, ...] = get_args(CrossingsName)
Heating = Literal["set", "wait"]
HEATINGS: tuple[str, ...] = get_args(Heating)


class BeadSpec(Section):
    """Cross-section of a bead."""

    width: Thickness = key("width_mm", "width [mm]")
    # NaN if the G-code gives the heights of its beads, and otherwise until the layers' height replaces it.
    height: Thickness = Field(
        default_factory=lambda: math.nan,
        validate_default=False,
        alias="height_mm",
        description="height [mm]; default layers.height_mm, if that is given",
    )
    section: Annotated[SectionName, one_of(SECTIONS)] | None = key(
        "section",
        "shape: rectangle, width times height; rounded, half a circle at both sides; fibre, as thick as the "
        "filament, which is fed as fast as it is laid; default rectangle, or fibre with process.fibre",
        None,
    )


class ExtruderSpec(Section):
    """What pushes the filament."""

    motor: Annotated[MotorName, one_of(MOTORS)] = key(
        "motor",
        "how it is driven: e_axis, an axis of its own; speed_demand, in proportion to the nozzle's real speed; "
        "on_off, at the commanded speed's rate while a bead is laid",
        "e_axis",
    )
    lag: Annotated[float, Quantity("s", 0, 2)] = key(
        "lag_s", "time by which flow lags the motor, which then runs ahead (pressure advance) [s]", 0
    )
    flow_tolerance: Annotated[float, Quantity("", 0.005, 10)] = key(
        "flow_tolerance",
        "with on_off, the share by which the material in any millimetre of a bead may be off, except in its first "
        "and last 2 mm, or four widths of a bead narrower than 0.5 mm",
        0.1,
    )

    @model_validator(mode="after")
    def _only_what_can_be_driven(self) -> ExtruderSpec:
        if self.motor == "on_off" and self.lag > 0.0:
            reason = "a motor that is only on or off cannot make up for lag_s"
            raise refusal(reason, "leave out lag_s, or take another motor", fields=["motor", "lag_s"])
        return self

    @model_validator(mode="after")
    def _a_motor_that_follows_needs_no_tolerance(self) -> ExtruderSpec:
        if self.motor != "on_off" and "flow_tolerance" in self.model_fields_set:
            reason = f"with {self.motor}, flow follows the speed: flow_tolerance is for on_off"
            raise refusal(reason, "leave out flow_tolerance, or set motor: on_off", fields=["motor", "flow_tolerance"])
        return self


def material_key(whose: str, default: str = "the first one there") -> MaterialName | None:
    """The field for the material of a section of `layers`."""
    text = f"material of {whose}, by its name in process.materials; default: {default}"
    field: MaterialName | None = key("material", text, None)
    return field


class FilamentMoveSpec(Section):
    """Filament that the extruder pushes or pulls while nothing is deposited."""

    length: Annotated[float, Quantity("mm", 0, 100)] = key("length_mm", "length of filament [mm]; 0 is none", 0)
    speed: Annotated[float, Quantity("mm/s", 0.1, 200)] = key("speed_mm_s", "speed of the filament [mm/s]", 25)

    @property
    def time(self) -> float:
        """How long it takes [s]."""
        return self.length / self.speed


class MaterialSpec(Section):
    """One of several materials: the tool that feeds it, and where it differs from `process`."""

    tool: Annotated[int, Quantity("", 0, 99, whole=True)] | None = key(
        "tool", "number of its tool in the G-code; default: its place in the list, from 0", None
    )
    extruder_signal: Annotated[str, IDENTIFIER] | None = key(
        "extruder_signal",
        "the digital output of its extruder in RAPID; default: program.extruder_signal, with the tool's number "
        "appended for all but the first material",
        None,
    )
    nozzle: Annotated[str, IDENTIFIER] | None = key(
        "nozzle", "its nozzle, by its name in cell.nozzles; default: cell.nozzle, which lays all materials", None
    )
    filament_diameter: FilamentDiameter | None = key(
        "filament_diameter_mm", "diameter of its filament [mm]; default: process.filament_diameter_mm", None
    )
    nozzle_c: Annotated[float, Quantity("°C", 20, 500)] | None = key(
        "nozzle_c", "temperature of its nozzle [°C]; default: process.start.nozzle_c", None
    )
    prime: FilamentMoveSpec | None = key(
        "prime", "filament pushed just before a bead starts; default: process.prime", None
    )
    retract: FilamentMoveSpec | None = key(
        "retract", "filament pulled back as soon as a bead ends; default: process.retract", None
    )


class ChangeSpec(Section):
    """What happens at home between beads of two materials."""

    wait: Annotated[float, Quantity("s", LEAST_WAIT, 3600)] = key(
        "wait_s", "time that the robot rests at home while tools are changed [s]", 1
    )
    purge: Annotated[float, Quantity("mm", 0, 1000)] = key(
        "purge_mm", "filament of the new material pushed out then [mm]; 0 is none", 0
    )
    purge_speed: Annotated[float, Quantity("mm/s", 0.1, 200)] = key(
        "purge_speed_mm_s", "speed of the filament while purging [mm/s]", 5
    )

    @property
    def time(self) -> float:
        """How long the robot rests at home for a change [s]."""
        return self.wait + self.purge / self.purge_speed


def signals(problem: Problem) -> dict[str, str]:
    """Material name → the digital output in RAPID that switches its extruder."""
    process, found = problem.process, {}
    for i, (name, spec) in enumerate(process.materials.items()):
        usual = problem.program.extruder_signal
        found[name] = spec.extruder_signal or (f"{usual}{process.tool(name)}" if i else usual)
    return found


def check_materials(problem: Problem) -> None:
    """Raise InputError for an unknown material or nozzle, and for a name that is too long for RAPID or used twice."""
    names = list(problem.process.materials)
    parts = [(f"layers.{part}", getattr(problem.layers, part, None)) for part in ("support", "infill")]
    for field, section in (("layers", problem.layers), *parts):
        name = getattr(section, "material", None)
        if name is not None and name not in names:
            near = nearest_name(name, names)
            hint = f"choices: {', '.join(names)}" if names else "give process.materials, or leave it out"
            reason = f"there is no material {name!r} in process.materials"
            raise problem.error(f"{field}.material", reason, f"did you mean {near}? {hint}" if near else hint)
    check_nozzles(problem)
    program = problem.program
    uses = {} if problem.cell.nozzles else {"tool": program.tool}  # each of several nozzles is a tool of its own
    uses |= {"work_object": program.work_object, "station": program.station or POSITIONER}
    taken = {name.lower(): f"program.{use}" for use, name in uses.items()}
    for name in problem.cell.nozzles:
        first = taken.setdefault(name.lower(), f"cell.nozzles.{name}")
        if first != f"cell.nozzles.{name}":
            raise problem.error(f"cell.nozzles.{name}", f"{name!r} is already the name of {first}", "give each its own")
    for name, signal in signals(problem).items():
        field = f"process.materials.{name}.extruder_signal"
        if len(signal) > LONGEST_NAME:
            raise problem.error(field, f"{signal!r} is too long for RAPID", f"at most {LONGEST_NAME} characters")
        first = taken.setdefault(signal.lower(), name)  # RAPID ignores case
        if first != name:
            raise problem.error(field, f"{signal!r} is already the name of {first}", "give each its own name")


def check_nozzles(problem: Problem) -> None:
    """Raise InputError for a material without a nozzle where there are several, and for an unknown nozzle."""
    nozzles, materials = list(problem.cell.nozzles), problem.process.materials
    if nozzles and not materials:
        hint = "give one nozzle as cell.nozzle, or materials, each with its nozzle"
        raise problem.error("cell.nozzles", "there are no process.materials for them to lay", hint)
    for name, spec in materials.items():
        field = f"process.materials.{name}.nozzle"
        if spec.nozzle is None and nozzles:
            raise problem.error(field, "is missing: there are several nozzles", f"choices: {', '.join(nozzles)}")
        if spec.nozzle is not None and not nozzles:
            raise problem.error(field, "there are no cell.nozzles", "name several there, in place of cell.nozzle")
        if spec.nozzle is not None and spec.nozzle not in nozzles:
            near, choices = nearest_name(spec.nozzle, nozzles), f"choices: {', '.join(nozzles)}"
            reason = f"there is no nozzle {spec.nozzle!r} in cell.nozzles"
            raise problem.error(field, reason, f"did you mean {near}? {choices}" if near else choices)


def check_board(problem: Problem) -> None:
    """Raise InputError for a tool that the extruder's board lacks, or a command or input that its firmware lacks."""
    process, board = problem.process, problem.program.board
    for name in process.materials:
        tool = process.tool(name)
        if board.tools is not None and tool not in board.tools:
            hint = f"program.board.tools has {', '.join(map(str, board.tools))}"
            raise problem.error(f"process.materials.{name}.tool", f"the board has no tool {tool}", hint)
    last = board.input + max(len(process.materials), 1) - 1
    if board.sync == "signal" and last >= INPUTS[board.firmware]:
        reason = f"{len(process.materials)} materials need inputs up to {last}, which {board.firmware} does not have"
        raise problem.error("program.board.input", reason, f"at most {INPUTS[board.firmware] - len(process.materials)}")
    code = () if process.fibre is None else process.fibre.code
    shared = next((line for line in code if len(commands_in(line)) > 1), None)
    if shared is not None and board.firmware not in SHARING:
        reason = f"{board.firmware} takes one command per line, not {shared!r}"
        raise problem.error("process.fibre.cut_code", reason, f"[{', '.join(commands_in(shared))}]")
    if board.firmware != "klipper":
        return
    if process.fan is not None and process.fan.number:
        reason = f"Klipper's M106 has no fan {process.fan.number}"
        raise problem.error("process.fan.number", reason, "its only fan is 0")
    for command in process.fibre.commands if process.fibre is not None else ():
        if command.startswith(KLIPPER_LACKS):
            reason = f"Klipper has no {command.split(' ')[0]}, which cuts the fibre"
            raise problem.error("process.fibre.cut_code", reason, "use M106, M107 and G4")


def _fan_of(command: str) -> int | None:
    """The fan output that a G-code command switches (without P, the first one); None for other commands."""
    word, *parameters = command.split()
    if word not in ("M106", "M107"):
        return None
    return next((int(each[1:]) for each in parameters if each[0] == "P"), 0)


def _order(value: Any) -> str:
    """A line of a board's macro: one or more outputs (M42, M106, M107), servos (M280) and pauses in milliseconds."""
    if not isinstance(value, str):
        raise refusal(f"must be a line of G-code, not {describe(value)}", "quote it, for example 'M106 P0 S1'")
    if not _ORDER.fullmatch(value):
        raise refusal(
            f"{describe(value)} cannot be used here",
            "M42, M106, M107 or M280 with their words, or a pause such as G4 P500",
        )
    return value


def _few(value: Any) -> Any:
    if isinstance(value, tuple) and not 1 <= len(value) <= MOST_LINES:
        raise refusal(f"must be 1 to {MOST_LINES} lines, not {len(value)}", "for example [M106 P0 S1, G4 P500]")
    return value


CutCode = Annotated[
    tuple[Annotated[str, Form(_order, schema={"pattern": f"^({_ORDER.pattern})$"})], ...], BeforeValidator(_few)
]


def usual_cut(wait: float) -> tuple[str, ...]:
    """The published macro of a cut, with its two pauses together no longer than `wait` [s]."""
    ms = int(min(CUT_PAUSE, 0.5 * wait) * 1e3)
    pause = (f"G4 P{ms}",) if ms else ()
    return ("M106 P0 S1", *pause, "M106 P0 S0", *pause)


class FanSpec(Section):
    """The fan that cools the print."""

    speed: Annotated[float, Quantity("", 0.01, 1)] = key("speed", "share of its full speed", 1)
    from_layer: Annotated[int, Quantity("", 1, 100_000, whole=True)] = key(
        "from_layer", "the first layer that it cools, counted from 1", 2
    )
    number: Annotated[int, Quantity("", 0, 31, whole=True)] = key("number", "number of its output (P of M106)", 0)


class StartSpec(Section):
    """What the extruder does at home, before the first move."""

    nozzle_c: Annotated[float, Quantity("°C", 20, 500)] | None = key(
        "nozzle_c", "temperature of the nozzle [°C]; default: it is not set", None
    )
    bed_c: Annotated[float, Quantity("°C", 20, 300)] | None = key(
        "bed_c", "temperature of the bed that carries the part [°C]; default: it is not set", None
    )
    heat_wait: Wait = key("heat_wait_s", "time that the robot waits at home while nozzle and bed heat up [s]", 0)
    heat: Annotated[Heating, one_of(HEATINGS)] = key(
        "heat",
        "whether the extruder's board only sets temperatures, or waits for them before its clock starts; "
        f"{' or '.join(HEATINGS)}",
        "set",
    )
    purge: Annotated[float, Quantity("mm", 0, 1000)] = key(
        "purge_mm", "filament pushed out at home once everything is hot [mm]; 0 is none", 0
    )
    purge_speed: Annotated[float, Quantity("mm/s", 0.1, 200)] = key(
        "purge_speed_mm_s", "speed of the filament while purging [mm/s]", 5
    )

    @property
    def time(self) -> float:
        """How long the robot rests at home before its first move [s]."""
        return self.heat_wait + self.purge / self.purge_speed


class FibreSpec(Section):
    """Continuous fibre, cut inside the head so that it ends where the bead does."""

    cut_length: Annotated[float, Quantity("mm", 1, 500)] = key(
        "cut_length_mm", "length of fibre from the cutter to the nozzle's tip [mm]"
    )
    cut_wait: Annotated[float, Quantity("s", 0, 600)] = key(
        "cut_wait_s", "time that the nozzle rests on the bead while the fibre is cut [s]", 3
    )
    clearance: Annotated[float, Quantity("mm", 1, 500)] | None = key(
        "clearance_mm", "height to which the nozzle rises from a bead along the normal [mm]; default: lift_mm", None
    )
    least_laid: Annotated[float, Quantity("mm", 1, 500)] = key(
        "least_laid_mm", "least length laid before the cut, whose adhesion holds the fibre [mm]", 5
    )
    least_radius: Annotated[float, Quantity("mm", 0.1, 10_000)] | None = key(
        "least_radius_mm",
        "least radius of geodesic curvature to which the fibre may be steered on the surface [mm]; default: any",
        None,
    )
    cut_code: CutCode | None = key(
        "cut_code",
        "G-code of the cut: outputs and servos, and pauses (G4 P, milliseconds) no longer than cut_wait_s in all; with "
        "reprap, a line may hold several commands; default: fan output 0 on and off, as published",
        None,
    )

    @model_validator(mode="after")
    def _cut_in_time(self) -> FibreSpec:
        takes = self.code_time
        if takes > self.cut_wait + 1e-9:
            reason = f"the pauses of cut_code take {takes:g} s, but cut_wait_s is {self.cut_wait:g}"
            raise refusal(reason, "wait longer, or pause less", fields=["cut_wait_s", "cut_code"])
        return self

    @property
    def code(self) -> tuple[str, ...]:
        """Lines of G-code with which the extruder's board cuts the fibre, no longer than the wait."""
        return usual_cut(self.cut_wait) if self.cut_code is None else self.cut_code

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands of `code`, one by one."""
        return tuple(command for line in self.code for command in commands_in(line))

    @property
    def code_time(self) -> float:
        """How long the pauses of `code` take [s]."""
        return time_of(self.code)

    @property
    def least_length(self) -> float:
        """Length [m] of the shortest bead that can be laid."""
        return self.cut_length + self.least_laid


class AroundBeadSpec(Section):
    """Run-in and run-out, lift, and what the extruder does before and after a bead."""

    run_in: Annotated[float, Quantity("mm", 0.5, 100)] = key(
        "run_in_mm", "length of run-in and run-out, where speed is gained and lost and nothing deposited [mm]", 3
    )
    ramp_angle: Annotated[float, Quantity("deg", 5, 60)] | None = key(
        "ramp_deg",
        "angle to the surface at which a straight run-in comes down and a straight run-out leaves [deg]; "
        f"default: none, the height grows with the cube of the distance instead; with fibre {FIBRE_RAMP_DEG}",
        None,
    )
    lift_height: Annotated[float, Quantity("mm", 1, 500)] = key(
        "lift_mm", "least height of travel above the surface [mm]", 5
    )
    travel: Annotated[TravelName, one_of(TRAVELS)] | None = key(
        "travel",
        "how to travel between beads: quickest, on any clear path; upright, up along the normal by lift_mm, across, "
        "and down along the normal, with stops in between; default: quickest, or upright with fibre",
        None,
    )
    hand_over: Annotated[HandOver, one_of(HAND_OVERS)] = key(
        "hand_over",
        "how travel joins run-ins and run-outs: at rest, or in motion, which fibre does not allow",
        "rest",
    )
    prime: FilamentMoveSpec = key("prime", "filament pushed just before a bead starts; default: none", {})
    retract: FilamentMoveSpec = key("retract", "filament pulled back as soon as a bead ends; default: none", {})
    start: StartSpec = key("start", "heating and purge at home before the first move; default: none", {})
    fibre: FibreSpec | None = key("fibre", "continuous fibre and its cut; default: none", None)
    fan: FanSpec | None = key("fan", "the fan that cools the print; default: it is left alone", None)

    @model_validator(mode="after")
    def _one_clearance(self) -> AroundBeadSpec:
        if self.fibre is not None and self.fibre.clearance is not None and "lift_height" in self.model_fields_set:
            reason = "both lift_mm and fibre.clearance_mm are given"
            raise refusal(reason, "give one of them", fields=["lift_mm", "fibre"])
        return self

    @model_validator(mode="after")
    def _fibre_feeds_itself(self) -> AroundBeadSpec:
        for name, move in (("prime", self.prime), ("retract", self.retract)):
            if self.fibre is not None and move.length > 0.0:
                raise refusal(
                    f"{name}.length_mm is {move.length * 1e3:g}, but there is fibre",
                    "leave it out: cut fibre is not pulled back, and is fed forward by fibre.cut_length_mm",
                    fields=["fibre", name],
                )
        return self

    @model_validator(mode="after")
    def _cutter_is_no_fan(self) -> AroundBeadSpec:
        if self.fibre is not None and self.fan is not None:
            taken = [each for each in self.fibre.commands if _fan_of(each) == self.fan.number]
            if taken:
                reason = f"fan output {self.fan.number} is taken by the cutter ({taken[0]})"
                raise refusal(reason, "give another fan.number, or another fibre.cut_code", fields=["fan", "fibre"])
        return self

    @model_validator(mode="after")
    def _fibre_rests(self) -> AroundBeadSpec:
        if self.fibre is not None and self.hand_over == "motion":
            reason = "hand_over is motion, but there is fibre"
            raise refusal(reason, "leave it out: a fibre's bead begins and ends at rest", fields=["fibre", "hand_over"])
        return self

    @model_validator(mode="after")
    def _upright_rests(self) -> AroundBeadSpec:
        if self.travel == "upright" and self.hand_over == "motion":
            reason = "hand_over is motion, but travel is upright"
            raise refusal(
                reason, "leave one of them out: the nozzle rests before it rises", fields=["travel", "hand_over"]
            )
        if self.travel == "quickest" and self.fibre is not None:
            reason = "travel is quickest, but there is fibre"
            raise refusal(
                reason, "leave it out: the nozzle leaves the end of a fibre upright", fields=["travel", "fibre"]
            )
        return self

    @property
    def travels_upright(self) -> bool:
        """Whether the nozzle leaves and reaches beads along the normal, and stops before it moves across."""
        return self.fibre is not None or self.travel == "upright"

    @property
    def ramp(self) -> float | None:
        """Angle of run-in and run-out to the surface [rad]; None if the height grows with the cube of the distance."""
        if self.ramp_angle is None and self.fibre is not None:
            return math.radians(FIBRE_RAMP_DEG)
        return self.ramp_angle

    @property
    def lift(self) -> float:
        """Least height of travel above the surface [m]: the fibre's clearance, if that is given."""
        if self.fibre is None or self.fibre.clearance is None:
            return self.lift_height
        return self.fibre.clearance

    @property
    def prime_length(self) -> float:
        """Filament pushed before each bead [m]; with fibre, its length from the cutter to the nozzle's tip."""
        return self.prime.length if self.fibre is None else self.fibre.cut_length


class ConesSpec(Section):
    """How far the nozzle and the layer may lean, as half angles of cones."""

    tilt: Annotated[float, Quantity("deg", 0, 60)] = key(
        "nozzle_normal_deg",
        "greatest angle of the nozzle axis to the surface normal [deg]; 0 keeps it on the normal",
        0,
    )
    nozzle_gravity: Annotated[float, Quantity("deg", 1, 180)] = key(
        "nozzle_gravity_deg", "greatest angle of the nozzle axis to straight down [deg]; 180 is free", 180
    )
    layer_gravity: Annotated[float, Quantity("deg", 1, 180)] = key(
        "layer_gravity_deg", "greatest angle of the surface normal to straight up [deg]; 180 is free", 180
    )

    @property
    def bound_to_gravity(self) -> bool:
        """Whether a cone about the vertical limits anything."""
        return min(self.layer_gravity, self.nozzle_gravity) < math.pi


class ProcessSpec(AroundBeadSpec):
    """How material is laid down, and what happens around a bead."""

    speed: Speed = key("speed_mm_s", "speed of the nozzle along the part while printing [mm/s]")
    travel_speed: Speed = key("travel_speed_mm_s", "greatest speed between beads [mm/s]")
    speeds: Speeds = key(
        "speeds",
        "other speeds of some layers or beads; if several apply to a bead, the last one counts; default: none",
        (),
    )
    layer_time: LayerTimeSpec | None = key("layer_time", "least time that a layer takes; default: any", None)
    interlayer_time: InterlayerTimeSpec | None = key(
        "interlayer_time",
        "least and greatest age of a place when the bead above is laid on it; default: any",
        None,
    )
    pauses: Pauses = key("pauses", "rests at home before some layers; default: none", ())
    order: Order = key(
        "order",
        "names of beads, * for any letters, in the order in which they are laid in each layer, any others last; "
        "default: the order with the least travel",
        (),
    )
    seam: SeamSpec | None = key("seam", "where closed beads begin; default: as far from corners as possible", None)
    skirt: SkirtSpec | None = key("skirt", "lines around the first layer, laid before all others; default: none", None)
    bead: BeadSpec = key("bead", "cross-section of a bead")
    corner_tolerance: Annotated[float, Quantity("mm", 0.01, 5)] = Field(
        0.2,
        alias="corner_tolerance_mm",
        description="how far a rounded corner may be from the drawn one [mm]; finer than an arm repeats; default: 0.2, "
        "or half of bead.width_mm if that is less",
    )
    chord_tolerance: Annotated[float, Quantity("mm", 0.0005, 1)] = key(
        "chord_tolerance_mm", "how far curves may be from the lines that approximate them [mm]", 0.01
    )
    cones: ConesSpec = key("cones", "how far nozzle and layer may lean; each has a default", {})
    filament_diameter: FilamentDiameter = key(
        "filament_diameter_mm", "diameter of the filament that the extruder pushes [mm]", 1.75
    )
    extruder: ExtruderSpec = key("extruder", "what pushes the filament; each has a default", {})
    materials: dict[MaterialName, MaterialSpec] = key(
        "materials", "several materials, by names; default: one, without a name", {}
    )
    change: ChangeSpec = key("change", "what happens between beads of two materials; each has a default", {})
    crossings: Annotated[CrossingsName, one_of(CROSSINGS_NAMES)] | None = key(
        "crossings",
        "whether crossing beads in a layer are refused, or only reported (told); default: refused where faces are "
        "covered, else not checked",
        None,
    )
    split_beads: Truth = key(
        "split_beads",
        "whether a bead that cannot be followed in one go may be laid in pieces: the nozzle lifts off, the arm "
        "changes its branch or unwinds a joint, and returns to the bead",
        False,
    )

    def of(self, material: str) -> ProcessSpec:
        """The process with a material's own values; unchanged for the material without a name."""
        spec = self.materials.get(material)
        if spec is None:
            return self
        own = {name: getattr(spec, name) for name in ("filament_diameter", "prime", "retract")}
        return self.model_copy(update={name: value for name, value in own.items() if value is not None})

    def tool(self, material: str) -> int:
        """Number of the tool that feeds the material of that name."""
        given = self.materials[material].tool
        return list(self.materials).index(material) if given is None else given

    def nozzle_c(self, material: str) -> float | None:
        """Nozzle temperature of the material of that name [°C]; None if it is not set."""
        given = self.materials[material].nozzle_c
        return self.start.nozzle_c if given is None else given

    @model_validator(mode="after")
    def _heat_for_something(self) -> ProcessSpec:
        hot = [self.start.nozzle_c, self.start.bed_c, *(material.nozzle_c for material in self.materials.values())]
        if self.start.heat == "wait" and all(celsius is None for celsius in hot):
            reason, hint = "heat is wait, but no temperature is given", "give nozzle_c or bed_c"
            raise refusal(reason, hint, item="start", fields=["heat"])
        return self

    @model_validator(mode="after")
    def _slower_than_usual(self) -> ProcessSpec:
        slowest = None if self.layer_time is None else self.layer_time.slowest
        if slowest is not None and slowest > self.speed:
            reason = f"slowest_mm_s is {slowest * 1e3:g}, above speed_mm_s {self.speed * 1e3:g}"
            raise refusal(reason, "give a lower one", fields=["speed_mm_s", "layer_time"])
        return self

    @model_validator(mode="after")
    def _no_faster_than_travel(self) -> ProcessSpec:
        fastest = max([self.speed, *(spec.speed for spec in self.speeds)])
        if fastest > self.travel_speed:
            reason = f"travel_speed_mm_s is {self.travel_speed * 1e3:g}, below a speed_mm_s of {fastest * 1e3:g}"
            hint = "travel at least as fast as all beads: run-ins reach their speed, and count as travel"
            raise refusal(reason, hint, fields=["speed_mm_s", "speeds", "travel_speed_mm_s"])
        return self

    @model_validator(mode="after")
    def _one_pause_each(self) -> ProcessSpec:
        layers = [pause.before_layer for pause in self.pauses]
        twice = next((layer for layer in layers if layers.count(layer) > 1), None)
        if twice is not None:
            raise refusal(f"two pauses before layer {twice}", "give one of them, as long as both", fields=["pauses"])
        return self

    @model_validator(mode="after")
    def _one_tool_each(self) -> ProcessSpec:
        seen: dict[int, str] = {}
        for name in self.materials:
            first = seen.setdefault(self.tool(name), name)
            if first != name:
                reason = f"tool {self.tool(name)} feeds both {first} and {name}"
                raise refusal(reason, "give each material a tool of its own", fields=["materials"])
        return self

    @model_validator(mode="after")
    def _fibre_is_alone(self) -> ProcessSpec:
        if self.materials and self.section == "fibre":
            reason = "fibre and several materials do not go together"
            raise refusal(reason, "leave out materials", fields=["fibre", "bead", "materials"])
        return self

    @property
    def section(self) -> SectionName:
        """Shape of a bead's cross-section."""
        return self.bead.section or ("rectangle" if self.fibre is None else "fibre")

    @model_validator(mode="after")
    def _motor_can_pull_back(self) -> ProcessSpec:
        if self.extruder.motor == "on_off" and self.retract.length > 0.0:
            reason = "a motor that is only on or off cannot pull filament back"
            raise refusal(reason, "leave out retract, or take another motor", fields=["extruder", "retract"])
        for name, material in self.materials.items():
            if self.extruder.motor == "on_off" and material.retract is not None and material.retract.length > 0.0:
                reason = f"a motor that is only on or off cannot pull filament of {name} back"
                raise refusal(reason, "leave out its retract, or take another motor", fields=["extruder", "materials"])
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
        for name, move in (("prime", self.prime), ("retract", self.retract)):
            if move.length > 0.0:
                reason = f"{name}.length_mm is {move.length * 1e3:g}, and a fibre is fed as long as its bead"
                raise refusal(reason, "leave it out, or take another bead.section", fields=["bead", name])
        return self
