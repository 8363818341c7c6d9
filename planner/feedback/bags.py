"""ROS recordings: joint states in bags of ROS 1 (.bag) and ROS 2 (a folder, .db3, .mcap)."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import InputError
from planner.base.extras import missing_extra
from planner.cell.cell import Cell

SUFFIXES = (".bag", ".db3", ".mcap")
LARGEST_BAG = 4_000_000_000  # bytes: bags may also hold camera images, which are not read
MOST_MESSAGES = 4_000_000  # joint states: about an hour at 1 kHz
JOINT_STATE = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
USUAL = ("/joint_states", "/robot/joint_states")
COMMANDED = ("command", "target", "desired", "reference", "setpoint", "cmd")  # in the name of a topic of commands
NANO = 1e-9
OFTEN = 0.9  # × the number of messages of the joint that is sent most often


@dataclass(frozen=True)
class BagTable:
    """Joint states as a table: column names, each row's message number among all joint states, and the values."""

    names: tuple[str, ...]
    messages: Ints
    numbers: Array


@dataclass(frozen=True)
class _TopicJoints:
    """Messages of one topic: stamps [ns], positions and message numbers of each joint."""

    stamps: dict[str, list[int]] = field(default_factory=dict)
    places: dict[str, list[float]] = field(default_factory=dict)
    messages: dict[str, list[int]] = field(default_factory=dict)


def is_bag(path: Path) -> bool:
    """Whether a recording is a ROS bag."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(path: Path, cell: Cell, topic: str | None = None) -> BagTable:
    """Read the joint states of a bag; a topic whose name marks it as commands gives the commanded joints.

    topic   of the executed joints, where the bag has several
    Raises InputError if there are none, if the file is not a bag, or if the package that reads bags is missing.
    """
    files = [each for each in path.rglob("*") if each.is_file()] if path.is_dir() else [path]
    if not path.exists():
        raise InputError("there is no such file", file=path)
    if sum(each.stat().st_size for each in files) > LARGEST_BAG:
        raise InputError(f"larger than {LARGEST_BAG // 10**9} GB", file=path, hint="record the joint states alone")
    found = _topics(path)
    executed, commanded = _chosen(path, found, topic, cell)
    joints = [name for name in cell.joint_names if name in executed.places]
    if not joints:
        there = ", ".join(sorted(executed.places))[:200]
        raise InputError(f"its joints are {there}", file=path, hint=f"this cell's are {', '.join(cell.joint_names)}")
    # several publishers send separate messages: resample all joints at the stamps of one that is sent most often
    most = max(len(executed.stamps[name]) for name in joints)
    leader = next(name for name in joints if len(executed.stamps[name]) >= OFTEN * most)
    base = np.array(executed.stamps[leader], dtype=np.int64)
    kept = _in_all(path, base, executed, joints)
    base, messages = base[kept], np.array(executed.messages[leader], dtype=np.int64)[kept]
    time = NANO * (base - base[0])
    columns = [_at(time, base[0], executed, name) for name in joints]
    names = ["t_s", *(_named(cell, name) for name in joints)]
    if commanded is not None:
        columns += [_at(time, base[0], commanded, name) for name in cell.joint_names]
        names += [f"target_{_named(cell, name)}" for name in cell.joint_names]
    return BagTable(tuple(names), messages, np.column_stack([time, *columns]))


def _in_all(path: Path, base: Ints, executed: _TopicJoints, joints: Sequence[str]) -> Flags:
    """Which instants (m) [ns] lie between the first and last message of every joint. InputError if none does."""
    stamps = [np.array(executed.stamps[name], dtype=np.int64) for name in joints]
    slack = int(max(np.median(np.diff(each)) if len(each) > 1 else 0.0 for each in stamps))
    first, last = max(int(each.min()) for each in stamps), min(int(each.max()) for each in stamps)
    kept = np.asarray((base >= first - slack) & (base <= last + slack))
    if not kept.any():
        raise InputError("its joints were recorded at different times", file=path, hint="record all joints at once")
    return kept


def _named(cell: Cell, name: str) -> str:
    """A column's name with the unit that ROS uses."""
    return f"{name}_{'rad' if cell.limits.turns[cell.joint_names.index(name)] else 'm'}"


def _at(time: Array, zero: np.int64, joints: _TopicJoints, name: str) -> Array:
    """Positions (m) of a joint at times (m) [s] after an instant [ns]."""
    own = NANO * (np.array(joints.stamps[name], dtype=np.int64) - zero)
    places = np.array(joints.places[name])
    if len(own) == len(time) and (own == time).all():
        return places
    order = np.argsort(own, kind="stable")
    return np.asarray(np.interp(time, own[order], places[order]))


