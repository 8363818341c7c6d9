"""Prints with several nozzles: the beads of each are searched in the cell that has it in use.

Between beads of two nozzles the arm goes home, so neither search has to know about the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from typing import Any, TypeVar, cast

from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.resolve.joint_path import JointPath
from planner.toolpath.task import NozzleTask

Search = TypeVar("Search", bound=Callable[..., tuple[Any, ...]])


def nozzles_of(cell: Cell, items: Sequence[NozzleTask | JointPath]) -> Iterator[tuple[Cell, list[int]]]:
    """For each nozzle of the print, the cell that has it in use and the beads (indices) that it lays."""
    materials = [item.material if isinstance(item, NozzleTask) else item.task.material for item in items]
    if not cell.nozzles:
        yield cell, list(range(len(items)))
        return
    for k in range(len(cell.nozzles)):
        own = [i for i, material in enumerate(materials) if cell.nozzle_of[material] == k]
        if own:
            yield cell.with_nozzle(k), own


def with_each_nozzle(search: Search) -> Search:
    """Extend a search, which returns a result for each bead, to prints with several nozzles.

    search: (cell, tasks or paths, …) → a result for each. Obstacles among its other arguments, positional or by name,
    are those of the cell, and become those of each nozzle's cell.
    """

    @wraps(search)
    def searched(cell: Cell, items: Sequence[NozzleTask | JointPath], *args: Any, **named: Any) -> tuple[Any, ...]:
        found: dict[int, Any] = {}
        for own, which in nozzles_of(cell, items):
            if own is cell and len(which) == len(items):
                return search(cell, items, *args, **named)
            others = [_for_nozzle(each, cell, own) for each in args]
            by_name = {name: _for_nozzle(each, cell, own) for name, each in named.items()}
            found |= zip(which, search(own, [items[i] for i in which], *others, **by_name), strict=True)
        return tuple(found[i] for i in range(len(items)))

    return cast(Search, searched)


def _for_nozzle(given: Any, cell: Cell, own: Cell) -> Any:
    return given.for_nozzle(cell, own) if isinstance(given, Obstacles) else given
