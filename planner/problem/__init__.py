"""The problem: cell, part, layers, process and strategy, from one YAML file into frozen SI values.

The keys of the file are the aliases, in mm and degrees; the names of the attributes carry no unit because they are SI
(m, s, rad). What a value may be, and why, stands with its field.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import PrivateAttr, ValidationError, ValidationInfo, field_validator
from pydantic_core import PydanticKnownError

from planner.errors import InputError
from planner.problem.cell import CellSpec
from planner.problem.fields import IDENTIFIER, Section, key, one_of, refusal
from planner.problem.file import (
    Keys,
    Source,
    apply_overrides,
    find_problem,
    parse_yaml,
    read_problem_file,
    shipped_problems,
)
from planner.problem.gcode import GcodeLayersSpec
from planner.problem.layers import AnyLayersSpec, check_body
from planner.problem.materials import check_materials
from planner.problem.mistakes import first_mistake
from planner.problem.part import PartSpec
from planner.problem.process import ProcessSpec
from planner.problem.settings import STRATEGY_NAMES, ProgramSpec, ResolveSpec, StrategyName
from planner.problem.solids import CollisionSpec
from planner.problem.waypoints import WaypointLayersSpec

__all__ = ["Problem", "find_problem", "load_problem", "shipped_problems"]

Identifier = Annotated[str, IDENTIFIER]


class Problem(Section):
    """One print: everything that the planner is told.

    In SI units; made by `load_problem`.
    """

    name: Identifier = key("name", "name of the problem: of its results' folder and of the robot program")
    cell: CellSpec = key("cell", "arm, nozzle, and what carries the part")
    layers: AnyLayersSpec = key("layers", "what is printed")
    part: PartSpec | None = key(
        "part", "the body to print on, where curves are wrapped or projected; default: none", None
    )
    process: ProcessSpec = key("process", "how material is laid down")
    strategy: Annotated[StrategyName, one_of(STRATEGY_NAMES)] = key(
        "strategy", f"how the free motion is decided: {', '.join(STRATEGY_NAMES)}", "sqp"
    )
    resolve: ResolveSpec = key("resolve", "settings of the search; each has a default", {})
    collision: CollisionSpec = key("collision", "how far everything keeps apart; each has a default", {})
    program: ProgramSpec = key("program", "names in the robot program, and how fine it is; each has a default", {})
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
        layers, given = info.data.get("layers"), "height" in process.bead.model_fields_set
        if isinstance(layers, GcodeLayersSpec):
            if given:
                raise refusal("height_mm stands in the G-code", "leave it out", item="bead")
            return process
        if given or layers is None:
            return process
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

    @property
    def overrides(self) -> tuple[str, ...]:
        """The `dotted.key=value` that were applied to the file."""
        return self._source.overrides

    def error(self, field: str, reason: str, hint: str | None = None) -> InputError:
        """Return the error of a field, dotted as in the file (`cell.arm`), with its file and line, or its `--set`.

        A whole number in it counts items of a list from 0.
        """
        path = tuple(int(key) if key.isdecimal() else key for key in field.split("."))
        return self._source.error(path, reason, hint)


def load_problem(path: str | Path, overrides: Sequence[str] = ()) -> Problem:
    """Read a problem file, or a shipped problem by name, with `dotted.key=value` overrides applied before validation.

    Raises one InputError for whatever is wrong: the first mistake by line, and how many more there are. The drawing
    that the problem names is not opened.
    """
    data, source = read_problem_file(find_problem(path))
    data, source = apply_overrides(data, source, overrides)
    return _validated(data, source)


def parse_problem(text: str, file: Path) -> Problem:
    """Read a problem from its text, as if it stood in a file that need not be there yet; raises InputError."""

    def complain(reason: str, line: int | None, hint: str | None) -> InputError:
        return InputError(reason, file=file, line=line, hint=hint)

    lines: dict[Keys, int] = {}
    data = parse_yaml(text, complain, lines)
    return _validated(data, Source(file, lines))


def _validated(data: dict[str, Any], source: Source) -> Problem:
    try:
        problem = Problem.model_validate(data, context=source)
    except ValidationError as error:
        raise first_mistake(error.errors(include_url=False), source, Problem) from None
    check_materials(problem)
    return problem
