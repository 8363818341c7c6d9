"""What controllers can take in: least time per target, and targets per program. One row for each robot language."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from planner.export.player.model import ABB, ASSUMED_ABB, MotionModel


@dataclass(frozen=True)
class ControllerLimits:
    """A controller whose programs are written in a language.

    motion        how it moves
    warned_time   time per target below which there is a warning [s]
    most_targets  users report trouble beyond this many in one program; None if no limit is known, or programs are split
    source        where the times come from, for messages
    """

    title: str
    motion: MotionModel
    warned_time: float
    most_targets: int | None
    source: str

    def measured(self, values: Sequence[tuple[str, float]]) -> ControllerLimits:
        """These limits with values measured on one controller: fields of its motion and values [SI]."""
        if not values:
            return self
        own = {name: int(value) if name == "ahead_moves" else value for name, value in values}
        assumed = tuple(name for name in self.motion.assumed if name not in own)
        return replace(self, motion=replace(self.motion, assumed=assumed, **own))  # type: ignore[arg-type]

    @property
    def most_per_second(self) -> float:
        """Greatest rate of targets [1/s] without a warning."""
        return 1.0 / self.warned_time


CONTROLLERS: dict[str, ControllerLimits] = {
    # A real IRC5 ran 62 evenly spaced lines a second, 16.0 ms each, at full speed (recordings of curve 2, hehonglu123/
    # Motion-Primitive-Planning); no recording with shorter ones was found. In its curve 1, lines of 25.7 ms leave no
    # trace in the speed. Users with targets every few ms report "50078 too many closely spaced positions". Programs
    # are split and loaded in parts.
    "rapid": ControllerLimits("ABB IRC5 / OmniCore", ABB, 0.016, None, "recordings of a real IRC5"),
    # ASSUMED: two interpolation cycles of 12 ms (KR C2, KR C4), as no recording is public. $ADVANCE: at most 5 moves
    # ahead, 3 by default (KUKA System Software, system variables).
    "krl": ControllerLimits("KUKA KR C", ASSUMED_ABB["krl"], 0.024, None, "assumed: two cycles of 12 ms"),
    # ASSUMED: a control cycle is 8 ms on a CB3, 2 ms on an e-Series. Users report that programs of more than 1,000 to
    # 2,500 targets do not load.
    "urscript": ControllerLimits("Universal Robots", ASSUMED_ABB["urscript"], 0.008, 1000, "assumed: a cycle of 8 ms"),
    # ASSUMED, all of them: no recording was found. The interpolation period is assumed to be 8 ms for FANUC, 7.1 ms for
    # Mitsubishi, 4 ms for Yaskawa, Stäubli and Kawasaki; there is a warning about moves of less than two periods.
    "fanuc": ControllerLimits("FANUC R-30iB", ASSUMED_ABB["fanuc"], 0.016, None, "assumed: two periods of 8 ms"),
    "inform": ControllerLimits("Yaskawa", ASSUMED_ABB["inform"], 0.008, None, "assumed: two periods of 4 ms"),
    "val3": ControllerLimits("Stäubli CS9", ASSUMED_ABB["val3"], 0.008, None, "assumed: two periods of 4 ms"),
    "kawasaki": ControllerLimits("Kawasaki", ASSUMED_ABB["kawasaki"], 0.008, None, "assumed: two periods of 4 ms"),
    "melfa": ControllerLimits("Mitsubishi CR800", ASSUMED_ABB["melfa"], 0.016, None, "assumed: two periods of 7.1 ms"),
    # To add a language: a row here, its motion in player/model.py, and `program` in its module.
}