def _topics(path: Path) -> dict[str, _TopicJoints]:
    """The joint-state topics with all their messages."""
    try:
        from apsw import Error as StorageError
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag1 import ReaderError as FirstReaderError
        from rosbags.rosbag2 import ReaderError as SecondReaderError
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_typestore
    except ImportError as error:
        raise missing_extra(error, "reading a bag of ROS") or error from None
    # what the packages raise on damaged bytes: lengths beyond all memory, unknown names, a broken database
    wrong = (AnyReaderError, FirstReaderError, SecondReaderError, SerdeError, TypesysError, StorageError, sqlite3.Error,
             struct.error, OSError, EOFError, MemoryError, ArithmeticError, LookupError, AssertionError, TypeError,
             ValueError, AttributeError, RuntimeError)  # fmt: skip
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            there = {each.topic: each.msgtype for each in reader.connections}
            chosen = [each for each in reader.connections if each.msgtype in JOINT_STATE]
            found = {each.topic: _TopicJoints() for each in chosen}
            for number, (name, stamp, message) in enumerate(_messages(reader, chosen), 1):
                if number > MOST_MESSAGES:
                    raise InputError(f"more than {MOST_MESSAGES} messages of joints", file=path)
                _take(found[name], number, stamp, message, path)
    except wrong as error:
        reason = f"cannot be read as a bag of ROS: {str(error) or type(error).__name__}"
        raise InputError(reason[:240], file=path, hint="a whole bag, closed by its recorder") from None
    if not found:
        topics = ", ".join(f"{name} ({kind})" for name, kind in sorted(there.items()))[:240] or "nothing"
        raise InputError("has no sensor_msgs/JointState", file=path, hint=f"it has {topics}")
    return {name: joints for name, joints in found.items() if joints.places}


def _messages(reader: Any, connections: Sequence[Any]) -> Iterator[tuple[str, int, Any]]:
    """Topic, time of recording [ns] and message, in order."""
    if connections:
        for connection, stamp, raw in reader.messages(connections=connections):
            yield connection.topic, stamp, reader.deserialize(raw, connection.msgtype)


def _take(joints: _TopicJoints, number: int, recorded: int, message: Any, path: Path) -> None:
    """Add a message's positions. Raises InputError if it has more or fewer positions than joint names."""
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    places = np.asarray(message.position, dtype=np.float64)
    if len(places) != len(message.name):
        if not len(places):
            return  # only speeds or efforts
        reason = f"a message names {len(message.name)} joints but has {len(places)} positions"
        raise InputError(reason, file=path, line=number)
    if not np.isfinite(places).all():
        raise InputError("a message has a position that is not a finite number", file=path, line=number)
    for name, place in zip(message.name, places.tolist(), strict=True):
        # if the publisher does not stamp its messages, use the time of recording
        joints.stamps.setdefault(name, []).append(stamp or recorded)
        joints.places.setdefault(name, []).append(place)
        joints.messages.setdefault(name, []).append(number)


def _chosen(
    path: Path, found: dict[str, _TopicJoints], topic: str | None, cell: Cell
) -> tuple[_TopicJoints, _TopicJoints | None]:
    """The executed joints, and the commanded ones if there are any."""
    if not found:
        raise InputError("its joint states have no positions", file=path)
    told = {name: joints for name, joints in found.items() if any(word in name.lower() for word in COMMANDED)}
    done = {name: joints for name, joints in found.items() if name not in told}
    if topic is not None:
        if topic not in found:
            raise InputError(
                f"has no joint states in {topic}", file=path, field="--topic", hint=", ".join(sorted(found))
            )
        executed = topic
    else:
        # of several, the one with most of the cell's joints, or with the usual name
        if not done:
            hint = "a topic such as /joint_states; --topic names another"
            raise InputError("it has commanded joints, but not the executed ones", file=path, hint=hint)
        counts = {name: sum(joint in joints.places for joint in cell.joint_names) for name, joints in done.items()}
        most = [name for name, count in counts.items() if count == max(counts.values())]
        usual = [name for name in most if name in USUAL]
        if len(most) > 1 and len(usual) != 1:
            raise InputError(
                f"several topics have joints: {', '.join(sorted(most))}",
                file=path,
                field="--topic",
                hint="name one of them",
            )
        executed = usual[0] if usual else most[0]
    # of several command topics, the only one that has all joints
    others = [joints for name, joints in told.items() if name != executed]
    whole = [joints for joints in others if all(name in joints.places for name in cell.joint_names)]
    return found[executed], whole[0] if len(whole) == 1 else None
