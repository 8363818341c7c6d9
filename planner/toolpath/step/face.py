"""A face of a STEP file: a surface, the closed curves that trim it, and which side of it is out of the material."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planner.readonly import Array, Ints, ReadOnlyArrays
from planner.toolpath.step.splines import SplineSet, SplineSurface


@dataclass(frozen=True)
class Face(ReadOnlyArrays):
    """One face (metres, part frame), as algorithms that cover faces see it.

    number    in the file, from 1; name as it stands there, often empty
    loops     closed curves (m, 2) in u and v that trim it, the first point not repeated; the outer one first
    edges     for each loop, the number of the edge that each point stands on (the first of the two where edges meet);
              faces that share an edge share its number, and the places of its points
    side      1 where du x dv points out of the material, -1 where it points into it
    """

    number: int
    name: str
    surface: SplineSurface
    loops: tuple[Array, ...]
    edges: tuple[Ints, ...]
    side: int
    alone: SplineSet = field(repr=False)

    @property
    def title(self) -> str:
        """What a message calls it."""
        return f"face {self.number} {self.name!r}" if self.name else f"face {self.number}"

    def points(self, uv: Array) -> Array:
        """Points (n, 3) at parameters (n, 2) [m]."""
        return self.alone.points(np.zeros(len(uv), dtype=np.int64), uv)

    def normals(self, uv: Array) -> Array:
        """Unit outward normals (n, 3) at parameters (n, 2)."""
        return self.side * self.alone.normals(np.zeros(len(uv), dtype=np.int64), uv)
