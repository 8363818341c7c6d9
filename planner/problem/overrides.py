"""Values set in addition to a problem file: `dotted.key=value` as after `--set`, or from Python by key or keyword."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arguments import kind_of
from planner.base.errors import InputError
from planner.problem.waypoint_arrays import WaypointArrays
from planner.problem.yaml_file import (
    DEEPEST_NESTING,
    LARGEST_FILE,
    Complaint,
    Keys,
    Override,
    ValueSources,
    describe,
    dotted,
    parse_yaml,
    shorten,
)

FORM, EXAMPLE = "is not of the form dotted.key=value", "for example --set process.speed_mm_s=30"
DOT = "__"  # in a keyword, which can have no dots


def parse_override(text: str) -> Override:
    """One `dotted.key=value`, the value being YAML; raises InputError that names `--set`."""
    key, equals, value = text.partition("=")
    path = tuple(part.strip() for part in key.split("."))
    label = f"--set {dotted(path)}"

    def complain(reason: str, line: int | None, hint: str | None) -> InputError:
        return InputError(reason, field=label, hint=hint)

    if not equals or not all(path):
        raise InputError(FORM, field=f"--set {shorten(text)}", hint=EXAMPLE)
    if len(path) > DEEPEST_NESTING:
        raise complain("has too many dots", None, None)
    if len(value) > LARGEST_FILE:
        raise complain("is larger than 1 MB", None, None)
    return Override(path, parse_yaml(value, complain, {}), label, text)


def overrides_of(given: Sequence[str | Mapping[str, Any]], keywords: Mapping[str, Any]) -> tuple[Override, ...]:
    """Overrides given from Python, in their order, keywords last.

    given: `dotted.key=value`, or mappings of a dotted key to a value: a number, string, boolean, None, list, array of
    numbers, path, or mapping, which replaces the whole section
    keywords: the same, with `__` in place of a dot
    Raises InputError that names the argument for anything else.
    """
    return tuple(_each(given, keywords))


def with_paths(override: Override, paths: Mapping[Keys, Path]) -> Override:
    """An override with the strings at some keys of the problem replaced by paths; unchanged if it sets none of them."""
    if not any(keys[: len(override.path)] == override.path for keys in paths):
        return override
    value = _with_paths(override.value, override.path, paths)
    return replace(override, value=value, words=f"{'.'.join(map(str, override.path))}={_yaml(value)}")


def _with_paths(value: Any, keys: Keys, paths: Mapping[Keys, Path]) -> Any:
    if isinstance(value, dict):
        return {name: _with_paths(each, (*keys, name), paths) for name, each in value.items()}
    if isinstance(value, tuple):
        return tuple(_with_paths(each, (*keys, i), paths) for i, each in enumerate(value))
    return str(paths[keys]) if keys in paths else value


def _each(given: Sequence[str | Mapping[str, Any]], keywords: Mapping[str, Any]) -> Iterator[Override]:
    for i, one in enumerate(given):
        if isinstance(one, str):
            yield parse_override(one)
        elif isinstance(one, Mapping):
            for key, value in one.items():
                yield _from_python(key, value, f"overrides[{key!r}]")
        else:
            hint = 'for example "layers.count=1" or {"layers.count": 1}'
            raise InputError(
                f"must be a text or a dictionary, not {kind_of(one)}", field=f"overrides, number {i}", hint=hint
            )
    for name, value in keywords.items():
        yield _from_python(name.replace(DOT, "."), value, name)


def _from_python(key: object, value: object, label: str) -> Override:
    """An override from a key and a value given in Python."""
    path = tuple(key.split(".")) if isinstance(key, str) else ()
    if not path or not all(part.strip() == part and part for part in path):
        raise InputError("a key is names joined by dots", field=shorten(label), hint='for example "layers.count"')
    if len(path) > DEEPEST_NESTING:
        raise InputError("has too many dots", field=shorten(label))
    plain = _plain(value, label)
    return Override(path, plain, label, f"{'.'.join(path)}={_yaml(plain)}")


def _plain(value: object, label: str, depth: int = 0) -> Any:
    """A value as YAML would give it. Raises InputError for one that no problem file can hold."""
    if depth > DEEPEST_NESTING:
        raise InputError("is nested too deeply", field=label)
    if isinstance(value, Path):
        return str(value.absolute())  # strings are relative to the problem's folder, paths to the working directory
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.generic):
        return _plain(value.item(), label, depth + 1)
    if isinstance(value, np.ndarray):
        return _plain(value.tolist(), label, depth + 1)
    if isinstance(value, (list, tuple)):
        return tuple(_plain(each, f"{label}[{i}]", depth + 1) for i, each in enumerate(value))
    if isinstance(value, Mapping):
        wrong = next((key for key in value if not isinstance(key, str)), None)
        if wrong is not None:
            raise InputError(f"a key must be a name, not {kind_of(wrong)}", field=label)
        return {key: _plain(each, f"{label}[{key!r}]", depth + 1) for key, each in value.items()}
    raise InputError(
        f"is {kind_of(value)}", field=label, hint="a number, text, list or dictionary, as in a problem file"
    )


def _yaml(value: Any) -> str:
    """A plain value as one line of YAML that reads back as the very same value."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else f"{'-' if value < 0.0 else ''}.inf"
    if isinstance(value, str):
        return value if _reads_back(value) else _quoted(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_yaml, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_yaml(key)}: {_yaml(each)}' for key, each in value.items())}}}"
    return repr(value)


