"""What the problem requires of layers: the least time for each, rests at home before some, and the order of beads.

Derived independently, from the samples (n) and the input alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase

import numpy as np

from planner.plan import Check, Event, Trajectory
from planner.problem.by_layer import PauseSpec
from planner.verify.checks import EVERYWHERE, Findings, Judged, check_least, drawn_name, lines_around
from planner.verify.material import AT_HOME, INSTANT, SAMPLES, away_from_home, rest

AMOUNT = 1e-9  # m of filament


def by_layer(judged: Judged) -> Findings:
    """Checks of what the problem requires of layers; none where it requires nothing."""
    process = judged.problem.process
    checks = [] if process.layer_time is None else [_times(judged, process.layer_time.least)]
    checks += [_pauses(judged)] if process.pauses else []
    checks += [_order(judged)] if process.order else []
    return Findings(tuple(checks))


def _times(judged: Judged, least: float) -> Check:
    """The time [s] from the start of one layer to the start of the next is at least the required one."""
    t = judged.trajectory
    name, limit = "time of a layer", least - SAMPLES * t.dt
    begins = [first for first, _ in _begun(judged)]
    if len(begins) < 2:
        return Check(name, least, limit, "s", True, EVERYWHERE, least=True)
    times = np.full(len(t), np.inf)
    times[begins[1:]] = np.diff(t.t[begins])
    return check_least(t, name, times, limit, "s")


def _begun(judged: Judged) -> Iterator[tuple[int, int]]:
    """The first sample of each layer that is begun, and its bead, in order of time."""
    t = judged.trajectory
    laid = np.flatnonzero(t.deposit)
    layers = np.array([bead.layer for bead in judged.toolpath.beads])[t.bead[laid]]
    there = {bead.layer for bead in judged.toolpath.beads[: t.first_bead]}
    first = np.sort(np.unique(layers, return_index=True)[1])
    for k in first.tolist():
        if layers[k] not in there or k == 0:
            yield int(laid[k]), int(t.bead[laid[k]])


def _pauses(judged: Judged) -> Check:
    """Before each layer that requires it, the robot rests at home and purges the required amount."""
    t, worst, where = judged.trajectory, 0.0, EVERYWHERE
    layers = {judged.toolpath.beads[bead].layer: bead for sample, bead in list(_begun(judged))[1:]}
    asked = {
        layers[pause.before_layer - 1]: pause
        for pause in judged.problem.process.pauses
        if pause.before_layer - 1 in layers
    }
    found = [event for event in t.events if event.kind == "pause"]
    for bead, pause in asked.items():
        own = [event for event in found if event.bead == bead]
        missing = _missing(judged, own[0], pause) if len(own) == 1 else pause.time
        if not missing <= worst:
            worst, where = missing, f"before bead {bead}"
    limit = SAMPLES * t.dt
    ok = worst <= limit + INSTANT and len(found) == len(asked)
    return Check("pauses before layers", worst, limit, "s missing", ok, where)


def _order(judged: Judged) -> Check:
    """In each layer, beads come in the order of the patterns that their names match."""
    patterns = [pattern.replace("[", "[[]") for pattern in judged.problem.process.order]
    t, wrong, where = judged.trajectory, 0, EVERYWHERE
    last: dict[int, int] = {}
    starts = np.flatnonzero(t.deposit & (np.concatenate([[-1], t.bead[:-1]]) != t.bead))
    around = lines_around(judged.problem, judged.toolpath)  # skirt lines come first, whatever the patterns say
    for i in t.bead[starts][t.bead[starts] >= around].tolist():
        bead = judged.toolpath.beads[i]
        name = drawn_name(bead)
        own = next((k for k, pattern in enumerate(patterns) if fnmatchcase(name, pattern)), len(patterns))
        if own < last.get(bead.layer, own):
            wrong, where = wrong + 1, where if wrong else f"bead {i}"
        last[bead.layer] = max(own, last.get(bead.layer, own))
    return Check("order of beads", float(wrong), 0.0, "too late", wrong == 0, where)


def _missing(judged: Judged, event: Event, pause: PauseSpec) -> float:
    """How much [s] of a pause is missing."""
    t = judged.trajectory
    if away_from_home(judged, event.start, pause.time) > AT_HOME or _ends_behind(t, event):
        return pause.time
    purged = sum(
        each.amount
        for each in t.events
        if each.kind == "purge" and each.bead == event.bead and abs(each.start - event.start - pause.wait) < INSTANT
    )
    lacking = abs(purged - pause.purge)
    missing = pause.time - rest(t, event, pause.wait, pause.time) + abs(event.duration - pause.wait)
    return missing + (lacking / pause.purge_speed if lacking > AMOUNT else 0.0)


def _ends_behind(t: Trajectory, event: Event) -> bool:
    """Whether an event ends after its bead begins, or begins before the previous bead ends."""
    laid = np.flatnonzero(t.deposit)
    rows = laid[np.searchsorted(t.bead[laid], event.bead) :][:1]
    before = laid[laid < rows[0]][-1:] if len(rows) else rows
    return not (len(rows) and t.t[rows[0]] >= event.start + event.duration - INSTANT) or bool(
        len(before) and t.t[before[0]] > event.start + INSTANT
    )
