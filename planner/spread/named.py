"""Functions as other processes find them, and what comes of calling them there."""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from planner.errors import PlannerError
from planner.versions import versions

Item = TypeVar("Item")
Result = TypeVar("Result")

# function, items → (index, result or error that is the user's to mend) of each item, as they are done
Spread = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]

_DIGITS = 12  # of the digest of sources: enough that two programs never share them


class Lost(PlannerError):
    """An item has no result, because every process that worked on it died (out of memory, or killed)."""


def lost(index: int, times: int, how: str) -> Lost:
    """The error of an item whose processes died so many times, the last one so."""
    return Lost(f"item {index} has no result: {times} processes that worked on it died ({how})")


def name_of(function: Callable[..., Any]) -> tuple[str, str]:
    """Module and name by which another process finds a function. Raises TypeError where it cannot."""
    module, name = function.__module__, function.__qualname__
    if module == "__main__":
        spec = getattr(sys.modules[module], "__spec__", None)
        module = "" if spec is None else spec.name
    if not module or not name.isidentifier():
        raise TypeError(f"{name} cannot be found by its name from another process")
    return module, name


def by_name(module: str, name: str) -> Callable[[Any], Any]:
    """The function of that name."""
    found: Callable[[Any], Any] = getattr(importlib.import_module(module), name)
    return found


def outcome(function: Callable[[Item], Result], item: Item) -> Result | PlannerError:
    """A function's result, or the error that is the user's to mend."""
    try:
        return function(item)
    except PlannerError as error:
        return error


@cache
def program_of(module: str) -> str:
    """What a result may depend on besides its item, told in a line: versions, and a digest of the sources.

    The sources are those of this program and of the package that holds the module.
    """
    digest = hashlib.sha256()
    for top in sorted({"planner", module.partition(".")[0]}):
        file = importlib.import_module(top).__file__
        if file is None:
            raise TypeError(f"{top} has no sources that could be compared")
        path = Path(file)
        sources = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
        for source in sources:
            digest.update(source.relative_to(path.parent).as_posix().encode() + b"\0" + source.read_bytes())
    told = ", ".join(f"{package} {version}" for package, version in versions().items())
    return f"{told}, sources {digest.hexdigest()[:_DIGITS]}"
