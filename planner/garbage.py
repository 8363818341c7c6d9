"""When Python looks for garbage: not while a command is imported, and not when it ends."""

from __future__ import annotations

import atexit
import gc
import sys


def put_off() -> None:
    """Where this is a command (`python -m`), do not look for garbage until `look_again`, nor when it ends.

    Imports leave next to none, and among all that they make it takes a quarter of a second to find that out; at the end
    as long again, when the memory goes back to the system as a whole.
    """
    if sys.argv[:1] == ["-m"]:  # Python's word for a module that it still looks for
        gc.disable()
        atexit.register(gc.freeze)


def look_again() -> None:
    """From here on as usual, but not at what has been imported, which stays."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
