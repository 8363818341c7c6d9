"""Items in processes of this computer, each started afresh: a copy of this one would have its threads' locks."""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import TypeVar

from planner.errors import PlannerError
from planner.interrupts import ignored_interrupts
from planner.spread.named import by_name, lost, name_of, outcome

Item = TypeVar("Item")
Result = TypeVar("Result")

TRIES = 3  # of an item whose process dies: once may be bad luck, three times is the item
_BUG = 1  # exit code of a process that an exception ended


def in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int
) -> Iterator[tuple[int, Result | PlannerError]]:
    """As `planner.spread.spread`, an item at a time for each process; whichever dies is replaced."""
    name = name_of(function)
    todo = deque(range(len(items)))
    tries = [0] * len(items)
    processes: dict[Connection, SpawnProcess] = {}
    working: dict[Connection, int] = {}
    context = multiprocessing.get_context("spawn")
    try:
        while todo or working:
            idle = [pipe for pipe in processes if pipe not in working]
            for _ in range(min(len(todo), jobs - len(working))):
                pipe = idle.pop() if idle else _start(context, name, processes)
                working[pipe] = todo.popleft()
                with suppress(OSError):  # of one that died while it was idle: its pipe tells so below
                    pipe.send(items[working[pipe]])
            ready = wait(list(working))
            for pipe in [each for each in working if each in ready]:
                i = working.pop(pipe)
                try:
                    result = pipe.recv()
                except (EOFError, OSError):
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
        for pipe in list(processes):
            processes[pipe].terminate()
            _end(processes, pipe)


def _start(context: SpawnContext, name: tuple[str, str], processes: dict[Connection, SpawnProcess]) -> Connection:
    here, there = context.Pipe()
    processes[here] = context.Process(target=_serve, args=(there, *name), daemon=True)
    with ignored_interrupts():  # Ctrl-C is for who started it, who ends it
        processes[here].start()
    there.close()
    return here


def _end(processes: dict[Connection, SpawnProcess], pipe: Connection) -> int | None:
    """Forget a process, once it has ended; its exit code."""
    process = processes.pop(pipe)
    process.join()
    pipe.close()
    return process.exitcode


def _serve(pipe: Connection, module: str, name: str) -> None:
    """Answer every item with its outcome, until the other end is gone; a bug ends the process with its traceback."""
    while True:
        try:
            item = pipe.recv()
        except EOFError:
            return
        pipe.send(outcome(by_name(module, name), item))
