"""Problem and robot files as text: a small, safe part of YAML 1.2, with the line of every value.

Values are read from the parser's events, so that nothing is built before it has been checked: no tags, no anchors
(hence no alias bombs), no second document, no duplicate keys, no deep nesting. Composed nodes would not do: they no
longer distinguish explicit tags such as !!str from resolved ones. Scalars follow the core schema (YAML 1.2.2, 10.3.2).
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

from planner.base.budgets import YAML_BYTES, YAML_DEPTH, YAML_VALUES
from planner.base.errors import InputError, nearest_name
from planner.base.shipped import PROBLEMS

_PLAIN = re.compile(r"[A-Za-z_./-][A-Za-z0-9_./ -]*")
_QUOTED_WORDS = {"true", "false", "null", "yes", "no", "on", "off"}

LARGEST_FILE, MOST_VALUES, DEEPEST_NESTING = YAML_BYTES.most, YAML_VALUES.most, YAML_DEPTH.most
LONGEST_NUMBER = 300  # digits; a longer integer is read as a float, that is, as infinite
Keys = tuple[str | int, ...]
Complaint = Callable[[str, int | None, str | None], InputError]  # reason, line, hint → the error with its place
_INTEGER = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS = dict.fromkeys(("", "~", "null", "Null", "NULL")) | {
    word: word.lower() == "true" for word in ("true", "True", "TRUE", "false", "False", "FALSE")
}


def yaml_text(value: Any) -> str:
    """A value as one line of YAML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {yaml_text(each)}" for key, each in value.items()) + "}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(yaml_text, value)) + "]"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, (str, Path)):
        text = str(value)
        plain = _PLAIN.fullmatch(text) and text.lower() not in _QUOTED_WORDS and not text.endswith(" ")
        return text if plain else "'" + text.replace("'", "''") + "'"
    return str(value)


@dataclass(frozen=True)
class Override:
    """A value set in addition to the file.

    path   its keys
    value  plain, as YAML gives it, or a value that only Python can give
    label  what an error calls it: `--set process.speed_mm_s`
    words  the override as written after `--set`
    """

    path: Keys
    value: Any
    label: str
    words: str


@dataclass(frozen=True)
class ValueSources:
    """Where each value of a problem came from.

    file        as the user gave it
    lines       path of keys → line (from 1); the empty path is where the document starts
    overrides   values set in addition, in that order
    sha256      of the file's content; empty if the problem did not come from a file
    """

    file: Path
    lines: dict[Keys, int]
    overrides: tuple[Override, ...] = ()
    sha256: str = ""

    def error(self, path: Keys, reason: str, hint: str | None = None) -> InputError:
        """Return the InputError for the field at `path`, naming its file and line, or the `--set` it came from."""
        field = dotted(path)
        override = self.override(path)
        if override is None:
            return InputError(reason, file=self.file, line=self.line(path), field=field or None, hint=hint)
        inside = f": {field}" if len(path) > len(override.path) and field != dotted(override.path) else ""
        return InputError(reason, field=f"{override.label}{inside}", hint=hint)

    def line(self, path: Keys) -> int | None:
        """Line of the field at `path`, or of the nearest section around it that the file has."""
        around = (path[:n] for n in range(len(path), -1, -1))
        return next((self.lines[keys] for keys in around if keys in self.lines), None)

    def override(self, path: Keys) -> Override | None:
        """Return the override that the value at `path` came from, the last one if several; None if from the file."""
        for override in reversed(self.overrides):
            if path[: len(override.path)] == override.path:
                return override
            if path and path not in self.lines and override.path[: len(path)] == path:  # a section made by it
                return override
        return None


def shipped_problems() -> list[str]:
    """Names of the problems that ship."""
    return sorted(path.stem for path in PROBLEMS.glob("*.yaml"))


