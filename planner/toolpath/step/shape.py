"""Faces of a STEP file as triangles, for pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from planner.toolpath.shape import Shape
from planner.toolpath.step.face import Face

_CELLS = 10  # along either parameter of a face


def faces_shape(faces: Sequence[Face]) -> Shape:
    """Triangles of faces: cells of their parameters, cut where the faces are trimmed."""
    vertices, normals = [], []
    for face in faces:
        uv = _triangles(face)
        points, out = face.points(uv), face.normals(uv)
        across = np.cross(points[1::3] - points[::3], points[2::3] - points[::3])
        turned = (across * out[::3]).sum(axis=1) < 0.0
        order = np.arange(len(uv)).reshape(-1, 3)
        order[turned] = order[turned][:, ::-1]
        vertices.append(points[order.ravel()])
        normals.append(out[order.ravel()])
    return Shape(np.vstack(vertices), np.vstack(normals), np.arange(sum(map(len, vertices))).reshape(-1, 3))


def _triangles(face: Face) -> np.ndarray:
    """Corners (3 k, 2) of k triangles in u and v."""
    outer, *holes = face.loops
    area = shapely.make_valid(shapely.Polygon(outer, holes))
    low, high = np.array(area.bounds).reshape(2, 2)
    u, v = (np.linspace(a, b, _CELLS + 1) for a, b in zip(low, high, strict=True))
    cells = shapely.box(*(edge.ravel() for edge in (*np.meshgrid(u[:-1], v[:-1]), *np.meshgrid(u[1:], v[1:]))))
    pieces = shapely.intersection(cells, area)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(pieces))
    corners = shapely.get_coordinates(triangles[shapely.area(triangles) > 0.0]).reshape(-1, 4, 2)
    return corners[:, :3].reshape(-1, 2)
