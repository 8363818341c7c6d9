"""Items on the workers of a dask scheduler.

Only data and names go over the wire: workers import the function, and so must have the program. That it is the same
program is looked at with every item, for workers may come and go at any time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from planner.errors import InputError
from planner.spread.named import Spread, by_name, lost, name_of, outcome, program_of

PATIENCE = 10.0  # s for the scheduler to answer, and then for a first worker to be there
_ADDRESS = re.compile(r"(tcp|tls)://([^/\s:\[\]]+|\[[0-9a-fA-F:]+\]):\d{1,5}")
_FIELD = "--scheduler"


@dataclass(frozen=True)
class Stranger:
    """What a worker answers whose program is not the one that asks."""

    program: str


@contextmanager
def cluster_crew(scheduler: str) -> Iterator[Spread]:
    """What spreads items over the workers of a scheduler; what a dead one had, dask itself gives to others."""
    if not _ADDRESS.fullmatch(scheduler):
        raise InputError(f"{scheduler!r} is no address", field=_FIELD, hint="such as tcp://192.168.0.10:8786")
    try:
        import distributed
    except ModuleNotFoundError:
        raise InputError("dask is not installed", field=_FIELD, hint="the extra `cluster` has it") from None
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
    # not pure: a result of an earlier run with the same items is not this run's
    futures = [client.submit(_work, program, *name, item, pure=False) for item in items]
    index = {future.key: i for i, future in enumerate(futures)}
    finished = distributed.as_completed(futures, loop=client.loop)
    futures.clear()  # so that results that were taken do not stay on the workers
    for future in finished:
        i = index[future.key]
        yield i, _result(future, i, name, program, scheduler)


def _result(future: Any, i: int, name: tuple[str, str], program: str, scheduler: str) -> Any:
    """What a future came to. Raises InputError for a worker without this program, RuntimeError for a bug."""
    from distributed import KilledWorker

    if future.cancelled():
        raise InputError(f"the scheduler at {scheduler} went away", field=_FIELD)
    error = future.exception()
    if isinstance(error, KilledWorker):
        return lost(i, error.allowed_failures + 1, f"last on {error.last_worker.address}")
    if isinstance(error, ModuleNotFoundError) and error.name in ("planner", name[0].partition(".")[0]):
        hint = "workers run in an environment with the same program"
        raise InputError(f"a worker of {scheduler} has no module {error.name}", field=_FIELD, hint=hint)
    if error is not None:
        raise RuntimeError(f"{'.'.join(name)} failed on a worker: {error!r}") from error
    result = future.result()
    if isinstance(result, Stranger):
        reason = f"a worker of {scheduler} has another program: {_difference(result.program, program)}"
        raise InputError(reason, field=_FIELD, hint="the same commit and requirements.txt everywhere")
    return result


def _difference(there: str, here: str) -> str:
    """What of two programs differs, in words."""
    pairs = zip(there.split(", "), here.split(", "), strict=True)
    return ", ".join(f"{one} instead of {other}" for one, other in pairs if one != other)


def _work(program: str, module: str, name: str, item: Any) -> Any:
    """On a worker: the outcome of an item, or a Stranger."""
    own = program_of(module)
    return outcome(by_name(module, name), item) if own == program else Stranger(own)
