"""The same function for many items: in this process, in processes on this computer, or on a dask cluster.

Results depend on the items alone, not on where or in which order they were processed. If a process dies, its item is
tried again; no other work is lost. Processes on this computer are spawned: a fork of this one would have its threads'
locks. A cluster is sent only data and names: workers import the function, and so must have the same program, which is
compared with every item, since workers may come and go at any time.
"""

from __future__ import annotations

import hashlib
import importlib
import multiprocessing
import os
import re
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, TypeVar

from planner.base.errors import InputError, PlannerError
from planner.base.extras import missing_extra
from planner.base.signals import end_with_parent, ignored_interrupts
from planner.base.versions import versions

Item = TypeVar("Item")
Result = TypeVar("Result")

# function, items → (index, result or error that the user can fix) of each item, as they are done
Spread = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]

MOST_JOBS = 256  # processes; each takes some 200 MB for its imports
TRIES = 3  # of an item whose process dies: once may be bad luck, three times is the item's fault
_BUG = 1  # exit code of a process ended by an exception
PATIENCE = 10.0  # s to wait for the scheduler to answer, and then for a first worker
_ADDRESS = re.compile(r"(tcp|tls)://([^/\s:\[\]]+|\[[0-9a-fA-F:]+\]):\d{1,5}")
_FIELD = "--scheduler"
_DIGITS = 12  # of the digest of sources: enough to tell any two programs apart


class Lost(PlannerError):
    """An item has no result, because every process that worked on it died (out of memory, or killed)."""


def spread(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, Result | PlannerError]]:
    """Yield (index, `function(item)`) of every item, in the order in which they are done.

    function    defined at the top level of a module, as are the types of all that goes in and out
    jobs        processes; with one, everything is done here, in order, and nothing is tried again
    scheduler   address of a dask scheduler, such as "tcp://host:8786", whose workers are used instead

    A PlannerError that an item raises is its result, and so is `Lost`. Any other exception is a bug: it ends
    everything, as RuntimeError if it came from another process. The processes end with the iteration.
    Raises InputError if there is no such scheduler, or if its workers have a different program.
    """
    with crew(jobs, scheduler) as over:
        yield from over(function, items)


def crew(jobs: int = 1, scheduler: str | None = None) -> AbstractContextManager[Spread]:
    """As `spread`, but called with function and items, and with processes that stay until the block ends.

    What a function keeps in its process (a cache) is still there for later items.
    """
    if not 1 <= jobs <= MOST_JOBS:
        raise InputError(f"{jobs} is not a number of processes", field="--jobs", hint=f"1 to {MOST_JOBS}")
    if scheduler is not None:
        return cluster_crew(scheduler)
    return local_crew(jobs) if jobs > 1 else nullcontext(_here)


