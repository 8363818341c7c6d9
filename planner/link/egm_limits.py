"""A limiter of joint references: however they jump, no step goes beyond the joints' speed and acceleration."""

from __future__ import annotations

import numpy as np

from planner.readonly import Array

CATCHING_UP = 0.5  # share of the acceleration with which a reference that lies behind is planned to come up


class Limiter:
    """References (m) every `period` [s]. Where goals themselves keep the limits, they come out unchanged.

    A goal that is ahead is caught up with as quickly as allowed, and without passing it: the speed towards it is what
    can still be braked. An axis whose limits are 0 never moves.
    """

    def __init__(self, at: Array, velocity: Array, acceleration: Array, period: float) -> None:
        self.at, self.speed = np.array(at, np.float64), np.zeros(len(at))
        self._goal = self.at.copy()
        self._velocity, self._acceleration, self._period = velocity, acceleration, period

    def stopped(self) -> None:
        """The robot was left without references and stands."""
        self.speed = np.zeros_like(self.speed)

    def next(self, goal: Array) -> Array:
        """The reference that follows, towards a goal for the same instant."""
        behind = self._goal - self.at
        moving = (goal - self._goal) / self._period
        brake = CATCHING_UP * self._acceleration
        # the greatest speed from which whole steps of braking end within what is left
        tick = brake * self._period
        most = np.sqrt(0.25 * tick * tick + 2.0 * brake * np.abs(behind)) - 0.5 * tick
        closing = np.sign(behind) * np.minimum(np.abs(behind) / self._period, most)
        change = self._acceleration * self._period
        wanted = np.clip(moving + closing, self.speed - change, self.speed + change)
        self.speed = np.clip(wanted, -self._velocity, self._velocity)
        self.at = self.at + self.speed * self._period
        self._goal = np.array(goal, np.float64)
        return self.at
