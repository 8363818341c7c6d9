"""Numbers of the controller's digital outputs that switch extruders, for languages that have no names for them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from planner.plan.materials import materials_of

if TYPE_CHECKING:
    from planner.export.program import Program
    from planner.problem import Problem


def output_numbers(problem: Problem) -> dict[str, int]:
    """Number of each extruder's output by its signal: the problem's own, and those after it for further materials."""
    signals = [each.signal for each in materials_of(problem)] or [problem.program.extruder_signal]
    return {signal: problem.program.extruder_output + k for k, signal in enumerate(signals)}


def named(program: Program, numbers: dict[str, int]) -> Program:
    """The program with signals in place of their outputs' numbers; a number that is none of theirs stays."""
    names = {str(number): signal for signal, number in numbers.items()}
    return replace(
        program,
        triggers={
            move: tuple(replace(each, signal=names.get(each.signal, each.signal)) for each in group)
            for move, group in program.triggers.items()
        },
    )
