"""The Plan: everything that is known at the end, as one frozen value. Export and report see only this."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.cell import Cell
from planner.problem import Problem
from planner.readonly import ReadOnlyArrays
from planner.toolpath.bead import Toolpath

Array = NDArray[np.float64]
TRAVEL = -1
RAPID_EXTERNAL_AXES = 6


@dataclass(frozen=True)
class Event:
    """Something that the extruder or its heating does: "heat", "purge", "prime", "retract", "cut", …

    bead its index, or -1; start, duration [s]; amount of filament [m], signed, 0 if none
    """

    kind: str
    bead: int
    start: float
    duration: float
    amount: float


@dataclass(frozen=True)
class Trajectory(ReadOnlyArrays):
    """The whole motion, sampled every `dt` seconds (n samples; SI units, radians).

    bead          (n,) int32  index of the bead, or TRAVEL (-1); run-in and run-out count as travel
    layer         (n,) int32
    deposit       (n,) bool   material flows
    s             (n,)        arc length along the bead [m]; 0 in travel
    q             (n, nj)     joints in the cell's order: arm, then the positioner's free axes
    tip           (n, 3)      nozzle tip in the part frame [m]
    quat          (n, 4)      orientation of the nozzle frame in the part frame, x y z w; its z is the axis
    axis          (n, 3)      unit nozzle axis, from the nozzle into the part, part frame
    branch        (n,) int8   ABB's cfx: 4 wrist centre behind axis 1, 2 behind the lower arm, 1 axis 5 negative;
                              without a spherical wrist the number that the inverse kinematics gives the branch
    speed         (n,)        of the tip relative to the part [m/s]
    flow          (n,)        of material [m^3/s]
    extruded      (n,)        volume deposited since the start [m^3]
    """

    dt: float
    t: Array
    bead: NDArray[np.int32]
    layer: NDArray[np.int32]
    deposit: NDArray[np.bool_]
    s: Array
    q: Array
    tip: Array
    quat: Array
    axis: Array
    branch: NDArray[np.int8]
    speed: Array
    flow: Array
    extruded: Array

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True)
class Check:
    """One named check of the verifier: the worst value found, its limit, and where it stands."""

    name: str
    worst: float
    limit: float
    unit: str
    ok: bool
    where: str


@dataclass(frozen=True)
class Plan:
    """A finished plan. `verified` is true only if every check holds.

    metrics:  name → value, in the units that the name says (see the output contract in the docs)
    series:   per-sample arrays (n,) or (n, nj) that the verifier found on the way, for the report:
              sigma, wrist_deg (not of seven axes), limit_margin_deg, velocity_ratio, acceleration_ratio, jerk_ratio
    timing_s: seconds by stage
    baseline: strategy name → its metrics, for the summary beside the chosen strategy
    """

    problem: Problem
    cell: Cell
    toolpath: Toolpath
    strategy: str
    trajectory: Trajectory
    checks: tuple[Check, ...]
    metrics: dict[str, float]
    series: dict[str, Array]
    timing_s: dict[str, float]
    versions: dict[str, str]
    baseline: dict[str, dict[str, float]]
    settings: dict[str, Any]

    @property
    def verified(self) -> bool:
        """True if every check of the verifier holds."""
        return all(check.ok for check in self.checks)

    @property
    def no_rapid(self) -> str | None:
        """Why no RAPID program can say this plan; None if one can."""
        arm, holder = self.cell.arm_robot, self.cell.holder_robot
        if not self.cell.spherical or not arm.name.startswith("ABB "):
            return f"{arm.name} is not programmed in RAPID"
        if holder is not None and len(holder.joint_names) > RAPID_EXTERNAL_AXES:
            return f"{holder.name} has more axes than RAPID's {RAPID_EXTERNAL_AXES} external ones"
        return None
