"""Rows of our own over faces: lines of equal distance from an edge or from a line through the middle.

They never cross, for they are lines of one function; they are joined along the edges (`joints.py`); of several
sources the one is taken whose strokes are done first.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from planner.toolpath.coverage.edge import InsetEdge
from planner.toolpath.coverage.fields import fields_of
from planner.toolpath.coverage.joints import End, Joint, chains, chosen, possible
from planner.toolpath.coverage.levels import Rim, Row, rows_at
from planner.toolpath.coverage.measures import Line, distances, farthest, seconds
from planner.toolpath.coverage.onto import onto_faces
from planner.toolpath.coverage.patches import Array, Ints, Patch, Stroke
from planner.toolpath.coverage.sheet import Sheet, sheet_of
from planner.toolpath.coverage.smooth import evenly, smooth

REACH = 0.55  # spacings: no point of a face is farther from the strokes
_MESH = 0.25  # spacings between points of the net
_INSET = 0.04  # spacings between the edge and where rows end and joints run
_KERNEL = 0.4  # spacings, half width of what turns a row's end: as wide as REACH allows
_STEP = 0.1  # spacings between points of a stroke
_FINE = 0.025  # spacings between points that are averaged
_SHORTEST = 0.3  # spacings: a shorter row is a dot
_ALONE = 0.53  # spacings from the rows: what is farther away has a row of its own
_TRIES = 3  # at rows of its own for what is left
_CLOSER = 0.97  # of the spacing, where strokes leave points out of reach
_CLOSEST = 5  # times closer, at most
_AIM = 0.543  # spacings: REACH, less what may be between the points that are looked at


class TooSmallError(ValueError):
    """No row fits onto the faces at this spacing."""


class NotCoveredError(ValueError):
    """Strokes would leave points of the faces farther away than REACH; `farthest`: how far [spacings]."""

    def __init__(self, farthest: float) -> None:
        self.farthest = farthest
        super().__init__(f"points of the faces are {farthest:.2f} spacings from the nearest row")


@dataclass(frozen=True)
class _Net:
    """The faces' net and what is asked of it again and again: its rim, normals (n, 3) at its points, a tree of these,
    and points all over the material (k, 3)."""

    sheet: Sheet
    rim: Rim
    normals: Array
    tree: cKDTree
    solid: Ints
    looked_at: Array


@dataclass(frozen=True)
class _Candidate:
    """Strokes before they are brought onto the faces, lines (n, 3) and whether closed; their time, about [s]; how far
    the farthest point of the material is [spacings]."""

    lines: tuple[tuple[Array, bool], ...]
    time: float
    farthest: float


def cover(patches: Sequence[Patch], spacing: float, speed: float) -> list[Stroke]:
    """Strokes over faces, sewn together where they meet: rows at most `spacing` [m] apart, printed at `speed` [m/s].

    No point of the faces is farther from them than REACH; they neither cross nor touch. Raises TooSmallError or
    NotCoveredError.
    """
    sheet = sheet_of(patches, _MESH * spacing)
    solid = np.unique(sheet.triangles[sheet.material])
    net = _Net(sheet, Rim.of(sheet), sheet.normals(), cKDTree(sheet.points), solid, sheet.looked_at())
    # the quickest first; one that leaves points out of reach comes back with its rows closer together
    queue: list[tuple[float, int, int, _Candidate]] = []
    fields = fields_of(sheet, net.rim, spacing)
    for k, field in enumerate(fields):
        _tried(queue, net, field, k, 0, spacing, speed)
    nearest = np.inf
    while queue:
        _, k, closer, best = heapq.heappop(queue)
        nearest = min(nearest, best.farthest)
        if best.farthest <= _AIM:
            return [onto_faces(sheet, line, closed) for line, closed in best.lines]
        if closer < _CLOSEST:
            _tried(queue, net, fields[k], k, closer + 1, spacing, speed)
    if np.isinf(nearest):
        raise TooSmallError("the faces are too small for a row at this spacing")
    raise NotCoveredError(nearest)


def _tried(
    queue: list[tuple[float, int, int, _Candidate]],
    net: _Net,
    field: Array,
    k: int,
    closer: int,
    spacing: float,
    speed: float,
) -> None:
    """Enter what comes of a field (the k-th) with rows so many times closer, if there are any."""
    found = _candidate(net, field, spacing, spacing * _CLOSER**closer, speed)
    if found is not None:
        heapq.heappush(queue, (found.time, k, closer, found))


def _candidate(net: _Net, field: Array, spacing: float, apart: float, speed: float) -> _Candidate | None:
    """Rows of one field at most `apart` [m] apart, joined and smoothed; None where there are none."""
    low, high = float(field[net.solid].min()), float(field[net.solid].max())
    count = max(int(np.ceil((high - low) / apart - 1e-6)), 1)
    heights: Array = np.linspace(low, high, 2 * count + 1)[1::2]
    rows = [
        row for k, height in enumerate(heights) for row in rows_at(net.sheet, net.rim, field, float(height), float(k))
    ]
    rows = _with_caps(net, field, rows, heights, spacing)
    rows = [cut for row in rows if (cut := _shortened(row, spacing)) is not None]
    if not rows:
        return None
    lines = _strokes(net.sheet, net.rim, rows, spacing)
    measured = [Line(line, net.normals[net.tree.query(line)[1]], closed) for line, closed in lines]
    time = seconds(measured, speed, _INSET * spacing)
    return _Candidate(tuple(lines), time, farthest(measured, net.looked_at) / spacing)


def _strokes(sheet: Sheet, rim: Rim, rows: Sequence[Row], spacing: float) -> list[tuple[Array, bool]]:
    """Rows joined into as few lines as can be, smoothed, in the order in which they are printed."""
    joints = chosen(possible(rows, rim.around, spacing), spacing)
    at = {end: joint for joint in joints for end in (joint.first, joint.second)}
    edge = InsetEdge.of(sheet, rim, _INSET * spacing)
    out = []
    for chain in chains(len(rows), joints):
        closed = rows[chain[0][0]].ends is None
        line = smooth(_line(rows, chain, at, edge), _KERNEL * spacing, _FINE * spacing, closed)
        out.append((evenly(line, _STEP * spacing, closed), closed))
    return _in_turn(out)


def _line(rows: Sequence[Row], chain: Sequence[End], at: dict[End, Joint], edge: InsetEdge) -> Array:
    """Rows of a chain and the joints between them as one polyline."""
    pieces = []
    for k, (row, entered) in enumerate(chain):
        points = rows[row].points
        pieces.append(points if entered == 0 else points[::-1])
        if k + 1 < len(chain):
            left = (row, 1 - entered)
            joint = at[left]
            between = edge.between(joint.loop, joint.start, joint.stop)
            pieces.append(between if joint.first == left else between[::-1])
    return np.vstack(pieces)


def _in_turn(lines: Sequence[tuple[Array, bool]]) -> list[tuple[Array, bool]]:
    """Lines one after the other, the nearest end first; open ones may be turned round."""
    left = list(lines)
    out = [left.pop(0)]
    while left:
        here = out[-1][0][0 if out[-1][1] else -1]
        far = [(float(np.linalg.norm(line[0] - here)), k, False) for k, (line, _) in enumerate(left)] + [
            (float(np.linalg.norm(line[-1] - here)), k, True) for k, (line, closed) in enumerate(left) if not closed
        ]
        _, k, back = min(far)
        line, closed = left.pop(k)
        out.append((line[::-1].copy() if back else line, closed))
    return out


def _shortened(row: Row, spacing: float) -> Row | None:
    """The row without what is too near the edge; None where hardly anything is left."""
    if row.ends is None:
        return row if row.length > _SHORTEST * spacing else None
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(row.points, axis=0), axis=1))])
    first, last = _INSET * spacing, s[-1] - _INSET * spacing
    if last - first < _SHORTEST * spacing:
        return None
    at = np.concatenate([[first], s[(s > first) & (s < last)], [last]])
    points = np.stack([np.interp(at, s, row.points[:, i]) for i in range(3)], axis=1)
    return replace(row, points=points)


def _with_caps(net: _Net, field: Array, rows: Sequence[Row], heights: Array, spacing: float) -> list[Row]:
    """Rows, and further ones half-way between the last of them and what it leaves out of reach, where the material ends
    between two levels."""
    out = list(rows)
    points = net.sheet.points[net.solid]
    for _ in range(_TRIES if out else 0):
        away = distances([row.points for row in out], points)
        if away.max() <= _ALONE * spacing:
            break
        worst = int(net.solid[np.argmax(away)])
        base = int(np.clip(np.searchsorted(heights, field[worst]) - 1, 0, len(heights) - 1))
        height = 0.5 * (heights[base] + field[worst])
        level = base + 0.5 * float(np.sign(field[worst] - heights[base]))
        near = [
            row
            for row in rows_at(net.sheet, net.rim, field, float(height), level)
            if np.linalg.norm(row.points - net.sheet.points[worst], axis=1).min() < spacing
            and row.length > _SHORTEST * spacing
        ]
        if not near:
            break
        out += near
    return out
