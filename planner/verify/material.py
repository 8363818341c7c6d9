"""Material: flow against the volume of the beads, filament pushed by the motor, and the tool that lays each bead.

Cross-sections, volumes and lag are derived independently, from the samples (n) and the input alone. Volumes are in m^3,
filament in m of its length.
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

EXTRUSION_TOLERANCE = 1e-3  # × the volume
PER_MILLIMETRE = 5e-3  # × the volume of a millimetre of the bead
SWITCHED_ENDS = 2e-3  # m at both ends of a bead that are not judged where the motor is only switched on and off,
SWITCHED_WIDTHS = 4.0  # or × the bead's width, if that is less: little else would be left of narrow beads
MILLIMETRE = 1e-3  # m: stretch of a bead whose volume is compared
RESOLVED = 4  # least samples in a stretch: fewer do not resolve its volume
STEPS = 4  # stretches begun per length of one: they overlap
FILAMENT_TOLERANCE = 1e-2  # × the volume laid in one sample, for filament
FINE = 5e-3  # s: with samples no farther apart, what the motor does between them matters little
ZONE_SAMPLES = 2  # samples added to the lag: its start is known only to a sample
STILL = 1e-9  # rad: most that a joint moves in a sample where the robot rests
UNMOVED = 1e-12  # m: most that the filament moves in a sample where the extruder rests
AT_HOME = 1e-6  # rad or m: tolerance of resting at home
INSTANT = 1e-9  # s: resolution of the instants of events
SAMPLES = 2  # a rest may seem shorter by this many, as the samples do not show exactly when it begins and ends


@dataclass(frozen=True)
class Volume:
    """Volume of a bead along its length: area (n) [m^2] at s (n) [m], linear between, and its integral (n) [m^3]."""

    s: Array
    area: Array
    integral: Array

    @property
    def total(self) -> float:
        """Volume of the whole bead [m^3]."""
        return float(self.integral[-1])

    def to(self, s: Array) -> Array:
        """Volume (k) [m^3] from the start to s (k) [m]."""
        i = np.clip(np.searchsorted(self.s, s) - 1, 0, len(self.s) - 2)
        far = np.clip(s, 0.0, self.s[-1]) - self.s[i]
        here = np.interp(s, self.s, self.area)
        return self.integral[i] + 0.5 * (self.area[i] + here) * far


@dataclass(frozen=True)
class FlowByLength:
    """Flow by millimetres of beads: the largest relative error of those judged, its place and sample (-1 for none), and
    the share of all millimetres within process.extruder.flow_tolerance."""

    worst: float
    where: str
    sample: int
    even: float


def volume_of(bead: Bead, process: ProcessSpec) -> Volume:
    """The bead's volume, from its dimensions and the section that the problem sets; a strut in space is round."""
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
    """Length [m] at both ends of a bead of some width [m] that is not judged where the motor is only switched."""
    return min(SWITCHED_ENDS, SWITCHED_WIDTHS * width)


def extrusion(judged: Judged) -> Findings:
    """Material flows only while beads are laid, exactly as much as they hold, and the motor pushes that much."""
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
    """Greatest speed [m/s] at which material is laid, in a bead or from its last sample to the next."""
    t = judged.trajectory
    ending = t.deposit[1:] != t.deposit[:-1]
    step = np.linalg.norm(np.diff(judged.motion.tip, axis=0)[ending], axis=1).max(initial=0.0) / t.dt
    most = float(judged.commanded.max()) * (1.0 + SPEED_TOLERANCE)
    return max(float(t.speed[t.deposit].max(initial=0.0)), min(float(step), most))


def _share_check(t: Trajectory, name: str, off: Array, sample: float, limit: float) -> Check:
    """The check that no volume error (n) [m^3] exceeds a share of what one sample lays down."""
    share = off / sample if sample else np.ones(len(t))
    return check_most(t, name, share, limit, "of what one sample lays down")


