"""A smooth curve through waypoints: exact where they are smooth, rounded where they turn a corner.

Between corners a spline of degree 5 in chord length passes through every waypoint, points and normals alike. At a
corner it is averaged with a kernel just wide enough to use the tolerance. Samples are as far apart as the waypoints,
closer at corners; their arc length is a smooth function of their index.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import convolve1d, maximum_filter1d

from planner.base.arrays import Array
from planner.base.geometry import angles_between, arc_lengths, subdivided
from planner.toolpath.plane_paths import SampleDensity

CORNER_TURN = np.radians(30.0)  # at one waypoint; more is a corner: a circle of fewer than twelve waypoints has corners
_DEGREE = 5
# The kernel (1 - x^2)^4 (1 - SWING x^2) has negative lobes: the curve swings out before a corner, where the tolerance
# would otherwise be unused, and turns with a quarter of the jerk of SWING = 0 at the same tolerance.
_SWING = 5.0
_CUT = 0.0752  # × the kernel's half width and half the jump in direction: what it cuts off a corner
_WIDEST = 25.0  # × the tolerance: greatest half width of the kernel
_CELLS = 48  # grid cells per half width of the kernel
_SAMPLES = 20.0  # per half width of the kernel, at the corner
_TRIES = 12  # to find the width that uses the tolerance
_NEARLY, _AIM = 0.94, 0.98  # shares of the usable tolerance: enough from here on; target
_USED = 0.9  # × the tolerance: the rest is for the curve between samples
_SPREAD = 0.7  # × the kernel's half width: distance from a corner at which the density of samples has halved
_SPARSE = 1.5  # × the usual waypoint distance: ends where samples are farther apart are judged by their own distance
_ENDS = 2.0  # × the usual sample distance: how far from the ends samples are closer together
_CHORD = 2e-6  # m: greatest deviation of the source from the curve through the waypoints
_CORNER_STEP = 2e-4  # m, between the source's points where a corner is rounded
_FEWEST = 8  # samples of a bead at least
_SWING_OUT = 0.15  # × the step: a curve between two waypoints leaves their chord by less, on a circle by 0.07 at most
_STILL = 2e-5  # m: scans wiggle by half of this, and less does no harm, however short the step
_STILL_NORMAL = 0.1  # of a unit normal, likewise
_LOOKS = np.linspace(0.0, 1.0, 7)[1:-1]  # places within a step where that is checked
_DENSER = 4.0  # × the length of its neighbours: from here on, a step is compared with where they lead
_MOST_CELLS = 8_000_000  # of a grid on which corners are averaged: some 2 GB
_RESOLVED = 1e-5  # m, third difference of the direction times the step: below, one sample per waypoint is enough
_MOST_PER_STEP = 4.0  # samples at most
# Waypoints this close together say nothing that more widely spaced ones do not. Over such short steps, joint positions
# known only to a few digits have no meaningful third derivatives per millimetre, and their noise would slow the print.
_TOO_DENSE, _ENOUGH = 1e-4, 2.5e-4  # m: median distance of such waypoints; distance of samples that is enough then
_SHAKY = 0.05  # third difference of normals above which they count as rough
_BESIDE = 8  # waypoints at an end whose roughness counts there
_LESS = 1.0 - 1e-6  # × a distance: another one counts as less only below this
_ORDER = 3  # of the difference that measures how rough normals are
_RESOLVED_NORMAL = 2e-3  # third difference of normals below which one sample per waypoint is enough
_LOOSEST = 6.0  # × `apart`: any sparser, and a place's nearest sample would be on another pass


class TooRough(ValueError):
    """No smooth curve stays within tolerance at the corners from this waypoint (counted from 0) on."""

    def __init__(self, waypoint: int) -> None:
        self.waypoint = waypoint
        super().__init__(f"no smooth curve keeps the tolerance from waypoint {waypoint} on")


@dataclass(frozen=True)
class Interpolated:
    """Points and unit normals (n, 3) of a curve, and the input path `source` (m, 3), in the input's frame and unit.

    chord (n): length of the chords through the waypoints up to each sample
    """

    points: Array
    normals: Array
    source: Array
    chord: Array


@dataclass(frozen=True)
class _Corner:
    """Corners that are rounded together.

    first, last  chord lengths of the first and the last corner
    width        half width of the kernel
    rows         spline of the rounded rows over chord length
    """

    first: float
    last: float
    width: float
    rows: Any

    def weight(self, c: Array) -> Array:
        """1 where the rounded rows apply, 0 from one width further on, smooth in between."""
        beyond = np.maximum(np.maximum(self.first - c, c - self.last), 0.0) / self.width
        x = np.clip(2.0 - beyond, 0.0, 1.0)
        return x**5 * (126.0 - x * (420.0 - x * (540.0 - x * (315.0 - 70.0 * x))))


def interpolate(
    points: Array, normals: Array, tolerance: float, apart: float, ends: float = np.inf, astray: float = np.inf
) -> Interpolated:
    """Lay a curve through waypoints (m, 3), m at least 2, no two successive ones equal; corners within `tolerance`.

    The curve is within a micrometre of every waypoint that is neither a corner nor next to one, if waypoints are dense
    enough to be smooth. It ends at the first and the last waypoint.

    apart   greatest distance between the source's points, less than that between neighbouring passes, so that each
            point's nearest is on its own pass
    ends    greatest distance between samples at the two ends, for whatever is attached there
    astray  how far the curve, on a step far longer than its neighbours, may be from where these lead; beyond that the
            step is straight, if that is nearer to where they lead

    All in m: smoothness is judged in micrometres. Raises TooRough if there is no such curve.
    """
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    chord, turn = arc_lengths(points), _turns(points)
    path, sharp = _calm_spline(chord, np.hstack([points, normals]), np.flatnonzero(turn > CORNER_TURN), astray)
    corners = _round(path, chord, sharp, turn, tolerance)

    per_step = np.maximum(_samples_per_step(points, normals, chord, sharp), step / (_LOOSEST * apart))
    if float(np.median(step)) < _TOO_DENSE:
        per_step = np.minimum(per_step, np.maximum(_fewest_per_step(points, normals, chord, sharp), step / _ENOUGH))
    density = SampleDensity.of_steps(chord, per_step)
    for corner in corners:
        at = chord[sharp]
        inside = at[(at >= corner.first) & (at <= corner.last)]
        kept = [inside[0]]
        for c in inside[1:]:
            if c - kept[-1] > corner.width:
                kept.append(c)
        density = density.denser(np.array(kept), corner.width / _SAMPLES, _SPREAD * corner.width)
    usual = chord[-1] / max(len(chord) - 1, 1)
    for k in (0, -1):
        end = chord[[k]]
        spacing = float(density.spacing_at(end)[0])
        local = spacing if spacing > _SPARSE * usual else usual
        beside = slice(0, _BESIDE) if k == 0 else slice(-_BESIDE, None)
        rough = float(_roughness(normals[beside], chord[beside]).max(initial=0.0))
        # so dense that whatever is attached there changes nothing between the samples
        wanted = min(ends, spacing / float(np.clip((rough / _RESOLVED_NORMAL) ** 0.25, 1.0, _MOST_PER_STEP)))
        if wanted < _LESS * local:
            density = density.denser(end, 1.0 / (1.0 / wanted - 1.0 / local), _ENDS * local)
    c = density.samples(_FEWEST)
    rows = np.asarray(path(c))
    for corner in corners:
        near = slice(*np.searchsorted(c, [corner.first - 2.0 * corner.width, corner.last + 2.0 * corner.width]))
        w = corner.weight(c[near])[:, None]
        rows[near] += w * (np.asarray(corner.rows(c[near])) - rows[near])
    rows[0, :3], rows[-1, :3] = points[0], points[-1]

    return Interpolated(rows[:, :3].copy(), _unit(rows[:, 3:]), _source(path, chord, turn, corners, apart), c)


def calm_path(points: Array) -> tuple[BSpline, Array]:
    """The curve through waypoints (m, 3) over chord length, before corners are rounded, and their chord lengths (m).

    No two successive waypoints are equal.
    """
    chord = arc_lengths(points)
    sharp = np.flatnonzero(_turns(points) > CORNER_TURN)
    return _calm_spline(chord, np.hstack([points, np.zeros_like(points)]), sharp)[0], chord


def _roughness(normals: Array, chord: Array) -> Array:
    """Third differences (m - 3) of normals (m, 3) at chord lengths (m), as if evenly spaced; empty if m <= 3."""
    if len(normals) <= _ORDER:
        return np.zeros(0)
    divided = normals
    for order in range(1, _ORDER + 1):
        divided = np.diff(divided, axis=0) / (chord[order:] - chord[:-order])[:, None] * order
    mean = (chord[_ORDER:] - chord[:-_ORDER]) / _ORDER
    return np.asarray(np.linalg.norm(divided, axis=1) * mean**_ORDER)


def _source(path: BSpline, chord: Array, turn: Array, corners: list[_Corner], apart: float) -> Array:
    """The unrounded path as a polyline (m, 3): all waypoints, and as many points in between as its bends need."""
    step = np.diff(chord)
    bend = np.maximum(turn[:-1], turn[1:])
    bend[bend > CORNER_TURN] = CORNER_TURN  # a corner is a waypoint: the path next to it bends less
    pieces = np.ceil(np.maximum(np.sqrt(step * bend / (8.0 * _CHORD)), step / apart))
    for corner in corners:
        near = slice(*np.searchsorted(chord, [corner.first - 2.0 * corner.width, corner.last + 2.0 * corner.width]))
        near = slice(max(near.start - 1, 0), near.stop)
        pieces[near] = np.maximum(pieces[near], np.ceil(step[near] / _CORNER_STEP))
    index, share = subdivided(pieces.astype(int))
    c = np.append(chord[index] + step[index] * share, chord[-1])
    return np.asarray(path(c)[:, :3])


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def _turns(points: Array) -> Array:
    """Angle (m) between the chords before and after each waypoint; 0 at both ends."""
    chords = np.diff(points, axis=0)
    along = chords / np.linalg.norm(chords, axis=1)[:, None]
    return np.concatenate([[0.0], angles_between(along[1:], along[:-1]), [0.0]])


def _samples_per_step(points: Array, normals: Array, chord: Array, sharp: NDArray[np.int64]) -> Array:
    """How many samples each step (m - 1) of the waypoints needs: one, or more where they bend within a few steps.

    The interpolation error grows with the fourth power of the spacing. Where normals are rough, joints between two
    samples leave the path by the square of what they turn.
    """
    step = np.diff(chord)
    along = np.diff(points, axis=0) / step[:, None]
    bend = np.diff(along, axis=0)
    bend[sharp - 1] = 0.0  # a corner is rounded, and sampled for that
    rough = np.zeros(len(step))
    if len(bend) > 2:
        third = np.linalg.norm(np.diff(bend, n=2, axis=0), axis=1)
        rough[1:-2] = third  # a neighbouring corner makes it rougher than it is: that does no harm
        rough = maximum_filter1d(rough, 5, mode="constant") * step
    shaky = np.zeros(len(step))
    if len(normals) > _ORDER:
        shaky[1:-1] = _roughness(normals, chord)
        shaky = maximum_filter1d(shaky, 5, mode="constant")
    needed = np.maximum((rough / _RESOLVED) ** 0.25, (shaky / _SHAKY) ** 0.5)
    return np.asarray(np.clip(needed, 1.0, _MOST_PER_STEP))


def _fewest_per_step(points: Array, normals: Array, chord: Array, sharp: NDArray[np.int64]) -> Array:
    """How many samples, or what share of one, each step (m - 1) of dense waypoints needs, by bends over _ENOUGH."""
    every = max(int(_ENOUGH / float(np.median(np.diff(chord)))), 1)
    kept = np.union1d(np.arange(0, len(chord), every), np.append(sharp, len(chord) - 1))
    few = np.unique(np.searchsorted(kept, sharp))
    few = few[(few > 0) & (few < len(kept) - 1)]
    needed = _samples_per_step(points[kept], normals[kept], chord[kept], few) / np.diff(kept)
    return np.repeat(needed, np.diff(kept))


def _calm_spline(
    chord: Array, rows: Array, sharp: NDArray[np.int64], astray: float = np.inf
) -> tuple[BSpline, NDArray[np.int64]]:
    """The spline through all rows, and the waypoints where it has corners: `sharp`, and where it would swing out.

    A spline of high degree swings out between points whose distances or directions jump. Both ends of a step where it
    does so become corners, until it is calm; a step between two corners is straight. The same applies to a step far
    longer than its neighbours if the spline is more than `astray` [m] off where these lead, and a straight step less.
    """
    ends = np.array([0, len(chord) - 1])
    step = np.diff(chord)
    while True:
        path = _spline(chord, rows, sharp)
        between = np.asarray(path(chord[:-1, None] + step[:, None] * _LOOKS))
        straight = rows[:-1, None] + _LOOKS[:, None] * np.diff(rows, axis=0)[:, None]
        swing = between - straight
        off = np.linalg.norm(swing.reshape(len(step), len(_LOOKS), 2, 3), axis=3).max(axis=1)
        turned = np.linalg.norm(np.diff(rows[:, 3:], axis=0), axis=1)
        wild = (off[:, 0] > np.maximum(_SWING_OUT * step, _STILL)) | (
            off[:, 1] > np.maximum(_SWING_OUT * turned, _STILL_NORMAL)
        )
        if astray < np.inf:
            long, led = _led_on(rows[:, :3], chord, sharp)
            along = (np.diff(rows[:, :3], axis=0) / step[:, None])[long, None]
            aside = swing[long, :, :3] - led
            aside = aside - (aside * along).sum(axis=2, keepdims=True) * along
            off_led, off_chord = (np.linalg.norm(each, axis=2).max(axis=1) for each in (aside, led))
            wild[long] |= (off_led > astray) & (off_led > off_chord)  # where a straight step is nearer to that
        k = np.flatnonzero(wild)
        more = np.setdiff1d(np.union1d(sharp, np.concatenate([k, k + 1])), ends)
        if len(more) == len(sharp):
            return path, sharp
        sharp = more


def _led_on(points: Array, chord: Array, sharp: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """Steps (k) far longer than the next two at one end or both, and where these lead: offsets (k, looks, 3) [m].

    The offsets, from the chord of the long step, are those of a curve that leaves and reaches it as the short ones do.
    At an end where the next two are not that much shorter, it mirrors the other end.

    The spline continues the bend of dense waypoints: on a straight step after a bend it swings out by about the step's
    length squared over 32 radii.
    """
    step = np.diff(chord)
    slope, k = np.diff(points, axis=0) / step[:, None], np.arange(len(step))
    calm = np.ones(len(points), dtype=np.bool_)
    calm[sharp] = False
    leads, known = [], []
    for side in (-1, 1):
        inside = (k + 2 * side >= 0) & (k + 2 * side < len(step))
        near, far = np.where(inside, k + side, k), np.where(inside, k + 2 * side, k)
        meet = near if side > 0 else near + 1  # the waypoint where the step meets the near one
        dense = inside & (_DENSER * np.maximum(step[near], step[far]) <= step) & calm[meet] & calm[meet + side]
        turn = slope[near] - slope[far]
        leads.append(slope[near] + (step[near] / (step[near] + step[far]))[:, None] * turn - slope)
        known.append(dense)
    before = np.where(known[0][:, None], leads[0], -leads[1])
    after = np.where(known[1][:, None], leads[1], -leads[0])
    which = np.flatnonzero(known[0] | known[1])
    u = _LOOKS[:, None]
    off = u * (1.0 - u) ** 2 * before[which, None] - u**2 * (1.0 - u) * after[which, None]
    return which, np.asarray(step[which, None, None] * off)


def _spline(chord: Array, rows: Array, sharp: NDArray[np.int64]) -> BSpline:
    """One spline of degree 5 through all rows (m, d), smooth except at waypoints `sharp`: only continuous there."""
    ends = np.concatenate([[0], sharp, [len(chord) - 1]])
    knots, coefficients = [], []
    for first, last in zip(ends[:-1], ends[1:], strict=True):
        x, y = chord[first : last + 1], rows[first : last + 1]
        if len(x) <= _DEGREE:  # few points: their polynomial, raised to the degree of the others
            low = make_interp_spline(x, y, k=len(x) - 1)
            x = np.linspace(x[0], x[-1], _DEGREE + 1)
            y = low(x)
        piece = make_interp_spline(x, y, k=_DEGREE)
        knots.append(piece.t[: len(piece.c)])
        coefficients.append(piece.c)
    knots.append(np.repeat(chord[-1], _DEGREE + 1))
    return BSpline(np.concatenate(knots), np.concatenate(coefficients), _DEGREE)


def _round(path: BSpline, chord: Array, sharp: NDArray[np.int64], turn: Array, tolerance: float) -> list[_Corner]:
    """Round the corners `sharp` of a path, together where they are close to each other."""
    if len(sharp) == 0:
        return []
    cut = _CUT * np.maximum(
        np.sin(0.5 * turn[sharp]), _USED / (_CUT * _WIDEST)
    )  # where the path is straight, nothing is cut
    widths = _USED * tolerance / cut
    at = chord[sharp]
    corners: list[_Corner] = []
    start = 0
    for i in range(1, len(at) + 1):
        # a corner reaches twice its width: those that overlap are rounded as one
        if i < len(at) and at[i] - at[i - 1] <= 2.0 * (widths[i] + widths[i - 1]):
            continue
        corner = _rounded(path, at[start:i], float(widths[start:i].min()), chord[-1], tolerance)
        if corner is None:
            raise TooRough(int(sharp[start]))
        corners.append(corner)
        start = i
    return corners


def _rounded(path: BSpline, at: Array, width: float, length: float, tolerance: float) -> _Corner | None:
    """Average a path around the corners `at` with the widest kernel, `width` at most, that keeps the tolerance.

    None if no width tried does.
    """
    room = _USED * tolerance
    fits, exceeds = 0.0, np.inf
    best: _Corner | None = None
    for _ in range(_TRIES):
        if (float(at[-1] - at[0]) / width + 6.0) * _CELLS > _MOST_CELLS:
            return best
        corner, off = _averaged(path, at, width, length)
        if off <= room:
            fits, best = width, corner
            if off > _NEARLY * room or exceeds == np.inf:
                break
        else:
            exceeds = width
        # the deviation grows roughly in proportion to the width
        width = float(
            np.clip(width * _AIM * room / off, fits + 0.1 * (exceeds - fits), exceeds - 0.1 * (exceeds - fits))
        )
        width = max(width, 0.25 * exceeds)
    return best


def _averaged(path: BSpline, at: Array, width: float, length: float) -> tuple[_Corner, float]:
    """Average a path around the corners `at` with a kernel, and return the greatest distance this moves a point."""
    low, high = float(at[0]), float(at[-1])
    cell = width / _CELLS
    cells = int(np.ceil((high - low) / cell)) + 6 * _CELLS + 1
    grid = low - 3.0 * width + cell * np.arange(cells, dtype=np.float64)
    rows = _extended(path, grid, length)
    x = np.linspace(-1.0, 1.0, 2 * _CELLS + 1)
    kernel = (1.0 - x**2) ** 4 * (1.0 - _SWING * x**2)
    inner = slice(_CELLS, -_CELLS)
    smooth = convolve1d(rows, kernel / kernel.sum(), axis=0, mode="nearest")[inner]
    corner = _Corner(low, high, width, make_interp_spline(grid[inner], smooth, k=_DEGREE))
    # at the corners themselves, too: a spike of one waypoint may lie between two grid points
    moved = np.vstack([smooth - rows[inner], corner.rows(at) - path(at)])
    return corner, float(np.linalg.norm(moved[:, :3], axis=1).max())


def _extended(path: BSpline, c: Array, length: float) -> Array:
    """A path's rows at chord lengths c, point-mirrored beyond its ends, so that averaging leaves these in place."""
    inside = np.where(c < 0.0, -c, np.where(c > length, 2.0 * length - c, c))
    rows = np.asarray(path(np.clip(inside, 0.0, length)))
    for beyond, end in ((c < 0.0, 0.0), (c > length, length)):
        if beyond.any():
            rows[beyond] = 2.0 * np.asarray(path(end)) - rows[beyond]
    return rows
