"""A heater and its temperature over time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

AMBIENT_C = 22.0


@dataclass(frozen=True)
class Heater:
    """Full power until the target is reached, then held; cools by itself. Temperatures in °C, times in s.

    limit   where it would end at full power; time_constant of both heating and cooling
    start, since   temperature at a time, from which the present one follows
    """

    limit: float
    time_constant: float
    target: float = 0.0
    start: float = AMBIENT_C
    since: float = 0.0

    def at(self, time: float) -> float:
        """Temperature at a time, not before `since`."""
        goal = max(self.target, AMBIENT_C)
        towards = self.limit if goal > self.start else AMBIENT_C
        there = towards + (self.start - towards) * math.exp(-(time - self.since) / self.time_constant)
        return min(there, goal) if goal > self.start else max(there, goal)

    def set(self, target: float, time: float) -> Heater:
        """The heater with another target from a time on."""
        return replace(self, target=target, start=self.at(time), since=time)

    def reached(self, cooling: bool) -> float:
        """When the target is reached; at once where it would have to cool and that is not waited for."""
        goal = max(self.target, AMBIENT_C)
        if goal > self.start:
            return self.since + self.time_constant * math.log((self.limit - self.start) / (self.limit - goal))
        if not cooling or goal == self.start:
            return self.since
        near = max(goal, AMBIENT_C + 1.0)  # ambient itself is never quite reached
        return self.since + self.time_constant * max(0.0, math.log((self.start - AMBIENT_C) / (near - AMBIENT_C)))


# Typical of a 40 W cartridge in a nozzle and of a mains bed: 200 °C after 95 s, 60 °C after 118 s.
NOZZLE = Heater(limit=350.0, time_constant=120.0)
BED = Heater(limit=140.0, time_constant=300.0)
