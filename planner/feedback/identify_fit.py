"""Limits of a joint from its recorded moves: least-squares fits of both kinds of profile, without differentiation.

All moves of a joint share its limits, and each has its own instant. Short moves determine the jerk, longer ones the
acceleration, the longest the speed. Models are extended, starting from the simplest, as long as they explain more than
chance would: braking like acceleration or not, a servo with lag or without (Schwarz, Estimating the dimension of a
model, 1978). This is done both with a limited jerk and with a mean over a fixed time, and the better kind is reported.
If one set of limits does not explain all moves, as when the drives have to do more in one posture than in another, each
move is fitted separately, and the least limits are reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from planner.base.arrays import Array, Flags, ReadOnlyArrays
from planner.feedback.identify_match import MatchedLog
from planner.feedback.identify_profile import MotionLimits, MoveProfile, move_profile
from planner.feedback.identify_program import AskedMoves

QUANTITIES = ("speed", "acceleration", "jerk")
FLOOR = 2e-6  # rad, m: rounding error of a recording without noise
KNOWN = 0.05  # standard error of a limit's logarithm up to which it is reported: 5 %
VAGUE = 2.0  # prior standard deviation of a limit's logarithm: a factor of seven either way
WIDEST = 20.0  # bound on a limit's logarithm: a search need not try values beyond
VAGUE_MOVE = 0.5  # prior standard deviation for a single move, around the limits of all moves
DIFFER = 3.0  # × the variance from noise: above, moves may differ (residuals), or do (their limits)
MOST_APART = 2.5  # × the least limit: moves that differ by more show nothing together
OTHERWISE = 5e-3  # relative difference from which braking counts as different from speeding up
LEAST_ERROR = 1e-3  # relative error of a limit: no model profile matches a robot's own more closely
UNEVEN = 0.02  # × the sample interval: standard deviation from which the steps count as uneven
MOST_UNEVEN = 0.02  # s: greatest distance of a stamp from its even sample
STEP = 1e-5  # of a logarithm, for finite differences
INSTANT = 1e-6  # s, likewise
CRUISE = 0.05  # share of a move at its greatest speed, from which that speed is a limit
PLATEAU = 0.15  # × the time taken to reach an acceleration: if held for longer, it is a limit
BELOW = 0.8  # × the acceleration reached: where a search restarts
MOST_STEPS = 60  # function evaluations of a search
FINE = 1e-7  # relative change of the squares, or of the parameters, below which a search ends
LONGER = (2.0, 4.0)  # × the time of a mean: where a search restarts
COARSE = 1e-5  # as FINE, while models are compared: far less than the margin by which one must be better
FACTORS = 2.0 ** np.arange(-4.0, 4.1)  # × the file's limits: where the search may start
FIRST_LAGS = (0.003, 0.02)  # s, likewise
EXPLAINED = 1.1  # × the noise's variance, up to which residuals are noise
EVIDENT = 10.0  # least difference of the criteria for one kind of profile to be evident


@dataclass(frozen=True)
class MoveSamples(ReadOnlyArrays):
    """One recorded move: times (m) [s], distance covered (m) [rad, m], the whole distance, and share of the speed."""

    time: Array
    way: Array
    distance: float
    share: float


@dataclass(frozen=True)
class IdentifiedLimit:
    """A limit that a recording shows, or what it shows instead.

    value    [rad, s; m if it slides]: the limit, or the greatest value that was reached
    error    its standard error [same unit]; NaN if the limit was not reached
    spread   least and greatest among moves that differ; both the value if they agree
    asked    the limit that the program itself had set, which hides the robot's own if it was reached
    """

    value: float
    error: float
    spread: tuple[float, float]
    asked: float | None

    @property
    def told(self) -> bool:
        """Whether the recording shows the limit."""
        return bool(np.isfinite(self.error))

    @property
    def as_asked(self) -> bool:
        """Whether it is the limit that the program had set, so that the robot may be capable of more."""
        return self.told and self.asked is not None and self.value > 0.97 * self.asked


@dataclass(frozen=True)
class JointFit:
    """What a joint's moves show: speed, acceleration, jerk; the servo's lag [s]; and how well the fit explains them.

    residual   root mean square residual [rad, m];  noise: standard deviation at rest [rad, m]
    braking    acceleration and jerk of braking if they differ from those of speeding up, else None
    averaged   time [s] of a mean that smooths the profile, with standard error, the jerk being acceleration / time;
               None if the jerk is limited
    either     the jerk of the other kind of profile, if the moves cannot tell the kinds apart; the lesser is reported
    """

    joint: int
    speed: IdentifiedLimit
    acceleration: IdentifiedLimit
    jerk: IdentifiedLimit
    braking: tuple[float, float] | None
    lag: float
    residual: float
    noise: float
    moves: int
    averaged: tuple[float, float] | None = None
    either: float | None = None

    @property
    def limits(self) -> tuple[IdentifiedLimit, IdentifiedLimit, IdentifiedLimit]:
        """Speed, acceleration, jerk."""
        return self.speed, self.acceleration, self.jerk


@dataclass(frozen=True)
class _Model:
    """Which parameters the moves of a joint share, after the speeds: logarithms of acceleration and jerk, of those of
    braking (a mean has a single time, so braking has no jerk of its own), and of the lag."""

    averaged: bool
    braking: bool
    lag: bool

    @property
    def sided(self) -> int:
        """How many parameters braking has."""
        return (1 if self.averaged else 2) if self.braking else 0

    @property
    def size(self) -> int:
        return 2 + self.sided + self.lag

    def extends(self, other: _Model) -> bool:
        """Whether it has exactly one feature more than another model."""
        return (
            self.averaged == other.averaged
            and self.braking >= other.braking
            and self.lag >= other.lag
            and self.braking + self.lag == other.braking + other.lag + 1
        )

    def limits(self, shared: Array, level: int, levels: int) -> MotionLimits:
        own = np.exp(np.clip(shared, -WIDEST, WIDEST))
        acceleration, jerk, *rest = own[levels:]
        braking = rest[0] if self.braking else acceleration
        # a mean builds up braking in the same time as acceleration
        braking_jerk = braking * jerk / acceleration if self.averaged else rest[1] if self.braking else jerk
        return MotionLimits(
            float(own[level]), float(acceleration), float(jerk), float(braking), float(braking_jerk),
            float(rest[-1]) if self.lag else 0.0, self.averaged,
        )  # fmt: skip


MODELS = tuple(
    _Model(averaged, braking, lag) for averaged in (False, True) for lag in (False, True) for braking in (False, True)
)
PLAIN, PLAIN_MEAN = MODELS[0], MODELS[4]


@dataclass(frozen=True, eq=False)
class _Solved:
    model: _Model
    shared: Array
    instants: Array
    errors: Array  # standard errors of the shared parameters
    squares: float  # sum of squared residuals, in units of the noise's variance
    count: int

    @property
    def differ(self) -> bool:
        """Whether the residuals are so large that moves may have separate limits."""
        return self.squares > DIFFER * self.count

    @property
    def limits(self) -> MotionLimits:
        """The limits at full speed."""
        return self.model.limits(self.shared, 0, self.levels)

    @property
    def levels(self) -> int:
        """Number of speeds."""
        return len(self.shared) - self.model.size

    @property
    def side_errors(self) -> tuple[Array, Array]:
        """Standard errors of the logarithms of acceleration and jerk (1 each, or 2 with braking)."""
        acceleration, jerk, *braking = self.errors[self.levels : self.levels + 2 + self.model.sided]
        rates = [acceleration, *braking[:1]]
        return np.array(rates), np.array([jerk, *(braking[1:] or [jerk][: len(braking)])])

    @property
    def criterion(self) -> float:
        """Schwarz's criterion: lower is better."""
        return float(self.count * np.log((self.squares + 0.01 * self.count) / self.count)) + len(self.shared) * float(
            np.log(self.count)
        )


