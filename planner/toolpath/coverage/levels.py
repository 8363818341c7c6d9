"""Lines of equal distance on a net of triangles, cut where the material ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.toolpath.coverage.patches import Array, Ints
from planner.toolpath.coverage.sheet import Sheet


@dataclass(frozen=True)
class Rim:
    """The edges of the material: closed curves; loop (e,) and arc (e,), at the start of each edge [m], of edges (e, 2)
    with the material on one side only; edge_of: from an edge's points, the lower first, to its number; around: length
    of each curve [m]; vertices: its points in order."""

    edges: Ints
    edge_of: dict[tuple[int, int], int]
    loop: Ints
    arc: Array
    around: Array
    vertices: tuple[Ints, ...]

    @staticmethod
    def of(sheet: Sheet) -> Rim:
        """Chain the edges that have material on one side; the triangles' own sense is kept where they agree."""
        edges = sheet.edges().reshape(-1, 3, 2)[sheet.material].reshape(-1, 2)
        _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
        rim = edges[np.sort(first[count == 1])]
        at: dict[int, list[int]] = {}
        for k, (a, b) in enumerate(rim):
            at.setdefault(int(a), []).append(k)
            at.setdefault(int(b), []).append(k)
        used = np.zeros(len(rim), dtype=np.bool_)
        ordered: list[tuple[int, int]] = []
        loop: list[int] = []
        vertices: list[Ints] = []
        for seed in range(len(rim)):
            if used[seed]:
                continue
            used[seed] = True
            start, here = (int(i) for i in rim[seed])
            chain = [start, here]
            while here != start:
                on = next((k for k in at[here] if not used[k]), None)
                if on is None:
                    break
                used[on] = True
                a, b = (int(i) for i in rim[on])
                here = b if a == here else a
                chain.append(here)
            ordered += list(zip(chain[:-1], chain[1:], strict=True))
            loop += [len(vertices)] * (len(chain) - 1)
            vertices.append(np.array(chain[:-1], dtype=np.int64))
        pairs = np.array(ordered, dtype=np.int64).reshape(-1, 2)
        names = np.array(loop, dtype=np.int64)
        length = np.linalg.norm(sheet.points[pairs[:, 1]] - sheet.points[pairs[:, 0]], axis=1)
        around: Array = np.bincount(names, weights=length, minlength=len(vertices)).astype(np.float64)
        before = np.concatenate([[0.0], np.cumsum(length)[:-1]])
        arc = before - np.concatenate([[0.0], np.cumsum(around)])[names]
        edge_of = {(min(pair), max(pair)): k for k, pair in enumerate(ordered)}
        return Rim(pairs, edge_of, names, arc, around, tuple(vertices))


@dataclass(frozen=True)
class Row:
    """A line of equal distance on the material: points (n, 3) [m], level: its number. ends: (loop of the rim, arc
    there [m]) at which it starts and ends; none: it is closed, the first point not repeated."""

    points: Array
    level: float
    ends: tuple[tuple[int, float], tuple[int, float]] | None

    @property
    def length(self) -> float:
        """[m], closed rows without the last side."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


def rows_at(sheet: Sheet, rim: Rim, field: Array, height: float, level: float) -> list[Row]:
    """All pieces of the line on which `field` (n,) is `height`."""
    net = sheet.triangles[sheet.material]
    above = field >= height
    cut = net[above[net].any(axis=1) & ~above[net].all(axis=1)]
    if not len(cut):
        return []
    edges = np.stack([cut, np.roll(cut, -1, axis=1)], axis=2)
    crossed = above[edges[..., 0]] != above[edges[..., 1]]
    pairs = np.sort(edges[crossed], axis=1)  # two of each triangle, in a row
    nodes, node = np.unique(pairs, axis=0, return_inverse=True)
    links = node.reshape(-1, 2)
    share = (height - field[nodes[:, 0]]) / (field[nodes[:, 1]] - field[nodes[:, 0]])
    points = sheet.points[nodes[:, 0]] + share[:, None] * (sheet.points[nodes[:, 1]] - sheet.points[nodes[:, 0]])

    def end(k: int) -> tuple[int, float] | None:
        on = rim.edge_of.get((int(nodes[k, 0]), int(nodes[k, 1])))
        if on is None:
            return None
        return int(rim.loop[on]), float(rim.arc[on] + np.linalg.norm(points[k] - sheet.points[rim.edges[on, 0]]))

    out = []
    for chain, closed in _chains(links, len(nodes)):
        first, last = (None, None) if closed else (end(chain[0]), end(chain[-1]))
        both = (first, last) if first is not None and last is not None else None
        line = points[chain]
        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        line = line[np.concatenate([[True], step > 0.0])]
        if len(line) > 1:
            out.append(Row(line, level, both))
    return out


def _chains(links: Ints, count: int) -> list[tuple[list[int], bool]]:
    """Paths and cycles of a graph whose nodes have at most two links; (nodes, is a cycle)."""
    beside: list[list[int]] = [[] for _ in range(count)]
    for a, b in links:
        beside[int(a)].append(int(b))
        beside[int(b)].append(int(a))
    seen = np.zeros(count, dtype=np.bool_)
    out = []
    for ends_only in (True, False):
        for seed in range(count):
            if seen[seed] or (ends_only and len(beside[seed]) != 1):
                continue
            chain = [seed]
            seen[seed] = True
            while True:
                on = next((k for k in beside[chain[-1]] if not seen[k]), None)
                if on is None:
                    break
                seen[on] = True
                chain.append(on)
            out.append((chain, not ends_only))
    return out
