"""What validation found wrong with a problem, told as one error with place, reason and hint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from planner.errors import InputError, nearest_name
from planner.problem_file import Keys, Source, describe

Mistake = tuple[Keys, str, str | None]  # path, reason, hint
Model = type[BaseModel]


def first_mistake(details: Sequence[ErrorDetails], source: Source, model: Model) -> InputError:
    """Turn Pydantic's findings about a `model` into one error: those of `--set` first, then by line."""
    unknown = [detail["loc"] for detail in details if detail["type"] == "extra_forbidden"]
    meant = {(*loc[:-1], nearest_name(str(loc[-1]), _keys(model, loc[:-1]))) for loc in unknown}
    # A misspelt key is one mistake, not also a missing one.
    real = [detail for detail in details if detail["type"] != "missing" or detail["loc"] not in meant]
    mistakes = [_mistake(detail, source, model) for detail in real]

    def place(mistake: Mistake) -> int:
        return 0 if source.override(mistake[0]) is not None else source.line(mistake[0]) or 0

    path, reason, hint = min(mistakes, key=place)
    more = len(mistakes) - 1
    if more:
        hint = f"{hint}; " if hint else ""
        hint += f"{more} more mistake{'s' if more > 1 else ''} in this problem"
    return source.error(path, reason, hint)


def _mistake(detail: ErrorDetails, source: Source, model: Model) -> Mistake:
    """Path, reason and hint of one of Pydantic's findings."""
    path, value = tuple(key for key in detail["loc"] if key != "[key]"), detail["input"]
    match detail["type"]:
        case "problem":
            context = detail["ctx"]
            if "item" in context:
                path = (*path, context["item"])
            if "fields" in context:
                path = _culprit(path, context["fields"], source)
            return path, context["reason"], context["hint"]
        case "missing":
            return path, "is missing", _description(model, path)
        case "extra_forbidden":
            keys = _keys(model, path[:-1])
            near = nearest_name(str(path[-1]), keys)
            return path, "unknown key", f"did you mean {near}?" if near else f"known keys: {', '.join(keys)}"
        case "model_type":
            return path, f"must be a section, not {describe(value)}", f"its keys: {', '.join(_keys(model, path))}"
        case "dict_type":
            return path, f"must be a section, not {describe(value)}", "its keys are names of axes or joints"
        case "tuple_type":
            return path, f"must be a list, not {describe(value)}", "for example [rotation]"
    return path, detail["msg"], None


def _culprit(section: Keys, fields: Sequence[str], source: Source) -> Keys:
    """Of fields that contradict each other, the one that came last; the section itself if none is there."""
    there = [path for path in ((*section, field) for field in fields) if path in source.lines or source.override(path)]
    return max(there, key=lambda path: (source.override(path) is not None, source.line(path) or 0), default=section)


def _section(model: Model, path: Keys) -> Model:
    """The model of the section at `path`; names that the user chose, such as joints, are passed over."""
    section = model
    for key in path:
        for name, field in section.model_fields.items():
            if key == (field.alias or name):
                kinds = (field.annotation, *get_args(field.annotation))
                section = next((k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)), section)
                break
    return section


def _keys(model: Model, path: Keys) -> list[str]:
    """The keys that a section may have."""
    return [field.alias or name for name, field in _section(model, path).model_fields.items()]


def _description(model: Model, path: Keys) -> str | None:
    """What the field at `path` is, in words."""
    fields = _section(model, path[:-1]).model_fields.values()
    return next((field.description for field in fields if field.alias == path[-1]), None)
