"""The joints of a plan over time, read from its folder: what EGM sends, at its own rate."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from planner.errors import InputError
from planner.readonly import Array

PERIOD = 0.004  # s, of EGM
ARM_AXES = 6
MOST_EXTERNAL = 6
LARGEST_PLAN, LARGEST_TABLE = 256 << 20, 2 << 30  # bytes
LONGEST_STEP = 0.02  # s between samples of a plan
UNEVEN = 1e-6  # s by which steps of a table may differ, which is its rounding


@dataclass(frozen=True)
class JointPlan:
    """Joints at EGM's rate (n samples): six of the arm, then all axes of the station in its own order.

    q (n, m) [rad]; velocity, acceleration (m) limits [rad/s, rad/s²], 0 for an axis that is held
    """

    q: Array
    velocity: Array
    acceleration: Array


def read_plan(folder: Path) -> JointPlan:
    """The joints of the results in a folder. Raises InputError where they are missing, damaged, or of no such arm."""
    path = folder / "plan.json"
    data = _json(path)
    try:
        if data["verified"] is not True:
            raise InputError("the plan is not verified", file=path)
        joints = data["cell"]["joints"]
        names = [str(joint["name"]) for joint in joints]
        arm = [str(joint["name"]) for joint in joints if joint["moves"] == "nozzle"]
        limits = {str(joint["name"]): (float(joint["v_max"]), float(joint["a_max"])) for joint in joints}
        holder = [(str(axis["name"]), axis["held_at"]) for axis in data["cell"]["holder_axes"]]
        held = {name: float(angle) for name, angle in holder if angle is not None}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"not a plan of this version: {error}", file=path, hint="solve the problem again") from error
    if len(arm) != ARM_AXES or len(holder) > MOST_EXTERNAL:
        raise InputError(f"EGM moves arms of {ARM_AXES} axes, with up to {MOST_EXTERNAL} more", file=path)
    if any(not 0.0 < value < math.inf for pair in limits.values() for value in pair):
        raise InputError("a limit that is no positive number", file=path)
    moved = _table(folder / "trajectory.csv", names)
    order = [*arm, *(name for name, _ in holder)]
    columns = [np.full(len(moved), held[name]) if name in held else moved[:, names.index(name)] for name in order]
    both = np.array([limits.get(name, (0.0, 0.0)) for name in order])
    return JointPlan(np.column_stack(columns), both[:, 0], both[:, 1])


def _json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_PLAN:
            raise InputError(f"larger than {LARGEST_PLAN >> 20} MB", file=path)
        data = json.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        raise InputError("no plan here", file=path, hint="solve a problem first: python -m planner.solve") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from error
    if not isinstance(data, dict):
        raise InputError("not a plan", file=path)
    return data


def _table(path: Path, names: list[str]) -> Array:
    """The named columns at EGM's rate (n, k)."""
    try:
        if path.stat().st_size > LARGEST_TABLE:
            raise InputError(f"larger than {LARGEST_TABLE >> 20} MB", file=path)
        with path.open(encoding="ascii") as stream:
            head = stream.readline().strip().split(",")
            missing = [name for name in ("t_s", *names) if name not in head]
            if missing:
                raise InputError(f"no column {missing[0]!r}", file=path, line=1)
            columns = [head.index(name) for name in ("t_s", *names)]
            rows = np.loadtxt(stream, delimiter=",", usecols=columns, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from error
    steps = np.diff(rows[:, 0])
    if len(rows) < 4 or not np.isfinite(rows).all() or steps.min() <= 0.0 or np.ptp(steps[:-1]) > 2 * UNEVEN:
        raise InputError("not a trajectory with even steps", file=path)
    if steps.max() > LONGEST_STEP + UNEVEN:
        raise InputError(f"steps of {steps.max():g} s, but no plan has more than {LONGEST_STEP:g} s", file=path, line=3)
    instants = np.arange(0.0, rows[-1, 0] + PERIOD, PERIOD)
    if abs(steps[0] - PERIOD) < UNEVEN:
        return rows[:, 1:]
    return np.asarray(CubicSpline(rows[:, 0], rows[:, 1:])(np.minimum(instants, rows[-1, 0])))
