"""Sources from which distances along faces are measured: sides of their edges, and lines through their middle."""

from __future__ import annotations

import numpy as np

from planner.toolpath.coverage.levels import Rim
from planner.toolpath.coverage.marching import march
from planner.toolpath.coverage.patches import Array, Ints
from planner.toolpath.coverage.sheet import Sheet

_CORNER = np.radians(30.0)  # of an edge, within a spacing: there one side ends and the next begins
_SIDES = 4  # the longest sides are tried as sources
_DIRECTIONS = 6  # and so many lines through the middle


def fields_of(sheet: Sheet, rim: Rim, spacing: float) -> list[Array]:
    """Distances of the net's points from each source (n,) [m], with a sign where the source has two sides."""
    out = []
    sides = [side for loop in rim.vertices for side in _sides(sheet, loop, spacing)]
    sides.sort(key=lambda side: -float(np.linalg.norm(np.diff(sheet.points[side], axis=0), axis=1).sum()))
    for side in sides[:_SIDES]:
        start = np.full(len(sheet.points), np.inf)
        start[side] = 0.0
        out.append(march(sheet.points, sheet.triangles, start))
    corners = sheet.points[sheet.triangles[sheet.material]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = np.average(corners.mean(axis=1), axis=0, weights=area)
    centre = int(np.argmin(np.linalg.norm(sheet.points - middle, axis=1)))
    spread = sheet.points - sheet.points[centre]
    axes = np.linalg.svd(sheet.points - middle, full_matrices=False)[2]
    for k in range(_DIRECTIONS):
        angle = np.pi * k / _DIRECTIONS
        out.append(_from_section(sheet, spread @ (np.cos(angle) * axes[0] + np.sin(angle) * axes[1])))
    return [field for field in out if np.isfinite(field[sheet.triangles]).all()]


def _sides(sheet: Sheet, loop: Ints, spacing: float) -> list[Ints]:
    """Pieces of a rim between its corners; none where it has fewer than two."""
    points = sheet.points[loop]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(np.vstack([points, points[:1]]), axis=0), axis=1))])
    n = len(loop)
    ahead = np.array([_at(points, s, s[i] + 0.5 * spacing) for i in range(n)])
    behind = np.array([_at(points, s, s[i] - 0.5 * spacing) for i in range(n)])
    one, two = points - behind, ahead - points
    cosine = np.einsum("ij,ij->i", one, two) / np.maximum(
        np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1), np.finfo(float).tiny
    )
    bent = cosine < np.cos(_CORNER)
    if not bent.any() or bent.all():
        return []
    # of the points beside a corner, the one where the edge turns most
    shift = int(np.flatnonzero(~bent)[0])
    bent, cosine, order = np.roll(bent, -shift), np.roll(cosine, -shift), np.roll(loop, -shift)
    runs = np.flatnonzero(np.diff(bent.astype(np.int64)) == 1) + 1
    stops = np.flatnonzero(np.diff(np.append(bent, False).astype(np.int64)) == -1) + 1
    corner = [a + int(np.argmin(cosine[a:b])) for a, b in zip(runs, stops, strict=True)]
    if len(corner) < 2:
        return []
    twice = np.concatenate([order, order])
    return [twice[a : b + 1] for a, b in zip(corner, [*corner[1:], corner[0] + n], strict=True)]


def _at(points: Array, s: Array, where: float) -> Array:
    """The point of a closed polyline at arc `where` [m], any turn."""
    closed = np.vstack([points, points[:1]])
    return np.array([np.interp(where % s[-1], s, closed[:, i]) for i in range(3)])


def _from_section(sheet: Sheet, height: Array) -> Array:
    """Signed distance along the net from the line where `height` (n,) is nought."""
    corners, values = sheet.points[sheet.triangles], height[sheet.triangles]
    cut = (values > 0.0).any(axis=1) & (values <= 0.0).any(axis=1)
    e, f = corners[cut, 1] - corners[cut, 0], corners[cut, 2] - corners[cut, 0]
    de, df = values[cut, 1] - values[cut, 0], values[cut, 2] - values[cut, 0]
    ee, ef, ff = (np.einsum("ij,ij->i", x, y) for x, y in ((e, e), (e, f), (f, f)))
    slope = np.sqrt((de * de * ff - 2.0 * de * df * ef + df * df * ee) / (ee * ff - ef * ef))
    start = np.full(len(height), np.inf)
    np.minimum.at(start, sheet.triangles[cut], np.abs(values[cut]) / slope[:, None])
    return np.where(height > 0.0, 1.0, -1.0) * march(sheet.points, sheet.triangles, start)
