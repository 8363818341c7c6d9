"""What path algorithms see of a face: the points that it was sampled at, and how far apart they are along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from planner.readonly import Array, Ints

# Samples nearer than this many spacings are neighbours. With a knight's move (2.24) among them, the shortest way over
# neighbours is at most 3 % longer than the straight one.
_REACH = 2.3
# Cosine of the angle between normals from which on two samples are on sheets that only lie close to each other.
_OTHER_SHEET = 0.0


@dataclass(frozen=True)
class SampledSurface:
    """points (n, 3) of faces and their unit outward normals (n, 3) [m, part frame]; parameters (n, 2), the u and v of
    each on its face; face (n,), its number; row (n,), the line of constant u (of constant v, where faces were sampled
    the other way) on which it stands, no number used twice; spacing: the desired distance along u and along v [m].
    """

    points: Array
    normals: Array
    parameters: Array
    face: Ints
    row: Ints
    spacing: tuple[float, float]

    def links(self) -> csr_array:
        """Chords between neighbours [m], (n, n) sparse and symmetric: the distance along the surface, near enough."""
        pairs = cKDTree(self.points).query_pairs(_REACH * max(self.spacing), output_type="ndarray")
        a, b = pairs[:, 0], pairs[:, 1]
        same = np.einsum("ij,ij->i", self.normals[a], self.normals[b]) > _OTHER_SHEET
        a, b = a[same], b[same]
        # a chord of length zero would be no link: samples at one place (a pole) are a hair apart
        chord = np.maximum(np.linalg.norm(self.points[a] - self.points[b], axis=1), np.finfo(float).tiny)
        n = len(self.points)
        return csr_array(
            (np.concatenate([chord, chord]), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n)
        )


def along_surface(surface: SampledSurface, links: csr_array, start: Ints) -> Array:
    """Distances (len(start), n) along the surface [m]: over the links; where none lead there, the chord through the
    air, longer than any way along the surface."""
    way = np.atleast_2d(dijkstra(links, indices=start))
    if np.isinf(way).any():
        longest = float(links.data.sum()) if links.nnz else 0.0
        chord = np.linalg.norm(surface.points[start][:, None] - surface.points, axis=2)
        way = np.where(np.isinf(way), longest + chord, way)
    return way
