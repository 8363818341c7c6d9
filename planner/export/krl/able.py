"""Which cells KRL can speak of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner.export.outputs import output_numbers

if TYPE_CHECKING:
    from planner.export.setup import Setup

EXTERNAL_AXES = 6  # E1 to E6


def unsaid_in_krl(setup: Setup) -> str | None:
    """Why no KRL program can say what a cell does; None if one can."""
    arm, holder = setup.cell.arm_robot, setup.cell.holder_robot
    if not setup.cell.spherical:
        return f"KR C controllers move arms with six axes and a spherical wrist, which {arm.name} is not"
    if holder is not None and holder.inverse is not None:
        return f"the part is held by an arm, {holder.name}, and external axes are those of a positioner"
    if holder is not None and len(holder.joint_names) > EXTERNAL_AXES:
        return f"{holder.name} has more axes than KRL's {EXTERNAL_AXES} external ones"
    if min(output_numbers(setup.problem).values()) < 1:
        return "outputs count from 1, and program.extruder_output is 0"
    return None
