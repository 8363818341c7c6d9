"""Extrusion: cross-sections of beads, flow at each instant, feed of the filament, and the extruder's other events.

Volumes are in m^3, areas in m^2, filament in m of its length; n counts samples of the trajectory or of a bead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.motion.visits import Rest
from planner.plan import TRAVEL, Event
from planner.plan.plan import SELECTS
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead
from planner.toolpath.runs import prime_time

_ROUNDING = 1e-9  # s
ADVANCE_RAMP = 0.4  # share of the lag over which pressure is built up at a bead's start and released at its end,
LONGEST_RAMP = 0.04  # s, and at most this long: the error left one lag later is below 0.3 %


@dataclass(frozen=True)
class Span:
    """When a bead is laid down: from start to end, and when the nozzle comes to rest at its stops [s].

    material: name of the bead's; at_home: the robot's rest at home before the bead, if there is one
    """

    bead: int
    start: float
    end: float
    stops: tuple[float, ...] = ()
    material: str = ""
    at_home: Rest | None = None


def events(process: ProcessSpec, spans: Sequence[Span]) -> tuple[Event, ...]:
    """All events of a print whose beads are laid down at `spans`, in order of time; none overlaps another.

    A prime ends as its bead starts, a retract begins as it ends. The print begins at 0 s with a rest of
    `process.start.time` at home. Fibre is fed from its prime to its cut; after the cut it is drawn, not fed, to the end
    of its bead. Named materials are selected at home: the first one when everything is hot, any other during a rest
    there. Raises ValueError if the beads leave too little time for that and for `least_travel_time`.
    """
    first = spans[0].material if spans else ""
    found = _at_start(process, first)
    for span in spans:
        own, name = process.of(span.material), span.material
        if span.at_home is not None:
            found += _at_home(process, span.at_home, span.bead, name, found)
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
    """Events at home before the print: heating, selection of the first material if it is named, and purge."""
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


def _at_home(process: ProcessSpec, rest: Rest, bead: int, material: str, before: Sequence[Event]) -> list[Event]:
    """Events in a rest at home, in order: the previous layer cools, a pause, a change of material.

    A pause purges the material that was in use before the change, if there is one.
    """
    found, now = [], rest.start
    if rest.cool > 0.0:
        found.append(Event("cool", bead, now, rest.cool, 0.0))
    now += rest.cool
    old = next((event.material for event in reversed(before) if event.kind in SELECTS), material)
    for kind, asked, own, note in (
        ("pause", rest.pause, old, "" if rest.pause is None else rest.pause.what),
        ("change", process.change if rest.change else None, material, ""),
    ):
        if asked is None:
            continue
        found.append(Event(kind, bead, now, asked.wait, 0.0, own if kind == "change" else "", note))
        if asked.purge > 0.0:
            found.append(Event("purge", bead, now + asked.wait, asked.purge / asked.purge_speed, asked.purge, own))
        now += asked.time
    return found


def filament_area(process: ProcessSpec) -> float:
    """Cross-section of the filament [m^2]."""
    return float(np.pi * process.filament_diameter**2 / 4.0)


def cross_section(section: str, width: Array, height: Array, filament_diameter: float) -> Array:
    """Area (n) [m^2] of a bead of width and height (n) [m].

    A rectangle; a rounded one, with a semicircle at each side; or a fibre, which keeps the filament's diameter.
    Raises InputError if a rounded bead is higher than it is wide.
    """
    if section == "rectangle":
        return width * height
    if section == "rounded":
        if np.any(width < height):
            i = int(np.argmax(height - width))
            narrow = f"{width[i] * 1e3:g} mm wide and {height[i] * 1e3:g} mm high"
            raise InputError(f"a rounded bead cannot be {narrow}", hint="at least as wide as high")
        return (width - height) * height + 0.25 * np.pi * height**2
    return np.full(len(width), 0.25 * np.pi * filament_diameter**2)


def bead_area(bead: Bead, process: ProcessSpec) -> Array:
    """Area (n) [m^2] of the bead's cross-section at its samples."""
    if bead.round and process.section != "fibre":
        return 0.25 * np.pi * bead.width**2
    return cross_section(process.section, bead.width, bead.height, process.filament_diameter)


def deposited_volume(bead: Bead, area: Array, s: Array) -> Array:
    """Volume (k) [m^3] of the bead from its start to arc length s (k) [m]: nothing before 0 or past the end.

    The area (n) [m^2] is linear between the bead's samples; its integral is exact.
    """
    # the varying part is integrated separately: a constant area gives area times length to the last digit
    extra = area - area[0]
    before = np.concatenate([[0.0], np.cumsum(0.5 * (extra[1:] + extra[:-1]) * np.diff(bead.s))])
    s = np.clip(s, 0.0, bead.length)
    k = np.clip(np.searchsorted(bead.s, s, side="right") - 1, 0, len(bead.s) - 2)
    within = s - bead.s[k]
    slope = (extra[k + 1] - extra[k]) / (bead.s[k + 1] - bead.s[k])
    return area[0] * s + (before[k] + within * (extra[k] + 0.5 * slope * within))


def extruded_volume(bead: Bead, process: ProcessSpec, t: Array, s: Array) -> Array:
    """Volume (k) [m^3] that has left the nozzle in this bead by the instants t (k) [s], with the nozzle at s (k) [m].

    Neither t nor s decreases, and both extend beyond the bead's ends. An on/off motor runs at the commanded speed's
    rate for as long as the bead is laid; any other follows the actual speed.
    """
    area = bead_area(bead, process)
    if process.extruder.motor != "on_off":
        return deposited_volume(bead, area, s)
    mean = deposited_volume(bead, area, bead.s[-1:])[0] / bead.length
    start, end = np.interp([0.0, bead.length], s, t)
    return mean * bead.commanded(process.speed) * np.clip(t - start, 0.0, end - start)


