"""Whether the extruder does what the problem requires around beads and before the first move.

Derived independently, from the samples (n), the events and the input alone. What pauses and changes of material require
is checked with them (`by_layer.py`, `material.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner.plan import TRAVEL, Check, Event
from planner.verify.checks import EVERYWHERE, Findings, Judged
from planner.verify.material import INSTANT, SAMPLES, rest

AMOUNT = 1e-9  # m of filament
PLACE = 1e-5  # m along the bead: fibre may be cut this far before or after its place
KINDS = ("heat", "prime", "retract", "cut")  # events checked here, along with purges


@dataclass(frozen=True)
class AskedEvent:
    """An event that the problem requires.

    bead          its index, or TRAVEL
    since, until  earliest and latest start [s]
    duration      [s]; amount: filament that it moves [m]
    """

    kind: str
    bead: int
    since: float
    until: float
    duration: float
    amount: float

    def is_met_by(self, event: Event) -> bool:
        """Whether an event meets this requirement; one with NaN does not."""
        return (
            self.since - INSTANT <= event.start <= self.until + INSTANT
            and abs(event.duration - self.duration) <= INSTANT
            and abs(event.amount - self.amount) <= AMOUNT
        )


def around_beads(judged: Judged) -> Findings:
    """The check that beads are primed, retracted and cut, and the print is started, as the problem requires."""
    wrong = [*_otherwise(judged), *_without_rest(judged)]
    where = wrong[0] if wrong else EVERYWHERE
    return Findings(
        (Check("primes, retracts and cuts as asked", float(len(wrong)), 0.0, "that are not", not wrong, where),)
    )


def _otherwise(judged: Judged) -> Iterator[str]:
    """Required events that are missing or differ, and events that nothing requires, in words."""
    t = judged.trajectory
    rests: dict[int, list[float]] = {}  # by bead: ends of required rests, after which a purge is allowed
    for event in t.events:
        if _is_rest(judged, event):
            rests.setdefault(event.bead, []).append(event.start + event.duration)
    found: dict[tuple[str, int], list[Event]] = {}
    for event in t.events:
        after_rest = any(abs(end - event.start) <= INSTANT for end in rests.get(event.bead, ()))
        if event.kind in KINDS or (event.amount != 0.0 and not (event.kind == "purge" and after_rest)):
            found.setdefault((event.kind, event.bead), []).append(event)
    for asked in _asked(judged):
        own = found.pop((asked.kind, asked.bead), [])
        if len(own) != 1 or not asked.is_met_by(own[0]):
            yield _words(asked.kind, asked.bead)
    for kind, bead in found:
        yield _words(kind, bead)


def _words(kind: str, bead: int) -> str:
    return f"{kind} at the start" if bead == TRAVEL else f"{kind} of bead {bead}"


def _asked(judged: Judged) -> Iterator[AskedEvent]:
    """All events that the problem requires, each with the window of its start, as exactly as the samples show it."""
    process, t = judged.problem.process, judged.trajectory
    start, begin, near = process.start, float(t.t[0]), SAMPLES * t.dt
    hot = [start.bed_c, start.nozzle_c, *(process.nozzle_c(name) for name in process.materials)]
    if start.heat_wait > 0.0 or any(celsius is not None for celsius in hot):
        yield AskedEvent("heat", TRAVEL, begin, begin, start.heat_wait, 0.0)
    if start.purge > 0.0:
        due = begin + start.heat_wait
        yield AskedEvent("purge", TRAVEL, due, due, start.purge / start.purge_speed, start.purge)
    beads = judged.toolpath.beads
    processes = {name: process.of(name) for name in dict.fromkeys(bead.material for bead in beads)}
    for i in range(t.first_bead, len(beads)):
        own, at = processes[beads[i].material], judged.samples[i]
        if not len(at):
            continue  # another check reports that
        first, last = (float(t.t[k]) for k in at[[0, -1]])
        if own.prime_length > 0.0:
            takes = own.prime_length / own.prime.speed
            yield AskedEvent("prime", i, first - takes - near, first - takes + near, takes, own.prime_length)
        if own.retract.length > 0.0:
            takes = own.retract.length / own.retract.speed
            yield AskedEvent("retract", i, last - near, last + near, takes, -own.retract.length)
        if own.fibre is not None:
            place = beads[i].length - own.fibre.cut_length
            a, b = (min(int(k), len(at) - 1) for k in np.searchsorted(t.s[at], [place - PLACE, place + PLACE]))
            yield AskedEvent("cut", i, float(t.t[at[a]]) - t.dt, float(t.t[at[b]]), own.fibre.cut_wait, 0.0)


def _is_rest(judged: Judged, event: Event) -> bool:
    """Whether an event is a required rest: a pause, if the problem has any, or a real change of material."""
    beads = judged.toolpath.beads
    if event.kind == "change" and judged.trajectory.first_bead < event.bead < len(beads):
        return beads[event.bead - 1].material != beads[event.bead].material
    return event.kind == "pause" and event.bead != TRAVEL and bool(judged.problem.process.pauses)


def _without_rest(judged: Judged) -> Iterator[str]:
    """Rests in which the robot or the extruder moves (at home before the first move, and at cuts), in words."""
    start, t = judged.problem.process.start, judged.trajectory
    begins = Event("heat", TRAVEL, float(t.t[0]), start.heat_wait, 0.0)
    short = SAMPLES * t.dt + INSTANT
    if not start.time - rest(t, begins, start.heat_wait, start.time) <= short:
        yield "rest at the start"
    for event in t.events:
        if event.kind == "cut" and not event.duration - rest(t, event, event.duration, event.duration, True) <= short:
            yield f"rest at the cut of bead {event.bead}"
