"""A wing in layers parallel to its surfaces: the section `layers` of the problem file, where its source is an aerofoil."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import model_validator

from planner.problem.fields import PATH, Form, Position, Quantity, Section, Thickness, exactly_one, key, one_of, refusal
from planner.problem.file import describe, shorten
from planner.problem.materials import MaterialName, material_key


def _naca(value: Any) -> str:
    if not isinstance(value, str):
        raise refusal(f"must be four digits in quotes, not {describe(value)}", 'for example naca: "0015"')
    if not re.fullmatch(r"[0-9]{4}", value):
        raise refusal(f"{shorten(value)!r} is no section of four digits", 'for example naca: "0015"')
    if value[2:] == "00":
        raise refusal(f"section {value} has no thickness", 'the last two digits, for example naca: "0015"')
    if (value[0] == "0") != (value[1] == "0"):
        reason = f"section {value} has camber without its place, or a place without camber"
        raise refusal(reason, "the first two digits are both 0, or neither is")
    return value


_NACA = Form(_naca, schema={"pattern": "^[0-9]{4}$"})


METHODS = ("curved", "planar")
_POINTS = "file of the section's points, counted from the folder of the problem file"


class TipSpec(Section):
    """A wing's section where its span ends; straight lines lead to it from the section where the span begins."""

    aerofoil: Annotated[Path, PATH] | None = key("aerofoil", f"{_POINTS}; default: none", None)
    naca: Annotated[str, _NACA] | None = key(
        "naca", "the section by its four digits, in quotes; default: that where the span begins", None
    )
    chord: Annotated[float, Quantity("mm", 1, 10_000)] = key("chord_mm", "length of the chord [mm]")
    sweep: Annotated[float, Quantity("mm", -10_000, 10_000)] = key(
        "sweep_mm", "how far its leading edge lies behind that where the span begins [mm]", 0
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

    aerofoil: Annotated[Path, PATH] | None = key("aerofoil", f"{_POINTS}; default: none, but naca", None)
    naca: Annotated[str, _NACA] | None = key(
        "naca", "the section by its four digits, in quotes; default: none, but aerofoil", None
    )
    chord: Annotated[float, Quantity("mm", 1, 10_000)] = key("chord_mm", "length of the chord [mm]")
    span: Annotated[float, Quantity("mm", 1, 10_000)] = key("span_mm", "length along the span [mm]")
    origin: Position = key("origin_mm", "leading edge in the part frame, where the span begins [mm]", (0, 0, 0))
    tilt: Annotated[float, Quantity("deg", 5, 90)] = key(
        "tilt_deg", "greatest tilt of a layer [deg]; where a layer is steeper, it is left out", 45
    )
    tip: TipSpec | None = key("tip", "the section where the span ends; default: the same all along the span", None)
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
    """What is printed under a wing: level layers, loosely filled, and curved ones on them that follow its surface."""

    length: Annotated[float, Quantity("mm", 1, 10_000)] = key(
        "length_mm", "length of the level layers along the chord, as much before the wing as behind it [mm]"
    )
    height: Annotated[float, Quantity("mm", 0, 10_000)] = key(
        "height_mm", "height of the level layers before and behind the wing [mm]"
    )
    infill: Annotated[float, Quantity("", 0.1, 1)] = key("infill", "share of the level layers that is filled", 0.5)
    curved: Annotated[int, Quantity("", 0, 20, whole=True)] = key("curved", "number of curved layers", 2)
    material: MaterialName | None = material_key("the support", "the wing's")


class AerofoilLayersSpec(Section):
    """What is printed, if it is a wing: layers parallel to its lower and its upper surface."""

    bodies: ClassVar[tuple[str, ...]] = ()  # a wing is its own

    source: AerofoilSpec = key("source", "where the wing's section comes from")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] | None = key(
        "count", "number of layers, from the first; default: all of support and wing", None
    )
    height: Thickness = key("height_mm", "height of a layer [mm]")
    support: SupportSpec | None = key("support", "what is printed under the wing; default: none, it is there", None)
    material: MaterialName | None = material_key("the wing")