def _keeps_pace(t: Trajectory, off: Array, sample: float) -> Check:
    """The check that the material that has flowed is off (n) [m^3] by no more than one sample lays down."""
    return _share_check(t, "material keeps pace", off, sample, 1.0 + SPEED_TOLERANCE)


def _flow_per_millimetre(t: Trajectory, flow: FlowByLength, limit: float) -> Check:
    """The check of the result of `_per_millimetre`."""
    ok = flow.worst <= limit
    where = flow.where if ok else _if_coarse(t, flow.where)
    return Check("flow per millimetre", flow.worst, limit, "of what a millimetre holds", ok, where, sample=flow.sample)


def _fed(t: Trajectory, pressed: Array, lag: float, near: NDArray[np.bool_], sample: float) -> Check:
    """Filament is fed as material is laid, ahead by the lag; pressed (n) [m^3]: fed into the melt, events aside.

    Near a bead's ends it may be off by the volume that the lag holds at the flow there.
    """
    # rate at each sample: slope of the quartic through the volumes at it, at its neighbours and half-way to them
    more = np.pad(t.extruded, 1, mode="edge")
    ahead = lag * (8.0 * t.flow * t.dt - more[2:] + more[:-2]) / (6.0 * t.dt)
    off = np.abs(pressed - t.extruded - ahead)
    around = maximum_filter1d(t.flow, 2 * int(np.ceil(lag / t.dt + ZONE_SAMPLES)) + 1, mode="nearest")
    off = np.where(near, np.maximum(off - lag * around, 0.0), off)
    return _share_check(t, "filament fed", off, sample, FILAMENT_TOLERANCE)