def fit_joints(
    log: MatchedLog, asked: AskedMoves, first_guess: tuple[Array, Array, Array]
) -> tuple[MatchedLog, list[JointFit]]:
    """The limits of all joints that moved, and the recording with the clock that explains them best.

    first_guess: speeds, accelerations, jerks (n each) of the robots' files [rad, m]. If stamps are uneven, the samples
    may still have been taken evenly and stamped late: the clock with the smaller residuals is used.
    """
    joints = sorted({move.joint for move in asked.moves})
    found = []
    for each in (log, *evened(log)):
        guesses = [(float(first_guess[0][j]), float(first_guess[1][j]), float(first_guess[2][j])) for j in joints]
        fits = [fit_joint(each, asked, j, guess) for j, guess in zip(joints, guesses, strict=True)]
        found.append((sum((fit.residual / max(fit.noise, FLOOR)) ** 2 for fit in fits), each, fits))
    _, best, fits = min(found, key=lambda one: one[0])
    return best, fits


def evened(log: MatchedLog) -> list[MatchedLog]:
    """The recording with even time steps, if its stamps are uneven but could be those of even samples; else nothing."""
    steps = np.diff(log.time)
    step = float(np.median(steps))
    if steps.std() < UNEVEN * step:
        return []
    first, last = int(log.rests[0, 0]), int(log.rests[-1, 1])
    count = np.arange(len(log.time), dtype=np.float64)
    slope, begin = np.polyfit(count[first : last + 1], log.time[first : last + 1], 1)
    even = begin + slope * count
    if np.abs(even - log.time)[first : last + 1].max() > MOST_UNEVEN:
        return []
    remark = f"stamps are uneven by {1e3 * float(steps.std()):.2g} ms, samples are not: they are taken as even"
    return [replace(log, time=even, remarks=(*log.remarks, remark))]


