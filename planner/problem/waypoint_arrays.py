"""Waypoints given as arrays from Python, in place of a file of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.problem.fields import InMemory


@dataclass(frozen=True, eq=False)
class WaypointArrays(ReadOnlyArrays, InMemory):
    """Waypoints (n) in the part frame, like the columns of a file; made by `Toolpath.from_arrays`.

    Attributes:
        points: Positions (n, 3) of the nozzle tip [m].
        normals: Normals (n, 3) out of the part, of any length.
        width: Width (n,) of the bead [m]; None if not given.
        height: Height (n,) of the bead [m]; None if not given.
        layer: Whole numbers (n,) of the layers; None if not given.
        bead: Whole numbers (n,) of the beads; None if not given.
        firsts: Index of the first waypoint of each bead, where beads were given one by one; else None.
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
        """Index of a waypoint in the arrays given: `[17]`, or `[2][17]` if beads were given one by one.

        Args:
            waypoint: Its index among all waypoints.
        """
        if self.firsts is None:
            return f"[{waypoint}]"
        bead = int(np.searchsorted(self.firsts, waypoint, side="right")) - 1
        return f"[{bead}][{waypoint - int(self.firsts[bead])}]"

    def __str__(self) -> str:
        return f"{len(self)} waypoints from arrays"


Place = dict[str, Any]  # of an InputError: file and line, or field
