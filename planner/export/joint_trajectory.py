"""ROS trajectory_msgs/JointTrajectory as JSON: writer, reader, and check against the plan."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import CubicSpline

from planner.base.arrays import Array, Indices
from planner.base.errors import InputError
from planner.export.external import held_axes
from planner.export.fit import by_samples, thin, to_matrix
from planner.export.moves import ANGLE_TOLERANCE, ROUNDING, fed_spans, run_tolerance
from planner.export.support import by_bead, output_numbers
from planner.export.text import beyond
from planner.plan.plan import by_nozzle

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# Switching times of the extruders, from the start of the motion.


@dataclass(frozen=True)
class Switch:
    """An output goes on or off for a bead, at a time [s] from the start."""

    time: float
    output: str
    value: bool
    bead: int


def planned_switches(plan: Plan) -> tuple[Switch, ...]:
    """On at the first and off at the last sample of each stretch with material, in order of time."""
    t = plan.trajectory
    outputs = by_bead(plan, list(output_numbers(plan.problem)))
    found = []
    for a, b in zip(*(ends.tolist() for ends in fed_spans(t)), strict=True):
        bead = int(t.bead[a])
        found += [Switch(float(t.t[k] - t.t[0]), outputs[bead], value, bead) for k, value in ((a, True), (b, False))]
    return tuple(found)


# ----------------------------------------------------------------------------------------------------
# The fewest points whose quintic splines repeat the planned joints.
#
# Between points with position, velocity and acceleration, ROS's joint_trajectory_controller interpolates by polynomials
# of degree 5 (ros2_controllers, "Trajectory Representation"), and the points are chosen accordingly.

FARTHEST = 64  # samples between two points, at most: where thinning starts
VELOCITY_SHARE = 0.005  # share of a joint's limit by which the splines may miss the planned velocity
ACCELERATION_SHARE = 0.05  # likewise; where jerk jumps, samples do not give the acceleration any better


@dataclass(frozen=True)
class SplineKnots:
    """k points of a joint trajectory: time (k) [s] from its start; q, velocity, acceleration (k, nj) [rad, s]."""

    time: Array
    q: Array
    velocity: Array
    acceleration: Array

    def __len__(self) -> int:
        return len(self.time)

    def chosen(self, rows: Indices) -> SplineKnots:
        """Some of the points."""
        return SplineKnots(self.time[rows], self.q[rows], self.velocity[rows], self.acceleration[rows])


def derived(plan: Plan) -> SplineKnots:
    """Every sample as a point, with velocity and acceleration of the cubic spline through all, from rest to rest."""
    trajectory = plan.trajectory
    time = trajectory.t - trajectory.t[0]
    spline = CubicSpline(time, trajectory.q, bc_type="clamped")
    return SplineKnots(time, trajectory.q, spline(time, 1), spline(time, 2))


def plan_knots(plan: Plan) -> SplineKnots:
    """The points of a plan: as few of its samples as repeat all others within its tolerances."""
    dense, nozzle = derived(plan), Nozzle(plan)
    last = len(dense) - 1
    kept = np.unique([*range(0, last, FARTHEST), *nozzle.begins, last])

    def misfit(a: Indices, b: Indices, k: Indices) -> Array:
        q, velocity, acceleration = quintic(dense.chosen(a), dense.chosen(b), dense.time[k])
        worst = nozzle.misfit(q, k)
        joints = np.abs(q - dense.q[k]).max(axis=1) / ANGLE_TOLERANCE
        limits = plan.cell.limits
        fast = np.abs(velocity - dense.velocity[k]) / (VELOCITY_SHARE * limits.velocity)
        steep = np.abs(acceleration - dense.acceleration[k]) / (ACCELERATION_SHARE * limits.acceleration)
        out: Array = np.maximum.reduce([worst, joints, fast.max(axis=1), steep.max(axis=1)])
        return out

    return dense.chosen(thin(kept, by_samples(misfit)))


class Nozzle:
    """How far postures hold the nozzle from its pose at a plan's samples."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._in_use = by_nozzle(plan.cell, plan.trajectory.events, plan.trajectory.t)
        self._rotation = to_matrix(plan.trajectory.quat / np.linalg.norm(plan.trajectory.quat, axis=1, keepdims=True))

    @property
    def begins(self) -> tuple[int, ...]:
        """Samples at which the use of each of several nozzles begins."""
        return tuple(rows.start for _, rows in self._in_use)

    def misses(self, q: Array, k: Indices) -> tuple[Array, Array]:
        """Distance [m] of the tip and angle [rad], each (m), of postures q (m, nj) from samples k (m)."""
        T = np.empty((len(k), 4, 4))
        for cell, rows in self._in_use:
            own = (k >= rows.start) & (k < rows.stop)
            T[own] = cell.T_part_nozzle(q[own])
        off = np.linalg.norm(T[:, :3, 3] - self._plan.trajectory.tip[k], axis=1)
        # the chord between two rotations, in Frobenius' norm, is sqrt(8) sin(angle / 2)
        chord = np.linalg.norm(T[:, :3, :3] - self._rotation[k], axis=(1, 2))
        return off, 2.0 * np.arcsin(np.minimum(chord / np.sqrt(8.0), 1.0))

    def misfit(self, q: Array, k: Indices) -> Array:
        """The worse of distance and angle (m), in tolerances."""
        off, turned = self.misses(q, k)
        chord = self._plan.problem.program.chord
        allowed = np.where(self._plan.trajectory.deposit[k], chord - ROUNDING, run_tolerance(chord))
        out: Array = np.maximum(off / allowed, turned / ANGLE_TOLERANCE)
        return out


