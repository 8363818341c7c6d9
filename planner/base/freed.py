"""Returning freed memory to the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


def give_back() -> None:
    """Return freed memory to the system; with a C library other than glibc, do nothing.

    glibc keeps small freed blocks; after a large print they add up to as much as its plan.
    """
    if sys.platform.startswith("linux"):
        with suppress(AttributeError, OSError):  # another library, or none that can be called
            ctypes.CDLL(None).malloc_trim(0)


@contextmanager
def given_back(large: bool) -> Iterator[None]:
    """Return the memory that the block freed, a stage of a print, before the next stage needs more; only if `large`."""
    yield
    if large:
        give_back()
