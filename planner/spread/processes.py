"""Items in processes of this computer, each started afresh: a copy of this one would have its threads' locks."""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from planner.interrupts import ignored_interrupts
from planner.spread.named import Spread, by_name, lost, name_of, outcome

TRIES = 3  # of an item whose process dies: once may be bad luck, three times is the item
_BUG = 1  # exit code of a process that an exception ended


@contextmanager
def local_crew(jobs: int) -> Iterator[Spread]:
    """What spreads items over so many processes, which stay until the block ends."""
    processes: dict[Connection, SpawnProcess] = {}
    try:
        yield partial(_in_processes, processes, jobs)
    finally:
        for pipe in list(processes):
            _end(processes, pipe)


def _in_processes(
    processes: dict[Connection, SpawnProcess], jobs: int, function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    """An item at a time for each process; whichever dies is replaced."""
    name = name_of(function)
    todo = deque(range(len(items)))
    tries = [0] * len(items)
    working: dict[Connection, int] = {}
    try:
        while todo or working:
            idle = [pipe for pipe in processes if pipe not in working]
            for _ in range(min(len(todo), jobs - len(working))):
                pipe = idle.pop() if idle else _start(processes)
                working[pipe] = todo.popleft()
                with suppress(OSError):  # of one that died while it was idle: its pipe tells so below
                    pipe.send((name, items[working[pipe]]))
            ready = wait(list(working))
            for pipe in [each for each in working if each in ready]:
                i = working.pop(pipe)
                try:
                    result = pipe.recv()
                except (EOFError, OSError):
                    processes[pipe].join()  # it is about to end, with an exit code of its own
                    code = _end(processes, pipe)
                    if code == _BUG:
                        raise RuntimeError(f"{'.'.join(name)} failed in its own process, as told above") from None
                    tries[i] += 1
                    if tries[i] < TRIES:
                        todo.appendleft(i)
                    else:
                        yield i, lost(i, TRIES, f"exit code {code}")
                else:
                    yield i, result
    finally:
        for pipe in working:  # what they would answer, nobody waits for
            _end(processes, pipe)


def _start(processes: dict[Connection, SpawnProcess]) -> Connection:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    processes[here] = context.Process(target=_serve, args=(there,), daemon=True)
    with ignored_interrupts():  # Ctrl-C is for who started it, who ends it
        processes[here].start()
    there.close()
    return here


def _end(processes: dict[Connection, SpawnProcess], pipe: Connection) -> int | None:
    """End a process and forget it; its exit code."""
    process = processes.pop(pipe)
    pipe.close()
    process.terminate()
    process.join()
    return process.exitcode


def _serve(pipe: Connection) -> None:
    """Answer every item with its outcome, until the other end is gone; a bug ends the process with its traceback."""
    while True:
        try:
            name, item = pipe.recv()
        except EOFError:
            return
        pipe.send(outcome(by_name(*name), item))