def quintic(a: SplineKnots, b: SplineKnots, time: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (m, nj) at times (m) between points a (m) and b (m)."""
    h = (b.time - a.time)[:, None]
    u = (time - a.time)[:, None] / h
    # the Taylor polynomial from a, plus three terms that reach b's state; the remainders r are in units of position
    r0 = b.q - a.q - h * a.velocity - 0.5 * h**2 * a.acceleration
    r1 = h * (b.velocity - a.velocity) - h**2 * a.acceleration
    r2 = h**2 * (b.acceleration - a.acceleration)
    c3 = 10.0 * r0 - 4.0 * r1 + 0.5 * r2
    c4 = -15.0 * r0 + 7.0 * r1 - r2
    c5 = 6.0 * r0 - 3.0 * r1 + 0.5 * r2
    c1, c2 = h * a.velocity, 0.5 * h**2 * a.acceleration
    q = a.q + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
    velocity = (c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h
    acceleration = (2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / h**2
    return q, velocity, acceleration


def at_times(knots: SplineKnots, time: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (m, nj) at times (m) of a trajectory of at least two points."""
    first = np.clip(np.searchsorted(knots.time, time, side="right") - 1, 0, len(knots) - 2)
    return quintic(knots.chosen(first), knots.chosen(first + 1), time)


# ----------------------------------------------------------------------------------------------------
# Writer: two JSON files, the message and the switching of the extruders.
#
# One message holds the whole print, as it must not stop within a bead and travel between beads is timed as well. Its
# times count from the robot's first motion, as do those of the extruder's G-code.

# decimals of rad, rad/s and rad/s^2; at 1 m a ten-millionth of a radian is 0.1 micrometres
DECIMALS = {"positions": 7, "velocities": 6, "accelerations": 5}
NANO = 1_000_000_000


def trajectory_name(plan: Plan) -> str:
    """File of the message."""
    return f"{plan.name}_joint_trajectory.json"


def switches_name(plan: Plan) -> str:
    """File of the extruders' switching."""
    return f"{plan.name}_extruder.json"


def joint_trajectory(plan: Plan) -> str:
    """JSON of the message, one line per point."""
    return message(plan.cell.joint_names, plan_knots(plan))


def message(joint_names: Sequence[str], knots: SplineKnots) -> str:
    """JSON of the message with these points, one line for each."""
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
    # a zero stamp: start as soon as the message arrives
    head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    return (
        f'{{"header":{_line(head)},\n"joint_names":{_line(list(joint_names))},\n"points":[\n'
        + ",\n".join(points)
        + "\n]}\n"
    )


def write(plan: Plan) -> dict[str, str]:
    """Both files of a verified plan, by name."""
    return {trajectory_name(plan): joint_trajectory(plan), switches_name(plan): switches(plan)}


def switches(plan: Plan) -> str:
    """JSON of the times at which each bead's extruder output goes on and off, and of the held axes."""
    lines = [
        _line({"time_from_start": _duration(each.time), "output": each.output, "value": each.value, "bead": each.bead})
        for each in planned_switches(plan)
    ]
    return f'{{"held":{_line(_held(plan))},\n"events":[\n' + ",\n".join(lines) + "\n]}\n"


def _held(plan: Plan) -> dict[str, float | None]:
    """Where each axis is held [rad, m]."""
    return {axis.name: axis.held for axis in held_axes(plan.cell)}


def _line(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _unsigned_noughts(values: list[float]) -> list[float]:
    return [value + 0.0 for value in values]


def _duration(seconds: float) -> dict[str, int]:
    """A builtin_interfaces/Duration."""
    sec, nanosec = divmod(round(seconds * NANO), NANO)
    return {"sec": sec, "nanosec": nanosec}


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the fields of ROS's message.

LONGEST_FILE = 1_000_000_000  # characters; 180,000 points of eight joints have some 70 million
MOST_JOINTS = 32
LONGEST_WHOLE = 19  # digits; as many as 64 bits hold
LONGEST_SECONDS = 2**31 - 1  # builtin_interfaces/Duration counts them with 32 bits

POINT = ("positions", "velocities", "accelerations", "effort", "time_from_start")
SWITCH = ("time_from_start", "output", "value", "bead")


@dataclass(frozen=True)
class JointTrajectory:
    """A message that was read: names (nj) and points of all joints in their order."""

    joint_names: tuple[str, ...]
    knots: SplineKnots


def read_joint_trajectory(text: str) -> JointTrajectory:
    """The message in a JSON text. Raises InputError, with the field, for anything that is not as ROS defines it."""
    reader = _Reader("JointTrajectory")
    message = reader.fields(reader.load(text), "the message", ("header", "joint_names", "points"))
    header = reader.fields(message["header"], "header", ("stamp", "frame_id"))
    reader.duration(header["stamp"], "header.stamp")
    if not isinstance(header["frame_id"], str):
        raise reader.error("header.frame_id", "must be a text")
    names = reader.items(message["joint_names"], "joint_names")
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) != len(names):
        raise reader.error("joint_names", "must be unique names")
    if not 0 < len(names) <= MOST_JOINTS:
        raise reader.error("joint_names", f"must be 1 to {MOST_JOINTS} joints")
    rows: dict[str, list[list[float]]] = {name: [] for name in POINT[:3]}
    times: list[float] = []
    for i, item in enumerate(reader.items(message["points"], "points")):
        point = reader.fields(item, f"points.{i}", POINT)
        for name, table in rows.items():
            table.append(reader.numbers(point[name], f"points.{i}.{name}", len(names)))
        reader.numbers(point["effort"], f"points.{i}.effort", 0)
        times.append(reader.duration(point["time_from_start"], f"points.{i}.time_from_start"))
        if i and not times[-2] < times[-1]:
            raise reader.error(f"points.{i}.time_from_start", "must be later than that of the point before")
    if len(times) < 2:
        raise reader.error("points", "must be two or more")
    return JointTrajectory(tuple(names), SplineKnots(np.array(times), *(np.array(table) for table in rows.values())))


def read_switches(text: str) -> tuple[tuple[Switch, ...], dict[str, float]]:
    """Switching of the extruders, and the held axes [rad, m]. Raises InputError for anything unknown."""
    reader = _Reader("extruder")
    data = reader.fields(reader.load(text), "the file", ("held", "events"))
    if not isinstance(data["held"], dict):
        raise reader.error("held", "must be numbers by name")
    places = reader.numbers(list(data["held"].values()), "held", len(data["held"]))
    found = []
    for i, item in enumerate(reader.items(data["events"], "events")):
        event = reader.fields(item, f"events.{i}", SWITCH)
        output, value, bead = event["output"], event["value"], event["bead"]
        if not isinstance(output, str) or not isinstance(value, bool) or type(bead) is not int:
            raise reader.error(f"events.{i}", "output is a text, value true or false, bead a whole number")
        found.append(Switch(reader.duration(event["time_from_start"], f"events.{i}"), output, value, bead))
    return tuple(found), dict(zip(data["held"], places, strict=True))


class _Reader:
    def __init__(self, file: str) -> None:
        self._file = file

    def error(self, field: str, reason: str, line: int | None = None) -> InputError:
        return InputError(reason, file=self._file, field=field, line=line)

    def load(self, text: str) -> Any:
        if len(text) > LONGEST_FILE:
            raise self.error("the file", f"must be at most {LONGEST_FILE} characters")
        try:
            return json.loads(text, parse_constant=self._constant, parse_int=self._whole, object_pairs_hook=self._once)
        except json.JSONDecodeError as error:
            raise self.error("the file", f"is not JSON: {error.msg}", error.lineno) from None
        except RecursionError:
            raise self.error("the file", "is nested too deeply") from None

    def _constant(self, name: str) -> float:
        raise self.error("the file", f"{name} is not a JSON number")

    def _whole(self, digits: str) -> int:
        if len(digits) > LONGEST_WHOLE:
            raise self.error("the file", "a whole number is too long")
        return int(digits)

    def _once(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            raise self.error("the file", "a field occurs twice")
        return found

    def fields(self, value: Any, field: str, names: tuple[str, ...]) -> dict[str, Any]:
        if not isinstance(value, dict) or set(value) != set(names):
            raise self.error(field, f"must have {', '.join(names)} and nothing else")
        return value

    def items(self, value: Any, field: str) -> list[Any]:
        if not isinstance(value, list):
            raise self.error(field, "must be a list")
        return value

    def numbers(self, value: Any, field: str, count: int) -> list[float]:
        items = self.items(value, field)
        if len(items) != count:
            raise self.error(field, f"must be {count} numbers, not {len(items)}")
        for item in items:
            if type(item) not in (int, float) or not math.isfinite(item):
                raise self.error(field, "must be finite numbers")
        return items

    def duration(self, value: Any, field: str) -> float:
        """Seconds in a builtin_interfaces/Duration, which must not be negative."""
        parts = self.fields(value, field, ("sec", "nanosec"))
        sec, nanosec = parts["sec"], parts["nanosec"]
        if type(sec) is not int or type(nanosec) is not int:
            raise self.error(field, "must be whole seconds and nanoseconds")
        if not (0 <= sec <= LONGEST_SECONDS and 0 <= nanosec < NANO):
            raise self.error(field, "is out of range")
        return sec + nanosec / NANO


# ----------------------------------------------------------------------------------------------------
# Check of a message that was read against the plan, also between its points.

BLOCK = 20_000  # samples compared at once: bounds the memory
ON_TIME = 1e-6  # [s]
# How much the splines may differ: by what thinning (`plan_knots`) and rounding allow.
OFF = 0.01e-3  # [m] beyond the chord tolerance, where material is laid
OFF_IN_TRAVEL = 0.3e-3  # [m]
TURNED = np.radians(0.06)  # nozzle and joints
CHECKED_VELOCITY_SHARE = 0.01  # share of a joint's limit
CHECKED_ACCELERATION_SHARE = 0.06


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of both files from the plan beyond rounding and thinning, in words. InputError for unknown fields."""
    found, held = read_switches(files[switches_name(plan)])
    return [
        *_motion(plan, read_joint_trajectory(files[trajectory_name(plan)])),
        *_switching(plan, found, held),
    ]


def _motion(plan: Plan, read: JointTrajectory) -> list[str]:
    if read.joint_names != plan.cell.joint_names:
        return [f"joints are {', '.join(read.joint_names)}, not {', '.join(plan.cell.joint_names)}"]
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
        "a joint's velocity differs by {:.3g} of its limit": CHECKED_VELOCITY_SHARE,
        "a joint's acceleration differs by {:.3g} of its limit": CHECKED_ACCELERATION_SHARE,
    }
    return beyond(zip(allowed, worst.tolist(), allowed.values(), strict=True))


def _switching(plan: Plan, found: tuple[Switch, ...], held: Mapping[str, float]) -> list[str]:
    planned, differences = planned_switches(plan), []
    if len(found) != len(planned):
        differences.append(f"outputs are switched {len(found)} times, not {len(planned)} times")
    for one, other in zip(found, planned, strict=False):
        if (one.output, one.value, one.bead) != (other.output, other.value, other.bead):
            differences.append(f"output {other.output} of bead {other.bead} is not switched as planned")
        elif abs(one.time - other.time) > ON_TIME:
            differences.append(f"output {other.output} of bead {other.bead} is switched at {one.time:.6f} s")
    if dict(held) != _held(plan):
        differences.append("other axes are held, or at other positions")
    return differences
