"""What runs of a print taught: the section `as_run`, by which its program asks for something else than the plan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from planner.problem.fields import PATH, Quantity, Section, key


class AsRunSpec(Section):
    """By how much the program leaves the plan so that the robot keeps to it; see beadwise learn."""

    corrections: Annotated[Path, PATH] = key(
        "corrections", "the file that beadwise learn wrote (CSV), counted from the folder of the problem file"
    )
    most: Annotated[float, Quantity("mm", 0.01, 5)] = key(
        "most_mm", "by how much the program may ask for places off the plan, at most [mm]", 1
    )
