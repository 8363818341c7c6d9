"""Which cells RAPID can speak of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planner.plan import RAPID_EXTERNAL_AXES

if TYPE_CHECKING:
    from planner.export.setup import Setup


def unsaid_in_rapid(setup: Setup) -> str | None:
    """Why no RAPID program can say what a cell does; None if one can."""
    arm, holder = setup.cell.arm_robot, setup.cell.holder_robot
    if not setup.cell.spherical:
        return f"the configuration of a target is that of a spherical wrist, which {arm.name} has not"
    if holder is not None and len(holder.joint_names) > RAPID_EXTERNAL_AXES:
        return f"{holder.name} has more axes than RAPID's {RAPID_EXTERNAL_AXES} external ones"
    return None
