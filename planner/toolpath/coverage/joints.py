"""Which rows are joined end to end, along the edge of the material, so that few strokes are left.

A joint runs along the edge from the end of one row to the next end there. Joints have pieces of the edge of their own,
so that none crosses another, or a row. Which of them are taken is an integer program: each end at most once, no ring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from planner.toolpath.coverage.levels import Row
from planner.toolpath.coverage.patches import Array

End = tuple[int, int]  # row, and 0 for its first point or 1 for its last

_LONGEST = 4.0  # spacings along the edge: where it is nearly parallel to the rows, a joint would lie on them
_NEXT = 1.01  # levels apart, of rows that are next to each other


@dataclass(frozen=True)
class Joint:
    """From one end along the loop's edge, in its sense, from arc `start` to `stop` [m] (past its end: all round)."""

    first: End
    second: End
    loop: int
    start: float
    stop: float

    @property
    def length(self) -> float:
        return self.stop - self.start


def possible(rows: Sequence[Row], around: Array, spacing: float) -> list[Joint]:
    """Joints between ends that follow each other along a loop of the rim (lengths `around`), rows next to each other."""
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


def chosen(joints: Sequence[Joint], spacing: float) -> list[Joint]:
    """As many of them as can be without an end used twice or a ring; of equally many, the shortest."""
    if not joints:
        return []
    rows: list[tuple[dict[int, float], float]] = []
    used: dict[End, dict[int, float]] = {}
    for k, joint in enumerate(joints):
        for end in (joint.first, joint.second):
            used.setdefault(end, {})[k] = 1.0
    rows += [(row, 1.0) for row in used.values() if len(row) > 1]
    # one joint more is worth more than all their lengths
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


def chains(count: int, joints: Sequence[Joint]) -> list[list[End]]:
    """Strokes as the ends at which each of their rows is entered, every one of `count` rows in one stroke."""
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
