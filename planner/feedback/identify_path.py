"""How a recorded motion leaves the path of its program: deviation, cut corners, and how far ahead the controller brakes.

The path is compared, not the time: each recorded posture is set beside the place of the commanded path that it has come
to, in order, in joints and at the tip. So delays and slower controllers do not count as deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import lfilter, savgol_coeffs, savgol_filter

from planner.base.arrays import Array, Flags, Indices, ReadOnlyArrays
from planner.base.compiled import njit
from planner.cell.cell import Cell

LEVER = 0.1  # m: a joint that turns counts as much as the tip at this distance, where places are compared
ALIKE = 1e-4  # m by which an earlier place of the path may be farther off than the nearest and is taken all the same
AHEAD = (3e-3, 0.1)  # m, and s of the present speed, within which the next place is looked for: a cut corner is a leap
AROUND = 2e-3  # m of path around a place within which the tip's distance is taken
MOST_LATE = 0.3  # s by which joints may follow their commands
DEVIATION_SPAN = 0.036  # s over which deviations are smoothed, by parabolas
SPEED_SPAN = 0.06  # s, likewise of speeds
TURN = np.radians(5.0)  # of the direction at a target, from which it is a corner
SIDES = 1e-3  # m that lines have at least on both sides of a corner
REST = 0.02  # of the greatest speed, below which the tip rests
CORNER_TICK = 1e-3  # s between instants at which a corner is modelled
CORNER_SPAN = 0.15  # s before and behind it: some times the lag of any arm
CLEAR_CUT = 6.0  # times the noise, from which cuts tell the lag
LEFT = 0.05  # of a cut, from which on the line is left
LEAST_SAMPLES = 8  # near a corner
MODEL = 0.05  # of a cut: no controller has just parabolas and a lag
TRUE = 0.1  # of lag, share and ramps: how the speed changes within a corner is not seen, and no ramp is quite even
MEAN_SHOWN, MOST_SHOWN = 0.8, 7.0  # times the noise: noise alone leaves less, of a robot at rest too
SHOWN = 0.25  # standard error over value up to which a parameter is told
LEAST_CORNERS = 4
HELD = 0.95  # of the programmed speed, below which something holds the robot back
STOP_SPAN = (-0.5, 0.2)  # s around a stop within which it is looked at
STOP_NEAR = 3e-4  # m from a target, within which the robot rests at it
STOP_UNITS = np.array([1.0, 1.0, 1e-3])  # of speed, instant and ramp in a search [m/s, s, s]
MOST_LAG, LAG_STEP = 0.05, 2e-3  # s of a lag that is looked for, and by which it is varied
CLEAR_SPEED = 15.0  # times its noise, from which a speed is known well enough for its stop
SAME_SPEED = 0.15  # by which a stop's fitted speed may be off the one before it
SHORTEST_RAMP = 5e-3  # s
MOST_STOPS = 12  # that are fitted
ALIKE_SPEED = 1.1  # times, by which speeds of stops differ that are told together
NO_STOP = "it never stops from a steady speed"
STEADY = 0.2  # of the deceleration of stops, below which its speed is steady
LEAST_HELD = 10  # samples on moves of one length
APART = 1.5  # times, by which lengths of moves differ where a look-ahead is told from other causes


@dataclass(frozen=True)
class CommandedPath(ReadOnlyArrays):
    """Postures (k) of a program, straight from one to the next.

    q (k, n) joints [rad, m];  tip (k, 3) of the nozzle in the part frame [m]
    target (m)    the posture that is the target of each move
    zone (m)      radius of its corner zone [m], NaN where it has none;  fine (m): the robot rests there
    line (m)      the move is a line;  laid (m): material is laid on it
    speed (m)     of the tip [m/s], NaN where none is programmed
    """

    q: Array
    tip: Array
    target: Indices
    zone: Array
    fine: Flags
    line: Flags
    laid: Flags
    speed: Array


@dataclass(frozen=True)
class FollowedPath(ReadOnlyArrays):
    """Recorded samples (s) set beside the commanded path.

    time (s) [s];  segment, share (s): between which postures, and where between them
    tip (s, 3)     where it was in the part frame, smoothed [m]
    off (s, 3)     tip from the nearest place of the path [m], smoothed; joints (s, n): likewise [rad, m]
    noise          standard deviation of `off` along one axis [m]; joint_noise (n): of `joints`
    way (s)        metres of the tip's path behind it;  speed (s) along it, speed_noise: its standard deviation [m/s]
    """

    time: Array
    segment: Indices
    share: Array
    tip: Array
    off: Array
    joints: Array
    noise: float
    joint_noise: Array
    way: Array
    speed: Array
    speed_noise: float


@dataclass(frozen=True)
class PathDeviation:
    """Mean and greatest distance, and the standard error of a single one that noise leaves; at: the sample of the greatest."""

    mean: float
    most: float
    error: float
    at: int

    @property
    def shown(self) -> bool:
        """Whether it stands out from noise."""
        return self.mean > MEAN_SHOWN * self.error or self.most > MOST_SHOWN * self.error


@dataclass(frozen=True)
class ShownValue:
    """A value with its standard error; told: the recording shows it, otherwise `value` is what it is at least, or nothing."""

    value: float
    error: float
    told: bool
    reason: str = ""


@dataclass(frozen=True)
class CutCorners:
    """Corners with zones of one radius [m]: how many, by how much they are cut [m], the scatter [m], and how far before the
    target the tip leaves its line [m]."""

    zone: float
    count: int
    mean: float
    most: float
    scatter: float
    leaves: float


@dataclass(frozen=True)
class Braking:
    """Stops from one speed [m/s]: how many, and how long an even ramp to rest takes [s], with its standard error; the robot
    begins to brake so much ahead, and half of that times the speed before the place."""

    speed: float
    count: int
    time: float
    error: float

    @property
    def way(self) -> float:
        """How far ahead of the stop it begins [m]."""
        return 0.5 * self.speed * self.time


@dataclass(frozen=True)
class PathFindings:
    """What a recording shows of how a controller follows a program.

    tip           of all of the path;  laid: where material is laid, None without
    joints        of each joint [rad, m]
    corners       by zone;  depth: share of a zone's parabola that is cut; lag: time constant that rounds corners [s]
    brakes        how long before a stop it begins to brake, by speed
    ahead         moves ahead of the one that runs that it knows
    """

    tip: PathDeviation
    laid: PathDeviation | None
    joints: tuple[PathDeviation, ...]
    corners: tuple[CutCorners, ...]
    depth: ShownValue
    lag: ShownValue
    brakes: tuple[Braking, ...]
    ahead: ShownValue


# ----------------------------------------------------------------------------------------------------
# Places of the path.


def follow(path: CommandedPath, time: Array, q: Array, cell: Cell) -> FollowedPath:
    """Set samples (s) of joints q (s, n) [rad, m], from the path's beginning to its end, beside the path."""
    tip = cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]
    lever = np.where(cell.limits.turns, LEVER, 1.0)
    step = float(np.median(np.diff(time)))
    segment, share, off = _places(
        np.ascontiguousarray(np.hstack([path.tip, lever * path.q])),
        np.ascontiguousarray(np.hstack([tip, lever * q])),
        (AHEAD[0], AHEAD[1] / step, ALIKE, AROUND),
    )
    window = _odd(DEVIATION_SPAN / step)
    told = path.q[segment] + share[:, None] * (path.q[segment + 1] - path.q[segment])
    steps = np.linalg.norm(np.diff(path.tip, axis=0), axis=1)
    # places come one after another, so noise moves them on: the tip is as often before as behind them
    between = np.diff(path.tip, axis=0)[segment]
    beside = tip - path.tip[segment] - share[:, None] * between
    along = (beside * between).sum(axis=1) / np.maximum(steps[segment], 1e-12)
    way = np.append(0.0, np.cumsum(steps))[segment] + share * steps[segment] + along
    fast, noise = _odd(SPEED_SPAN / step), float(np.sqrt((_noise(tip) ** 2).mean()))
    left = np.sqrt((savgol_coeffs(window, 2) ** 2).sum())
    return FollowedPath(
        time=time,
        segment=segment,
        share=share,
        tip=_smooth(tip, window),
        off=_smooth(off, window),
        joints=_smooth(q - told, window),
        noise=float(left * noise),
        joint_noise=left * _noise(q),
        way=way,
        speed=savgol_filter(way, fast, 2, deriv=1, delta=step),
        speed_noise=float(noise * np.sqrt((savgol_coeffs(fast, 2, deriv=1, delta=step) ** 2).sum())),
    )


