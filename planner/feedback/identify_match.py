"""Matches a recording to a test program: which rest is which, and why it does not match if it does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays, true_runs
from planner.base.errors import InputError
from planner.feedback.filters import noise_of
from planner.feedback.identify_program import AskedMoves
from planner.feedback.readings import LogReading, check_clock, readings
from planner.feedback.recordings import DEGREE, RobotLog

SPAN = 0.04  # s before and after an instant, over which positions are averaged to detect motion
LEAST_REST = 0.15  # s: least duration of a rest between moves
QUIET = (0.4, 0.7)  # fractions of a rest between which it is quiet
STILL = (np.radians(0.02), 5e-5)  # rad, m: greatest difference of averages while a joint stands
SIGMAS = 6.0  # standard deviations of noise that do not count as motion
SAME = (np.radians(0.1), 0.4e-3)  # rad, m: tolerance of a rest's posture; servo errors are smaller
STRAY = (np.radians(0.3), 1e-3)  # rad, m: tolerated motion of joints that should stand
SLOWEST = 0.0125  # s between samples: a short move takes some 80 ms
COMMANDED_OFF = (np.radians(1.0), 3e-3)  # rad, m: greatest distance between commanded and executed rest
COMMANDED_STILL = (np.radians(0.1), 3e-4)  # rad, m: greatest change of commands while joints rest


@dataclass(frozen=True)
class MatchedLog(ReadOnlyArrays):
    """A recording (m samples) of the moves (k) of a test program for a cell's joints (n).

    time (m) [s];  executed (m, n), commanded (m, n) or None [rad, m]
    rests (k + 1, 2)   first and last sample of the quiet middle of each rest
    postures (k + 1, n)   of the joints at rest [rad, m];  noise (n): standard deviation of one sample there [rad, m]
    remarks            notes on how the file was read
    """

    time: Array
    executed: Array
    commanded: Array | None
    rests: Ints
    postures: Array
    noise: Array
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class RecordedRests:
    """Stretches in which all joints stand: first and last sample (r, 2), mean postures (r, n) of their quiet middles."""

    ends: Ints
    postures: Array

    def __len__(self) -> int:
        return len(self.ends)


def match(log: RobotLog, asked: AskedMoves) -> MatchedLog:
    """Find a test program's moves in a recording.

    Raises InputError that names the cause: too few samples, gaps, another unit or order of joints, another program.
    """
    if log.step > SLOWEST:
        hint = f"at least one every {1e3 * SLOWEST:g} ms"
        raise InputError(f"too few samples: one every {1e3 * log.step:.3g} ms", file=log.file, hint=hint)
    tried = [(reading, reading.of(log.executed)) for reading in readings(log, asked.sliding, asked.counted)]
    for reading, q in tried:
        rests = find_rests(log.time, q, asked)
        if (first := _aligned(rests, asked)) is not None:
            return _matched(log, asked, reading, q, RecordedRests(*_cut(rests, first, len(asked.moves) + 1)))
    reading, q = tried[0]
    raise _misfit(log, asked, q, find_rests(log.time, q, asked))


def find_rests(time: Array, q: Array, asked: AskedMoves) -> RecordedRests:
    """Stretches of a recording in which all joints q (m, n) [rad, m] stand; neighbours at one posture are joined."""
    step = float(np.median(np.diff(time)))
    count = min(max(round(SPAN / step), 3), len(q) // 4)
    sums = np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(q - q[0], axis=0)])
    means = (sums[count:] - sums[:-count]) / count
    change = np.abs(means[count:] - means[:-count])  # after minus before sample i + count
    still = np.maximum(SIGMAS * noise_of(q) * np.sqrt(2.0 / count), _tolerances(asked, STILL))
    quiet = np.zeros(len(q), dtype=np.bool_)
    quiet[count : count + len(change)] = (change < still).all(axis=1)
    # the ends of a file have no samples before, or after: copy the nearest result
    quiet[:count], quiet[count + len(change) :] = quiet[count], quiet[count + len(change) - 1]
    ends = true_runs(quiet).astype(np.int64)
    ends[:, 1] -= 1
    ends = ends[time[ends[:, 1]] - time[ends[:, 0]] >= LEAST_REST]
    postures = np.array([q[_middle(first, last)].mean(axis=0) for first, last in ends]).reshape(-1, q.shape[1])
    return _joined(ends, postures, _tolerances(asked, SAME))


def _joined(ends: Ints, postures: Array, same: Array) -> RecordedRests:
    """Join consecutive rests at one posture: something shook the robot there."""
    if not len(ends):
        return RecordedRests(ends, postures)
    begins = np.append(True, (np.abs(np.diff(postures, axis=0)) > same).any(axis=1))
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(ends)) - 1
    return RecordedRests(np.column_stack([ends[first, 0], ends[last, 1]]), postures[first])


def _middle(first: int, last: int) -> slice:
    """The quiet part of a rest, without settling at its start, and commands that precede the next motion at its end."""
    length = int(last) - int(first)
    return slice(int(first) + int(QUIET[0] * length), int(first) + int(QUIET[1] * length) + 1)


def _tolerances(asked: AskedMoves, pair: tuple[float, float]) -> Array:
    """The tolerance (n) of each joint, from a pair for revolute and prismatic ones."""
    return np.where(np.isin(np.arange(len(asked.start)), asked.sliding), pair[1], pair[0])


def _aligned(rests: RecordedRests, asked: AskedMoves) -> int | None:
    """The rest with which the requested moves begin; None unless they are all there, one after another."""
    wanted, same = asked.postures, _tolerances(asked, SAME)
    spare = len(rests) - len(wanted)
    fits = (k for k in range(spare + 1) if (np.abs(rests.postures[k : k + len(wanted)] - wanted) < same).all())
    return next(fits, None)


def _cut(rests: RecordedRests, first: int, count: int) -> tuple[Ints, Array]:
    return rests.ends[first : first + count], rests.postures[first : first + count]


def _matched(log: RobotLog, asked: AskedMoves, reading: LogReading, q: Array, rests: RecordedRests) -> MatchedLog:
    middles = [_middle(first, last) for first, last in rests.ends]
    first, last = int(rests.ends[0, 0]), int(rests.ends[-1, 1])
    check_clock(log, middles[0].start, middles[-1].stop)
    quiet = np.concatenate([q[each] - q[each].mean(axis=0) for each in middles])
    spare = len(quiet) - len(middles)
    noise = np.sqrt((quiet**2).sum(axis=0) / max(spare, 1))
    _check_alone(log, asked, q, middles, _tolerances(asked, STRAY) + SIGMAS * noise)
    return MatchedLog(
        time=log.time,
        executed=q,
        commanded=_commanded(log, asked, reading, q, middles),
        rests=np.array([[each.start, each.stop - 1] for each in middles], dtype=np.int64),
        postures=rests.postures,
        noise=noise,
        remarks=(
            *reading.words,
            *log.remarks,
            f"columns {', '.join(log.told)}",
            f"{last - first + 1} samples, one every {1e3 * log.step:.3g} ms, in lines {log.lines[first]} to {log.lines[last]}",
        ),
    )


def _check_alone(log: RobotLog, asked: AskedMoves, q: Array, middles: list[slice], stray: Array) -> None:
    """Raises InputError if a joint moves other than the requested one."""
    for move, before, after in zip(asked.moves, middles, middles[1:], strict=False):
        part = q[before.start : after.stop]
        away = np.abs(part - part[0])
        away[:, move.joint] = 0.0
        if (away > stray).any():
            row, j = np.unravel_index(int(np.argmax(away / stray)), away.shape)
            reason = (
                f"{asked.joint_names[j]} moves by {_shown(asked, int(j), away[row, j])} while only "
                f"{asked.joint_names[move.joint]} was asked to"
            )
            raise InputError(reason, file=log.file, line=int(log.lines[before.start + int(row)]))


def _commanded(log: RobotLog, asked: AskedMoves, reading: LogReading, q: Array, middles: list[slice]) -> Array | None:
    """The commanded joints (m, n) [rad, m], read like the executed ones. InputError if they rest elsewhere."""
    if log.commanded is None or log.commanded_unit is None:
        return None
    unsaid = np.isnan(log.commanded_unit)
    scale = np.where(unsaid, reading.scale, np.sign(reading.scale) * log.commanded_unit)
    told = log.commanded * scale + reading.offset
    off = np.abs(np.array([told[each].mean(axis=0) - q[each].mean(axis=0) for each in middles])).max(axis=0)
    worst = int(np.argmax(off / _tolerances(asked, COMMANDED_OFF)))
    if off[worst] > _tolerances(asked, COMMANDED_OFF)[worst]:
        reason = (
            f"commanded and executed joints rest up to {_shown(asked, worst, off[worst])} apart at "
            f"{asked.joint_names[worst]}: another unit, order or clock"
        )
        raise InputError(reason, file=log.file)
    moving = np.array([np.ptp(told[each], axis=0) for each in middles]) > _tolerances(asked, COMMANDED_STILL)
    if moving.any():
        k = int(np.argmax(moving.any(axis=1)))
        reason = "commands begin to move more than about 0.15 s before the joints do, or have another clock"
        raise InputError(reason, file=log.file, line=int(log.lines[middles[k].start]))
    return np.asarray(told)


# ----------------------------------------------------------------------------------------------------
# Why a recording does not match the program, in words.

_MOST_NAMED = 3  # joints in one sentence


def _misfit(log: RobotLog, asked: AskedMoves, q: Array, rests: RecordedRests) -> InputError:
    """What is wrong with a recording in which the requested moves were not found."""
    hint = "correct the names of the columns"
    for scale, unit, said in ((1.0 / DEGREE, "radians", "degrees"), (DEGREE, "degrees", "radians")):
        # in another unit, the thresholds against noise do not fit: find the rests again
        factors = np.where(np.isin(np.arange(q.shape[1]), asked.sliding), 1.0, scale)
        if _aligned(find_rests(log.time, factors * q, asked), asked) is not None:
            return InputError(f"joints are in {unit}, but its header says {said}", file=log.file, hint=hint)
    if not len(rests):
        return InputError("the joints never rest in it", file=log.file, hint="record the whole test program")
    count = len(asked.moves) + 1
    for k in range(len(rests) - count + 1):
        for words in (_other_order, _other_zero):
            if (found := words(asked, rests.postures[k : k + count])) is not None:
                return InputError(found, file=log.file, hint=hint)
    return _another_program(log, asked, rests)


def _other_order(asked: AskedMoves, found: Array) -> str | None:
    """Columns that move as other joints should."""
    same = _tolerances(asked, SAME)
    apart = np.abs(found[:, :, None] - asked.postures[:, None, :]).max(axis=0)  # column, joint
    fits = apart < same
    others = [(c, int(np.argmin(apart[c]))) for c in range(len(fits)) if not fits[c, c] and fits[c].any()]
    if not others or not fits.any(axis=1).all():
        return None
    names = asked.joint_names
    words = [f"that of {names[c]} moves as {names[j]} was asked to" for c, j in others[:_MOST_NAMED]]
    return f"columns are in another order: {', '.join(words)}{' …' if len(others) > _MOST_NAMED else ''}"


def _other_zero(asked: AskedMoves, found: Array) -> str | None:
    """Joints that move as requested, but from another zero or in the opposite direction."""
    wanted, same = asked.postures - asked.start, 2.0 * _tolerances(asked, SAME)
    moved = found - found[0]
    right, turned = ((np.abs(side * moved - wanted) < same).all(axis=0) for side in (1.0, -1.0))
    if not (right | turned).all():
        return None
    off = found[0] - asked.start
    names = asked.joint_names
    words = [f"{names[j]} moves the other way round" for j in np.flatnonzero(turned & ~right)]
    words += [
        f"the zero of {names[j]} is {_shown(asked, int(j), off[j])} off"
        for j in np.flatnonzero(right & (np.abs(off) > 0.5 * same))
    ]
    more = " …" if len(words) > _MOST_NAMED else ""
    return f"joints are counted differently: {', '.join(words[:_MOST_NAMED])}{more}"


def _another_program(log: RobotLog, asked: AskedMoves, rests: RecordedRests) -> InputError:
    """How far the recording matches the program, and where it departs from it."""
    wanted, same = asked.postures, _tolerances(asked, SAME)
    held = np.zeros(len(rests), dtype=np.int64)
    for k in range(len(rests)):
        part = rests.postures[k : k + len(wanted)]
        fits = (np.abs(part - wanted[: len(part)]) < same).all(axis=1)
        held[k] = len(part) if fits.all() else int(np.argmin(fits))
    best = int(np.argmax(held))
    count = int(held[best])
    hint = "record the program that was written together with the --asked file, from its first posture to its last"
    if count == 0:
        off = np.abs(rests.postures - asked.start)
        nearest = int(np.argmin((off / same).max(axis=1)))
        j = int(np.argmax((off / same)[nearest]))
        reason = (
            f"another program: none of its {len(rests)} rests is the start posture; in the nearest "
            f"{asked.joint_names[j]} is {_shown(asked, j, off[nearest, j])} away"
        )
        return InputError(reason, file=log.file, line=int(log.lines[rests.ends[nearest, 0]]), hint=hint)
    if best + count >= len(rests):
        reason = f"ends after {count - 1} of {len(wanted) - 1} moves"
        return InputError(reason, file=log.file, line=int(log.lines[-1]), hint=hint)
    off = np.abs(rests.postures[best + count] - wanted[count])
    j = int(np.argmax(off / same))
    reason = (
        f"another program: its first {count - 1} of {len(wanted) - 1} moves are as asked, then {asked.joint_names[j]} rests "
        f"{_shown(asked, j, off[j])} from where it was asked to"
    )
    return InputError(reason, file=log.file, line=int(log.lines[rests.ends[best + count, 0]]), hint=hint)


def _shown(asked: AskedMoves, j: int, value: float) -> str:
    """A distance of a joint in degrees, or in mm."""
    return f"{1e3 * value:.3g} mm" if j in asked.sliding else f"{np.degrees(value):.3g} degrees"
