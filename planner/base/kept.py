"""What a pure function gave for an object, kept as long as the object lives."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from functools import wraps
from typing import TypeVar

Subject = TypeVar("Subject")
Value = TypeVar("Value")


def kept(function: Callable[[Subject], Value]) -> Callable[[Subject], Value]:
    """The same pure function, that works out once for each object what it gives.

    For objects that never change and have no hash, as frozen dataclasses of arrays: which one it is counts, not what is in
    it. The value goes with the object, so it must not hold it.
    """
    known: dict[Hashable, tuple[weakref.ref[Subject], Value]] = {}

    @wraps(function)
    def once(subject: Subject) -> Value:
        name = id(subject)
        found = known.get(name)
        if found is not None and found[0]() is subject:
            return found[1]
        value = function(subject)
        known[name] = weakref.ref(subject, lambda _: known.pop(name, None)), value
        return value

    return once
