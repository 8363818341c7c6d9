"""The kinds of value in a problem file, and descriptions of a model's fields.

Millimetres and degrees become SI here and nowhere else. Each kind refuses values with a PydanticCustomError whose
context carries the hint, and in a list the index of the item.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from planner.base.errors import InputError, nearest_name
from planner.base.rapid_names import LONGEST_NAME, RAPID_WORDS
from planner.problem.yaml_file import ValueSources, describe, parse_yaml, shorten

LONGEST_TEXT = 1000  # characters, of a file's path or a name in words
Vector = tuple[float, float, float]

Model = type[BaseModel]
_TO_SI: dict[str, Callable[[float], float]] = {
    "mm": lambda value: value / 1000,
    "mm/s": lambda value: value / 1000,
    "mm/s2": lambda value: value / 1000,
    "mm/s3": lambda value: value / 1000,
    "deg": math.radians,
    "deg/s": math.radians,
    "rad/s2": float,
    "rad/s3": float,
    "s": float,
    "ms": lambda value: value / 1000,
    "°C": float,
    "": float,
}


def refusal(reason: str, hint: str | None = None, **context: Any) -> PydanticCustomError:
    """Return the error of a field: reason and hint for the user; `item` or `fields` say where within it."""
    return PydanticCustomError("problem", "{reason}", {"reason": reason, "hint": hint, **context})


class InMemory:
    """A value of a field that only Python can give, not a file; models take it as it is."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by class alone."""
        return core_schema.is_instance_schema(cls)


def _truth(value: Any) -> bool:
    if not isinstance(value, bool):
        raise refusal(f"must be true or false, not {describe(value)}", "without quotes")
    return value


Truth = Annotated[bool, BeforeValidator(_truth)]


@dataclass(frozen=True)
class Quantity:
    """Annotation of a number, or a list of `count` numbers, in `unit` within [low, high]; becomes SI.

    `count` is how many there are, or the least and the greatest number of them.
    `whole` numbers stay integers. Strings, booleans, NaN and infinity are refused.
    """

    unit: str
    low: float
    high: float
    count: int | tuple[int, int] | None = None
    whole: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by `to_si` alone."""
        return core_schema.no_info_plain_validator_function(self.to_si)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe the value as written in the file."""
        kind = "integer" if self.whole else "number"
        number: JsonSchemaValue = {"type": kind, "minimum": self.low, "maximum": self.high}
        if self.count is None:
            return number
        least, most = self._counts
        return {"type": "array", "items": number, "minItems": least, "maxItems": most}

    @property
    def _counts(self) -> tuple[int, int]:
        """The least and the greatest length of the list."""
        if isinstance(self.count, tuple):
            return self.count
        return (0, 0) if self.count is None else (self.count, self.count)

    @property
    def valid(self) -> str:
        """The valid range in words."""
        each = "" if self.count is None else "each "
        return f"valid: {each}{_figure(self.low)} to {_figure(self.high)} {self.unit}".rstrip()

    @property
    def words(self) -> str:
        """What is accepted, without its unit."""
        span = f"{_figure(self.low)} to {_figure(self.high)}" + (", whole" if self.whole else "")
        least, most = self._counts
        if self.count is None:
            return span
        return f"{least if least == most else f'{least} to {most}'} numbers, each {span}"

    def to_si(self, value: Any) -> Any:
        """Return the value (or the tuple of them) in SI units; raises a refusal for anything else."""
        if self.count is None:
            return self._number(value, {}, "")
        least, most = self._counts
        asked = f"{least}" if least == most else f"{least} to {most}"
        if not isinstance(value, tuple):
            raise refusal(f"must be a list of {asked} numbers, not {describe(value)}", self.valid)
        if not least <= len(value) <= most:
            raise refusal(f"must be a list of {asked} numbers, not of {len(value)}", self.valid)
        return tuple(self._number(v, {"item": i}, f"number {i + 1} ") for i, v in enumerate(value))

    def from_si(self, value: Any) -> Any:
        """Return a value in SI units, or a tuple of them, as written in the file."""
        if isinstance(value, tuple):
            return tuple(self.from_si(each) for each in value)
        return value if self.whole else value / _TO_SI[self.unit](1.0)

    def _number(self, value: Any, where: dict[str, int], name: str) -> float:
        if type(value) not in (int, float):
            hint = f"{self.valid}, without quotes" if isinstance(value, str) else self.valid
            raise refusal(f"{name}must be a number, not {describe(value)}", hint, **where)
        if not abs(value) < math.inf:
            raise refusal(f"{name}must be a finite number, not {describe(value)}", self.valid, **where)
        if self.whole and type(value) is not int:
            raise refusal(f"{name}must be a whole number, not {value}", self.valid, **where)
        if not self.low <= value <= self.high:
            side = "small" if value < self.low else "large"
            raise refusal(f"{name}{describe(value)} {self.unit}".rstrip() + f" is too {side}", self.valid, **where)
        return value if self.whole else _TO_SI[self.unit](value)


