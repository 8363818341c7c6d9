"""Strategies, and settings of the search and of the robot program: the sections `resolve` and `program`."""

from __future__ import annotations

from ipaddress import AddressValueError, IPv4Address
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field, model_validator

from planner.base.rapid_names import ARMS, LONGEST_NAME, OWN_NAMES
from planner.problem.fields import (
    IDENTIFIER,
    INCREASING,
    UNIQUE,
    UNIT_VECTOR,
    Angles,
    Form,
    Position,
    Quantity,
    Section,
    Truth,
    Vector,
    key,
    one_of,
    refusal,
)
from planner.problem.yaml_file import describe

FlavourName = Literal["linuxcnc", "reprap"]
FLAVOURS: tuple[str, ...] = get_args(FlavourName)
MachineType = Literal["robot", "table_table", "head_table", "head_head"]
MACHINE_TYPES: tuple[str, ...] = get_args(MachineType)
FeedName = Literal["inverse_time", "per_minute"]
FEEDS: tuple[str, ...] = get_args(FeedName)
TURNING = {"linuxcnc": ("A", "B", "C"), "reprap": ("A", "B", "C", "U", "V", "W")}  # letters of axes that may turn
EXTRUDER = {"linuxcnc": ("U", "V", "W"), "reprap": ("E",)}  # letters of axes that may push filament; default: the last
# deg between the two axes, and between the tilting axis and the nozzle: below, nothing can be reached
LEAST_ANGLE = 5.0
Letter = Annotated[str, one_of(("A", "B", "C", "E", "U", "V", "W"))]

StrategyName = Literal["as_published", "fixed", "greedy", "ladder", "sqp", "nlp"]
STRATEGY_NAMES: tuple[str, ...] = get_args(StrategyName)
PublishedName = Literal["turning_table", "fixed_heading", "along_path"]
PUBLISHED_NAMES: tuple[str, ...] = get_args(PublishedName)
QPName = Literal["interior_point", "osqp"]
QP_NAMES: tuple[str, ...] = get_args(QPName)
TimingName = Literal["jerk_limited", "toppra"]
TIMING_NAMES: tuple[str, ...] = get_args(TimingName)
LanguageName = Literal[
    "rapid", "urscript", "krl", "fanuc", "inform", "val3", "kawasaki", "melfa", "joint_trajectory", "axes"
]
LANGUAGE_NAMES: tuple[str, ...] = get_args(LanguageName)
USUAL_LANGUAGE: LanguageName = "joint_trajectory"  # of arms whose file names none
Identifier = Annotated[str, IDENTIFIER]
StyleName = Literal["output", "demand", "socket"]
STYLE_NAMES: tuple[str, ...] = get_args(StyleName)
ZoneName = Literal["z0", "z1", "z5", "z10"]
ZONE_NAMES: tuple[str, ...] = get_args(ZoneName)
FirmwareName = Literal["reprap", "marlin", "klipper"]
FIRMWARES: tuple[str, ...] = get_args(FirmwareName)
SyncName = Literal["signal", "free"]
SYNCS: tuple[str, ...] = get_args(SyncName)
# Input numbers below these can be waited for: RepRapFirmware's MaxGpInPorts of its largest boards (M577 P), and the
# byte of Marlin's pin numbers (M226 P). Klipper cannot wait for inputs.
INPUTS = {"reprap": 56, "marlin": 256}
FIRST_PORT, LAST_PORT = 1025, 4999  # ABB, RAPID reference, SocketBind: free for programs
# mechanical units of ABB controllers: a positioner, and the arms of a MultiMove system
POSITIONER = "STN1"
SECOND_ARM = ARMS[1]
CHORD_SHARE = 0.25  # × a bead's height: how far a program's lines may be from it by default; twice that if widened
_ADDRESS = r"^[0-9]{1,3}(\.[0-9]{1,3}){3}$"  # roughly, for editors


def _code(value: Any) -> str:
    words = value.split(" ") if isinstance(value, str) else []
    if not 0 < len(words) <= 4 or not all(_is_word(word) for word in words):
        raise refusal(f"must be words of G-code, not {describe(value)}", "for example 'G43.4 H1' or M428")
    return " ".join(words)