def _odd(count: float) -> int:
    """An odd number of samples near a count, enough for a parabola."""
    return max(2 * int(0.5 * count) + 1, 5)


def _smooth(values: Array, window: int) -> Array:
    out: Array = savgol_filter(values, window, 2, axis=0)
    return out


def _noise(values: Array) -> Array:
    """Standard deviation (c) of single samples (s, c): third differences hold noise, and hardly any motion."""
    out: Array = 1.4826 * np.median(np.abs(np.diff(values, 3, axis=0)), axis=0) / np.sqrt(20.0)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _places(path: Array, samples: Array, limits: tuple[float, float, float, float]) -> Any:
    """The segment (s), the share of it (s), and the tip's way from the path (s, 3) of samples (s, d) along a path (k, d).

    The first three columns are the tip. limits: how far ahead the next place is looked for, in m and in steps; by how much
    an earlier one may be farther; around which the tip's distance is taken.
    """
    ahead, steps, alike, around = limits
    count, last, width = len(samples), len(path) - 2, path.shape[1]
    segments, shares, off = np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros((count, 3))
    now, at = 0, 0.0
    for i in range(count):
        step = 0.0
        if i > 0:
            for c in range(width):
                step += (samples[i, c] - samples[i - 1, c]) ** 2
        reach = ahead + steps * np.sqrt(step)
        # the nearest place within reach
        nearest, gone, j = np.inf, 0.0, now
        while j <= last and gone <= reach:
            u, far, length = _beside(path, samples[i], j, width, at if j == now else 0.0)
            nearest = min(nearest, far)
            gone += (1.0 - at) * length if j == now else length
            j += 1
        # the earliest that is hardly farther, and on from there as long as they come nearer
        gone, j, best, best_u, found = 0.0, now, now, at, np.inf
        while j <= last and gone <= reach:
            u, far, length = _beside(path, samples[i], j, width, at if j == now else 0.0)
            if far > nearest + alike or far > found:
                if found < np.inf:
                    break
            else:
                best, best_u, found = j, u, far
                if u < 1.0:
                    break  # no nearer place follows at once
            gone += (1.0 - at) * length if j == now else length
            j += 1
        now, at = best, best_u
        segments[i], shares[i] = now, at
        # the tip's own nearest place, not far from there
        least = np.inf
        for side in (-1, 1):
            gone, j = 0.0, now if side < 0 else now + 1
            while 0 <= j <= last and gone <= around:
                u, far, length = _beside(path, samples[i], j, 3, 0.0)
                if far < least:
                    least = far
                    for c in range(3):
                        off[i, c] = samples[i, c] - path[j, c] - u * (path[j + 1, c] - path[j, c])
                gone += length
                j += side
    return segments, shares, off