def fit_joint(log: MatchedLog, asked: AskedMoves, joint: int, first_guess: tuple[float, float, float]) -> JointFit:
    """The limits of one joint; first_guess: speed, acceleration, jerk of its file [rad, m].

    If the controller generated the profile and its commands were recorded, the commands are fitted; otherwise the
    executed positions, with the servo's lag.
    """
    own_profile = asked.asked[2] is None
    commanded = log.commanded is not None and own_profile
    moves = samples_of(log, asked, joint, commanded)
    noise = FLOOR if commanded else max(float(log.noise[joint]), FLOOR)
    kinds = _solve_all(moves, noise, first_guess, lags=not commanded)
    kinds = tuple(_solve(each.model, moves, noise, each.shared, each.instants) for each in kinds)
    solved, other = sorted(kinds, key=lambda each: each.criterion)
    evident, own = other.criterion - solved.criterion > EVIDENT, None
    if solved.differ:
        # if limits differ, the shared residuals say nothing about the kind; those of separately fitted moves do
        found = {each: _by_move(each, moves, noise) for each in kinds}
        solved, evident = min(kinds, key=lambda each: found[each].left), True
        own = found[solved]
    elif not evident:
        # only noise decides which is better, so take the lesser jerk to be safe
        solved, other = sorted(kinds, key=lambda each: each.limits.jerk)
    fit = _told(solved, own, moves, noise, float(log.noise[joint]), joint, asked)
    return fit if evident else replace(fit, either=other.limits.jerk)


def samples_of(log: MatchedLog, asked: AskedMoves, joint: int, commanded: bool) -> list[MoveSamples]:
    """The samples of a joint's moves, each from the quiet part of the rest before it to that of the rest after it."""
    out = []
    q = log.commanded if commanded and log.commanded is not None else log.executed
    for k, move in enumerate(asked.moves):
        if move.joint != joint:
            continue
        (first, last), (next_first, next_last) = log.rests[k].tolist(), log.rests[k + 1].tolist()
        before, after = q[first : last + 1, joint].mean(), q[next_first : next_last + 1, joint].mean()
        part = slice(last, next_first + 1)
        side = np.sign(after - before)
        out.append(
            MoveSamples(log.time[part], side * (q[part, joint] - before), float(abs(after - before)), move.share)
        )
    return out


# ----------------------------------------------------------------------------------------------------
# Least squares.


