"""Memory that was freed, given back to the system."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress


def give_back() -> None:
    """Give back what was freed: glibc keeps it, in pieces between what is in use, which of a large print is as much again.

    Elsewhere nothing is done. It takes some 50 ms a gigabyte.
    """
    if sys.platform.startswith("linux"):
        with suppress(AttributeError, OSError):  # another library, or none that can be asked
            ctypes.CDLL(None).malloc_trim(0)
