"""A multi-axis program that was read back: does it move nozzle and filament as the plan does, and in its time?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.axes.able import STATION
from planner.export.axes.flavours import FLAVOURS
from planner.export.axes.follow import above, spec_of
from planner.export.axes.machine import FiveAxes, Machine, Robot, machine_of
from planner.export.axes.reader import AxesProgram, read_axes
from planner.export.extruder.orders import orders
from planner.export.moves import nearest_fraction
from planner.export.rotations import continuous
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


PATH = 0.05e-3  # m
LEAN = np.radians(0.1)
ROUNDED = 1e-6  # m
STANDS = 1e-6  # m; a shorter line is rounding, and does not tell where on it the tip is
LATE = 15e-3  # s by which the tip is early or late on a bead
FILAMENT = 0.02e-3  # m too much or too little where a bead begins or ends
SPOKEN = 3e-3  # s, and a sample: by which the rest is said behind or before its time
DURATION = 3e-3  # s


def axes_complaints(plan: Plan, text: str) -> list[str]:
    """Every difference between a program and its plan beyond rounding and thinning, in words."""
    spec = spec_of(plan)
    machine = machine_of(spec)
    t = plan.trajectory
    station = t.q[:, len(plan.cell.arm) :] if isinstance(machine, Robot) else np.empty((len(t), 0))
    program = read_axes(text, spec, ("X", "Y", "Z", *machine.letters, *STATION[: station.shape[1]]))
    tip, quat = t.tip.copy(), continuous(t.quat)
    if not isinstance(machine, Robot):
        first, last = above(plan)
        tip[:first], quat[:first], tip[last:], quat[last:] = tip[first], quat[first], tip[last], quat[last]
    found = _moved(machine, program, tip, quat, station, t.t - t.t[0], t.deposit)
    found += _beyond(machine, program)
    found += _fed(plan, program)
    found += _told(plan, program)
    if not abs(program.time[-1] - (t.t[-1] - t.t[0])) <= DURATION:
        found.append(f"it lasts {program.time[-1]:.3f} s")
    return found


def _moved(
    machine: Machine,
    program: AxesProgram,
    tip: Array,
    quat: Array,
    station: Array,
    clock: Array,
    laid: NDArray[np.bool_],
) -> list[str]:
    """Where the program's lines leave the path, its directions, its times or the part's axes."""
    k = len(machine.letters)
    places = machine.tip(program.straight, program.turning[:, :k])
    best = np.full(len(tip), np.inf)
    lean, late, shifted = np.full(len(tip), np.inf), np.full(len(tip), np.inf), np.zeros(len(tip))
    own = np.searchsorted(program.time, clock) - 1
    for by in (-1, 0, 1):  # a sample beside a target may belong to the line before or after it
        a = np.clip(own + by, 0, len(places) - 2)
        lasts = program.time[a + 1] - program.time[a]
        share = np.clip((clock - program.time[a]) / np.where(lasts > 0.0, lasts, 1.0), 0.0, 1.0)
        u = nearest_fraction(places[a], places[a + 1], tip, share)
        u = np.where(np.linalg.norm(places[a + 1] - places[a], axis=1) < STANDS, share, u)
        turning = program.turning[a] + u[:, None] * (program.turning[a + 1] - program.turning[a])
        straight = program.straight[a] + u[:, None] * (program.straight[a + 1] - program.straight[a])
        off = np.linalg.norm(machine.tip(straight, turning[:, :k]) - tip, axis=1)
        nearer = off < best - 1e-9
        best = np.where(nearer, off, best)
        lean = np.where(nearer, machine.leaning(turning[:, :k], quat), lean)
        late = np.where(off <= PATH, np.minimum(late, np.abs(program.time[a] + u * lasts - clock)), late)
        off_station = np.abs(turning[:, k:] - station).max(axis=1, initial=0.0)
        shifted = np.where(nearer, off_station, shifted)
    at = np.clip(np.searchsorted(clock, program.time), 1, len(clock) - 1)
    astray = np.full(len(places), np.inf)
    for by in (-1, 0, 1):
        b = np.clip(at + by, 1, len(clock) - 1)
        u = nearest_fraction(tip[b - 1], tip[b], places, np.zeros(len(places)))
        astray = np.minimum(astray, np.linalg.norm(tip[b - 1] + u[:, None] * (tip[b] - tip[b - 1]) - places, axis=1))
    worst = {
        "the tip is {:.3g} m off its path": (float(best.max()), PATH),
        "a target is {:.3g} m off the path": (float(astray.max()), PATH),
        "the nozzle leans {:.3g} rad from its direction": (float(lean.max()), LEAN),
        "what moves the part is {:.3g} rad off": (float(shifted.max()), LEAN),
        "the tip is {:.3g} s off its time": (float(late[laid].max(initial=0.0)), LATE),
    }
    return [words.format(value) for words, (value, limit) in worst.items() if not value <= limit]


def _beyond(machine: Machine, program: AxesProgram) -> list[str]:
    """Axes that turn beyond their range, or go beyond their limits."""
    found = []
    for letter, within, turning in zip(machine.letters, machine.ranges, program.turning.T, strict=False):
        if within is not None and not (within[0] - 1e-6 <= turning.min() and turning.max() <= within[1] + 1e-6):
            found.append(f"{letter} turns beyond its range")
    if isinstance(machine, FiveAxes):
        slides = machine.slides(machine.tip(program.straight, program.turning), program.turning)
        inside = (slides >= machine.least - ROUNDED) & (slides <= machine.greatest + ROUNDED)
        for name, ok in zip("XYZ", inside.T, strict=True):
            found += [] if ok.all() else [f"{name} goes beyond its limits"]
    return found


def _fed(plan: Plan, program: AxesProgram) -> list[str]:
    """Filament at both ends of every bead, and in all."""
    t = plan.trajectory
    edge = np.flatnonzero(np.diff(t.deposit.astype(np.int8), prepend=0, append=0))
    ends = np.unique(np.concatenate([np.clip(edge, 0, len(t) - 1), np.clip(edge - 1, 0, len(t) - 1), [len(t) - 1]]))
    fed = np.interp(t.t[ends] - t.t[0], program.time, program.filament)
    off = np.abs(fed - (t.feed[ends] - t.feed[0]))
    # a bead of another tool ends where the next one begins; what a millisecond pushes is rounding
    most = FILAMENT + SPOKEN * float(np.abs(np.diff(t.feed)).max(initial=0.0)) / t.dt
    worst = int(np.argmax(off))
    if off[worst] <= most:
        return []
    return [f"{off[worst] * 1e3:.3g} mm of filament too much or too little by {t.t[ends[worst]] - t.t[0]:.3f} s"]


def _told(plan: Plan, program: AxesProgram) -> list[str]:
    """What else is said, and when."""
    flavour = FLAVOURS[spec_of(plan).flavour]
    planned = [(due, flavour.order(line)) for order in orders(plan) for due, line in order.due]
    if [line for _, line in planned] != [line for _, line in program.told]:
        return ["other things are said of heat, tools, fan and cutter than the plan's, or in another order"]
    late = [(abs(at - due), line) for (at, line), (due, _) in zip(program.told, planned, strict=True)]
    worst, line = max(late, default=(0.0, ""))
    return [] if worst <= SPOKEN + plan.trajectory.dt else [f"{line} is said {worst:.3g} s off its time"]
