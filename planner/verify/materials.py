"""The verifier's part on several materials: each bead by its own tool, each change at rest and as long as it takes."""

from __future__ import annotations

import numpy as np

from planner.plan import Check, Event, Trajectory
from planner.plan.materials import NONE, selected
from planner.problem import Problem
from planner.toolpath.bead import Toolpath
from planner.verify.checks import place

STILL = 1e-9  # rad that a joint moves in a sample at most, and
UNMOVED = 1e-12  # m of filament, where robot and extruder rest
INSTANT = 1e-9  # s: as near as instants of events are known
SAMPLES = 2  # that a rest may be shorter than it is: the samples do not tell when it begins and ends


def materials(problem: Problem, toolpath: Toolpath, t: Trajectory, checks: list[Check]) -> None:
    """Append the checks of a print whose materials have names."""
    names = list(problem.process.materials)
    if names:
        _own_tool(names, toolpath, t, checks)
        _changes(problem, toolpath, t, checks)


def _own_tool(names: list[str], toolpath: Toolpath, t: Trajectory, checks: list[Check]) -> None:
    """Whatever is laid, pushed or pulled is fed by the tool of the material that it has to be."""
    own = np.array([names.index(bead.material) if bead.material in names else NONE for bead in toolpath.beads])
    wanted = np.where(t.deposit, own[t.bead], NONE)
    wrong = t.deposit & ((selected(names, t.events, t.t) != wanted) | (wanted == NONE))
    count, where = int(wrong.sum()), place(t, int(np.argmax(wrong))) if wrong.any() else "everywhere"
    for event in t.events:
        if event.amount == 0.0:
            continue
        middle = selected(names, t.events, np.array([event.start + 0.5 * event.duration]))[0]
        bead = event.bead if 0 <= event.bead < len(own) else t.first_bead  # what is pushed before all is for that one
        if middle == NONE or not names[middle] == event.material == toolpath.beads[bead].material:
            count, where = count + 1, f"{event.kind} of bead {event.bead}" if count == 0 else where
    checks.append(Check("material fed by its own tool", float(count), 0.0, "samples and events", count == 0, where))


def _changes(problem: Problem, toolpath: Toolpath, t: Trajectory, checks: list[Check]) -> None:
    """Wherever the material changes, robot and extruder rest for it, and the new material is purged."""
    change, worst, where = problem.process.change, 0.0, "everywhere"
    purges = [event for event in t.events if event.kind == "purge"]
    for i in range(t.first_bead + 1, len(toolpath.beads)):
        before, after = toolpath.beads[i - 1 : i + 1]
        if before.material == after.material:
            continue
        found = [event for event in t.events if event.kind == "change" and event.bead == i]
        missing = change.time
        if len(found) == 1 and found[0].material == after.material:
            purged = sum(event.amount for event in purges if event.bead == i)
            missing = change.time - _rest(t, found[0], change.wait, change.time)
            missing += abs(found[0].duration - change.wait) + abs(purged - change.purge) / change.purge_speed
        if not missing <= worst:
            worst, where = missing, f"before bead {i}"
    limit = SAMPLES * t.dt
    checks.append(Check("rest for a change of material", worst, limit, "s missing", worst <= limit + INSTANT, where))


def _rest(t: Trajectory, event: Event, wait: float, time: float) -> float:
    """How long [s] the robot stands still in the `time` from an event on, no filament moves in the first `wait` of it."""
    first, silent, last = np.searchsorted(t.t, event.start + np.array([-INSTANT, wait + INSTANT, time + INSTANT]))
    still = np.abs(np.diff(t.q[first:last], axis=0)).max(axis=1, initial=0.0) < STILL
    moved = np.abs(np.diff(t.feed[first:last])) > UNMOVED
    moved[max(silent - first - 1, 0) :] = False
    return float((still & ~moved & ~t.deposit[first : last - 1]).sum()) * t.dt if last > first else 0.0