def _as_long_as_its_bead(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Check:
    """From the end of one bead to the end of the next, the fibre fed is as long as the next bead, purges aside."""
    fed = t.feed - _pushed(t.t, [event for event in t.events if event.kind == "purge"])
    primes = {event.bead: event for event in t.events if event.kind == "prime"}
    worst, where, before = 0.0, EVERYWHERE, 0.0
    for i in range(t.first_bead, len(volumes)):
        at, volume = samples[i], volumes[i]
        k = min(int(at[-1]) + 1, len(t) - 1) if len(at) else 0
        after = float(fed[k]) if len(at) else before
        if len(at) and i + 1 in primes:  # the next prime may begin in the very sample in which this bead ends
            after -= float(_pushed(t.t[k : k + 1], [primes[i + 1]])[0])
        off, before = abs(after - before - float(volume.s[-1])) / float(volume.s[-1]), after
        if not off <= worst:
            worst, where = off, f"bead {i}"
    ok = worst <= EXTRUSION_TOLERANCE
    where = where if ok else _if_coarse(t, where)
    return Check("fibre as long as its bead", worst, EXTRUSION_TOLERANCE, "of a bead's length", ok, where)


def _if_coarse(t: Trajectory, where: str) -> str:
    """The place where a check fails, with a possible reason if samples are far apart."""
    return where if t.dt <= FINE else f"{where}; samples {t.dt * 1e3:g} ms apart may be too coarse to feed it in time"


def _balance(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Check:
    """Material never flows outside beads or backwards, and each bead gets as much as it holds."""
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
    """Difference (n) [m^3] of the material that has flowed from the volume of the beads up to each sample."""
    before = np.cumsum([0.0, *(volume.total for volume in volumes)])
    before -= before[t.first_bead]
    begun = np.maximum.accumulate(np.where(t.deposit, t.bead, t.first_bead - 1))
    expected = before[begun + 1]  # at the end of the bead, or of the last one
    for i, at in enumerate(samples):
        expected[at] = np.where(t.deposit[at], before[i] + volumes[i].to(t.s[at]), expected[at])
    late = np.abs(np.cumsum(t.flow) * t.dt - t.extruded)
    return np.asarray(np.maximum(np.abs(t.extruded - expected), late))


def _runs_while_laying(judged: Judged, volumes: Sequence[Volume]) -> Check:
    """A motor that is only on or off runs exactly while a bead is laid, at the rate for the commanded speed."""
    t = judged.trajectory
    rates = np.array([volume.total / volume.s[-1] for volume in volumes]) * judged.commanded
    rate = np.zeros(len(t))
    for at, own in zip(judged.samples, rates, strict=True):
        rate[at] = own
    changes = t.bead[1:] != t.bead[:-1]  # between two samples, at an unknown instant
    ends = t.deposit & (np.append(True, changes) | np.append(changes, True))
    off = np.maximum(np.abs(t.flow - rate) - np.where(ends, 0.5 * rate, 0.0), 0.0)
    grown, most = np.diff(t.extruded) / t.dt, np.maximum(rate[1:], rate[:-1])
    least = np.where(changes, 0.0, most)
    off[1:] = np.maximum(off[1:], np.maximum(grown - most, least - grown))
    return check_most(
        t, "motor runs while a bead is laid", off / rates[t.first_bead :].max(), EXTRUSION_TOLERANCE, "of its rate"
    )


def _over_extruded(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Array:
    """Volume (n) [m^3] that flows in each sample in excess of what the bead holds there."""
    over = np.zeros(len(t))
    for at, volume in zip(samples, volumes, strict=True):
        if len(at):
            s = t.s[at]
            edges = volume.to(np.concatenate([[0.0], 0.5 * (s[1:] + s[:-1]), volume.s[-1:]]))
            over[at] = t.flow[at] * t.dt - np.diff(edges)
    return over


def _per_millimetre(judged: Judged, volumes: Sequence[Volume], out: Array, ends: float) -> FlowByLength:
    """Relative error of the flow in millimetres of beads: the worst outside the `ends` [m] of each bead, and the share
    of all that are within the tolerance of a switched motor.

    Measured three ways: by the volume that leaves a nozzle lagging behind its motor (out (n) [m^3], outside lag zones),
    by the record of the extruded volume, and by the flow.
    """
    process, t, worst, where = judged.problem.process, judged.trajectory, 0.0, EVERYWHERE
    sample = -1
    zone = process.extruder.lag + ZONE_SAMPLES * t.dt if process.extruder.lag > 0.0 else 0.0
    even = 0
    seen = 0
    for i, (at, volume) in enumerate(zip(judged.samples, volumes, strict=True)):
        if len(at) < 2:
            continue  # another check reports that
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
    """Arc lengths (m + 1) half a sample before and after each of (m), and their uncertainty.

    Two parabolas, each through one more sample on one side, give the value as their mean and the uncertainty as half of
    their difference.
    """
    a = np.pad(s, 1, mode="reflect", reflect_type="odd")
    middle = (9.0 * (a[1:-2] + a[2:-1]) - a[:-3] - a[3:]) / 16.0
    doubt = np.abs(a[3:] - a[:-3] - 3.0 * (a[2:-1] - a[1:-2])) / 16.0
    edges = np.maximum.accumulate(np.concatenate([[0.0], np.clip(middle, 0.0, length), [length]]))
    return edges, np.concatenate([[0.0], doubt, [0.0]])


def _pressed(fed: Array, filament: Array | float) -> Array:
    """Volume (n) [m^3] pressed into the melt by filament (n) [m] of one cross-section [m^2] or of (n)."""
    if isinstance(filament, float):
        return filament * fed
    volume: Array = np.cumsum(filament * np.diff(fed, prepend=0.0))
    return volume


def _leaving(pressed: Array, dt: float, lag: float) -> Array:
    """Volume (n) [m^3] that has left the nozzle when (n) has been pressed into the melt: a first-order lag."""
    if lag <= 0.0:
        return pressed
    keep = np.exp(-dt / lag)
    gain = np.append(0.0, (1.0 - keep) * np.diff(pressed) / dt)
    rate = solve_banded((1, 0), np.array([np.ones(len(gain)), np.full(len(gain), -keep)]), gain, check_finite=False)
    leaving: Array = pressed - lag * rate
    return leaving


def _near_ends(t: Trajectory, lag: float) -> NDArray[np.bool_]:
    """Whether samples (n) are in lag zones, where pressure follows the start or end of a bead, or runs ahead of it."""
    if lag <= 0.0:
        return np.zeros(len(t), dtype=bool)
    changes = t.t[1:][np.diff(t.bead) != 0]
    zone = lag + ZONE_SAMPLES * t.dt
    return (np.searchsorted(changes, t.t + zone) - np.searchsorted(changes, t.t - zone)) > 0


def _drawn(t: Trajectory, volumes: Sequence[Volume], samples: Sequence[Samples]) -> Array:
    """Volume (n) [m^3] of fibre laid after cuts: drawn out by the fibre already laid, not fed by the motor."""
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
    """Arc length [m] at which the nozzle rests for an event; t (k), s (k) of the samples of its bead."""
    first = min(int(np.searchsorted(t, event.start)), len(t) - 1)
    resting = event.start <= t[first] <= event.start + event.duration
    return float(s[first] if resting else np.interp(event.start, t, s))


def _pushed(t: Array, events: Sequence[Event]) -> Array:
    """Filament (n) [m] that events have pushed by the instants t (n); NaN if an event is not finite."""
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
    """All filament laid, pushed or pulled is fed by the tool of the required material."""
    own = np.array([names.index(bead.material) if bead.material in names else NONE for bead in toolpath.beads])
    wanted = np.where(t.deposit, own[t.bead], NONE)
    wrong = t.deposit & ((selected(names, t.events, t.t) != wanted) | (wanted == NONE))
    count, where = int(wrong.sum()), place(t, int(np.argmax(wrong))) if wrong.any() else EVERYWHERE
    changes = {event.bead: event.start for event in t.events if event.kind == "change"}
    for event in t.events:
        if event.amount == 0.0:
            continue
        middle = selected(names, t.events, np.array([event.start + 0.5 * event.duration]))[0]
        bead = event.bead if 0 <= event.bead < len(own) else t.first_bead  # pushes before any bead are for the first
        if event.kind == "purge" and bead > t.first_bead and event.start < changes.get(bead, -np.inf):
            bead -= 1  # a pause purges the previous material
        if middle == NONE or not names[middle] == event.material == toolpath.beads[bead].material:
            count, where = count + 1, f"{event.kind} of bead {event.bead}" if count == 0 else where
    return Check("material fed by its own tool", float(count), 0.0, "samples and events", count == 0, where)


def _changes(judged: Judged) -> Check:
    """Wherever the material changes, robot and extruder rest at home, and the new material is purged."""
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
    """The check that beads are of the material that the layers name; none if they name none or a file's tools do.

    Beads of a wing's support and of a mesh's infill are recognised by their names. Skirt lines may be of any material.
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
    """Greatest distance [rad or m] of the arm's joints from home during `time` after `start` [s]."""
    t, arm = judged.trajectory, len(judged.cell.arm)
    first, last = np.searchsorted(t.t, start + np.array([INSTANT, time - INSTANT]))
    return float(np.abs(t.q[first:last, :arm] - judged.cell.home[:arm]).max(initial=0.0))


def rest(t: Trajectory, event: Event, wait: float, time: float, laying: bool = False) -> float:
    """How long [s] the robot stands still during `time` after an event's start, in travel or, if `laying`, within a
    bead; during the first `wait` no filament may move either."""
    first, silent, last = np.searchsorted(t.t, event.start + np.array([-INSTANT, wait + INSTANT, time + INSTANT]))
    still = np.abs(np.diff(t.q[first:last], axis=0)).max(axis=1, initial=0.0) < STILL
    moved = np.abs(np.diff(t.feed[first:last])) > UNMOVED
    moved[max(silent - first - 1, 0) :] = False
    return float((still & ~moved & (t.deposit[first : last - 1] == laying)).sum()) * t.dt if last > first else 0.0
