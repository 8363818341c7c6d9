"""Recordings as from a robot with known limits: jerk-limited moves by ruckig, lag, delay, noise, other clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import ruckig
from scipy.signal import lfilter

from planner.base.arrays import Array
from planner.export.player.model import MotionModel
from planner.export.player.played import Played
from planner.export.program import RobotProgram
from planner.feedback.identify_extruder import FlowLine, width_of
from planner.feedback.identify_program import AskedMoves

FINE = 0.5e-3  # s at which ruckig's motion is looked at
AFTER = 0.3  # s recorded behind the last rest


@dataclass(frozen=True)
class TrueRobot:
    """What a simulated robot really does, for each joint (n): limits [rad, s], those of braking if they are others.

    delay, lag   pure delay, and time constant of the servo [s]
    mean         time [s] of a moving mean that smooths profiles of limited acceleration; 0: the jerk is limited instead
    """

    speed: Array
    acceleration: Array
    jerk: Array
    braking: Array | None = None
    delay: float = 0.0
    lag: float = 0.0
    mean: float = 0.0


@dataclass(frozen=True)
class Recording:
    """What was recorded (m samples): time [s], executed and commanded joints (m, n) [rad, m]."""

    time: Array
    executed: Array
    commanded: Array
    names: tuple[str, ...] = field(default=())


def commands(asked: AskedMoves, truth: TrueRobot) -> tuple[Array, Array]:
    """Time (m) [s] and commanded joints (m, n) [rad, m] of the whole program, every FINE."""
    n, rests = len(asked.start), asked.rests
    parts, q = [np.tile(asked.start, (round(rests[0] / FINE), 1))], asked.start.copy()
    for move, rest in zip(asked.moves, rests[1:], strict=True):
        way = _moved(move.start, move.end, move.share, truth, move.joint)
        rows = np.tile(q, (len(way) + round(rest / FINE), 1))
        q[move.joint] = move.end
        rows[: len(way), move.joint], rows[len(way) :, move.joint] = way, move.end
        parts.append(rows)
    joints = np.concatenate([*parts, np.tile(q, (round(AFTER / FINE), 1))])
    if joints.shape[1] != n:
        raise ValueError("another number of joints")
    return FINE * np.arange(len(joints)), joints


def _moved(start: float, end: float, share: float, truth: TrueRobot, j: int) -> Array:
    """Places (m) of one joint on its way, every FINE."""
    if truth.mean > 0.0:
        return _smoothed(start, end, share * float(truth.speed[j]), truth, j)
    given = ruckig.InputParameter(1)
    given.current_position, given.target_position = [start], [end]
    given.max_velocity, given.max_jerk = [share * float(truth.speed[j])], [float(truth.jerk[j])]
    given.max_acceleration = [float(truth.acceleration[j])]
    if truth.braking is not None:
        # ruckig's least acceleration is that of braking upwards, and of speeding up downwards
        up = end > start
        braking = [float(truth.braking[j])]
        given.max_acceleration, given.min_acceleration = (
            (given.max_acceleration, [-braking[0]]) if up else (braking, [-float(truth.acceleration[j])])
        )
    found = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(given, found)
    return np.array([found.at_time(t)[0][0] for t in np.arange(0.0, found.duration, FINE)])


def _smoothed(start: float, end: float, speed: float, truth: TrueRobot, j: int) -> Array:
    """Places (m) of one joint whose speed, a trapezoid, goes through a moving mean, every FINE: summed up, not solved for."""
    up = float(truth.acceleration[j])
    down = up if truth.braking is None else float(truth.braking[j])
    way = abs(end - start)
    top = min(speed, float(np.sqrt(2.0 * way * up * down / (up + down))))
    duration = way / top + 0.5 * top / up + 0.5 * top / down
    step = FINE / 10.0
    t = np.arange(0.0, duration + truth.mean + 2.0 * FINE, step)
    trapezoid = np.clip(np.minimum(np.minimum(up * t, top), down * (duration - t)), 0.0, None)
    sums = np.concatenate([np.zeros(round(truth.mean / step)), np.cumsum(trapezoid) * step])
    speeds = (sums[round(truth.mean / step) :] - sums[: len(t)]) / truth.mean
    places = np.append(0.0, np.cumsum(0.5 * (speeds[1:] + speeds[:-1])) * step)
    return start + (end - start) * (places / places[-1])[::10]


def recorded(
    asked: AskedMoves, truth: TrueRobot, rate: float = 250.0, noise: float = np.radians(0.01), seed: int = 1
) -> Recording:
    """What an interface records `rate` times a second, with noise of executed places (standard deviation) [rad, m]."""
    fine, told = commands(asked, truth)
    done = told
    if truth.lag > 0.0:
        fading = np.exp(-FINE / truth.lag)
        first = 1.0 - truth.lag / FINE * (1.0 - fading)
        done = told[0] + lfilter([first, 1.0 - fading - first], [1.0, -fading], told - told[0], axis=0)
    time = np.arange(0.0, fine[-1], 1.0 / rate)
    random = np.random.default_rng(seed)
    executed = np.column_stack([np.interp(time - truth.delay, fine, column) for column in done.T])
    commanded = np.column_stack([np.interp(time, fine, column) for column in told.T])
    return Recording(time, executed + random.normal(0.0, 1.0, executed.shape) * noise, commanded, asked.joint_names)


def executed_run(
    program: RobotProgram,
    played: Played,
    model: MotionModel,
    rate: float = 250.0,
    noise: float = np.radians(0.01),
    seed: int = 1,
) -> tuple[Array, Array]:
    """Time (m) [s] and joints (m, n) [rad, m] of an arm that runs a program as a model of its controller has it.

    Zones are passed on their parabolas, as much of them as the model cuts; then the arm follows with its lag, which weighs
    what was commanded before and after by exp(-|dt| / lag). It rests before and behind.
    """
    tick = 1e-3
    t = np.arange(-1.0, played.duration + 1.0, tick)
    q = played.at(t).q
    steps = np.linalg.norm(np.diff(played.position, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps))
    at = way[played.target]
    for i in range(len(at) - 1):
        before, after = at[i] - (at[i - 1] if i else 0.0), at[i + 1] - at[i]
        reach = min(float(program.zone[i]), 0.5 * before, 0.5 * after)
        if program.fine[i] or not reach > 0.0:
            continue
        ends = np.array([at[i] - reach, at[i] + reach])
        k = np.clip(np.searchsorted(way, ends, side="right") - 1, 0, len(steps) - 1)
        since, until = played.reached(k, (ends - way[k]) / np.where(steps[k] > 0.0, steps[k], 1.0))
        a, b = played.at(np.array([since, until])).q
        own = np.flatnonzero((t > since) & (t < until))
        # shares of the way, not of time: a parabola whatever the speed
        times, ways = _gone(played, since, until)
        gone, whole = np.interp(t[own], times, ways), float(ways[-1])
        u = (gone / max(whole, 1e-12))[:, None]
        parabola = (1.0 - u) ** 2 * a + 2.0 * u * (1.0 - u) * played.q[played.target[i]] + u**2 * b
        q[own] += model.depth * (parabola - q[own])
    if model.lag > 0.0:
        keep = np.exp(-tick / model.lag)
        first = q[0]
        for _ in range(2):
            q = (first + lfilter([1.0 - keep], [1.0, -keep], q - first, axis=0))[::-1]
            first = q[0]
    time = np.arange(t[0], t[-1], 1.0 / rate)
    out = np.column_stack([np.interp(time, t, column) for column in q.T])
    return time - time[0], out + np.random.default_rng(seed).normal(0.0, 1.0, out.shape) * noise


def _gone(played: Played, since: float, until: float) -> tuple[Array, Array]:
    """Times (m) [s] between two, and the tip's way (m) [m] since the first."""
    t = np.linspace(since, until, 200)
    way = np.linalg.norm(np.diff(played.at(t).position, axis=0), axis=1)
    return t, np.append(0.0, np.cumsum(way))


