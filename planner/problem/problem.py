"""The problem: one YAML file as frozen SI values, or one error with its place, reason and hint.

The keys of the file are the fields' aliases, in mm and degrees. The names of attributes carry no unit, because they are
SI (m, s, rad). What values are allowed, and why, is documented with each field.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, PrivateAttr, Tag, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails, PydanticKnownError

from planner.base.errors import InputError, nearest_name
from planner.problem.as_printed import AsPrintedSpec
from planner.problem.as_run import AsRunSpec
from planner.problem.cell import CellSpec, CollisionSpec, NozzleSpec
from planner.problem.fields import IDENTIFIER, Section, key, one_of, refusal
from planner.problem.layers import (
    KINDS,
    AerofoilLayersSpec,
    AnyLayersSpec,
    FaceLayersSpec,
    GcodeLayersSpec,
    WaypointLayersSpec,
    check_body,
)
from planner.problem.overrides import apply_overrides, parse_override
from planner.problem.part import PartSpec
from planner.problem.process import CORNER_SHARE, ProcessSpec, check_board, check_materials
from planner.problem.settings import CHORD_SHARE, STRATEGY_NAMES, ProgramSpec, ResolveSpec, StrategyName
from planner.problem.yaml_file import (
    Keys,
    Override,
    ValueSources,
    describe,
    find_problem,
    parse_yaml,
    read_problem_file,
)

Mistake = tuple[Keys, str, str | None]  # path, reason, hint
Model = type[BaseModel]
# Pydantic's own entries in a path, for a key or a kind of section
_NOT_IN_THE_FILE = ("[key]", *(kind.tag for kind in KINDS))

Identifier = Annotated[str, IDENTIFIER]


def first_mistake(details: Sequence[ErrorDetails], source: ValueSources, model: Model) -> InputError:
    """Turn Pydantic's findings about a `model` into one error: those of `--set` first, then by line."""
    unknown = [detail["loc"] for detail in details if detail["type"] == "extra_forbidden"]
    meant = {(*loc[:-1], nearest_name(str(loc[-1]), _keys(model, loc[:-1]))) for loc in unknown}
    # A misspelt key is one mistake, not also a missing one.
    real = [detail for detail in details if detail["type"] != "missing" or detail["loc"] not in meant]
    mistakes = [_mistake(detail, source, model) for detail in real]

    def place(mistake: Mistake) -> int:
        return 0 if source.override(mistake[0]) is not None else source.line(mistake[0]) or 0

    every = tuple(source.error(*mistake) for mistake in sorted(mistakes, key=place))
    more = len(every) - 1
    if not more:
        return every[0]
    first = every[0]
    hint = f"{first.hint}; " if first.hint else ""
    hint += f"{more} more mistake{'s' if more > 1 else ''} in this problem"
    return InputError(first.reason, file=first.file, line=first.line, field=first.field, hint=hint, all=every)


def _mistake(detail: ErrorDetails, source: ValueSources, model: Model) -> Mistake:
    """Path, reason and hint of one of Pydantic's findings."""
    loc, value = detail["loc"], detail["input"]
    path = tuple(key for key in loc if key not in _NOT_IN_THE_FILE)
    match detail["type"]:
        case "problem":
            context = detail["ctx"]
            if "item" in context:
                path = (*path, context["item"])
            if "fields" in context:
                path = _culprit(path, context["fields"], source)
            return path, context["reason"], context["hint"]
        case "missing":
            return path, "is missing", _description(model, loc)
        case "extra_forbidden":
            keys = _keys(model, loc[:-1])
            near = nearest_name(str(path[-1]), keys)
            return path, "unknown key", f"did you mean {near}?" if near else f"known keys: {', '.join(keys)}"
        case "model_type":
            return path, f"must be a section, not {describe(value)}", f"its keys: {', '.join(_keys(model, loc))}"
        case "dict_type":
            return (
                path,
                f"must be a section, not {describe(value)}",
                "its keys are names of your own choice, or of axes and joints",
            )
        case "tuple_type":
            return path, f"must be a list, not {describe(value)}", _description(model, loc)
    return path, detail["msg"], None


