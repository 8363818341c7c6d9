"""Material: what flows against what the beads hold, what the motor pushes, and which tool lays which bead.

Cross-sections, volumes and lag are worked out anew here, from the samples (n) and the input alone. Volumes are in
m^3, filament in m of its length.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.ndimage import maximum_filter1d

from planner.base.arrays import Array
from planner.plan import Check, Event, Trajectory
from planner.plan.plan import NONE, filament_areas, selected
from planner.problem.layers import GcodeLayersSpec
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.verify.checks import EVERYWHERE, SPEED_TOLERANCE, Findings, Judged, check_most, lines_around, place

Samples = NDArray[np.intp]

EXTRUSION_TOLERANCE = 1e-3  # of the volume
PER_MILLIMETRE = 5e-3  # of what a millimetre of the bead holds
SWITCHED_ENDS = 2e-3  # m at both ends of a bead that are not judged where a motor is only switched,
SWITCHED_WIDTHS = 4.0  # or times the width of narrow ones, of which as much would be all that there is
MILLIMETRE = 1e-3  # m: stretch of a bead that is weighed
RESOLVED = 4  # samples that a stretch lasts at least: fewer do not tell how much lies in it
STEPS = 4  # places in a stretch at which the next one begins
FILAMENT_TOLERANCE = 1e-2  # of what one sample lays down, in filament
FINE = 5e-3  # s between samples: what the motor does between them matters little
ZONE_SAMPLES = 2  # beyond the lag itself: when it began is known to a sample only
STILL = 1e-9  # rad that a joint moves in a sample at most, and
UNMOVED = 1e-12  # m of filament, where robot and extruder rest
AT_HOME = 1e-6  # rad or m, by which the arm may rest beside home
INSTANT = 1e-9  # s: as near as instants of events are known
SAMPLES = 2  # that a rest may be shorter than it is: the samples do not tell when it begins and ends


@dataclass(frozen=True)
class Volume:
    """Volume of a bead along its length: area (n) [m^2] at s (n) [m], linear between, and its integral (n) [m^3]."""

    s: Array
    area: Array
    integral: Array

    @property
    def total(self) -> float:
        """Of the whole bead [m^3]."""
        return float(self.integral[-1])

    def to(self, s: Array) -> Array:
        """Volume (k) [m^3] from the start to s (k) [m]."""
        i = np.clip(np.searchsorted(self.s, s) - 1, 0, len(self.s) - 2)
        far = np.clip(s, 0.0, self.s[-1]) - self.s[i]
        here = np.interp(s, self.s, self.area)
        return self.integral[i] + 0.5 * (self.area[i] + here) * far


@dataclass(frozen=True)
class FlowByLength:
    """What millimetres of beads get: the largest share by which one that is judged is off, where, at which sample (-1 at none),
    and the share of all that are within process.extruder.flow_tolerance."""

    worst: float
    where: str
    sample: int
    even: float


def volume_of(bead: Bead, process: ProcessSpec) -> Volume:
    """The bead's volume, from its measures and the section that the problem asks for; a strut in space is round."""
    w, h = bead.width, bead.height
    area = {
        "rectangle": w * h,
        "rounded": w * h - (1.0 - np.pi / 4.0) * h**2,  # a rectangle without its four corners
        "round": np.pi * (0.5 * w) ** 2,
        "fibre": np.pi * (0.5 * process.filament_diameter) ** 2 + 0.0 * w,
    }["round" if bead.round and process.section != "fibre" else process.section]
    pieces = np.diff(bead.s) * (area[:-1] + area[1:]) / 2.0
    return Volume(bead.s, area, np.concatenate([[0.0], np.cumsum(pieces)]))


def switched_ends(width: float) -> float:
    """How much of a bead of some width [m] is not judged at both ends where a motor is only switched [m]."""
    return min(SWITCHED_ENDS, SWITCHED_WIDTHS * width)


