"""extrusion.gcode for RepRapFirmware: the extruder alone, in the time of the robot's motion."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.table import filament_area

if TYPE_CHECKING:
    from planner.plan import Plan

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

BLOCK_S = 0.02  # shortest command [s]: a board that is fed faster than 50 lines/s may stutter
FLOW_STEP = 0.01  # blocks whose flow is equal to this share of the largest flow become one command


def gcode(plan: Plan) -> str:
    """G-code of the extruder: G1 E F while a bead is laid, G4 P in between; E is relative, mm of filament."""
    t = plan.trajectory
    cuts, bead = _chunks(plan)
    fed = t.extruded / filament_area(plan) * 1e3
    # differences of rounded totals: rounding never adds up, neither in filament nor in time
    amount = np.diff(np.round(fed[cuts] - fed[0], 5))
    clock = t.t[cuts] - t.t[0]
    # a G1 lasts E / F, which a rounded E sets only nearly: what is lost or gained goes into the pauses
    rate = np.round(amount / np.diff(clock) * 60.0, 3)
    lasts = np.where(amount > 0.0, amount / np.where(amount > 0.0, rate, 1.0) * 60.0, 0.0)

    name = re.sub(r"[^\x20-\x7e]", "?", plan.problem.name)
    size = f"{len(plan.toolpath.beads)} beads in {plan.toolpath.layers} layers"
    total, seconds = fed[-1] - fed[0], t.t[-1] - t.t[0]
    lines = [
        f"; {name}: extrusion in time with the robot, strategy {plan.strategy}",
        f"; {size}, {total:.3f} mm of filament, {seconds:.3f} s from the robot's first motion",
        "M83",
    ]
    now, waited_until, last_bead = 0.0, 0.0, -1
    for e, f, took, end, b, layer in zip(
        amount.tolist(),
        rate.tolist(),
        lasts.tolist(),
        clock[1:].tolist(),
        bead.tolist(),
        t.layer[(cuts[:-1] + cuts[1:] + 1) // 2].tolist(),
        strict=True,
    ):
        waited_until = end
        if e <= 0.0:
            continue
        lines += _pause(end - took - now)
        now += _pause_length(end - took - now) + took
        if b != last_bead:
            lines.append(f"; bead {b}, layer {layer}")
            last_bead = b
        lines.append(f"G1 E{e:.5f} F{f:.3f}")
    lines += _pause(waited_until - now)
    return "\n".join(lines) + "\n"


def _pause_length(seconds: float) -> float:
    """Whole milliseconds, which is what G4 P takes; below one there is no pause."""
    return max(0, round(seconds * 1e3)) * 1e-3


def _pause(seconds: float) -> list[str]:
    ms = round(_pause_length(seconds) * 1e3)
    return [f"G4 P{ms}"] if ms else []


def _chunks(plan: Plan) -> tuple[Indices, NDArray[np.int32]]:
    """Samples (m + 1) between which the flow counts as constant, and the bead (m) of each chunk (-1: none)."""
    t = plan.trajectory
    volume = np.diff(t.extruded)
    # a bead's first or last part sample belongs to the bead beside it
    bead = np.where(volume > 0.0, np.maximum(t.bead[:-1], t.bead[1:]), -1)
    edge = np.flatnonzero(np.diff(bead)) + 1
    starts = np.concatenate([[0], edge])
    ends = np.concatenate([edge, [len(volume)]])
    block = max(1, round(BLOCK_S / t.dt))
    # blocks count from each run's own start, so that no block spans two runs
    first = np.repeat(starts, ends - starts)
    at = np.arange(len(volume))
    heads = np.flatnonzero((at - first) % block == 0)
    mean = np.add.reduceat(volume, heads) / np.diff(np.append(heads, len(volume)))
    level = np.round(mean / max(float(mean.max()), 1e-300) / FLOW_STEP)
    changes = np.concatenate([[True], (np.diff(level) != 0) | (np.diff(bead[heads]) != 0)])
    cuts = heads[changes]
    return np.append(cuts, len(volume)), bead[cuts]
