"""Corrections learned from runs of a print: the section `as_run`, by which its program departs from the plan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from planner.problem.fields import PATH, Quantity, Section, key


class AsRunSpec(Section):
    """How far the program departs from the plan so that the robot follows the plan; see beadwise learn."""

    corrections: Annotated[Path, PATH] = key(
        "corrections", "the file that beadwise learn wrote (CSV), path relative to the problem file's folder"
    )
    most: Annotated[float, Quantity("mm", 0.01, 5)] = key(
        "most_mm", "how far places in the program may be from the plan [mm]", 1
    )
