"""Change values in a problem or robot file and keep every other character, for another folder if need be."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode

from planner.base.errors import InputError, OutputError
from planner.base.files import write_new
from planner.problem.overrides import with_paths
from planner.problem.problem import Problem
from planner.problem.yaml_file import Keys, Override, parse_yaml

Value = float | list[float] | list[str] | str | dict[str, float]


def write_changed(problem: Problem, changes: Mapping[str, Value], target: Path) -> None:
    """Write a problem's file into a new file, with fields (dotted, as in the file) set to values in the file's units.

    Comments and layout stay; paths of other files are changed so that they still lead there. Values from `--set` are
    not written. Raises OutputError if the file exists already, or cannot be written.
    """
    text = changed_text(problem, changes, target.parent)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_new(target, text)
    except FileExistsError:
        raise OutputError(f"{target} is there already, and stays as it is: choose another name") from None
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error


def changed_text(problem: Problem, changes: Mapping[str, Value], folder: Path) -> str:
    """The text of a problem's file for a folder, with fields set to values (see `write_changed`)."""
    try:
        with problem.file.open(encoding="utf-8-sig", newline="") as stream:
            text = stream.read()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("cannot be read any more", file=problem.file) from error
    here, there = problem.file.parent.resolve(), folder.resolve()
    if here != there:
        for keys, path in paths_in(problem):
            node = _node(_root(text), keys)
            if node is not None and not isinstance(node, (MappingNode, SequenceNode)):
                given = Path(str(node.value))
                if not given.is_absolute() and problem.file.parent / given == path:  # not one that --set gave
                    text = _with(text, keys, Path(os.path.relpath(path.resolve(), there)).as_posix())
    return with_values(text, changes)


def with_values(text: str, changes: Mapping[str, Value]) -> str:
    """The text of a YAML mapping with fields (dotted) set to values, all else unchanged; new fields come first."""
    for field, value in changes.items():
        text = _with(text, tuple(field.split(".")), value)
    return text


def without(text: str, fields: Iterable[str]) -> str:
    """The text of a YAML mapping without some of its fields (dotted); comments above other fields stay.

    A section that would be empty is removed as a whole.
    """
    for field in fields:
        keys = tuple(field.split("."))
        root = _root(text)
        if _node(root, keys) is None:
            continue
        while len(keys) > 1 and len(_node(root, keys[:-1]).value) == 1:  # type: ignore[union-attr]
            keys = keys[:-1]
        section = _node(root, keys[:-1])
        if isinstance(section, MappingNode):
            text = _without(text, section, [name.value for name, _ in section.value].index(keys[-1]))
    return text


def _without(text: str, section: MappingNode, k: int) -> str:
    """The text without the k-th entry of a section."""
    pairs = section.value
    first, last = pairs[k][0].start_mark.index, pairs[k][1].end_mark.index
    if section.flow_style:
        if k + 1 < len(pairs):
            return text[:first] + text[pairs[k + 1][0].start_mark.index :]
        return text[: pairs[k - 1][1].end_mark.index if k else first] + text[last:]
    first = text.rfind("\n", 0, first) + 1
    end = pairs[k + 1][0].start_mark.index if k + 1 < len(pairs) else text.find("\n", last - 1)
    last = len(text) if end < 0 else text.rfind("\n", 0, end + 1) + 1
    lines = text[first:last].splitlines(keepends=True)
    while len(lines) > 1 and (not lines[-1].strip() or lines[-1].lstrip().startswith("#")):
        last -= len(lines.pop())
    return text[:first] + text[last:]


def absolute_overrides(problem: Problem) -> tuple[Override, ...]:
    """A problem's overrides, with absolute paths, so that they mean the same for a file in another folder."""
    paths = {keys: path.resolve() for keys, path in paths_in(problem)}
    return tuple(with_paths(override, paths) for override in problem.sources.overrides)


def paths_in(value: Any, keys: Keys = ()) -> Iterator[tuple[Keys, Path]]:
    """Every path in a problem, or a section of it, with the keys that lead to it in the file."""
    if isinstance(value, Path):
        yield keys, value
    elif isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield from paths_in(getattr(value, name), (*keys, field.alias or name))
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from paths_in(inner, (*keys, name))
    elif isinstance(value, tuple):
        for i, inner in enumerate(value):
            yield from paths_in(inner, (*keys, i))


def _root(text: str) -> Node:
    root: Node = YAML(typ="safe", pure=True).compose(text)
    return root


def _node(node: Node | None, keys: Keys) -> Node | None:
    """The node that keys lead to; None if there is none."""
    for key in keys:
        if isinstance(node, MappingNode):
            node = next((value for name, value in node.value if name.value == key), None)
        elif isinstance(node, SequenceNode) and isinstance(key, int) and key < len(node.value):
            node = node.value[key]
        else:
            return None
    return node


def _with(text: str, keys: Keys, value: Value) -> str:
    """The text with the value at some keys replaced, or inserted first into the section where it belongs."""
    root = _root(text)
    section, node = _node(root, keys[:-1]), _node(root, keys)
    if node is not None:
        first, last = node.start_mark.index, node.end_mark.index
        old = text[first:last]  # a list on lines of its own ends where the next key begins
        after = old[len(old.rstrip()) :] + text[last:]
        if isinstance(section, MappingNode):
            name = next(name for name, value in section.value if value is node)
            between = text[name.end_mark.index : first]
            if "\n" in between:  # it starts below its key, where a list in brackets cannot
                comment = between[: between.index("\n")].removeprefix(":").rstrip()
                return f"{text[: name.end_mark.index]}: {_written(value)}{comment}{after}"
        return text[:first] + _written(value) + after
    if not isinstance(section, MappingNode) or not section.value:
        raise OutputError(f"{'.'.join(str(key) for key in keys[:-1])} has no lines of its own in the problem file")
    before = section.value[0][0].start_mark
    entry = f"{keys[-1]}: {_written(value)}"
    glue = ", " if section.flow_style else "\n" + " " * before.column
    return text[: before.index] + entry + glue + text[before.index :]


def _written(value: Value) -> str:
    """A value as written in a file."""
    if isinstance(value, list):
        return f"[{', '.join(_written(each) for each in value)}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}: {_written(each)}' for name, each in value.items())}}}"
    if isinstance(value, float):
        return f"{value:.6f}".rstrip("0").rstrip(".")

    def complain(reason: str, line: int | None, hint: str | None) -> InputError:
        return InputError(reason)

    plain = (
        all(c.isalnum() or c in "_./-" for c in value)
        and value[:1] not in "-"
        and parse_yaml(value, complain, {}) == value
    )
    return value if plain else "'" + value.replace("'", "''") + "'"
