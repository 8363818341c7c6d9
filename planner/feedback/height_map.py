"""The height map of a print: how far the top of a layer is from where it was planned, place by place, from a cloud of points.

The planned top of a layer is what the nozzle's tip went along. Its beads are cut into cells about as long as wide; of a
cell's points, which lie in the middle of the bead's width, the mean of those near the median counts. Cells that disagree
with those around them are left out, and what has too few points is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import MAD_TO_SIGMA, Array, Flags, Ints, ReadOnlyArrays
from planner.base.errors import Complaint
from planner.toolpath.as_printed import DeviationField
from planner.toolpath.bead import Toolpath

ACROSS = 0.3  # of a bead's width to either side: there its top is flat, farther out it falls away
LONGEST_CELL = 3e-3  # m along and across a bead, or ACROSS of a wider one: over more, a print may bend
WINDOW, WINDOW_SHARE = 3e-3, 0.5  # m, or of a bead's height: a print farther off is elsewhere, or of another layer
FEWEST = 4  # points of a cell: the median of fewer can be an outlier
SCATTER, SCATTER_SHARE = 0.35e-3, 0.1  # m, or of a bead's height, robust deviation of a cell: more is of two surfaces
LEAST_COVERED = 0.6  # share of the layer's cells that must be measured
ELSEWHERE = 0.3  # share of cells with any point near them, below which the cloud is not of this layer
_ALIKE = 8.0  # times as large, or as small, that a cloud and its layer may be: a scan sees more, or less
_DENSE = 0.15  # of a bead's width between places by which points find their cell
_NEAR_MEDIAN = 3.0  # robust deviations, within which points count
_LEAST_SCATTER = 0.02e-3  # m
_ODD, _LEAST_ODD = 5.0, 0.1e-3  # robust deviations, and m, by which a cell that is left out is off what lies around it
_ROUNDS = 3
_GROWN = 2.5  # times the radius, step by step, from which holes are interpolated


@dataclass(frozen=True)
class PlannedTop(ReadOnlyArrays):
    """The top of a layer as it was planned: places (n) along the middles of its beads, and cells (m) of these.

    points, normals (n, 3)   part frame [m], normals outward and of unit length
    width (n)                of the bead [m]
    cell (n)                 which cell each place is of
    middle, out (m, 3)       place in the middle of each cell, and its normal
    bead (m), s (m)          the cell's bead, and the arc length of its middle [m]
    high (m)                 height of the bead there [m]
    """

    points: Array
    normals: Array
    width: Array
    cell: Ints
    middle: Array
    out: Array
    bead: Ints
    s: Array
    high: Array

    @property
    def window(self) -> Array:
        """How far (m) from the planned top the points of each cell may lie [m]."""
        return np.asarray(np.maximum(WINDOW, WINDOW_SHARE * self.high))

    @property
    def most_scatter(self) -> Array:
        """Robust deviation (m) that the points of each cell may have [m]."""
        return np.asarray(np.maximum(SCATTER, SCATTER_SHARE * self.high))


@dataclass(frozen=True)
class HeightMap(ReadOnlyArrays):
    """How far the top of a layer is from where it was planned, in cells (m).

    deviation (m)   along the normal, positive where the print is too high [m]; interpolated where not measured
    measured (m)    whether points told it;  count (m) how many points;  scatter (m) their robust deviation [m]
    smoothed (m)    deviation smoothed over `radius` [m]: what layers above make up for
    widest_hole     from a cell that is interpolated to the nearest measured one, at most [m]
    """

    top: PlannedTop
    deviation: Array
    measured: Flags
    count: Ints
    scatter: Array
    smoothed: Array
    radius: float
    widest_hole: float

    @property
    def covered(self) -> float:
        """Share of the cells that were measured."""
        return float(self.measured.mean())

    @property
    def noise(self) -> float:
        """Robust deviation of measured cells from the smoothed map [m]."""
        return robust(self.deviation[self.measured] - self.smoothed[self.measured])


def planned_top(toolpath: Toolpath, layer: int) -> PlannedTop:
    """The planned top of a layer, counted from 1."""
    parts = []
    cells = 0
    for i, bead in enumerate(toolpath.beads):
        if bead.layer != layer - 1:
            continue
        width = float(bead.width.mean())
        longest = max(LONGEST_CELL, ACROSS * width)
        count = max(int(np.ceil(bead.length / min(width, longest))), 1)
        per = max(int(np.ceil(1.0 / _DENSE)), 2)
        s = (np.arange(count * per) + 0.5) * bead.length / (count * per)
        middles = (np.arange(count) + 0.5) * bead.length / count

        def along(at: Array, values: Array, s: Array = bead.s) -> Array:
            return np.stack([np.interp(at, s, column) for column in values.T], axis=1)

        normals, out = _unit(along(s, bead.normals)), _unit(along(middles, bead.normals))
        of = cells + np.repeat(np.arange(count), per)
        cells += count
        widths = np.interp(s, bead.s, bead.width)
        numbers, high = np.full(count, i), np.interp(middles, bead.s, bead.height)
        cell = along(middles, bead.points), out, numbers, middles, high
        parts.append((along(s, bead.points), normals, widths, of, *cell))
    return PlannedTop(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def height_map(top: PlannedTop, cloud: Array, radius: float, complain: Complaint) -> HeightMap:
    """The map of a layer by a cloud (n, 3) in the part frame [m], smoothed over a radius [m].

    Raises InputError, made by `complain`, for a cloud that lies elsewhere, or covers too little of the layer.
    """
    check_place(top, cloud, complain)
    height, cell = _heights(top, cloud)
    deviation, scatter, count = _cells(height, cell, len(top.middle))
    measured = (count >= FEWEST) & (scatter <= top.most_scatter)
    for _ in range(_ROUNDS):
        if not measured.any():
            break
        field = DeviationField(top.middle[measured], top.out[measured], deviation[measured], radius)
        off = np.abs(deviation - field.at(top.middle, top.out))
        odd = measured & (off > max(_ODD * robust(off[measured]), _LEAST_ODD))
        measured &= ~odd
        if not odd.any():
            break
    share = float(measured.mean())
    if share < LEAST_COVERED:
        reason = f"covers {share:.0%} of the layer's top: {int(measured.sum())} of {len(measured)} cells have {FEWEST} points "
        hint = f"at least {LEAST_COVERED:.0%}; a denser scan, or --fit if it is a little displaced"
        raise complain(reason + "or more that agree", hint=hint)
    deviation, hole = _filled(top, deviation, measured, radius)
    found = HeightMap(top, deviation, measured, count, scatter, deviation, radius, hole)
    smoothed = DeviationField(top.middle, top.out, deviation, radius).at(top.middle, top.out)
    return replace(found, smoothed=smoothed)


def check_size(top: PlannedTop, cloud: Array, complain: Complaint) -> None:
    """Raise InputError, made by `complain`, for a cloud (n, 3) [m] that is a thousand times as large as the layer, or as small."""
    ours, theirs = (
        float(np.linalg.norm(np.subtract(*np.quantile(x, (0.98, 0.02), axis=0)))) for x in (top.middle, cloud)
    )
    ratio = theirs / max(ours, 1e-12)
    for factor in (1e3, 1e-3):
        if 1.0 / _ALIKE < ratio / factor < _ALIKE:
            size = f"{theirs * 1e3:.4g} mm across, about {factor:g} times the layer's {ours * 1e3:.4g} mm"
            raise complain(
                f"is {size}: its unit is another one", hint="--unit m or mm; without it mm, or what its header says"
            )


def check_place(top: PlannedTop, cloud: Array, complain: Complaint) -> None:
    """Raise InputError, made by `complain`, for a cloud (n, 3) [m] in another unit, or far from the layer's top."""
    check_size(top, cloud, complain)
    away = cKDTree(cloud).query(top.middle)[0]
    if float((away <= top.window).mean()) >= ELSEWHERE:
        return
    shift = (np.median(cloud, axis=0) - np.median(top.middle, axis=0)) * 1e3
    reason = (
        f"lies elsewhere: half of the layer's top is {np.median(away) * 1e3:.1f} mm or more from its nearest point, and its "
        f"middle ({shift[0]:+.1f}, {shift[1]:+.1f}, {shift[2]:+.1f}) mm from the layer's"
    )
    raise complain(
        reason, hint="in which frame was it scanned? --frame; --fit makes up for a few millimetres and degrees"
    )