def _here(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Outcomes of items, one after another in this process."""
    for i, item in enumerate(items):
        yield i, outcome(function, item)


def lost(index: int, times: int, how: str) -> Lost:
    """The error of an item whose processes died `times` times; how: the last of them."""
    return Lost(f"item {index} has no result: {times} processes that worked on it died ({how})")


def name_of(function: Callable[..., Any]) -> tuple[str, str]:
    """Module and name by which another process finds a function. Raises TypeError if it cannot."""
    module, name = function.__module__, function.__qualname__
    if module == "__main__":
        spec = getattr(sys.modules[module], "__spec__", None)
        module = "" if spec is None else spec.name
    if not module or not name.isidentifier():
        raise TypeError(f"{name} cannot be imported by name in another process")
    return module, name


def by_name(module: str, name: str) -> Callable[[Any], Any]:
    """The function of that name."""
    found: Callable[[Any], Any] = getattr(importlib.import_module(module), name)
    return found


def outcome(function: Callable[[Item], Result], item: Item) -> Result | PlannerError:
    """A function's result, or the error that the user can fix."""
    try:
        return function(item)
    except PlannerError as error:
        return error


@cache
def program_of(module: str) -> str:
    """Everything but the item that a result may depend on, in one line: versions, and a digest of the sources.

    The sources are those of this program and of the package that holds the module.
    """
    digest = hashlib.sha256()
    for top in sorted({"planner", module.partition(".")[0]}):
        file = importlib.import_module(top).__file__
        if file is None:
            raise TypeError(f"{top} has no source files to compare")
        path = Path(file)
        sources = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
        for source in sources:
            digest.update(source.relative_to(path.parent).as_posix().encode() + b"\0" + source.read_bytes())
    told = ", ".join(f"{package} {version}" for package, version in versions().items())
    return f"{told}, sources {digest.hexdigest()[:_DIGITS]}"


@contextmanager
def local_crew(jobs: int) -> Iterator[Spread]:
    """Spreads items over `jobs` processes, which stay until the block ends."""
    processes: dict[Connection, SpawnProcess] = {}
    try:
        yield partial(_in_processes, processes, jobs)
    finally:
        for pipe in list(processes):
            _end(processes, pipe)


def _in_processes(
    processes: dict[Connection, SpawnProcess], jobs: int, function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    """One item at a time per process; a process that dies is replaced."""
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
                with suppress(OSError):  # if it died while idle, which its pipe shows below
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
                        raise RuntimeError(f"{'.'.join(name)} failed in its own process: see the error above") from None
                    tries[i] += 1
                    if tries[i] < TRIES:
                        todo.appendleft(i)
                    else:
                        yield i, lost(i, TRIES, f"exit code {code}")
                else:
                    yield i, result
    finally:
        for pipe in working:  # nobody waits for their answers
            _end(processes, pipe)


def _start(processes: dict[Connection, SpawnProcess]) -> Connection:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    processes[here] = context.Process(target=_serve, args=(there, os.getpid()), daemon=True)
    with ignored_interrupts():  # Ctrl-C is for the parent, which ends it
        processes[here].start()
    there.close()
    return here


def _end(processes: dict[Connection, SpawnProcess], pipe: Connection) -> int | None:
    """End a process and forget it; returns its exit code."""
    process = processes.pop(pipe)
    pipe.close()
    process.terminate()
    process.join()
    return process.exitcode


def _serve(pipe: Connection, parent: int) -> None:
    """Answer every item with its outcome until the other end closes; a bug ends the process with its traceback."""
    end_with_parent(parent)
    while True:
        try:
            name, item = pipe.recv()
        except EOFError:
            return
        pipe.send(outcome(by_name(*name), item))


@dataclass(frozen=True)
class Stranger:
    """The answer of a worker whose program differs from the caller's."""

    program: str


@contextmanager
def cluster_crew(scheduler: str) -> Iterator[Spread]:
    """Spreads items over the workers of a scheduler; dask itself reassigns those of a worker that dies."""
    if not _ADDRESS.fullmatch(scheduler):
        raise InputError(f"{scheduler!r} is not an address", field=_FIELD, hint="such as tcp://192.168.0.10:8786")
    try:
        import distributed
    except ImportError as error:
        raise missing_extra(error, _FIELD) or error from None
    try:
        client = distributed.Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError):
        hint = "start one: dask scheduler --port 8786"
        raise InputError(f"no scheduler answers at {scheduler}", field=_FIELD, hint=hint) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            hint = f"start one: dask worker {scheduler} --nthreads 1"
            raise InputError(f"the scheduler at {scheduler} has no worker", field=_FIELD, hint=hint) from None
        yield partial(_on_workers, client, scheduler)


def _on_workers(
    client: Any, scheduler: str, function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    import distributed

    name = name_of(function)
    program = program_of(name[0])
    # not pure: results of an earlier run with the same items must not be reused
    futures = [client.submit(_work, program, *name, item, pure=False) for item in items]
    index = {future.key: i for i, future in enumerate(futures)}
    finished = distributed.as_completed(futures, loop=client.loop)
    futures.clear()  # so that results already taken do not stay on the workers
    for future in finished:
        i = index[future.key]
        yield i, _result(future, i, name, program, scheduler)


def _result(future: Any, i: int, name: tuple[str, str], program: str, scheduler: str) -> Any:
    """The result of a future. Raises InputError for a worker without this program, RuntimeError for a bug."""
    from distributed import KilledWorker

    if future.cancelled():
        raise InputError(f"the connection to the scheduler at {scheduler} was lost", field=_FIELD)
    error = future.exception()
    if isinstance(error, KilledWorker):
        return lost(i, error.allowed_failures + 1, f"last on {error.last_worker.address}")
    if isinstance(error, ModuleNotFoundError) and error.name in ("planner", name[0].partition(".")[0]):
        hint = "start workers in an environment that has the same program"
        raise InputError(f"a worker of {scheduler} has no module {error.name}", field=_FIELD, hint=hint)
    if error is not None:
        raise RuntimeError(f"{'.'.join(name)} failed on a worker: {error!r}") from error
    result = future.result()
    if isinstance(result, Stranger):
        reason = f"a worker of {scheduler} runs a different program: {_difference(result.program, program)}"
        raise InputError(reason, field=_FIELD, hint="install the same version and packages everywhere")
    return result


def _difference(there: str, here: str) -> str:
    """The differences between two programs, in words."""
    pairs = zip(there.split(", "), here.split(", "), strict=True)
    return ", ".join(f"{one} instead of {other}" for one, other in pairs if one != other)


def _work(program: str, module: str, name: str, item: Any) -> Any:
    """On a worker: the outcome of an item, or a Stranger."""
    own = program_of(module)
    return outcome(by_name(module, name), item) if own == program else Stranger(own)
