"""What validation found wrong with a problem, told as one error with place, reason and hint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, Tag
from pydantic_core import ErrorDetails

from planner.errors import InputError, nearest_name
from planner.problem.file import Keys, Source, describe
from planner.problem.layers import KINDS

Mistake = tuple[Keys, str, str | None]  # path, reason, hint
Model = type[BaseModel]
_NOT_IN_THE_FILE = (
    "[key]",
    *(kind.tag for kind in KINDS),
)  # Pydantic's marks in a path: of a key, of a kind of section


def first_mistake(details: Sequence[ErrorDetails], source: Source, model: Model) -> InputError:
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


def _mistake(detail: ErrorDetails, source: Source, model: Model) -> Mistake:
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


def _culprit(section: Keys, fields: Sequence[str], source: Source) -> Keys:
    """Of fields that contradict each other, the one that came last; the section itself if none is there."""
    there = [path for path in ((*section, field) for field in fields) if path in source.lines or source.override(path)]
    return max(there, key=lambda path: (source.override(path) is not None, source.line(path) or 0), default=section)


def _section(model: Model, path: Keys) -> Model:
    """The model of the section at `path`; names that the user chose, such as joints, are passed over."""
    section = model
    for i, key in enumerate(path):
        for name, field in section.model_fields.items():
            if key == (field.alias or name):
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
        elif choice is not annotation and get_origin(choice) is dict:  # sections by names of the user's, or none
            found.update(_models(choice))
    return found


def _keys(model: Model, path: Keys) -> list[str]:
    """The keys that a section may have."""
    return [field.alias or name for name, field in _section(model, path).model_fields.items()]


def _description(model: Model, path: Keys) -> str | None:
    """What the field at `path` is, in words."""
    fields = _section(model, path[:-1]).model_fields.values()
    return next((field.description for field in fields if field.alias == path[-1]), None)
