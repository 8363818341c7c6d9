"""Recordings of ROS: bags of ROS 1 and ROS 2 that its own package writes, read as the tables that they hold."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.recordings import Recording, recorded
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED, InputError
from planner.cell.cell import Cell
from planner.feedback.bags import is_bag, read_bag
from planner.feedback.identify_command import main
from planner.feedback.identify_match import match
from planner.feedback.identify_program import asked_text
from planner.feedback.identify_robot_file import digest_of
from planner.feedback.recordings import read_log
from tests.identify_fixtures import asked_of, cell_of, truth_of

pytest.importorskip("rosbags")


KINDS = ("bag", "sqlite3", "mcap")
SINCE = 1_700_000_000 * 10**9  # ns


def bag_of(
    folder: Path,
    kind: str,
    topics: dict[str, Sequence[tuple[int, Sequence[str], Sequence[float]]]],
    stamped: bool = True,
    of: str = "sensor_msgs/msg/JointState",
) -> Path:
    """A bag of topics: instants [ns], names and places of each message."""
    from rosbags.rosbag1 import Writer as FirstWriter
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as SecondWriter
    from rosbags.typesys import Stores, get_typestore

    first = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    types = store.types
    path = folder / ("run.bag" if first else "run")
    writer: Any = (
        FirstWriter(path) if first else SecondWriter(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
    )
    with writer:
        for topic, messages in topics.items():
            connection = writer.add_connection(topic, of, typestore=store)
            for k, (stamp, names, places) in enumerate(messages):
                time = types["builtin_interfaces/msg/Time"](*divmod(stamp if stamped else 0, 10**9))
                sequence = {"seq": k} if first else {}
                header = types["std_msgs/msg/Header"](stamp=time, frame_id="", **sequence)
                nothing = np.empty(0)
                if of.endswith("JointState"):
                    message = types[of](header, list(names), np.array(places, dtype=np.float64), nothing, nothing)
                else:
                    message = types[of](data="x")
                raw = (store.serialize_ros1 if first else store.serialize_cdr)(message, of)
                writer.write(connection, SINCE + 4_000_000 * k + 1_000_000, raw)
    return path


def messages(
    names: Sequence[str], time: Array, q: Array, late: int = 0
) -> list[tuple[int, Sequence[str], Sequence[float]]]:
    return [(SINCE + late + round(1e9 * t), names, row) for t, row in zip(time.tolist(), q.tolist(), strict=True)]


def short(cell: Cell, count: int = 80) -> tuple[Array, Array]:
    time = 0.004 * np.arange(count)
    return time, cell.home + 0.1 * np.sin(3.0 * time)[:, None] * np.arange(len(cell.home))


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_is_read_as_the_table_that_it_holds(tmp_path: Path, kind: str) -> None:
    _, cell = cell_of("cylinder_logo")
    time, q = short(cell)
    order = np.array([3, 1, 2, 0, 6, 5, 4])
    names = [cell.joint_names[j] for j in order]
    path = bag_of(tmp_path, kind, {"/joint_states": messages(names, time, q[:, order])})
    assert is_bag(path)
    log = read_log(path, cell)
    np.testing.assert_allclose(log.time, time, atol=1e-8)
    np.testing.assert_allclose(log.executed * log.unit, q, atol=1e-12)
    assert log.commanded is None and log.lines.tolist() == list(range(1, 81))
    if kind != "bag":
        (inside,) = (each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
        np.testing.assert_array_equal(read_log(inside, cell).executed, log.executed)


@pytest.mark.parametrize("kind", KINDS[:2])
def test_commands_and_joints_of_other_publishers_come_to_the_same_instants(tmp_path: Path, kind: str) -> None:
    _, cell = cell_of("cylinder_logo")
    time, q = short(cell)
    arm, rest = cell.joint_names[:6], cell.joint_names[6:]
    topics = {
        "/joint_states": [
            *messages(arm, time, q[:, :6]),
            *messages(rest, np.append(time, 0.32) - 1e-3, np.append(q[:, 6:], q[-1:, 6:], axis=0)),
        ],
        "/controller/joint_commands": messages(cell.joint_names, time, q + 0.01),
        "/other": messages(("door",), time, q[:, :1]),
    }
    log = read_log(bag_of(tmp_path, kind, topics), cell)
    np.testing.assert_allclose(log.executed[:, :6], q[:, :6], atol=1e-12)
    np.testing.assert_allclose(log.executed[:, 6], np.interp(time + 1e-3, time, q[:, 6]), atol=1e-4)
    assert log.commanded is not None
    np.testing.assert_allclose(log.commanded, q + 0.01, atol=1e-12)


def test_messages_without_stamps_count_by_when_they_were_recorded(tmp_path: Path) -> None:
    _, cell = cell_of("peer_cap")
    time, q = short(cell)
    path = bag_of(tmp_path, "mcap", {"/joint_states": messages(cell.joint_names, time, q)}, stamped=False)
    np.testing.assert_allclose(read_log(path, cell).time, time, atol=1e-8)


def test_a_rail_is_in_metres(tmp_path: Path) -> None:
    _, cell = cell_of("rail_panel")
    time, q = short(cell)
    log = read_log(bag_of(tmp_path, "sqlite3", {"/joint_states": messages(cell.joint_names, time, q)}), cell)
    assert log.unit.tolist() == [1.0] * len(cell.joint_names)
    assert read_bag(tmp_path / "run", cell).names[1] == f"{cell.joint_names[0]}_m"


def test_a_test_program_is_found_in_a_bag(tmp_path: Path) -> None:
    _, cell = cell_of("peer_cap")
    asked = asked_of("peer_cap", joints=(3,), most=10.0)
    recording: Recording = recorded(asked, truth_of(cell))
    path = bag_of(tmp_path, "mcap", {"/joint_states": messages(cell.joint_names, recording.time, recording.executed)})
    log = match(read_log(path, cell), asked)
    np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4)


def test_of_several_topics_one_is_to_be_named(tmp_path: Path) -> None:
    _, cell = cell_of("peer_cap")
    time, q = short(cell)
    topics = {f"/{side}/states": messages(cell.joint_names, time, q + k) for k, side in enumerate(("left", "right"))}
    path = bag_of(tmp_path, "sqlite3", topics)
    with pytest.raises(
        InputError, match=r"several topics have joints: /left/states, /right/states \(name one of them\)"
    ):
        read_log(path, cell)
    np.testing.assert_allclose(read_log(path, cell, topic="/right/states").executed, q + 1, atol=1e-12)
    with pytest.raises(InputError, match="has no joint states in /middle"):
        read_log(path, cell, topic="/middle")


def _nan(time: Array, q: Array) -> tuple[Array, Array]:
    q[5, 1] = np.nan
    return time, q


def _back(time: Array, q: Array) -> tuple[Array, Array]:
    time[40:] -= 0.1
    return time, q


@pytest.mark.parametrize(
    ("change", "names", "said"),
    [
        (_nan, None, r":6: a message has a position that is not a finite number"),
        (_back, None, "the clock runs back by 0.096 s"),
        (None, ("a", "b", "c", "d", "e", "f"), "its joints are a, b, c, d, e, f"),
        (None, ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "j6x"), "no column has joint_6"),
        (lambda time, q: (time[:20], q[:20]), None, "holds 20 samples"),
    ],
)
def test_bags_of_something_else_are_refused(
    tmp_path: Path,
    change: Callable[[Array, Array], tuple[Array, Array]] | None,
    names: tuple[str, ...] | None,
    said: str,
) -> None:
    _, cell = cell_of("peer_cap")
    time, q = short(cell) if change is None else change(*short(cell))
    path = bag_of(tmp_path, "sqlite3", {"/joint_states": messages(names or cell.joint_names, time, q)})
    with pytest.raises(InputError, match=said):
        read_log(path, cell)


def test_a_bag_without_joints_says_what_it_has(tmp_path: Path) -> None:
    path = bag_of(tmp_path, "mcap", {"/chatter": [(SINCE, (), ())]}, of="std_msgs/msg/String")
    with pytest.raises(InputError, match=r"has no sensor_msgs/JointState \(it has /chatter \(std_msgs/msg/String\)\)"):
        read_log(path, cell_of("peer_cap")[1])


def test_commands_alone_are_refused(tmp_path: Path) -> None:
    _, cell = cell_of("peer_cap")
    path = bag_of(tmp_path, "bag", {"/joint_command": messages(cell.joint_names, *short(cell))})
    with pytest.raises(InputError, match="it has commanded joints, but not the executed ones"):
        read_log(path, cell)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("spoilt", [lambda data: data[: len(data) // 2], lambda data: b"x" * 200, lambda data: b""])
def test_a_spoilt_bag_is_refused(tmp_path: Path, kind: str, spoilt: Callable[[bytes], bytes]) -> None:
    _, cell = cell_of("peer_cap")
    path = bag_of(tmp_path, kind, {"/joint_states": messages(cell.joint_names, *short(cell))})
    file = path if kind == "bag" else next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
    file.write_bytes(spoilt(file.read_bytes()))
    with pytest.raises(InputError, match=r"cannot be read as a bag of ROS|has no sensor_msgs|holds .* samples"):
        read_log(file, cell)
    if kind != "bag":
        with pytest.raises(InputError):
            read_log(path, cell)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_with_any_bytes_overwritten_is_read_or_refused(tmp_path: Path, kind: str) -> None:
    """Lengths of records, too, which their packages believe."""
    _, cell = cell_of("cylinder_logo")
    path = bag_of(tmp_path, kind, {"/joint_states": messages(cell.joint_names, *short(cell))})
    file = path if kind == "bag" else next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
    whole = file.read_bytes()
    random = np.random.default_rng(1)
    for k in random.integers(0, len(whole) - 8, 60).tolist():
        for new in (b"\xff" * 8, b"\x00" * 8, (2**62).to_bytes(8, "little")):
            file.write_bytes(whole[:k] + new + whole[k + 8 :])
            with suppress(InputError):
                read_log(file, cell)


def test_joints_of_a_publisher_that_stops_are_not_taken_to_stand(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    time, q = short(cell, 200)
    arm, rest = cell.joint_names[:6], cell.joint_names[6:]
    both = [*messages(arm, time, q[:, :6]), *messages(rest, time[20:120], q[20:120, 6:])]
    log = read_log(bag_of(tmp_path, "mcap", {"/joint_states": both}), cell)
    assert len(log.time) == 102
    np.testing.assert_allclose(log.executed[1:-1], q[20:120], atol=1e-9)
    (tmp_path / "apart").mkdir()
    apart = [*messages(arm, time[:60], q[:60, :6]), *messages(rest, time[100:], q[100:, 6:])]
    with pytest.raises(InputError, match="its joints were recorded at different times"):
        read_log(bag_of(tmp_path / "apart", "mcap", {"/joint_states": apart}), cell)


def test_joints_that_are_sent_seldom_do_not_thin_out_the_others(tmp_path: Path) -> None:
    _, cell = cell_of("rail_panel")
    time, q = short(cell, 200)
    topic = [*messages(cell.joint_names[:1], time[::10], q[::10, :1]), *messages(cell.joint_names[1:], time, q[:, 1:])]
    log = read_log(bag_of(tmp_path, "mcap", {"/joint_states": topic}), cell)
    assert log.step == pytest.approx(0.004) and len(log.time) > 180


def test_commands_of_some_joints_are_no_commands(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    time, q = short(cell)
    topics = {
        "/joint_states": messages(cell.joint_names, time, q),
        "/table/joint_command": messages(cell.joint_names[6:], time, q[:, 6:]),
    }
    assert read_log(bag_of(tmp_path, "mcap", topics), cell).commanded is None
    (tmp_path / "more").mkdir()
    topics["/arm/joint_command"] = messages(cell.joint_names, time, q + 0.01)
    told = read_log(bag_of(tmp_path / "more", "mcap", topics), cell).commanded
    np.testing.assert_allclose(told, q + 0.01, atol=1e-12)


@pytest.mark.slow
def test_a_bag_that_is_a_folder_is_measured_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, cell = cell_of("peer_cap")
    whole = asked_of("peer_cap", "rapid", joints=(3,), most=30.0)
    asked = replace(whole, moves=whole.moves[:1] + whole.moves[-7:])
    recording: Recording = recorded(asked, truth_of(cell))
    path = bag_of(tmp_path, "mcap", {"/joint_states": messages(cell.joint_names, recording.time, recording.executed)})
    (tmp_path / "asked.json").write_text(asked_text(asked), encoding="utf-8")
    given = ["read", str(path), "peer_cap", "--asked", str(tmp_path / "asked.json"), "--out", str(tmp_path / "out")]
    assert main(given) == EXIT_VERIFIED, capsys.readouterr().err
    (written,) = (tmp_path / "out").iterdir()
    assert f"SHA-256 {digest_of(path)[:16]}" in written.read_text(encoding="utf-8")
    before = digest_of(path)
    (path / "metadata.yaml").write_text("changed", encoding="utf-8")
    assert digest_of(path) != before


def test_the_package_is_named_where_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.bag").write_bytes(b"")
    for name in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(InputError, match=r"reading a bag of ROS needs the package rosbags .*beadwise\[bags\]"):
        read_log(tmp_path / "run.bag", cell_of("peer_cap")[1])


def test_a_missing_bag_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_log(tmp_path / "none.mcap", cell_of("peer_cap")[1])
