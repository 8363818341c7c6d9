"""Faces as `rows` sees them, and the strokes that cover them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planner.readonly import Array, Ints


class Patch(Protocol):
    """One face: a surface over (u, v), and the closed curves that trim it.

    loops: closed polylines (m, 2) in (u, v), the first point not repeated; the outer one first, then holes. Their points
    are at most a quarter of the spacing of rows apart on the surface. Where two faces meet (or a face meets itself, as
    a cylinder does), both list the same points in space: that is how a seam is known. points and normals must answer
    in holes too, and a little beyond the outer loop.
    """

    @property
    def loops(self) -> tuple[Array, ...]: ...

    def points(self, uv: Array) -> Array:
        """Points (n, 3) at parameters (n, 2) [m]."""
        ...

    def normals(self, uv: Array) -> Array:
        """Unit outward normals (n, 3) at parameters (n, 2)."""
        ...


@dataclass(frozen=True)
class Stroke:
    """A curve on the faces, printed without a break: points (n, 3) and unit normals (n, 3) on the true surface [m],
    patch (n,), the number of the face each stands on, and parameters (n, 2) there; closed: the last point is joined to
    the first (which is not repeated)."""

    points: Array
    normals: Array
    patch: Ints
    parameters: Array
    closed: bool = False
