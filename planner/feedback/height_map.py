"""The height map of a print: local deviation of a layer's top from the plan, measured by a point cloud.

The planned top of a layer is the path of the nozzle's tip. Its beads are cut into cells about as long as they are wide.
A cell's height is the mean of its points that lie in the middle of the bead's width and near their median. Cells that
disagree with their surroundings are left out; these, and cells with too few points, are interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import MAD_TO_SIGMA, Array, Flags, Ints, ReadOnlyArrays
from planner.base.errors import Complaint
from planner.toolpath.as_printed import DeviationField
from planner.toolpath.bead import Toolpath

ACROSS = 0.3  # × the bead's width to either side: the top is flat there and falls away farther out
LONGEST_CELL = 3e-3  # m along and across a bead, or ACROSS × its width if that is more: over more, a print may bend
WINDOW, WINDOW_SHARE = 3e-3, 0.5  # m, or × the bead's height if that is more: points farther off are not of this layer
FEWEST = 4  # points per cell: the median of fewer can be an outlier
SCATTER, SCATTER_SHARE = 0.35e-3, 0.1  # m, or × the bead's height if more: a cell that deviates more has two surfaces
LEAST_COVERED = 0.6  # share of the layer's cells that must be measured
ELSEWHERE = 0.3  # share of cells with a point nearby: below this, the cloud is not of this layer
_ALIKE = 8.0  # ratio of sizes, either way, up to which cloud and layer count as equal: a scan sees more, or less
_DENSE = 0.15  # × the bead's width: spacing of the sampled top, by which points find their cell
_NEAR_MEDIAN = 3.0  # robust deviations from the median within which points count
_LEAST_SCATTER = 0.02e-3  # m
_ODD, _LEAST_ODD = 5.0, 0.1e-3  # robust deviations, and at least m: a cell this far off its surroundings is left out
_ROUNDS = 3
_GROWN = 2.5  # growth of the radius from step to step, as needed to interpolate holes


@dataclass(frozen=True)
class PlannedTop(ReadOnlyArrays):
    """The planned top of a layer: points (n) along the centrelines of its beads, grouped into cells (m).

    points, normals (n, 3)   part frame [m], normals outward and of unit length
    width (n)                of the bead [m]
    cell (n)                 the cell that each point belongs to
    middle, out (m, 3)       centre of each cell [m], and its normal
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
        """Greatest distance (m) of each cell's points from the planned top [m]."""
        return np.asarray(np.maximum(WINDOW, WINDOW_SHARE * self.high))

    @property
    def most_scatter(self) -> Array:
        """Greatest robust deviation (m) of each cell's points [m]."""
        return np.asarray(np.maximum(SCATTER, SCATTER_SHARE * self.high))


@dataclass(frozen=True)
class HeightMap(ReadOnlyArrays):
    """Deviation of a layer's top from the plan, in cells (m).

    deviation (m)   along the normal, positive where the print is too high [m]; interpolated where not measured
    measured (m)    whether points measured it;  count (m) how many points;  scatter (m) their robust deviation [m]
    smoothed (m)    deviation smoothed over `radius` [m]: what the layers above compensate
    widest_hole     greatest distance from an interpolated cell to the nearest measured one [m]
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
    """The height map of a layer from a cloud (n, 3) in the part frame [m], smoothed over a radius [m].

    Raises InputError, made by `complain`, for a cloud that lies elsewhere or covers too little of the layer.
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
        hint = f"at least {LEAST_COVERED:.0%} is needed: scan more densely, or use --fit if it is slightly displaced"
        raise complain(reason + "or more that agree", hint=hint)
    deviation, hole = _filled(top, deviation, measured, radius)
    found = HeightMap(top, deviation, measured, count, scatter, deviation, radius, hole)
    smoothed = DeviationField(top.middle, top.out, deviation, radius).at(top.middle, top.out)
    return replace(found, smoothed=smoothed)


def check_size(top: PlannedTop, cloud: Array, complain: Complaint) -> None:
    """Raise InputError, made by `complain`, for a cloud (n, 3) [m] about 1000 times as large or small as the layer."""
    ours, theirs = (
        float(np.linalg.norm(np.subtract(*np.quantile(x, (0.98, 0.02), axis=0)))) for x in (top.middle, cloud)
    )
    ratio = theirs / max(ours, 1e-12)
    for factor in (1e3, 1e-3):
        if 1.0 / _ALIKE < ratio / factor < _ALIKE:
            size = f"{theirs * 1e3:.4g} mm across, about {factor:g} times the layer's {ours * 1e3:.4g} mm"
            raise complain(
                f"is {size}: it is in another unit", hint="--unit m or mm; the default is what its header says, or mm"
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
    """Robust standard deviation of values (n), from their median absolute deviation."""
    return float(MAD_TO_SIGMA * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _heights(top: PlannedTop, cloud: Array) -> tuple[Array, Ints]:
    """Heights (k) above the planned top [m] of the points near the centrelines of beads, and the cell (k) of each."""
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
    """Robust mean (m) and deviation (m) of the heights (k) in each of `count` cells, and how many heights count (m)."""
    middle = _medians(height, cell, count)
    scatter = np.maximum(MAD_TO_SIGMA * _medians(np.abs(height - middle[cell]), cell, count), _LEAST_SCATTER)
    kept = np.abs(height - middle[cell]) <= _NEAR_MEDIAN * scatter[cell]
    number = np.bincount(cell[kept], minlength=count)
    total = np.bincount(cell[kept], height[kept], minlength=count)
    return total / np.maximum(number, 1), scatter, number


def _medians(values: Array, group: Ints, count: int) -> Array:
    """Median (m) of the values (k) in each of `count` groups; 0 in empty ones."""
    order = np.lexsort((values, group))
    size = np.bincount(group, minlength=count)
    first = np.cumsum(size) - size
    there = np.flatnonzero(size)
    out = np.zeros(count)
    low, high = first[there] + (size[there] - 1) // 2, first[there] + size[there] // 2
    out[there] = 0.5 * (values[order[low]] + values[order[high]])
    return out


def _filled(top: PlannedTop, deviation: Array, measured: Flags, radius: float) -> tuple[Array, float]:
    """Deviations (m) with holes interpolated, and the greatest distance of a hole from a measured cell [m]."""
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
