"""A plan as two JSON files: the message trajectory_msgs/JointTrajectory, and when extruders go on and off.

The message holds the whole print in one, since it may stop nowhere within a bead and travel between beads is timed as
well. Its times count from the robot's first motion, as those of the extruder's G-code do.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from planner.export.joint_trajectory.knots import plan_knots
from planner.export.joint_trajectory.switches import planned_switches

if TYPE_CHECKING:
    from planner.plan import Plan

# decimals of rad, rad/s and rad/s^2: at 1 m a ten-millionth of a radian is 0.1 micrometres
DECIMALS = {"positions": 7, "velocities": 6, "accelerations": 5}
NANO = 1_000_000_000


def trajectory_name(plan: Plan) -> str:
    """File of the message."""
    return f"{plan.name}_joint_trajectory.json"


def switches_name(plan: Plan) -> str:
    """File of the extruders' switching."""
    return f"{plan.name}_extruder.json"


def joint_trajectory(plan: Plan) -> str:
    """JSON of the message, a line for each point. ValueError if the plan is not verified: the caller's mistake."""
    if not plan.verified:
        raise ValueError("robot code is written for verified plans only")
    knots = plan_knots(plan)
    columns = zip(
        np.round(knots.q, DECIMALS["positions"]).tolist(),
        np.round(knots.velocity, DECIMALS["velocities"]).tolist(),
        np.round(knots.acceleration, DECIMALS["accelerations"]).tolist(),
        knots.time.tolist(),
        strict=True,
    )
    points = [
        _line(
            {
                "positions": _unsigned_noughts(q),
                "velocities": _unsigned_noughts(v),
                "accelerations": _unsigned_noughts(a),
                "effort": [],
                "time_from_start": _duration(t),
            }
        )
        for q, v, a, t in columns
    ]
    # a stamp of nought: start at once, as soon as the message comes
    head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    names = list(plan.cell.joint_names)
    return f'{{"header":{_line(head)},\n"joint_names":{_line(names)},\n"points":[\n' + ",\n".join(points) + "\n]}\n"


def switches(plan: Plan) -> str:
    """JSON of the times at which the output of each bead's extruder goes on and off, and of the axes that are held."""
    lines = [
        _line({"time_from_start": _duration(each.time), "output": each.output, "value": each.value, "bead": each.bead})
        for each in planned_switches(plan)
    ]
    return f'{{"held":{_line(plan.cell.held)},\n"events":[\n' + ",\n".join(lines) + "\n]}\n"


def _line(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _unsigned_noughts(values: list[float]) -> list[float]:
    return [value + 0.0 for value in values]


def _duration(seconds: float) -> dict[str, int]:
    """builtin_interfaces/Duration."""
    sec, nanosec = divmod(round(seconds * NANO), NANO)
    return {"sec": sec, "nanosec": nanosec}
