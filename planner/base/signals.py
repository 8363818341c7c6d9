"""Signals that end a process: held for a moment, treated as Ctrl-C, or sent to a child when its parent ends."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from types import FrameType
from typing import NoReturn

from planner.base.errors import EXIT_INTERRUPTED

_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux
_SOON = 0.02  # s until an interruption that Python dropped is sent again
_came: list[int] = []  # numbers of the signals that interrupted this process
_held: list[int] = []  # signals that wait while `_holding` is not empty
_holding: list[None] = []
_last_words: list[str] = []  # of a process that ends at once
_undone: list[Callable[[], None]] = []  # functions that undo unfinished work, in the order in which that began


@contextmanager
def ignored_interrupts(terminations: bool = False) -> Iterator[None]:
    """Ignore Ctrl-C in the block, and SIGTERM with `terminations`; so do processes started in it, from the start."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set signal handlers, and only it gets Ctrl-C
        return
    numbers = (signal.SIGINT, signal.SIGTERM) if terminations else (signal.SIGINT,)
    previous = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def terminations_interrupt() -> None:
    """From here on SIGTERM ends this process as Ctrl-C does: half-written files are removed, its child processes end.

    Objects that either leaves half closed cause no traceback.
    """
    if threading.current_thread() is threading.main_thread():
        for number, usual in ((signal.SIGTERM, signal.SIG_DFL), (signal.SIGINT, signal.default_int_handler)):
            if signal.getsignal(number) is usual:
                signal.signal(number, _interrupt)


@contextmanager
def hangups_interrupt() -> Iterator[None]:
    """In the block, closing the terminal interrupts as Ctrl-C does, unless hang-ups are ignored, as under nohup.

    For commands that start no processes.
    """
    number = getattr(signal, "SIGHUP", None)
    main_thread = threading.current_thread() is threading.main_thread()
    if number is None or not main_thread or signal.getsignal(number) is not signal.SIG_DFL:
        yield
        return
    signal.signal(number, _hung_up)
    try:
        yield
    finally:
        signal.signal(number, signal.SIG_DFL)


def _hung_up(number: int, frame: FrameType | None) -> None:
    """The system and the shell both send it; the second must not interrupt the handling of the first."""
    if not _holding:
        signal.signal(number, signal.SIG_IGN)
    _interrupt(number, frame)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if _holding:
        _held.append(number)
        return
    _came.append(number)
    if _last_words:
        _end_at_once()
    sys.unraisablehook = _half_closed
    signal.default_int_handler(number, frame)


@contextmanager
def ended_at_once(words: str) -> Iterator[None]:
    """In the block, an interruption ends this process at once, with some last words.

    An exception might not get through compiled code, which may drop it, replace it, or crash. For commands that hold
    nothing but files.
    """
    _last_words.append(words)
    try:
        yield
    finally:
        _last_words.pop()


@contextmanager
def undone_at_the_end(undo: Callable[[], None]) -> Iterator[None]:
    """Call `undo` after the block, and before an interruption in it ends this process at once."""
    _undone.append(undo)
    try:
        yield
    finally:
        with interruptions_held():
            _undone.remove(undo)
            undo()


@contextmanager
def interruptions_held() -> Iterator[None]:
    """Hold interruptions until the end of the block."""
    _holding.append(None)
    try:
        yield
    finally:
        _holding.pop()
        if not _holding and _held:
            number = _held[0]
            _held.clear()
            os.kill(os.getpid(), number)


def _end_at_once() -> NoReturn:
    no_more_interruptions()
    threading.excepthook = lambda told: None  # of threads whose files disappear
    for child in multiprocessing.active_children():  # which may be writing files that are removed next
        child.kill()
        child.join()
    for undo in reversed(_undone):
        with suppress(OSError):
            undo()
    # past the buffers, which may be in use where the interruption came
    wiped = "\r\x1b[2K\x1b[?25h" if os.isatty(2) else ""  # erases a progress bar, and shows the cursor it has hidden
    with suppress(OSError):  # nobody is reading
        os.write(2, f"{wiped}{_last_words[-1]}\n".encode(sys.stderr.encoding or "utf-8", "replace"))
    os._exit(EXIT_INTERRUPTED)


def interrupted() -> bool:
    """Whether Ctrl-C or SIGTERM came since `terminations_interrupt`.

    C code that was calling Python at that moment may have dropped the exception, or replaced it.
    """
    return bool(_came)


def no_more_interruptions() -> None:
    """From here on neither Ctrl-C nor SIGTERM changes how this process ends."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _half_closed(left: sys.UnraisableHookArgs) -> None:
    """Ignore errors of objects that were being closed when the interruption came. If it came in a finaliser, where
    Python drops it, it is sent again."""
    if isinstance(left.exc_value, KeyboardInterrupt):
        threading.Timer(_SOON, partial(signal.pthread_kill, threading.get_ident(), signal.SIGINT)).start()


def interrupts_answered() -> None:
    """Let this process end with its own exit code, even if Ctrl-C came while it ran code from a string.

    CPython remembers an interrupt that leaves such code (NumPy and numba make functions from strings), and kills
    `python -m …` by SIGINT at its end, even if it was caught since. Running another string makes it forget.
    """
    exec("")


def end_with_parent(parent: int) -> None:
    """From here on this process ends with process `parent`, which started it, however that ends (on Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != parent:  # it had ended before the request
            os._exit(1)


@contextmanager
def terminations_held() -> Iterator[None]:
    """Hold SIGTERM in the block, and in processes forked in it until they call `taken_as_systems_do`."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def taken_as_systems_do() -> None:
    """Let SIGTERM, held when this process was forked, end it at once: the parent's handler is of no use here."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
