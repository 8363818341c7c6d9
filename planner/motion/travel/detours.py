"""Ways around the part and around obstacles: an arc at constant distance, and a search of joint space (RRT-Connect).

Where the wrist turns far, a straight move of the joints swings the nozzle about, and its tip's speed limit makes the
travel slow. On an arc the tip takes the shortest way around the part, at constant distance from it, and the first
joints compensate for the wrist's motion; the joints are a spline of time.

Where no such way is clear of obstacles, two trees of postures grow from above the ends towards random postures and
towards each other until they meet (Kuffner and LaValle, RRT-Connect, ICRA 2000); the way found is then shortened.
The random numbers are the same each time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from planner.base.arrays import Array, Flags
from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.motion.cubics import Cubics, chain
from planner.motion.travel.clearance import SLOPE, SWEPT, TravelClearance, nozzle_points, track
from planner.motion.travel.moves import Bounds, between, stopped
from planner.motion.travel.ways import Built, Ends, lifted, reaching
from planner.toolpath.waypoints.nearest import FAR

_STEPS = 30  # of the walk around the part, if it were straight
_GROWTH = 0.3  # share of the distance from the nearer end that a step may take
_LEAST_STEP = 1e-3  # m
_MOST_STEPS = 4 * _STEPS
FITS = ((1.4, 1.2), (1.7, 1.4), (1.95, 1.7))  # how many times steeper than the cones above which a travel stays, and
# higher than the lift, an arc is laid out, so that it still stays above them once rounded: tried in order
_ROUNDS = 3  # of smoothing of the walk
_PIECES = 32  # of the spline of time
_RAMP = 0.5  # share of the acceleration and jerk limits that speeding up may take; the rest is for bends
_LEAST_RAMP = 1e-6  # s
_ROUNDS_OF_TIME = 10  # in which times settle between the limits
_CAUTION = 0.5  # exponent that damps the change of times in each
_RESCALINGS = 12
_NEAR = 1.005  # × the time that the limits require: close enough
_LIFTS = (1.0, 4.0, 16.0)  # × the least lift: heights from which the search starts, in order
_DRAWN = 1500  # random postures, at most
_STEP = 0.25  # m: greatest motion of anything along one branch of a tree
_SHORTCUTS = 300  # tried,
_ALL = 0.5  # share of them for all joints
_WORTH = 0.02  # s that one must save
_STOP = 0.15  # s: approximate cost of a rest
_ROOM = 2e-3  # m of additional clearance, if the shortened way turns out to pass too close
_LOOKS = 8  # checks of the tip's speed along a straight move
_COARSE = 5.0 * SWEPT  # m: step in which branches are checked; the way itself is checked in fine steps


def arc(cell: Cell, ends: Ends, room: TravelClearance, speed: float, fit: tuple[float, float]) -> Built | None:
    """An arc around the part from state to state, the tip no faster than `speed` [m/s]; None if time does not help."""
    if not ends.resting:
        return _from_motion(cell, ends, room, speed, fit)
    return along_tips(cell, ends, _walk(room, *fit), speed)


def along_tips(cell: Cell, ends: Ends, tips: Array, speed: float) -> Built | None:
    """From rest to rest with the tip close to positions (k, 3) in the part frame, no faster than `speed` [m/s].

    None if time does not help.
    """
    q = _postures(cell, ends, tips)
    if not np.isfinite(q).all():  # the part has no normal on its axis
        return None
    times = _times(cell, q, ends.bounds, speed)
    times = max(1.0, ends.least / float(times[-1])) * times
    for _ in range(_ROUNDS_OF_TIME):
        motion = _spline(times, q)
        # slow down where a limit is overrun, speed up where none is near
        rate = maximum_filter1d(_hurry(cell, motion, ends.bounds, speed), 3)
        rate = uniform_filter1d(rate, 5) ** _CAUTION
        times = np.interp(times, motion.times, np.concatenate([[0.0], np.cumsum(rate * np.diff(motion.times))]))
        times = max(1.0, ends.least / float(times[-1])) * times
    for _ in range(_RESCALINGS):
        motion = _spline(times, q)
        over = max(float(_hurry(cell, motion, ends.bounds, speed).max()), track(cell, motion).tip_speed / speed)
        if over <= 1.0:
            return Built(motion)
        times = over * _NEAR * times
    return None


def _hurry(cell: Cell, motion: Cubics, bounds: Bounds, speed: float) -> Array:
    """Factor (m) by which each piece should last longer to keep joint limits and the tip's speed [m/s]."""
    c3, c2, c1, _ = motion.coefficients
    h = np.diff(motion.times)[:, None]
    tip = cell.T_part_nozzle(motion.joints(motion.times))[:, :3, 3]
    over = np.stack(
        [
            np.abs(np.stack([c1, c1 + h * c2, c1 + h * (2.0 * c2 + 3.0 * h * c3)])).max(axis=0) / bounds.velocity,
            np.sqrt(np.abs(np.stack([2.0 * c2, 2.0 * c2 + 6.0 * h * c3])).max(axis=0) / bounds.acceleration),
            np.cbrt(np.abs(6.0 * c3) / bounds.jerk),
        ]
    )
    return np.maximum(over.max(axis=(0, 2)), np.linalg.norm(np.diff(tip, axis=0), axis=1) / (h[:, 0] * speed))