def _solve_all(
    moves: Sequence[MoveSamples], noise: float, first_guess: tuple[float, float, float], lags: bool
) -> tuple[_Solved, ...]:
    """The best model of limited jerk, and the best one of a mean."""
    shares = sorted({move.share for move in moves}, reverse=True)
    speeds = np.log([_quickest(moves, share) for share in shares])
    instants = np.array([_half_way(move) for move in moves])
    start = _start(moves, noise, speeds, instants, first_guess)
    plain = _solve(PLAIN, moves, noise, start, instants, COARSE)
    levels = len(shares)
    tops = [_profile(PLAIN, plain.shared, levels, m, k) for m, k in zip(moves, _levels(moves), strict=True)]
    if not any(_reached(profile)[1] for profile in tops):
        # an acceleration that no move reaches has no gradient, which traps the search: restart below what is reached
        again = plain.shared.copy()
        again[levels] = np.log(BELOW * max(profile.top_acceleration for profile in tops))
        plain = min(plain, _solve(PLAIN, moves, noise, again, plain.instants, COARSE), key=lambda each: each.criterion)
    mean = _solve(PLAIN_MEAN, moves, noise, plain.shared, plain.instants, COARSE)
    if mean.squares > EXPLAINED * mean.count:
        # too short a time has no effect, and no gradient: start with longer ones as well
        longer = [plain.shared - np.log(factor) * (np.arange(len(plain.shared)) == levels + 1) for factor in LONGER]
        tries = (_solve(PLAIN_MEAN, moves, noise, begin, plain.instants, COARSE) for begin in longer)
        mean = min(mean, *tries, key=lambda each: each.criterion)
    kinds = []
    for own, other in ((plain, mean), (mean, plain)):
        # if the other kind already leaves nothing but noise, only a lag could make this one as good
        explained = other.squares < EXPLAINED * other.count and other.criterion < own.criterion
        among = [model for model in MODELS if (lags or not model.lag) and not (explained and model.braking)]
        kinds.append(_extended(own, moves, noise, among))
    return tuple(kinds)


def _extended(best: _Solved, moves: Sequence[MoveSamples], noise: float, among: Sequence[_Model]) -> _Solved:
    """The best model, extended step by step for as long as the criterion improves."""
    tried = [best.model]
    while True:
        more = [model for model in among if model not in tried and model.extends(best.model)]
        if not more:
            return best
        tried += more
        found = [_from(best, model, moves, noise) for model in more]
        better = min(found, key=lambda each: each.criterion)
        if better.criterion >= best.criterion:
            return best
        best = better


def _from(before: _Solved, model: _Model, moves: Sequence[MoveSamples], noise: float) -> _Solved:
    """A model's solution, starting from that of the model it extends."""
    levels = before.levels
    speeds, (acceleration, jerk, *rest) = before.shared[:levels], before.shared[levels:]
    braking = rest[: before.model.sided] or [acceleration, jerk][: model.sided]
    found = []
    for lag in FIRST_LAGS if model.lag and not before.model.lag else (None,):
        own = [acceleration, jerk, *braking]
        if lag is not None:
            # so far the unmodelled lag has appeared as a lesser jerk
            own[1::2] = [value + np.log(2.0) for value in own[1::2]]
        last = [] if not model.lag else [rest[-1] if lag is None else np.log(lag)]
        found.append(_solve(model, moves, noise, np.array([*speeds, *own, *last]), before.instants, COARSE))
    return min(found, key=lambda each: each.criterion)


