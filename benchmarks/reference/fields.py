"""docs/reference/problem_file.md and robot_file.md: every key of both files, read off the models that read them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.reference.examples import EXAMPLES
from benchmarks.reference.markdown import table
from benchmarks.reference.schema import TOLD_BY
from planner.cell.robot_file import KEYS
from planner.problem import Problem, find_problem, shipped_problems
from planner.problem.fields import Described, Model, Section, described
from planner.problem.layers import KINDS
from planner.problem.yaml_file import read_problem_file, yaml_text

LONGEST_EXAMPLE = 70  # characters
_HEAD = """\
# The problem file

*Made by `python -m benchmarks.reference` from the models that read the file; do not edit.*

A problem is one YAML file. Lengths are millimetres, angles degrees, times seconds and temperatures degrees Celsius, \
as the names of the keys say. Files that it names are counted from its own folder. A key that is not known is \
refused, with the nearest known one. `python -m planner.check my_part.yaml` reads a file without planning it.

An editor that knows JSON schemas completes and checks the file while it is written: the first line of a problem in \
`problems/` names [problem.schema.json](../problem.schema.json).

A key without a default must be there. `NAME` stands for a name of your own.
"""
_ROBOT_HEAD = """\
# The robot file

*Made by `python -m benchmarks.reference`; do not edit.*

What a URDF cannot say of a robot stands in a YAML file: `robots/<name>.yaml` of those that ship, or a file of your \
own, which the problem names in `cell.arm`, `cell.base.robot` or `cell.positioner.robot`. [A robot of your own](../own_robot.md) shows \
all of it; `python -m planner.robots my_robot.yaml` tells what was read. [robot.schema.json](../robot.schema.json) \
is its JSON schema.
"""


def problem_page() -> str:
    """The page of the problem file."""
    found = dict(sections())
    examples = shipped_examples()
    parts = [_HEAD]
    for model, places in found.items():
        fields = sorted(described(model).values(), key=lambda one: not one.required)  # what must be there comes first
        rows = [_row(model, one, examples) for one in fields]
        parts.append(f"## {_title(model, places)}\n\n{_about(model, places)}\n\n{table(HEADINGS, rows)}")
    return "\n".join(parts)


def robot_page() -> str:
    """The page of robots' files."""
    rows = [[f"`{name}`", one.text, one.default, f"`{one.example}`"] for name, one in KEYS.items()]
    return f"{_ROBOT_HEAD}\n{table(('key', 'meaning', 'default', 'example'), rows)}"


_EACH_HAS_ONE = re.compile("; each (of its keys )?has a default$")  # which the column of defaults says
WORDS = {str: "name", Path: "file", bool: "true or false", int: "number"}
HEADINGS = ("key", "meaning", "values and unit", "default", "example")


def sections() -> list[tuple[Model, list[str]]]:
    """Every section with the places where it may stand, dotted, in the order of the file."""
    found: dict[Model, list[str]] = {}

    def walk(model: Model, where: str) -> None:
        known = model in found
        found.setdefault(model, []).append(where)
        if known:
            return
        for one in described(model).values():
            here = f"{where}.{one.key}" if where else one.key
            here += {"names": ".NAME", "list": "[]"}.get(one.shape, "")
            for inner in one.sections:
                walk(inner, here)

    walk(Problem, "")
    return list(found.items())


def shipped_examples() -> dict[tuple[Model, str], str]:
    """The shortest value that a shipped problem gives to a key, as it would stand in one line of the file."""
    found: dict[tuple[Model, str], str] = {}

    def walk(model: Model, data: Mapping[str, Any], spec: Any) -> None:
        for name, one in described(model).items():
            if one.key not in data:
                continue
            text = yaml_text(data[one.key])
            if len(text) <= LONGEST_EXAMPLE and len(text) < len(found.get((model, one.key), text + " ")):
                found[model, one.key] = text
            for inner, value in _within(data[one.key], getattr(spec, name)):
                walk(type(value), inner, value)

    for name in shipped_problems():
        file = find_problem(name)
        data, source = read_problem_file(file)
        walk(Problem, data, Problem.model_validate(data, context=source))
    return found


def _within(data: Any, spec: Any) -> Iterator[tuple[Mapping[str, Any], Section]]:
    """The sections in a value, each with its part of the file."""
    if isinstance(spec, Section):
        yield data, spec
    elif isinstance(spec, dict) and isinstance(data, dict):
        for name, each in spec.items():
            yield from _within(data[name], each)
    elif isinstance(spec, tuple) and isinstance(data, tuple):
        for one, each in zip(data, spec, strict=False):
            yield from _within(one, each)


def _title(model: Model, places: list[str]) -> str:
    kind = next((kind for kind in KINDS if kind.model is model), None)
    if kind is not None:
        told = f", and `{TOLD_BY[kind.tag]}`" if kind.tag in TOLD_BY else ""
        return f"`layers` with `source.{'`, `source.'.join(kind.names)}`{told}"
    names = [name for kind in KINDS if kind.model.model_fields["source"].annotation is model for name in kind.names]
    if names:
        return f"`layers.source` with `{'` or `'.join(dict.fromkeys(names))}`"
    return f"`{places[0]}`" if places[0] else "The whole file"


def _about(model: Model, places: list[str]) -> str:
    text = (model.__doc__ or "").strip().partition("\n\n")[0]
    if others := [f"`{place}`" for place in dict.fromkeys(places) if place != places[0]]:
        text += f" Likewise: {', '.join(others)}."
    extra: Any = model.model_config.get("json_schema_extra") or {}
    for choices in (extra, *extra.get("allOf", ())):
        if names := [f"`{each['required'][0]}`" for each in choices.get("oneOf", ())]:
            text += f" Exactly one of {', '.join(names)} is given."
    return text


def _row(model: Model, one: Described, examples: Mapping[tuple[Model, str], str]) -> list[str]:
    text, default = meaning(one)
    example = examples.get((model, one.key)) or example_of(model, one.key)
    return [f"`{one.key}`", text, values(one), default, f"`{example}`"]


def example_of(model: Model, key: str) -> str:
    """An example of a key that no shipped problem has, or only at length: the model's own, or that of any section."""
    return EXAMPLES.get(f"{model.__name__}.{key}") or EXAMPLES[key]


def meaning(one: Described) -> tuple[str, str]:
    """What a key is, without unit and default, and its default in words; empty where it must be there."""
    given = _EACH_HAS_ONE.sub("", one.text)
    each = "; each default" in given
    text, _, default = given.partition("; each default" if each else "; default")
    default = ("each " if each else "") + default.removeprefix(":").strip()
    text = text.replace(f" [{one.unit}]", "") if one.unit else text
    if not one.required and not default:
        default = "each of its own"
    if isinstance(one.default, (tuple, list)) and one.default:
        default = yaml_text(tuple(one.default))
    return text.strip(), default


def values(one: Described) -> str:
    """What may stand there, in words."""
    if one.quantity is not None:
        span = f"{one.quantity.words} {one.unit}".rstrip()
        return f"by name: {span}" if one.shape == "names" else span
    if one.choices and int in one.types:
        return f"{', '.join(f'`{word}`' for word in one.choices)}, or a list: name or number"
    if one.choices:
        words = ", ".join(f"`{word}`" for word in one.choices)
        return f"list of {words}" if one.shape == "list" else words
    kind = "section" if one.sections else " or ".join(dict.fromkeys(WORDS[each] for each in one.types))
    return {"list": "list: {}", "names": "by name: {}", "value": "{}"}[one.shape].format(kind)