def _quoted(text: str) -> str:
    """A text in double quotes, with escapes for whatever a reader might refuse."""
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text) + '"'


def _reads_back(text: str) -> bool:
    """Whether a text needs no quotes."""
    plain = text.replace("_", "").replace("-", "").replace("/", "").replace(".", "")
    if not plain.isalnum() or not plain.isascii() or text[0] in "-.":
        return False

    def complain(reason: str, line: int | None, hint: str | None) -> InputError:
        return InputError(reason)

    return bool(parse_yaml(text, complain, {}) == text)


def apply_overrides(
    data: dict[str, Any], source: ValueSources, overrides: Sequence[Override]
) -> tuple[dict[str, Any], ValueSources]:
    """Apply overrides to a problem's values; raises InputError that names one whose key would be below a plain value.

    Whether the problem has such a key is left to the validation, which knows the keys.
    """
    for override in overrides:
        if isinstance(override.value, WaypointArrays):
            data = _printing(data, override.value)
            continue

        def complain(reason: str, line: int | None, hint: str | None, label: str = override.label) -> InputError:
            return InputError(reason, field=label, hint=hint)

        data = _put(data, override.path, override.value, complain)
    return data, replace(source, overrides=tuple(overrides))


def printed(toolpath: object) -> Override:
    """An override by which a problem prints waypoints from arrays. Raises InputError for anything else."""
    if not isinstance(toolpath, WaypointArrays):
        hint = "planner.Toolpath.from_arrays(points, normals) makes it"
        raise InputError(f"must be waypoints from arrays, not {kind_of(toolpath)}", field="toolpath", hint=hint)
    return Override(("layers",), toolpath, "toolpath", f"layers={toolpath}")


def _printing(data: dict[str, Any], arrays: WaypointArrays) -> dict[str, Any]:
    """A problem's values with waypoints in place of its layers; they carry their own surface, so there is no part.

    The layers' material stays, and their height becomes that of beads, unless the problem gives another.
    """
    old, process = data.get("layers"), data.get("process")
    layers: dict[str, Any] = {"source": {"waypoints": arrays, "unit": "m"}}
    data = {key: value for key, value in data.items() if key != "part"} | {"layers": layers}
    if isinstance(old, dict) and "material" in old:
        layers["material"] = old["material"]
    bead = process.get("bead") if isinstance(process, dict) else None
    if isinstance(old, dict) and "height_mm" in old and isinstance(bead, dict):
        data["process"] = {**process, "bead": {"height_mm": old["height_mm"], **bead}}  # type: ignore[dict-item]
    return data


def _put(data: Any, path: Keys, value: Any, complain: Complaint) -> dict[str, Any]:
    """Return `data` with the value at `path` replaced or inserted."""
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise complain(f"`{path[0]}` would go below {describe(data)}, which has no keys", None, None)
    inner = value if len(path) == 1 else _put(data.get(path[0]), path[1:], value, complain)
    return {**data, path[0]: inner}
