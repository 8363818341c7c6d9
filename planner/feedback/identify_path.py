"""A recorded motion set beside the path of its program: how far it leaves that.

The path is compared, not the time: each recorded posture is set beside the place of the commanded path that it has come
to, in order, in joints and at the tip. So delays and slower controllers do not count as deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Indices, ReadOnlyArrays
from planner.base.geometry import arc_lengths
from planner.cell.cell import Cell
from planner.feedback.filters import noise_left, noise_of, slope_of, smoothed, window_of
from planner.feedback.tracking import beside, track, tracked_path

LEVER = 0.1  # m: a joint that turns counts as much as the tip at this distance, where places are compared
AROUND = 2e-3  # m of path around a place, and a sample's way more, within which the tip's distance is taken
MOST_LATE = 0.3  # s by which joints may follow their commands
DEVIATION_SPAN = 0.036  # s over which deviations are smoothed, by parabolas
SPEED_SPAN = 0.06  # s, likewise of speeds
MEAN_SHOWN, MOST_SHOWN = 0.8, 7.0  # times the noise: noise alone leaves less, of a robot at rest too
SHOWN = 0.25  # standard error over value up to which a parameter is told


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

    @property
    def way(self) -> Array:
        """Metres of the tip's path (k) up to each posture."""
        return arc_lengths(self.tip)


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


def follow(path: CommandedPath, time: Array, q: Array, cell: Cell) -> FollowedPath:
    """Set samples (s) of joints q (s, n) [rad, m], from the path's beginning to its end, beside the path."""
    tip = cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]
    lever = np.where(cell.limits.turns, LEVER, 1.0)
    step = float(np.median(np.diff(time)))
    window, fast = window_of(DEVIATION_SPAN, step), window_of(SPEED_SPAN, step)
    # where lines turn back on each other noise would take the motion for the one that follows
    samples = smoothed(np.hstack([tip, lever * q]), window)
    gone = np.append(0.0, np.linalg.norm(np.diff(samples, axis=0), axis=1))
    place, _ = track(tracked_path(np.hstack([path.tip, lever * path.q])), samples, gone)
    segment = np.minimum(place.astype(np.intp), len(path.tip) - 2)
    share = place - segment
    told = path.q[segment] + share[:, None] * (path.q[segment + 1] - path.q[segment])
    between = np.diff(path.tip, axis=0)[segment]
    size = np.linalg.norm(between, axis=1)
    # at its ends a segment has no places that lie farther on, so that noise would count to one side alone
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
    window = window_of(DEVIATION_SPAN, step)
    left = noise_left(window)
    noise = left * float(np.sqrt((noise_of(tips[0]) ** 2).mean()))
    tip = deviation_of(np.linalg.norm(smoothed(off, window), axis=1), noise, 2)
    return tip, tuple(
        deviation_of(np.abs(each), left * float(own), 1)
        for each, own in zip(smoothed(joints, window).T, noise_of(executed), strict=True)
    )


def deviation_of(size: Array, noise: float, axes: int, of: Flags | None = None) -> PathDeviation:
    """Of distances (s), or those of some samples, with noise along so many axes; the mean is without what noise adds to it."""
    of = np.ones(len(size), dtype=np.bool_) if of is None else of
    own = size[of]
    square = float((own**2).mean())
    share = max(1.0 - axes * noise**2 / square, 0.0) if square > 0.0 else 0.0
    worst = int(np.argmax(np.where(of, size, -1.0)))
    return PathDeviation(float(own.mean()) * float(np.sqrt(share)), float(size[worst]), noise, worst)