def _quickest(moves: Sequence[MoveSamples], share: float) -> float:
    """The greatest mean speed over about 20 ms among moves at a share of the speed."""
    found = []
    for move in moves:
        if move.share == share:
            n = max(1, min(round(0.02 / float(np.median(np.diff(move.time)))), len(move.time) // 4))
            found.append(float(((move.way[n:] - move.way[:-n]) / (move.time[n:] - move.time[:-n])).max()))
    return max(*found, 1e-6)


def _half_way(move: MoveSamples) -> float:
    """When half of the distance was covered [s]."""
    beyond = int(np.argmax(move.way > 0.5 * move.distance))
    if beyond == 0:
        return float(move.time.mean())
    a, b = move.way[beyond - 1], move.way[beyond]
    share = float(np.clip((0.5 * move.distance - a) / (b - a), 0.0, 1.0))
    return float(move.time[beyond - 1] + share * (move.time[beyond] - move.time[beyond - 1]))


def _start(
    moves: Sequence[MoveSamples], noise: float, speeds: Array, instants: Array, first_guess: tuple[float, float, float]
) -> Array:
    """The shared parameters at which the search starts: the best of a coarse grid of accelerations and jerks."""
    best, start = np.inf, np.append(speeds, np.log(first_guess[1:]))
    for acceleration in first_guess[1] * FACTORS:
        for jerk in first_guess[2] * FACTORS:
            trial = np.append(speeds, np.log([acceleration, jerk]))
            squares = sum(
                float((_off(PLAIN, trial, len(speeds), move, level, at) ** 2).sum())
                for move, level, at in zip(moves, _levels(moves), instants, strict=True)
            )
            if squares < best:
                best, start = squares, trial
    return start


def _levels(moves: Sequence[MoveSamples]) -> list[int]:
    """The index of each move's share of speed, from the greatest share."""
    shares = sorted({move.share for move in moves}, reverse=True)
    return [shares.index(move.share) for move in moves]


def _profile(model: _Model, shared: Array, levels: int, move: MoveSamples, level: int) -> MoveProfile:
    return move_profile(move.distance, model.limits(shared, level, levels))


def _off(model: _Model, shared: Array, levels: int, move: MoveSamples, level: int, at: float) -> Array:
    """Modelled minus recorded positions (m); `at` is the mid-time of the move, including the servo's lag [s]."""
    profile = _profile(model, shared, levels, move, level)
    return profile.at(move.time - (at - 0.5 * profile.total - profile.lag)) - move.way


def _solve(
    model: _Model, moves: Sequence[MoveSamples], noise: float, start: Array, instants: Array, fine: float = FINE
) -> _Solved:
    level, levels = _levels(moves), len(start) - model.size
    begins = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum([len(move.time) for move in moves])])
    n, count = len(start), int(begins[-1])

    def residuals(x: Array) -> Array:
        parts = [
            _off(model, x[:n], levels, move, own, x[n + k]) / noise
            for k, (move, own) in enumerate(zip(moves, level, strict=True))
        ]
        return np.concatenate([*parts, (x[:n] - start) / VAGUE])

    # a move's samples depend on its own speed, the parameters that all moves share, and its own instant
    columns = [[own, *range(levels, n), n + k] for k, own in enumerate(level)]
    width = n - levels + 2
    indices = np.append(np.repeat(columns, np.diff(begins), axis=0), np.arange(n))
    rows = np.append(width * np.arange(count), width * count + np.arange(n + 1))

    def slopes(x: Array) -> csr_array:
        out, here = np.empty((count, width)), residuals(x)
        for k, (move, own) in enumerate(zip(moves, level, strict=True)):
            part = slice(begins[k], begins[k + 1])
            for column, i in enumerate(columns[k][:-1]):
                step = x[:n].copy()
                step[i] += STEP
                out[part, column] = (_off(model, step, levels, move, own, x[n + k]) / noise - here[part]) / STEP
            later = _off(model, x[:n], levels, move, own, x[n + k] + INSTANT) / noise
            out[part, -1] = (later - here[part]) / INSTANT
        return csr_array((np.append(out, np.full(n, 1.0 / VAGUE)), indices, rows), shape=(count + n, len(x)))

    found = least_squares(
        residuals, np.append(start, instants), slopes, x_scale="jac", max_nfev=MOST_STEPS, ftol=fine, xtol=fine
    )
    squares = float((found.fun[:count] ** 2).sum())
    scale = max(1.0, squares / max(count - len(found.x), 1)) * _repeated(found.fun[:count])
    errors = _errors((found.jac.T @ found.jac).toarray(), scale)
    return _Solved(model, found.x[:n], found.x[n:], errors[:n], squares, count)


def _repeated(residuals: Array) -> float:
    """How many samples are worth one independent one: correlated residuals are not noise, but errors of the profile."""
    squares = float(residuals @ residuals)
    alike = float(residuals[1:] @ residuals[:-1]) / squares if squares > 0.0 else 0.0
    alike = float(np.clip(alike, 0.0, 0.999))
    return (1.0 + alike) / (1.0 - alike)


def _errors(squares: Array, scale: float) -> Array:
    """Standard errors of parameters (k) from J^T J (k, k); scale: the variance of J's residuals."""
    norms = np.maximum(np.sqrt(squares.diagonal()), 1e-300)
    sizes, directions = np.linalg.eigh(squares / np.outer(norms, norms))
    out: Array = np.sqrt(scale) * np.linalg.norm(directions / np.sqrt(np.maximum(sizes, 1e-24)), axis=1) / norms
    return out


