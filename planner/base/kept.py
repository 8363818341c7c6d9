"""Results of a pure function for an object, kept as long as the object lives."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from functools import wraps
from typing import TypeVar

Subject = TypeVar("Subject")
Value = TypeVar("Value")


def kept(function: Callable[[Subject], Value]) -> Callable[[Subject], Value]:
    """The same pure function, evaluated only once for each object.

    For objects that never change and have no hash, such as frozen dataclasses of arrays: identity counts, not content.
    The value is dropped with the object, so it must not hold a reference to it.
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
