"""Signals that end a process: held off for a moment, taken as Ctrl-C, or sent to what was started when its parent ends."""

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
_SOON = 0.02  # s
_came: list[int] = []  # numbers of the signals that interrupted this process
_held: list[int] = []  # those that wait, where `_holding` is not empty
_holding: list[None] = []
_last_words: list[str] = []  # of a process that ends at once
_undone: list[Callable[[], None]] = []  # what takes back what is half done, in the order in which that began


@contextmanager
def ignored_interrupts(terminations: bool = False) -> Iterator[None]:
    """Ctrl-C, and SIGTERM with `terminations`, is ignored in the block, and by processes that are started in it from
    their first instant on."""
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
    """From here on SIGTERM ends this process as Ctrl-C does: what is half-written goes, processes that it started end.

    What either leaves half closed goes without a traceback.
    """
    if threading.current_thread() is threading.main_thread():
        for number, usual in ((signal.SIGTERM, signal.SIG_DFL), (signal.SIGINT, signal.default_int_handler)):
            if signal.getsignal(number) is usual:
                signal.signal(number, _interrupt)


@contextmanager
def hangups_interrupt() -> Iterator[None]:
    """In the block a terminal that closes interrupts, as Ctrl-C does, unless that is ignored, as under nohup.

    For commands that start no process.
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
    """The system and the shell both say so; the second time nothing is to be cut off that answers the first."""
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
    """In the block an interruption ends this process where it is, with some last words: no exception finds its way through
    compiled code, which may drop it, make another one of it, or crash. For commands that hold nothing but files."""
    _last_words.append(words)
    try:
        yield
    finally:
        _last_words.pop()


@contextmanager
def undone_at_the_end(undo: Callable[[], None]) -> Iterator[None]:
    """Call `undo` behind the block, and before an interruption in it ends this process at once."""
    _undone.append(undo)
    try:
        yield
    finally:
        with interruptions_held():
            _undone.remove(undo)
            undo()


@contextmanager
def interruptions_held() -> Iterator[None]:
    """Interruptions wait for the end of the block."""
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
    threading.excepthook = lambda told: None  # of threads whose files go
    for child in multiprocessing.active_children():  # which may be writing what is undone
        child.kill()
        child.join()
    for undo in reversed(_undone):
        with suppress(OSError):
            undo()
    # buffers may be in use where the interruption came
    wiped = "\r\x1b[2K\x1b[?25h" if os.isatty(2) else ""  # the line of a bar, and the cursor that it hides
    with suppress(OSError):  # nobody reads it
        os.write(2, f"{wiped}{_last_words[-1]}\n".encode(sys.stderr.encoding or "utf-8", "replace"))
    os._exit(EXIT_INTERRUPTED)


def interrupted() -> bool:
    """Whether Ctrl-C or SIGTERM came since `terminations_interrupt`.

    Code in C that was calling Python then may have dropped the exception, or made another one of it.
    """
    return bool(_came)


def no_more_interruptions() -> None:
    """From here on neither Ctrl-C nor SIGTERM changes how this process ends."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _half_closed(left: sys.UnraisableHookArgs) -> None:
    """Say nothing of an object that was being closed when the interruption came. One that came in a finalizer, where
    Python drops it, comes again."""
    if isinstance(left.exc_value, KeyboardInterrupt):
        threading.Timer(_SOON, partial(signal.pthread_kill, threading.get_ident(), signal.SIGINT)).start()


def interrupts_answered() -> None:
    """This process ends with its own exit code, though Ctrl-C came while it ran a program that was given as text.

    CPython remembers an interrupt that leaves such a text (NumPy and numba make functions from them), and kills
    `python -m …` by SIGINT at its end, whoever caught it since. The next text that is run makes it forget.
    """
    exec("")


def end_with_parent(parent: int) -> None:
    """From here on this process ends with the one that started it, of that number, however that ends (on Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_DEATH_SIGNAL, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before it could be asked for
            os._exit(1)


@contextmanager
def terminations_held() -> Iterator[None]:
    """SIGTERM waits in the block, and in processes that are forked in it until they take it as systems do."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def taken_as_systems_do() -> None:
    """SIGTERM, which was held back when this process was forked, ends it at once: the parent's handler is of no use here."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