def _culprit(section: Keys, fields: Sequence[str], source: ValueSources) -> Keys:
    """The last given of several fields that contradict each other; the section itself if none is given."""
    there = [path for path in ((*section, field) for field in fields) if path in source.lines or source.override(path)]
    return max(there, key=lambda path: (source.override(path) is not None, source.line(path) or 0), default=section)


def _section(model: Model, path: Keys) -> Model:
    """The model of the section at `path`; names that the user chose, such as joints, are skipped."""
    section = model
    for i, step in enumerate(path):
        for name, field in section.model_fields.items():
            if step == (field.alias or name):
                models = _models(field.annotation)
                kind = path[i + 1] if i + 1 < len(path) else None
                section = models.get(kind, next(iter(models.values()), section))
                break
    return section


def _models(annotation: Any) -> dict[Any, Model]:
    """The sections that a field may hold, by their tag where there are several kinds."""
    found: dict[Any, Model] = {}
    for choice in (annotation, *get_args(annotation)):
        tags: list[Any] = [None]
        if get_origin(choice) is Annotated:
            choice, *marks = get_args(choice)
            tags = [mark.tag for mark in marks if isinstance(mark, Tag)]
        if isinstance(choice, type) and issubclass(choice, BaseModel):
            found.update(dict.fromkeys(tags, choice))
        elif choice is not annotation and get_origin(choice) is dict:  # sections by names that the user chose, or none
            found.update(_models(choice))
    return found


def _keys(model: Model, path: Keys) -> list[str]:
    """The keys that a section may have."""
    return [field.alias or name for name, field in _section(model, path).model_fields.items()]


def _description(model: Model, path: Keys) -> str | None:
    """The description of the field at `path`."""
    fields = _section(model, path[:-1]).model_fields.values()
    return next((field.description for field in fields if field.alias == path[-1]), None)


