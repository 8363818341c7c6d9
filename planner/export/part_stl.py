"""report_part.stl: the body under the print as triangles, for pictures and for whoever looks at the trajectory elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

if TYPE_CHECKING:
    from planner.toolpath.shape import Shape


def part_stl(shape: Shape) -> bytes:
    """A binary STL file of a shape: millimetres, part frame."""
    import trimesh  # a third of a second, and most problems have no part of their own

    mesh = trimesh.Trimesh(np.round(shape.vertices * 1e3, 4), shape.triangles, process=False)
    return cast(bytes, mesh.export(file_type="stl"))
