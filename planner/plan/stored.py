"""Plans to a file and back: numbers to the last bit, and nothing executable.

A file is an NPZ archive of plain arrays: one for each type of number, in which all arrays are concatenated, and a JSON
text that refers to them. The text names classes of this package's values; nothing else can be read. The cell is not
stored: it is built again from the problem and the robots' files, and the plan's seal shows whether it is the same.
"""

from __future__ import annotations

import enum
import json
import os
import re
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from planner.base.arguments import as_path
from planner.base.errors import InputError, OutputError
from planner.base.versions import versions
from planner.plan.seal import digest_of

if TYPE_CHECKING:
    from planner.plan.plan import Plan

FORMAT = 1
INPUTS = ("problem", "toolpath")  # what is verified against, and is in the file
_TEXT = "structure"
_KINDS = "fiub"  # NumPy kinds of arrays: numbers and booleans
# Classes that may be named: frozen values in the packages that a plan is made of.
_HOMES = re.compile(r"planner\.(problem|cell|toolpath|resolve|plan)(\.[a-z][a-z_]*)*")
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    RuntimeError,
)
_UNLIKE = (TypeError, OverflowError, ValueError, KeyError, IndexError, AttributeError, ImportError, RecursionError)


def save(plan: Plan, path: str | Path) -> Path:
    """Write a plan into one file, replacing an earlier one. Raises OutputError if it cannot be written."""
    target = as_path(path, "path")
    taking = _Taking()
    parts = {field.name: taking.of(getattr(plan, field.name)) for field in fields(plan) if field.name != "cell"}
    source = taking.of(plan.problem.sources)
    held = {
        "format": FORMAT,
        "beadwise": versions().get("beadwise", ""),
        "plan": parts,
        "source": source,
        "objects": taking.objects,
        "inputs": {name: _digest(getattr(plan, name)) for name in INPUTS},
    }
    text = json.dumps(held, ensure_ascii=True)
    arrays: dict[str, Any] = {kind: np.concatenate(rows) for kind, rows in taking.rows.items()}
    arrays[_TEXT] = np.frombuffer(text.encode(), dtype=np.uint8)
    fresh = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        with fresh.open("wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **arrays)
        os.replace(fresh, target)
    except OSError as error:
        with suppress(OSError):
            fresh.unlink()
        raise OutputError(f"cannot write {target}: {error.strerror}") from error
    return target


def stored_parts(path: str | Path, names: Collection[str]) -> dict[str, Any]:
    """The fields of a plan that `save` wrote, by name, except its cell. Raises InputError for anything else."""
    source = as_path(path, "path")
    try:
        with np.load(source, allow_pickle=False) as archive:
            if not hasattr(archive, "files"):
                raise ValueError("one array")
            arrays: dict[str, NDArray[Any]] = {name: np.asarray(archive[name]) for name in archive.files}
        found = json.loads(arrays.pop(_TEXT).tobytes().decode())
    except FileNotFoundError as error:
        raise InputError("there is no such file", file=source) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=source) from error
    except MemoryError as error:
        raise InputError("is too large for the memory", file=source) from error
    except _UNREADABLE as error:
        raise InputError("is not a saved plan", file=source, hint="plan.save(path) makes one") from error
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError("is not a plan saved by this version", file=source, hint="plan it again")
    unlike = f"holds a plan of beadwise {found.get('beadwise')} that this version cannot read"
    try:
        giving = _Giving(found["objects"], arrays)
        parts: dict[str, Any] = {name: giving.of(value) for name, value in found["plan"].items()}
        parts["problem"].model_post_init(giving.of(found["source"]))
        if set(parts) != set(names):
            raise KeyError("other parts")
        changed = [name for name in INPUTS if _digest(parts[name]) != found["inputs"][name]]
    except _UNLIKE as error:
        raise InputError(unlike, file=source, hint="plan it again") from error
    if changed:
        # Inputs are searched by compiled code, which trusts them. A changed motion or verdict is only verified again.
        # Another version may have other fields, which make it another input.
        other = found.get("beadwise") != versions().get("beadwise")
        reason = unlike if other else f"changed since it was saved: its {' and its '.join(changed)}"
        raise InputError(reason, file=source, hint="plan it again")
    return parts


def _digest(value: object) -> str:
    """Digest of an input; empty if it has none."""
    try:
        return digest_of(value)
    except TypeError:
        return ""