def _is_word(word: str) -> bool:
    number = word[1:].replace(".", "", 1)
    return word[:1].isascii() and word[:1].isupper() and number.isdecimal() and number.isascii() and len(word) <= 8


Code = Annotated[str, Form(_code, schema={"pattern": "^[A-Z][0-9.]+( [A-Z][0-9.]+){0,3}$"})]


class RotarySpec(Section):
    """A rotary axis of the head or the table, right-handed about its direction with both axes at zero."""

    letter: Letter = key("letter", "its letter in the G-code")
    direction: Annotated[Vector, Quantity("", -1000, 1000, count=3), UNIT_VECTOR] = key(
        "direction", "direction about which a positive angle turns what it carries, in the machine's axes"
    )
    centre: Position = key(
        "centre_mm",
        "a point on it [mm]: in machine coordinates; for an axis in the head, from the nozzle's tip",
        (0, 0, 0),
    )
    range: Annotated[tuple[float, float], Quantity("deg", -1800, 1800, count=2), INCREASING] | None = key(
        "range_deg", "least and greatest angle [deg]; default: it turns without end", None
    )


class MachineSpec(Section):
    """A machine with six axes (a robot), or with three linear and two rotary ones."""

    flavour: Annotated[FlavourName, one_of(FLAVOURS)] = key("flavour", f"its controller: {' or '.join(FLAVOURS)}")
    type: Annotated[MachineType, one_of(MACHINE_TYPES)] = key(
        "type", f"what turns: {', '.join(MACHINE_TYPES)}; a robot is sent poses of the nozzle"
    )
    rotary: tuple[RotarySpec, ...] = key(
        "rotary",
        "the two rotary axes, the one that carries the other first; for head_table, the head's first; default: none",
        (),
    )
    least: Position | None = key("least_mm", "least X, Y and Z of the machine [mm]; default: not checked", None)
    greatest: Position | None = key("greatest_mm", "greatest X, Y and Z [mm]; default: not checked", None)
    part: Position = key("part_mm", "origin of the part frame on the machine at zero angles [mm]", (0, 0, 0))
    part_rpy: Angles = key("part_rpy_deg", "roll, pitch and yaw of the part frame there [deg]", (0, 0, 0))
    tcp: Truth = key("tcp", "whether the controller keeps the tip on its line while axes turn (TCP control)", False)
    tcp_on: Code = key("tcp_on", "code that switches TCP control on", "M428")
    tcp_off: Code = key("tcp_off", "code that switches TCP control off", "M429")
    extruder: Letter | None = key(
        "extruder", "letter of the axis that pushes filament; default W, or E with reprap", None
    )
    feed: Annotated[FeedName, one_of(FEEDS)] = key(
        "feed", "what F means: inverse_time (G93), or per_minute for firmware without that", "inverse_time"
    )

    @property
    def filament(self) -> str:
        """Letter of the axis that pushes filament."""
        return self.extruder or EXTRUDER[self.flavour][-1]

    @model_validator(mode="after")
    def _letters(self) -> MachineSpec:
        turning, pushing = TURNING[self.flavour], EXTRUDER[self.flavour]
        for i, axis in enumerate(self.rotary):
            if axis.letter not in turning:
                reason = f"{self.flavour} has no rotary axis {axis.letter}"
                raise refusal(reason, f"choices: {', '.join(turning)}", fields=["rotary"])
            if axis.letter in [other.letter for other in self.rotary[:i]]:
                raise refusal(f"two axes are called {axis.letter}", "give each its own letter", fields=["rotary"])
        if self.filament not in pushing:
            reason = f"{self.flavour} has no filament axis {self.filament}"
            raise refusal(reason, f"choices: {', '.join(pushing)}", fields=["extruder"])
        if self.filament in [axis.letter for axis in self.rotary]:
            raise refusal(
                f"{self.filament} is already the letter of a rotary axis", "give another", fields=["extruder"]
            )
        return self

    @model_validator(mode="after")
    def _axes_of_its_type(self) -> MachineSpec:
        if self.type == "robot":
            if self.flavour != "linuxcnc":
                reason = f"{self.flavour} has no kinematics that take the pose of a robot's nozzle"
                raise refusal(reason, "use linuxcnc, or a five-axis machine", fields=["type", "flavour"])
            if {"rotary", "least", "greatest", "part", "part_rpy", "tcp"} & self.model_fields_set:
                reason = "a robot has no rotary axes, limits, part_mm, part_rpy_deg or tcp of its own"
                raise refusal(reason, "leave them out: the cell says where its part is", fields=["rotary", "type"])
            return self
        if self.least is not None and self.greatest is not None:
            for name, low, high in zip("XYZ", self.least, self.greatest, strict=True):
                if not low < high:
                    raise refusal(f"{name} has no range: least_mm is not below greatest_mm", fields=["greatest_mm"])
        if len(self.rotary) != 2:
            raise refusal(f"{self.type} has 2 rotary axes, not {len(self.rotary)}", "give both", fields=["rotary"])
        first, second = (np.array(axis.direction) for axis in self.rotary)
        down = np.array([0.0, 0.0, -1.0])
        tilting = second if self.type == "head_head" else first
        for a, b, what in ((first, second, "the two axes"), (tilting, down, "the axis that tilts and the nozzle")):
            if np.linalg.norm(np.cross(a, b)) < np.sin(np.radians(LEAST_ANGLE)):
                raise refusal(f"{what} are parallel", f"at least {LEAST_ANGLE:g} degrees apart", fields=["rotary"])
        return self


