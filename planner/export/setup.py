"""What decides whether a language can say a plan, known before there is one: the problem and its cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from planner.cell import Cell
    from planner.problem import Problem


class Setup(Protocol):
    """Problem and cell; every Plan is one."""

    @property
    def problem(self) -> Problem:
        """What was asked for."""
        ...

    @property
    def cell(self) -> Cell:
        """The robots that it is asked of."""
        ...


@dataclass(frozen=True)
class Given:
    """Problem and cell, before they are planned with."""

    problem: Problem
    cell: Cell