@njit(cache=True, nogil=True, error_model="numpy")
def _beside(path: Array, sample: Array, j: int, width: int, since: float) -> Any:
    """The nearest place of a segment to a sample, as a share of it from `since` on, its distance, and the segment's length."""
    along, square, off = 0.0, 0.0, 0.0
    for c in range(width):
        d = path[j + 1, c] - path[j, c]
        along += d * (sample[c] - path[j, c])
        square += d * d
    u = min(max(along / square, since), 1.0) if square > 0.0 else since
    for c in range(width):
        off += (sample[c] - path[j, c] - u * (path[j + 1, c] - path[j, c])) ** 2
    return u, np.sqrt(off), np.sqrt(square)


def off_commands(
    time: Array, executed: Array, commanded: Array, cell: Cell
) -> tuple[PathDeviation, tuple[PathDeviation, ...]]:
    """How far the tip, and each joint, of samples (s, n) leave the path of commands (s, n) of the same clock [rad, m].

    Of a command's path the part is looked at that joints may have come to: until MOST_LATE before.
    """
    tips = [cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3] for q in (executed, commanded)]
    lever = np.where(cell.limits.turns, LEVER, 1.0)
    samples, path = (np.hstack([tip, lever * q]) for tip, q in zip(tips, (executed, commanded), strict=True))
    step = float(np.median(np.diff(time)))
    off, joints = np.full(tips[0].shape, np.inf), np.zeros_like(executed)
    nearest, least = np.full(len(time), np.inf), np.full(len(time), np.inf)
    at = np.arange(len(time))
    for late in range(-1, round(MOST_LATE / step) + 1):
        begin = np.clip(at - late - 1, 0, len(time) - 2)
        for width, best in ((path.shape[1], nearest), (3, least)):
            a, way = path[begin, :width], path[begin + 1, :width] - path[begin, :width]
            square = np.maximum((way**2).sum(axis=1), 1e-30)
            u = np.clip(((samples[:, :width] - a) * way).sum(axis=1) / square, 0.0, 1.0)[:, None]
            beside = samples[:, :width] - a - u * way
            size = np.linalg.norm(beside, axis=1)
            nearer = size < best
            best[nearer] = size[nearer]
            if width == 3:
                off[nearer] = beside[nearer]
            else:
                told = commanded[begin] + u * (commanded[begin + 1] - commanded[begin])
                joints[nearer] = (executed - told)[nearer]
    window = _odd(DEVIATION_SPAN / step)
    left = np.sqrt((savgol_coeffs(window, 2) ** 2).sum())
    everywhere = np.ones(len(time), dtype=np.bool_)
    noise = left * _noise(executed)
    tip = _deviation(
        np.linalg.norm(_smooth(off, window), axis=1),
        float(left * np.sqrt((_noise(tips[0]) ** 2).mean())),
        2,
        everywhere,
    )
    return tip, tuple(
        _deviation(np.abs(each), float(own), 1, everywhere)
        for each, own in zip(_smooth(joints, window).T, noise, strict=True)
    )


