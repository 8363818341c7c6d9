"""Rows joined end to end along the edge of the material, so that few strokes are left.

A joint runs a little inside the edge, from the end of one row to the next end there. Each joint has its own stretch of
the edge, so it crosses neither another joint nor a row. An integer program chooses the joints: it uses each end at most
once and closes no ring.

Where the edge leans away from a row's end, towards the next row, neither row reaches all of it. Such a row overshoots:
it bends a little towards the next one, and the joint comes back along the edge.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths
from planner.toolpath.coverage.sheet import FaceMesh, Rim, Row

_POWER = 4  # of the kernel (1 - x^2)^4: four times differentiable

End = tuple[int, int]  # row, and 0 for its first point or 1 for its last
_LONGEST = 4.0  # spacings along the edge: a longer joint would lie on the rows, which are nearly parallel to the edge
_NEXT = 1.01  # levels: rows less far apart are next to each other

_WITHIN = 0.51  # spacings: how near the line comes to all points of the edge
_STEEPEST = 4.0  # greatest 1 / sine of the angle between row and edge that is compensated for
_SHARE = 0.45  # × the distance to the next row's end: greatest overshoot
_BENT, _BENT_MORE = 0.1, 0.4  # spacings of the row that bend, and how many more for each by which the edge leans
_KEPT = 0.3  # share of a row that is not bent


@dataclass(frozen=True)
class InsetEdge:
    """For each loop of the rim: arc lengths (k,) of its points [m], and these points moved onto the material (k, 3)."""

    arcs: tuple[Array, ...]
    points: tuple[Array, ...]
    around: Array

    @staticmethod
    def of(sheet: FaceMesh, rim: Rim, inset: float) -> InsetEdge:
        """The edge of a net, moved onto the material by `inset` [m]."""
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
        """The point (3,) at an arc of a loop [m], at most one lap beyond its ends."""
        arcs, points = self._thrice(loop)
        return np.array([np.interp(arc, arcs, points[:, i]) for i in range(3)])

    def _thrice(self, loop: int) -> tuple[Array, Array]:
        around = float(self.around[loop]) * np.arange(-1.0, 2.0)
        return np.concatenate([self.arcs[loop] + turn for turn in around]), np.tile(self.points[loop], (3, 1))


def _inward(sheet: FaceMesh, rim: Rim) -> Array:
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


def evenly(line: Array, step: float, closed: bool) -> Array:
    """Points (m, 3) of a polyline (n, 3), about `step` apart; a closed one does not repeat its first point."""
    if closed:
        line = np.vstack([line, line[:1]])
    s = arc_lengths(line)
    count = max(round(s[-1] / step), 2)
    at = np.linspace(0.0, s[-1], count + 1)[: count + (not closed)]
    return np.stack([np.interp(at, s, line[:, i]) for i in range(line.shape[1])], axis=1)


def smooth(line: Array, half_width: float, step: float, closed: bool) -> Array:
    """A polyline (n, 3) averaged over `half_width` to both sides, points about `step` apart; open ends stay put."""
    even = evenly(line, step, closed)
    reach = min(max(round(half_width / step), 1), len(even) - 1)
    x = np.arange(-reach, reach + 1) / (reach + 1.0)
    kernel = (1.0 - x**2) ** _POWER
    kernel /= kernel.sum()
    if closed:
        return convolve1d(even, kernel, axis=0, mode="wrap")
    # beyond its ends, the line continues as its own point reflection in the end point
    before = 2.0 * even[0] - even[reach:0:-1]
    after = 2.0 * even[-1] - even[-2 : -2 - reach : -1]
    return convolve1d(np.vstack([before, even, after]), kernel, axis=0)[reach : reach + len(even)]


@dataclass(frozen=True)
class Joint:
    """A stretch of a loop of the edge from one end to another, in the loop's sense.

    It runs from arc `start` to `stop` [m], which may be on the next lap.
    """

    first: End
    second: End
    loop: int
    start: float
    stop: float

    @property
    def length(self) -> float:
        """Along the edge [m]."""
        return self.stop - self.start


def possible_joints(rows: Sequence[Row], around: Array, spacing: float) -> list[Joint]:
    """Joints between successive ends of adjacent rows along each loop of the rim (lengths `around`)."""
    ends: dict[int, list[tuple[float, End]]] = {}
    for k, row in enumerate(rows):
        if row.ends is not None:
            for side, (loop, arc) in enumerate(row.ends):
                ends.setdefault(loop, []).append((arc, (k, side)))
    out = []
    for loop, found in sorted(ends.items()):
        found.sort()
        for (start, one), (stop, two) in zip(found, found[1:] + found[:1], strict=True):
            if stop < start or len(found) == 1:
                stop += float(around[loop])
            beside = one[0] != two[0] and abs(rows[one[0]].level - rows[two[0]].level) < _NEXT
            if beside and stop - start < _LONGEST * spacing:
                out.append(Joint(one, two, loop, start, stop))
    return out


def chosen_joints(joints: Sequence[Joint], spacing: float) -> list[Joint]:
    """As many joints as possible without using an end twice or closing a ring; of equally many, the shortest."""
    if not joints:
        return []
    rows: list[tuple[dict[int, float], float]] = []
    used: dict[End, dict[int, float]] = {}
    for k, joint in enumerate(joints):
        for end in (joint.first, joint.second):
            used.setdefault(end, {})[k] = 1.0
    rows += [(row, 1.0) for row in used.values() if len(row) > 1]
    # one more joint is worth more than all their lengths
    total = sum(joint.length for joint in joints) + spacing
    price = np.array([joint.length / total for joint in joints]) - 1.0
    while True:
        limits = []
        if rows:
            at = [(i, k, value) for i, (row, _) in enumerate(rows) for k, value in row.items()]
            i, j, value = (np.array(column) for column in zip(*at, strict=True))
            matrix = csr_array((value, (i, j)), shape=(len(rows), len(joints)))
            limits = [LinearConstraint(matrix, ub=np.array([most for _, most in rows]))]
        found = milp(price, integrality=np.ones(len(joints)), bounds=Bounds(0.0, 1.0), constraints=limits)
        taken = [int(k) for k in np.flatnonzero(found.x > 0.5)]
        rings = _rings([joints[k] for k in taken])
        if not rings:
            return [joints[k] for k in taken]
        rows += [({taken[k]: 1.0 for k in ring}, len(ring) - 1.0) for ring in rings]


def _rings(joints: Sequence[Joint]) -> list[list[int]]:
    """Sets of joints that close a ring of rows."""
    parent: dict[int, int] = {}

    def root(row: int) -> int:
        while parent.setdefault(row, row) != row:
            row = parent[row]
        return row

    closing = set()
    for joint in joints:
        a, b = root(joint.first[0]), root(joint.second[0])
        if a == b:
            closing.add(a)
        else:
            parent[b] = a
    closing = {root(row) for row in closing}
    return [[k for k, joint in enumerate(joints) if root(joint.first[0]) == ring] for ring in sorted(closing)]


def row_chains(count: int, joints: Sequence[Joint]) -> list[list[End]]:
    """Strokes as the ends at which each of their rows is entered; each of `count` rows is in exactly one stroke."""
    beside: dict[End, End] = {}
    for joint in joints:
        beside[joint.first] = joint.second
        beside[joint.second] = joint.first
    seen: set[int] = set()
    out = []
    for row in range(count):
        free = [side for side in (0, 1) if (row, side) not in beside]
        if row in seen or not free:
            continue
        here: End | None = (row, free[0])
        chain = []
        while here is not None:
            chain.append(here)
            seen.add(here[0])
            here = beside.get((here[0], 1 - here[1]))
        out.append(chain)
    return out


@dataclass(frozen=True)
class _Over:
    """How far along the edge an end overshoots (signed) [m], and how much of the row bends towards that [m]."""

    arc: float = 0.0
    bent: float = 0.0


def stitched(
    rows: Sequence[Row], chain: Sequence[End], joints: Sequence[Joint], edge: InsetEdge, spacing: float
) -> Array:
    """One polyline (n, 3) of open rows, each entered at the given end, and the joints between them."""
    at = {end: joint for joint in joints for end in (joint.first, joint.second)}
    arcs: dict[int, list[float]] = {}
    for any_row in rows:
        for loop, arc in any_row.ends or ():
            arcs.setdefault(loop, []).append(arc)
    for found in arcs.values():
        found.sort()
    over = {
        end: _overshoot(rows, end, at.get(end), arcs, edge, spacing) for row, _ in chain for end in ((row, 0), (row, 1))
    }
    first, last = chain[0], (chain[-1][0], 1 - chain[-1][1])
    pieces = [_tail(rows, first, over[first], edge)[::-1]]
    for k, (row, entered) in enumerate(chain):
        points = _bent(rows[row].points, over[(row, 0)].bent, over[(row, 1)].bent)
        pieces.append(points if entered == 0 else points[::-1])
        if k + 1 < len(chain):
            left = (row, 1 - entered)
            joint = at[left]
            between = _joint(joint, over[joint.first].arc, over[joint.second].arc, edge)
            pieces.append(between if joint.first == left else between[::-1])
    pieces.append(_tail(rows, last, over[last], edge))
    return np.vstack(pieces)


def _overshoot(
    rows: Sequence[Row], end: End, joint: Joint | None, arcs: dict[int, list[float]], edge: InsetEdge, spacing: float
) -> _Over:
    """How an end overshoots, on the side without a joint."""
    points, ends = rows[end[0]].points, rows[end[0]].ends
    if ends is None:
        return _Over()
    loop, arc = ends[end[1]]
    inward = points[1] - points[0] if end[1] == 0 else points[-2] - points[-1]
    along = edge.at(loop, arc + 0.2 * spacing) - edge.at(loop, arc - 0.2 * spacing)
    cosine = float(inward @ along / max(np.linalg.norm(inward) * np.linalg.norm(along), np.finfo(float).tiny))
    # the edge leans away in the sense in which it runs against the row's direction inward
    sense = -np.sign(cosine)
    if joint is not None and sense == (1.0 if joint.first == end else -1.0):
        return _Over()
    steep = min(1.0 / max(float(np.sqrt(1.0 - min(cosine * cosine, 1.0))), 1e-6), _STEEPEST)
    rise = max(1.0 - _WITHIN * (1.0 + steep) / steep, 0.0)
    if rise == 0.0:
        return _Over()
    other = arcs[loop]
    k = bisect(other, arc) if sense > 0.0 else bisect(other, arc - 1e-12) - 1
    around = float(edge.around[loop])
    gap = (other[k % len(other)] - arc) * sense
    gap = gap if gap > 1e-12 else gap + around
    leaning = float(np.sqrt(steep * steep - 1.0))
    return _Over(float(sense) * min(rise * steep * spacing, _SHARE * gap), (_BENT + _BENT_MORE * leaning) * spacing)


def _bent(points: Array, first: float, last: float) -> Array:
    """A row without the lengths `first` and `last` [m] that bend at its ends."""
    s = arc_lengths(points)
    most = 0.5 * (1.0 - _KEPT) * s[-1]
    start, stop = min(first, most), s[-1] - min(last, most)
    at = np.concatenate([[start], s[(s > start) & (s < stop)], [stop]])
    return np.stack([np.interp(at, s, points[:, i]) for i in range(3)], axis=1)


def _joint(joint: Joint, before: float, after: float, edge: InsetEdge) -> Array:
    """Points of a joint that overshoots by `before` and `after` [m] at its ends."""
    start, stop = joint.start + before, joint.stop + after
    head = [edge.at(joint.loop, start)] if before else []
    tail = [edge.at(joint.loop, stop)] if after else []
    return np.vstack([*head, edge.between(joint.loop, start, stop), *tail])


def _tail(rows: Sequence[Row], end: End, over: _Over, edge: InsetEdge) -> Array:
    """The point (k, 3), if any, to which a line's own end overshoots."""
    ends = rows[end[0]].ends
    if ends is None or not over.arc:
        return np.empty((0, 3))
    loop, arc = ends[end[1]]
    return edge.at(loop, arc + over.arc)[None]
