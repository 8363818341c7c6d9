"""Functions in separate processes or threads, so that other cores work, too."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, NamedTuple, TypeVar

import numpy as np

from planner.base.errors import PlannerError
from planner.base.signals import end_with_parent, ignored_interrupts, taken_as_systems_do, terminations_held

Job = Callable[[], Iterable["Job"]]

Item = TypeVar("Item")
Result = TypeVar("Result")

MANY = 500  # items of a few milliseconds each: from here on, sending results costs less than computing them
_PARTS_A_CORE = 4  # so that a core that is done with easy parts finds more


def spare_core() -> bool:
    """Whether a second process helps: on Linux, where forking is safe, if this process may use more than one core.

    Not in a process of `spread` or of a cluster, which runs alongside others, and only in the main thread: a process
    forked in another may wait forever for a lock that a thread held.
    """
    if threading.current_thread() is not threading.main_thread() or multiprocessing.current_process().daemon:
        return False
    return sys.platform == "linux" and cores() > 1


def cores() -> int:
    """Number of cores this process may use: those it was confined to, for example by `taskset`."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


@contextmanager
def in_background(function: Callable[..., Any], *arguments: Any) -> Iterator[Callable[[], Any]]:
    """Run `function(*arguments)` alongside the block, which gets a function that waits for its result.

    Only where `spare_core`. The process is a fork of this one: it starts in a hundredth of a second, has everything,
    and shares all memory that neither of them changes. It ends with the block, finished or not, and with this process,
    however that ends. Ctrl-C is the block's to handle: the process does not see it. A PlannerError in it is raised when
    the result is requested; any other exception shows its traceback, and raises RuntimeError then.
    """
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    ours = Fork(os.getpid(), receiver, sender)
    child = context.Process(target=_send_result, args=(ours, function, arguments), daemon=True)
    with ignored_interrupts(), terminations_held():
        child.start()
    sender.close()

    def wait() -> Any:
        try:
            result, error = receiver.recv()
        except EOFError:
            child.join()
            raise RuntimeError(f"{function.__name__} failed in its own process (exit code {child.exitcode})") from None
        if error is not None:
            raise error
        return result

    try:
        yield wait
    finally:
        child.terminate()
        child.join()
        receiver.close()


@contextmanager
def beside(second_process: bool, function: Callable[..., Any], *arguments: Any) -> Iterator[Callable[[], Any]]:
    """`in_background` if a second process is wanted and a core is spare; else yields a call of the function here."""
    if second_process and spare_core():
        with in_background(function, *arguments) as wait:
            yield wait
    else:
        yield lambda: function(*arguments)


def in_halves(
    function: Callable[[int, int], Any], count: int, second_process: bool, middle: int | None = None
) -> list[Any]:
    """Results of `function(first, last)` for the halves of range(count) in parallel, or for all of it here.

    The second half begins at `middle` (default: count // 2).
    """
    half = count // 2 if middle is None else middle
    if not second_process or not 0 < half < count or not spare_core():
        return [function(0, count)]
    with in_background(function, half, count) as wait:
        return [function(0, half), wait()]


def of_each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`function(item)` of all items in order, half of them in a second process where these are many.

    For items of a few milliseconds each. Not while other threads are at work: a process forked while one of them
    loads a kernel waits for that forever.
    """

    def part(first: int, last: int) -> list[Result]:
        return [function(item) for item in items[first:last]]

    return [each for half in in_halves(part, len(items), len(items) >= MANY) for each in half]


def in_threads(function: Callable[[int, int], None], count: int) -> None:
    """Call a function that releases the GIL with (first, last) of parts of range(count), in a thread per core.

    Compiled loops that run in parallel by themselves take several times as long to compile.
    """
    edges = np.unique(np.linspace(0, count, min(cores() * _PARTS_A_CORE, count) + 1).astype(int)).tolist()
    with ThreadPoolExecutor(cores()) as pool:
        for _ in pool.map(function, edges[:-1], edges[1:]):
            pass


def in_blocks(function: Callable[[slice], None], count: int, block: int, few: int = 1) -> None:
    """Call a function that releases the GIL with slices of range(count), `block` long, in a thread per core if there
    are more than `few`. Results may depend on the slices, which are the same for any number of cores."""
    blocks = -(-count // block)

    def part(first: int, last: int) -> None:
        for k in range(first, last):
            function(slice(k * block, min((k + 1) * block, count)))

    if blocks > few:
        in_threads(part, blocks)
    else:
        part(0, blocks)


def in_turn(jobs: Iterable[Job]) -> None:
    """Call jobs that release the GIL in a thread per core, and the jobs that each of them returns, which may begin once
    it is done."""
    done: SimpleQueue[Future[Iterable[Job]]] = SimpleQueue()
    begun = 0
    with ThreadPoolExecutor(cores()) as pool:
        try:
            for job in jobs:
                pool.submit(job).add_done_callback(done.put)
                begun += 1
            while begun:  # waiting for a set of futures would go through all of them, each time
                following = done.get().result()
                begun -= 1
                for job in following:
                    pool.submit(job).add_done_callback(done.put)
                    begun += 1
        finally:
            pool.shutdown(cancel_futures=True)


class Fork(NamedTuple):
    """What a forked process gets from its parent: its process id, and both ends of the pipe to it."""

    parent: int
    receiver: Connection
    sender: Connection


def _send_result(fork: Fork, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    end_with_parent(fork.parent)
    taken_as_systems_do()
    fork.receiver.close()  # else sending could wait forever for this end to read
    try:
        result, error = function(*arguments), None
    except PlannerError as refused:
        result, error = None, refused
    with suppress(BrokenPipeError):  # the parent has ended, so this process is about to
        fork.sender.send((result, error))
