"""Rows and the joints between them as one line, which reaches into the corners that rows leave at a slanting edge.

Where the edge leans away from a row's end, towards the next row, points of the edge are out of reach of both. Such an
end overshoots: the row bends a little towards the next one, and the joint comes back along the edge.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.toolpath.coverage.edge import InsetEdge
from planner.toolpath.coverage.joints import End, Joint
from planner.toolpath.coverage.levels import Row
from planner.toolpath.coverage.patches import Array

_WITHIN = 0.51  # spacings: how near the line comes to all points of the edge
_STEEPEST = 4.0  # 1 / sine of the angle between row and edge that is still made up for
_SHARE = 0.45  # of the way to the next row's end, at most
_BENT, _BENT_MORE = 0.1, 0.4  # spacings of the row that bend, and so many more for each by which the edge leans
_KEPT = 0.3  # of a row is not bent


@dataclass(frozen=True)
class _Over:
    """How far along the edge an end overshoots (with a sign) [m], and how much of the row bends towards that [m]."""

    arc: float = 0.0
    bent: float = 0.0


def stitched(
    rows: Sequence[Row], chain: Sequence[End], joints: Sequence[Joint], edge: InsetEdge, spacing: float
) -> Array:
    """One polyline (n, 3) of open rows, each entered at the end given, and of the joints between them."""
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
    """How an end overshoots, on the side where no joint is."""
    points, ends = rows[end[0]].points, rows[end[0]].ends
    if ends is None:
        return _Over()
    loop, arc = ends[end[1]]
    inward = points[1] - points[0] if end[1] == 0 else points[-2] - points[-1]
    along = edge.at(loop, arc + 0.2 * spacing) - edge.at(loop, arc - 0.2 * spacing)
    cosine = float(inward @ along / max(np.linalg.norm(inward) * np.linalg.norm(along), np.finfo(float).tiny))
    # the edge leans away in the sense in which it goes against the row's way inward
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
    """A row without what bends at its two ends [m]."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    most = 0.5 * (1.0 - _KEPT) * s[-1]
    start, stop = min(first, most), s[-1] - min(last, most)
    at = np.concatenate([[start], s[(s > start) & (s < stop)], [stop]])
    return np.stack([np.interp(at, s, points[:, i]) for i in range(3)], axis=1)


def _joint(joint: Joint, before: float, after: float, edge: InsetEdge) -> Array:
    """Points of a joint, which overshoots by so much at its two ends."""
    start, stop = joint.start + before, joint.stop + after
    head = [edge.at(joint.loop, start)] if before else []
    tail = [edge.at(joint.loop, stop)] if after else []
    return np.vstack([*head, edge.between(joint.loop, start, stop), *tail])


def _tail(rows: Sequence[Row], end: End, over: _Over, edge: InsetEdge) -> Array:
    """Where a line's own end overshoots."""
    ends = rows[end[0]].ends
    if ends is None or not over.arc:
        return np.empty((0, 3))
    loop, arc = ends[end[1]]
    return edge.at(loop, arc + over.arc)[None]