def _address(value: Any) -> str:
    """A numeric IPv4 address, the only kind that a controller can bind."""
    try:
        return str(IPv4Address(value if isinstance(value, str) else ""))
    except AddressValueError as error:
        hint = "four numbers, such as 192.168.125.1"
        raise refusal(f"{describe(value)} is not an address", hint) from error


_Weight = Annotated[float, Quantity("", 0, 100)]  # beyond, a price would weigh as much as a bound


class WeightsSpec(Section):
    """Factors on the prices of the refinement's terms. Cones, clearance and ranges are bounds: they have no weight."""

    time_lost: _Weight = key("time_lost", "time below the commanded speed, and each dip", 1)
    effort: _Weight = key("effort", "joints' speed, acceleration and jerk, and peaks of speed", 1)
    singularity: _Weight = key("singularity", "proximity of the arm to singularities", 1)
    joint_limits: _Weight = key("joint_limits", "proximity of the arm's joints to the ends of their ranges", 1)
    tilt: _Weight = key("tilt", "lean of the nozzle from the surface normal", 1)
    travel: _Weight = key("travel", "bead ends that move away from where travel is short", 1)


class ResolveSpec(Section):
    """Settings of the search for joint paths: finer is better and slower."""

    roll_step: Annotated[float, Quantity("deg", 2, 90)] = key(
        "roll_step_deg", "step between tried rotations about the nozzle axis [deg]; refined to a third", 15
    )
    table_step: Annotated[float, Quantity("deg", 1, 90)] = key(
        "table_step_deg", "step between tried angles of the positioner [deg]; refined to a third", 15
    )
    rung: Annotated[float, Quantity("mm", 0.5, 100)] = key(
        "rung_mm", "distance along a bead between places where postures are searched [mm]; interpolated in between", 5
    )
    knot: Annotated[float, Quantity("mm", 0.5, 100)] = key(
        "knot_mm",
        "distance along a bead between control values of the refined free angles; half of that around bends [mm]",
        2.5,
    )
    min_sigma: Annotated[float, Quantity("", 0, 1)] = key(
        "min_sigma", "least singular value of the arm's Jacobian (in metres); below it, joints race", 0.05
    )
    qp: Annotated[QPName, one_of(QP_NAMES)] = key(
        "qp", f"solver of the quadratic programs of strategy sqp: {' or '.join(QP_NAMES)} (slower)", "interior_point"
    )
    timing: Annotated[TimingName, one_of(TIMING_NAMES)] = key(
        "timing",
        f"how joint paths are timed: {' or '.join(TIMING_NAMES)}, a reference without jerk limits that is not verified",
        "jerk_limited",
    )
    published: Annotated[PublishedName, one_of(PUBLISHED_NAMES)] = key(
        "published",
        f"which paper's method strategy as_published follows: {', '.join(PUBLISHED_NAMES)}; unless set, along_path "
        "with process.fibre, and fixed_heading on faces and aerofoils",
        "turning_table",
    )
    weights: WeightsSpec = key(
        "weights", "factors on the terms that the refinement of strategy sqp trades off; each has a default", {}
    )


