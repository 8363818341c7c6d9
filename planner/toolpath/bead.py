"""Beads and toolpaths in the part frame, and bodies as triangles for pictures.

A Bead is one line of material; a Toolpath is all beads in print order, with the surface they lie on. A Shape is only
drawn: nothing is planned or checked with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.problem.waypoint_arrays import WaypointArrays

_AROUND = 96  # segments of a circle
_DOWN = 24  # rings of a dome
_ACROSS = 80  # squares of a skin along its longer side
MOST_TRIANGLES = 20_000  # in a picture: a browser still turns this many with ease


@dataclass(frozen=True)
class Shape(ReadOnlyArrays):
    """Triangles of a body's surface, counter-clockwise seen from outside.

    vertices (n, 3) [m], part frame; normals (n, 3) outward, of unit length; triangles (m, 3) indices of vertices
    """

    vertices: Array
    normals: Array
    triangles: Ints


def cylinder_shape(radius: float, height: float, centre: Array) -> Shape:
    """An upright cylinder on z = 0 with a lid; its axis is at centre (2)."""
    a = np.linspace(0.0, 2.0 * np.pi, _AROUND + 1)
    out = np.column_stack([np.cos(a), np.sin(a), np.zeros(_AROUND + 1)])
    bottom = radius * out + [*centre, 0.0]
    top = bottom + [0.0, 0.0, height]
    up = np.tile([0.0, 0.0, 1.0], (_AROUND + 2, 1))
    wall = _squares(2, _AROUND + 1)
    rim = 2 * (_AROUND + 1) + np.arange(_AROUND)
    lid = np.column_stack([rim, rim + 1, np.full(_AROUND, 3 * (_AROUND + 1))])
    vertices = np.vstack([bottom, top, top, [[*centre, height]]])
    return Shape(vertices, np.vstack([out, out, up]), np.vstack([wall, lid]))


def dome_shape(radius: float, centre: Array) -> Shape:
    """The part of a sphere above its own equator and above z = 0; centre (3)."""
    lowest = np.arccos(np.clip(-centre[2] / radius, 0.0, 1.0))
    down, around = np.meshgrid(
        np.linspace(0.0, lowest, _DOWN + 1), np.linspace(0.0, 2.0 * np.pi, _AROUND + 1), indexing="ij"
    )
    normals = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], axis=-1)
    normals = normals.reshape(-1, 3)
    return Shape(centre + radius * normals, normals, _squares(_DOWN + 1, _AROUND + 1)[:, ::-1])


def facets_shape(corners: Array) -> Shape | None:
    """Facets (n, 3, 3) unchanged; None if there are more than MOST_TRIANGLES."""
    if len(corners) > MOST_TRIANGLES:
        return None
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.repeat(across / np.linalg.norm(across, axis=1)[:, None], 3, axis=0)
    return Shape(corners.reshape(-1, 3), normals, np.arange(3 * len(corners)).reshape(-1, 3))


def skin_shape(at: Callable[[Array], tuple[Array, Array]], low: Array, high: Array) -> Shape:
    """The part of a surface over the rectangle low (2) to high (2); `at` gives points and normals at x, y (n, 2)."""
    step = float((high - low).max()) / _ACROSS
    axes = [np.linspace(a, b, max(2, int(np.ceil((b - a) / step)) + 1)) for a, b in zip(low, high, strict=True)]
    points, normals = at(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2))
    there = np.asarray(np.isfinite(points).all(axis=1))
    number = np.cumsum(there) - 1
    squares = _squares(len(axes[0]), len(axes[1]))
    return Shape(
        points[there], normals[there], number[squares[there[squares].all(axis=1)]][:, ::-1]
    )  # rows run along x


def _squares(rows: int, columns: int) -> Ints:
    """Triangles of a grid of vertices, counter-clockwise if columns run to the right and rows upwards."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above = corner + 1, corner + columns
    return np.vstack([np.column_stack([corner, right, above]), np.column_stack([right, above + 1, above])])


class Surface(Protocol):
    """The part's own surface, on which the first layer lies (metres, part frame); it may grow as beads are printed."""

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the solid part; negative inside."""
        ...

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the surface nearest to points (n, 3)."""
        ...

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Outward unit normals (n, 3) beneath a bead at arc lengths s (n) [m], with the nozzle tip at tips (n, 3)."""
        ...

    def before(self, bead: int) -> Surface:
        """The surface after the first `bead` beads have been printed, if it keeps track of them."""
        ...


@dataclass(frozen=True)
class SurfaceOver:
    """The same bodies as another surface, but with different or renumbered beads."""

    surface: Surface

    def signed_distance(self, points: Array) -> Array:
        """As for the underlying surface."""
        return self.surface.signed_distance(points)

    def normals(self, points: Array) -> Array:
        """As for the underlying surface."""
        return self.surface.normals(points)


@dataclass(frozen=True)
class Bead(ReadOnlyArrays):
    """One line of material, laid down without interruption.

    s         (n,)   arc length from the start, strictly increasing, s[0] = 0 [m]; the samples are
                     uniform in the curve's parameter and closer together where it turns sharply
    points    (n, 3) nozzle tip, part frame [m]
    normals   (n, 3) unit surface normal, out of the part; the nozzle axis is its negative
    roll_zero (n, 3) unit vector in the tangent plane from which roll about the normal is measured
    source    (m, 3) the input path before corners were rounded, same layer, part frame [m]
    width, height (n,) of the bead [m]
    closed         the last point repeats the first (both are kept)
    material       its name in process.materials; empty if they have no names
    short_runs     whether run-in and run-out are as short as possible, because longer ones are infeasible
    round          a strut in space: its section is a circle, width and height are its diameter
    speed          commanded [m/s]; None for the process's speed
    """

    name: str
    layer: int
    s: Array
    points: Array
    normals: Array
    roll_zero: Array
    source: Array
    width: Array
    height: Array
    closed: bool
    material: str = ""
    short_runs: tuple[bool, bool] = (False, False)
    round: bool = False
    speed: float | None = None

    @property
    def length(self) -> float:
        """Deposited length [m]."""
        return float(self.s[-1])

    def commanded(self, usual: float) -> float:
        """Commanded speed [m/s]; `usual` is the process's."""
        return usual if self.speed is None else self.speed


