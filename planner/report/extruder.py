"""What the extruder does, for the report: its events in words and as a table, and flow against the motor's push."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from planner.base.arrays import Array
from planner.plan.plan import filament_areas, used
from planner.report.templates import render
from planner.report.thinning import stretches
from planner.report.wording import counted, number, significant

if TYPE_CHECKING:
    from planner.plan import Event, Plan, Trajectory

WORDS = {
    "heat": "heat up, at home",
    "select": "select the first tool, at home",
    "change": "change tools, at home",
    "purge": "purge, at home",
    "prime": "prime, before a bead",
    "retract": "retract, after a bead",
    "cut": "cut the fibre, at rest on the bead",
    "pause": "pause before a layer, at home",
    "cool": "wait until the material below is cool, at home or lifted",
}

QUICK = 5.0  # × the greatest flow laid: lags up to 0.1 s need three or four times as much, which motors can deliver


@dataclass(frozen=True)
class Kind:
    """All events of one kind: their count, total time [s], total filament [m], and when the first begins [s]."""

    kind: str
    count: int
    time: float
    amount: float
    first: float


def kinds_of(events: Sequence[Event]) -> list[Kind]:
    """Events by kind, in the order in which each kind first occurs."""
    found: dict[str, list[Event]] = {}
    for event in events:
        found.setdefault(event.kind, []).append(event)
    return [
        Kind(
            kind,
            len(group),
            math.fsum(event.duration for event in group),
            math.fsum(event.amount for event in group),
            group[0].start,
        )
        for kind, group in found.items()
    ]


def materials_words(plan: Plan) -> list[str]:
    """A line for each named material: its tool, its beads, and how much of it is used."""
    return [
        f"material {each.material.name}: tool T{each.material.tool}, {counted(each.beads, 'bead')}, "
        f"{significant(each.volume * 1e9)} mm³ laid down, {significant(each.filament * 1e3)} mm of filament"
        for each in used(plan)
    ]


def materials_section(plan: Plan) -> Markup:
    """HTML of how much of each material is used; empty if materials have no names."""
    found = used(plan)
    return render("materials", used=found) if found else Markup("")


def events_words(events: Sequence[Event]) -> str:
    """One line: how often each kind occurs, its total time and the filament it moves; empty without events."""
    each = []
    for kind in kinds_of(events):
        sign = "+" if kind.amount > 0.0 else "-"
        filament = f", {sign}{significant(abs(kind.amount) * 1e3)} mm" if kind.amount else ""
        each.append(f"{kind.count} x {kind.kind} ({significant(kind.time)} s{filament})")
    return f"extruder, apart from laying down: {'; '.join(each)}" if each else ""


def events_section(plan: Plan) -> Markup:
    """HTML of what the extruder does besides depositing; empty if it does nothing else."""
    kinds = kinds_of(plan.trajectory.events)
    return render("events", kinds=kinds, words=WORDS) if kinds else Markup("")


def flow_note(plan: Plan) -> str:
    """What the chart of flow shows, depending on what pushes the material."""
    process, events = plan.problem.process, plan.trajectory.events
    if process.extruder.motor == "on_off":
        note = (
            "The motor only runs or stops: at the commanded speed's rate as long as a bead is laid. "
            "Flow stays the same through a dip in speed, and the bead gets too much material there"
        )
        over = plan.metrics.get("over_extruded_mm3")
        follows = "A motor that follows the speed (process.extruder.motor: e_axis or speed_demand) would avoid that."
        return f"{note}: {number(over, 2)} mm³ in all. {follows}" if over is not None else f"{note}."
    if process.section == "fibre":
        note = "Fibre is laid exactly as fast as the nozzle really moves."
    elif process.extruder.motor == "speed_demand":
        note = (
            "The motor is driven in proportion to the nozzle's real speed, so that the bead stays even through a dip."
        )
    else:
        note = "Material follows the speed that is really reached, so that the bead stays even through a dip."
    if process.extruder.lag > 0.0:
        note += (
            f" Flow lags the motor by {process.extruder.lag:g} s, so the motor runs ahead: more where flow grows, less "
            "where it falls."
        )
        times = most_pushed(plan)
        if times > QUICK:
            note += (
                f" Where beads begin and end it pushes up to {significant(times, 2)} times the greatest flow laid: a "
                "motor that cannot do so lays too little where a bead begins, and too much after its end."
            )
    if any(event.amount for event in events):
        note += " Between beads the motor also pushes and pulls filament that is not deposited."
    if any(event.kind == "cut" for event in events):
        note += " From the cut to the end of the bead, fibre is drawn, not pushed."
    return note


def pushes_otherwise(plan: Plan) -> bool:
    """Whether the motor pushes anything but what is laid down at that moment."""
    trajectory = plan.trajectory
    return plan.problem.process.extruder.lag > 0.0 or any(event.amount for event in trajectory.events)


def pushed(plan: Plan) -> Array:
    """What the motor pushes (n) [m^3/s]: the rate of feed, as volume."""
    t = plan.trajectory
    return np.asarray(filament_areas(plan.problem, t.events, t.t) * np.gradient(t.feed, t.dt))


def most_pushed(plan: Plan) -> float:
    """The motor's greatest push within beads, as a multiple of the greatest flow laid; 0 if nothing is laid."""
    t = plan.trajectory
    within = t.deposit & np.roll(t.deposit, 1) & np.roll(t.deposit, -1)  # next to others a prime or a retract may push
    most = float(even_flow(t).max(initial=0.0))
    return float(pushed(plan)[within].max(initial=0.0)) / most if most > 0.0 else 0.0


def even_flow(trajectory: Trajectory) -> Array:
    """Flow (n) [m^3/s] for display, without false peaks at the ends of beads.

    A bead's first and last samples also carry the flow of the partial sample next to them, which would look like a
    peak; here they are no higher than their neighbour within the bead.
    """
    flow = trajectory.flow.copy()
    index, begin, end = stretches(trajectory.deposit, trajectory.bead)
    longer = end > begin
    for at, step in ((begin[longer], 1), (end[longer], -1)):
        flow[index[at]] = np.minimum(flow[index[at]], flow[index[at + step]])
    return np.asarray(flow)


def surplus(plan: Plan) -> Array | None:
    """Share (n) [%] of the flow that exceeds what the bead holds; None if flow follows the speed."""
    over = plan.series.get("over_extruded_mm3")
    if over is None:
        return None
    flows = plan.trajectory.flow * plan.trajectory.dt * 1e9
    return np.asarray(100.0 * np.divide(over, flows, out=np.zeros(len(over)), where=flows > 0.0))