def write_recording(
    path: Path, recording: Recording, head: Sequence[str], scale: float = np.degrees(1.0), commanded: bool = False
) -> Path:
    """A CSV file: time, executed joints, commanded ones too if asked for; scale: from rad to its unit."""
    columns = [recording.executed * scale, *([recording.commanded * scale] if commanded else [])]
    table = np.column_stack([recording.time, *columns])
    np.savetxt(path, table, fmt="%.7f", delimiter=",", header=",".join(head), comments="")
    return path


def line_table(
    path: Path,
    line: FlowLine,
    lag: float,
    flow: float,
    density: float | None = None,
    noise: float = 0.0,
    seed: int = 1,
    zero: float = 0.0,
) -> Path:
    """The table of a test line, whose flow follows the motor with a lag [s] and is a share of what was asked.

    Masses of segments of 5 mm with a density [kg/m³], else a width every millimetre; noise: standard deviation [kg, m];
    zero: of the ruler behind the line's beginning [m]. Flow is stepped through, not solved for.
    """
    step = 2e-6
    s = np.arange(0.0, line.length + step, step)
    wanted = line.area[np.minimum(np.searchsorted(line.ends, s, side="right") - 1, len(line.area) - 1)]
    keep = np.exp(-step / (line.speed * lag)) if lag > 0.0 else 0.0
    area = flow * lfilter([1.0 - keep], [1.0, -keep], wanted)
    random = np.random.default_rng(seed)
    if density is not None:
        cuts = np.arange(0.0, line.length + 1e-6, 5e-3)
        total = np.append(0.0, np.cumsum(area) * step)
        masses = density * np.diff(np.interp(cuts + zero, np.append(0.0, s + step), total))
        masses = np.maximum(masses + random.normal(0.0, 1.0, len(masses)) * noise, 0.0)
        rows = np.column_stack([1e3 * cuts[:-1], 1e3 * cuts[1:], 1e6 * masses])
        head = "from_mm,to_mm,mass_mg"
    else:
        at = np.arange(0.5e-3, line.length - zero, 1e-3)
        widths = width_of(np.interp(at + zero, s, area), line.height, line.rounded)
        widths = widths + random.normal(0.0, 1.0, len(widths)) * noise
        rows, head = np.column_stack([1e3 * at, 1e3 * widths]), "s_mm,width_mm"
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=head, comments="")
    return path
