"""What the extruder does besides depositing, in time: heat, select, purge, prime, retract, cut and change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planner.plan import TRAVEL, Event
from planner.problem.process import ProcessSpec
from planner.process import prime_time

_ROUNDING = 1e-9  # s


@dataclass(frozen=True)
class Span:
    """When a bead is laid down: from start to end, and when the nozzle comes to rest at its stops [s].

    material of the bead, by its name; change: when the robot comes to rest at home before it, to change to that, if so
    """

    bead: int
    start: float
    end: float
    stops: tuple[float, ...] = ()
    material: str = ""
    change: float | None = None


def events(process: ProcessSpec, spans: Sequence[Span]) -> tuple[Event, ...]:
    """All events of a print whose beads are laid down at `spans`, in order of time; none overlaps another.

    A prime ends as its bead starts, a retract begins as it ends. The print begins at 0 s with the rest at home that
    `process.start.time` asks for. Fibre is fed from its prime to its cut; after the cut it is drawn, not fed, to the
    end of its bead. Materials with names are selected at home, the first one when all is hot, any other in the rest
    that `process.change` asks for. Raises ValueError where the beads leave less time than that and
    `process.least_travel_time` ask for.
    """
    first = spans[0].material if spans else ""
    found = _at_start(process, first)
    for span in spans:
        own, name = process.of(span.material), span.material
        if span.change is not None:
            change = process.change
            found.append(Event("change", span.bead, span.change, change.wait, 0.0, name))
            if change.purge > 0.0:
                time = change.purge / change.purge_speed
                found.append(Event("purge", span.bead, span.change + change.wait, time, change.purge, name))
        prime = prime_time(own)
        if own.prime_length > 0.0:
            found.append(Event("prime", span.bead, span.start - prime, prime, own.prime_length, name))
        if own.fibre is not None:
            found += [Event("cut", span.bead, stop, own.fibre.cut_wait, 0.0, name) for stop in span.stops]
        if own.retract.length > 0.0:
            found.append(Event("retract", span.bead, span.end, own.retract.time, -own.retract.length, name))
    for before, after in zip(found[:-1], found[1:], strict=True):
        late = before.start + before.duration - after.start
        if late > _ROUNDING:
            raise ValueError(
                f"{after.kind} of bead {after.bead} begins {late:.3g} s before {before.kind} of bead {before.bead} ends"
            )
    return tuple(found)


def _at_start(process: ProcessSpec, material: str) -> list[Event]:
    """Heating, selection of the first material, if it has a name, and purge, at home."""
    start = process.start
    found = []
    hot = [start.bed_c, start.nozzle_c, *(process.nozzle_c(name) for name in process.materials)]
    if start.heat_wait > 0.0 or any(celsius is not None for celsius in hot):
        found.append(Event("heat", TRAVEL, 0.0, start.heat_wait, 0.0, material))
    if material:
        found.append(Event("select", TRAVEL, start.heat_wait, 0.0, 0.0, material))
    if start.purge > 0.0:
        found.append(Event("purge", TRAVEL, start.heat_wait, start.purge / start.purge_speed, start.purge, material))
    return found
