"""What is laid down and what pushes it: the sections `bead` and `extruder` of `process` in the problem file."""

from __future__ import annotations

import math
from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from planner.problem.fields import Quantity, Section, Thickness, key, one_of, refusal

SectionName = Literal["rectangle", "rounded", "fibre"]
MotorName = Literal["e_axis", "speed_demand", "on_off"]
SECTIONS: tuple[str, ...] = get_args(SectionName)
MOTORS: tuple[str, ...] = get_args(MotorName)


class BeadSpec(Section):
    """Cross-section of a bead."""

    width: Thickness = key("width_mm", "width [mm]")
    # NaN only until Process is complete and the layers' height is put in its place.
    height: Thickness = Field(
        default_factory=lambda: math.nan,
        validate_default=False,
        alias="height_mm",
        description="height [mm]; default layers.height_mm, where that is given",
    )
    section: Annotated[SectionName, one_of(SECTIONS)] | None = key(
        "section",
        "shape: rectangle, width times height; rounded, half a circle at both sides; "
        "fibre, as thick as the filament, which is fed as fast as it is laid; default rectangle, or fibre with fibre",
        None,
    )


class ExtruderSpec(Section):
    """What pushes the filament."""

    motor: Annotated[MotorName, one_of(MOTORS)] = key(
        "motor",
        "how it is driven: e_axis, an axis of its own; speed_demand, in proportion to the nozzle's real speed; "
        "on_off, at the commanded speed's rate as long as a bead is laid",
        "e_axis",
    )
    lag: Annotated[float, Quantity("s", 0, 2)] = key(
        "lag_s", "time by which flow lags the motor, which then runs ahead (pressure advance) [s]", 0
    )

    @model_validator(mode="after")
    def _only_what_can_be_driven(self) -> ExtruderSpec:
        if self.motor == "on_off" and self.lag > 0.0:
            reason = "a motor that is only on or off cannot make up for lag_s"
            raise refusal(reason, "leave out lag_s, or take another motor", fields=["motor", "lag_s"])
        return self