# ----------------------------------------------------------------------------------------------------
# What they show.


def findings(path: CommandedPath, followed: FollowedPath) -> PathFindings:
    """PathDeviation, corners, braking and look-ahead of a followed path."""
    size = np.linalg.norm(followed.off, axis=1)
    move = np.searchsorted(path.target, followed.segment, side="right") if len(path.target) else followed.segment * 0
    laid = path.laid[np.minimum(move, len(path.laid) - 1)] if path.laid.any() else np.zeros(len(size), dtype=np.bool_)
    corners = _corners(path, followed)
    depth, lag = _corner_shape(corners, followed.noise)
    stops = _stops(path, followed)
    return PathFindings(
        tip=_deviation(size, followed.noise, 2, np.ones(len(size), dtype=np.bool_)),
        laid=_deviation(size, followed.noise, 2, laid) if laid.any() else None,
        joints=tuple(
            _deviation(np.abs(each), float(noise), 1, np.ones(len(size), dtype=np.bool_))
            for each, noise in zip(followed.joints.T, followed.joint_noise, strict=True)
        ),
        corners=_by_zone(corners),
        depth=depth,
        lag=lag,
        brakes=tuple(_brakes(stops)),
        ahead=_ahead(path, followed, stops),
    )


def _deviation(size: Array, noise: float, axes: int, of: Flags) -> PathDeviation:
    """Of distances (s) with noise along so many axes; the mean is without what noise adds to it."""
    own = size[of]
    square = float((own**2).mean())
    share = max(1.0 - axes * noise**2 / square, 0.0) if square > 0.0 else 0.0
    worst = int(np.argmax(np.where(of, size, -1.0)))
    return PathDeviation(float(own.mean()) * float(np.sqrt(share)), float(size[worst]), noise, worst)


