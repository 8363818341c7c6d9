"""A recorded motion compared with the path of its program: how far it deviates.

The path is compared, not the time: each recorded posture is matched, in order, to the point of the commanded path that
it has reached, in joints and at the tip. So delays and slower controllers do not count as deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Indices, ReadOnlyArrays
from planner.base.geometry import arc_lengths
from planner.cell.cell import Cell
from planner.feedback.filters import noise_left, noise_of, slope_of, smoothed, window_of
from planner.feedback.tracking import beside, track, tracked_path

LEVER = 0.1  # m: when postures are compared, a revolute joint counts like the tip at this distance
AROUND = 2e-3  # m of path around a point, plus the last step's length, within which the tip's distance is taken
MOST_LATE = 0.3  # s: longest delay between commands and joints
DEVIATION_SPAN = 0.036  # s over which deviations are smoothed by parabolas
SPEED_SPAN = 0.06  # s, likewise for speeds
MEAN_SHOWN, MOST_SHOWN = 0.8, 7.0  # × the noise: noise alone gives less, even for a robot at rest
SHOWN = 0.25  # standard error over value up to which a parameter is reported


@dataclass(frozen=True)
class CommandedPath(ReadOnlyArrays):
    """Postures (k) of a program, linearly interpolated.

    q (k, n) joints [rad, m];  tip (k, 3) of the nozzle in the part frame [m]
    target (m)    the index of each move's target posture
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

    @property
    def way(self) -> Array:
        """Arc length (k) of the tip's path up to each posture [m]."""
        return arc_lengths(self.tip)


@dataclass(frozen=True)
class FollowedPath(ReadOnlyArrays):
    """Recorded samples (s) matched to the commanded path.

    time (s) [s];  segment, share (s): the segment of the path, and the fraction of it
    tip (s, 3)     of the nozzle in the part frame, smoothed [m]
    off (s, 3)     tip relative to the nearest point of the path, smoothed [m]; joints (s, n): likewise [rad, m]
    noise          standard deviation of `off` along one axis [m]; joint_noise (n): of `joints`
    way (s)        arc length of the path covered [m];  speed (s) along it, speed_noise: its standard deviation [m/s]
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
    """Mean and greatest distance, and the standard error of a single one from noise; at: the sample of the greatest."""

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
    """A value with its standard error; told: the recording shows it, otherwise `value` is a lower bound, or NaN."""

    value: float
    error: float
    told: bool
    reason: str = ""


def follow(path: CommandedPath, time: Array, q: Array, cell: Cell) -> FollowedPath:
    """Match samples (s) of joints q (s, n) [rad, m], from the start of the path to its end, to the path."""
    tip = cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]
    lever = np.where(cell.limits.turns, LEVER, 1.0)
    step = float(np.median(np.diff(time)))
    window, fast = window_of(DEVIATION_SPAN, step), window_of(SPEED_SPAN, step)
    # where lines turn back on each other, noise could move a sample to the line that follows
    samples = smoothed(np.hstack([tip, lever * q]), window)
    gone = np.append(0.0, np.linalg.norm(np.diff(samples, axis=0), axis=1))
    place, _ = track(tracked_path(np.hstack([path.tip, lever * path.q])), samples, gone)
    segment = np.minimum(place.astype(np.intp), len(path.tip) - 2)
    share = place - segment
    told = path.q[segment] + share[:, None] * (path.q[segment + 1] - path.q[segment])
    between = np.diff(path.tip, axis=0)[segment]
    size = np.linalg.norm(between, axis=1)
    # measured beyond the segment's ends, where clipping would count noise to one side only
    aside = tip - path.tip[segment] - share[:, None] * between
    along = (aside * between).sum(axis=1) / np.maximum(size, 1e-12)
    way = path.way[segment] + share * size + along
    noise = float(np.sqrt((noise_of(tip) ** 2).mean()))
    return FollowedPath(
        time=time,
        segment=segment,
        share=share,
        tip=smoothed(tip, window),
        off=smoothed(beside(path.tip, tip, segment, AROUND + gone), window),
        joints=smoothed(q - told, window),
        noise=noise_left(window) * noise,
        joint_noise=noise_left(window) * noise_of(q),
        way=way,
        speed=slope_of(way, fast, step),
        speed_noise=noise_left(fast, step) * noise,
    )


def off_commands(
    time: Array, executed: Array, commanded: Array, cell: Cell
) -> tuple[PathDeviation, tuple[PathDeviation, ...]]:
    """How far tip and joints of samples (s, n) leave the path of commands (s, n) on the same clock [rad, m].

    Each sample is compared with the commands that the joints may have reached: those of the last MOST_LATE.
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
    window = window_of(DEVIATION_SPAN, step)
    left = noise_left(window)
    noise = left * float(np.sqrt((noise_of(tips[0]) ** 2).mean()))
    tip = deviation_of(np.linalg.norm(smoothed(off, window), axis=1), noise, 2)
    return tip, tuple(
        deviation_of(np.abs(each), left * float(own), 1)
        for each, own in zip(smoothed(joints, window).T, noise_of(executed), strict=True)
    )


def deviation_of(size: Array, noise: float, axes: int, of: Flags | None = None) -> PathDeviation:
    """Deviation from distances (s), all or some, with noise along `axes` axes; the mean excludes the noise."""
    of = np.ones(len(size), dtype=np.bool_) if of is None else of
    own = size[of]
    square = float((own**2).mean())
    share = max(1.0 - axes * noise**2 / square, 0.0) if square > 0.0 else 0.0
    worst = int(np.argmax(np.where(of, size, -1.0)))
    return PathDeviation(float(own.mean()) * float(np.sqrt(share)), float(size[worst]), noise, worst)