def flow(volume_at_edges: Array, dt: float) -> Array:
    """Mean flow (n) [m^3/s] over each sample's own dt, from the volume at its two edges (n + 1)."""
    return np.diff(volume_at_edges) / dt


def feed(
    t: Array,
    bead: NDArray[np.int32],
    extruded: Array,
    flow: Array,
    events: Sequence[Event],
    filament_area: float,
    lag: float,
) -> Array:
    """How far the motor has pushed the filament (n) [m] at uniformly spaced instants t (n) [s].

    extruded (n) [m^3] and flow (n) [m^3/s] belong to the beads in `bead` (n), which is -1 in travel. From a cut to the
    end of its bead, fibre is drawn, not pushed; events with an amount push evenly over their duration. With a lag [s]
    the filament runs ahead by the lag times its rate, so that a flow which follows the motor with that lag is the
    bead's.
    """
    fed = (extruded - _drawn(t, bead, extruded, events)) / filament_area + _pushed(t, events)
    if lag > 0.0:
        fed = fed + lag / filament_area * _advance(bead, extruded, flow, lag, float(t[1] - t[0]))
    return fed


def feed_of_materials(
    process: ProcessSpec,
    materials: Sequence[str],
    begun: NDArray[np.int32],
    t: Array,
    bead: NDArray[np.int32],
    extruded: Array,
    flow: Array,
    events: Sequence[Event],
) -> Array:
    """Filament (n) [m] that all motors together have pushed, each its own material; see `feed`.

    materials: the name of each bead's; begun (n): the last bead begun, whose material is laid if any is.
    """
    lag, names = process.extruder.lag, list(dict.fromkeys(materials))
    if len(names) == 1:
        return feed(t, bead, extruded, flow, events, filament_area(process.of(names[0])), lag)
    fed, laid = np.zeros(len(t)), np.diff(extruded, prepend=0.0)
    own = np.array([names.index(material) for material in materials])[begun]
    for k, name in enumerate(names):
        mine = own == k
        volume = np.cumsum(np.where(mine, laid, 0.0))
        moved = [event for event in events if event.material == name]
        area = filament_area(process.of(name))
        fed += feed(t, np.where(mine, bead, -1), volume, np.where(mine, flow, 0.0), moved, area, lag)
    return fed


def _drawn(t: Array, bead: NDArray[np.int32], extruded: Array, events: Sequence[Event]) -> Array:
    """Volume (n) [m^3] laid down after cuts, which no motor feeds."""
    cuts = [event for event in events if event.kind == "cut"]
    if not cuts:
        return np.zeros(len(t))
    last = np.flatnonzero((bead >= 0) & (np.append(bead[1:], -1) != bead))  # of each bead; the next counts it whole
    ends = last[np.searchsorted(bead[last], [event.bead for event in cuts])] + 1
    begin = np.interp([event.start for event in cuts], t, extruded)
    resting = np.searchsorted(t, [event.start for event in cuts]).clip(max=len(t) - 1)  # samples in the rest are exact
    rests = t[resting] <= [event.start + event.duration for event in cuts]
    begin = np.where(rests, extruded[resting], begin)
    end = extruded[np.minimum(ends, len(t) - 1)]
    total = np.cumsum(end - begin)
    drawn = np.column_stack([np.append(0.0, total[:-1]), total]).ravel()
    return np.interp(extruded, np.column_stack([begin, end]).ravel(), drawn)


def _pushed(t: Array, events: Sequence[Event]) -> Array:
    """Filament (n) [m] pushed by events, which do not overlap."""
    pushes = [event for event in events if event.amount != 0.0]
    if not pushes:
        return np.zeros(len(t))
    times = np.maximum.accumulate(np.array([[event.start, event.start + event.duration] for event in pushes]).ravel())
    total = np.cumsum([event.amount for event in pushes])
    return np.interp(t, times, np.column_stack([np.append(0.0, total[:-1]), total]).ravel())


def _advance(bead: NDArray[np.int32], extruded: Array, flow: Array, lag: float, dt: float) -> Array:
    """The flow (n) for which pressure is maintained: that of each sample, ramped smoothly at the ends of a bead."""
    laid = np.flatnonzero(bead >= 0)
    if len(laid) == 0:
        return np.zeros(len(flow))
    edges = np.flatnonzero(np.diff(bead[laid])) + 1
    first, last = np.append(0, edges), np.append(edges, len(laid)) - 1
    # the rate at a sample's own instant, from the means over dt and over 2 dt (Richardson extrapolation)
    rate = flow[laid] + (flow - np.gradient(extruded, dt))[laid] / 3.0
    # a bead's first and last samples also carry the flow of the partial sample next to them
    rate[first] = rate[np.minimum(first + 1, last)]
    rate[last] = rate[np.maximum(last - 1, first)]
    share = (bead >= 0).astype(np.float64)
    for end in (first, last):
        share[laid[end]] = flow[laid[end]] / np.where(rate[end] > 0.0, rate[end], 1.0)
    share = uniform_filter1d(share, 2 * int(0.5 * min(ADVANCE_RAMP * lag, LONGEST_RAMP) / dt) + 1, mode="constant")
    samples = np.arange(len(flow))
    after = np.clip(np.searchsorted(laid, samples), 0, len(laid) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(samples - laid[before] < laid[after] - samples, before, after)
    return share * rate[nearest]
