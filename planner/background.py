"""A function in a process of its own, so that the second core works too."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

from planner.interrupts import ignored_interrupts


@contextmanager
def in_background(function: Callable[..., Any], *arguments: Any) -> Iterator[Callable[[], Any]]:
    """Run `function(*arguments)` beside the block, which gets what waits for its result.

    The process ends with the block, finished or not. Ctrl-C is the block's to handle: the process does not see
    it. An exception there shows its traceback and raises RuntimeError where the result is asked for.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_send_result, args=(sender, function, arguments), daemon=True)
    with ignored_interrupts():
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


def _send_result(sender: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    sender.send(function(*arguments))