def find_problem(name_or_path: str | Path) -> Path:
    """Return the problem file meant by a path, or by the name of a shipped one with or without `.yaml`.

    Raises InputError, with the nearest shipped name, if there is none. A file wins over a shipped name, and a shipped
    name over a folder (such as the results of that very problem).
    """
    given = Path(name_or_path)
    name = given.name.removesuffix(".yaml")
    names = shipped_problems()
    # os.path, not Path: a name that no file can have simply does not exist.
    if os.path.exists(given) and not os.path.isdir(given):
        return given
    if str(given) == given.name and name in names:
        return PROBLEMS / f"{name}.yaml"
    if os.path.isdir(given):
        raise InputError("is a folder, not a problem file", file=given, hint="give the .yaml file in it")
    near = nearest_name(name, names)
    raise InputError(
        "there is no such problem file",
        file=shorten(str(given), 200),
        hint=f"did you mean {near}?"
        if near
        else f"looked in {Path.cwd()} and {PROBLEMS}, which has {', '.join(names)}",
    )


def read_problem_file(file: Path) -> tuple[dict[str, Any], ValueSources]:
    """Read a problem file into plain dicts, tuples, strings, numbers, booleans and None; raises InputError."""
    return read_yaml_file(file, "a problem starts with `name:`; see problems/cylinder_logo.yaml")


def read_yaml_file(file: Path, empty: str) -> tuple[dict[str, Any], ValueSources]:
    """Read a YAML file of `key: value` lines into plain values; raises InputError, with the hint `empty` if it is."""

    def complain(reason: str, line: int | None = None, hint: str | None = None) -> InputError:
        return InputError(reason, file=file, line=line, hint=hint)

    try:
        if not stat.S_ISREG(file.stat().st_mode):
            raise complain("is not a regular file", hint="give a .yaml file")
        with file.open("rb") as stream:
            raw = stream.read(LARGEST_FILE + 1)
    except OSError as error:
        raise complain(f"cannot be read: {error.strerror}") from error
    if len(raw) > LARGEST_FILE:
        raise complain("is larger than 1 MB, which no file of settings is", hint="curves belong in files of their own")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise complain("is not UTF-8 text", line, "save it as UTF-8") from error
    lines: dict[Keys, int] = {}
    data = parse_yaml(text, complain, lines)
    if data is None:
        raise complain("is empty", hint=empty)
    if not isinstance(data, dict):
        raise complain(f"must be `key: value` lines at the top, not {describe(data)}", lines[()])
    return data, ValueSources(file, lines, sha256=hashlib.sha256(raw).hexdigest())


def parse_yaml(text: str, complain: Complaint, lines: dict[Keys, int]) -> Any:
    """Return the value of a YAML text, filling `lines` with the line of every key and item.

    An empty text gives None. Raises the error of `complain` for anything but plain YAML.
    """
    try:
        events = _plain_events(text, complain)
        first = next(events, None)
        if first is None:
            return None
        lines[()] = first.start_mark.line + 1
        value = _value(first, events, (), lines, complain)
        if (second := next(events, None)) is not None:
            line = second.start_mark.line + 1
            raise complain("has a second document", line, "one document per file: remove the `---` line")
        return value
    except MarkedYAMLError as error:
        raise _not_yaml(error, complain) from error
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        column = error.position - text.rfind("\n", 0, error.position)
        raise complain(f"is not text at column {column}: it holds a control character", line, None) from error
    except (ValueError, OverflowError) as error:  # the scanner, on an escape such as "\UFFFFFFFF"
        beyond = (m for m in re.finditer(r"\\U([0-9a-fA-F]{8})", text) if int(m[1], 16) > sys.maxunicode)
        line = next((text.count("\n", 0, m.start()) + 1 for m in beyond), None)
        raise complain("is not YAML: it holds an escape or a version that does not exist", line, None) from error


def _not_yaml(error: MarkedYAMLError, complain: Complaint) -> InputError:
    """Say where the text stops being YAML or, if something is never closed, where that starts."""
    mark, reason = error.problem_mark or error.context_mark, str(error.problem or error.context)
    hint = "indent with spaces, not tabs" if "\\t" in reason else "a YAML file is expected"
    if "end of stream" in reason or "<stream end>" in reason:
        start = error.context_mark
        open_here = start is not None and mark is not None and start.index < mark.index
        mark, hint = (start, "close what starts here") if open_here else (mark, "something above is not closed")
    if mark is None:
        return complain(f"is not YAML: {reason}", None, hint)
    return complain(f"is not YAML at column {mark.column + 1}: {reason}", mark.line + 1, hint)


