"""How late joints follow their commands: a pure delay and a first-order lag, fitted by shifting and filtering them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import lfilter

from planner.base.arrays import Array, ReadOnlyArrays
from planner.feedback.identify_fit import FLOOR
from planner.feedback.identify_match import MatchedLog
from planner.feedback.identify_program import AskedMoves

GRID = 0.5e-3  # s: time step at which commands are filtered, a fraction of any controller's cycle
LONGEST = 0.25  # s: longest delay of the search; longer ones reach into the rest before
EARLIEST = -0.02  # s: commands and positions may be stamped at different instants of a cycle
FIRST_DELAYS = np.arange(EARLIEST, LONGEST, 4e-3)  # s: candidate starts of the search
FIRST_DELAY_LAGS = (1e-3, 0.01, 0.03)  # s, likewise
SHORTEST_LAG = 1e-4  # s: a shorter lag counts as none


@dataclass(frozen=True)
class JointDelay:
    """How late a joint follows its commands.

    delay, lag   pure delay and time constant of a first-order lag [s], with their standard errors
    total        sum of both [s]: how late the joint is at a steady speed
    """

    joint: int
    delay: float
    delay_error: float
    lag: float
    lag_error: float
    total: float
    total_error: float


@dataclass(frozen=True)
class FollowedMove(ReadOnlyArrays):
    """Commands on an even grid (g) from `start` [s], and the joint at times (m) [s]; relative to the rest before."""

    start: float
    commands: Array
    time: Array
    executed: Array

    def modelled(self, delay: float, lag: float) -> Array:
        """Modelled positions (m) of the joint with a delay and a lag [s]."""
        followed = self.commands
        if lag > SHORTEST_LAG:
            # exact for commands that are linear between grid points
            fading = np.exp(-GRID / lag)
            first = 1.0 - lag / GRID * (1.0 - fading)
            followed = lfilter([first, 1.0 - fading - first], [1.0, -fading], self.commands)
        grid = self.start + GRID * np.arange(len(followed))
        return np.interp(self.time - delay, grid, followed)


def fit_delay(log: MatchedLog, asked: AskedMoves, joint: int) -> JointDelay | None:
    """How late a joint follows its commands; None if the recording has no commands."""
    if log.commanded is None:
        return None
    moves = [_followed(log, log.commanded, k, joint) for k, move in enumerate(asked.moves) if move.joint == joint]
    noise = max(float(log.noise[joint]), FLOOR)
    begin = min(FIRST_DELAYS, key=lambda delay: _squares(moves, float(delay), 0.0))
    found = min(
        (_solve_delay(moves, noise, np.array([max(begin - lag, EARLIEST + 1e-6), lag])) for lag in FIRST_DELAY_LAGS),
        key=lambda each: float(each[2]),
    )
    x, covariance, _ = found
    return JointDelay(
        joint=joint,
        delay=float(x[0]),
        delay_error=float(np.sqrt(covariance[0, 0])),
        lag=float(x[1]),
        lag_error=float(np.sqrt(covariance[1, 1])),
        total=float(x.sum()),
        total_error=float(np.sqrt(max(covariance.sum(), 0.0))),
    )


def _followed(log: MatchedLog, commanded: Array, k: int, joint: int) -> FollowedMove:
    (first, last), (next_first, next_last) = log.rests[k].tolist(), log.rests[k + 1].tolist()
    part = slice(first, next_last + 1)
    time, told, done = log.time[part] - log.time[first], commanded[part, joint], log.executed[part, joint]
    told, done = told - told[: last - first + 1].mean(), done - done[: last - first + 1].mean()
    grid = np.arange(0.0, time[-1], GRID)
    seen = slice(last - first, next_first - first + 1)
    return FollowedMove(0.0, np.asarray(CubicSpline(time, told)(grid)), time[seen], done[seen])


def _squares(moves: Sequence[FollowedMove], delay: float, lag: float) -> float:
    return sum(float(((move.modelled(delay, lag) - move.executed) ** 2).sum()) for move in moves)


def _solve_delay(moves: Sequence[FollowedMove], noise: float, start: Array) -> tuple[Array, Array, float]:
    """Delay and lag (2), their covariance (2, 2), and the sum of squares in units of the noise's variance."""

    def residuals(x: Array) -> Array:
        return np.concatenate([(move.modelled(x[0], x[1]) - move.executed) / noise for move in moves])

    bounds = ([EARLIEST, 0.0], [LONGEST, LONGEST])
    found = least_squares(residuals, start, bounds=bounds, x_scale=[1e-3, 1e-3], diff_step=1e-3, max_nfev=60)
    squares = float((found.fun**2).sum())
    scale = max(1.0, squares / max(len(found.fun) - 2, 1))
    return found.x, np.linalg.pinv(found.jac.T @ found.jac) * scale, squares
