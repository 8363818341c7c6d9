"""G-code for a machine that moves nozzle and filament itself: every line all axes at once, in the time of the plan."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.about import resumed, verified
from planner.export.axes.able import STATION
from planner.export.axes.flavours import FLAVOURS, Flavour, feed_length
from planner.export.axes.follow import Followed, follow, spec_of
from planner.export.axes.machine import FiveAxes
from planner.export.axes.targets import kept
from planner.export.extruder.orders import Order, orders
from planner.export.rests import ON_TIME
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem.machine import MachineSpec


DECIMALS = 4  # of mm and of degrees: 0.1 um, and as little at a metre's distance
FILAMENT_DECIMALS = 5  # mm
LEAST_PAUSE = 1e-3  # s
SHORTEST = 1e-5  # s of a move: near a direction that leaves an axis free it may turn as far as it can in no time
FAST = 60.0  # s per minute


def file_name(plan: Plan) -> str:
    """Name of the file."""
    return f"{plan.name}.{FLAVOURS[spec_of(plan).flavour].suffix}"


def axes_gcode(plan: Plan) -> str:
    """The whole print for the machine of `program.machine`; InputError where it cannot make the motion."""
    spec = spec_of(plan)
    flavour = FLAVOURS[spec.flavour]
    motion = follow(plan)
    said = orders(plan)
    at = kept(plan, motion, np.array([order.start for order in said]))
    lines = [*_header(plan, motion, len(at)), *_begin(plan, spec, flavour, motion)]
    lines += _lines(plan, spec, flavour, motion, at, list(said))
    lines += ["G94"] if spec.feed == "inverse_time" else []
    lines += [spec.tcp_off] if spec.tcp else []
    return "\n".join([*lines, *flavour.end]) + "\n"


def letters_of(plan: Plan, motion: Followed) -> tuple[str, ...]:
    """Letters of all axes but the filament's, in the order in which they are written."""
    return ("X", "Y", "Z", *motion.machine.letters, *STATION[: motion.station.shape[1]])


def _header(plan: Plan, motion: Followed, targets: int) -> list[str]:
    spec, cell = spec_of(plan), plan.cell
    size = f"{len(plan.beads)} beads in {plan.layers} layers"
    said = [
        f"{plan.name} for {spec.flavour}, {spec.type}, strategy {plan.strategy}",
        ", ".join(f"{name} {version}" for name, version in sorted(plan.versions.items())),
        f"{size}, {targets} targets, {plan.trajectory.t[-1] - plan.trajectory.t[0]:.3f} s",
        *resumed(plan),
        "Verified for the robot before it was written:",
        *verified(plan),
    ]
    if isinstance(motion.machine, FiveAxes):
        reach = [
            f"{letter} {_number(np.degrees(low), 1)} to {_number(np.degrees(high), 1)} deg"
            for letter, low, high in zip(
                motion.machine.letters, motion.angles.min(axis=0), motion.angles.max(axis=0), strict=True
            )
        ]
        low, high = motion.straight.min(axis=0) * 1e3, motion.straight.max(axis=0) * 1e3
        reach += [f"{letter} {a:.1f} to {b:.1f}" for letter, a, b in zip("XYZ", low, high, strict=True)]
        what = "the tip in the part as it lies at zero angles" if spec.tcp else "on the machine"
        said += [f"X Y Z are {what}. How far it goes:", f"  {', '.join(reach)}", _fastest(motion)]
        said += ["The robot's clearances hold for its own head and ways: look at those of this machine."]
    else:
        home = ", ".join(f"{v:.4f}" for v in np.degrees(plan.trajectory.q[0]))
        said += [f"Joints at the start, from which the controller's iteration follows: {home} deg"]
        frame = "on the turning part" if cell.holder_robot is not None else "in the part frame"
        said += [f"X Y Z A B C are the nozzle's pose {frame}: A, B, C are roll, pitch and yaw, yaw last"]
    return [f"; {re.sub(r'[^ -~]', '?', text)[:150].rstrip()}" for text in said]


def _fastest(motion: Followed) -> str:
    """How fast the axes would have to turn for the planned times to hold."""
    lasts = np.maximum(np.diff(motion.t), SHORTEST)
    rates = np.degrees((np.abs(np.diff(motion.angles, axis=0)) / lasts[:, None]).max(axis=0, initial=0.0))
    names = (f"{letter} up to {rate:.0f} deg/s" for letter, rate in zip(motion.machine.letters, rates, strict=True))
    return f"To keep the planned times: {', '.join(names)}; where it turns more slowly all of it slows down."