def _from_motion(cell: Cell, ends: Ends, room: TravelClearance, speed: float, fit: tuple[float, float]) -> Built | None:
    """The same between states in motion: the arc joins postures near these in which the joints can be at rest."""
    start, end = stopped(ends.bounds, ends.start, 1.0), stopped(ends.bounds, ends.end, -1.0)
    before, after = between(ends.bounds, ends.start, start), between(ends.bounds, end, ends.end)
    if before is None or after is None:
        return None
    least = max(ends.least - before.duration - after.duration, 0.0)
    tips = cell.T_part_nozzle(np.stack([start.q, end.q]))[:, :3, 3]
    middle = arc(cell, replace(ends, start=start, end=end, least=least), replace(room, tips=tips), speed, fit)
    return None if middle is None else Built(chain([before, middle.motion, after]))


def _walk(room: TravelClearance, steeper: float, higher: float) -> Array:
    """Tip positions (k, 3) from the start's to the end's, as high above the part as needed, denser near the ends."""
    p, goal = room.tips
    step = max(math.dist(p, goal) / _STEPS, _LEAST_STEP)
    full = min(higher * room.full, max(room.full, FAR))  # surfaces given by waypoints know no greater heights
    points = [p]
    left, gap, normal = math.dist(p, goal), float(room.gaps[0, 0]), room.surface.normals(p[None])[0]
    while len(points) < _MOST_STEPS and left > _LEAST_STEP:
        ahead = goal - p
        inwards = float(ahead @ normal)
        if inwards < 0.0 and gap < 2.0 * full:
            sideways = ahead - inwards * normal
            if math.hypot(*sideways) > _LEAST_STEP:
                ahead = sideways
        near = min(math.dist(p, room.tips[0]), left)
        p = p + min(step, max(_LEAST_STEP, _GROWTH * near)) / math.hypot(*ahead) * ahead
        left, normal = math.dist(p, goal), room.surface.normals(p[None])[0]
        start, end = room.gaps[:, 0] + steeper * SLOPE * np.array([math.dist(p, room.tips[0]), left])
        gap = float(room.surface.signed_distance(p[None])[0])
        lacking = min(full, start, end) - gap
        if lacking > 0.0:
            p, gap = p + lacking * normal, gap + lacking
        points.append(p)
    way = np.vstack([*points, goal])
    for _ in range(_ROUNDS):
        way[1:-1] = 0.25 * way[:-2] + 0.5 * way[1:-1] + 0.25 * way[2:]
    if len(way) > _STEPS:
        return way
    return np.asarray(make_interp_spline(np.arange(len(way)), way, k=1)(np.linspace(0.0, len(way) - 1.0, _STEPS + 1)))


def _postures(cell: Cell, ends: Ends, tips: Array) -> Array:
    """Postures (k, nj) along tip positions (k, 3); wrist and holder turn from the start's posture to the end's."""
    steps = np.linalg.norm(np.diff(tips, axis=0), axis=1) + _LEAST_STEP / _STEPS
    u = (np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum())[:, None]
    q = (1.0 - u) * ends.start.q + u * ends.end.q
    q[:, : len(cell.arm)] = reaching(cell, q, tips)
    q[0], q[-1] = ends.start.q, ends.end.q
    return q


