"""What the fields of a section are, read off its model: key, meaning, unit, range, choices, default, sections within."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from planner.errors import InputError
from planner.problem.fields import Quantity
from planner.problem.file import parse_yaml

Model = type[BaseModel]


@dataclass(frozen=True)
class Described:
    """One field.

    key       as it stands in the file
    text      what it is; its unit in brackets, its default at the end
    shape     "value", "list" (of values or sections) or "names" (sections or values by names of the user's own)
    quantity  of a number, or a list of numbers; else None
    choices   of a word; else empty
    sections  the models that may stand there; none for a value
    types     what else may stand there: str, Path, bool, int
    """

    key: str
    text: str
    required: bool
    default: Any
    shape: str
    quantity: Quantity | None
    choices: tuple[str, ...]
    sections: tuple[Model, ...]
    types: tuple[type, ...]

    @property
    def unit(self) -> str:
        """Unit of a number in the file; empty where it has none."""
        return "" if self.quantity is None else self.quantity.unit

    def shown(self, value: Any) -> Any:
        """A validated value as it would stand in the file."""
        if self.quantity is None or value is None:
            return value
        if self.shape == "names":
            return {name: self.quantity.from_si(each) for name, each in value.items()}
        return self.quantity.from_si(value)


def described(model: Model) -> dict[str, Described]:
    """The fields of a section by their names in the code, in the order of the file."""
    return {name: _field(name, field) for name, field in model.model_fields.items()}


def _field(name: str, field: FieldInfo) -> Described:
    annotation = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
    parts = list(_parts(annotation, "value"))
    found = [part for _, part in parts if isinstance(part, type)]
    return Described(
        key=field.alias or name,
        text=field.description or "",
        required=field.is_required(),
        default=None if field.is_required() or field.default_factory is not None else field.default,
        shape=next((shape for shape, _ in parts if shape != "value"), "value"),
        quantity=next((part for _, part in parts if isinstance(part, Quantity)), None),
        choices=tuple(dict.fromkeys(part for _, part in parts if isinstance(part, str))),
        sections=tuple(part for part in found if issubclass(part, BaseModel)),
        types=tuple(part for part in found if not issubclass(part, BaseModel)),
    )


def _parts(annotation: Any, shape: str) -> Iterator[tuple[str, Any]]:
    """Quantities, models, other types and choices in an annotation, each with what it stands in."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        known = [mark for mark in inner[1:] if isinstance(mark, Quantity)]
        yield from ((shape, mark) for mark in known)
        if not known:
            yield from ((shape, word) for mark in inner[1:] for word in getattr(mark, "choices", ()))
            yield from _parts(inner[0], shape)
    elif origin in (Union, UnionType):
        for choice in inner:
            yield from _parts(choice, shape)
    elif origin is Literal:
        yield from ((shape, word) for word in inner)
    elif origin is tuple:
        yield "list", None
        for item in inner:
            yield from _parts(item, "list")
    elif origin is dict:
        yield "names", None
        yield from _parts(inner[1], "names")
    elif annotation not in (NoneType, Ellipsis):
        yield shape, annotation


def read_value(one: Described, text: str) -> Any:
    """A value of a field from a text as it would stand in the file; of a list of numbers the brackets may be missing.

    Raises ValueError, in words, for one that the field does not take.
    """
    lists = one.quantity is not None and one.quantity.count is not None
    if lists and not text.startswith("["):
        text = f"[{', '.join(text.replace(',', ' ').split())}]"
    try:
        value = parse_yaml(text, lambda reason, *_: InputError(reason), {})
        if one.quantity is not None:
            one.quantity.to_si(value)
    except InputError as error:
        raise ValueError(str(error)) from None
    except PydanticCustomError as error:
        hint = (error.context or {}).get("hint")
        raise ValueError(f"{error}" + (f" ({hint})" if hint else "")) from None
    if one.quantity is None and one.choices and value not in one.choices:
        raise ValueError(f"choices: {', '.join(one.choices)}")
    return list(value) if isinstance(value, tuple) else value
