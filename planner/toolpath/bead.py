"""Bead and Toolpath: what is to be printed, in the part frame, before any robot is thought of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planner.readonly import Array, ReadOnlyArrays
from planner.toolpath.shape import Shape


class Surface(Protocol):
    """The part's own surface, on which the first layer lies (metres, part frame); it may grow as beads are printed."""

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the solid part; negative inside."""
        ...

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the surface nearest to points (n, 3)."""
        ...

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Outward unit normals (n, 3) on which a bead is laid at arc lengths s (n) [m], the nozzle's tip at tips (n, 3)."""
        ...

    def before(self, bead: int) -> Surface:
        """The surface when the first `bead` beads have been printed, if it knows of them."""
        ...


@dataclass(frozen=True)
class Bead(ReadOnlyArrays):
    """One line of material, laid down without interruption.

    s         (n,)   arc length from the start, strictly increasing, s[0] = 0 [m]; the samples are
                     uniform in the curve's parameter and draw together where it turns sharply
    points    (n, 3) nozzle tip, part frame [m]
    normals   (n, 3) unit surface normal, out of the part; the nozzle axis is its negative
    roll_zero (n, 3) unit vector in the tangent plane from which roll about the normal is counted
    source    (m, 3) the input path before corners were rounded, same layer, part frame [m]
    width, height (n,) of the bead [m]
    closed         the last point is the first one again (both are kept)
    material       its name in process.materials; empty where they have no names
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

    @property
    def length(self) -> float:
        """Deposited length [m]."""
        return float(self.s[-1])


@dataclass(frozen=True)
class Toolpath:
    """All beads in print order, and the surface they lie on.

    shape  of a body to draw beneath them, if there is one
    solid  (n, 3, 3) facets [m] of the whole body, where they are known exactly; else its shape stands for it
    notes  sentences for the user: what was left out of the input, or changed in it
    """

    beads: tuple[Bead, ...]
    surface: Surface
    shape: Shape | None = None
    notes: tuple[str, ...] = ()
    solid: Array | None = None

    @property
    def length(self) -> float:
        """Deposited length of all beads [m]."""
        return sum(bead.length for bead in self.beads)

    @property
    def layers(self) -> int:
        """Number of layers."""
        return 1 + max(bead.layer for bead in self.beads)

    def layers_from(self, first: int) -> int:
        """Number of layers that beads from index `first` on belong to."""
        return len({bead.layer for bead in self.beads[first:]}) if first else self.layers
