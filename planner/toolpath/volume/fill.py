"""What fills a region of the plane: beads along its outlines, and zig-zag lines in what they leave."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import shapely
import shapely.affinity

from planner.readonly import Array
from planner.toolpath.paths import length
from planner.toolpath.svg import PlanePath
from planner.toolpath.volume.solid import polygons

_FARTHEST = 3.0  # line distances, to the next line's end: farther, the zig-zag ends
_BESIDE = 0.1  # bead widths by which the way from line to line may leave the region: the bead at the wall takes it
_SPECK = 0.1  # bead widths: a line shorter than this only touches the region
_TRIES = 3  # distances of lines that are tried
_HAIR = 1e-6  # m: the outermost lines lie so far inside, else they are found or not by chance


def walls(region: shapely.MultiPolygon, width: float, count: int, chord: float, name: str) -> list[PlanePath]:
    """Closed paths of `count` beads along all outlines, side by side from the outside in; chord: of outlines [m]."""
    found: list[PlanePath] = []
    for number in range(count):
        inside = _inset(region, (number + 0.5) * width)
        for polygon in inside.geoms:
            for ring in (polygon.exterior, *polygon.interiors):
                points = np.asarray(ring.simplify(chord).coords)[:, :2]
                found.append(PlanePath(f"{name} wall {len(found) + 1}", points, True))
    return found


def zigzag(
    region: shapely.MultiPolygon, width: float, beside: int, density: float, angle: float, name: str
) -> list[PlanePath]:
    """Lines that fill a share `density` of what `beside` beads along the outlines leave, joined from end to end.

    angle: of the lines against x [rad]. The outermost lines lie half a bead from the outermost walls.
    """
    inside = shapely.affinity.rotate(_inset(region, (beside + 0.5) * width), -angle, (0.0, 0.0), use_radians=True)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    found: list[PlanePath] = []
    for polygon in inside.geoms:
        for chain in _filling(polygon, width, density):
            found.append(PlanePath(f"{name} infill {len(found) + 1}", chain @ turn, False))
    return found


def _inset(region: shapely.MultiPolygon, by: float) -> shapely.MultiPolygon:
    return polygons(region.buffer(-by, join_style="mitre"))


def _filling(polygon: shapely.Polygon, width: float, density: float) -> list[Array]:
    """Zig-zags (k, 2) whose length comes nearest to that share: their turns count, and there are whole lines only."""
    wanted = density * polygon.buffer(0.5 * width, join_style="mitre").area / width
    apart, best, least = width / density, [], np.inf
    for _ in range(_TRIES):
        chains = list(_chains(polygon, width, max(apart, width)))
        total = sum(length(chain) for chain in chains)
        if abs(total - wanted) < least:
            best, least = chains, abs(total - wanted)
        apart *= total / wanted
    return best


def _chains(polygon: shapely.Polygon, width: float, apart: float) -> Iterator[Array]:
    """Zig-zags (k, 2) along x through a polygon, their lines `apart` [m] or a little more or less."""
    rows = _rows(polygon, apart, _SPECK * width)
    near = shapely.prepared.prep(polygon.buffer(_BESIDE * width))
    while any(rows):
        first = next(i for i, row in enumerate(rows) if row)
        line = rows[first].pop(0)
        chain = [line]
        for row in rows[first + 1 :]:
            ways = [
                (float(np.hypot(*(end[0] - chain[-1][1]))), k, end)
                for k, piece in enumerate(row)
                for end in (piece, piece[::-1])
            ]
            size, k, following = min(ways, key=lambda way: way[0], default=(np.inf, -1, chain[-1]))
            if size > _FARTHEST * apart or not near.covers(shapely.LineString([chain[-1][1], following[0]])):
                break
            row.pop(k)
            chain.append(following)
        yield np.vstack(chain)


def _rows(polygon: shapely.Polygon, apart: float, least: float) -> list[list[Array]]:
    """Lines (2, 2) within a polygon, row by row upwards, each from left to right; longer than `least` [m]."""
    left, low, right, high = polygon.bounds
    count = max(round((high - low) / apart), 1) + 1
    rows = []
    for y in np.linspace(low + _HAIR, high - _HAIR, count):
        across = shapely.LineString([(left - apart, y), (right + apart, y)]).intersection(polygon)
        pieces = [np.asarray(part.coords) for part in shapely.get_parts(across) if part.length > least]
        rows.append(sorted(pieces, key=lambda piece: float(piece[0, 0])))
    return rows