class SocketSpec(Section):
    """Where the controller waits for the relay of style `socket`."""

    address: Annotated[str, Form(_address, schema={"pattern": _ADDRESS})] = key(
        "address",
        "address of the controller itself in the relay's network; the default is out of reach of other computers",
        "127.0.0.1",
    )
    port: Annotated[int, Quantity("", FIRST_PORT, LAST_PORT, whole=True)] = key(
        "port", "port of the controller", FIRST_PORT
    )


class BoardSpec(Section):
    """The board that moves filament with `extrusion.gcode`: its firmware, and how it keeps pace with the robot."""

    firmware: Annotated[FirmwareName, one_of(FIRMWARES)] = key("firmware", f"one of {', '.join(FIRMWARES)}", "reprap")
    sync: Annotated[SyncName, one_of(SYNCS)] = key(
        "sync",
        "what keeps it in step: signal, it waits for the robot's output at both ends of each bead, which klipper "
        "cannot do; or free, time alone",
        "signal",
    )
    input: Annotated[int, Quantity("", 0, max(INPUTS.values()) - 1, whole=True)] = key(
        "input",
        "number of the input that the extruder's output is wired to: J of M950 (reprap), or the pin's number (marlin); "
        "further materials use the following ones",
        1,
    )
    tools: Annotated[tuple[Annotated[int, Quantity("", 0, 99, whole=True)], ...], UNIQUE] | None = key(
        "tools",
        "numbers of its tools; a print of one material selects the first; default: tool 0, or those of the materials",
        None,
    )
    rests: Truth | None = key(
        "rests",
        "whether each of its moves starts and ends at rest, so that lines are written faster to make up for the ramps; "
        "default: with klipper",
        None,
    )
    acceleration: Annotated[float, Quantity("mm/s2", 10, 1e6)] = key(
        "acceleration_mm_s2", "acceleration of filament that moves from rest to rest [mm/s2]", 1500
    )

    @property
    def from_rest(self) -> bool:
        """Whether each line moves filament from rest to rest."""
        return self.firmware == "klipper" if self.rests is None else self.rests

    @property
    def first_tool(self) -> int:
        """Number of the tool that a print of one material selects."""
        return 0 if self.tools is None else self.tools[0]

    @model_validator(mode="after")
    def _what_its_firmware_can(self) -> BoardSpec:
        if self.tools == ():
            reason = "a board without a tool moves no filament"
            raise refusal(reason, "give the numbers of its tools, for example [0]", fields=["tools"])
        if self.sync == "free":
            return self
        if self.firmware not in INPUTS:
            raise refusal(
                f"{self.firmware} has no command that waits for an input",
                "set sync: free, which runs by time alone, or program.style demand or socket; see docs/gcode.md",
                fields=["firmware", "sync"],
            )
        if self.input >= INPUTS[self.firmware]:
            reason = f"{self.firmware} has no input {self.input}"
            raise refusal(reason, f"valid: 0 to {INPUTS[self.firmware] - 1}", fields=["firmware", "input"])
        return self


