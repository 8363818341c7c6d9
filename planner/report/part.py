"""What lies under the print: the part as a shaded solid, beads that were there before; and where it is looked at from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.report.thinning import keep_minima, turning

if TYPE_CHECKING:
    from planner.toolpath.bead import Bead
    from planner.toolpath.shape import Shape

Array = NDArray[np.float64]

PART_LIT, PART_DARK = np.array([238.0, 242.0, 246.0]), np.array([176.0, 187.0, 199.0])
EARLIER = "#b9c4cf"  # beads of which no motion is shown: they were there before
SUNK_MM = 0.15  # the part is drawn this much smaller, so that the first layer's lines are not half sunk into it


def part_traces(shape: Shape | None, facing: Array) -> list[dict[str, Any]]:
    """The part as a light solid, where its shape is known, lit from where the print is seen."""
    if shape is None:
        return []
    vertices = (shape.vertices * 1e3 - SUNK_MM * shape.normals).astype(np.float32)
    corners = shape.triangles.astype(np.uint16 if len(vertices) <= np.iinfo(np.uint16).max else np.uint32)
    return [
        {
            "type": "mesh3d",
            **{axis: vertices[:, k].copy() for k, axis in enumerate("xyz")},
            **{corner: corners[:, k].copy() for k, corner in enumerate("ijk")},
            # Shaded here: plotly lights an orthographic scene evenly, and a round part would look flat.
            "vertexcolor": _shade(shape.normals, facing),
            # Opaque at first: plotly does not sort translucent triangles, and stripes would show.
            "opacity": 1.0,
            "hoverinfo": "skip",
            "lighting": {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0, "fresnel": 0.0},
        }
    ]


def earlier_beads(beads: Sequence[Bead], budget: int) -> Array:
    """Points (n, 3) [m] of beads that are there before the motion, thinned; NaN between beads."""
    if not beads:
        return np.empty((0, 3))
    points = np.concatenate([bead.points for bead in beads])
    counts = np.array([len(bead.points) for bead in beads], dtype=np.intp)
    last = np.cumsum(counts) - 1
    first = last + 1 - counts
    sharp = turning(points, first, last)
    kept = keep_minima([-sharp, np.zeros(len(points))], budget, np.union1d(first, last))
    return np.insert(points[kept], np.flatnonzero(np.isin(kept, first))[1:], np.nan, axis=0)


def earlier_traces(beads: Sequence[Bead], budget: int) -> list[dict[str, Any]]:
    """The same as one pale line; nothing without such beads."""
    x, y, z = (1e3 * earlier_beads(beads, budget)).astype(np.float32).T
    line = {"type": "scatter3d", "mode": "lines", "x": x, "y": y, "z": z, "line": {"width": 3, "color": EARLIER}}
    return [line | {"hoverinfo": "skip", "showlegend": False}] if beads else []


def eye(facing: Array) -> dict[str, float]:
    """Camera direction: from where the print faces, a little from above; a fixed one if it faces everywhere."""
    flat = float(np.hypot(facing[0], facing[1]))
    sideways = flat > 0.15
    azimuth = (np.arctan2(facing[1], facing[0]) if sideways else np.radians(-60.0)) + np.radians(18.0)
    out, up = (1.6, 0.55) if sideways else (1.35, 1.1)
    return {"x": round(out * float(np.cos(azimuth)), 3), "y": round(out * float(np.sin(azimuth)), 3), "z": up}


def _shade(normals: Array, facing: Array) -> list[str]:
    """Colours of a matt surface with `normals` (n, 3), lit from beside and above the camera."""
    at = eye(facing)
    side = np.array([-at["y"], at["x"], 0.0])
    light = np.array([at["x"], at["y"], 0.9]) - 0.6 * side
    lit = np.clip(normals @ (light / np.linalg.norm(light)), 0.0, 1.0)[:, None]
    colours = np.round(PART_DARK + lit * (PART_LIT - PART_DARK)).astype(int)
    return [f"rgb({r},{g},{b})" for r, g, b in colours]