def _brakes(stops: Sequence[_Stop]) -> list[Braking]:
    """Stops from speeds that are alike together."""
    groups: list[list[_Stop]] = []
    for stop in sorted(stops, key=lambda each: each.speed):
        if groups and stop.speed < ALIKE_SPEED * groups[-1][0].speed:
            groups[-1].append(stop)
        else:
            groups.append([stop])
    out = []
    for group in groups:
        times = np.array([stop.time for stop in group])
        weights = 1.0 / np.maximum([stop.error for stop in group], 1e-5) ** 2
        scatter = float(times.std(ddof=1) / np.sqrt(len(times))) if len(times) > 1 else 0.0
        speed, time = float(np.mean([stop.speed for stop in group])), float(np.average(times, weights=weights))
        error = float(np.hypot(max(float(weights.sum() ** -0.5), scatter), TRUE * time))
        out.append(Braking(speed, len(group), time, error))
    return out


# Corners.


@dataclass(frozen=True)
class _PassedCorner:
    """How a corner was passed: zone, reach of its parabola, cut, where the line was left [m]; directions before and behind
    (3 each); when the tip was how far from it on the programmed lines (g) [s], (g) [m]."""

    zone: float
    reach: float
    cut: float
    leaves: float
    comes: Array
    goes: Array
    time: Array
    way: Array

    def modelled(self, depth: float, lag: float) -> float:
        """By how much it is cut [m] by a share of its parabola, and a lag [s] before and behind."""
        s = self.way[:, None]
        lines = np.minimum(s, 0.0) * self.comes + np.maximum(s, 0.0) * self.goes
        u = np.clip(0.5 + 0.5 * s / self.reach, 0.0, 1.0)
        parabola = self.reach * (u**2 * self.goes - (1.0 - u) ** 2 * self.comes)
        places = np.where(np.abs(s) < self.reach, lines + depth * (parabola - lines), lines)
        if lag > CORNER_TICK:
            # as `planner.export.player.path` has it: what was commanded before and after counts by exp(-|dt| / lag)
            keep = float(np.exp(-CORNER_TICK / lag))
            places = _followed(_followed(places, keep)[::-1], keep)
        places = _smooth(places, _odd(DEVIATION_SPAN / CORNER_TICK))  # as recorded ones are
        return float(np.linalg.norm(places, axis=1).min())


def _followed(places: Array, keep: float) -> Array:
    """Places (g, 3) through a first-order lag that has followed their first line for long."""
    first, slope = places[0], places[1] - places[0]
    line = first + slope * np.arange(len(places))[:, None]
    out: Array = line - slope * keep / (1.0 - keep) + lfilter([1.0 - keep], [1.0, -keep], places - line, axis=0)
    return out


def _corners(path: CommandedPath, followed: FollowedPath) -> list[_PassedCorner]:
    """All targets with a zone at which the direction changes between two lines."""
    steps = np.diff(path.tip, axis=0)
    way, at = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1))), _ways(path)
    out = []
    for i in range(1, len(at) - 1):
        side = 0.5 * min(at[i] - at[i - 1], at[i + 1] - at[i])
        if path.fine[i] or not path.zone[i] > 0.0 or not (path.line[i] and path.line[i + 1]) or side < 0.5 * SIDES:
            continue
        corner = path.tip[path.target[i]]
        reach = min(float(path.zone[i]), side)
        comes, goes = (
            (corner - _at(path.tip, way, at[i] - reach)) / reach,
            (_at(path.tip, way, at[i] + reach) - corner) / reach,
        )
        near = np.flatnonzero(np.abs(followed.way - at[i]) <= side)
        if np.linalg.norm(goes - comes) < TURN or len(near) < LEAST_SAMPLES:
            continue
        near = np.arange(near[0], near[-1] + 1)
        cut = _nearest(followed.tip[near], corner)
        size = np.linalg.norm(followed.off[near], axis=1)
        left = near[(size > max(4.0 * followed.noise, LEFT * cut)) & (followed.way[near] <= at[i])]
        passed = _passed(followed, near, float(at[i]), min(max(3.0 * cut, reach), 0.9 * side))
        if passed is None:
            continue
        out.append(
            _PassedCorner(
                zone=float(path.zone[i]),
                reach=reach,
                cut=cut,
                leaves=float(at[i] - followed.way[left[0]]) if len(left) else float("nan"),
                comes=comes,
                goes=goes,
                time=passed[0],
                way=passed[1],
            )
        )
    return out