class _Taking:
    """Values on their way into a file: every object once, arrays concatenated by type of number."""

    def __init__(self) -> None:
        self.objects: list[Any] = []
        self.rows: dict[str, list[NDArray[Any]]] = {}
        self._filled: dict[str, int] = {}
        self._known: dict[int, tuple[Any, Any]] = {}  # by id; the value is kept alive, so that its id is not reused

    def of(self, value: Any) -> Any:
        """A value as JSON: itself, a list whose first item gives its kind, or the number of an object."""
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, enum.Enum):
            return ["enum", _home(type(value)), value.name]
        if isinstance(value, int):
            return value
        if isinstance(value, np.generic):
            return ["scalar", self._array(np.asarray(value))]
        if isinstance(value, float):
            return ["float", value.hex()]
        if isinstance(value, PurePath):
            return ["path", str(value)]
        if isinstance(value, tuple | list | set | frozenset):
            items = sorted(value) if isinstance(value, set | frozenset) else value
            return [
                type(value).__name__ if not hasattr(value, "_fields") else _home(type(value)),
                [self.of(each) for each in items],
            ]
        if isinstance(value, Mapping):
            return ["mapping", [[self.of(key), self.of(each)] for key, each in value.items()]]
        if id(value) not in self._known:
            number = len(self.objects)
            self.objects.append(None)
            self._known[id(value)] = value, number
            self.objects[number] = list(self._object(value))
        return ["object", self._known[id(value)][1]]

    def _object(self, value: Any) -> Iterator[Any]:
        if isinstance(value, np.ndarray):
            yield from ("array", self._array(value))
        elif is_dataclass(value):  # fields that it does not compare by are computed again on demand
            kept = [each.name for each in fields(value) if each.compare]
            yield from (_home(type(value)), {name: self.of(getattr(value, name)) for name in kept})
        elif hasattr(value, "model_fields_set"):  # of pydantic
            given = {name: self.of(getattr(value, name)) for name in type(value).model_fields}
            yield from (_home(type(value)), given, sorted(value.model_fields_set))
        elif isinstance(value, BSpline):
            yield from ("BSpline", [self.of(each) for each in (value.t, value.c, value.k)])
        elif isinstance(value, cKDTree):
            yield from ("cKDTree", self.of(value.data))
        elif hasattr(value, "wkb"):
            yield from ("shapely", value.wkb_hex)
        else:
            raise TypeError(f"{type(value).__module__}.{type(value).__qualname__} cannot be saved")

    def _array(self, value: NDArray[Any]) -> list[Any]:
        if value.dtype.kind not in _KINDS:
            raise TypeError(f"an array of {value.dtype} cannot be saved")
        kind, flat = value.dtype.name, np.ascontiguousarray(value).reshape(-1)
        first = self._filled.get(kind, 0)
        self.rows.setdefault(kind, []).append(flat)
        self._filled[kind] = first + flat.size
        return [kind, first, list(value.shape)]


class _Giving:
    """Values on their way out of a file; each object is made once, when it is first needed."""

    def __init__(self, objects: list[Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        self._objects, self._arrays = objects, arrays
        self._made: dict[int, Any] = {}

    def of(self, told: Any) -> Any:
        """The value that a piece of JSON represents. Raises one of _UNLIKE if it represents none."""
        if not isinstance(told, list):
            return told
        kind, *rest = told
        match kind:
            case "object":
                return self._object(int(rest[0]))
            case "float":
                return float.fromhex(rest[0])
            case "scalar":
                return self._array(rest[0])[()]
            case "path":
                return Path(rest[0])
            case "enum":
                return _class(rest[0], enum.Enum)[rest[1]]
            case "tuple" | "list" | "set" | "frozenset":
                make = {"tuple": tuple, "list": list, "set": set, "frozenset": frozenset}[kind]
                return make(self.of(each) for each in rest[0])
            case "mapping":
                return {self.of(key): self.of(each) for key, each in rest[0]}
        return _class(kind, tuple)(*(self.of(each) for each in rest[0]))  # a named tuple

    def _object(self, number: int) -> Any:
        if number not in self._made:
            self._made[number] = self._new(*self._objects[number])
        return self._made[number]

    def _new(self, kind: str, told: Any, given: list[str] | None = None) -> Any:
        if kind == "array":
            found = self._array(told)
            found.setflags(write=False)
            return found
        if kind == "BSpline":
            return BSpline(*(self.of(each) for each in told))
        if kind == "cKDTree":
            return cKDTree(self.of(told))
        if kind == "shapely":
            import shapely

            return shapely.from_wkb(told)
        values = {name: self.of(each) for name, each in told.items()}
        made: Any = _class(kind, object)
        if given is None:
            if not hasattr(made, "__dataclass_fields__"):
                raise TypeError(f"{kind} is no dataclass")
            return made(**values)
        by_key = {made.model_fields[name].alias or name: value for name, value in values.items()}
        return made.model_construct(set(given), **by_key)

    def _array(self, told: list[Any]) -> NDArray[Any]:
        kind, first, shape = told
        size = int(np.prod(shape, dtype=np.int64))
        row = self._arrays[kind]
        if min(first, size, *shape) < 0 or first + size > len(row):
            raise IndexError(f"{first}, {shape}")
        row = row[first : first + size]
        if row.dtype.kind not in _KINDS:
            raise TypeError(f"{kind} holds no numbers")
        return row.reshape(shape).copy()


def _home(of: type) -> str:
    return f"{of.__module__}:{of.__qualname__}"


def _class(told: str, of: type) -> Any:
    """A class of this package's values, from its `module:name`. Raises TypeError for any other."""
    module, _, name = told.partition(":")
    if not _HOMES.fullmatch(module) or not name.isidentifier():
        raise TypeError(f"{told} is no value of a plan")
    found = vars(import_module(module)).get(name)
    if not isinstance(found, type) or not issubclass(found, of) or found.__module__ != module:
        raise TypeError(f"{told} is no value of a plan")
    return found
