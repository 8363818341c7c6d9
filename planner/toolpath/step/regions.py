"""Faces that a bead may run across: those that meet without an edge to be felt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.readonly import Array
from planner.toolpath.step.face import Face
from planner.toolpath.step.trim import ON_THE_RIM

SMOOTH = np.radians(0.04)  # between normals along a shared edge: half of what the nozzle's axis may be off the normal


def smooth_regions(faces: Sequence[Face]) -> list[list[Face]]:
    """Groups of faces, in their order, that are joined by edges where the normal turns by less than SMOOTH.

    Over any other edge a nozzle on the normal would have to turn at one place: a bead ends there.
    """
    points = [np.vstack([face.points(loop) for loop in face.loops]) for face in faces]
    normals = [np.vstack([face.normals(loop) for loop in face.loops]) for face in faces]
    edges = [np.concatenate(face.edges) for face in faces]
    joined = []
    for i in range(len(faces)):
        for j in range(i + 1, len(faces)):
            if np.isin(edges[i], edges[j]).any() and _smooth(i, j, points, normals, edges):
                joined.append((i, j))
    a, b = np.array(joined, dtype=np.int64).reshape(-1, 2).T
    links = coo_array((np.ones(len(a)), (a, b)), shape=(len(faces), len(faces)))
    _, label = connected_components(links, directed=False)
    return [[face for face, own in zip(faces, label, strict=True) if own == k] for k in range(int(label.max()) + 1)]


def _smooth(i: int, j: int, points: list[Array], normals: list[Array], edges: list[NDArray[np.int64]]) -> bool:
    """Whether two faces meet smoothly along one of the edges that they share."""
    for edge in np.intersect1d(edges[i], edges[j]):
        a, b = edges[i] == edge, edges[j] == edge
        away, near = cKDTree(points[j][b]).query(points[i][a])
        same = away <= 2.0 * ON_THE_RIM
        cosine = (normals[i][a] * normals[j][b][near]).sum(axis=1)[same]
        if same.any() and cosine.min() >= np.cos(SMOOTH):
            return True
    return False