class Problem(Section):
    """One print: all input to the planner.

    In SI units; made by `load_problem`.
    """

    name: Identifier = key("name", "name of the problem, its results folder and the robot program")
    cell: CellSpec = key("cell", "arm, nozzle, and what carries the part")
    layers: AnyLayersSpec = key("layers", "what to print")
    part: PartSpec | None = key("part", "the body to print on, if curves are wrapped or projected; default: none", None)
    process: ProcessSpec = key("process", "how material is laid down")
    strategy: Annotated[StrategyName, one_of(STRATEGY_NAMES)] = key(
        "strategy", f"how the redundant motion is chosen: {', '.join(STRATEGY_NAMES)}", "sqp"
    )
    resolve: ResolveSpec = key("resolve", "settings of the search; each has a default", {})
    collision: CollisionSpec = key("collision", "least distances between bodies; each has a default", {})
    program: ProgramSpec = key("program", "names in the robot program, and how fine it is; each has a default", {})
    as_printed: AsPrintedSpec | None = key(
        "as_printed", "what a scan found of the layers already printed; default: nothing is printed yet", None
    )
    as_run: AsRunSpec | None = key(
        "as_run", "corrections learned from runs of the program; default: the program follows the plan as it is", None
    )
    _source: ValueSources = PrivateAttr()

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
                raise refusal("height_mm comes from the G-code", "leave it out", item="bead")
            return process
        if given or layers is None:
            return process
        if isinstance(layers, WaypointLayersSpec):
            raise refusal(
                "height_mm is missing", "give the height of a bead [mm]: a file of waypoints has none", item="bead"
            )
        bead = process.bead.model_copy(update={"height": layers.height})
        return process.model_copy(update={"bead": bead})

    @field_validator("process")
    @classmethod
    def _rounded_bead_as_wide_as_high(cls, process: ProcessSpec) -> ProcessSpec:
        bead = process.bead
        if process.section == "rounded" and bead.width < bead.height:
            size = f"{bead.width * 1e3:g} mm wide and {bead.height * 1e3:g} mm high"
            raise refusal(f"a rounded bead cannot be {size}", "make it at least as wide as high", item="bead")
        return process

    @field_validator("process")
    @classmethod
    def _corners_within_the_bead(cls, process: ProcessSpec) -> ProcessSpec:
        """Unless the tolerance is given, corners of narrow beads are rounded by at most a share of their width."""
        if "corner_tolerance" in process.model_fields_set:
            return process
        most = CORNER_SHARE * process.bead.width
        return process.model_copy(update={"corner_tolerance": most}) if most < process.corner_tolerance else process

    @field_validator("resolve")
    @classmethod
    def _as_its_paper(cls, resolve: ResolveSpec, info: ValidationInfo) -> ResolveSpec:
        """Unless one is given, the published strategy of the paper that prints such parts."""
        layers, process = info.data.get("layers"), info.data.get("process")
        if "published" in resolve.model_fields_set or layers is None or process is None:
            return resolve
        if process.fibre is not None:
            return resolve.model_copy(update={"published": "along_path"})
        if isinstance(layers, FaceLayersSpec | AerofoilLayersSpec):
            return resolve.model_copy(update={"published": "fixed_heading"})
        return resolve

    @field_validator("program")
    @classmethod
    def _as_fine_as_its_beads(cls, program: ProgramSpec, info: ValidationInfo) -> ProgramSpec:
        """Unless the tolerance is given, lines of the program are off low beads by at most a share of their height."""
        process = info.data.get("process")
        if process is None or "chord" in program.model_fields_set:
            return program
        finest = CHORD_SHARE * process.bead.height
        return program.model_copy(update={"chord": finest}) if finest < program.chord else program

    def model_post_init(self, context: Any) -> None:
        """Keep the sources of the values, which come as the validation context."""
        self._source = context

    @property
    def file(self) -> Path:
        """The problem file, as the user gave it."""
        return self._source.file

    @property
    def sources(self) -> ValueSources:
        """Where each of its values came from."""
        return self._source

    @property
    def overrides(self) -> tuple[str, ...]:
        """The overrides applied to the file, as `dotted.key=value`."""
        return tuple(override.words for override in self._source.overrides)

    def changed(self, overrides: Sequence[str | Override]) -> Problem:
        """The problem read again, with further overrides after its own; raises InputError as `load_problem` does."""
        return load_problem(self.file, (*self._source.overrides, *overrides))

    def nozzle_of(self, material: str) -> NozzleSpec:
        """The nozzle that lays a material."""
        spec = self.process.materials.get(material)
        return self.cell.nozzle_named("" if spec is None else spec.nozzle or "")

    @property
    def from_arrays(self) -> bool:
        """Whether its waypoints are arrays from Python, not a file."""
        return isinstance(self.layers, WaypointLayersSpec) and not isinstance(self.layers.source.waypoints, Path)

    def error(self, field: str, reason: str, hint: str | None = None) -> InputError:
        """Return the error of a field, dotted as in the file (`cell.arm`), with its file and line, or its `--set`.

        Whole numbers in it are indices of list items, from 0.
        """
        path = tuple(int(key) if key.isdecimal() else key for key in field.split("."))
        return self._source.error(path, reason, hint)


def load_problem(path: str | Path, overrides: Sequence[str | Override] = ()) -> Problem:
    """Read a problem file, or a shipped problem by name, with `dotted.key=value` overrides applied before validation.

    Raises one InputError for all mistakes: the first by line, and how many more there are. The drawing that the problem
    names is not opened.
    """
    data, source = read_problem_file(find_problem(path))
    read = [parse_override(each) if isinstance(each, str) else each for each in overrides]
    data, source = apply_overrides(data, source, read)
    return _validated(data, source)


def parse_problem(text: str, file: Path) -> Problem:
    """Read a problem from its text, as if from a file, which need not exist yet; raises InputError."""

    def complain(reason: str, line: int | None, hint: str | None) -> InputError:
        return InputError(reason, file=file, line=line, hint=hint)

    lines: dict[Keys, int] = {}
    data = parse_yaml(text, complain, lines)
    return _validated(data, ValueSources(file, lines))


def _validated(data: dict[str, Any], source: ValueSources) -> Problem:
    try:
        problem = Problem.model_validate(data, context=source)
    except ValidationError as error:
        raise first_mistake(error.errors(include_url=False), source, Problem) from None
    check_materials(problem)
    check_board(problem)
    return problem