def _times(cell: Cell, q: Array, bounds: Bounds, speed: float) -> Array:
    """Times (k) at which postures (k, nj) are passed: as fast as velocities allow, with ramps at both ends."""
    tip = cell.T_part_nozzle(q)[:, :3, 3]
    least = np.maximum(
        np.linalg.norm(np.diff(tip, axis=0), axis=1) / speed, (np.abs(np.diff(q, axis=0)) / bounds.velocity).max(axis=1)
    )
    least = np.maximum(least, 1e-3 * least.max() + 1e-6)
    least[1:-1] = np.maximum(least[1:-1], 0.25 * least[:-2] + 0.5 * least[1:-1] + 0.25 * least[2:])
    rates = np.abs(np.diff(q, axis=0)) / least[:, None]  # at full speed
    edge = np.maximum(rates[: len(q) // 4].max(axis=0), rates[-(len(q) // 4) :].max(axis=0))
    ramp = float((edge / (_RAMP * bounds.acceleration) + np.sqrt(edge / (_RAMP * bounds.jerk))).max())
    # the time t at which u is reached, with a smooth ramp of length `ramp` from rest, and the same to rest
    total = float(least.sum())
    ramp = min(max(ramp, _LEAST_RAMP), total)
    fine = np.linspace(0.0, total + ramp, 40 * len(q))
    rate = np.minimum(_smooth(fine / ramp), _smooth((total + ramp - fine) / ramp))
    gone = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine))])
    return np.interp(np.concatenate([[0.0], np.cumsum(least)]) * (gone[-1] / total), gone, fine)


