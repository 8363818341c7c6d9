"""Rests at home between beads: until a layer is cool, for a requested pause, for a change of material.

Waits for the material below a bead are handled in `planner.motion.interlayer`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from planner.motion.timing.timed_path import TimedPath
from planner.problem.by_layer import PauseSpec
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead

_SLIGHT = 1e-3  # s by which a layer may be too quick without a visit home


@dataclass(frozen=True)
class Visit:
    """Why the robot goes home before a bead.

    layer_before  first bead of the previous layer if that may have been laid too quickly; None if it surely was not
    pause         requested before the bead's layer
    change        whether the bead is of another material
    """

    layer_before: int | None = None
    pause: PauseSpec | None = None
    change: bool = False


@dataclass(frozen=True)
class Rest:
    """A scheduled visit: it begins at `start`, and first lets the previous layer cool for another `cool` [s]."""

    start: float
    cool: float
    pause: PauseSpec | None
    change: bool

    def time(self, process: ProcessSpec) -> float:
        """How long the robot rests [s]."""
        pause = 0.0 if self.pause is None else self.pause.time
        return self.cool + pause + (process.change.time if self.change else 0.0)


def visits(process: ProcessSpec, beads: Sequence[Bead], timed: Sequence[TimedPath]) -> Mapping[int, Visit]:
    """Beads, by index, before which the robot goes home, and why; timed: all of them, or the last ones."""
    before, least = len(beads) - len(timed), 0.0 if process.layer_time is None else process.layer_time.least - _SLIGHT
    pauses = {pause.before_layer - 1: pause for pause in process.pauses}
    found: dict[int, Visit] = {}
    first, seen = before, {bead.layer for bead in beads[: before + 1]}
    laying = _laying(timed[0], beads[before]) if least else 0.0
    for i in range(before + 1, len(beads)):
        bead, path = beads[i], timed[i - before]
        new = bead.layer not in seen
        seen.add(bead.layer)
        visit = Visit(
            layer_before=first if new and laying < least else None,
            pause=pauses.get(bead.layer) if new else None,
            change=beads[i - 1].material != bead.material,
        )
        if visit != Visit():
            found[i] = visit
        if new:
            first, laying = i, 0.0
        laying += _laying(path, bead) if least else 0.0
    return found


def rest_of(process: ProcessSpec, visit: Visit, start: float, after: float, begun: float) -> Rest:
    """Schedule a visit from `start` [s].

    after: time from its end until the bead is laid [s]; begun: when the bead `layer_before` was begun [s]
    """
    rest = Rest(start, 0.0, visit.pause, visit.change)
    if visit.layer_before is None or process.layer_time is None:
        return rest
    cool = process.layer_time.least - (start + rest.time(process) + after - begun)
    return Rest(start, max(0.0, cool), visit.pause, visit.change)


def _laying(path: TimedPath, bead: Bead) -> float:
    """How long it takes to lay a bead [s], without its runs."""
    return path.when(bead.length) - path.when(0.0)
