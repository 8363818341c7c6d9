"""Limits on the size of inputs: all in one table, each with its unit and its reason.

A file's contents are counted before they cost anything: before curves are rounded, facets become a mesh, or blocks are
expanded. Exceeding a limit raises an InputError that names what was counted, the limit, and what would fit.
"""

from __future__ import annotations

from dataclasses import dataclass

from planner.base.errors import Complaint, InputError


@dataclass(frozen=True)
class Limit:
    """A greatest count, its unit, and the reason for it."""

    most: int
    unit: str
    reason: str

    def check(self, count: float, what: str, complain: Complaint, hint: str | None = None) -> None:
        """Raise the InputError of `complain` if `count` exceeds the limit; what: how the message begins ("it has")."""
        if count > self.most:
            raise self.refusal(count, what, complain, hint)

    def refusal(self, count: float, what: str, complain: Complaint, hint: str | None = None) -> InputError:
        """The error that `check` raises; hint: what would fit."""
        return complain(f"{what} {round(count):,} {self.unit}; at most {self.most:,} are allowed", hint=hint)


# Of the whole print, whatever its source
WAYPOINTS = Limit(3_000_000, "waypoints", "1.26 million take 10 minutes and 7.8 GB on two cores")
BEADS = Limit(50_000, "beads", "20,000 take five minutes on two cores: each has a travel of its own")
BALLS = Limit(20_000_000, "places of the print to keep clear of", "0.4 kB each; flat beads have many")

# Problem files
YAML_BYTES = Limit(1_000_000, "bytes", "a problem is some 2 kB; curves are in files of their own")
YAML_VALUES = Limit(20_000, "values", "a problem has about 100; each is checked by itself")
YAML_DEPTH = Limit(20, "levels", "a problem's own fields go 5 deep")

# Drawings
SVG_BYTES = Limit(20_000_000, "bytes", "read in some 20 s")
SVG_ELEMENTS = Limit(100_000, "elements", "in the file, and again once every <use> is followed")
SVG_DEPTH = Limit(100, "levels", "of elements within elements: each is a call of a function")
SVG_SEGMENTS = Limit(200_000, "curves and lines", "0.1 ms each, of all paths together")
SVG_MATCHES = Limit(5_000_000, "tries of a style rule on an element", "some 2 us each")
SVG_CROSSINGS = Limit(200_000, "crossings", "of what clip paths and masks cut: each begins a face of its own")
SVG_WINDINGS = Limit(1_000_000_000, "looks from a face to a chord", "of the same: some 10 ns each")
DRAWING_POINTS = Limit(1_000_000, "points", "vertices of all chords: 16 bytes each, some 100 while they are rounded")
DXF_BYTES = Limit(50_000_000, "bytes", "read in about a minute")
DXF_ENTITIES = Limit(100_000, "entities", "blocks within blocks multiply: some 0.1 ms each")
DXF_DEPTH = Limit(16, "levels", "of blocks within blocks")

# Bodies
MESH_BYTES = Limit(600_000_000, "bytes", "two million facets as text")
MESH_FACETS = Limit(2_000_000, "facets", "read in 5 s with 1.5 GB as a binary STL file")
STEP_BYTES = Limit(100_000_000, "bytes", "another process reads them, in 300 s at most")
STEP_FACES = Limit(5_000, "faces", "read and converted in some 20 s")

# Paths given point by point
WAYPOINT_BYTES = Limit(500_000_000, "bytes", "some five million waypoints")
GCODE_BYTES = Limit(200_000_000, "bytes", "some six million moves: 40 s")
GCODE_MOVES = Limit(4_000_000, "extruding moves", "40 bytes each in a list, and a waypoint or more")

# Robots
URDF_BYTES = Limit(20_000_000, "bytes", "meshes are in files of their own")
LINKS = Limit(1_000, "links", "chains are walked link by link")


def table() -> tuple[tuple[str, Limit], ...]:
    """All limits by name, in the order of their definition."""
    return tuple((name, value) for name, value in globals().items() if isinstance(value, Limit))