@dataclass(frozen=True)
class Split:
    """A place where a drawn bead is interrupted and continues as another bead.

    bead         index of the bead that begins there
    name, layer  of the drawn bead
    s            arc length along it [m]
    why          the reason, in words
    """

    bead: int
    name: str
    layer: int
    s: float
    why: str


@dataclass(frozen=True)
class Told:
    """The figures in a toolpath's notes: how far it departs from its input.

    left_out  share of the source's length, or of a body's volume, that is not printed
    open      share of a body's volume that stays open between walls
    held      share of the volume required by walls and infill that beads hold
    off       greatest distance of beads from a file's facets [m]; 0 if too small to report
    """

    left_out: float = 0.0
    open: float = 0.0
    held: float = 1.0
    off: float = 0.0


@dataclass(frozen=True)
class Toolpath:
    """All beads in print order, and the surface they lie on.

    Attributes:
        beads: The beads, in print order.
        surface: The surface on which the beads lie, part frame; its `before` gives it at each stage of the print.
        shape: Body to draw beneath the beads, if there is one.
        notes: Sentences for the user: what was left out of the input, or changed in it.
        solid: Facets (n, 3, 3) [m] of the whole body, part frame, if they are known exactly; otherwise its shape stands
            in for it.
        splits: Where drawn beads are laid in pieces.
        left_out: Lines (n, 3) that were drawn but are not printed [m], for display.
        told: The figures in the notes.
    """

    beads: tuple[Bead, ...]
    surface: Surface
    shape: Shape | None = None
    notes: tuple[str, ...] = ()
    solid: Array | None = None
    splits: tuple[Split, ...] = ()
    left_out: tuple[Array, ...] = ()
    told: Told = Told()

    @staticmethod
    def from_arrays(
        points: ArrayLike | Sequence[ArrayLike],
        normals: ArrayLike | Sequence[ArrayLike],
        *,
        bead: ArrayLike | None = None,
        layer: ArrayLike | Sequence[ArrayLike] | None = None,
        width: ArrayLike | Sequence[ArrayLike] | None = None,
        height: ArrayLike | Sequence[ArrayLike] | None = None,
        unit: Literal["m", "mm"] | None = None,
    ) -> WaypointArrays:
        """Waypoints from arrays, to be planned with `solve(load(problem, toolpath=...))` like those from a file.

        Corners are rounded, noise smoothed and crumbs left out as the problem's `process` and `layers.source` specify.

        Args:
            points: Positions (n, 3) of the nozzle tip, part frame, or a list of such arrays, one per bead.
            normals: Normals (n, 3) of the surface, out of the part, of any length, or one (3,) for all; in a list if
                points are.
            bead: Integers (n,): a bead ends where they change; by default, where a step is longer than three median
                steps. To be left out if points are given bead by bead.
            layer: Integers (n,), or one per bead of a list; by default, layers are derived from where beads lie.
            width: Widths (n,), one per bead of a list, or one for all; by default, that of `process.bead`.
            height: Heights (n,), one per bead of a list, or one for all; by default, that of `process.bead`.
            unit: Unit of points, width and height, "m" or "mm"; "m" by default, but required if the print is larger
                than 5 m.

        Returns:
            The waypoints, in the part frame [m].

        Raises:
            InputError: If an argument does not fit; it names the argument, index and shape.
        """
        from planner.toolpath.waypoints.arrays import waypoints_of

        return waypoints_of(points, normals, bead=bead, layer=layer, width=width, height=height, unit=unit)

    @property
    def length(self) -> float:
        """Deposited length of all beads [m]."""
        return sum(bead.length for bead in self.beads)

    @property
    def waypoints(self) -> int:
        """Number of waypoints of all beads."""
        return sum(len(bead.s) for bead in self.beads)

    @property
    def layers(self) -> int:
        """Number of layers."""
        return 1 + max(bead.layer for bead in self.beads)

    @property
    def lowest(self) -> tuple[Bead, ...]:
        """The beads of the lowest layer that has any: the first layer may be too narrow to print."""
        lowest = min(bead.layer for bead in self.beads)
        return tuple(bead for bead in self.beads if bead.layer == lowest)

    def layers_from(self, first: int) -> int:
        """Number of layers among the beads from an index on.

        Args:
            first: Index of the first bead that counts.
        """
        return len({bead.layer for bead in self.beads[first:]}) if first else self.layers