def _nearest(tip: Array, place: Array) -> float:
    """How near a polyline (k, 3) passes a place (3) [m]."""
    first, step = tip[:-1], np.diff(tip, axis=0)
    u = np.clip(((place - first) * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-30), 0.0, 1.0)
    return float(np.linalg.norm(first + u[:, None] * step - place, axis=1).min())


def _passed(followed: FollowedPath, near: Indices, at: float, width: float) -> tuple[Array, Array] | None:
    """When (g) [s] how much (g) [m] of programmed lines lay behind a corner; None where too few samples tell.

    Near the corner, where a cut path has no place on the lines, a cubic between both sides.
    """
    t, way, speed = followed.time[near], followed.way[near] - at, followed.speed[near]
    before, behind = np.flatnonzero(way < -width), np.flatnonzero(way > width)
    if not len(before) or not len(behind):
        return None
    a, b = int(before[-1]), int(behind[0])
    middle = CubicHermiteSpline(t[[a, b]], way[[a, b]], speed[[a, b]])
    grid = np.arange(t[a] - CORNER_SPAN, t[b] + CORNER_SPAN, CORNER_TICK)
    out = np.where(
        grid < t[a],
        np.where(grid < t[0], way[0] + speed[0] * (grid - t[0]), np.interp(grid, t[: a + 1], way[: a + 1])),
        np.where(grid > t[-1], way[-1] + speed[-1] * (grid - t[-1]), np.interp(grid, t[b:], way[b:])),
    )
    inside = (grid >= t[a]) & (grid <= t[b])
    out[inside] = middle(grid[inside])
    return grid, out


def _at(tip: Array, way: Array, place: float) -> Array:
    """The tip (3) at metres of path."""
    return np.array([np.interp(place, way, column) for column in tip.T])


def _by_zone(corners: Sequence[_PassedCorner]) -> tuple[CutCorners, ...]:
    out = []
    for zone in sorted({round(corner.zone, 6) for corner in corners}):
        own = [corner for corner in corners if round(corner.zone, 6) == zone]
        cuts = np.array([corner.cut for corner in own])
        left = np.array([corner.leaves for corner in own])
        leaves = float(np.nanmedian(left)) if np.isfinite(left).any() else float("nan")
        scatter = float(cuts.std(ddof=1)) if len(cuts) > 1 else float("nan")
        out.append(CutCorners(zone, len(own), float(cuts.mean()), float(cuts.max()), scatter, leaves))
    return tuple(out)


def _corner_shape(corners: Sequence[_PassedCorner], noise: float) -> tuple[ShownValue, ShownValue]:
    """Which share of its parabola a zone is cut by, and the time constant of the lag that rounds corners besides [s]."""
    none = float("nan")
    if len(corners) < LEAST_CORNERS:
        return (ShownValue(none, none, False, f"{len(corners)} corners, {LEAST_CORNERS} are needed"),) * 2
    cuts = np.array([corner.cut for corner in corners])
    if np.percentile(cuts, 10.0) < CLEAR_CUT * noise:
        # the nearest of places with noise is nearer than it is
        return (ShownValue(none, none, False, "noise hides how much its corners are cut"),) * 2
    weight = 1.0 / np.hypot(noise, MODEL * cuts)

    def residuals(x: Array) -> Array:
        return (np.array([corner.modelled(float(x[0]), float(x[1]) * 1e-3) for corner in corners]) - cuts) * weight

    found = least_squares(residuals, [0.8, 15.0], bounds=([0.0, 0.0], [2.0, 300.0]), x_scale=[0.1, 2.0], diff_step=1e-3)
    scale = max(1.0, float(found.fun @ found.fun) / (len(cuts) - 2))
    errors = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * scale)
    depth, lag = found.x[0], 1e-3 * found.x[1]
    return _shown(float(depth), float(errors[0])), _shown(float(lag), 1e-3 * float(errors[1]))


def _shown(value: float, error: float) -> ShownValue:
    error = float(np.hypot(error, TRUE * value)) if error > 0.0 else error
    told = bool(0.0 < error < SHOWN * value)  # at an end of what is looked for there is no error
    return ShownValue(
        value,
        error,
        told,
        "" if told else "its corners do not show it: others with larger zones, or faster ones, would",
    )


