"""Which cells URScript can speak of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner.export.outputs import output_numbers

if TYPE_CHECKING:
    from planner.export.setup import Setup

STANDARD_OUTPUTS = 8  # of a control box, numbered from 0


def unsaid_in_urscript(setup: Setup) -> str | None:
    """Why no URScript program can say what a cell does; None if one can."""
    arm, holder = setup.cell.arm_robot, setup.cell.holder_robot
    if arm.language != "urscript":
        return f"{arm.name} is no arm of Universal Robots, by the language in its file"
    if holder is not None:
        return f"it moves the arm alone, and here {holder.name} moves the part"
    last = max(output_numbers(setup.problem).values())
    if last >= STANDARD_OUTPUTS:
        return f"an extruder has the output {last}, and the last one is {STANDARD_OUTPUTS - 1}"
    return None