def extrusion(judged: Judged) -> Findings:
    """Material flows while beads are laid and at no other time, as much as they hold; the motor pushes that much."""
    problem, t, samples = judged.problem, judged.trajectory, judged.samples
    process, lag = problem.process, problem.process.extruder.lag
    volumes = [volume_of(bead, process) for bead in judged.toolpath.beads]
    sample = max(float(v.area.max()) for v in volumes[t.first_bead :]) * _fastest(judged) * t.dt
    drawn, pushed = _drawn(t, volumes, samples), _pushed(t.t, t.events)
    pressed = _pressed(t.feed - pushed, filament_areas(problem, t.events, t.t)) + drawn
    switched = process.extruder.motor == "on_off"
    ends = switched_ends(process.bead.width) if switched else 0.0
    flow = _per_millimetre(judged, volumes, _leaving(pressed, t.dt, lag), ends)
    near = _near_ends(t, lag)
    checks: list[Check] = []
    metrics: dict[str, float] = {}
    series: dict[str, Array] = {}
    if switched:
        late = np.abs(np.cumsum(t.flow) * t.dt - t.extruded)
        over = _over_extruded(t, volumes, samples)
        checks.append(_runs_while_laying(judged, volumes))
        checks.append(_keeps_pace(t, late, sample))
        series["over_extruded_mm3"] = over * 1e9
        metrics["over_extruded_mm3"] = float(over.sum()) * 1e9
        metrics["even_flow_fraction"] = flow.even
    else:
        checks.append(_balance(t, volumes, samples))
        checks.append(_keeps_pace(t, _behind(t, volumes, samples), sample))
    checks.append(_flow_per_millimetre(t, flow, process.extruder.flow_tolerance if switched else PER_MILLIMETRE))
    checks.append(_fed(t, pressed, lag, near, sample))
    if process.section == "fibre":
        checks.append(_as_long_as_its_bead(t, volumes, samples))
    if process.materials:
        checks += [_own_tool(list(process.materials), judged.toolpath, t), _changes(judged)]
        checks += _as_named(judged)
    metrics["flow_error_max"] = flow.worst
    if lag > 0.0:
        metrics["lag_zone_mm"] = float((t.speed * t.dt)[near & t.deposit].sum()) * 1e3
    metrics["extruded_volume_mm3"] = float(t.extruded[-1]) * 1e9
    metrics["extruded_mm"] = float(t.feed[-1]) * 1e3
    return Findings(tuple(checks), metrics, series)


def _fastest(judged: Judged) -> float:
    """Greatest speed [m/s] at which material is laid: in a bead, or from its last sample to the next one, where it ends."""
    t = judged.trajectory
    ending = t.deposit[1:] != t.deposit[:-1]
    step = np.linalg.norm(np.diff(judged.motion.tip, axis=0)[ending], axis=1).max(initial=0.0) / t.dt
    most = float(judged.commanded.max()) * (1.0 + SPEED_TOLERANCE)
    return max(float(t.speed[t.deposit].max(initial=0.0)), min(float(step), most))


def _share_check(t: Trajectory, name: str, off: Array, sample: float, limit: float) -> Check:
    """The check that no volume (n) [m^3] is off by more than a share of what one sample lays down."""
    share = off / sample if sample else np.ones(len(t))
    return check_most(t, name, share, limit, "of what one sample lays down")


def _keeps_pace(t: Trajectory, off: Array, sample: float) -> Check:
    """The check that what has flowed is off (n) [m^3] by no more than one sample lays down."""
    return _share_check(t, "material keeps pace", off, sample, 1.0 + SPEED_TOLERANCE)


def _flow_per_millimetre(t: Trajectory, flow: FlowByLength, limit: float) -> Check:
    """The check of what `_per_millimetre` found."""
    ok = flow.worst <= limit
    where = flow.where if ok else _if_coarse(t, flow.where)
    return Check("flow per millimetre", flow.worst, limit, "of what a millimetre holds", ok, where, sample=flow.sample)


def _fed(t: Trajectory, pressed: Array, lag: float, near: NDArray[np.bool_], sample: float) -> Check:
    """Filament is fed as material is laid, ahead by the lag; (n) [m^3] is pressed into the melt beside events.

    Near a bead's ends it may be off by what the lag holds at the flow around.
    """
    # the rate at each sample: the slope of the quartic through what has flowed at it, before, after and half-way
    more = np.pad(t.extruded, 1, mode="edge")
    ahead = lag * (8.0 * t.flow * t.dt - more[2:] + more[:-2]) / (6.0 * t.dt)
    off = np.abs(pressed - t.extruded - ahead)
    around = maximum_filter1d(t.flow, 2 * int(np.ceil(lag / t.dt + ZONE_SAMPLES)) + 1, mode="nearest")
    off = np.where(near, np.maximum(off - lag * around, 0.0), off)
    return _share_check(t, "filament fed", off, sample, FILAMENT_TOLERANCE)