# Braking and look-ahead.


@dataclass(frozen=True)
class _Stop:
    """A stop from a steady speed [m/s]: how long an even ramp to it takes [s], its standard error, and how far it goes [m]."""

    speed: float
    time: float
    error: float

    @property
    def way(self) -> float:
        """How far the robot goes while it brakes [m]."""
        return 0.5 * self.speed * self.time


def _stops(path: CommandedPath, followed: FollowedPath) -> list[_Stop]:
    """Stops at `fine` targets of lines, from the fastest ones on."""
    at = _ways(path)
    rest = max(REST * float(followed.speed.max(initial=0.0)), 3.0 * followed.speed_noise)
    still = followed.speed < rest
    found = []
    for i in np.flatnonzero(path.fine & path.line):
        there = np.flatnonzero(still & (np.abs(followed.way - at[i]) < STOP_NEAR + 5.0 * followed.noise))
        if not len(there):
            continue
        end = int(there[0])
        window = slice(*np.searchsorted(followed.time, followed.time[end] + np.array(STOP_SPAN)).tolist())
        top = float(np.percentile(followed.speed[window], 90.0))
        fast = np.flatnonzero(followed.speed[window] >= 0.9 * top) + window.start
        if top > max(3.0 * rest, CLEAR_SPEED * followed.speed_noise) and len(fast) and fast[-1] - fast[0] > 3:
            # to where it moves on
            moves_on = np.flatnonzero(~still[end : window.stop])
            last = end + int(moves_on[0]) if len(moves_on) else window.stop
            found.append((top, slice(int(fast[0]), last), float(at[i])))
    found.sort(key=lambda each: -each[0])
    return _fitted_stops(followed, found[:MOST_STOPS])


def _fitted_stops(followed: FollowedPath, parts: Sequence[tuple[float, slice, float]]) -> list[_Stop]:
    """Stops with the one lag [s] that explains all of them best, from their speeds [m/s], samples and places [m]."""
    if not parts:
        return []

    def fits(lag: float) -> list[Any]:
        return [_stop(followed, part, place, top, lag) for top, part, place in parts]

    def squares(lag: float) -> float:
        return float(sum(2.0 * fit.cost for fit in fits(lag)))

    best = minimize_scalar(squares, bounds=(0.0, MOST_LAG), method="bounded", options={"xatol": 3e-4, "maxiter": 14})
    lag = float(best.x)
    # how well the lag is known, and what that does to the ramps
    sides = (max(lag - LAG_STEP, 0.0), lag + LAG_STEP)
    around = [fits(each) for each in sides]
    rise = float(np.mean([sum(2.0 * fit.cost for fit in each) for each in around])) - float(best.fun)
    lag_error = LAG_STEP / float(np.sqrt(max(rise, 1e-3)))
    out = []
    for (top, _, _), fit, low, high in zip(parts, fits(lag), *around, strict=True):
        speed, _, time = fit.x * STOP_UNITS
        scale = max(2.0 * float(fit.cost) / max(len(fit.fun) - 3, 1), 1.0)
        own = float(np.sqrt(np.linalg.pinv(fit.jac.T @ fit.jac)[2, 2] * scale)) * float(STOP_UNITS[2])
        by_lag = float((high.x[2] - low.x[2]) * STOP_UNITS[2]) / (sides[1] - sides[0]) * lag_error
        error = float(np.hypot(own, by_lag))
        near = abs(speed / top - 1.0) < SAME_SPEED and time > SHORTEST_RAMP
        if near and error < SHOWN * time:
            out.append(_Stop(float(speed), float(time), error))
    return out


