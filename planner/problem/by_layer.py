"""Settings of single layers and beads: speeds, least times, pauses, and how a layer is laid."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, model_validator

from planner.problem.fields import (
    TEXT,
    UNIQUE,
    UNIT_VECTOR,
    Position,
    Quantity,
    Section,
    Vector,
    exactly_one,
    key,
    refusal,
)
from planner.problem.yaml_file import describe

Speed = Annotated[float, Quantity("mm/s", 0.1, 2000)]  # below, a print takes days; above, no arm is exact
LayerNumber = Annotated[int, Quantity("", 1, 100_000, whole=True)]

LEAST_WAIT = 0.1  # s: five of the coarsest samples, so that events before and after never fall into the same one
_SLOWEST = 0.5  # × the process's speed, by default: below, thin beads drag and pull off
_DAY = 86_400  # s
_MOST = 100  # rules, pauses or patterns: each is looked up for every bead


def fits(pattern: str, name: str) -> bool:
    """Whether a name matches a pattern: * stands for any letters, ? for one."""
    escaped = re.escape(pattern).replace(r"\*", ".*").replace(r"\?", ".")
    return re.fullmatch(escaped, name, re.DOTALL) is not None


def _few(value: Any) -> Any:
    if isinstance(value, list | tuple) and len(value) > _MOST:
        raise refusal(f"must be a list of at most {_MOST}, not of {len(value)}", None)
    return value


class SpeedSpec(Section):
    """A speed of some beads: by their layers, their names, or both."""

    speed: Speed = key("speed_mm_s", "speed of the nozzle along the part while printing these beads [mm/s]")
    from_layer: LayerNumber = key("from_layer", "the first layer that it applies to, counted from 1", 1)
    to_layer: LayerNumber | None = key("to_layer", "the last layer that it applies to; default: the last of all", None)
    beads: Annotated[str, TEXT] = key(
        "beads", "names of the beads that it applies to, as in the report; * stands for any letters, ? for one", "*"
    )

    @model_validator(mode="after")
    def _some_layers(self) -> SpeedSpec:
        if self.to_layer is not None and self.to_layer < self.from_layer:
            reason = f"to_layer is {self.to_layer}, before from_layer {self.from_layer}"
            raise refusal(reason, "give a later one", fields=["from_layer", "to_layer"])
        return self

    def covers(self, name: str, layer: int) -> bool:
        """Whether it applies to a bead of that name in that layer, counted from 0."""
        last = layer + 1 if self.to_layer is None else self.to_layer
        return self.from_layer <= layer + 1 <= last and fits(self.beads, name)


class LayerTimeSpec(Section):
    """The least time between the starts of two layers, so that one is firm before the next is laid."""

    least: Annotated[float, Quantity("s", LEAST_WAIT, 3600)] = key(
        "least_s", "least time from a layer's start to the next one's [s]"
    )
    slowest: Speed | None = key(
        "slowest_mm_s",
        "speed down to which beads of a short layer are slowed [mm/s]; the robot waits at home for any time still "
        f"missing; default: {_SLOWEST:g} of speed_mm_s",
        None,
    )

    def floor(self, usual: float) -> float:
        """Least speed [m/s] that beads are slowed down to, if the process's speed is `usual`."""
        return _SLOWEST * usual if self.slowest is None else self.slowest


class InterlayerTimeSpec(Section):
    """The range of ages that a place may have when the next layer's bead is laid on it."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": ["least_s"]}, {"required": ["most_s"]}]})

    least: Annotated[float, Quantity("s", LEAST_WAIT, _DAY)] | None = key(
        "least_s", "no bead is laid on a place before it is this old [s]; default: any", None
    )
    most: Annotated[float, Quantity("s", LEAST_WAIT, _DAY)] | None = key(
        "most_s", "no bead is laid on a place that is older [s]; default: any", None
    )

    @model_validator(mode="after")
    def _a_window(self) -> InterlayerTimeSpec:
        both = ["least_s", "most_s"]
        if self.least is None and self.most is None:
            raise refusal("give least_s, most_s or both", "for example {least_s: 20, most_s: 120}", fields=both)
        if self.least is not None and self.most is not None and self.least > self.most:
            reason = f"least_s is {self.least:g}, more than most_s {self.most:g}"
            raise refusal(reason, "give a window from a least to a greatest time", fields=both)
        return self


class PauseSpec(Section):
    """A rest at home before a layer, to insert something or to change the spool."""

    before_layer: Annotated[int, Quantity("", 2, 100_000, whole=True)] = key(
        "before_layer", "the layer that it comes before, counted from 1"
    )
    wait: Annotated[float, Quantity("s", LEAST_WAIT, 3600)] = key("wait_s", "time that the robot rests at home [s]")
    what: Annotated[str, TEXT] = key("for", "what it is for, in words that are written into the programs", "pause")
    purge: Annotated[float, Quantity("mm", 0, 1000)] = key(
        "purge_mm", "filament pushed out after the wait, as for a new spool [mm]; 0 is none", 0
    )
    purge_speed: Annotated[float, Quantity("mm/s", 0.1, 200)] = key(
        "purge_speed_mm_s", "speed of the filament while purging [mm/s]", 5
    )

    @model_validator(mode="after")
    def _plain_words(self) -> PauseSpec:
        if not self.what.isprintable() or not self.what.isascii():
            raise refusal(f"for cannot be {describe(self.what)}", "use plain letters: robots read them", fields=["for"])
        return self

    @property
    def time(self) -> float:
        """How long the robot rests at home for it [s]."""
        return self.wait + self.purge / self.purge_speed


class SkirtSpec(Section):
    """Lines around the first layer, which has to be level, laid before all other beads."""

    loops: Annotated[int, Quantity("", 1, 100, whole=True)] = key("loops", "number of lines, side by side", 1)
    gap: Annotated[float, Quantity("mm", 0, 100)] = key(
        "gap_mm",
        "distance between the innermost line and the layer [mm]; 0 makes a brim, which holds the print to the bed",
        3,
    )


class SeamSpec(Section):
    """Where closed beads begin and end: one of these."""

    model_config = exactly_one("near_mm", "towards")

    near: Position | None = key(
        "near_mm", "they begin where they come nearest to this place in the part frame [mm]; default: none", None
    )
    towards: Annotated[Vector, Quantity("", -1e6, 1e6, count=3), UNIT_VECTOR] | None = key(
        "towards", "they begin where they reach farthest in this direction of the part frame; default: none", None
    )

    @model_validator(mode="after")
    def _one_of_them(self) -> SeamSpec:
        if (self.near is None) == (self.towards is None):
            raise refusal(
                "give either near_mm or towards", "towards: [0, 1, 0] is at the back", fields=["near_mm", "towards"]
            )
        return self


Speeds = Annotated[tuple[SpeedSpec, ...], BeforeValidator(_few)]
Pauses = Annotated[tuple[PauseSpec, ...], BeforeValidator(_few)]
Order = Annotated[tuple[Annotated[str, TEXT], ...], BeforeValidator(_few), UNIQUE]