class ProgramSpec(Section):
    """The robot program: how it drives the extruder, its names, and how finely its moves approximate a bead."""

    languages: Annotated[tuple[Annotated[LanguageName, one_of(LANGUAGE_NAMES)], ...], UNIQUE] | None = key(
        "languages", f"of {', '.join(LANGUAGE_NAMES)}, those to write; default: what the arm's controller speaks", None
    )
    tool: Identifier = key("tool", "name of the tooldata", "tPen")
    work_object: Identifier = key("work_object", "name of the wobjdata", "wobjPart")
    station: Identifier | None = key(
        "station",
        f"the mechanical unit that moves the part; default: {POSITIONER}, or {SECOND_ARM} where a second arm does",
        None,
    )
    extruder_signal: Identifier = key("extruder_signal", "name of the digital output of the extruder", "doExtrude")
    extruder_output: Annotated[int, Quantity("", 0, 4096, whole=True)] = key(
        "extruder_output", "its number, where outputs have numbers; further materials use the following ones", 1
    )
    style: Annotated[StyleName, one_of(STYLE_NAMES)] = key(
        "style",
        "how the extruder is driven: output, by a digital output; demand, also by an analog one that follows the flow; "
        "socket, by lines of G-code through a socket",
        "output",
    )
    socket: SocketSpec = key("socket", "where style socket waits for its relay; each has a default", {})
    demand_signal: Identifier = key("demand_signal", "name of the analog output of style demand", "aoDemand")
    demand_scale: Annotated[float, Quantity("", 1e-6, 1e6)] = key(
        "demand_scale", "value of that output per mm3/s of filament, in volts for example", 0.5
    )
    demand_most: Annotated[float, Quantity("", 1e-6, 1e9)] = key(
        "demand_most", "greatest value that it can have; a plan that needs more is refused", 10
    )
    board: BoardSpec = key("board", "what moves filament with extrusion.gcode; each has a default", {})
    module_moves: Annotated[int, Quantity("", 100, 1_000_000, whole=True)] = key(
        "module_moves",
        "moves per RAPID module; a longer program is split into modules that are loaded on the way",
        5000,
    )
    chord: Annotated[float, Quantity("mm", 0.005, 1)] = Field(
        0.05,
        alias="chord_mm",
        description="how far a line or an arc of the program may be from the bead that it stands for [mm]; default: "
        "0.05, or a quarter of process.bead.height_mm if that is less",
    )
    widest_chord: Annotated[float, Quantity("mm", 0.005, 2)] | None = key(
        "widest_chord_mm",
        "the same where moves would otherwise take less than least_time_ms; other tolerances grow in proportion; "
        "default: twice chord_mm [mm]",
        None,
    )
    least_time: Annotated[float, Quantity("ms", 0, 1000)] = key(
        "least_time_ms",
        "least time that a move on a bead should take, since controllers accept only so many targets a second [ms]",
        25,
    )
    arcs: Truth = key("arcs", "circular moves, in languages that have them", True)
    tangent: Annotated[float, Quantity("deg", 0.5, 45)] = key(
        "tangent_deg", "greatest angle between a bead and the line that stands for it [deg]", 45
    )
    longest: Annotated[float, Quantity("mm", 1, 1000)] = key(
        "longest_mm", "longest move on a bead [mm]; below it, chord and angle alone decide", 25
    )
    largest_zone: Annotated[ZoneName, one_of(ZONE_NAMES)] = key(
        "largest_zone", f"the largest zone of a target in RAPID: {', '.join(ZONE_NAMES)}", "z10"
    )
    machine: MachineSpec | None = key("machine", "a multi-axis machine to write G-code for; default: none", None)

    @property
    def widening(self) -> float:
        """Factor by which tolerances may grow to reach the least time."""
        return 2.0 if self.widest_chord is None else self.widest_chord / self.chord

    def mover(self, second_arm: bool) -> str:
        """The mechanical unit that moves the part: a second arm, or a positioner."""
        return self.station or (SECOND_ARM if second_arm else POSITIONER)

    @model_validator(mode="after")
    def _distinct(self) -> ProgramSpec:
        if self.widest_chord is not None and self.widest_chord < self.chord:
            raise refusal(
                f"widest_chord_mm, {1e3 * self.widest_chord:g}, is less than chord_mm, {1e3 * self.chord:g}",
                "make it at least as wide",
                fields=["widest_chord_mm", "chord_mm"],
            )
        seen: dict[str, str] = {}
        for field in ("tool", "work_object", "station", "extruder_signal", "demand_signal"):
            name = getattr(self, field) or POSITIONER
            first = seen.setdefault(name.lower(), field)  # RAPID ignores case
            if first != field:
                raise refusal(
                    f"{name!r} names both {first} and {field}", "give each its own name", fields=[first, field]
                )
            if OWN_NAMES.fullmatch(name) or (field != "station" and name.upper() in ARMS):
                reason = f"{name!r} may be a name of the program's own, or of the controller's"
                raise refusal(reason, f"for example my_{name}"[:LONGEST_NAME], fields=[field])
        return self
