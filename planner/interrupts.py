"""Ctrl-C where it must not strike."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from planner.errors import EXIT_INTERRUPTED


@contextmanager
def ignored_interrupts() -> Iterator[None]:
    """Ctrl-C is ignored in the block, and by processes that are started in it from their first instant on."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set signal handlers, and only it gets Ctrl-C
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def end_quietly() -> None:
    """Where this is a command (`python -m`), let Ctrl-C end it at once, without a traceback, until `end_in_order`.

    Importing takes seconds, in which there is nothing yet to put in order. One that is ignored stays ignored.
    """
    command = sys.argv[:1] == ["-m"]  # Python's word for a module that it still looks for
    main = threading.current_thread() is threading.main_thread()
    if command and main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def end_in_order() -> None:
    """From here on Ctrl-C raises KeyboardInterrupt, as usual."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(EXIT_INTERRUPTED)