# ----------------------------------------------------------------------------------------------------
# What is reported.


def _told(
    solved: _Solved,
    own: _MovesAlone | None,
    moves: Sequence[MoveSamples],
    noise: float,
    at_rest: float,
    joint: int,
    asked: AskedMoves,
) -> JointFit:
    model, limits = solved.model, solved.limits
    profiles = [
        _profile(model, solved.shared, solved.levels, move, level)
        for move, level in zip(moves, _levels(moves), strict=True)
    ]
    set_by_program = [None if values is None else float(values[joint]) for values in asked.asked]
    shares = np.array([move.share for move in moves])
    ends = np.array([_reached(profile) for profile in profiles])
    speed = _limit(
        np.array([limits.speed]), solved.errors[:1], np.array([ends[shares == shares.max(), 0].any()]),
        max(profile.top_speed for profile in profiles), set_by_program[0],
    )  # fmt: skip
    sides = 1 + model.braking
    tops = max(max(profile.top_acceleration, profile.top_braking) for profile in profiles)
    rates = np.array([limits.acceleration, limits.braking])[:sides]
    rate_errors, jerk_errors = solved.side_errors
    acceleration = _limit(rates, rate_errors, np.asarray(ends[:, 1 : 1 + sides].any(axis=0)), tops, set_by_program[1])
    jerks = np.array([limits.jerk, limits.braking_jerk])[:sides]
    # a jerk that is not shown exceeds this with 95 % confidence
    least = float((jerks * np.exp(-2.0 * jerk_errors)).min())
    jerk = _limit(jerks, jerk_errors, np.ones(sides, dtype=np.bool_), least, set_by_program[2])
    residual = noise * float(np.sqrt(solved.squares / solved.count))
    if own is not None:
        speed, acceleration, jerk = (
            _least(values, shared) for values, shared in zip(own.limits, (speed, acceleration, jerk), strict=True)
        )
    time = limits.acceleration / limits.jerk
    return JointFit(
        joint=joint,
        speed=speed,
        acceleration=acceleration,
        jerk=jerk,
        braking=_otherwise(limits) if model.braking and own is None else None,
        lag=limits.lag if own is None else own.lag,
        residual=residual,
        noise=at_rest,
        moves=len(moves),
        averaged=(time, time * float(np.hypot(rate_errors[0], jerk_errors[0]))) if model.averaged else None,
    )


def _otherwise(limits: MotionLimits) -> tuple[float, float] | None:
    """Acceleration and jerk of braking, if they differ from those of speeding up by more than the model can resolve."""
    ratios = np.array([limits.braking / limits.acceleration, limits.braking_jerk / limits.jerk])
    return (limits.braking, limits.braking_jerk) if (np.abs(np.log(ratios)) > OTHERWISE).any() else None


def _reached(profile: MoveProfile) -> tuple[bool, bool, bool]:
    """Whether a move reaches, and holds for a while, its greatest speed, acceleration, and braking.

    At the threshold noise decides: a limit just below what is reached without it explains a recording as well.
    """
    return profile.cruise > CRUISE * profile.total, profile.held[0] > PLATEAU, profile.held[1] > PLATEAU


def _limit(values: Array, errors: Array, reached: Flags, top: float, asked: float | None) -> IdentifiedLimit:
    """The lesser of the known limits (1 or 2, of speeding up and braking), or else what was reached.

    None is reported if another that is not known well enough is nevertheless lower with 95 % confidence: a reported
    limit must not exceed the robot's.
    """
    known = reached & (errors < KNOWN)
    if not known.any():
        return IdentifiedLimit(top, float("nan"), (top, top), asked)
    k = int(np.argmin(np.where(known, values, np.inf)))
    value = float(values[k])
    less = reached & ~known & (np.log(values) + 2.0 * errors < np.log(value))
    if less.any():
        least = min(top, float((values * np.exp(-2.0 * errors))[less].min()))
        return IdentifiedLimit(least, float("nan"), (least, least), asked)
    return IdentifiedLimit(value, value * max(float(errors[k]), LEAST_ERROR), (value, value), asked)


