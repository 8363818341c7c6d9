"""The edge of the material, a little inside: there joints run from row to row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.toolpath.coverage.levels import Rim
from planner.toolpath.coverage.patches import Array
from planner.toolpath.coverage.sheet import Sheet


@dataclass(frozen=True)
class InsetEdge:
    """For each loop of the rim: arcs (k,) of its points [m], and these points moved onto the material (k, 3)."""

    arcs: tuple[Array, ...]
    points: tuple[Array, ...]
    around: Array

    @staticmethod
    def of(sheet: Sheet, rim: Rim, inset: float) -> InsetEdge:
        """inset: by how much they are moved [m]."""
        inward = _inward(sheet, rim)
        arcs, points = [], []
        for loop in range(len(rim.vertices)):
            on = rim.loop == loop
            sides = inward[on] + np.roll(inward[on], 1, axis=0)
            sides /= np.maximum(np.linalg.norm(sides, axis=1), np.finfo(float).tiny)[:, None]
            arcs.append(rim.arc[on])
            points.append(sheet.points[rim.edges[on, 0]] + inset * sides)
        return InsetEdge(tuple(arcs), tuple(points), rim.around)

    def between(self, loop: int, start: float, stop: float) -> Array:
        """Points (k, 3) strictly between two arcs of a loop [m], either of which may be beyond the loop's ends."""
        arcs, points = self._thrice(loop)
        return points[(arcs > start) & (arcs < stop)]

    def at(self, loop: int, arc: float) -> Array:
        """The point (3,) at an arc of a loop [m], at most once round beyond its ends."""
        arcs, points = self._thrice(loop)
        return np.array([np.interp(arc, arcs, points[:, i]) for i in range(3)])

    def _thrice(self, loop: int) -> tuple[Array, Array]:
        around = float(self.around[loop]) * np.arange(-1.0, 2.0)
        return np.concatenate([self.arcs[loop] + turn for turn in around]), np.tile(self.points[loop], (3, 1))


def _inward(sheet: Sheet, rim: Rim) -> Array:
    """Unit vectors (e, 3) from each edge of the rim into its triangle."""
    edges = np.sort(sheet.edges(), axis=1).reshape(-1, 3, 2)[sheet.material]
    net = sheet.triangles[sheet.material]
    n = len(sheet.points)
    key = (edges[..., 0] * n + edges[..., 1]).ravel()
    order = np.argsort(key, kind="stable")
    wanted = np.sort(rim.edges, axis=1)
    at = order[np.searchsorted(key[order], wanted[:, 0] * n + wanted[:, 1])]
    opposite = net[at // 3, (at % 3 + 2) % 3]  # edge 0 joins corners 0 and 1, so that 2 is opposite, and so on
    a, b, c = sheet.points[rim.edges[:, 0]], sheet.points[rim.edges[:, 1]], sheet.points[opposite]
    along = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
    into = (c - a) - np.einsum("ij,ij->i", c - a, along)[:, None] * along
    return into / np.linalg.norm(into, axis=1)[:, None]
