"""What every source of toolpaths has in common: a section `layers.source` is named by one key of its own."""

from __future__ import annotations

from typing import Any

from pydantic import model_validator

from planner.problem.fields import Section, refusal

# Each names a source, so only one may be given.
SOURCE_NAMES = ("svg", "pattern", "curves", "waypoints", "gcode", "mesh", "aerofoil", "naca", "faces")


class SourceSection(Section):
    """A source of toolpaths; refused where another source is named beside it."""

    @model_validator(mode="before")
    @classmethod
    def _one_source(cls, value: Any) -> Any:
        given = [name for name in SOURCE_NAMES if isinstance(value, dict) and name in value]
        if len(given) > 1:
            raise refusal(f"both {given[0]} and {given[1]} are given", "give one of them", fields=given)
        return value
