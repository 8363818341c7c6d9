"""What lies under the print, for the scene: the part's surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from planner.toolpath.shape import Shape

SUNK = 0.15e-3  # m: the part is drawn this much smaller, so that the first layer is not half sunk into it


def part_data(shape: Shape | None) -> dict[str, Any] | None:
    """Points and normals (part frame, m) and corners of the part's surface, one after the other; None without a shape."""
    if shape is None:
        return None
    points = shape.vertices - SUNK * shape.normals
    return {
        "points": points.astype(np.float32).ravel(),
        "normals": shape.normals.astype(np.float32).ravel(),
        "corners": shape.triangles.astype(np.uint16 if len(points) <= np.iinfo(np.uint16).max else np.uint32).ravel(),
    }
