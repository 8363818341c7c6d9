"""A multi-axis machine that runs G-code: the section `program.machine` of the problem file."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, model_validator

from planner.problem.fields import (
    INCREASING,
    UNIT_VECTOR,
    Form,
    Position,
    Quantity,
    Section,
    Vector,
    key,
    one_of,
    refusal,
)
from planner.problem.file import describe

FlavourName = Literal["linuxcnc", "reprap"]
FLAVOURS: tuple[str, ...] = get_args(FlavourName)
MachineType = Literal["robot", "table_table", "head_table", "head_head"]
MACHINE_TYPES: tuple[str, ...] = get_args(MachineType)
FeedName = Literal["inverse_time", "per_minute"]
FEEDS: tuple[str, ...] = get_args(FeedName)
TURNING = {"linuxcnc": ("A", "B", "C"), "reprap": ("A", "B", "C", "U", "V", "W")}  # letters that may turn
EXTRUDER = {"linuxcnc": ("U", "V", "W"), "reprap": ("E",)}  # letters that may push filament; the last one by default
LEAST_ANGLE = 5.0  # deg between the two axes, and between the second one and the nozzle: below, nothing can be reached


def _code(value: Any) -> str:
    words = value.split(" ") if isinstance(value, str) else []
    if not 0 < len(words) <= 4 or not all(_is_word(word) for word in words):
        raise refusal(f"must be words of G-code, not {describe(value)}", "for example 'G43.4 H1' or M428")
    return " ".join(words)


def _is_word(word: str) -> bool:
    number = word[1:].replace(".", "", 1)
    return word[:1].isascii() and word[:1].isupper() and number.isdecimal() and number.isascii() and len(word) <= 8


def _truth(value: Any) -> bool:
    if not isinstance(value, bool):
        raise refusal(f"must be true or false, not {describe(value)}", "without quotes")
    return value


Code = Annotated[str, Form(_code, schema={"pattern": "^[A-Z][0-9.]+( [A-Z][0-9.]+){0,3}$"})]
Letter = Annotated[str, one_of(("A", "B", "C", "E", "U", "V", "W"))]


class RotarySpec(Section):
    """An axis that turns the head or the table, right-handed about its direction at zero angles of both axes."""

    letter: Letter = key("letter", "its letter in the G-code")
    direction: Annotated[Vector, Quantity("", -1000, 1000, count=3), UNIT_VECTOR] = key(
        "direction", "about which a positive angle turns what it carries, on the machine's axes"
    )
    centre: Position = key(
        "centre_mm", "a point on it [mm]: on the machine; of an axis in the head, from the nozzle's tip", (0, 0, 0)
    )
    range: Annotated[tuple[float, float], Quantity("deg", -1800, 1800, count=2), INCREASING] | None = key(
        "range_deg", "least and greatest angle [deg]; default: it turns without end", None
    )


class MachineSpec(Section):
    """A machine of six axes (a robot), or of three straight ones and two that turn."""

    flavour: Annotated[FlavourName, one_of(FLAVOURS)] = key("flavour", f"its controller: {' or '.join(FLAVOURS)}")
    type: Annotated[MachineType, one_of(MACHINE_TYPES)] = key(
        "type", f"what turns: {', '.join(MACHINE_TYPES)}; a robot is told poses of the nozzle"
    )
    rotary: tuple[RotarySpec, ...] = key(
        "rotary",
        "the two axes that turn, the one that carries the other first; of head_table the head's first; default: none",
        (),
    )
    least: Position | None = key("least_mm", "least X, Y and Z of the machine [mm]; default: not looked at", None)
    greatest: Position | None = key("greatest_mm", "greatest X, Y and Z [mm]; default: not looked at", None)
    part: Position = key("part_mm", "origin of the part frame on the machine at zero angles [mm]", (0, 0, 0))
    part_rpy: Annotated[Vector, Quantity("deg", -360, 360, count=3)] = key(
        "part_rpy_deg", "roll, pitch and yaw of the part frame there [deg]", (0, 0, 0)
    )
    tcp: Annotated[bool, BeforeValidator(_truth)] = key(
        "tcp", "whether the controller keeps the tip on its line while axes turn (tool centre point control)", False
    )
    tcp_on: Code = key("tcp_on", "code that switches that on", "M428")
    tcp_off: Code = key("tcp_off", "code that switches that off", "M429")
    extruder: Letter | None = key(
        "extruder", "letter of the axis that pushes filament; default W, or E of reprap", None
    )
    feed: Annotated[FeedName, one_of(FEEDS)] = key(
        "feed", "what F says: inverse_time (G93), or per_minute for firmware that lacks it", "inverse_time"
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
                reason = f"{self.flavour} does not turn {axis.letter}"
                raise refusal(reason, f"choices: {', '.join(turning)}", fields=["rotary"])
            if axis.letter in [other.letter for other in self.rotary[:i]]:
                raise refusal(f"two axes are called {axis.letter}", "give each its own letter", fields=["rotary"])
        if self.filament not in pushing:
            reason = f"{self.flavour} does not push filament with {self.filament}"
            raise refusal(reason, f"choices: {', '.join(pushing)}", fields=["extruder"])
        if self.filament in [axis.letter for axis in self.rotary]:
            raise refusal(f"{self.filament} is the letter of an axis that turns", "give another", fields=["extruder"])
        return self

    @model_validator(mode="after")
    def _axes_of_its_type(self) -> MachineSpec:
        if self.type == "robot":
            if self.flavour != "linuxcnc":
                reason = f"{self.flavour} has no kinematics that take the pose of a robot's nozzle"
                raise refusal(reason, "take linuxcnc, or a machine of five axes", fields=["type", "flavour"])
            if {"rotary", "least", "greatest", "part", "part_rpy", "tcp"} & self.model_fields_set:
                reason = "a robot has no rotary axes, limits, part_mm, part_rpy_deg or tcp of its own"
                raise refusal(reason, "leave them out: the cell says where its part is", fields=["rotary", "type"])
            return self
        if self.least is not None and self.greatest is not None:
            for name, low, high in zip("XYZ", self.least, self.greatest, strict=True):
                if not low < high:
                    raise refusal(f"{name} has no room between least_mm and greatest_mm", fields=["greatest_mm"])
        if len(self.rotary) != 2:
            raise refusal(f"{self.type} has 2 rotary axes, not {len(self.rotary)}", "give both", fields=["rotary"])
        first, second = (np.array(axis.direction) for axis in self.rotary)
        down = np.array([0.0, 0.0, -1.0])
        tilting = second if self.type == "head_head" else first
        for a, b, what in ((first, second, "the two axes"), (tilting, down, "the axis that tilts and the nozzle")):
            if np.linalg.norm(np.cross(a, b)) < np.sin(np.radians(LEAST_ANGLE)):
                raise refusal(f"{what} are parallel", f"at least {LEAST_ANGLE:g} degrees apart", fields=["rotary"])
        return self
