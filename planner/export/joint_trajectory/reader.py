"""Reads the two JSON files of a joint trajectory: exactly the fields that ROS's message has, and nothing else."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.errors import InputError
from planner.export.joint_trajectory.knots import Knots
from planner.export.joint_trajectory.switches import Switch
from planner.export.joint_trajectory.writer import NANO

LONGEST_FILE = 1_000_000_000  # characters; 180,000 points of eight joints have some 70 million
MOST_JOINTS = 32
LONGEST_WHOLE = 19  # digits; what 64 bits hold
LONGEST_SECONDS = 2**31 - 1  # builtin_interfaces/Duration counts them with 32 bits

POINT = ("positions", "velocities", "accelerations", "effort", "time_from_start")
SWITCH = ("time_from_start", "output", "value", "bead")


@dataclass(frozen=True)
class JointTrajectory:
    """A message that was read: names (nj) and points of all joints in their order."""

    joint_names: tuple[str, ...]
    knots: Knots


def read_joint_trajectory(text: str) -> JointTrajectory:
    """The message of a JSON text. Raises InputError, with the field, for whatever is not as ROS defines it."""
    reader = _Reader("JointTrajectory")
    message = reader.fields(reader.load(text), "the message", ("header", "joint_names", "points"))
    header = reader.fields(message["header"], "header", ("stamp", "frame_id"))
    reader.duration(header["stamp"], "header.stamp")
    if not isinstance(header["frame_id"], str):
        raise reader.error("header.frame_id", "must be a text")
    names = reader.items(message["joint_names"], "joint_names")
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) != len(names):
        raise reader.error("joint_names", "must be names, each once")
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
            raise reader.error(f"points.{i}.time_from_start", "must be later than the point before")
    if len(times) < 2:
        raise reader.error("points", "must be two or more")
    return JointTrajectory(tuple(names), Knots(np.array(times), *(np.array(table) for table in rows.values())))


def read_switches(text: str) -> tuple[tuple[Switch, ...], dict[str, float]]:
    """Switching of the extruders, and the axes that are held [rad]. Raises InputError for whatever is not known."""
    reader = _Reader("extruder")
    data = reader.fields(reader.load(text), "the file", ("held", "events"))
    if not isinstance(data["held"], dict):
        raise reader.error("held", "must be angles by name")
    angles = reader.numbers(list(data["held"].values()), "held", len(data["held"]))
    found = []
    for i, item in enumerate(reader.items(data["events"], "events")):
        event = reader.fields(item, f"events.{i}", SWITCH)
        output, value, bead = event["output"], event["value"], event["bead"]
        if not isinstance(output, str) or not isinstance(value, bool) or type(bead) is not int:
            raise reader.error(f"events.{i}", "output is a text, value true or false, bead a whole number")
        found.append(Switch(reader.duration(event["time_from_start"], f"events.{i}"), output, value, bead))
    return tuple(found), dict(zip(data["held"], angles, strict=True))


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
        raise self.error("the file", f"{name} is not a number of JSON")

    def _whole(self, digits: str) -> int:
        if len(digits) > LONGEST_WHOLE:
            raise self.error("the file", "a whole number is too long")
        return int(digits)

    def _once(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            raise self.error("the file", "a field stands there twice")
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
        """Seconds of a builtin_interfaces/Duration that is not negative."""
        parts = self.fields(value, field, ("sec", "nanosec"))
        sec, nanosec = parts["sec"], parts["nanosec"]
        if type(sec) is not int or type(nanosec) is not int:
            raise self.error(field, "must be whole seconds and nanoseconds")
        if not (0 <= sec <= LONGEST_SECONDS and 0 <= nanosec < NANO):
            raise self.error(field, "is out of range")
        return sec + nanosec / NANO
