"""A function in a process of its own, so that the second core works too."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any


def in_background(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Start `function(*arguments)`; returns what waits for its result. Everything handed over must pickle.

    Ctrl-C is the parent's to handle: the child does not see it, and ends with the parent. An exception in the
    child shows its traceback there and raises RuntimeError here.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_send_result, args=(sender, function, arguments), daemon=True)
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited by the child from its first instant on
    try:
        child.start()
    finally:
        signal.signal(signal.SIGINT, previous)
    sender.close()

    def wait() -> Any:
        try:
            result = receiver.recv()
        except EOFError:
            child.join()
            raise RuntimeError(f"{function.__name__} failed in its own process (exit code {child.exitcode})") from None
        child.join()
        return result

    return wait


def _send_result(sender: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    sender.send(function(*arguments))
