"""The same function for many items: in this process, in processes of this computer, or on a dask cluster.

What comes back depends on the items alone, not on where or in which order they were done. A process that dies costs
its item another try, not the rest of the work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

from planner.errors import InputError, PlannerError
from planner.spread.cluster import cluster_crew
from planner.spread.named import Lost, Spread, outcome
from planner.spread.processes import local_crew

__all__ = ["MOST_JOBS", "Lost", "Spread", "crew", "spread"]

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_JOBS = 256  # processes; each takes some 200 MB for what it imports


def spread(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, Result | PlannerError]]:
    """Yield (index, `function(item)`) of every item, in the order in which they are done.

    function    of a module, known by its name there, as is the type of all that goes in and out
    jobs        processes; with one, everything is done here, in order, and nothing is tried again
    scheduler   address of a dask scheduler, such as "tcp://host:8786", whose workers do it instead

    A PlannerError that an item raises is its result, and so is `Lost`. Any other exception is a bug: it ends all, as
    RuntimeError if it came from another process. The processes end with the iteration.
    Raises InputError where there is no such scheduler, or its workers do not have the program that this one is.
    """
    with crew(jobs, scheduler) as over:
        yield from over(function, items)


def crew(jobs: int = 1, scheduler: str | None = None) -> AbstractContextManager[Spread]:
    """What spreads as `spread` does, called with function and items, with processes that stay until the block ends.

    So what a function keeps in its process (a cache) is still there for later items.
    """
    if not 1 <= jobs <= MOST_JOBS:
        raise InputError(f"{jobs} is not a number of processes", field="--jobs", hint=f"1 to {MOST_JOBS}")
    if scheduler is not None:
        return cluster_crew(scheduler)
    return local_crew(jobs) if jobs > 1 else nullcontext(_here)


def _here(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    for i, item in enumerate(items):
        yield i, outcome(function, item)
