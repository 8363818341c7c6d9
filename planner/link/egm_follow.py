"""Externally guided motion without its network: what the controller says in, joint references out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from planner.errors import EXIT_NOT_VERIFIED, PlannerError
from planner.link.egm_limits import Limiter
from planner.link.egm_plan import PERIOD, JointPlan
from planner.readonly import Array

NEAR_START = np.radians(1.0)  # within which the robot must stand before the first reference
DEVIATION = np.radians(2.0)  # of the robot from all references of the last LAG
LAG = 0.3  # s by which a robot may follow its references late
RAMP = 0.2  # s in which the plan's own time comes to run, and to stand
SILENCE = 0.5  # s without a word of the controller
SETTLED = np.radians(0.1)  # of the last reference
STANDING = 1e-6  # rad/s
SETTLING = 2.0  # s in which the robot must come to it
GAP = 2.5  # periods between two words, beyond which the robot is taken to have stopped


class EgmStopped(PlannerError):
    """The motion has ended before its time; says why and where."""

    exit_code = EXIT_NOT_VERIFIED


@dataclass(frozen=True)
class Heard:
    """A word of the controller: joints (m) [rad] as the plan orders them, whether it runs, its clock [s]."""

    joints: Array
    running: bool
    clock: float


class Follower:
    """Answers each word of the controller with the next reference. The plan's time goes on only with the answers.

    sample, total   of the plan, at EGM's rate; `over` once the robot stands at the last one
    """

    def __init__(self, plan: JointPlan) -> None:
        self._plan, self.total, self.over = plan, len(plan.q), False
        self._place, self._rate, self._stopping = 0.0, 0.0, False
        self._limiter: Limiter | None = None
        self._sent: deque[Array] = deque(maxlen=round(LAG / PERIOD))
        self._clock, self._settling = 0.0, 0.0

    @property
    def sample(self) -> int:
        return int(self._place)

    @property
    def begun(self) -> bool:
        """References have been sent."""
        return self._limiter is not None

    def stop(self) -> None:
        """Come to rest on the path; `over` once the references stand, at once where none was sent."""
        self._stopping, self.over = True, not self.begun

    def answer(self, heard: Heard) -> Array | None:
        """The reference (m) [rad] that answers a word; None where there is nothing to say yet.

        Raises EgmStopped where the robot is not where it should be, or has stopped.
        """
        if len(heard.joints) != self._plan.q.shape[1]:
            raise EgmStopped(f"the controller has {len(heard.joints)} axes, the plan {self._plan.q.shape[1]}")
        if not np.isfinite(heard.joints).all():
            raise self._ended("the controller sent joints that are no numbers")
        if self._limiter is None:
            return self._begin(heard)
        if not heard.running:
            raise self._ended("the controller has stopped")
        self._watch(heard.joints)
        gap, self._clock = heard.clock - self._clock, heard.clock
        if not 0.0 <= gap <= GAP * PERIOD:
            self._rate = 0.0
            self._limiter.stopped()
        step = PERIOD / RAMP
        self._rate = max(0.0, self._rate - step) if self._stopping else min(1.0, self._rate + step)
        self._place = min(self._place + self._rate, self.total - 1.0)
        reference = self._limiter.next(self._at(self._place))
        self._sent.append(reference)
        self._finish(heard.joints)
        return reference

    def _begin(self, heard: Heard) -> Array | None:
        away = np.abs(heard.joints - self._plan.q[0])
        if not heard.running:
            return None
        if away.max() > NEAR_START:
            worst = int(away.argmax())
            far = np.degrees(away[worst])
            raise EgmStopped(f"axis {worst + 1} stands {far:.2f} degrees from the plan's start")
        self._limiter = Limiter(heard.joints, self._plan.velocity, self._plan.acceleration, PERIOD)
        self._clock = heard.clock
        self._sent.append(self._limiter.at)
        return self._limiter.at

    def _watch(self, joints: Array) -> None:
        low, high = np.min(self._sent, axis=0), np.max(self._sent, axis=0)
        away = np.maximum(low - joints, joints - high)
        if away.max() > DEVIATION:
            worst = int(away.argmax())
            far = np.degrees(away[worst])
            raise self._ended(f"axis {worst + 1} is {far:.1f} degrees away from all references of the last {LAG:g} s")

    def _at(self, place: float) -> Array:
        k = min(int(place), self.total - 2)
        share = place - k
        return (1.0 - share) * self._plan.q[k] + share * self._plan.q[k + 1]

    def _finish(self, joints: Array) -> None:
        if self._limiter is None:
            return
        if self._stopping:
            self._settling += PERIOD
            stands = self._rate == 0.0 and float(np.abs(self._limiter.speed).max()) < STANDING
            self.over = stands or self._settling > SETTLING
        elif self._place >= self.total - 1.0:
            self._settling += PERIOD
            self.over = float(np.abs(joints - self._plan.q[-1]).max()) < SETTLED
            if not self.over and self._settling > SETTLING:
                raise self._ended("the robot does not come to the last reference")

    def _ended(self, reason: str) -> EgmStopped:
        return EgmStopped(f"{reason}, {self.sample * PERIOD:.2f} s of {(self.total - 1) * PERIOD:.2f} s into the plan")