def _figure(value: float) -> str:
    return f"{value:.0f}" if value == round(value) else f"{value:g}"


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise refusal(f"must be a name, not {describe(value)}", "quote it if it is text")
    if not value.strip() or not value.isprintable() or len(value) > LONGEST_TEXT:
        raise refusal(f"must be a name, not {describe(value)}")
    return value


def identifier(value: Any) -> str:
    """A name that controllers accept, too. Raises PydanticCustomError for any other value."""
    text = _text(value)
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", text) or len(text) > LONGEST_NAME:
        reason = f"{shorten(text)!r} cannot be a name in RAPID"
        raise refusal(reason, f"a letter, then letters, digits or _, at most {LONGEST_NAME} characters in all")
    if text.lower() in RAPID_WORDS:
        raise refusal(f"{text!r} is a reserved word of RAPID", f"for example my_{text}"[:LONGEST_NAME])
    return text


def identifier_like(text: str, ending: str = "") -> str:
    """An identifier as close to a text as possible, with `ending` at its end."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")
    taken = RAPID_WORDS | {"null"}  # which YAML reads as no value
    usable = name[:1].isalpha() and (name + ending).lower() not in taken
    return (name if usable else f"print_{name}")[: LONGEST_NAME - len(ending)].rstrip("_") + ending


def _beside_the_problem(value: Any, info: ValidationInfo) -> Path:
    """A path in a problem file, which is relative to the folder of that file."""
    source = cast(ValueSources, info.context)
    return source.file.parent / _text(value)


def _file_or_arrays(value: Any, info: ValidationInfo) -> Any:
    return value if isinstance(value, InMemory) else _beside_the_problem(value, info)


def _robot(value: Any, info: ValidationInfo) -> str | Path:
    """A shipped robot, by its name, or the user's own, by its file."""
    text = _text(value)
    return _beside_the_problem(text, info) if text.endswith((".yaml", ".yml")) else text