def _smooth(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def _spline(times: Array, q: Array) -> Cubics:
    """A uniform B-spline of degree 3 controlled by postures q (k, nj) at times (k), from rest to rest.

    It does not overshoot its control values, so it is as far from the part as these are, except where it is rounded.
    """
    step = float(times[-1]) / (_PIECES + 2)
    at = np.arange(2, _PIECES + 1) * step
    inner = np.column_stack([np.interp(at, times, each) for each in q.T])
    P = np.vstack([np.repeat(q[:1], 3, axis=0), inner, np.repeat(q[-1:], 3, axis=0)])  # triple ends: at rest there
    a, b, c, d = P[:-3], P[1:-2], P[2:-1], P[3:]
    coefficients = np.stack(
        [
            (d - a + 3.0 * (b - c)) / (6.0 * step**3),
            (a - 2.0 * b + c) / (2.0 * step**2),
            (c - a) / (2.0 * step),
            (a + 4.0 * b + c) / 6.0,
        ]
    )
    return Cubics(np.arange(len(P) - 2, dtype=np.float64) * step, coefficients)


@dataclass(frozen=True)
class ClearSpace:
    """Where a travel may be: clear of part and obstacles by a margin; the tip no faster than `speed` [m/s].

    now: progress of the print, as for `Obstacles`
    """

    cell: Cell
    room: TravelClearance
    speed: float
    obstacles: Obstacles
    now: float
    margin: float

    @property
    def swing(self) -> Array:
        """Greatest motion of anything per radian of each joint (nj) [m]."""
        return self.obstacles.swing

    def clear(self, a: Array, b: Array) -> bool:
        """Whether the straight move between two postures (nj) is clear of part and obstacles."""
        steps = max(int(np.ceil(float(np.abs(b - a) @ self.swing) / _COARSE)), 1)
        q = a + np.linspace(0.0, 1.0, steps + 1)[:, None] * (b - a)
        if self.room.lacking(nozzle_points(self.cell, q)) > 0.0:
            return False
        return self.obstacles.hit(q, self.now, self.margin) < 0

    def towards(self, a: Array, b: Array) -> Array:
        """The posture one step from a towards b, or b if it is no farther away."""
        far = float(np.abs(b - a) @ self.swing)
        return b if far <= _STEP else a + _STEP / far * (b - a)

    def seconds(self, way: Array) -> Array:
        """Approximate durations (k - 1) [s] of straight moves between postures (k, nj), each from rest to rest."""
        share = np.linspace(0.0, 1.0, _LOOKS + 1)[:, None]
        q = way[:-1, None] + share * (way[1:] - way[:-1])[:, None]
        tips = self.cell.T_part_nozzle(q.reshape(-1, way.shape[1]))[:, :3, 3].reshape(*q.shape[:2], 3)
        tip = np.linalg.norm(np.diff(tips, axis=1), axis=2).max(axis=1) * _LOOKS / self.speed
        joints = (np.abs(np.diff(way, axis=0)) / self.cell.limits.velocity).max(axis=1)
        return np.maximum(tip, joints) + _STOP


class _Tree:
    """Postures (n, nj), and the parent that each was reached from; their array doubles in size when it is full."""

    def __init__(self, root: Array) -> None:
        self._rows, self.parent = root[None].copy(), [-1]

    @property
    def q(self) -> Array:
        return self._rows[: len(self.parent)]

    def nearest(self, q: Array, swing: Array) -> int:
        return int(np.argmin(np.abs(self.q - q) @ swing))

    def add(self, q: Array, parent: int) -> int:
        own = len(self.parent)
        if own == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[own] = q
        self.parent.append(parent)
        return own

    def to_root(self, k: int) -> list[Array]:
        way = []
        while k >= 0:
            way.append(self.q[k])
            k = self.parent[k]
        return way


def around(space: ClearSpace, ends: Ends) -> Iterator[list[Array]]:
    """Ways around everything, from above the start to above the end, by the postures (nj) at which they rest.

    They have been checked in coarse steps only. Each way comes shortened, then shortened with more clearance, then as
    found; then a way from higher up follows. Nothing if none is found.
    """
    cell, room = space.cell, space.room
    limits, both = cell.limits, np.stack([ends.start.q, ends.end.q])
    low = np.maximum(limits.q_min, both.min(axis=0) - np.pi)
    high = np.minimum(limits.q_max, both.max(axis=0) + np.pi)
    for factor in _LIFTS:
        a, b = np.hstack([lifted(cell, both, room, factor * room.lift), both[:, len(cell.arm) :]])
        if space.clear(a, a) and space.clear(b, b):
            way = _connect(space, a, b, low, high)
            if way is not None:
                yield shorter(space, way)
                yield shorter(replace(space, margin=space.margin + _ROOM), way)
                yield way


def _connect(space: ClearSpace, a: Array, b: Array, low: Array, high: Array) -> list[Array] | None:
    rng = np.random.default_rng(0)
    here, there, turned = _Tree(a), _Tree(b), False
    for k in range(_DRAWN):
        goal = there.q[0] if k == 0 else rng.uniform(low, high)
        near = here.nearest(goal, space.swing)
        new = space.towards(here.q[near], goal)
        if space.clear(here.q[near], new):
            own = here.add(new, near)
            other = there.nearest(new, space.swing)
            while True:  # extend the other tree as far as possible
                step = space.towards(there.q[other], new)
                if not space.clear(there.q[other], step):
                    break
                other = there.add(step, other)
                if np.array_equal(step, new):
                    way = here.to_root(own)[::-1] + there.to_root(other)[1:]
                    return way[::-1] if turned else way
        here, there, turned = there, here, not turned
    return None


def shorter(space: ClearSpace, way: Sequence[Array]) -> list[Array]:
    """Shorten a way, given by the postures (nj) at which it rests: replace detours by straight moves that save time.

    The straight moves must be clear, and are of all joints or of some, while the others move as before (Geraerts and
    Overmars, IJRR 26, 2007).
    """
    rng, q = np.random.default_rng(0), np.array(way)
    legs = space.seconds(q)
    for _ in range(_SHORTCUTS):
        if len(legs) < 2:
            break
        at = np.concatenate([[0.0], np.cumsum(legs)])
        two = np.sort(rng.uniform(0.0, at[-1], 2))
        some: Flags = np.ones(q.shape[1], dtype=np.bool_)
        if rng.random() >= _ALL:
            some = np.asarray(rng.random(q.shape[1]) < 0.5)
        i, j = np.minimum(np.searchsorted(at, two, side="right") - 1, len(legs) - 1)
        if i == j:
            continue
        share = ((two - at[[i, j]]) / legs[[i, j]])[:, None]
        a, b = q[[i, j]] + share * (q[[i + 1, j + 1]] - q[[i, j]])
        middle = q[i + 1 : j + 1].copy()
        gone = ((at[i + 1 : j + 1] - two[0]) / (two[1] - two[0]))[:, None]
        middle[:, some] = (a + gone * (b - a))[:, some]
        new = np.vstack([q[i], a, *([] if some.all() else middle), b, q[j + 1]])
        taken = space.seconds(new)
        if taken.sum() > at[j + 1] - at[i] - _WORTH:
            continue
        if all(space.clear(*leg) for leg in itertools.pairwise(new[1:-1])):
            q, legs = np.vstack([q[:i], new, q[j + 2 :]]), np.concatenate([legs[:i], taken, legs[j + 1 :]])
    return list(q)
