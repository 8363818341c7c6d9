"""The content of a problem at one time: its fields, the files that it names, and what changed between two saves."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from planner.base.errors import InputError, PlannerError
from planner.cell.robot_file import read_robot_file
from planner.problem import Problem, load_problem
from planner.problem.yaml_file import read_problem_file, shorten

LONGEST_TEXT = 60  # characters of a value shown
MOST_MISTAKES = 20  # shown below the first
MISSING = "missing"
Signature = tuple[int, int, int]  # time of the last change [ns], size [bytes], inode: editors save by renaming


@dataclass(frozen=True)
class Content:
    """Everything that determines a plan, at one time.

    fields  (dotted key, value as text), in the order of the file
    files   (path, digest of the content) of the files that it names
    """

    fields: tuple[tuple[str, str], ...]
    files: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Mistake:
    """Why there is nothing to solve, and where; `excerpt`: that line of the file, `more`: further mistakes."""

    text: str
    file: str = ""
    line: int | None = None
    field: str = ""
    hint: str = ""
    excerpt: str = ""
    more: tuple[str, ...] = ()


def mistake_of(error: PlannerError) -> Mistake:
    """An error as the page shows it, with the line that it names."""
    if not isinstance(error, InputError):
        return Mistake(str(error))
    first, *others = error.all or (error,)
    file = "" if first.file is None else str(first.file)
    return Mistake(
        first.reason,
        file,
        first.line,
        first.field or "",
        first.hint or "",
        _excerpt(file, first.line),
        tuple(_in_short(other) for other in others[:MOST_MISTAKES]),
    )


def _in_short(error: InputError) -> str:
    """An error without its file, which is that of the first one."""
    place = "" if error.line is None else f"line {error.line}: "
    field = "" if error.field is None else f"{error.field}: "
    return place + field + error.reason + ("" if error.hint is None else f" ({error.hint})")


def _excerpt(file: str, line: int | None) -> str:
    if line is None or not os.path.isfile(file):
        return ""
    with open(file, encoding="utf-8", errors="replace") as stream:
        text = next((text for number, text in enumerate(stream, 1) if number == line), "")
    return shorten(text.rstrip(), 160)


def read_content(path: Path, overrides: Sequence[str]) -> tuple[Content, tuple[Path, ...]]:
    """The content of a problem file, and the files that it names. Raises InputError for whatever is wrong with it."""
    if not path.is_file():
        reason = "is gone" if path.parent.is_dir() else "is gone, and so is its folder"
        raise InputError(reason, file=path, hint="the view resumes as soon as it is back")
    data, _ = read_problem_file(path)
    named = tuple(dict.fromkeys(_with_urdf(load_problem(path, overrides))))
    return Content(tuple(flattened(data)), tuple((str(file), _digest(file)) for file in named)), named


def signatures(paths: Iterable[Path]) -> dict[Path, Signature | None]:
    """Signature of each file; None if there is none, or if it cannot be examined."""
    found: dict[Path, Signature | None] = {}
    for path in paths:
        try:
            status = path.stat()
        except OSError:
            found[path] = None
        else:
            found[path] = (status.st_mtime_ns, status.st_size, status.st_ino)
    return found


def changes(before: Content, after: Content) -> tuple[str, ...]:
    """The differences, each in words: `process.speed_mm_s: 5 → 10`."""
    old, new = dict(before.fields), dict(after.fields)
    said = [
        f"{key}: {_short(old[key])} → {_short(new[key])}" if key in old else f"{key}: {_short(new[key])} added"
        for key in new
        if old.get(key) != new[key]
    ]
    said += [f"{key}: {_short(old[key])} removed" for key in old if key not in new]
    known = dict(before.files)
    said += [f"{Path(file).name} changed" for file, digest in after.files if known.get(file, digest) != digest]
    return tuple(said)


def flattened(value: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """(dotted key, text) of everything in nested mappings; a list of plain values becomes one text."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from flattened(inner, f"{prefix}.{key}" if prefix else str(key))
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        for i, inner in enumerate(value):
            yield from flattened(inner, f"{prefix}[{i}]")
    else:
        yield prefix, _text(value)


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_text(item) for item in value)}]"
    if isinstance(value, Mapping):
        return "{}"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _short(text: str) -> str:
    return shorten(text, LONGEST_TEXT)


def _with_urdf(problem: Problem) -> Iterator[Path]:
    """Files that a problem names, and those named in the files of the user's own robots."""
    yield from _paths(problem)
    others = [spec.robot for spec in (problem.cell.carrier, problem.cell.positioner) if spec is not None]
    for robot in (problem.cell.arm, *others):
        if isinstance(robot, Path) and robot.is_file():
            try:
                urdf = read_robot_file(robot).data.get("urdf")
            except InputError:
                continue  # the solver reports it, with its line
            if isinstance(urdf, str):
                yield robot.parent / urdf


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, Path):
        yield value
    elif isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from _paths(getattr(value, name))
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _paths(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _paths(inner)


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return MISSING  # the solver reports it, with the field that names it