@dataclass(frozen=True)
class Form(BeforeValidator):
    """A check of a string, and the same for editors: `schema` is added to the field's JSON schema."""

    schema: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def choices(self) -> tuple[str, ...]:
        """The words allowed there; empty if any are."""
        return tuple(self.schema.get("enum", ()))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe the string as written in the file."""
        return {**handler(schema), **self.schema}


def one_of(names: Sequence[str]) -> Form:
    """Accept only one of the names, and otherwise suggest the nearest."""

    def check(value: Any) -> str:
        if isinstance(value, str) and value in names:
            return value
        choices = f"choices: {', '.join(names)}"
        if not isinstance(value, str):
            raise refusal(f"must be a name, not {describe(value)}", choices)
        near = nearest_name(value, names)
        raise refusal(f"unknown name {shorten(value)!r}", f"did you mean {near}? {choices}" if near else choices)

    return Form(check, schema={"enum": list(names)})


def exactly_one(*keys: str, and_of: tuple[str, ...] = ()) -> ConfigDict:
    """The configuration by which a section's JSON schema asks for exactly one of some keys, and one of others.

    Its validators refuse anything else, with a message.
    """
    first, *more = ({"oneOf": [{"required": [name]} for name in group]} for group in (keys, and_of) if group)
    return ConfigDict(json_schema_extra=cast(Any, first | ({"allOf": more} if more else {})))


def _unique(names: tuple[str, ...]) -> tuple[str, ...]:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise refusal(f"{name!r} appears twice in the list", "name each once", item=i)
    return names


def _increasing(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise refusal("the first number must be less than the second", "for example [-180, 180]")
    return pair


def _unit_vector(vector: tuple[float, ...]) -> tuple[float, ...]:
    length = math.hypot(*vector)
    if length < 1e-6:
        raise refusal("must not be the zero vector", "three numbers, not all of them 0")
    return tuple(value / length for value in vector)


TEXT = Form(_text, schema={"minLength": 1, "maxLength": LONGEST_TEXT})
IDENTIFIER = Form(identifier, schema={"pattern": f"^[A-Za-z][A-Za-z0-9_]{{0,{LONGEST_NAME - 1}}}$"})
PATH = BeforeValidator(_beside_the_problem)
PATH_OR_ARRAYS = BeforeValidator(_file_or_arrays)
ROBOT = BeforeValidator(_robot)
UNIQUE = AfterValidator(_unique)
INCREASING = AfterValidator(_increasing)
UNIT_VECTOR = AfterValidator(_unit_vector)
Position = Annotated[Vector, Quantity("mm", -100_000, 100_000, count=3)]  # a hall of 100 m
Angles = Annotated[Vector, Quantity("deg", -360, 360, count=3)]
Thickness = Annotated[float, Quantity("mm", 0.01, 50)]  # from a fibre to large concrete beads
FILAMENTS_MM = (0.1, 500)  # from a thin fibre to the bore of a ram
FilamentDiameter = Annotated[float, Quantity("mm", *FILAMENTS_MM)]


def key(alias: str, text: str, default: Any = ...) -> Any:
    """A field with its key in the file; `default` is in the file's unit and goes through the same validation."""
    if default is ...:
        return Field(alias=alias, description=text)
    return Field(default, alias=alias, description=f"{text}; default {default}" if default or default == 0 else text)


class Section(BaseModel):
    """A section of the problem file: frozen, without unknown keys."""

    # The whole problem's schema is built once, with the first problem. Built with each class, schemas of sections
    # within sections would be built several times, and every command would take a tenth of a second longer.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, validate_default=True, defer_build=True)


@dataclass(frozen=True)
class Described:
    """One field.

    key       as in the file
    text      its description, with the unit in brackets and the default at the end
    shape     "value", "list" (of values or sections) or "names" (sections or values by names that the user chooses)
    quantity  of a number, or a list of numbers; else None
    choices   of a word; else empty
    sections  the models allowed there; empty for a value
    types     other types allowed there: str, Path, bool, int
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
        """Unit of a number in the file; empty if it has none."""
        return "" if self.quantity is None else self.quantity.unit

    def shown(self, value: Any) -> Any:
        """A validated value as written in the file."""
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
    """Quantities, models, other types and choices in an annotation, each with the shape that it is in."""
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
    elif annotation not in (NoneType, Ellipsis) and not _only_in_memory(annotation):
        yield shape, annotation


def _only_in_memory(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, InMemory)


def in_words(error: PydanticCustomError) -> str:
    """A refusal with its hint."""
    hint = (error.context or {}).get("hint")
    return f"{error}" + (f" ({hint})" if hint else "")


def read_value(one: Described, text: str) -> Any:
    """A field's value from a text as in the file; a list of numbers may lack its brackets.

    Raises ValueError, in words, for a value that the field does not accept.
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
        raise ValueError(in_words(error)) from None
    if one.quantity is None and one.choices and value not in one.choices:
        raise ValueError(f"choices: {', '.join(one.choices)}")
    return list(value) if isinstance(value, tuple) else value
