"""A function in a process of its own, so that the second core works too."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any


@contextmanager
def in_background(function: Callable[..., Any], *arguments: Any) -> Iterator[Callable[[], Any]]:
    """Run `function(*arguments)` beside the block, which gets what waits for its result.

    The process ends with the block, finished or not. Ctrl-C is the block's to handle: the process does not see
    it. An exception there shows its traceback and raises RuntimeError where the result is asked for.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_send_result, args=(sender, function, arguments), daemon=True)
    with _ignored_interrupt():  # inherited by the child from its first instant on
        child.start()
    sender.close()

    def wait() -> Any:
        try:
            return receiver.recv()
        except EOFError:
            child.join()
            raise RuntimeError(f"{function.__name__} failed in its own process (exit code {child.exitcode})") from None

    try:
        yield wait
    finally:
        child.terminate()
        child.join()
        receiver.close()


@contextmanager
def _ignored_interrupt() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set signal handlers, and only it gets Ctrl-C
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def _send_result(sender: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    sender.send(function(*arguments))
