"""What the extruder does besides depositing, in time: heat, purge, prime, retract and cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planner.plan import TRAVEL, Event
from planner.problem.process import ProcessSpec
from planner.process import prime_time

_ROUNDING = 1e-9  # s


@dataclass(frozen=True)
class Span:
    """When a bead is laid down: from start to end, and when the nozzle comes to rest at its stops [s]."""

    bead: int
    start: float
    end: float
    stops: tuple[float, ...] = ()


def events(process: ProcessSpec, spans: Sequence[Span]) -> tuple[Event, ...]:
    """All events of a print whose beads are laid down at `spans`, in order of time; none overlaps another.

    A prime ends as its bead starts, a retract begins as it ends. The print begins at 0 s with the rest at home that
    `process.start.time` asks for. Fibre is fed from its prime to its cut; after the cut it is drawn, not fed, to the
    end of its bead. Raises ValueError where the beads leave less time than `process.least_travel_time` asks for.
    """
    found = _at_start(process)
    for span in spans:
        prime = prime_time(process)
        if process.prime_length > 0.0:
            found.append(Event("prime", span.bead, span.start - prime, prime, process.prime_length))
        if process.fibre is not None:
            found += [Event("cut", span.bead, stop, process.fibre.cut_wait, 0.0) for stop in span.stops]
        if process.retract.length > 0.0:
            found.append(Event("retract", span.bead, span.end, process.retract.time, -process.retract.length))
    for before, after in zip(found[:-1], found[1:], strict=True):
        late = before.start + before.duration - after.start
        if late > _ROUNDING:
            raise ValueError(
                f"{after.kind} of bead {after.bead} begins {late:.3g} s before {before.kind} of bead {before.bead} ends"
            )
    return tuple(found)


def _at_start(process: ProcessSpec) -> list[Event]:
    """Heating and purge at home."""
    start = process.start
    found = []
    if start.heat_wait > 0.0 or start.nozzle_c is not None or start.bed_c is not None:
        found.append(Event("heat", TRAVEL, 0.0, start.heat_wait, 0.0))
    if start.purge > 0.0:
        found.append(Event("purge", TRAVEL, start.heat_wait, start.purge / start.purge_speed, start.purge))
    return found
