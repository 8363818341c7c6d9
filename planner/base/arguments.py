"""Checks of arguments of functions that users call: an error for a wrong type names the argument."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterable
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

from planner.base.errors import InputError

Wanted = TypeVar("Wanted")


def kind_of(value: object) -> str:
    """What kind of value was given where another was expected, in words."""
    return "nothing" if value is None else f"of type {type(value).__name__}"


def as_path(value: object, field: str) -> Path:
    """A path from a string or a path. Raises InputError for anything else, and for an empty string."""
    if isinstance(value, (str, os.PathLike)) and isinstance(name := os.fspath(value), str):
        if name:
            return Path(name)
        raise InputError("is empty", field=field, hint="the name of a file or folder")
    raise InputError(f"must be a path, not {kind_of(value)}", field=field, hint="a text or a pathlib.Path")


def as_number(value: object, field: str) -> float:
    """A real number. Raises InputError for anything else."""
    if isinstance(value, Real) and not isinstance(value, bool):
        return float(value)
    raise InputError(f"must be a number, not {kind_of(value)}", field=field)


def as_index(value: object, field: str) -> int:
    """A whole number. Raises InputError for anything else."""
    if not isinstance(value, bool):
        try:
            return operator.index(value)  # type: ignore[arg-type]
        except TypeError:
            pass
    raise InputError(f"must be a whole number, not {kind_of(value)}", field=field)


def as_list(value: object, field: str, of: str) -> tuple[Any, ...]:
    """The items of a list, tuple or the like. Raises InputError for anything else, and for a string."""
    if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
        return tuple(value)
    raise InputError(f"must be a list of {of}, not {kind_of(value)}", field=field)


def as_one_of(value: object, kind: type[Wanted], field: str, hint: str) -> Wanted:
    """A value of type `kind`. Raises InputError for anything else."""
    if isinstance(value, kind):
        return value
    raise InputError(f"must be a {kind.__name__}, not {kind_of(value)}", field=field, hint=hint)


def check_callable(value: object, field: str) -> None:
    """Raise InputError for a value that cannot be called."""
    if not callable(value):
        raise InputError(f"cannot be called: it is {kind_of(value)}", field=field)
