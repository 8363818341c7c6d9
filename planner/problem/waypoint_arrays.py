"""Waypoints that come from Python as arrays, where a problem file names a file of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.problem.fields import InMemory


@dataclass(frozen=True, eq=False)
class WaypointArrays(ReadOnlyArrays, InMemory):
    """Waypoints (n) in the part frame, as columns of a file would have them; made by `Toolpath.from_arrays`.

    points (n, 3) [m]; normals (n, 3) out of the part, of any length
    width, height (n) of the bead [m]; layer, bead (n) whole numbers; None where they are not given
    firsts  index of the first waypoint of each bead, where beads were given one by one; else None
    """

    points: Array
    normals: Array
    width: Array | None = None
    height: Array | None = None
    layer: Array | None = None
    bead: Array | None = None
    firsts: Ints | None = None

    def __len__(self) -> int:
        return len(self.points)

    def index(self, waypoint: int) -> str:
        """Where a waypoint stands in what was given: `[17]`, or `[2][17]` of beads that were given one by one."""
        if self.firsts is None:
            return f"[{waypoint}]"
        bead = int(np.searchsorted(self.firsts, waypoint, side="right")) - 1
        return f"[{bead}][{waypoint - int(self.firsts[bead])}]"

    def __str__(self) -> str:
        return f"{len(self)} waypoints from arrays"


Place = dict[str, Any]  # of an InputError: file and line, or field
