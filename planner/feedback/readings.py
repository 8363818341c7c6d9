"""How the numbers of a recording may be meant: their unit, and how the controller counts its joints; where a run begins in it,
and whether its clock goes on without gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.cell.kinematics.placed_wrist import PlacedWrist
from planner.export.krl import OFFSETS as KUKA_OFFSETS
from planner.export.krl import SIGNS as KUKA_SIGNS
from planner.export.languages import LANGUAGES
from planner.feedback.recordings import DEGREE, RobotLog

NEAR = (np.radians(1.0), 3e-3)  # from a program's first posture, within which a run begins [rad, m]
LEAVES = 0.03  # m from a path, beyond which it is another program's
MOST_STARTS = 6  # times that the robot stands at the first posture, from which a run is looked for
LEAST_MOTION = 5  # samples behind a start
BEFORE = 0.2  # s
FINEST = (np.radians(0.05), 1e-4)  # of the steps in which joints are recorded at most [rad, m]
GAP = 5.0  # median steps: a longer one is a gap


@dataclass(frozen=True)
class JointCounting:
    """How a controller counts the joints of a cell (n): signs * q + offsets [rad, m]."""

    signs: Array
    offsets: Array

    @property
    def own(self) -> bool:
        """Whether it counts otherwise than the cell does."""
        return not (np.all(self.signs == 1.0) and np.all(self.offsets == 0.0))


@dataclass(frozen=True)
class LogReading:
    """One way to read a file's numbers: factors and offsets (n each) that make them the cell's joints, and in words."""

    scale: Array
    offset: Array
    words: tuple[str, ...]

    def of(self, numbers: Array) -> Array:
        """Joints (m, n) [rad, m] of a file's numbers (m, n)."""
        return np.asarray(numbers * self.scale + self.offset)


@dataclass(frozen=True)
class RunStart:
    """A place in a recording where a run may begin: how its numbers are read, joints (m, n) [rad, m], and the sample from which
    on the run is looked at, some BEFORE the robot leaves the place where the program begins."""

    reading: LogReading
    q: Array
    first: int


def counting(cell: Cell, language: str) -> JointCounting:
    """How the controller of a language counts a cell's joints; as the cell does without one."""
    signs, offsets = np.ones(len(cell.joint_names)), np.zeros(len(cell.joint_names))
    if not language:
        return JointCounting(signs, offsets)
    inverse = cell.own_inverse
    if LANGUAGES[language].counted and isinstance(inverse, PlacedWrist):
        signs[cell.own], offsets[cell.own] = inverse.signs, inverse.offsets
    if language == "krl":
        signs[cell.own] *= KUKA_SIGNS
        offsets[cell.own] = KUKA_SIGNS * offsets[cell.own] + KUKA_OFFSETS
    return JointCounting(signs, offsets)


def readings(log: RobotLog, sliding: tuple[int, ...], counted: JointCounting) -> Iterator[LogReading]:
    """The ways in which a file's numbers may be meant: units that it does not say, joints as the controller counts them."""
    n = len(counted.signs)
    slides = np.isin(np.arange(n), sliding)
    unsaid = np.isnan(log.unit)
    for degrees in (True, False) if unsaid.any() else (True,):
        usual = np.where(slides, 1e-3 if degrees else 1.0, DEGREE if degrees else 1.0)
        scale = np.where(unsaid, usual, log.unit)
        words = (f"numbers without a unit are {'degrees' if degrees else 'radians'}",) if unsaid.any() else ()
        yield LogReading(scale, np.zeros(n), words)
        if counted.own:
            own = (*words, "joints are counted as the controller does")
            yield LogReading(counted.signs * scale, -counted.signs * counted.offsets, own)


def near_start(q: Array, start: Array, cell: Cell) -> Array:
    """How far each joint (m, n) [rad, m] is from a program's first posture (n), over what is NEAR."""
    return np.asarray(np.abs(q - start) / np.where(cell.limits.turns, *NEAR))


def departures(q: Array, start: Array, cell: Cell) -> list[int]:
    """Last samples of the stretches in which the robot stands where a program begins, those that move on."""
    near = np.append((near_start(q, start, cell) < 1.0).all(axis=1), False)
    ends = np.flatnonzero(near[:-1] & ~near[1:])
    return [int(k) for k in ends if k < len(q) - LEAST_MOTION][:MOST_STARTS]


def run_starts(
    log: RobotLog, cell: Cell, counted: JointCounting, start: Array, as_run: Callable[[Array], Array] = np.asarray
) -> list[RunStart]:
    """All places in a recording where a run from a first posture (n) [rad, m] may begin, however its numbers are meant.

    as_run: gives joints (m, n) of the cell as those of the run, if they are counted otherwise
    """
    out = []
    for reading in readings(log, cell.limits.sliding, counted):
        q = as_run(reading.of(log.executed))
        out += [RunStart(reading, q, max(k - round(BEFORE / log.step), 0)) for k in departures(q, start, cell)]
    return out


def check_digits(log: RobotLog, reading: LogReading, cell: Cell) -> None:
    """Raises InputError where joints were recorded in steps that are too coarse to tell where the robot was."""
    steps = np.abs(np.diff(log.executed, axis=0)) * np.abs(reading.scale)
    least = np.where(steps > 0.0, steps, np.inf).min(axis=0)
    coarse = np.flatnonzero(np.isfinite(least) & (least > np.where(cell.limits.turns, *FINEST)))
    if len(coarse):
        j = int(coarse[0])
        words = f"{np.degrees(least[j]):.3g} degrees" if cell.limits.turns[j] else f"{1e3 * least[j]:.3g} mm"
        reason = f"{cell.joint_names[j]} is recorded in steps of {words}"
        raise InputError(reason, file=log.file, hint="a recording with more digits")


def check_clock(log: RobotLog, first: int, last: int) -> None:
    """Raises InputError where samples are missing between two of them, or the clock jumps."""
    steps = np.diff(log.time[first:last])
    gaps = np.flatnonzero(steps > GAP * log.step)
    if len(gaps):
        k = first + int(gaps[0])
        longest = float(steps.max())
        reason = (
            f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''} between samples, the longest {longest:.3f} s: samples are "
            "missing, or the clock jumped"
        )
        hint = f"a recording with a sample every {1e3 * log.step:.3g} ms throughout"
        raise InputError(reason, file=log.file, line=int(log.lines[k + 1]), hint=hint)