def _begin(plan: Plan, spec: MachineSpec, flavour: Flavour, motion: Followed) -> list[str]:
    """Modes, and the way to the first target: up, across, and down where the axes turn otherwise than the robot."""
    lines = list(flavour.begin)
    if spec.flavour == "linuxcnc":
        lines.append(f"G64 P{plan.problem.program.chord * 1e3:.4f}")
        lines.append(f"G92 {spec.filament}0")
    lines += [spec.tcp_on] if spec.tcp else []
    first = dict(zip(letters_of(plan, motion), _rows(motion, np.array([0]))[0].tolist(), strict=True))
    if isinstance(motion.machine, FiveAxes):
        high = (float(motion.straight[:, 2].max()) + plan.problem.process.lift) * 1e3
        across = " ".join(f"{name}{_number(value, DECIMALS)}" for name, value in first.items() if name != "Z")
        lines += [f"G0 Z{_number(high, DECIMALS)}", f"G0 {across}", f"G0 Z{_number(first['Z'], DECIMALS)}"]
    else:
        lines.append("G0 " + " ".join(f"{name}{_number(value, DECIMALS)}" for name, value in first.items()))
    return [*lines, "G93" if spec.feed == "inverse_time" else "G94"]


def _rows(motion: Followed, at: NDArray[np.intp]) -> Array:
    """All axes but the filament's at samples, rounded as written [mm, deg]."""
    turning = np.degrees(np.column_stack([motion.angles[at], motion.station[at]]))
    return np.round(np.column_stack([motion.straight[at] * 1e3, turning]), DECIMALS) + 0.0


def _lines(
    plan: Plan, spec: MachineSpec, flavour: Flavour, motion: Followed, at: NDArray[np.intp], waiting: list[Order]
) -> list[str]:
    """Moves and pauses to all targets, and what else is said between them."""
    names, rows = letters_of(plan, motion), _rows(motion, at)
    fed = np.round(motion.feed[at] * 1e3, FILAMENT_DECIMALS)
    bead, layer, laid = (values[motion.sample] for values in (plan.trajectory.bead, plan.trajectory.layer, motion.laid))
    lines: list[str] = []
    now, last = 0.0, -1
    ends = motion.t[at].tolist()
    for i in range(1, len(at)):
        while waiting and waiting[0].start - ON_TIME <= ends[i - 1]:
            said, took = _order(flavour, waiting.pop(0))
            lines += said
            now += took
        a, b = rows[i - 1], rows[i]
        own = int(bead[at[i]])
        if laid[at[i]] and own != last:
            lines.append(f"; bead {own}, layer {layer[at[i]]}")
            last = own
        filament = float(fed[i] - fed[i - 1])
        words = [f"{name}{_number(v, DECIMALS)}" for name, u, v in zip(names, a, b, strict=True) if u != v]
        if filament:
            told = filament if flavour.relative else float(fed[i])
            words.append(f"{spec.filament}{_number(told, FILAMENT_DECIMALS)}")
        lasts = ends[i] - now
        if not words:
            pause = round(lasts / LEAST_PAUSE) * LEAST_PAUSE
            if pause > 0.0:
                lines.append(flavour.pause.format(pause / flavour.unit))
                now += pause
            continue
        lasts = max(lasts, SHORTEST)
        moved = dict(zip(names, (b - a).tolist(), strict=True)) | {spec.filament: filament}
        length = feed_length(spec.flavour, moved)
        rate = round(FAST / lasts if spec.feed == "inverse_time" else FAST * length / lasts, 4)
        rate = max(rate, 1e-4)
        lines.append(f"G1 {' '.join(words)} F{rate:.4f}")
        now += FAST / rate if spec.feed == "inverse_time" else FAST * length / rate
    for order in waiting:
        lines += _order(flavour, order)[0]
    return lines


def _order(flavour: Flavour, order: Order) -> tuple[list[str], float]:
    """What an order is to this controller, and how long its pauses take [s]; ValueError where it cannot be said."""
    lines = [f"; {order.words}"]
    for line in order.lines:
        if line.startswith(";"):
            continue
        if line.startswith("G4 P"):
            lines.append(flavour.pause.format(int(line[len("G4 P") :]) * 1e-3 / flavour.unit))
            continue
        said = flavour.order(line)
        if said is None:
            raise ValueError(f"{line} cannot be said to this controller")
        lines.append(said)
    return lines, order.time


def _number(value: float, decimals: int) -> str:
    """Fixed-point number without minus nought."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text
