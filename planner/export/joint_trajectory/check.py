"""Whether a joint trajectory that was read back moves as its plan does, between its points as well."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.export.joint_trajectory.knots import Nozzle, at_times, derived
from planner.export.joint_trajectory.reader import JointTrajectory, read_joint_trajectory, read_switches
from planner.export.joint_trajectory.switches import Switch, planned_switches
from planner.export.joint_trajectory.writer import switches_name, trajectory_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from planner.plan import Plan

BLOCK = 20_000  # samples compared at once: bounds the memory
ON_TIME = 1e-6  # s
# What the splines may differ by: what thinning allows (`knots`), and rounding.
OFF = 0.01e-3  # m, beyond the chord tolerance, where material is laid
OFF_IN_TRAVEL = 0.3e-3  # m
TURNED = np.radians(0.06)  # nozzle and joints
VELOCITY_SHARE = 0.01  # of a joint's limit
ACCELERATION_SHARE = 0.06


def trajectory_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """What the two files say otherwise than the plan, beyond rounding and thinning, in words."""
    found, held = read_switches(files[switches_name(plan)])
    return [
        *_motion(plan, read_joint_trajectory(files[trajectory_name(plan)])),
        *_switching(plan, found, held),
    ]


def _motion(plan: Plan, read: JointTrajectory) -> list[str]:
    if read.joint_names != plan.cell.joint_names:
        return [f"joints are {', '.join(read.joint_names)} and not {', '.join(plan.cell.joint_names)}"]
    dense, knots = derived(plan), read.knots
    if abs(knots.time[0]) > ON_TIME or abs(knots.time[-1] - dense.time[-1]) > ON_TIME:
        return [f"it takes from {knots.time[0]:.6f} to {knots.time[-1]:.6f} s, not from 0 to {dense.time[-1]:.6f} s"]
    limits, nozzle, worst = plan.cell.limits, Nozzle(plan), np.zeros(6)
    for start in range(0, len(dense), BLOCK):
        k = np.arange(start, min(start + BLOCK, len(dense)))
        q, velocity, acceleration = at_times(knots, dense.time[k])
        off, turned = nozzle.misses(q, k)
        laid = plan.trajectory.deposit[k]
        worst = np.maximum(
            worst,
            [
                off[laid].max(initial=0.0),
                off[~laid].max(initial=0.0),
                turned.max(),
                np.abs(q - dense.q[k]).max(),
                (np.abs(velocity - dense.velocity[k]) / limits.velocity).max(),
                (np.abs(acceleration - dense.acceleration[k]) / limits.acceleration).max(),
            ],
        )
    allowed = {
        "path differs by {:.3g} m": plan.problem.program.chord + OFF,
        "travel differs by {:.3g} m": OFF_IN_TRAVEL,
        "angle of the nozzle differs by {:.3g} rad": TURNED,
        "a joint differs by {:.3g} rad": TURNED,
        "a joint's velocity differs by {:.3g} of its limit": VELOCITY_SHARE,
        "a joint's acceleration differs by {:.3g} of its limit": ACCELERATION_SHARE,
    }
    return [
        words.format(value) + f" (limit {limit:.3g})"
        for (words, limit), value in zip(allowed.items(), worst.tolist(), strict=True)
        if not value <= limit
    ]


def _switching(plan: Plan, found: tuple[Switch, ...], held: Mapping[str, float]) -> list[str]:
    planned, complaints = planned_switches(plan), []
    if len(found) != len(planned):
        complaints.append(f"outputs are switched {len(found)} times, not {len(planned)} times")
    for one, other in zip(found, planned, strict=False):
        if (one.output, one.value, one.bead) != (other.output, other.value, other.bead):
            complaints.append(f"output {other.output} of bead {other.bead} is not switched as planned")
        elif abs(one.time - other.time) > ON_TIME:
            complaints.append(f"output {other.output} of bead {other.bead} is switched at {one.time:.6f} s")
    if dict(held) != plan.cell.held:
        complaints.append("other axes are held, or at other angles")
    return complaints
