"""Strategy, settings of the search, and of the robot program: the sections `resolve` and `program`."""

from __future__ import annotations

import re
from ipaddress import AddressValueError, IPv4Address
from typing import Annotated, Any, Literal, get_args

from pydantic import model_validator

from planner.problem.fields import IDENTIFIER, LONGEST_NAME, UNIQUE, Form, Quantity, Section, key, one_of, refusal
from planner.problem.file import describe
from planner.problem.machine import MachineSpec

StrategyName = Literal["as_published", "fixed", "greedy", "ladder", "sqp", "nlp"]
STRATEGY_NAMES: tuple[str, ...] = get_args(StrategyName)
QPName = Literal["interior_point", "osqp"]
QP_NAMES: tuple[str, ...] = get_args(QPName)
LanguageName = Literal["rapid", "urscript", "krl", "joint_trajectory", "axes"]
LANGUAGE_NAMES: tuple[str, ...] = get_args(LanguageName)
USUAL_LANGUAGE: LanguageName = "joint_trajectory"  # of arms whose file names none
Identifier = Annotated[str, IDENTIFIER]
StyleName = Literal["output", "demand", "socket"]
STYLE_NAMES: tuple[str, ...] = get_args(StyleName)
FIRST_PORT, LAST_PORT = 1025, 4999  # ABB, RAPID reference, SocketBind: free for programs
_ADDRESS = r"^[0-9]{1,3}(\.[0-9]{1,3}){3}$"  # roughly, for editors
# names that the program gives itself: procedures, speeds, triggers, and what serves the socket; and ABB's own data
_OWN_NAMES = re.compile(
    r"(main|start|finish|bead\d+(part\d+)?|vel\d\w*|trg\w*|bw\w*|(tool|wobj|load)0|fine|[vz]\d+)", re.IGNORECASE
)


def _address(value: Any) -> str:
    """A numeric IPv4 address, which is what a controller can bind."""
    try:
        return str(IPv4Address(value if isinstance(value, str) else ""))
    except AddressValueError as error:
        hint = "four numbers, such as 192.168.125.1"
        raise refusal(f"{describe(value)} is not an address", hint) from error


class ResolveSpec(Section):
    """Settings of the search for joint paths: finer is better and slower."""

    roll_step: Annotated[float, Quantity("deg", 2, 90)] = key(
        "roll_step_deg", "step between tried rotations about the nozzle axis [deg]; refined to a third", 15
    )
    table_step: Annotated[float, Quantity("deg", 1, 90)] = key(
        "table_step_deg", "step between tried angles of the positioner [deg]; refined to a third", 15
    )
    rung: Annotated[float, Quantity("mm", 0.5, 100)] = key(
        "rung_mm", "distance along a bead at which postures are searched [mm]; interpolated between", 5
    )
    knot: Annotated[float, Quantity("mm", 0.5, 100)] = key(
        "knot_mm",
        "distance along a bead between control values of the refined free angles; round bends half of it [mm]",
        2.5,
    )
    min_sigma: Annotated[float, Quantity("", 0, 1)] = key(
        "min_sigma", "least singular value of the arm's Jacobian (metres); below it joints race", 0.05
    )
    qp: Annotated[QPName, one_of(QP_NAMES)] = key(
        "qp", f"solver of the quadratic programs of strategy sqp: {' or '.join(QP_NAMES)} (slower)", "interior_point"
    )


class SocketSpec(Section):
    """Where the controller waits for the relay of style `socket`."""

    address: Annotated[str, Form(_address, schema={"pattern": _ADDRESS})] = key(
        "address",
        "of the controller itself, in the network of the relay; the default reaches no other computer",
        "127.0.0.1",
    )
    port: Annotated[int, Quantity("", FIRST_PORT, LAST_PORT, whole=True)] = key("port", "of the controller", FIRST_PORT)


class ProgramSpec(Section):
    """The robot program: how it drives the extruder, its names, and how finely its straight lines divide a bead."""

    languages: Annotated[tuple[Annotated[LanguageName, one_of(LANGUAGE_NAMES)], ...], UNIQUE] | None = key(
        "languages", f"of {', '.join(LANGUAGE_NAMES)}, those to write; default: what the arm's controller speaks", None
    )
    tool: Identifier = key("tool", "the tooldata", "tPen")
    work_object: Identifier = key("work_object", "the wobjdata", "wobjPart")
    station: Identifier = key("station", "the positioner's mechanical unit", "STN1")
    extruder_signal: Identifier = key("extruder_signal", "the digital output of the extruder", "doExtrude")
    extruder_output: Annotated[int, Quantity("", 0, 4096, whole=True)] = key(
        "extruder_output", "its number, where outputs have numbers; further materials have those after it", 1
    )
    style: Annotated[StyleName, one_of(STYLE_NAMES)] = key(
        "style",
        "how the extruder is driven: by a digital output; by an analog one besides, with the flow; or by lines of "
        "G-code through a socket",
        "output",
    )
    socket: SocketSpec = key("socket", "where style socket waits for its relay; each has a default", {})
    demand_signal: Identifier = key("demand_signal", "the analog output of style demand", "aoDemand")
    demand_scale: Annotated[float, Quantity("", 1e-6, 1e6)] = key(
        "demand_scale", "value of that output for each mm3/s of filament, such as volts", 0.5
    )
    demand_most: Annotated[float, Quantity("", 1e-6, 1e9)] = key(
        "demand_most", "greatest value that it can have; a plan that asks for more is refused", 10
    )
    module_moves: Annotated[int, Quantity("", 100, 1_000_000, whole=True)] = key(
        "module_moves",
        "moves of a RAPID module; a program of more is split into modules that are loaded on the way",
        5000,
    )
    chord: Annotated[float, Quantity("mm", 0.005, 1)] = key(
        "chord_mm", "how far a line of the program may be from the bead that it stands for [mm]", 0.02
    )
    tangent: Annotated[float, Quantity("deg", 0.5, 45)] = key(
        "tangent_deg", "greatest angle between a bead and the line that stands for it [deg]", 45
    )
    machine: MachineSpec | None = key("machine", "a multi-axis machine to write G-code for; default: none", None)

    @model_validator(mode="after")
    def _distinct(self) -> ProgramSpec:
        seen: dict[str, str] = {}
        for field in ("tool", "work_object", "station", "extruder_signal", "demand_signal"):
            name = getattr(self, field)
            first = seen.setdefault(name.lower(), field)  # RAPID does not tell capitals from small letters
            if first != field:
                raise refusal(
                    f"{name!r} names both {first} and {field}", "give each its own name", fields=[first, field]
                )
            if _OWN_NAMES.fullmatch(name):
                reason = f"{name!r} may be a name of the program's own, or of the controller's"
                raise refusal(reason, f"for example my_{name}"[:LONGEST_NAME], fields=[field])
        return self
