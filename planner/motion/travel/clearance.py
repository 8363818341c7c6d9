"""What a travel keeps clear of: the part as printed so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays, read_only
from planner.base.compiled import njit
from planner.cell.cell import Cell
from planner.motion.cubics import Cubics, JointState
from planner.toolpath.bead import Surface
from planner.toolpath.waypoints.nearest import FAR

NOZZLE_POINTS = (0.0, 0.01, 0.03, 0.06, 0.1)  # m behind the tip, along the nozzle, that must keep clear
SLOPE = 0.5  # height gained per distance from an end: as steep as runs rise
STEP = 1e-3  # m: greatest motion of a point of the nozzle between two instants that are checked
SWEPT = 1e-3  # m: greatest motion of anything between two postures at which bodies are checked
_ENOUGH = 20e-3  # m of a lift that always count; the rest counts only up to FAR from the part
_SLACK = 0.25 * STEP  # m of height that may be lacking, since ways are checked in steps; never down to the part itself
_FIRST_LOOK = 5e-3  # s between instants, unless the nozzle moves too far in that time
_MOST_LOOKS = 20_000
_STRIDES = (64, 16, 4, 1)  # instants from one check to the next: coarse ones first
_ROUGH = 0.5e-3  # m by which a distance may change more than a point moves: surfaces of facets and samples are rough


@dataclass(frozen=True)
class NozzleTrack:
    """Nozzle points (k, n, 3) in the part frame at n instants `every` seconds apart, tip first [m]."""

    points: Array
    every: float

    @property
    def tip_speed(self) -> float:
        """Greatest speed of the tip relative to the part [m/s]."""
        steps = np.diff(self.points[0], axis=0)
        farthest = float(np.sqrt(np.einsum("ni,ni->n", steps, steps).max(initial=0.0)))
        return farthest / self.every if self.every > 0.0 else 0.0


def glance(cell: Cell, motion: Cubics) -> NozzleTrack:
    """Nozzle points along a motion at a few instants."""
    return _track(cell, motion, max(int(np.ceil(motion.duration / _FIRST_LOOK)), 4))


def track(cell: Cell, motion: Cubics, rough: NozzleTrack | None = None) -> NozzleTrack:
    """Nozzle points along a whole motion, none of which moves by more than STEP between two instants.

    rough: the result of a glance at it, if there was one.
    """
    looked = glance(cell, motion) if rough is None else rough
    while True:
        n = looked.points.shape[1] - 1
        steps = np.diff(looked.points, axis=1)
        most = float(np.sqrt(np.einsum("kni,kni->kn", steps, steps).max()))
        if most <= STEP or n >= _MOST_LOOKS:
            return looked
        looked = _track(cell, motion, min(int(np.ceil(1.05 * n * most / STEP)), _MOST_LOOKS))


def _track(cell: Cell, motion: Cubics, n: int) -> NozzleTrack:
    return NozzleTrack(
        nozzle_points(cell, motion.joints(np.linspace(0.0, motion.duration, n + 1))), motion.duration / n
    )


def fine(motion: Cubics, swing: Array) -> Array:
    """Postures (n, nj) along a motion, between which nothing moves by more than SWEPT.

    swing (nj): greatest motion of anything per radian of each joint [m]
    """
    n = max(int(np.ceil(motion.duration / _FIRST_LOOK)), 4)
    q = motion.joints(np.linspace(0.0, motion.duration, n + 1))
    most = float((np.abs(np.diff(q, axis=0)) @ swing).max())
    if most <= SWEPT:
        return q
    return motion.joints(np.linspace(0.0, motion.duration, min(int(np.ceil(1.05 * n * most / SWEPT)), _MOST_LOOKS) + 1))


def nozzle_points(cell: Cell, q: Array) -> Array:
    """Points (k, n, 3) of the nozzle in the part frame at postures q (n, nj), tip first."""
    T = cell.T_part_nozzle(q)
    return T[:, :3, 3] - np.array(NOZZLE_POINTS)[:, None, None] * T[:, :3, 2]


@dataclass(frozen=True)
class TravelClearance(ReadOnlyArrays):
    """What a travel keeps clear of, and by how much.

    surface   the part; `height` is how far the print stands out of it so far [m]
    lift      height above both at which travel is clear [m]
    tips      (2, 3) where the travel starts and ends [m], part frame
    gaps      (2, k) distances of the nozzle's points from the surface there [m]

    At its ends a travel is as close to the part as the ends of the beads are. From there it has to gain height in
    proportion to the distance from the end: it stays above a cone around each end, up to the height of the lift.
    """

    surface: Surface
    height: float
    lift: float
    tips: Array
    gaps: Array

    @property
    def full(self) -> float:
        """Distance from the surface at which a travel is clear anywhere [m]: the lift above the print, up to FAR."""
        return self.height + min(self.lift, max(_ENOUGH, FAR - self.height))

    def lacking(self, points: Array) -> float:
        """Greatest height that nozzle points (k, n, 3) lack [m]; the way is clear if it is 0 or less.

        Most of a way is far from the part, and a distance changes by no more than a point moves: every 64th instant is
        checked first, then those in between that this leaves undecided.
        """
        points = read_only(points)
        floor = min(0.0, float(self.gaps.min()))
        needed = _needed(points, self.tips, self.gaps, self.full, floor)
        most, before = -np.inf, 0
        least = np.full(needed.shape, -np.inf)  # lower bounds of the distances
        for stride in _STRIDES:
            row, column = _left_open(points, needed, least, before, stride)
            if len(row):
                least[row, column] = self.surface.signed_distance(points[row, column])
                most = max(most, float((needed[row, column] - least[row, column]).max()))
            if most > 0.0:
                break
            before = stride
        return most


@njit
def _needed(points: Array, tips: Array, gaps: Array, full: float, floor: float) -> Array:
    """Distances (k, n) from the surface that nozzle points (k, n, 3) must keep, never less than `floor` [m]."""
    k, n, _ = points.shape
    out = np.empty((k, n))
    for i in range(n):
        start, end = _apart(points[0, i], tips[0]), _apart(points[0, i], tips[1])
        for row in range(k):
            cone = min(gaps[0, row] + SLOPE * start, gaps[1, row] + SLOPE * end)
            out[row, i] = max(min(full, cone) - _SLACK, floor)
    return out


@njit
def _left_open(points: Array, needed: Array, least: Array, before: int, stride: int) -> tuple[Ints, Ints]:
    """Rows and columns of the points, at every `stride`-th instant, that are not known to be far enough away.

    The lower bounds least (k, n) at these instants are first raised by those known at every `before`-th instant, if
    any.
    """
    k, n, _ = points.shape
    rows, columns = np.empty(k * (n // stride + 2), dtype=np.int64), np.empty(k * (n // stride + 2), dtype=np.int64)
    found = 0
    for row in range(k):
        for step in range((n - 2) // stride + 2):
            i = min(step * stride, n - 1)
            if before > 0:
                left = i // before * before
                for near in (left, min(left + before, n - 1)):
                    moved = _apart(points[row, i], points[row, near])
                    least[row, i] = max(least[row, i], least[row, near] - moved - _ROUGH)
            if least[row, i] < needed[row, i]:
                rows[found], columns[found] = row, i
                found += 1
    return rows[:found], columns[:found]


@njit(inline="always")
def _apart(a: Array, b: Array) -> float:
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


def travel_clearance(
    cell: Cell, surface: Surface, height: float, lift: float, start: JointState, end: JointState
) -> TravelClearance:
    """What a travel from `start` to `end` keeps clear of."""
    points = nozzle_points(cell, np.stack([start.q, end.q]))
    gaps = surface.signed_distance(points.reshape(-1, 3)).reshape(points.shape[:2])
    return TravelClearance(surface, height, lift, np.ascontiguousarray(points[0]), np.ascontiguousarray(gaps.T))