def _plain_events(text: str, complain: Complaint) -> Iterator[Event]:
    """The events that make up values, without the parser's bookkeeping; refuses what a problem file never needs."""
    depth = count = 0
    for event in YAML(typ="safe", pure=True).parse(text):
        line = None if event.start_mark is None else event.start_mark.line + 1
        if isinstance(event, DocumentStartEvent) and event.version not in (None, (1, 2)):
            raise complain("asks for another version of YAML", line, "remove the %YAML line, 1.2 is understood")
        if isinstance(event, AliasEvent) or getattr(event, "anchor", None) is not None:
            raise complain("uses an anchor or alias (& or *)", line, "write the value out; quote text with & or *")
        if getattr(event, "tag", None) is not None:
            raise complain(f"uses a tag ({shorten(event.tag)})", line, "remove it; quote text that starts with !")
        if isinstance(event, (SequenceStartEvent, MappingStartEvent)):
            depth += 1
            if depth > DEEPEST_NESTING:
                raise complain(f"is nested deeper than {DEEPEST_NESTING} levels", line, None)
        elif isinstance(event, (SequenceEndEvent, MappingEndEvent)):
            depth -= 1
        elif not isinstance(event, ScalarEvent):
            continue
        count += 1
        if count > MOST_VALUES:
            raise complain(f"holds more than {MOST_VALUES} values", line, "curves belong in files of their own")
        yield event


def _value(event: Event, events: Iterator[Event], path: Keys, lines: dict[Keys, int], complain: Complaint) -> Any:
    """Build the value that starts with `event`, taking the rest of it from `events`."""
    if isinstance(event, ScalarEvent):
        return _scalar(event)
    if isinstance(event, SequenceStartEvent):
        items: list[Any] = []
        while not isinstance(item := next(events), SequenceEndEvent):
            here = (*path, len(items))
            lines[here] = item.start_mark.line + 1
            items.append(_value(item, events, here, lines, complain))
        return tuple(items)
    mapping: dict[str, Any] = {}
    while not isinstance(item := next(events), MappingEndEvent):
        line = item.start_mark.line + 1
        key = _scalar(item) if isinstance(item, ScalarEvent) else ()
        if not isinstance(key, str):
            raise complain("a key must be a name", line, "quote a number that is a name")
        here = (*path, key)
        if key in mapping:
            again = f"{dotted(here)} is given twice, first in line {lines[here]}"
            raise complain(again, line, "remove one of them")
        lines[here] = line
        mapping[key] = _value(next(events), events, here, lines, complain)
    return mapping


def _scalar(event: ScalarEvent) -> str | int | float | bool | None:
    text: str = event.value
    if not event.implicit[0]:  # quoted, or a block of text
        return text
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text) if len(text) <= LONGEST_NUMBER else float(text)
    if _BASED.fullmatch(text):
        return int(text, 0) if len(text) <= LONGEST_NUMBER else math.inf
    if _FLOAT.fullmatch(text):
        return float(text)
    return float(text.replace(".", "", 1)) if _INFINITE.fullmatch(text) else text


def describe(value: object) -> str:
    """Say in plain words what kind of value was found where another was expected."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {shorten(value)!r}"
    if isinstance(value, dict):
        return "a section with keys of its own"
    return "a list" if isinstance(value, tuple) else shorten(f"{value}")


def dotted(path: Keys) -> str:
    """Name a field as in `cell.nozzle.tip_mm`; items of lists are identified by their line alone."""
    return shorten(".".join(key for key in path if isinstance(key, str)), 80)


def shorten(text: str, length: int = 40) -> str:
    """Cut a long text for a message, and show unprintable characters as ?."""
    text = "".join(c if c.isprintable() else "?" for c in text[: length + 1])
    return text if len(text) <= length else text[: length - 1] + "…"
