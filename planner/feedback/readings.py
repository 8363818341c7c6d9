"""How to interpret a recording: units, how the controller counts joints, where a run begins, and gaps in the clock."""

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

NEAR = (np.radians(1.0), 3e-3)  # rad, m from a program's first posture, within which a run begins
LEAVES = 0.03  # m from a path: beyond, the motion is another program's
MOST_STARTS = 6  # departures from the first posture that are tried as the start of a run
LEAST_MOTION = 5  # samples after a start
BEFORE = 0.2  # s before the start that are included
COARSEST = (np.radians(0.05), 1e-4)  # rad, m: coarsest resolution of recorded joints
GAP = 5.0  # × the median step: a longer one is a gap


@dataclass(frozen=True)
class JointCounting:
    """How a controller counts the joints of a cell (n): signs * q + offsets [rad, m]."""

    signs: Array
    offsets: Array

    @property
    def own(self) -> bool:
        """Whether it counts differently from the cell."""
        return not (np.all(self.signs == 1.0) and np.all(self.offsets == 0.0))


@dataclass(frozen=True)
class LogReading:
    """One way to read a file's numbers: factors and offsets (n each) that convert them to joints, and a description."""

    scale: Array
    offset: Array
    words: tuple[str, ...]

    def of(self, numbers: Array) -> Array:
        """Joints (m, n) [rad, m] of a file's numbers (m, n)."""
        return np.asarray(numbers * self.scale + self.offset)


@dataclass(frozen=True)
class RunStart:
    """Where in a recording a run may begin: how its numbers are read, joints (m, n) [rad, m], and the first sample to
    use, BEFORE [s] the robot leaves the program's first posture."""

    reading: LogReading
    q: Array
    first: int


def counting(cell: Cell, language: str) -> JointCounting:
    """How the controller of a language counts a cell's joints; like the cell if no language is given."""
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
    """The possible interpretations of a file's numbers: of missing units, and of joints counted like the controller."""
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
    """Distance of each joint (m, n) [rad, m] from a program's first posture (n), relative to NEAR."""
    return np.asarray(np.abs(q - start) / np.where(cell.limits.turns, *NEAR))


def departures(q: Array, start: Array, cell: Cell) -> list[int]:
    """The last samples of the stretches near a program's first posture, if motion follows."""
    near = np.append((near_start(q, start, cell) < 1.0).all(axis=1), False)
    ends = np.flatnonzero(near[:-1] & ~near[1:])
    return [int(k) for k in ends if k < len(q) - LEAST_MOTION][:MOST_STARTS]


def run_starts(
    log: RobotLog, cell: Cell, counted: JointCounting, start: Array, as_run: Callable[[Array], Array] = np.asarray
) -> list[RunStart]:
    """All places in a recording where a run from a first posture (n) [rad, m] may begin, in every interpretation.

    as_run: converts joints (m, n) of the cell to those of the run, if they are counted differently
    """
    out = []
    for reading in readings(log, cell.limits.sliding, counted):
        q = as_run(reading.of(log.executed))
        out += [RunStart(reading, q, max(k - round(BEFORE / log.step), 0)) for k in departures(q, start, cell)]
    return out


def check_digits(log: RobotLog, reading: LogReading, cell: Cell) -> None:
    """Raises InputError if the resolution of the recorded joints is too coarse to tell where the robot was."""
    steps = np.abs(np.diff(log.executed, axis=0)) * np.abs(reading.scale)
    least = np.where(steps > 0.0, steps, np.inf).min(axis=0)
    coarse = np.flatnonzero(np.isfinite(least) & (least > np.where(cell.limits.turns, *COARSEST)))
    if len(coarse):
        j = int(coarse[0])
        words = f"{np.degrees(least[j]):.3g} degrees" if cell.limits.turns[j] else f"{1e3 * least[j]:.3g} mm"
        reason = f"{cell.joint_names[j]} is recorded in steps of {words}"
        raise InputError(reason, file=log.file, hint="record with more digits")


def check_clock(log: RobotLog, first: int, last: int) -> None:
    """Raises InputError if samples are missing between two samples, or the clock jumps."""
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