def _as_long_as_its_bead(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Check:
    """From the end of one bead to that of the next as much fibre is fed as the next is long, purges aside."""
    fed = t.feed - _pushed(t.t, [event for event in t.events if event.kind == "purge"])
    primes = {event.bead: event for event in t.events if event.kind == "prime"}
    worst, where, before = 0.0, EVERYWHERE, 0.0
    for i in range(t.first_bead, len(volumes)):
        at, volume = samples[i], volumes[i]
        k = min(int(at[-1]) + 1, len(t) - 1) if len(at) else 0
        after = float(fed[k]) if len(at) else before
        if len(at) and i + 1 in primes:  # which may begin in the very sample in which this bead ends
            after -= float(_pushed(t.t[k : k + 1], [primes[i + 1]])[0])
        off, before = abs(after - before - float(volume.s[-1])) / float(volume.s[-1]), after
        if not off <= worst:
            worst, where = off, f"bead {i}"
    ok = worst <= EXTRUSION_TOLERANCE
    where = where if ok else _if_coarse(t, where)
    return Check("fibre as long as its bead", worst, EXTRUSION_TOLERANCE, "of a bead's length", ok, where)


def _if_coarse(t: Trajectory, where: str) -> str:
    """A place where a check fails, and what may be the reason where samples are far apart."""
    return where if t.dt <= FINE else f"{where}; samples {t.dt * 1e3:g} ms apart may be too coarse to feed it in time"


def _balance(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Check:
    """Material: none outside beads, never backwards, and per bead as much as the bead holds."""
    worst, where = 0.0, EVERYWHERE
    for i in range(t.first_bead, len(volumes)):
        at, volume = samples[i], volumes[i]
        off = abs(float(t.flow[at].sum()) * t.dt - volume.total) / volume.total
        if off > worst:
            worst, where = off, f"bead {i}"
    stray = bool((t.flow[~t.deposit] != 0.0).any() or (t.flow < 0.0).any())
    total = sum(volume.total for volume in volumes[t.first_bead :])
    balanced = abs(float(t.extruded[-1]) - total) <= EXTRUSION_TOLERANCE * total
    if stray:
        where = "material flows outside a bead"
    ok = worst <= EXTRUSION_TOLERANCE and balanced and not stray
    return Check("extrusion balance", worst, EXTRUSION_TOLERANCE, "of a bead's volume", ok, where)


def _behind(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Array:
    """By how much (n) [m^3] what has flowed differs from what the beads hold up to each sample."""
    before = np.cumsum([0.0, *(volume.total for volume in volumes)])
    before -= before[t.first_bead]
    begun = np.maximum.accumulate(np.where(t.deposit, t.bead, t.first_bead - 1))
    expected = before[begun + 1]  # after the bead, or the last one
    for i, at in enumerate(samples):
        expected[at] = np.where(t.deposit[at], before[i] + volumes[i].to(t.s[at]), expected[at])
    late = np.abs(np.cumsum(t.flow) * t.dt - t.extruded)
    return np.asarray(np.maximum(np.abs(t.extruded - expected), late))


def _runs_while_laying(judged: Judged, volumes: Sequence[Volume]) -> Check:
    """A motor that is only on or off runs exactly while a bead is laid, at the rate of the commanded speed."""
    t = judged.trajectory
    rates = np.array([volume.total / volume.s[-1] for volume in volumes]) * judged.commanded
    rate = np.zeros(len(t))
    for at, own in zip(judged.samples, rates, strict=True):
        rate[at] = own
    changes = t.bead[1:] != t.bead[:-1]  # between two samples, at an instant that the samples do not tell
    ends = t.deposit & (np.append(True, changes) | np.append(changes, True))
    off = np.maximum(np.abs(t.flow - rate) - np.where(ends, 0.5 * rate, 0.0), 0.0)
    grown, most = np.diff(t.extruded) / t.dt, np.maximum(rate[1:], rate[:-1])
    least = np.where(changes, 0.0, most)
    off[1:] = np.maximum(off[1:], np.maximum(grown - most, least - grown))
    return check_most(
        t, "motor runs while a bead is laid", off / rates[t.first_bead :].max(), EXTRUSION_TOLERANCE, "of its rate"
    )


def _over_extruded(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Array:
    """Volume (n) [m^3] that flows in each sample beyond what the bead holds there."""
    over = np.zeros(len(t))
    for at, volume in zip(samples, volumes, strict=True):
        if len(at):
            s = t.s[at]
            edges = volume.to(np.concatenate([[0.0], 0.5 * (s[1:] + s[:-1]), volume.s[-1:]]))
            over[at] = t.flow[at] * t.dt - np.diff(edges)
    return over


def _per_millimetre(judged: Judged, volumes: Sequence[Volume], out: Array, ends: float) -> FlowByLength:
    """By what share millimetres of beads get more or less than they hold, where the worst of those is that lie off the
    `ends` [m] of their bead, and how many of all are within the tolerance of a motor that is switched.

    Counted three times: by what leaves a nozzle that lags its motor (out (n) [m^3], beyond lag zones), by the record of
    what has been extruded, and by the flow.
    """
    process, t, worst, where = judged.problem.process, judged.trajectory, 0.0, EVERYWHERE
    sample = -1
    zone = process.extruder.lag + ZONE_SAMPLES * t.dt if process.extruder.lag > 0.0 else 0.0
    even = 0
    seen = 0
    for i, (at, volume) in enumerate(zip(judged.samples, volumes, strict=True)):
        if len(at) < 2:
            continue  # which is another check's to say
        length = float(volume.s[-1])
        stretch = max(MILLIMETRE, RESOLVED * t.dt * float(judged.commanded[i]))
        places = np.linspace(0.0, length, STEPS * max(1, int(length / stretch)) + 1)
        holds = volume.to(places)
        holds = holds[STEPS:] - holds[:-STEPS]
        s = np.concatenate([[0.0], np.maximum.accumulate(t.s[at]), [length]])
        around = np.concatenate([at[:1] - 1, at, at[-1:] + 1]).clip(0, len(t) - 1)
        off = np.interp(places, s, out[around] - volume.to(s))
        share = np.abs(off[STEPS:] - off[:-STEPS]) / holds
        if zone > 0.0:
            when = np.interp(places, s, t.t[around])
            lagging = (when[:-STEPS] < t.t[at[0]] + zone) | (when[STEPS:] > t.t[at[-1]] - zone)
            share = np.where(lagging, 0.0, share)
        off = np.interp(places, s, t.extruded[around] - volume.to(s))
        share = np.maximum(share, np.abs(off[STEPS:] - off[:-STEPS]) / holds)
        edges, doubt = _between(s[1:-1], length)
        off = np.concatenate([[0.0], np.cumsum(t.flow[at]) * t.dt]) - volume.to(edges)
        off, doubt = np.interp(places, edges, off), np.interp(places, edges, doubt) * float(volume.area.max())
        beyond = np.abs(off[STEPS:] - off[:-STEPS]) - doubt[STEPS:] - doubt[:-STEPS]
        share = np.maximum(share, beyond / holds)
        share = np.where(np.isnan(share), np.inf, share)
        even, seen = even + int((share <= process.extruder.flow_tolerance).sum()), seen + len(share)
        share = np.where((places[:-STEPS] < ends) | (places[STEPS:] > length - ends), 0.0, share)
        k = int(np.argmax(share))
        if share[k] > worst:
            worst, where = float(share[k]), f"bead {i}, {places[k] * 1e3:.1f} mm"
            sample = int(at[np.argmin(np.abs(t.s[at] - places[k]))])
    return FlowByLength(worst, where, sample, even / seen if seen else 1.0)


def _between(s: Array, length: float) -> tuple[Array, Array]:
    """Arc lengths (m + 1) half a sample before and after each of (m), and by how much they are in doubt.

    Two parabolas, through one sample more on either side, give their mean and half of what they differ by.
    """
    a = np.pad(s, 1, mode="reflect", reflect_type="odd")
    middle = (9.0 * (a[1:-2] + a[2:-1]) - a[:-3] - a[3:]) / 16.0
    doubt = np.abs(a[3:] - a[:-3] - 3.0 * (a[2:-1] - a[1:-2])) / 16.0
    edges = np.maximum.accumulate(np.concatenate([[0.0], np.clip(middle, 0.0, length), [length]]))
    return edges, np.concatenate([[0.0], doubt, [0.0]])


def _pressed(fed: Array, filament: Array | float) -> Array:
    """Volume (n) [m^3] pressed into the melt by filament (n) [m] of cross-section [m^2], one or (n)."""
    if isinstance(filament, float):
        return filament * fed
    volume: Array = np.cumsum(filament * np.diff(fed, prepend=0.0))
    return volume


def _leaving(pressed: Array, dt: float, lag: float) -> Array:
    """Volume (n) [m^3] that has left the nozzle when (n) has been pressed into the melt: flow lags by first order."""
    if lag <= 0.0:
        return pressed
    keep = np.exp(-dt / lag)
    gain = np.append(0.0, (1.0 - keep) * np.diff(pressed) / dt)
    rate = solve_banded((1, 0), np.array([np.ones(len(gain)), np.full(len(gain), -keep)]), gain, check_finite=False)
    leaving: Array = pressed - lag * rate
    return leaving


def _near_ends(t: Trajectory, lag: float) -> NDArray[np.bool_]:
    """Samples (n) in lag zones: where pressure follows a start or an end of a bead, or runs ahead of it."""
    if lag <= 0.0:
        return np.zeros(len(t), dtype=bool)
    changes = t.t[1:][np.diff(t.bead) != 0]
    zone = lag + ZONE_SAMPLES * t.dt
    return (np.searchsorted(changes, t.t + zone) - np.searchsorted(changes, t.t - zone)) > 0


def _drawn(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Array:
    """Volume (n) [m^3] of fibre laid behind cuts: drawn by what is laid already, not fed by the motor."""
    gain = np.zeros(len(t))
    for event in t.events:
        if event.kind == "cut" and 0 <= event.bead < len(volumes) and len(samples[event.bead]):
            at, volume = samples[event.bead], volumes[event.bead]
            cut = volume.to(np.array([_rested_at(event, t.t[at], t.s[at])]))[0]
            behind = np.append(np.maximum(volume.to(t.s[at]) - cut, 0.0), volume.total - cut)
            gain[np.append(at, at[-1] + 1).clip(max=len(t) - 1)] += np.diff(behind, prepend=0.0)
    total: Array = np.cumsum(gain)
    return total


def _rested_at(event: Event, t: Array, s: Array) -> float:
    """Arc length [m] at which the nozzle rests for an event, among samples at t (k) and s (k) of its bead."""
    first = min(int(np.searchsorted(t, event.start)), len(t) - 1)
    resting = event.start <= t[first] <= event.start + event.duration
    return float(s[first] if resting else np.interp(event.start, t, s))


def _pushed(t: Array, events: Sequence[Event]) -> Array:
    """Filament (n) [m] that events have pushed by the instants t (n); NaN if one of them is no number."""
    if not np.isfinite([(event.start, event.duration, event.amount) for event in events]).all():
        return np.full(len(t), np.nan)
    pushes = sorted((event for event in events if event.amount != 0.0), key=lambda event: event.start)
    done = np.zeros(len(t) + 1)
    during = np.zeros(len(t))
    for event in pushes:
        first, last = np.searchsorted(t, [event.start, event.start + event.duration])
        during[first:last] += event.amount * (t[first:last] - event.start) / event.duration
        done[last] += event.amount
    total: Array = np.cumsum(done[:-1]) + during
    return total


def _own_tool(names: list[str], toolpath: Toolpath, t: Trajectory) -> Check:
    """Whatever is laid, pushed or pulled is fed by the tool of the material that it has to be."""
    own = np.array([names.index(bead.material) if bead.material in names else NONE for bead in toolpath.beads])
    wanted = np.where(t.deposit, own[t.bead], NONE)
    wrong = t.deposit & ((selected(names, t.events, t.t) != wanted) | (wanted == NONE))
    count, where = int(wrong.sum()), place(t, int(np.argmax(wrong))) if wrong.any() else EVERYWHERE
    changes = {event.bead: event.start for event in t.events if event.kind == "change"}
    for event in t.events:
        if event.amount == 0.0:
            continue
        middle = selected(names, t.events, np.array([event.start + 0.5 * event.duration]))[0]
        bead = event.bead if 0 <= event.bead < len(own) else t.first_bead  # what is pushed before all is for that one
        if event.kind == "purge" and bead > t.first_bead and event.start < changes.get(bead, -np.inf):
            bead -= 1  # what a pause purges is of the material before
        if middle == NONE or not names[middle] == event.material == toolpath.beads[bead].material:
            count, where = count + 1, f"{event.kind} of bead {event.bead}" if count == 0 else where
    return Check("material fed by its own tool", float(count), 0.0, "samples and events", count == 0, where)


def _changes(judged: Judged) -> Check:
    """Wherever the material changes, robot and extruder rest at home for it, and the new material is purged."""
    toolpath, t, change = judged.toolpath, judged.trajectory, judged.problem.process.change
    worst, where = 0.0, EVERYWHERE
    purges = [event for event in t.events if event.kind == "purge"]
    for i in range(t.first_bead + 1, len(toolpath.beads)):
        before, after = toolpath.beads[i - 1 : i + 1]
        if before.material == after.material:
            continue
        found = [event for event in t.events if event.kind == "change" and event.bead == i]
        missing = change.time
        if len(found) == 1 and found[0].material == after.material:
            begin = found[0].start
            due = [event for event in purges if event.bead == i and abs(event.start - begin - change.wait) < INSTANT]
            purged = sum(event.amount for event in due if event.material == after.material)
            lacking = abs(found[0].duration - change.wait) + abs(purged - change.purge) / change.purge_speed
            if away_from_home(judged, begin, change.time) <= AT_HOME:
                missing = change.time - rest(t, found[0], change.wait, change.time) + lacking
        if not missing <= worst:
            worst, where = missing, f"before bead {i}"
    limit = SAMPLES * t.dt
    return Check("rest for a change of material", worst, limit, "s missing", worst <= limit + INSTANT, where)


def _as_named(judged: Judged) -> Iterator[Check]:
    """The check that beads are of the material that the layers name; none where they name none, or the tools of a file do.

    Beads of a wing's support and of a mesh's infill are known by their names. Lines around the first layer are of any.
    """
    layers, beads = judged.problem.layers, judged.toolpath.beads
    parts = {mark: getattr(layers, part, None) for part, mark in (("support", "support "), ("infill", " infill "))}
    named = {mark: part.material for mark, part in parts.items() if part is not None and part.material is not None}
    by_tool = isinstance(layers, GcodeLayersSpec) and layers.source.tools is not None
    if by_tool or (layers.material is None and not named):
        return
    own = layers.material or next(iter(judged.problem.process.materials))
    wrong = [
        i
        for i in range(lines_around(judged.problem, judged.toolpath), len(beads))
        if beads[i].material != next((named[mark] for mark in named if mark in beads[i].name), own)
    ]
    where = f"bead {wrong[0]}" if wrong else EVERYWHERE
    yield Check("beads of the material asked for", float(len(wrong)), 0.0, "beads that are not", not wrong, where)


def away_from_home(judged: Judged, start: float, time: float) -> float:
    """How far [rad or m] the arm's joints are from home at most in the `time` from `start` on [s]."""
    t, arm = judged.trajectory, len(judged.cell.arm)
    first, last = np.searchsorted(t.t, start + np.array([INSTANT, time - INSTANT]))
    return float(np.abs(t.q[first:last, :arm] - judged.cell.home[:arm]).max(initial=0.0))


def rest(t: Trajectory, event: Event, wait: float, time: float, laying: bool = False) -> float:
    """How long [s] the robot stands still in the `time` from an event on, within a bead or, usually, in travel; no filament
    moves in the first `wait` of it."""
    first, silent, last = np.searchsorted(t.t, event.start + np.array([-INSTANT, wait + INSTANT, time + INSTANT]))
    still = np.abs(np.diff(t.q[first:last], axis=0)).max(axis=1, initial=0.0) < STILL
    moved = np.abs(np.diff(t.feed[first:last])) > UNMOVED
    moved[max(silent - first - 1, 0) :] = False
    return float((still & ~moved & (t.deposit[first : last - 1] == laying)).sum()) * t.dt if last > first else 0.0