@dataclass(frozen=True)
class _MovesAlone:
    """Moves that were fitted one by one: the known speeds, accelerations and jerks, with the standard errors of their
    logarithms; the lag of all [s], and the sum of the moves' residual variances, in units of the noise's variance."""

    limits: tuple[list[tuple[float, float]], ...]
    lag: float
    left: float


def _by_move(solved: _Solved, moves: Sequence[MoveSamples], noise: float) -> _MovesAlone:
    """Fit moves separately, where one set of limits does not explain all of them."""
    levels, averaged = solved.levels, solved.model.averaged
    starts = [np.append(solved.shared[own], solved.shared[levels : levels + 2]) for own in _levels(moves)]
    # the common lag may have been an artefact of differing moves, so try without it too
    alone = {
        lag: [
            _solve_one(move, noise, start, float(at), (lag, averaged))
            for move, start, at in zip(moves, starts, solved.instants, strict=True)
        ]
        for lag in (0.0, solved.limits.lag)
    }
    left = {lag: sum(scale for _, _, scale in each) for lag, each in alone.items()}
    lag = min(left, key=lambda each: left[each])
    found: tuple[list[tuple[float, float]], ...] = ([], [], [])
    for move, own, (limits, errors, _) in zip(moves, _levels(moves), alone[lag], strict=True):
        cruises, speeds_up, brakes = _reached(move_profile(move.distance, limits))
        shown = (cruises and own == 0, speeds_up and brakes, True)
        of_move = (limits.speed, limits.acceleration, limits.jerk)
        for values, value, error, is_shown in zip(found, of_move, errors.tolist(), shown, strict=True):
            if is_shown and error < KNOWN:
                values.append((value, error))
    return _MovesAlone(found, lag, left[lag])


def _least(found: Sequence[tuple[float, float]], shared: IdentifiedLimit) -> IdentifiedLimit:
    """The least of some moves' limits, given with the standard errors of their logarithms, or their mean if they agree.
    Not shown (no error): what was reached if fewer than two are known, or the least if they are too far apart."""
    if len(found) < 2:
        return IdentifiedLimit(shared.value, float("nan"), shared.spread, shared.asked)
    values, errors = np.array(found).T
    logs, weights = np.log(values), 1.0 / np.maximum(errors, LEAST_ERROR) ** 2
    mean = float(np.average(logs, weights=weights))
    apart = float((weights * (logs - mean) ** 2).sum()) / (len(logs) - 1)
    if apart < DIFFER:
        value, error = float(np.exp(mean)), float(np.sqrt(max(apart, 1.0) / weights.sum()))
        return IdentifiedLimit(value, value * max(error, LEAST_ERROR), (value, value), shared.asked)
    low, high = float(values.min()), float(values.max())
    if high > MOST_APART * low:
        return IdentifiedLimit(low, float("nan"), (low, low), shared.asked)
    return IdentifiedLimit(low, 0.5 * (high - low), (low, high), shared.asked)


def _solve_one(
    move: MoveSamples, noise: float, start: Array, at: float, kind: tuple[float, bool]
) -> tuple[MotionLimits, Array, float]:
    """Limits of a single move, near those (3) of all moves, the standard errors (3) of their logarithms, and the
    variance of the residuals, in units of the noise's. kind: lag [s], and whether it is a mean."""
    lag = kind[0]

    def limits(x: Array) -> MotionLimits:
        speed, acceleration, jerk = np.exp(np.clip(x[:3], -WIDEST, WIDEST)).tolist()
        return MotionLimits(speed, acceleration, jerk, acceleration, jerk, *kind)

    def residuals(x: Array) -> Array:
        profile = move_profile(move.distance, limits(x))
        off = profile.at(move.time - (x[3] - 0.5 * profile.total - lag)) - move.way
        return np.concatenate([off / noise, (x[:3] - start) / VAGUE_MOVE])

    found = least_squares(
        residuals, np.append(start, at), x_scale=[1.0, 1.0, 1.0, 0.01], max_nfev=MOST_STEPS, ftol=FINE, xtol=FINE
    )
    left = found.fun[: len(move.time)]
    scale = max(1.0, float(left @ left) / max(len(left) - 4, 1))
    return limits(found.x), _errors(found.jac.T @ found.jac, scale * _repeated(left))[:3], scale
