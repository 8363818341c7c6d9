"""extrusion.gcode for RepRapFirmware: the extruder alone, in the time of the robot's motion."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.extruder.orders import orders
from planner.readonly import Indices

if TYPE_CHECKING:
    from planner.plan import Plan, Trajectory

Labels = NDArray[np.int64]

BLOCK_S = 0.02  # shortest command [s]: a board that is fed faster than 50 lines/s may stutter
FLOW_STEP = 0.01  # blocks whose flow is equal to this share of the largest flow become one command
NOTHING = -1  # label of what belongs neither to a bead nor to an event
FIRST_EVENT = -2  # label of the first event; those of later ones count down


def gcode(plan: Plan) -> str:
    """G-code of the extruder: G1 E F while filament moves, G4 P in between; E is relative, mm of filament.

    What else the board is told, `orders` says. The robot waits at home for as long as its problem says.
    """
    t = plan.trajectory
    cuts, label = _chunks(t)
    fed = t.feed * 1e3
    # differences of rounded totals: rounding never adds up, neither in filament nor in time
    amount = np.diff(np.round(fed[cuts] - fed[0], 5))
    clock = t.t[cuts] - t.t[0]
    # a G1 lasts E / F, which a rounded E sets only nearly: what is lost or gained goes into the pauses
    rate = np.round(np.abs(amount) / np.diff(clock) * 60.0, 3)
    lasts = np.where(rate > 0.0, np.abs(amount) / np.where(rate > 0.0, rate, 1.0) * 60.0, 0.0)
    what = [(order.start, order.time, [f"; {order.words}", *order.lines]) for order in orders(plan)]
    last = NOTHING
    for e, f, took, end, who, layer in zip(
        amount.tolist(),
        rate.tolist(),
        lasts.tolist(),
        clock[1:].tolist(),
        label.tolist(),
        t.layer[(cuts[:-1] + cuts[1:] + 1) // 2].tolist(),
        strict=True,
    ):
        if f <= 0.0:
            continue
        said = [f"; {t.events[FIRST_EVENT - who].words}"] if who <= FIRST_EVENT else [f"; bead {who}, layer {layer}"]
        what.append((end - took, took, [*(said if who not in (last, NOTHING) else []), f"G1 E{e:.5f} F{f:.3f}"]))
        last = last if who == NOTHING else who

    name = re.sub(r"[^\x20-\x7e]", "?", plan.name)
    size = f"{len(plan.beads)} beads in {plan.layers} layers"
    total, seconds = fed[-1] - fed[0], t.t[-1] - t.t[0]
    lines = [
        f"; {name}: extrusion in time with the robot, strategy {plan.strategy}",
        f"; {size}, {total:.3f} mm of filament, {seconds:.3f} s from the robot's first motion",
        "M83",
    ]
    now = 0.0
    for start, took, said in sorted(what, key=lambda each: each[0]):
        lines += _pause(start - now)
        now += _pause_length(start - now) + took
        lines += said
    lines += _pause(float(clock[-1]) - now)
    return "\n".join(lines) + "\n"


def _pause_length(seconds: float) -> float:
    """Whole milliseconds, which is what G4 P takes; below one there is no pause."""
    return max(0, round(seconds * 1e3)) * 1e-3


def _pause(seconds: float) -> list[str]:
    ms = round(_pause_length(seconds) * 1e3)
    return [f"G4 P{ms}"] if ms else []


def _chunks(t: Trajectory) -> tuple[Indices, Labels]:
    """Samples (m + 1) between which filament moves at a constant rate, and what each chunk (m) belongs to.

    That is the index of a bead, FIRST_EVENT less the index of an event, or NOTHING.
    """
    moved = np.diff(t.feed)
    # a bead's first or last part sample belongs to the bead beside it
    label = np.where(np.diff(t.extruded) > 0.0, np.maximum(t.bead[:-1], t.bead[1:]), NOTHING)
    for k, event in enumerate(t.events):
        if event.amount != 0.0:  # which moves more filament than the part of a bead in the same sample
            since = int(np.searchsorted(t.t, event.start, side="right")) - 1
            label[since : np.searchsorted(t.t, event.start + event.duration)] = FIRST_EVENT - k
    edge = np.flatnonzero(np.diff(label)) + 1
    starts = np.concatenate([[0], edge])
    ends = np.concatenate([edge, [len(moved)]])
    block = max(1, round(BLOCK_S / t.dt))
    # blocks count from each run's own start, so that no block spans two runs; an event is one block
    first = np.repeat(starts, ends - starts)
    at = np.arange(len(moved))
    heads = np.flatnonzero((at == first) | (((at - first) % block == 0) & (label > FIRST_EVENT)))
    mean = np.add.reduceat(moved, heads) / np.diff(np.append(heads, len(moved)))
    level = np.round(mean / max(float(np.abs(mean[label[heads] >= 0]).max(initial=0.0)), 1e-300) / FLOW_STEP)
    changes = np.concatenate([[True], (np.diff(level) != 0) | (np.diff(label[heads]) != 0)])
    cuts = heads[changes]
    return np.append(cuts, len(moved)), label[cuts]