def _stop(followed: FollowedPath, part: slice, place: float, top: float, lag: float) -> Any:
    """An even ramp from a steady speed to rest at a place, behind a lag as that of corners, fitted to samples: speed, instant
    of rest, and time of the ramp, in STOP_UNITS."""
    t, way = followed.time[part] - followed.time[part.start], followed.way[part] - place
    grid = np.arange(t[0] - CORNER_SPAN, t[-1] + CORNER_SPAN, CORNER_TICK)
    weight = 1.0 / max(followed.noise, 1e-6)

    def residuals(x: Array) -> Array:
        speed, arrives, time = x * STOP_UNITS
        left = arrives - grid
        own = np.where(
            left > time, speed * (left - 0.5 * time), np.where(left > 0.0, 0.5 * speed * left**2 / time, 0.0)
        )
        own = own[:, None]
        if lag > CORNER_TICK:
            keep = float(np.exp(-CORNER_TICK / lag))
            own = _followed(_followed(own, keep)[::-1], keep)[::-1]
        out: Array = (-np.interp(t, grid, own[:, 0]) - way) * weight
        return out

    slow = float(t[np.argmax(followed.speed[part] < 0.5 * top)]) if (followed.speed[part] < 0.5 * top).any() else t[-1]
    start = np.array([top, slow + 0.05, 0.1]) / STOP_UNITS
    bounds = ([0.1 * start[0], 0.0, 1.0], [3.0 * start[0], 1e4, 1000.0])
    return least_squares(residuals, np.clip(start, bounds[0], bounds[1]), bounds=bounds, diff_step=1e-3, max_nfev=30)


def _ways(path: CommandedPath) -> Array:
    """Metres of the tip's path at each target (m)."""
    lengths = np.linalg.norm(np.diff(path.tip, axis=0), axis=1)
    out: Array = np.append(0.0, np.cumsum(lengths))[path.target]
    return out


def _ahead(path: CommandedPath, followed: FollowedPath, stops: Sequence[_Stop]) -> ShownValue:
    """How many moves ahead of the one that runs the controller knows: so many as the way holds in which it could stop.

    A controller that knows few is never faster than that allows: its speed is steady below the programmed one, and the way
    in which it could stop holds the same number of moves, however long these are. One that knows enough shows only what
    it needs at least.
    """
    none = float("nan")
    if not stops:
        return ShownValue(none, none, False, NO_STOP)
    at, known = _ways(path), sorted(stops, key=lambda stop: stop.speed)
    speeds = np.array([0.0, *(stop.speed for stop in known)])
    # ramps from speeds that it never stopped from are taken to grow with the speed, as with an even acceleration
    need = 0.5 * followed.speed * np.interp(followed.speed, speeds, np.array([0.0, *(stop.time for stop in known)]))
    places = np.append(0.0, at)
    turn = np.append(True, np.diff(places) > 0.0)
    count = np.arange(len(places), dtype=np.float64)
    held_by = np.interp(followed.way + need, places[turn], count[turn]) - np.interp(
        followed.way, places[turn], count[turn]
    )
    move = np.minimum(np.searchsorted(at, followed.way, side="right"), len(at) - 1)
    size = np.diff(places)[move]
    step = float(np.median(np.diff(followed.time)))
    steep = float(np.median([stop.speed / stop.time for stop in stops]))
    slope = np.abs(np.gradient(followed.speed, step))
    cruising = path.line[move] & (slope < STEADY * steep) & (followed.speed > 0.2 * speeds[1])
    cruising &= (followed.speed < 1.05 * speeds[-1]) & (followed.way + need < at[-1])
    if not cruising.any():
        return ShownValue(none, none, False, "no steady speed from which it stops")
    # the move that runs is one of them; so much as a move more is left to how well stops are known
    most = max(float(np.floor(np.percentile(held_by[cruising], 90.0) - 2.0)), 0.0)
    held = cruising & (followed.speed < HELD * path.speed[move])
    groups = []
    for length in np.unique(np.round(size[held], 5)):
        own = held & (np.abs(size - length) < 1e-5)
        if own.sum() >= LEAST_HELD:
            groups.append((float(length), float(np.median(held_by[own])) - 1.0))
    lengths, counts = np.array(groups).reshape(-1, 2).T
    if most < 1.0:
        return ShownValue(none, none, False, "stops are too short beside its moves")
    if len(counts) < 2 or lengths.max() < APART * lengths.min():
        return ShownValue(most, none, False, "at least")
    scatter = float(counts.std(ddof=1))
    if scatter > max(0.75, 0.25 * float(counts.mean())):
        return ShownValue(most, none, False, "at least")
    return ShownValue(float(counts.mean()), max(scatter, 1.0), True)