def robust(values: Array) -> float:
    """Standard deviation of most of values (n), by their median absolute deviation."""
    return float(MAD_TO_SIGMA * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _heights(top: PlannedTop, cloud: Array) -> tuple[Array, Ints]:
    """Heights (k) above the planned top [m] of the points that lie on the middles of beads, and the cell (k) of each."""
    window = top.window[top.cell]
    away, near = cKDTree(top.points).query(cloud, distance_upper_bound=2.0 * float(window.max()))
    there = np.flatnonzero(np.isfinite(away))
    near = near[there]
    way = cloud[there] - top.points[near]
    height = (way * top.normals[near]).sum(axis=1)
    aside = np.linalg.norm(way - height[:, None] * top.normals[near], axis=1)
    flat = ACROSS * top.width[near]
    across = np.minimum(flat, 0.5 * np.maximum(LONGEST_CELL, flat))
    kept = (aside <= across) & (np.abs(height) <= window[near])
    return height[kept], top.cell[near[kept]].astype(np.int64)


def _cells(height: Array, cell: Ints, count: int) -> tuple[Array, Array, Ints]:
    """Robust mean (m) and deviation (m) of the heights (k) in each of so many cells, and how many heights count (m)."""
    middle = _medians(height, cell, count)
    scatter = np.maximum(MAD_TO_SIGMA * _medians(np.abs(height - middle[cell]), cell, count), _LEAST_SCATTER)
    kept = np.abs(height - middle[cell]) <= _NEAR_MEDIAN * scatter[cell]
    number = np.bincount(cell[kept], minlength=count)
    total = np.bincount(cell[kept], height[kept], minlength=count)
    return total / np.maximum(number, 1), scatter, number


def _medians(values: Array, group: Ints, count: int) -> Array:
    """Median (m) of the values (k) in each of so many groups; 0 in empty ones."""
    order = np.lexsort((values, group))
    size = np.bincount(group, minlength=count)
    first = np.cumsum(size) - size
    there = np.flatnonzero(size)
    out = np.zeros(count)
    low, high = first[there] + (size[there] - 1) // 2, first[there] + size[there] // 2
    out[there] = 0.5 * (values[order[low]] + values[order[high]])
    return out


def _filled(top: PlannedTop, deviation: Array, measured: Flags, radius: float) -> tuple[Array, float]:
    """Deviations (m) with those of cells that were not measured by the cells around their holes; and how far in these are."""
    out = deviation.copy()
    holes = np.flatnonzero(~measured)
    if not len(holes):
        return out, 0.0
    away = cKDTree(top.middle[measured]).query(top.middle[holes])[0]
    grown = np.ceil(np.maximum(np.log(np.maximum(_GROWN * away / radius, 1.0)) / np.log(_GROWN), 0.0))
    for step in np.unique(grown):
        own = holes[grown == step]
        field = DeviationField(
            top.middle[measured], top.out[measured], deviation[measured], radius * _GROWN**step, bent=True
        )
        out[own] = field.at(top.middle[own], top.out[own])
    return out, float(away.max())


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])
