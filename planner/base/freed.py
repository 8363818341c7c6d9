"""Memory that was freed, given back to the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


def give_back() -> None:
    """Return freed memory to the system. glibc keeps small freed blocks; after a large print they add up to as much as its plan.

    With another C library, nothing is done.
    """
    if sys.platform.startswith("linux"):
        with suppress(AttributeError, OSError):  # another library, or none that can be asked
            ctypes.CDLL(None).malloc_trim(0)


@contextmanager
def given_back(large: bool) -> Iterator[None]:
    """Memory that a stage of a large print freed goes back to the system, lest it stand beside what the next one needs."""
    yield
    if large:
        give_back()
