"""Loose lines of a drawing, joined where their ends meet."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints

End = tuple[int, int]  # a line, and its end: 0 or 1
_ALONG = 1.0 - 1e-9  # least cosine between the directions of lines that lie on each other
_AT = 0.01  # × the joining distance: ends of such lines this near are at the same place


@dataclass(frozen=True)
class DrawnLine:
    """A line of a drawing, (n, 2) in its units; only lines of the same `group` are joined."""

    name: str
    group: str
    points: Array
    closed: bool


def joined(lines: Sequence[DrawnLine], join: float) -> list[DrawnLine]:
    """Join the lines of a group whose ends are at most `join` apart; results are in the order of their first parts.

    Where more than two ends meet, those that continue straightest are joined, but none whose lines lie on each other
    there.
    """
    partner: dict[End, End] = {}
    for group in dict.fromkeys(line.group for line in lines):
        loose = [i for i, line in enumerate(lines) if line.group == group and not line.closed]
        if loose:
            partner |= _pairs(lines, loose, join)
    out, used = [], set[int]()
    for i, line in enumerate(lines):
        if i in used:
            continue
        run, closed = _run(i, partner)
        used.update(k for k, _ in run)
        if len(run) == 1 and not closed:
            out.append(line)
            continue
        points = np.vstack([lines[k].points[:: -1 if back else 1] for k, back in run])
        name = line.name if len(run) == 1 else f"{lines[run[0][0]].name} and {len(run) - 1} more"
        out.append(DrawnLine(name, line.group, points, closed))
    return out


def _pairs(lines: Sequence[DrawnLine], loose: Sequence[int], join: float) -> dict[End, End]:
    """The partner of each end that is joined to another."""
    ends: list[End] = [(i, k) for i in loose for k in (0, 1)]
    places = np.array([lines[i].points[-k] for i, k in ends])
    near = cKDTree(places).query_pairs(join, output_type="ndarray")
    size = len(ends)
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(size, size))
    _, label = connected_components(links, directed=False)
    out: dict[End, End] = {}
    for members in _groups(label):
        ways = [_leaving(lines[ends[m][0]].points, ends[m][1]) for m in members]
        straight = sorted(
            (ends[members[a]][0] == ends[members[b]][0], float(ways[a] @ ways[b]), a, b)
            for a in range(len(members))
            for b in range(a)
        )
        free = set(range(len(members)))
        for own, cosine, a, b in straight:
            speck = own and np.ptp(lines[ends[members[a]][0]].points, axis=0).max() <= 2.0 * join
            apart = np.hypot(*(places[members[a]] - places[members[b]]))
            double = cosine > _ALONG and apart <= _AT * join
            if a in free and b in free and not (speck or double):
                free -= {a, b}
                one, other = ends[members[a]], ends[members[b]]
                out |= {one: other, other: one}
    return out


def _groups(label: Ints) -> Iterable[Ints]:
    order = np.argsort(label, kind="stable")
    return (part for part in np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(part) > 1)


def _leaving(points: Array, end: int) -> Array:
    """The direction (2) in which a line leaves one of its ends."""
    way = points[1] - points[0] if end == 0 else points[-2] - points[-1]
    return np.asarray(way / max(float(np.hypot(*way)), np.finfo(float).tiny))


def _run(start: int, partner: dict[End, End]) -> tuple[list[tuple[int, bool]], bool]:
    """The lines joined to line `start`, in order, each with whether it runs backwards; and whether they close."""
    first, back = start, False  # begin where the chain begins, if it has a beginning
    seen = {start}
    while (before := partner.get((first, 1 if back else 0))) is not None:
        if before[0] in seen:
            break
        first, back = before[0], before[1] == 0
        seen.add(first)
    run = [(first, back)]
    while True:
        i, back = run[-1]
        after = partner.get((i, 0 if back else 1))
        if after is None:
            return run, False
        if after[0] == run[0][0]:
            return run, True
        run.append((after[0], after[1] == 1))
